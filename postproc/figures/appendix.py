"""The appendix's figures: the current of the single urn against eq. (eqapp5), app2 to app4."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from postproc.figures import style
from postproc.reading.points import groups, means, need_only
from postproc.theory.models import defaults

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]

LEAST = 1e-3  # smallest current of theory (per unit time) in relative differences
LOWEST = -1.5  # smallest relative difference in the upper panel of app3
FILLS = (  # fill styles of app3's marks, one for each theory
    {"fillstyle": "full"},
    {"fillstyle": "none"},
    {"fillstyle": "left", "markerfacecoloralt": "white"},
    {"fillstyle": "top", "markerfacecoloralt": "white"},
)
MARKS = "so^DvP"  # the paper's first


class Group(NamedTuple):
    """What was measured at one N and w, by increasing T, and the places of N and w among all."""

    row: int
    column: int
    urn: Circuit
    threshold: Floats
    current: Floats
    error: Floats

    def theory(self, model: Model, threshold: Floats) -> Floats:
        """Return a theory's current at given thresholds."""
        return model.urn_current(replace(self.urn, threshold=threshold))

    @property
    def thresholds(self) -> Floats:
        """All T up to the largest that was measured."""
        return np.arange(0.0, min(self.threshold.max(), self.urn.number) + 1.0)


def _groups(points: xr.Dataset) -> list[Group]:
    need_only(points, "threshold", "number", "channel1_width")
    numbers, widths = (np.unique(points[key]).tolist() for key in ("number", "channel1_width"))
    found = []
    for _, part in groups(points, "number", "channel1_width"):
        group = part.sortby("threshold")
        urn, thresholds = group["circuit"].values[0], group["threshold"].values.astype(float)
        place = numbers.index(urn.number), widths.index(urn.channel1_width)
        found.append(Group(*place, urn, thresholds, *means(group, "current1")))
    return found


def _panels(points: xr.Dataset, height: float = 3.3) -> tuple[Figure, list[Axes]]:
    """Return a figure with a panel for each N, titled."""
    numbers = np.unique(points["number"])
    made = style.figure(style.PAGE if numbers.size > 1 else 4.4, height)
    panels = list(made.subplots(1, numbers.size, squeeze=False, sharey=True)[0])
    for axes, number in zip(panels, numbers, strict=True):
        axes.set_title(f"$N = {number:.0f}$")
        style.label_fraction(axes)
    return made, panels


def _explain(axes: Axes, lines: Sequence[tuple[str, str]]) -> None:
    for dashes, label in lines:
        axes.plot([], [], color=style.GREY, ls=dashes, lw=1.0, label=label)


@style.settings()
def figure_urn_current(points: xr.Dataset, models: Sequence[Model] = ()) -> Figure:
    """Return the stationary current of the single urn against T/N, a panel for each N."""
    models = models or defaults(points["circuit"].values)
    made, panels = _panels(points)
    for group in _groups(points):
        mark, colour = style.look(group.column, MARKS)
        axes, number = panels[group.row], group.urn.number
        label = f"$w = {style.in_math(group.urn.channel1_width, 6)}$" if group.row == 0 else None
        axes.errorbar(group.threshold / number, group.current, group.error, fmt=mark, color=colour,
                      mfc="none", ms=3.6, label=label)  # fmt: skip
        for model in models:
            look = {"color": colour, "ls": model.dashes, "lw": 0.9}
            axes.plot(group.thresholds / number, group.theory(model, group.thresholds), **look)
    _explain(panels[0], [(model.dashes, f"theory, {model.label}") for model in models])
    panels[0].set_ylabel("current (per unit time)")
    panels[0].set_ylim(bottom=0.0)
    style.legend_above(made, *panels[0].get_legend_handles_labels(), 5)
    return made


def relative_difference(current: Floats, error: Floats, expected: Floats) -> tuple[Floats, Floats]:
    """Return (theory - measured)/theory and its standard error, NaN where theory is too small."""
    known = np.where(np.abs(expected) > LEAST, expected, np.nan)
    return (known - current) / known, error / np.abs(known)


@style.settings()
def figure_urn_difference(points: xr.Dataset, models: Sequence[Model] = ()) -> Figure:
    """Return the relative difference of theory and measured current.

    Above, of the first theory (the paper's) and the second; below, on a scale of its own, of all
    but the first. Values below the upper panel are written at its edge.
    """
    models = models or defaults(points["circuit"].values)
    count = np.unique(points["number"]).size
    rows = min(len(models), 2)
    made = style.figure(style.PAGE if count > 1 else 4.4, 2.8 * rows)
    panels = made.subplots(rows, count, squeeze=False, sharex=True, sharey="row")
    beyond, unknown = [], 0
    for group in _groups(points):
        (mark, colour), row = style.look(group.column, MARKS), group.row
        fraction = group.threshold / group.urn.number
        for at, (model, fill) in enumerate(zip(models, FILLS, strict=False)):
            expected = group.theory(model, group.threshold)
            difference, error = relative_difference(group.current, group.error, expected)
            lines = {"color": colour, "lw": 0.7, "ms": 4.4, "marker": mark, "ls": model.dashes}
            chosen = [axes for axes, shown in zip(panels[:, row], (at < 2, at > 0), strict=False)
                      if shown]  # fmt: skip
            for axes in chosen:
                axes.errorbar(fraction, difference, error, **lines, **fill)
            unknown += int(np.isnan(difference).sum())
            if at == 0:
                low = difference < LOWEST
                beyond += [(panels[0, row], x, y, colour) for x, y
                           in zip(fraction[low], difference[low], strict=True)]  # fmt: skip
        if row == 0:
            label = f"$w = {style.in_math(group.urn.channel1_width, 6)}$"
            panels[0, 0].plot([], [], mark, color=colour, ms=4.4, label=label)
    for model, fill in zip(models, FILLS, strict=False):
        look = {"color": style.GREY, "lw": 0.7, "ms": 4.4, "marker": "s", "ls": model.dashes}
        panels[0, 0].plot([], [], label=f"theory, {model.label}", **look, **fill)
    for number, column in zip(np.unique(points["number"]), panels.T, strict=True):
        column[0].set_title(f"$N = {number:.0f}$")
        style.label_fraction(column[-1])
    for axes in panels.flat:
        axes.axhline(0.0, color=style.BLACK, lw=0.6)
    low, high = panels[0, 0].get_ylim()
    panels[0, 0].set_ylim(max(low, LOWEST), min(high, 1.06))
    _mark_beyond(beyond)
    made.supylabel("(theory $-$ measured) / theory", fontsize=9)
    notes = ["▼ below the panel, at the value beside it"] if beyond else []
    if unknown:
        notes.append(f"{unknown} differences left out, where theory is below {LEAST:g}")
    style.note(panels[0, 0], "; ".join(notes))
    handles, labels = panels[0, 0].get_legend_handles_labels()
    style.legend_above(made, handles, labels, 2, fontsize=7.5)
    return made


def _mark_beyond(beyond: Sequence[tuple[Axes, float, float, str]]) -> None:
    """Mark points below the panel at its edge, with their values, one above the other."""
    for place, (axes, x, y, colour) in enumerate(beyond):
        level = LOWEST + 0.06
        axes.plot([x], [level], "v", color=colour, ms=4, clip_on=False, zorder=4)
        taken = sum(one[0] is axes and abs(one[1] - x) < 1e-9 for one in beyond[:place])
        axes.annotate(
            f"{y:.2g}" if y > -100.0 else f"$-10^{{{np.log10(-y):.0f}}}$", (x, level),
            (0, 4 + 7 * taken), textcoords="offset points", fontsize=5.5, color=colour, ha="center",
            zorder=5, bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
        )  # fmt: skip


@style.settings()
def figure_urn_scaled(points: xr.Dataset, models: Sequence[Model] = ()) -> Figure:
    """Return currents and theory divided by N, against T/N, all N in one panel."""
    models = models or defaults(points["circuit"].values)
    made = style.figure(5.0, 3.7)
    axes = made.subplots()
    found, lines = _groups(points), (":", "--", "-.")
    for group in found:
        (mark, colour), number = style.look(group.column, MARKS), group.urn.number
        axes.errorbar(
            group.threshold / number, group.current / number, group.error / number, fmt=mark,
            color=colour, mfc=colour if group.row == found[-1].row else "white", ms=3.6,
            label=f"$w = {style.in_math(group.urn.channel1_width, 6)}$, $N = {number:.0f}$",
        )  # fmt: skip
        for at, model in enumerate(models):
            current = group.theory(model, group.thresholds)
            look = {"ls": lines[group.row % 3], "lw": 0.9} if at == 0 else {"ls": "-", "lw": 0.5}
            axes.plot(group.thresholds / number, current / number, color=colour, **look)
    numbers = np.unique(points["number"])
    explained = [
        (lines[at % 3], f"theory, {models[0].label}, $N = {one:.0f}$")
        for at, one in enumerate(numbers)
    ]
    _explain(axes, [*explained, *(("-", f"theory, {one.label}") for one in models[1:])])
    style.label_fraction(axes)
    axes.set_ylabel("current / $N$ (per unit time)")
    axes.set_ylim(bottom=0.0)
    style.legend_above(made, *axes.get_legend_handles_labels(), 3, fontsize=7)
    return made

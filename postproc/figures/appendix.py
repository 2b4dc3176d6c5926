"""The appendix's figures: the current of the single urn against eq. (eqapp5), app2 to app4."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from postproc.figures import style
from postproc.figures.theories import default

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.reading.points import Points
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
MARKS = {0: ("s", style.BLUE), 1: ("o", style.VERMILION), 2: ("^", style.GREEN)}


def _theory(group: Points, thresholds: Floats, model: Model) -> Floats:
    """Return a theory's current at given thresholds, for a group of one N and w."""
    urn = group.circuit(0)
    return model.urn_current(replace(urn, threshold=thresholds))


def _groups(points: Points) -> list[tuple[int, int, Points]]:
    """Return (index of N, index of w, points by T) for each pair of values."""
    found = []
    for row, number in enumerate(np.unique(points.number)):
        for column, width in enumerate(np.unique(points.channel1_width)):
            chosen = (points.number == number) & (points.channel1_width == width)
            if chosen.any():
                found.append((row, column, points.where(chosen).sorted_by_threshold()))
    return found


def _look(column: int) -> tuple[str, str]:
    return MARKS.get(column, ("D", style.CYCLE[column % len(style.CYCLE)]))


def _panels(points: Points, height: float = 3.3) -> tuple[Figure, list[Axes]]:
    """Return a figure with a panel for each N, titled."""
    numbers = np.unique(points.number)
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
def figure_urn_current(points: Points, models: Sequence[Model] = ()) -> Figure:
    """Return the stationary current of the single urn against T/N, a panel for each N."""
    models = models or default(points)
    points.need_only("threshold", "number", "channel1_width")
    made, panels = _panels(points)
    for row, column, group in _groups(points):
        mark, colour = _look(column)
        label = f"$w = {group.channel1_width[0]:g}$" if row == 0 else None
        panels[row].errorbar(
            group.threshold / group.number,
            group.current,
            group.current_error,
            fmt=mark,
            color=colour,
            mfc="none",
            ms=3.6,
            label=label,
        )
        thresholds = np.arange(0.0, min(group.threshold.max(), group.number[0]) + 1.0)
        for model in models:
            current = _theory(group, thresholds, model)
            look = {"color": colour, "ls": model.dashes, "lw": 0.9}
            panels[row].plot(thresholds / group.number[0], current, **look)
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
def figure_urn_difference(points: Points, models: Sequence[Model] = ()) -> Figure:
    """Return the relative difference of theory and measured current.

    Above, of the first theory (the paper's) and the second; below, on a scale of its own, of all
    but the first. Values below the upper panel are written at its edge.
    """
    models = models or default(points)
    points.need_only("threshold", "number", "channel1_width")
    count = np.unique(points.number).size
    made = style.figure(style.PAGE if count > 1 else 4.4, 5.6)
    panels = made.subplots(2, count, squeeze=False, sharex=True, sharey="row")
    beyond, unknown = [], 0
    for row, column, group in _groups(points):
        mark, colour = _look(column)
        fraction = group.threshold / group.number
        for at, (model, fill) in enumerate(zip(models, FILLS, strict=False)):
            expected = _theory(group, group.threshold, model)
            difference, error = relative_difference(group.current, group.current_error, expected)
            lines = {"color": colour, "lw": 0.7, "ms": 4.4, "marker": mark, "ls": model.dashes}
            chosen = [axes for axes, shown in zip(panels[:, row], (at < 2, at > 0), strict=True)
                      if shown]  # fmt: skip
            for axes in chosen:
                axes.errorbar(fraction, difference, error, **lines, **fill)
            unknown += int(np.isnan(difference).sum())
            if at == 0:
                low = difference < LOWEST
                beyond += [(panels[0, row], x, y, colour) for x, y
                           in zip(fraction[low], difference[low], strict=True)]  # fmt: skip
        if row == 0:
            label = f"$w = {group.channel1_width[0]:g}$"
            panels[0, 0].plot([], [], mark, color=colour, ms=4.4, label=label)
    for model, fill in zip(models, FILLS, strict=False):
        look = {"color": style.GREY, "lw": 0.7, "ms": 4.4, "marker": "s", "ls": model.dashes}
        panels[0, 0].plot([], [], label=f"theory, {model.label}", **look, **fill)
    for number, column in zip(np.unique(points.number), panels.T, strict=True):
        column[0].set_title(f"$N = {number:.0f}$")
        style.label_fraction(column[1])
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
def figure_urn_scaled(points: Points, models: Sequence[Model] = ()) -> Figure:
    """Return currents and theory divided by N, against T/N, all N in one panel."""
    models = models or default(points)
    points.need_only("threshold", "number", "channel1_width")
    made = style.figure(5.0, 3.7)
    axes = made.subplots()
    groups = _groups(points)
    lines = (":", "--", "-.")
    last = max(row for row, _, _ in groups)
    for row, column, group in groups:
        mark, colour = _look(column)
        number = group.number[0]
        axes.errorbar(
            group.threshold / number,
            group.current / number,
            group.current_error / number,
            fmt=mark,
            color=colour,
            mfc=colour if row == last else "white",
            ms=3.6,
            label=f"$w = {group.channel1_width[0]:g}$, $N = {number:.0f}$",
        )
        thresholds = np.arange(0.0, min(group.threshold.max(), group.number[0]) + 1.0)
        for at, model in enumerate(models):
            current = _theory(group, thresholds, model)
            look = {"ls": lines[row % 3], "lw": 0.9} if at == 0 else {"ls": "-", "lw": 0.5}
            axes.plot(thresholds / number, current / number, color=colour, **look)
    numbers = np.unique(points.number)
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

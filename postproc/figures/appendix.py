"""The appendix's figures: the current of the single urn against eq. (eqapp5), app2 to app4."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from postproc.figures import style
from postproc.reading.points import gather
from postproc.theory.circuit import single_urn_current
from postproc.theory.gates import WINDOW
from postproc.theory.renewal import RENEWAL

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.reading.points import Points
    from postproc.reading.results import Results
    from postproc.theory.gates import Gate

    Floats = NDArray[np.float64]

LEAST = 1e-3  # currents of theory below this (per unit time) are left out of relative differences
PAPER, COUNTED = "paper", "channel counted"
VARIANTS = (  # look, name, (gate, occupation)
    ({"fillstyle": "full"}, PAPER, (WINDOW, False)),
    ({"fillstyle": "none"}, "renewal gate", (RENEWAL, False)),
    ({"fillstyle": "left", "markerfacecoloralt": "white", "ls": ":"}, COUNTED, (RENEWAL, True)),
)
MARKS = {0: ("s", style.BLUE), 1: ("o", style.VERMILION), 2: ("^", style.GREEN)}


def _theory(
    results: Results, group: Points, thresholds: Floats, gate: Gate, occupation: bool = False
) -> Floats:
    """Return the theory's current at other thresholds of a group of one N and w."""
    urn = replace(results.circuit(int(group.point[0]), gate), occupation=occupation)
    return single_urn_current(replace(urn, threshold=thresholds))


def _groups(points: Points) -> list[tuple[int, int, Points]]:
    """Return (which N, which w, points by T) for each pair of values."""
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


def figure_app2(files: Sequence[Results]) -> Figure:
    """Return the stationary current of the single urn against T/N, a panel for each N."""
    points = gather(files)
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
        thresholds = np.arange(0.0, group.threshold.max() + 1.0)
        for gate, dashes in ((WINDOW, "--"), (RENEWAL, "-")):
            current = _theory(files[group.file[0]], group, thresholds, gate)
            panels[row].plot(thresholds / group.number[0], current, color=colour, ls=dashes, lw=0.9)
    _explain(panels[0], (("--", "theory, paper"), ("-", "theory, renewal gate")))
    panels[0].set_ylabel("current (per unit time)")
    panels[0].set_ylim(bottom=0.0)
    made.legend(loc="outside upper center", ncols=5)
    return made


def relative_difference(current: Floats, error: Floats, expected: Floats) -> tuple[Floats, Floats]:
    """Return (theory - measured)/theory and its standard error, NaN where theory is too small."""
    known = np.where(np.abs(expected) > LEAST, expected, np.nan)
    return (known - current) / known, error / np.abs(known)


def figure_app3(files: Sequence[Results]) -> Figure:
    """Return the relative difference of theory and measured current.

    Above, of the paper's theory, as in the paper, and of the renewal gate; below, on a scale of its
    own, of the renewal gate without and with those in the channel counted.
    """
    points = gather(files)
    count = np.unique(points.number).size
    made = style.figure(style.PAGE if count > 1 else 4.4, 5.2)
    panels = made.subplots(2, count, squeeze=False, sharex=True, sharey="row")
    for row, column, group in _groups(points):
        mark, colour = _look(column)
        results, fraction = files[group.file[0]], group.threshold / group.number
        for look, name, theory_of in VARIANTS:
            expected = _theory(results, group, group.threshold, *theory_of)
            difference, error = relative_difference(group.current, group.current_error, expected)
            lines = {"color": colour, "lw": 0.7, "ms": 4.4, "marker": mark, **look}
            label = f"$w = {group.channel1_width[0]:g}$, {name}" if row == 0 else None
            if name != COUNTED:
                panels[0, row].errorbar(fraction, difference, error, **lines)
            if name != PAPER:
                panels[1, row].errorbar(fraction, difference, error, **lines)
            panels[0, row].plot([], [], label=label, **lines)
    for number, column in zip(np.unique(points.number), panels.T, strict=True):
        column[0].set_title(f"$N = {number:.0f}$")
        style.label_fraction(column[1])
    for axes in panels.flat:
        axes.axhline(0.0, color=style.BLACK, lw=0.6)
    low, high = panels[0, 0].get_ylim()
    panels[0, 0].set_ylim(max(low, -1.5), min(high, 1.06))
    made.supylabel("(theory $-$ measured) / theory", fontsize=9)
    made.legend(loc="outside upper center", ncols=3, fontsize=7.5)
    return made


def figure_app4(files: Sequence[Results]) -> Figure:
    """Return currents and theory divided by N, against T/N, all N in one panel."""
    points = gather(files)
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
        thresholds = np.arange(0.0, group.threshold.max() + 1.0)
        for gate, dashes in ((WINDOW, lines[row % 3]), (RENEWAL, "-")):
            current = _theory(files[group.file[0]], group, thresholds, gate)
            width = 0.9 if gate is WINDOW else 0.5
            axes.plot(thresholds / number, current / number, color=colour, ls=dashes, lw=width)
    numbers = np.unique(points.number)
    explained = [
        (lines[at % 3], f"theory, paper, $N = {one:.0f}$") for at, one in enumerate(numbers)
    ]
    _explain(axes, [*explained, ("-", "theory, renewal gate")])
    style.label_fraction(axes)
    axes.set_ylabel("current / $N$ (per unit time)")
    axes.set_ylim(bottom=0.0)
    made.legend(loc="outside upper center", ncols=3, fontsize=7)
    return made

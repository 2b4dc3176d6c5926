"""The paper's figures of circuits against time and against T/N: comp05, comp06, comp01."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from postproc.figures import style
from postproc.figures.currents import binned, draw_currents
from postproc.reading.points import gather
from postproc.reading.results import Results
from postproc.theory.renewal import THEORIES
from postproc.theory.states import stable_state

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from postproc.reading.points import Points

    Drawing = Callable[[Sequence[Results]], Figure]

MARKS = ("o", "s", "^", "D", "v", "P")
TIME_COLOURS = (style.BLUE, style.VERMILION, style.BLACK, style.GREEN, style.PURPLE, style.ORANGE)
MOST = 6  # points in a figure against time
STEPS = 400  # places along the time axis of comp06


def _with_tasks(files: Sequence[Results]) -> Points:
    """Return the points with a complete task, by T, six at most."""
    points = gather(files)
    done = [
        files[file].done[point].any() for file, point in zip(points.file, points.point, strict=True)
    ]
    points = points.where(np.array(done)).sorted_by_threshold()
    return points.where(np.arange(points.number.size) < MOST)


def figure_comp05(files: Sequence[Results]) -> Figure:
    """Return flows and net currents against time, one panel a point, by increasing T."""
    points = _with_tasks(files)
    count = points.number.size
    made = style.figure(max(3.1 * count, 4.6), 3.6)
    panels = made.subplots(1, count, squeeze=False)[0]
    for at, axes in enumerate(panels):
        results, point = files[points.file[at]], int(points.point[at])
        replica = int(np.flatnonzero(results.done[point])[0])
        draw_currents(axes, results.circuit(point), results.series(point, replica), legend=False)
        axes.set_title(f"({chr(97 + at)})  $T = {points.threshold[at]:.0f}$")
    for axes in panels[1:]:
        axes.set_ylabel("")
    handles, labels = panels[0].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside upper center", ncols=7, columnspacing=1.0, fontsize=7)
    return made


def figure_comp06(files: Sequence[Results]) -> Figure:
    """Return chi, and below it the net current through channel 2, against time, a colour a T."""
    points = _with_tasks(files)
    made = style.figure(4.6, 4.8)
    spread, current = made.subplots(2, 1, sharex=True)
    last = 0.0
    for at, colour in zip(range(points.number.size), TIME_COLOURS, strict=False):
        results, point = files[points.file[at]], int(points.point[at])
        last = max(last, _draw_histories(spread, current, results, point, colour))
        state = stable_state(results.circuit(point))
        if state is not None:
            dashes = ":" if at == 0 else "--"
            spread.axhline(state.mass_spread, color=colour, ls=dashes, lw=0.9)
            current.axhline(state.net_current, color=colour, ls=dashes, lw=0.9)
    spread.plot([], [], color=style.GREY, ls="--", lw=0.9, label="theory, stable $\\chi > 0$")
    spread.set_ylabel(r"mass spread $\chi$")
    spread.set_ylim(0.0, 1.02)
    current.set_ylabel("net current, channel 2\n(per unit time)")
    current.axhline(0.0, color=style.GREY, lw=0.5)
    current.set_xlabel("time $t$  (length / $v$)")
    current.set_xlim(0.0, last)
    made.legend(loc="outside upper center", ncols=4, fontsize=7.5)
    return made


def _draw_histories(
    spread: Axes, current: Axes, results: Results, point: int, colour: str
) -> float:
    """Draw one point, its first replica in full and the others faintly; return the last time."""
    circuit, last = results.circuit(point), 0.0
    number = float(circuit.number)
    for replica in np.flatnonzero(results.done[point]):
        series = results.series(point, int(replica))
        chi = np.abs(number - 2.0 * series.urn1_number) / number
        net = series.flows["flow2_12"] - series.flows["flow2_21"]
        first = replica == np.flatnonzero(results.done[point])[0]
        look = {"color": colour, "lw": 1.1 if first else 0.5, "alpha": 1.0 if first else 0.35}
        label = f"$T = {circuit.threshold}$" if first else None
        middle, mean, _ = binned(series.time, chi, STEPS)
        spread.plot(middle, mean, label=label, **look)
        middle, mean, _ = binned(series.time, np.abs(net), STEPS)
        signed = binned(series.time, net, STEPS // 4)
        current.plot(signed[0], np.abs(signed[1]), **look)
        last = max(last, float(series.time[-1]))
    return last


def figure_comp01(files: Sequence[Results]) -> Figure:
    """Return net currents against T/N and against chi, one mark for each w'."""
    points = gather(files)
    made = style.figure(style.PAGE, 3.4)
    left, right = made.subplots(1, 2, sharey=True)
    for at, width in enumerate(np.unique(points.channel2_width)):
        group = points.where(points.channel2_width == width).sorted_by_threshold()
        colour, mark = style.CYCLE[at % len(style.CYCLE)], MARKS[at % len(MARKS)]
        look = {"fmt": mark, "color": colour, "mfc": "none", "elinewidth": 0.7, "ms": 3.8}
        fraction = group.threshold / group.number
        label = f"$w' = {width:.4g}$"
        left.errorbar(fraction, group.current, group.current_error, label=label, **look)
        right.errorbar(group.chi, group.current, group.current_error, group.chi_error, **look)
        for dashes, changes in zip(style.DASHES, THEORIES.values(), strict=True):
            _draw_branch(left, right, files, group, changes, {"color": colour, "ls": dashes})
    for dashes, name in zip(style.DASHES, THEORIES, strict=True):
        left.plot([], [], color=style.GREY, ls=dashes, lw=0.9, label=f"theory, {name}")
    style.label_fraction(left)
    left.set_ylabel("net current (per unit time)")
    right.set_xlabel(r"mass spread $\chi$")
    right.set_xlim(0.0, 1.0)
    left.set_ylim(bottom=min(0.0, left.get_ylim()[0]))
    handles, labels = left.get_legend_handles_labels()  # lines come first
    entries = list(zip(handles, labels, strict=True))
    handles, labels = zip(*entries[len(THEORIES) :], *entries[: len(THEORIES)], strict=True)
    made.legend(handles, labels, loc="outside upper center", ncols=4, fontsize=7.5)
    return made


def _draw_branch(
    left: Axes,
    right: Axes,
    files: Sequence[Results],
    group: Points,
    changes: dict[str, object],
    look: dict[str, str],
) -> None:
    """Draw the theory's stable polarised state through the thresholds of a group."""
    base = replace(files[group.file[0]].circuit(int(group.point[0])), **changes)
    lowest, highest = int(group.threshold.min()), int(group.threshold.max())
    thresholds = np.arange(max(lowest, 1), highest + 1)
    states = [stable_state(replace(base, threshold=int(one))) for one in thresholds]
    spread = np.array([np.nan if state is None else state.mass_spread for state in states])
    current = np.array([np.nan if state is None else state.net_current for state in states])
    left.plot(thresholds / float(base.number), current, lw=0.9, **look)
    right.plot(spread, current, lw=0.9, **look)

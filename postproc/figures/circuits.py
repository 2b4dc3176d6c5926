"""The paper's figures of circuits against time and against T/N: comp05, comp06, comp01."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator

from postproc.cli import InputError
from postproc.figures import style
from postproc.figures.currents import (
    binned,
    draw_currents,
    draw_eta,
    explain_eta,
    settled_number2,
)
from postproc.figures.maps import common_circuit
from postproc.figures.models import default, spread_and_current
from postproc.reading.points import gather
from postproc.reading.results import Results

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from postproc.reading.points import Points
    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Drawing = Callable[[Sequence[Results]], Figure]

MARKS = ("o", "s", "^", "D", "v", "P")
TIME_COLOURS = (style.BLUE, style.VERMILION, style.BLACK, style.GREEN, style.PURPLE, style.ORANGE)
MOST = 6  # points in a figure against time
STEPS = 400  # places along the time axis of comp06
EARLY = 3000.0  # time within which the transient battery at T = 2 decays


def _with_tasks(files: Sequence[Results]) -> Points:
    """Return the points with a complete task, by T, at most `MOST`."""
    points = gather(files)
    done = [
        files[file].done[point].any() for file, point in zip(points.file, points.point, strict=True)
    ]
    points = points.where(np.array(done)).sorted_by_threshold()
    return points.where(np.arange(points.number.size) < MOST)


@style.settings()
def figure_comp05(files: Sequence[Results], models: Sequence[Model] = ()) -> Figure:
    """Return flows and net currents against time, a panel for each point by T, eta below."""
    models = models or default(files)
    points = _with_tasks(files)
    count = points.number.size
    made = style.figure(max(3.1 * count, 4.6), 5.4)
    cells = made.add_gridspec(2, count, height_ratios=(2.0, 1.0))
    for at in range(count):
        results, point = files[points.file[at]], int(points.point[at])
        circuit = results.circuit(point)
        series = results.series(point, int(np.flatnonzero(results.done[point])[0]))
        panels = draw_currents(made, cells[0, at], circuit, series, models)
        balance = made.add_subplot(cells[1, at])
        draw_eta(balance, circuit, models, settled_number2(circuit, series))
        panels[0].set_title(f"({chr(97 + at)})  $T = {points.threshold[at]:.0f}$")
        if at > 0:
            for axes in panels:
                axes.set_ylabel("")
        else:
            balance.set_ylabel(r"$\eta$, what urn 2 gains")
    explain_eta(made.axes[0])
    handles, labels = made.axes[0].get_legend_handles_labels()
    style.legend_above(made, handles, labels, 6, columnspacing=1.0, fontsize=7)
    return made


@style.settings()
def figure_comp06(files: Sequence[Results], models: Sequence[Model] = ()) -> Figure:
    """Return chi, and below it the net current of channel 2, against time, a colour for each T.

    The current is counted from the urn that was full at the start to the other. The beginning is
    shown on the left if the run is much longer.
    """
    models = models or default(files)
    points = _with_tasks(files)
    last = max(float(files[file].value("series/time").max()) for file in np.unique(points.file))
    ends = [last] if last < 3.0 * EARLY else [EARLY, last]
    made = style.figure(style.PAGE if len(ends) > 1 else 4.6, 4.8)
    panels = made.subplots(2, len(ends), squeeze=False, sharex="col", sharey="row")
    for column, end in zip(panels.T, ends, strict=True):
        for at, colour in zip(range(points.number.size), TIME_COLOURS, strict=False):
            results, point = files[points.file[at]], int(points.point[at])
            _draw_histories(column, results, point, colour, end)
            _draw_states(column, models, results.circuit(point), colour)
        column[1].axhline(0.0, color=style.GREY, lw=0.5)
        column[1].set_xlabel("time $t$  (length / $v$)")
        column[1].set_xlim(0.0, end)
        column[1].xaxis.set_major_locator(MaxNLocator(5))
    for model in models:
        label = f"stable $\\chi > 0$, theory, {model.label}"
        panels[0, 0].plot([], [], color=style.GREY, ls=model.dashes, lw=0.9, label=label)
    panels[0, 0].set_ylabel(r"mass spread $\chi$")
    panels[0, 0].set_ylim(0.0, 1.02)
    panels[1, 0].set_ylabel("net current, channel 2\n(per unit time)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    style.legend_above(made, handles, labels, 3, fontsize=7.5)
    return made


def _draw_states(
    panels: Sequence[Axes], models: Sequence[Model], circuit: Circuit, colour: str
) -> None:
    """Draw chi and net current of the stable polarised state of each theory that has one."""
    for model in models:
        state = model.stable_state(circuit)
        if state is not None:
            for axes, level in zip(panels, (state.mass_spread, state.net_current), strict=True):
                axes.axhline(level, color=colour, ls=model.dashes, lw=0.9)


def _draw_histories(
    panels: Sequence[Axes], results: Results, point: int, colour: str, end: float
) -> None:
    """Draw one point up to a time, its first replica in full and the others faintly."""
    circuit = results.circuit(point)
    number = float(circuit.number)
    done = np.flatnonzero(results.done[point])
    for replica in done[::-1]:
        series = results.series(point, int(replica))
        early = series.time <= end
        time, first = series.time[early], series.urn1_number[early]
        net = (series.flows["flow2_12"] - series.flows["flow2_21"])[early]
        if 2.0 * first[0] < number:
            net = -net
        shown = replica == done[0]
        look = {"color": colour, "lw": 1.1 if shown else 0.5, "alpha": 1.0 if shown else 0.35}
        label = f"$T = {circuit.threshold}$" if shown else None
        middle, mean, _ = binned(time, np.abs(number - 2.0 * first) / number, STEPS)
        panels[0].plot(middle, mean, label=label, **look)
        middle, mean, _ = binned(time, net, STEPS // 8)
        panels[1].plot(middle, mean, **look)


@style.settings()
def figure_comp01(files: Sequence[Results], models: Sequence[Model] = ()) -> Figure:
    """Return currents along the polarity against T/N and against chi, one mark for each w'.

    The polarity is the instantaneous one, at all points: next to a transition chi does not decide
    which points are polarised.
    `models` are the theories to draw, those of `models.default` if none are given.
    """
    models = models or default(files)
    points = gather(files)
    common_circuit(files, points)
    if np.unique(points.start).size > 1:
        raise InputError("figure comp01 needs runs of one start")
    made = style.figure(style.PAGE, 3.4)
    left, right = made.subplots(1, 2, sharey=True)
    for at, width in enumerate(np.unique(points.channel2_width)):
        group = points.where(points.channel2_width == width).sorted_by_threshold()
        colour, mark = style.CYCLE[at % len(style.CYCLE)], MARKS[at % len(MARKS)]
        look = {"fmt": mark, "color": colour, "mfc": "none", "elinewidth": 0.7, "ms": 3.8}
        fraction = group.threshold / group.number
        label = f"$w' = {width:.4g}$"
        left.errorbar(fraction, group.along, group.along_error, label=label, **look)
        right.errorbar(group.chi, group.along, group.along_error, group.chi_error, **look)
        for model in models:
            _draw_branch((left, right), files, group, model, colour)
    for model in models:
        look = {"color": style.GREY, "ls": model.dashes, "lw": 0.9}
        left.plot([], [], label=f"theory, {model.label}", **look)
    style.label_fraction(left)
    left.set_ylabel("polarised current (per unit time)")
    right.set_xlabel(r"mass spread $\chi$")
    right.set_xlim(0.0, 1.0)
    left.set_ylim(bottom=min(0.0, left.get_ylim()[0]))
    handles, labels = left.get_legend_handles_labels()  # lines come first
    entries = list(zip(handles, labels, strict=True))
    handles, labels = zip(*entries[len(models) :], *entries[: len(models)], strict=True)
    style.legend_above(made, handles, labels, 4, fontsize=7.5)
    return made


def _draw_branch(
    panels: tuple[Axes, Axes],
    files: Sequence[Results],
    group: Points,
    model: Model,
    colour: str,
) -> None:
    """Draw a theory's stable polarised state through the thresholds of a group."""
    circuit = files[group.file[0]].circuit(int(group.point[0]))
    last = min(int(group.threshold.max()), int(circuit.number))  # as for all above
    thresholds = np.arange(max(int(group.threshold.min()), 1), last + 1)
    spread, current = spread_and_current(model, circuit, thresholds)
    look = {"color": colour, "ls": model.dashes, "lw": 0.9}
    panels[0].plot(thresholds / float(circuit.number), current, **look)
    panels[1].plot(spread, current, **look)

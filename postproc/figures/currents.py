"""Flows and net currents against time, with the theory's values and an inset of eta."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator

from postproc.figures import style
from postproc.reading.results import Results
from postproc.theory.circuit import eta, flow1, flow2, homogeneous_kind, net_current2
from postproc.theory.states import stationary_states

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.reading.results import Series
    from postproc.theory.circuit import Circuit

MARKS = 32  # points of a flow along the axis
BINS = 80  # steps of the lines of the net currents
FLOW_LOOK = {
    "flow1_12": ("o", style.BLUE, "channel 1, urn 1 → 2"),
    "flow1_21": ("s", style.ORANGE, "channel 1, urn 2 → 1"),
    "flow2_12": ("^", style.GREEN, "channel 2, urn 1 → 2"),
    "flow2_21": ("D", style.PURPLE, "channel 2, urn 2 → 1"),
}


def binned(
    time: NDArray[np.float64], values: NDArray[np.float64], bins: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return middle, mean and standard error of at most `bins` runs of equally many entries."""
    pieces = min(bins, time.size)
    starts = np.linspace(0, time.size, pieces + 1).astype(int)
    begin = np.concatenate([[0.0], time])[starts[:-1]]
    middle = 0.5 * (begin + time[starts[1:] - 1])
    parts = [values[one:other] for one, other in itertools.pairwise(starts)]
    mean = np.array([part.mean() for part in parts])
    error = np.array(
        [part.std(ddof=1) / np.sqrt(part.size) if part.size > 1 else 0.0 for part in parts]
    )
    return middle, mean, error


def settled_number2(circuit: Circuit, series: Series) -> float:
    """Return the mean of N2 over the second half of the series."""
    late = series.urn1_number[series.urn1_number.size // 2 :]
    return float(circuit.number) - float(late.mean())


def nearest_stable(circuit: Circuit, number2: float) -> float:
    """Return N2 of the theory's stable state (either sign of N2 - N1) nearest to `number2`."""
    total = float(circuit.number)
    found = [s.urn2_number for s in stationary_states(circuit) if s.kind == "stable"]
    found += [total - other for other in found]
    if homogeneous_kind(circuit) != "unstable":
        found.append(0.5 * total)
    return min(found, key=lambda other: abs(other - number2))


def draw_eta(axes: Axes, circuit: Circuit, number2: float | None = None) -> None:
    """Draw eta of eq. (eq007) against N2/N, its zeros, and a disk at the state that was reached."""
    total = float(circuit.number)
    second = np.linspace(0.0, total, 801)
    axes.axhline(0.0, color=style.GREY, linewidth=0.6)
    axes.plot(second / total, eta(circuit, second), color=style.BLACK, linewidth=1.0)
    zeros = [(s.urn2_number, s.kind) for s in stationary_states(circuit)]
    zeros += [(total - zero, kind) for zero, kind in zeros]
    zeros.append((0.5 * total, homogeneous_kind(circuit)))
    for zero, kind in zeros:
        face = "white" if kind == "unstable" else style.GREY
        axes.plot(zero / total, 0.0, "o", ms=3.2, mfc=face, mec=style.BLACK, mew=0.6)
    if number2 is not None:
        axes.plot(number2 / total, 0.0, "o", ms=5, color=style.VERMILION, zorder=5)
    axes.set_xlabel("$N_2/N$", fontsize=7, labelpad=1)
    axes.set_ylabel(r"$\eta$", fontsize=8, labelpad=0)
    axes.tick_params(labelsize=6.5, pad=2)
    axes.set_xlim(0.0, 1.0)


def draw_currents(axes: Axes, circuit: Circuit, series: Series, legend: bool = True) -> None:
    """Draw one panel: flows (marks), net currents (lines), theory (dashed), inset of eta."""
    for name, (mark, colour, label) in FLOW_LOOK.items():
        middle, mean, error = binned(series.time, series.flows[name], MARKS)
        axes.errorbar(
            middle,
            mean,
            error,
            fmt=mark,
            color=colour,
            mfc="none",
            ms=3.5,
            elinewidth=0.6,
            label=label,
        )
    for number, colour in ((1, style.VERMILION), (2, style.SKY)):
        net = series.flows[f"flow{number}_12"] - series.flows[f"flow{number}_21"]
        middle, mean, _ = binned(series.time, net, BINS)
        sign = np.sign(net[net.size // 2 :].mean()) or 1.0
        axes.plot(middle, sign * mean, color=colour, lw=1.3, label=f"net current, channel {number}")
    reached = settled_number2(circuit, series)
    second = nearest_stable(circuit, reached)
    first = float(circuit.number) - second
    lines = [flow(circuit, n) for flow in (flow1, flow2) for n in (first, second)]
    lines.append(np.abs(net_current2(circuit, second)))
    for at, level in enumerate(lines):
        label = "theory" if at == 0 else None
        axes.axhline(float(level), color=style.BLACK, ls="--", lw=0.8, zorder=0.5, label=label)
    _frame(axes, series)
    inset = axes.inset_axes((0.62, 0.63, 0.36, 0.32))
    draw_eta(inset, circuit, reached)
    if legend:
        axes.figure.legend(loc="outside upper center", ncols=4, handlelength=1.6, fontsize=7)


def _frame(axes: Axes, series: Series) -> None:
    """Leave the right upper part of the panel free for the inset."""
    marks = [binned(series.time, flow, MARKS) for flow in series.flows.values()]
    lines = [
        binned(series.time, np.abs(series.flows[f"{one}_12"] - series.flows[f"{one}_21"]), BINS)
        for one in ("flow1", "flow2")
    ]
    below = series.time[-1] * 0.5  # where the inset begins
    highest = max(mean.max() for _, mean, _ in marks + lines)
    late = max(mean[middle > below].max(initial=0.0) for middle, mean, _ in marks + lines)
    lowest = min(axes.get_ylim()[0], 0.0)
    axes.set_ylim(lowest, max(1.08 * highest, 2.6 * late, 1e-12))
    axes.set_xlim(0.0, series.time[-1])
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.set_xlabel("time $t$  (length / $v$)")
    axes.set_ylabel("particles per unit time")


def figure_currents(results: Results, point: int = 0, replica: int = 0) -> Figure:
    """Return the picture of one task of `results`."""
    circuit, series = results.circuit(point), results.series(point, replica)
    made = style.figure(5.8, 4.2)
    axes = made.add_subplot()
    draw_currents(axes, circuit, series)
    axes.set_title(
        f"$N = {circuit.number}$, $T = {circuit.threshold}$, "
        f"$w = {circuit.channel1_width:g}$, $w' = {circuit.channel2_width:g}$"
    )
    style.note(axes, results.remark)
    return made

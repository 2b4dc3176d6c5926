"""Flows and net currents against time with their values by theories, and eta beside them."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator

from postproc.cli import InputError
from postproc.figures import style
from postproc.theory.states import State

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.container import ErrorbarContainer
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]
    Binned = tuple[Floats, Floats, Floats]
    Parts = tuple[list[Binned], list[Binned], list[dict[str, float]]]

MARKS = 32  # points of a flow along the axis
BINS = 80  # steps of the lines of the net currents
NETS = "net currents"  # of a theory, in a legend
START = 0.05  # share of the time at the start that is ignored for the range of the axis
GAP = 0.4  # smallest empty share of the axis that is left out
FLOW_LOOK = {
    "flow1_12": ("o", style.BLUE, "channel 1, urn 1 → 2"),
    "flow1_21": ("s", style.ORANGE, "channel 1, urn 2 → 1"),
    "flow2_12": ("^", style.GREEN, "channel 2, urn 1 → 2"),
    "flow2_21": ("D", style.PURPLE, "channel 2, urn 2 → 1"),
}
# Round the circuit, so that both agree in a stationary state: that of channel 2 is -`current2`.
NET_LOOK = {
    "current1": (style.VERMILION, "net current, channel 1, urn 1 → 2"),
    "current2": (style.SKY, "net current, channel 2, urn 2 → 1"),
}


def binned(time: Floats, values: Floats, bins: int) -> Binned:
    """Return means of time and values, and standard errors of the latter, of at most `bins` bins.

    Bins have equally many entries. A flow, which is the mean over an interval, has its middle.
    """
    pieces = min(bins, time.size)
    starts = np.linspace(0, time.size, pieces + 1).astype(int)
    places, parts = ([one[first:last] for first, last in itertools.pairwise(starts)]
                     for one in (time, values))  # fmt: skip
    middle, mean = (np.array([part.mean() for part in one]) for one in (places, parts))
    error = np.array(
        [part.std(ddof=1) / np.sqrt(part.size) if part.size > 1 else 0.0 for part in parts]
    )
    return middle, mean, error


def settled_number2(circuit: Circuit, series: xr.Dataset) -> float:
    """Return the mean of N2 over the second half of the series."""
    late = series["urn1_number"][series.sizes["time"] // 2 :]
    return float(circuit.number) - float(late.mean())


def draw_eta(
    axes: Axes, circuit: Circuit, models: Sequence[Model], number2: float | None = None
) -> list[Line2D]:
    """Draw eta against N2/N, its zeros, and a disc at the state of the run.

    Return the line of each theory.
    """
    total = float(circuit.number)
    second = np.linspace(0.0, total, 801)
    axes.axhline(0.0, color=style.GREY, linewidth=0.6)
    lines = []
    for model in models:
        look = {"color": style.ink(), "ls": model.dashes, "lw": 1.0}
        lines += axes.plot(second / total, model.eta(circuit, second), label=model.label, **look)
        for zero, kind in model.zeros(circuit):
            face = axes.get_facecolor() if kind == "unstable" else style.GREY
            axes.plot(zero / total, 0.0, "o", ms=3.2, mfc=face, mec=style.ink(), mew=0.6, zorder=4)
    if number2 is not None:
        axes.plot(number2 / total, 0.0, "o", ms=5.5, mfc="none", mec=style.VERMILION, zorder=5)
    axes.set(xlabel="$N_2/N$", ylabel="$\\eta$ (per unit time)")
    axes.set_xlim(0.0, 1.0)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    return lines


def explain_eta(axes: Axes) -> None:
    """Add eta, which is below, and the discs on it to the legend of flows."""
    for line in axes.lines:
        if (label := str(line.get_label())).endswith(NETS):
            line.set_label(f"{label}, and $\\eta$ below")
    look = {"ls": "none", "marker": "o", "mec": style.BLACK, "mew": 0.6, "ms": 3.2}
    axes.plot([], [], mfc=style.GREY, label="stable", **look)
    axes.plot([], [], mfc="white", label="unstable", **look)
    look.update(mec=style.VERMILION, ms=5.5, mew=1.0)
    axes.plot([], [], mfc="none", label="reached", **look)


def draw_flows(
    axes: Axes, circuit: Circuit, series: xr.Dataset, models: Sequence[Model], start2: float
) -> list[ErrorbarContainer]:
    """Draw flows (marks), net currents (lines), and both by theories, into one panel."""
    end = float(series["time"][-1])
    return _draw(axes, models, _parts(circuit, series, models, start2), end)


def _parts(circuit: Circuit, series: xr.Dataset, models: Sequence[Model], start2: float) -> Parts:
    """Return flows and net currents, `binned`, and those of theories, by name.

    A theory's are those of the state that it reaches from the start, of the final polarity. Raises
    `InputError` for theories of the single urn.
    """
    if models and circuit.shape != "circuit":
        raise InputError("flows of theories are those of the circuit, not of the single urn")
    reached, number = settled_number2(circuit, series), float(circuit.number)
    levels = []
    for model in models:
        # with no stable state nothing flows
        state = model.reached(circuit, start2) or State(0.5 * number, "neutral", 0.0, 0.0)
        opposite = (state.urn2_number > 0.5 * number) != (reached > 0.5 * number)
        found = model.levels(circuit, state, mirrored=circuit.alike and opposite)
        levels.append(found | {"current2": -found["current2"]})
    time, flows = series["middle"].values, {name: series[name].values for name in FLOW_LOOK}
    ways = (("flow1_12", "flow1_21"), ("flow2_21", "flow2_12"))
    nets = [binned(time, flows[ahead] - flows[back], BINS) for ahead, back in ways]
    return [binned(time, flows[name], MARKS) for name in FLOW_LOOK], nets, levels


def draw_currents(
    made: Figure, cell: SubplotSpec, circuit: Circuit, series: xr.Dataset, models: Sequence[Model],
    start2: float,
) -> list[Axes]:  # fmt: skip
    """Draw flows (marks), net currents (lines), and both by theories; return the panels.

    A theory's flow has the colour of the corresponding marks, its net currents are black. The axis
    is broken if a large part of it is empty, so there are one or two panels, the upper one first.
    """
    flows, nets, levels = found = _parts(circuit, series, models, start2)
    end = float(series["time"][-1])
    early = START * end
    settled = [mean[middle > early] for middle, mean, _ in [*flows, *nets]]
    ranges = _ranges(np.concatenate([*settled, *(list(one.values()) for one in levels)]))
    parts = cell.subgridspec(len(ranges), 1, hspace=0.0)
    panels = [made.add_subplot(part) for part in parts]
    for axes, limits in zip(panels, ranges[::-1], strict=True):
        _draw(axes, models, found, end)
        axes.set(ylim=limits, xlabel="", ylabel="")
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(5))
    panels[-1].set_xlabel("time $t$  (length / $v$)")
    panels[-1].set_ylabel("flow (per unit time)", y=0.5 if len(panels) == 1 else 1.0)
    if len(panels) > 1:
        made.align_ylabels(panels)  # the one label of both is left of the numbers of both
        _break(*panels)
    return panels


def _ranges(values: Floats) -> list[tuple[float, float]]:
    """Return the parts of the axis to draw, the lower first: two if there is a wide gap."""
    ordered = np.unique(values)
    low, high = float(ordered[0]), float(ordered[-1])
    gaps = np.diff(ordered)
    if gaps.size == 0 or gaps.max() < GAP * (high - low):
        parts = [(low, high)]
    else:
        at = int(gaps.argmax())
        parts = [(low, float(ordered[at])), (float(ordered[at + 1]), high)]
    widest = max(*(end - begin for begin, end in parts), 0.02 * abs(high), 1e-12)
    margins = [max(0.15 * (end - begin), 0.05 * widest) for begin, end in parts]
    return [(begin - more, end + more) for (begin, end), more in zip(parts, margins, strict=True)]


def _draw(
    axes: Axes, models: Sequence[Model], found: Parts, end: float
) -> list[ErrorbarContainer]:  # fmt: skip
    """Draw what `_parts` has found into one panel, up to a time; return the flows."""
    drawn, (flows, nets, levels) = [], found
    for (mark, colour, label), (middle, mean, error) in zip(FLOW_LOOK.values(), flows, strict=True):
        look = {"fmt": mark, "color": colour, "mfc": "none", "ms": 3.5, "elinewidth": 0.6}
        drawn.append(axes.errorbar(middle, mean, error, label=label, **look))
    for (colour, label), (middle, mean, _) in zip(NET_LOOK.values(), nets, strict=True):
        axes.plot(middle, mean, color=colour, lw=1.1, label=label)
    for model, values in zip(models, levels, strict=True):
        look = {"ls": model.dashes, "lw": 1.0}
        for name, level in values.items():
            colour = FLOW_LOOK[name][1] if name in FLOW_LOOK else style.ink()
            axes.axhline(level, color=colour, zorder=0.5, **look)
        flows_of = f"{model.label}: flows, coloured as their marks"
        axes.plot([], [], color=style.GREY, label=flows_of, **look)
        axes.plot([], [], color=style.ink(), label=f"{model.label}: {NETS}", **look)
    axes.set(ylabel="flow (per unit time)", xlabel="time $t$  (length / $v$)")
    axes.set_xlim(0.0, max(end, axes.dataLim.x1))  # there may be another run
    return drawn


def _break(upper: Axes, lower: Axes) -> None:
    """Mark the break of the axis between the panels."""
    upper.tick_params(labelbottom=False, bottom=False)
    lower.tick_params(top=False)
    upper.spines["bottom"].set_visible(False)
    lower.spines["top"].set_visible(False)
    look = {"marker": [(-1.0, -0.5), (1.0, 0.5)], "ms": 8, "ls": "none", "color": style.BLACK}
    for axes, height in ((upper, 0.0), (lower, 1.0)):
        axes.plot([0, 1], [height] * 2, transform=axes.transAxes, clip_on=False, mew=0.8, **look)

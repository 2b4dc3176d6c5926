"""Lifetimes of the homogeneous and the polarised state against N, by runs and by the chain.

The homogeneous state lasts from chi = 0 until chi first reaches `HIGH`, the polarised one from chi
= 1 until chi first falls to `LOW`: both are far beyond the barrier, so that a passage is not a
short recrossing. The chain's times are those of the same passages, which are defined even if a
theory has no such state, only a region of slow drift.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import stats

from postproc.cli import InputError
from postproc.figures import style
from postproc.figures.maps import WIDTH, equals
from postproc.reading.groups import each_series
from postproc.reading.points import alike, files_of, need_only
from postproc.theory.circuit import PAPERS_AGE
from postproc.theory.models import defaults

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.container import ErrorbarContainer
    from matplotlib.figure import Figure

    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

LOW, HIGH = 0.2, 0.7  # chi at which the polarised, the homogeneous state has been left
BOUND = 3.0  # without a passage the lifetime exceeds a third of the time, at 95 %
CONFIDENCE = 0.6827  # of the intervals drawn
MOST = 6  # panels
PANEL = ("threshold", "channel1_length", WIDTH)  # what is one in a panel
DRAWN = (3e2, 1e10)  # range of lifetimes in the figure, length/v


@dataclass(frozen=True)
class Lifetime:
    """A lifetime measured at one point.

    Attributes
    ----------
    circuit : the point's circuit, with the paper's gate.
    polarised : whether the runs began polarised.
    passages, replicas : number of runs that left the state, and of all runs.
    time : total time before passages over their number (for exponential lifetimes the most likely
        mean, with runs that end before they pass); without a passage a lower bound at 95 %.
    low, high : its confidence interval at 68 %, NaN without a passage. If all runs passed, from
        their scatter; else that of a Poisson number of passages in the total time.
    """

    circuit: Circuit
    polarised: bool
    passages: int
    replicas: int
    time: float
    low: float
    high: float

    @property
    def number(self) -> float:
        """N."""
        return float(self.circuit.number)

    def of_chain(self, model: Model) -> float:
        """Return the time of the same passage by the chain of a theory."""
        return model.passage_times(self.circuit, LOW, HIGH)[int(self.polarised)]


def estimate(times: Sequence[float], passed: Sequence[bool]) -> tuple[float, float, float]:
    """Return mean lifetime and the ends of its interval (`Lifetime`) of runs, some not yet passed.

    Runs without a passage contribute their duration, as censored lifetimes: without them the mean
    would be too short.
    """
    total, count = float(np.sum(times)), int(np.count_nonzero(passed))
    if count == 0:
        return total / BOUND, math.nan, math.nan
    mean = total / count
    if count == len(times) > 1:
        error = float(np.std(times, ddof=1)) / math.sqrt(count)
        return mean, mean - error, mean + error
    most = stats.chi2.ppf(0.5 + 0.5 * CONFIDENCE, 2 * count + 2)
    least = stats.chi2.ppf(0.5 - 0.5 * CONFIDENCE, 2 * count)
    return mean, 2.0 * total / float(most), 2.0 * total / float(least)


def first_passage(series: xr.Dataset, barrier: float, below: bool) -> tuple[float, bool]:
    """Return when chi first falls to `barrier` (or reaches it) in a series, and whether it does.

    Without a passage: how long the series lasts, which bounds the lifetime from below.
    """
    chi, time = series["chi"].values, series["time"].values
    passed = np.flatnonzero(chi <= barrier if below else chi >= barrier)
    if passed.size == 0:
        return float(time[-1]), False
    return float(time[passed[0]]), True


def measured(points: xr.Dataset) -> list[Lifetime]:
    """Return the lifetimes at all points, by the first passages of their replicas.

    Runs of one circuit and one kind of start are combined.
    """
    need_only(points, "threshold", "number", "channel1_length", "channel2_width", "start")
    passages: dict[tuple[Circuit, bool], list[tuple[float, bool]]] = {}
    circuits, starts = alike(points), points["start"].values
    if between := [one for one in starts if LOW < one < HIGH]:
        raise InputError(f"runs that begin at chi = {between[0]:.3g} are in neither state: choose, "
                         "--select urn1_fraction=... or data.sel(urn1_fraction=...)")  # fmt: skip
    circuits = [replace(one, age=PAPERS_AGE) for one in circuits]  # no lifetime depends on it
    for at, series in each_series(points):
        circuit, polarised = circuits[at], bool(starts[at] >= HIGH)
        passage = first_passage(series, LOW if polarised else HIGH, polarised)
        passages.setdefault((circuit, polarised), []).append(passage)
    if not passages:
        raise InputError(f"{files_of(points)}: the series of all points are empty")
    lifetimes = []
    for (circuit, polarised), found in passages.items():
        times, passed = zip(*found, strict=True)
        count, estimated = int(np.count_nonzero(passed)), estimate(times, passed)
        lifetimes.append(Lifetime(circuit, polarised, count, len(times), *estimated))
    return lifetimes


def listed(found: Sequence[Lifetime], models: Sequence[Model]) -> str:
    """Return the lifetimes and those of the chains as text, a line for each point."""
    rows = [{
        "T": one.circuit.threshold, "l": f"{one.circuit.channel1_length:g}",
        "w'": f"{one.circuit.channel2_width:g}", "N": one.circuit.number,
        "from": "polarised" if one.polarised else "homogeneous",
        "left": f"{one.passages}/{one.replicas}", "lifetime": _short(one.time),
        "68 %": f"{_short(one.low)} to {_short(one.high)}" if one.passages else "at least (95 %)",
        **{model.label: _short(one.of_chain(model)) for model in models},
    } for one in found]  # fmt: skip
    return pd.DataFrame(rows).to_string(index=False)


def _short(time: float) -> str:
    """Return a time to three digits, below a million without exponent."""
    return f"{float(f'{time:.3g}'):.6g}"


@style.settings()
def figure_lifetimes(points: xr.Dataset, models: Sequence[Model] = ()) -> Figure:
    """Return lifetimes against N, a panel for each T, l and w': marks measured, lines chains."""
    found = measured(points)
    models = models or defaults(points["circuit"].values)
    panels: dict[tuple[float, ...], list[Lifetime]] = {}
    for one in found:
        key = tuple(float(getattr(one.circuit, name)) for name in PANEL)
        panels.setdefault(key, []).append(one)
    if len(panels) > MOST:
        raise InputError(
            f"this figure has at most {MOST} panels, of one T, l and w' each, here are "
            f"{len(panels)}: choose, --select KEY=VALUE ... or data.sel(KEY=VALUE)"
        )
    print(listed(found, models))
    several = len({key[2] for key in panels}) > 1
    made = style.figure(max(2.6 * len(panels), 4.6), 3.7)
    axes = made.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    lowest, highest = DRAWN
    for one, (key, group) in zip(axes, sorted(panels.items()), strict=True):
        draw_lifetimes(one, group, models)
        lowest, highest = min(lowest, one.get_ylim()[0]), max(highest, one.get_ylim()[1])
        among = zip(PANEL, key, zip(*panels, strict=True), strict=True)
        one.set_title(", ".join([equals(*values) for values in among][: 3 if several else 2]))
        one.label_outer()
    axes[0].set_ylim(lowest, highest)
    style.legend_above(made, *axes[0].get_legend_handles_labels(), 3)
    return made


def draw_lifetimes(
    axes: Axes, group: Sequence[Lifetime], models: Sequence[Model]
) -> list[ErrorbarContainer]:
    """Draw lifetimes of one T, l and w' against N; return what was measured."""
    drawn, group = [], sorted(group, key=lambda one: one.number)
    least = min(min(one.time, one.low) if one.passages else one.time for one in group)
    most = max(max(one.time, one.high) if one.passages else one.time for one in group)
    lowest, highest = min(DRAWN[0], 0.5 * least) or DRAWN[0], max(DRAWN[1], 2.0 * most)
    states = ((False, "s", style.BLUE, "homogeneous"), (True, "o", style.VERMILION, "polarised"))
    for row, (polarised, mark, colour, name) in enumerate(states):
        part = [one for one in group if one.polarised == polarised]
        of_chains = part or [replace(one, polarised=polarised) for one in group]
        beyond = _draw_chains(axes, of_chains, models, colour, highest)
        said = [] if part else ["no runs"]
        if beyond:
            which = "chains" if len(beyond) == len(models) else ", ".join(beyond)
            said.append(f"{which} above $10^{{{math.log10(highest):.0f}}}$")
        if said:
            axes.text(0.03, 0.97 - 0.06 * row, f"{name}: {', '.join(said)}", va="top",
                      transform=axes.transAxes, color=colour, fontsize=6,
                      bbox={"fc": "w", "ec": "none", "pad": 1.0})  # fmt: skip
        if not part:
            continue
        left = [one for one in part if one.passages]
        stayed = [one for one in part if not one.passages]
        drawn.append(axes.errorbar(
            [one.number for one in left],
            [one.time for one in left],
            np.abs([[one.time - one.low, one.high - one.time] for one in left]).reshape(-1, 2).T,
            fmt=mark,
            color=colour,
            zorder=3,
        ))  # fmt: skip
        axes.plot(
            [one.number for one in stayed], [one.time for one in stayed], "^", color=colour, mfc="w"
        )
    axes.set(xlabel="$N$", yscale="log", ylabel="lifetime  (length / $v$)")
    axes.set_ylim(lowest, highest)
    style.ticks_at(axes, (one.number for one in group))
    _explain(axes, models)
    return drawn


def _draw_chains(
    axes: Axes, part: Sequence[Lifetime], models: Sequence[Model], colour: str, highest: float
) -> list[str]:
    """Draw the chains of a state, of one N from edge to edge; return which are above the axis."""
    beyond = []
    for model in models:
        times = {one.number: one.of_chain(model) for one in part}
        look = {"color": colour, "ls": model.dashes, "lw": 0.9}
        if len(times) > 1:
            axes.plot([*times], [*times.values()], **look)
        else:
            axes.axhline(*times.values(), **look)
        if all(one > highest for one in times.values()):
            beyond.append(model.label)
    return beyond


def _explain(axes: Axes, models: Sequence[Model]) -> None:
    axes.plot([], [], "s", color=style.BLUE, label="homogeneous, measured")
    axes.plot([], [], "o", color=style.VERMILION, label="polarised, measured")
    axes.plot([], [], "^", color=style.GREY, mfc="w", label="lower bound (95 %)")
    for one in models:
        axes.plot([], [], color=style.GREY, ls=one.dashes, lw=0.9, label=f"chain, {one.label}")

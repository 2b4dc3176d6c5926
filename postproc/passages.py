"""Lifetimes of the homogeneous and the polarised state against N: measured, and of the chain."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from postproc import style
from postproc.gates import WINDOW
from postproc.lifetimes import first_passage, lifetimes
from postproc.points import gather
from postproc.renewal import RENEWAL

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from postproc.results import Results

MIDDLE = 0.5  # chi that parts the states where theory has no unstable state
LONGEST = 1e15  # longest time that is drawn, length/v


@dataclass(frozen=True)
class Lifetime:
    """A lifetime measured at one point.

    Attributes
    ----------
    number, threshold : N and T.
    polarised : whether the runs began polarised.
    time, error : total time before passages over their number, and its standard error; without a
        passage the total time, a lower bound, and NaN.
    """

    number: float
    threshold: float
    polarised: bool
    time: float
    error: float


def measured(files: Sequence[Results]) -> list[Lifetime]:
    """Return the lifetimes at all points, by the first passages of their replicas."""
    points, found = gather(files), []
    for at in range(points.number.size):
        results, point = files[points.file[at]], int(points.point[at])
        circuit, polarised = results.circuit(point), bool(points.start[at] > MIDDLE)
        barrier = lifetimes(circuit).barrier
        barrier = MIDDLE if math.isnan(barrier) else barrier
        passages = [
            first_passage(
                results.series(point, int(replica)), int(points.number[at]), barrier, polarised
            )
            for replica in np.flatnonzero(results.done[point])
        ]
        if not passages:
            continue
        total, count = sum(time for time, _ in passages), sum(done for _, done in passages)
        time = total / max(count, 1)
        error = time / math.sqrt(count) if count else math.nan
        found.append(Lifetime(points.number[at], points.threshold[at], polarised, time, error))
    return found


def figure_lifetimes(files: Sequence[Results]) -> Figure:
    """Return lifetimes against N: marks measured (open arrows: lower bounds), lines the chain."""
    found = measured(files)
    made = style.figure(4.6, 3.6)
    axes = made.subplots()
    for polarised, mark, colour, name in (
        (True, "o", style.VERMILION, "polarised"),
        (False, "s", style.BLUE, "homogeneous"),
    ):
        group = sorted((one for one in found if one.polarised == polarised), key=_by_number)
        if not group:
            continue
        left = [one for one in group if not math.isnan(one.error)]
        stayed = [one for one in group if math.isnan(one.error)]
        axes.errorbar(
            [one.number for one in left],
            [one.time for one in left],
            [one.error for one in left],
            fmt=mark,
            color=colour,
            label=f"{name}, measured",
        )
        axes.plot(
            [one.number for one in stayed], [one.time for one in stayed], "^", color=colour, mfc="w"
        )
        _draw_chain(axes, files, group, colour)
    axes.plot([], [], "^", color=style.GREY, mfc="w", label="lower bound")
    for dashes, label in (("--", "chain, paper's gate"), ("-", "chain, renewal gate")):
        axes.plot([], [], color=style.GREY, ls=dashes, label=label)
    axes.set_yscale("log")
    axes.set_xlabel("$N$")
    axes.set_ylabel("lifetime  (length / $v$)")
    made.legend(loc="outside upper center", ncols=2)
    return made


def _by_number(one: Lifetime) -> float:
    return one.number


def _draw_chain(
    axes: Axes, files: Sequence[Results], group: Sequence[Lifetime], colour: str
) -> None:
    base = files[0].circuit(0)
    for gate, dashes in ((WINDOW, "--"), (RENEWAL, "-")):
        times = []
        for one in group:
            own = replace(base, number=int(one.number), threshold=int(one.threshold), gate=gate)
            chain = lifetimes(own)
            times.append(chain.polarised if one.polarised else chain.homogeneous)
        shown = np.array(times)
        shown[~(shown < LONGEST) | (shown <= 0.0)] = np.nan
        axes.plot([one.number for one in group], shown, color=colour, ls=dashes, lw=0.9)

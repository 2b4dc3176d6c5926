"""Two pasts of one present: with gates, different regions of phase space are mapped to one.

Between events particles move freely, and a gate that fires reverses u_x of those that it counts. So
where the order of events does not change, the map from a state to that a time later is smooth and
conserves volume, |det| = 1. But two disjoint regions can have the same image: the map is two to one
there, and cannot be inverted by any rule.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from postproc.figures import style
from studies.common.text import number
from studies.gated_reversal.examples import example, flown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from studies.common import study

    Floats = NDArray[np.float64]

# x y ux uy; either 3 comes through and 1, 2 are reversed, or 1 comes through and 2, 3 are
PASTS = (
    ((1.6, 0.05, -1.0, 0.0), (1.8, -0.05, -1.0, 0.0), (-0.6, 0.0, 1.0, 0.0)),
    ((-1.0, 0.05, 1.0, 0.0), (1.4, -0.05, -1.0, 0.0), (1.6, 0.0, -1.0, 0.0)),
)
TURNED = ((0, 1), (1, 2))  # particles reversed in each past; the last of them makes the gate fire
PAST_TIME = 1.6
GATE_CHORD = 0.5  # x of the chord of gate 2
NEARBY = 0.01  # distance of nearby starts, in every coordinate
STEP = 1e-6  # of differences, in every coordinate
COLOURS = (style.BLUE, style.VERMILION, style.GREEN)


def present(start: Floats, past: int) -> Floats:
    """Return the state at `PAST_TIME` of a start near one of `PASTS`, computed by hand.

    Those in `TURNED` are reversed when the last of them is at the chord.
    """
    end = start.copy()
    end[:, :2] += PAST_TIME * start[:, 2:]
    mine = list(TURNED[past])
    last = start[mine[-1]]
    fired = (GATE_CHORD - last[0]) / last[2]
    end[mine, 0] = start[mine, 0] + (2.0 * fired - PAST_TIME) * start[mine, 2]
    end[mine, 2] = -start[mine, 2]
    return end


def other_past(end: Floats) -> Floats:
    """Return the start of the other past of an end of the first of `PASTS`, or of one near it.

    1 has moved straight all the time; 2 and 3 were reversed when 3 was at the chord of gate 2.
    """
    x, y, ux, uy = end.T
    turned = PAST_TIME - (x[2] - GATE_CHORD) / ux[2]
    start = np.column_stack([x - PAST_TIME * ux, y - PAST_TIME * uy, ux, uy])
    at_turn = x[1:] - (PAST_TIME - turned) * ux[1:]
    start[1:, 0] = at_turn + turned * ux[1:]
    start[1:, 2] = -ux[1:]
    return start


def volume_ratio(past: int) -> float:
    """Return |det| of the map from a past to the present, by differences of all 12 coordinates."""
    start = np.array(PASTS[past])
    columns = []
    for at in range(start.size):
        step = np.zeros(start.size)
        step[at] = STEP
        ahead, back = (
            present(start + sign * step.reshape(start.shape), past).ravel() for sign in (1.0, -1.0)
        )
        columns.append((ahead - back) / (2.0 * STEP))
    return float(abs(np.linalg.det(np.array(columns))))


def nearby(work: study.Study, tries: int) -> dict[str, object]:
    """Return the distances of the final states of starts near one past and of their other pasts."""
    random, worst, apart = np.random.default_rng(6), 0.0, 0.0
    for at in range(tries):
        start = np.array(PASTS[0]) + random.uniform(-NEARBY, NEARBY, (3, 4))
        one = np.column_stack(flown(work, f"nearby_{at}_one", start.T, PAST_TIME)[1])
        past = other_past(one).T
        other = np.column_stack(flown(work, f"nearby_{at}_other", past, PAST_TIME)[1])
        worst = max(worst, float(np.abs(one - other).max()))
        speed = np.hypot(*start[:, 2:].T)[:, None]  # particles of the program have the speed 1
        by_hand = present(np.column_stack([start[:, :2], start[:, 2:] / speed]), 0)
        apart = max(apart, float(np.abs(one - by_hand).max()))
    return {"tries": tries, "within": NEARBY, "differ_by": worst, "by_hand_differ_by": apart}


def _draw(axes: Axes, past: int) -> None:
    """Draw x against time of one past."""
    start = np.array(PASTS[past])
    mine = list(TURNED[past])
    last = start[mine[-1]]
    fired = (GATE_CHORD - last[0]) / last[2]
    axes.axhspan(0.0, GATE_CHORD, color=style.GREY, alpha=0.22, lw=0.0)
    axes.axhspan(-GATE_CHORD, 0.0, color=style.GREY, alpha=0.1, lw=0.0)
    axes.plot([0.0, fired], [GATE_CHORD] * 2, color="none")
    end = present(start, past)
    for particle, colour in enumerate(COLOURS):
        times = [0.0, fired, PAST_TIME] if particle in mine else [0.0, PAST_TIME]
        places = [start[particle, 0], *([start[particle, 0] + fired * start[particle, 2]]
                  if particle in mine else []), end[particle, 0]]  # fmt: skip
        axes.plot(times, places, "-", color=colour, lw=1.4)
        axes.plot([0.0], [places[0]], "o", color=colour, ms=4)
        axes.annotate(
            "", (PAST_TIME + 0.22, places[-1] + 0.22), (PAST_TIME, places[-1]),
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.2, "shrinkA": 0},
        )  # fmt: skip
        axes.plot([PAST_TIME], [places[-1]], "o", color=colour, ms=5)
        axes.text(-0.06, places[0], str(particle + 1), color=colour, ha="right", va="center")
    axes.axvline(fired, color=style.BLACK, ls=":", lw=0.8)
    axes.text(fired - 0.02, -1.0, "gate 2\nturns two", ha="right", va="center", fontsize=7)
    axes.axvline(PAST_TIME, color=style.BLACK, lw=0.8)
    axes.set_xlim(-0.2, PAST_TIME + 0.3)
    axes.set_xlabel("time $t$")


def figure_pasts() -> Figure:
    """Return both pasts, x along the channel against time: they end in the same state."""
    made = style.figure(style.PAGE, 3.4)
    panels = made.subplots(1, 2, sharey=True)
    for past, axes in enumerate(panels):
        _draw(axes, past)
    panels[0].set_title("(a)  3 comes through, 1 and 2 are turned back")
    panels[1].set_title("(b)  1 comes through, 2 and 3 are turned back")
    panels[0].set_ylabel("$x$ along channel 1")
    for height, name in ((0.25, "gate 2"), (-0.25, "gate 1")):
        panels[0].text(0.02, height, name, fontsize=7, va="center", color="#555555")
    panels[1].text(PAST_TIME - 0.04, 1.85, "one present", fontsize=8, ha="right", va="center")
    return made


def table(work: study.Study, one: dict, other: dict) -> None:
    """Write the events of two histories side by side."""
    times = sorted({round(time, 6) for past in (one, other) for time, _ in past["forth"]})
    work.table("pasts", ["t", "one past", "the other"], [
        [number(time), *(
            ", ".join(text for at, text in past["forth"] if round(at, 6) == time)
            for past in (one, other)
        )]
        for time in times
    ])  # fmt: skip


def run(work: study.Study) -> None:
    """Run both pasts, and others nearby; draw `two_pasts`, store the numbers."""
    histories = {
        f"past{at}": example(work, f"example_past{at}", past, PAST_TIME)
        for at, past in enumerate(PASTS, 1)
    }
    one, other = (np.array(past["forth_end"]) for past in histories.values())
    numbers = {
        **histories,
        "differ_by": float(np.abs(one - other).max()),
        "nearby": nearby(work, int(work.pick(5, 50))),
        "volume_ratios": [volume_ratio(past) for past in (0, 1)],
    }
    work.keep("pasts", numbers)
    table(work, histories["past1"], histories["past2"])
    work.draw(figure_pasts(), "two_pasts")

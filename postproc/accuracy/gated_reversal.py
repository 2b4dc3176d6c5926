"""Time reversal with gates: what becomes of their reversals when all velocities are turned.

A reversal turns T + 1 particles that head for the other gate. Run backwards, it is undone if those
T + 1, and nobody else, come back to the gate. But others may be on their way out of it: turned by
an earlier reversal, or come through from the other gate. Backwards they are entrants like all, the
gate counts them too, and it fires too early. So a single reversal is undone exactly if nobody else
heads out of its gate at that moment; and the first instant, going back, when more than T head out
together is where the two histories part.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from postproc.accuracy.events import (
    CROSSING1,
    CROSSING2,
    ENTRY,
    REVERSAL,
    Log,
    outward_stays,
    read_log,
    stories,
)
from postproc.figures import style
from postproc.reading.results import Results
from postproc.theory.circuit import Circuit
from postproc.theory.states import stable_spread

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from postproc.study.study import Groups, Study

    Floats = NDArray[np.float64]

CLOSE = 1e-6  # two events that mirror each other are closer in time than this
SCAN = ((2, 1), (10, 1), (100, 1), (1000, 1), (1000, 2), (1000, 4), (1000, 7), (1000, 10),
        (1000, 14), (1000, 18), (1000, 22))  # (N, T)  # fmt: skip
# N, T, for how long runs backwards are followed
TURNED = ((100, 1, 12.0), (1000, 2, 12.0), (1000, 7, 12.0), (1000, 18, 12.0))
BINS = np.array([0.0, 0.03, 0.08, 0.17, 0.33, 0.5, 0.75, 1.0])  # of the time back, as a share
SURE = 0.95  # of bounds
BLOCKS = 20  # of time, from which the errors of the scan are taken
APART = 60.0  # time between two turnings

# x y ux uy; all fly along the channel, so that every event can be worked out in the head
FROM_URN2 = ((0.7, 0.05, -1.0, 0.0), (0.8, -0.05, -1.0, 0.0))
PASSER = (-0.1, 0.0, 1.0, 0.0)
EXAMPLE_TIME = 0.8


@dataclass(frozen=True)
class Reversals:
    """What can be said of the reversals in one log.

    Attributes
    ----------
    time, gate, size : of each, shape (reversal,).
    alone : whether nobody else headed out of the gate then.
    parting : where a run backwards from the end leaves the history, going back.
    """

    time: Floats
    gate: NDArray[np.int64]
    size: NDArray[np.int64]
    alone: NDArray[np.bool_]
    parting: float


def reversals_of(log: Log, threshold: int, end: float = math.inf) -> Reversals:
    """Return the reversals before `end`, and what a run backwards from there must do to them."""
    known = log.time < end
    log = Log(*(getattr(log, field.name)[known] for field in fields(log)))
    gate, start, stop = outward_stays(stories(log))
    fired = np.flatnonzero(log.kind == REVERSAL)
    time, where = log.time[fired], log.where[fired]
    alone, parting = np.ones(fired.size, bool), -math.inf
    for one in (1, 2):
        mine = gate == one
        begins, ends = np.sort(start[mine]), np.sort(stop[mine])
        here = where == one
        came, left = (np.searchsorted(x, time[here], "left") for x in (begins, ends))
        alone[here] = came == left  # who made it reverse is out at once
        # who heads out when one of them leaves, that one too
        together = np.searchsorted(begins, ends, "left") - np.arange(ends.size)
        early = ends[(together > threshold) & (ends < end)]
        crowded = time[here][~alone[here]]
        parting = max(parting, *(float(one.max(initial=-math.inf)) for one in (early, crowded)))
    return Reversals(time, where, log.particle[fired], alone, parting)


def mirrored(forward: Reversals, backward: Reversals, turn: float) -> NDArray[np.bool_]:
    """Tell which reversals have a mirror image in the other run: gate, number, time from `turn`."""
    found = np.zeros(forward.time.size, bool)
    for one in (1, 2):
        here, there = np.flatnonzero(forward.gate == one), backward.gate == one
        order = np.argsort(turn - backward.time[there])
        image, size = (turn - backward.time[there])[order], backward.size[there][order]
        if image.size == 0:
            continue
        at = np.searchsorted(image, forward.time[here])
        for place in (at - 1, at):
            near = np.clip(place, 0, image.size - 1)
            close = np.abs(image[near] - forward.time[here]) < CLOSE
            found[here[close & (size[near] == forward.size[here])]] = True
    return found


def start_number(number: int, threshold: int) -> int:
    """Return how many to start in urn 1 for a state near the stationary one."""
    if number < 100:
        return number // 2
    spread = stable_spread(Circuit(number, threshold), "homogeneous")
    return round(0.5 * number * (1.0 - spread))


def states_file(path: Path, columns: Sequence[Floats]) -> str:
    """Write positions and velocities as an initial file; return its name."""
    np.savetxt(path, np.column_stack(columns), fmt="%.17g")
    return path.name


def final_state(results: Results) -> list[Floats]:
    """Return x, y, ux, uy of all particles at the end of a single task."""
    return [results.value(f"final/{name}")[0, 0] for name in ("x", "y", "ux", "uy")]


def forth_and_back(
    study: Study, name: str, changes: Groups, columns: Sequence[Floats]
) -> list[Path]:
    """Run from a state, turn all velocities, run as long again; return both results files."""
    files = []
    for way in ("forth", "back"):
        state = states_file(study.folder / f"{name}_{way}.txt", columns)
        own = {**changes, "particles": {**changes["particles"], "initial_file": state}}
        files.append(study.run("accuracy_reversal", f"{name}_{way}", own, alone=True))
        with Results(files[-1]) as results:
            x, y, ux, uy = final_state(results)
        columns = (x, y, -ux, -uy)
    return files


def _changes(number: int, threshold: int, duration: float, seed: int = 1) -> Groups:
    return {
        "particles": {
            "number": number, "urn1_number": start_number(number, threshold), "seed": seed,
        },
        "gate": {"threshold": threshold},
        "run": {"duration": duration},
    }  # fmt: skip


def example(
    study: Study, name: str, states: Sequence[Sequence[float]], turn: float = EXAMPLE_TIME
) -> dict[str, object]:
    """Run a few particles forth and back; return the events of both as rows, and the end."""
    changes = {
        "particles": {"number": len(states), "urn1_number": None},
        "gate": {"threshold": 1},
        "run": {"duration": turn},
    }
    columns = np.array(states).T
    told = {"turn": turn}
    for way, file in zip(
        ("forth", "back"), forth_and_back(study, name, changes, columns), strict=True
    ):
        with Results(file) as results:
            log, end = read_log(results), final_state(results)
        told[way] = [
            (time, words(kind, where, particle))
            for time, kind, where, particle in zip(
                log.time, log.kind, log.where, log.particle, strict=True
            )
        ]
        told[f"{way}_end"] = np.column_stack(end)
    start = np.array(states)
    told["returns_within"] = float(np.abs(told["back_end"][:, :2] - start[:, :2]).max())
    return told


def words(kind: int, where: int, particle: int) -> str:
    """Return an event in words."""
    urns = "from urn 1 to urn 2" if where == 12 else "from urn 2 to urn 1"
    return {
        ENTRY: f"particle {particle} enters gate {where}",
        REVERSAL: f"gate {where} turns back {particle}",
        CROSSING1: f"particle {particle} crosses the middle line {urns}",
        CROSSING2: f"particle {particle} crosses the periodic line {urns}",
    }[int(kind)]


def share_of(hits: ArrayLike, counts: ArrayLike) -> tuple[float, float]:
    """Return a share and its error from groups: hits of counts in each, shape (group,).

    Those of one group depend on each other (a wrong firing spoils the next ones), so the groups'
    scatter is the error, not that of single ones.
    """
    hit, count = np.asarray(hits, float), np.asarray(counts, float)
    total = count.sum()
    if total == 0.0:
        return math.nan, math.nan
    share = hit.sum() / total
    filled = int(np.count_nonzero(count))
    if filled < 2:
        return float(share), math.nan
    apart = np.sum((hit - share * count) ** 2) * filled / (filled - 1.0)
    return float(share), math.sqrt(apart) / float(total)


def bound_of_none(count: float) -> float:
    """Return the share at which none of `count` independent ones is seen in 5 % of cases."""
    return 1.0 - (1.0 - SURE) ** (1.0 / count)


def _scan(study: Study) -> list[dict[str, object]]:
    """Return, for each N and T, how many reversals single ones would be undone."""
    rows = []
    for number, threshold in SCAN:
        duration = study.pick(2000.0, 20000.0) * max(1.0, (100.0 / number) ** 2)
        name = f"reversals_{number}_{threshold}"
        changes = _changes(number, threshold, duration)
        with Results(study.run("accuracy_reversal", name, changes, alone=True)) as results:
            found = reversals_of(read_log(results), threshold)
        later = found.time > 0.1 * duration
        block = np.minimum(found.time[later] / duration * BLOCKS, BLOCKS - 1).astype(int)
        counts = np.bincount(block, minlength=BLOCKS)
        share, error = share_of(np.bincount(block, found.alone[later], BLOCKS), counts)
        count = int(counts.sum())
        rows.append(
            {
                "number": number, "threshold": threshold, "reversals": count, "share": share,
                "error": error,
                "per_time": count / (0.9 * duration),
            }
        )  # fmt: skip
    return rows


def _backwards(
    study: Study, number: int, threshold: int, back: float, turns: int
) -> dict[str, object]:
    """Return how many reversals are undone against the time back, from runs turned round.

    One run with a log goes on; its state is taken every now and then, turned, and run backwards.
    """
    times = 200.0 + APART * np.arange(1, turns + 1)
    name = f"turned_{number}_{threshold}"
    changes = _changes(number, threshold, float(times[-1]))
    changes["output"] = {"snapshot_times": times.tolist()}
    with Results(study.run("accuracy_reversal", name, changes, alone=True)) as results:
        log = read_log(results)
        states = [results.snapshot(0, 0, at) for at in range(turns)]

    def turned(at: int) -> Reversals:
        state = states[at]
        columns = (state.x, state.y, -state.ux, -state.uy)
        own = _changes(number, threshold, back)
        own["particles"]["initial_file"] = states_file(study.folder / f"{name}_{at}.txt", columns)
        with Results(study.run("accuracy_reversal", f"{name}_{at}", own, alone=True)) as results:
            return reversals_of(read_log(results), threshold)

    with ThreadPoolExecutor(study.ranks) as pool:
        backwards = list(pool.map(turned, range(turns)))
    ages, done, agreed, partings = [], [], 0, []
    for turn, backward in zip(times, backwards, strict=True):
        forward = reversals_of(log, threshold, turn)
        recent = forward.time > turn - back + CLOSE
        ages.append(turn - forward.time[recent])
        done.append(mirrored(forward, backward, turn)[recent].astype(float))
        strange = ~mirrored(backward, forward, turn)
        seen = float(backward.time[strange].min(initial=math.inf))
        told = turn - forward.parting
        agreed += abs(seen - told) < CLOSE if told < back else seen >= back
        partings.append(told)
    counts, hits = (
        np.array([np.histogram(age / back, BINS, weights=one)[0] for age, one in pairs])
        for pairs in ([(age, None) for age in ages], list(zip(ages, done, strict=True)))
    )
    shares = [share_of(*one) for one in zip(hits.T, counts.T, strict=True)]
    undone, undone_error = share_of(hits.sum(axis=1), counts.sum(axis=1))
    return {
        "number": number, "threshold": threshold, "turns": turns, "back": back,
        "reversals": int(counts.sum()), "undone": undone, "undone_error": undone_error,
        "time_back": 0.5 * (BINS[1:] + BINS[:-1]) * back, "counts": counts.sum(axis=0),
        "share": [one for one, _ in shares], "share_error": [error for _, error in shares],
        "parting_as_told": agreed, "parting_median": float(np.median(partings)),
    }  # fmt: skip


def figure_reversal(scan: Sequence[dict], turned: Sequence[dict]) -> Figure:
    """Return the share of single reversals undone against T, and that of runs against time.

    Where none was undone, the share that 95 % of such counts would have seen is a bound.
    """
    made = style.figure(style.PAGE, 3.2)
    left, right = made.subplots(1, 2)
    rows = [row for row in scan if row["number"] == 1000 and row["reversals"]]
    at = [row["threshold"] / row["number"] for row in rows]
    told = [np.array([row[name] for row in rows], float)
            for name in ("share", "error", "reversals")]  # fmt: skip
    _draw_shares(left, np.array(at), *told, "o", style.BLUE)
    left.set_title("(a)  turned at once, $N = 1000$")
    style.label_fraction(left)
    left.set_ylabel("share of reversals undone")
    left.set_ylim(-0.08, 1.03)
    for row, colour, mark in zip(turned, style.CYCLE, "osD^v", strict=False):
        told = [np.array(row[name], float)
                for name in ("time_back", "share", "share_error", "counts")]  # fmt: skip
        label = f"$N = {row['number']}$, $T = {row['threshold']}$"
        _draw_shares(right, *told, mark, colour, label=label)
    right.set_xscale("log")
    right.set_title("(b)  turned later")
    right.set_xlabel("time from reversal to turning  (length / $v$)")
    right.set_ylim(-0.08, 1.03)
    right.plot([], [], marker=r"$\downarrow$", mew=0.0, ms=7, ls="none", color=style.BLACK,
               label="none undone:\nbound (95 %)")  # fmt: skip
    made.legend(loc="outside right upper")
    return made


def _draw_shares(
    axes: Axes, x: Floats, share: Floats, error: Floats, counts: Floats, mark: str, colour: str,
    **look: object,
) -> None:  # fmt: skip
    """Draw shares with their errors, and bounds in place of those that are 0."""
    seen = share > 0.0
    axes.errorbar(x[seen], share[seen], error[seen], fmt=f"{mark}-", color=colour, ms=2.5, lw=0.8,
                  elinewidth=1.0, capsize=3.0, **look)  # fmt: skip
    for place, count in zip(x[share == 0.0], counts[share == 0.0], strict=True):
        style.bound(axes, place, bound_of_none(count), mark, colour, 3.5)


def run(study: Study) -> None:
    """Run forth and back, count, draw `reversal_gated`, keep the numbers."""
    study.folder.mkdir(parents=True, exist_ok=True)
    scan = _scan(study)
    turned = [_backwards(study, *one, int(study.pick(20, 100))) for one in TURNED]
    examples = {
        "undone": example(study, "example_undone", FROM_URN2),
        "not_undone": example(study, "example_not_undone", (*FROM_URN2, PASSER)),
    }
    study.keep("gated_reversal", {"scan": scan, "turned": turned, "examples": examples})
    study.draw(figure_reversal(scan, turned), "reversal_gated")

"""Time reversal with gates: which of their reversals are undone when all velocities are reversed.

A reversal reverses T + 1 particles that move to the other gate. Backwards in time it is undone if
these T + 1, and no others, return to the gate. But other particles may be moving out of it:
reversed by an earlier reversal, or come through from the other gate. Backwards they are entrants
like all, the gate counts them too, and it fires too early. So a single reversal is undone exactly
if no other particle moves out of its gate at that time; and the two histories separate at the first
time, backwards, at which more than T move out together.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc.figures import style
from studies.common import study, text
from studies.common.event_log import (
    REVERSAL,
    Log,
    outward_stays,
    particle_events,
    read_log,
)
from studies.common.numbers import bound
from studies.common.theories import told
from studies.gated_reversal import examples, pasts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from studies.common.study import Groups

    Floats = NDArray[np.float64]

CLOSE = 1e-6  # largest difference in time of two events that mirror each other
SCAN = ((2, 1), (10, 1), (100, 1), (1000, 1), (1000, 2), (1000, 4), (1000, 7), (1000, 10),
        (1000, 14), (1000, 18), (1000, 22))  # (N, T)  # fmt: skip
# N, T, duration of runs backwards
TURNED = ((100, 1, 12.0), (1000, 2, 12.0), (1000, 7, 12.0), (1000, 18, 12.0))
BINS = np.array([0.0, 0.03, 0.08, 0.17, 0.33, 0.5, 0.75, 1.0])  # of the time back, as a share
SURE = 0.95  # of bounds
BLOCKS = 20  # of time, from which the errors of the scan are taken
APART = 60.0  # time between two starts of runs backwards


@dataclass(frozen=True)
class Reversals:
    """The reversals in one log.

    Attributes
    ----------
    time, gate, size : of each reversal, shape (reversal,).
    alone : whether no other particle moved out of the gate then.
    parting : time at which a run backwards from the end leaves the history.
    """

    time: Floats
    gate: NDArray[np.int64]
    size: NDArray[np.int64]
    alone: NDArray[np.bool_]
    parting: float


def reversals_of(log: Log, threshold: int, end: float = math.inf) -> Reversals:
    """Return the reversals before `end`, and the predictions for a run backwards from there."""
    known = log.time < end
    log = Log(*(getattr(log, field.name)[known] for field in fields(log)))
    gate, start, stop = outward_stays(particle_events(log))
    fired = np.flatnonzero(log.kind == REVERSAL)
    time, where = log.time[fired], log.where[fired]
    alone, parting = np.ones(fired.size, bool), -math.inf
    for one in (1, 2):
        mine = gate == one
        begins, ends = np.sort(start[mine]), np.sort(stop[mine])
        here = where == one
        came, left = (np.searchsorted(x, time[here], "left") for x in (begins, ends))
        alone[here] = came == left  # the entrant that caused it is out at once
        # particles moving out when one of them leaves, that one included
        together = np.searchsorted(begins, ends, "left") - np.arange(ends.size)
        early = ends[(together > threshold) & (ends < end)]
        crowded = time[here][~alone[here]]
        parting = max(parting, *(float(one.max(initial=-math.inf)) for one in (early, crowded)))
    return Reversals(time, where, log.particle[fired], alone, parting)


def mirrored(forward: Reversals, backward: Reversals, turn: float) -> NDArray[np.bool_]:
    """Tell which reversals have a mirror image in the other run, by gate, number and time."""
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
    """Return the initial number in urn 1 for a state near the stationary one."""
    if number < 100:
        return number // 2
    theory = told("window", number=number, threshold=threshold)
    stable = [root["mass_spread"] for root in theory["roots"] if root["kind"] == "stable"]
    spread = 0.0 if theory["homogeneous"] == "stable" else min(stable, default=0.0)
    return round(0.5 * number * (1.0 - spread))


def _changes(number: int, threshold: int, duration: float) -> Groups:
    return {
        "particles": {
            "number": number, "urn1_number": start_number(number, threshold), "seed": 1,
        },
        "gate": {"threshold": threshold},
        "run": {"duration": duration},
    }  # fmt: skip


def share_of(hits: ArrayLike, counts: ArrayLike) -> tuple[float, float]:
    """Return a share and its error from groups: hits of counts in each, shape (group,).

    Those of one group depend on each other (a wrong reversal affects the next ones), so the error
    is from the scatter of the groups, not from that of single ones.
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
    """Return the share at which none of `count` independent events occurs in 5 % of cases."""
    return 1.0 - (1.0 - SURE) ** (1.0 / count)


def _scan(work: study.Study) -> list[dict[str, object]]:
    """Return, for each N and T, the share of reversals that would be undone one by one."""
    rows = []
    for number, threshold in SCAN:
        duration = work.pick(2000.0, 20000.0) * max(1.0, (100.0 / number) ** 2)
        name = f"reversals_{number}_{threshold}"
        changes = _changes(number, threshold, duration)
        log = read_log(work.run("reversal", name, changes, alone=True))
        found = reversals_of(log, threshold)
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
    work: study.Study, number: int, threshold: int, back: float, turns: int
) -> dict[str, object]:
    """Return the share of undone reversals against the time back, from runs backwards.

    One run has a log; states of it are taken at intervals, reversed, and run backwards.
    """
    times = 200.0 + APART * np.arange(1, turns + 1)
    name = f"turned_{number}_{threshold}"
    changes = _changes(number, threshold, float(times[-1]))
    changes["output"] = {"snapshot_times": times.tolist()}
    path = work.run("reversal", name, changes, alone=True)
    log = read_log(path)
    states = postproc.open_results(path, group="snapshots").squeeze("replica")

    def turned(at: int) -> Reversals:
        state = states.isel(time=at)
        columns = [sign * state[name].to_numpy()
                   for name, sign in (("x", 1), ("y", 1), ("ux", -1), ("uy", -1))]  # fmt: skip
        state_file = examples.states_file(work.folder / f"{name}_{at}.txt", columns)
        own = {"particles": {**changes["particles"], "initial_file": state_file},
               "gate": changes["gate"], "run": {"duration": back}}  # fmt: skip
        log = read_log(work.run("reversal", f"{name}_{at}", own, alone=True))
        return reversals_of(log, threshold)

    with ThreadPoolExecutor(work.ranks) as pool:
        backwards = list(pool.map(turned, range(turns)))
    ages, done, agreed, partings = [], [], 0, []
    for turn, backward in zip(times, backwards, strict=True):
        forward = reversals_of(log, threshold, turn)
        recent = forward.time > turn - back + CLOSE
        ages.append(turn - forward.time[recent])
        done.append(mirrored(forward, backward, turn)[recent].astype(float))
        strange = ~mirrored(backward, forward, turn)
        seen = float(backward.time[strange].min(initial=math.inf))
        predicted = turn - forward.parting
        agreed += abs(seen - predicted) < CLOSE if predicted < back else seen >= back
        partings.append(predicted)
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

    If none was undone, the share at which 95 % of such counts would not be 0 is a bound.
    """
    made = style.figure(style.PAGE, 3.2)
    left, right = made.subplots(1, 2)
    rows = [row for row in scan if row["number"] == 1000 and row["reversals"]]
    at = [row["threshold"] / row["number"] for row in rows]
    columns = [np.array([row[name] for row in rows], float)
               for name in ("share", "error", "reversals")]  # fmt: skip
    _draw_shares(left, np.array(at), *columns, "o", style.BLUE)
    left.set_title("(a)  turned at once, $N = 1000$")
    style.label_fraction(left)
    left.set_ylabel("share of reversals undone")
    left.set_ylim(-0.08, 1.03)
    for row, colour, mark in zip(turned, style.CYCLE, "osD^v", strict=False):
        columns = [np.array(row[name], float)
                   for name in ("time_back", "share", "share_error", "counts")]  # fmt: skip
        label = f"$N = {row['number']}$, $T = {row['threshold']}$"
        _draw_shares(right, *columns, mark, colour, label=label)
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
    """Draw shares with their errors, and bounds for those that are 0."""
    seen = share > 0.0
    axes.errorbar(x[seen], share[seen], error[seen], fmt=f"{mark}-", color=colour, ms=2.5, lw=0.8,
                  elinewidth=1.0, capsize=3.0, **look)  # fmt: skip
    for place, count in zip(x[share == 0.0], counts[share == 0.0], strict=True):
        bound(axes, place, bound_of_none(count), mark, colour, 3.5)


def tables(work: study.Study, scan: Sequence[dict], turned: Sequence[dict]) -> None:
    """Write the tables of the page."""
    work.table("scan", ["N", "T", "T/N", "reversals per unit time", "undone"], [
        [str(one["number"]), str(one["threshold"]),
         text.number(one["threshold"] / one["number"], 2), text.number(one["per_time"], 2),
         text.measured(one["share"], one["error"])]
        for one in scan
    ])  # fmt: skip
    head = ["N", "T", "reversals in the last 12", "undone", "histories part after (median)"]
    work.table("turned", head, [
        [str(one["number"]), str(one["threshold"]), str(one["reversals"]),
         f"{text.measured(100.0 * one['undone'], 100.0 * one['undone_error'])} %",
         text.number(one["parting_median"], 2)]
        for one in turned
    ])  # fmt: skip


def run(work: study.Study) -> None:
    """Run forwards and back; store numbers, write tables, draw `gated` and `two_pasts`."""
    scan = _scan(work)
    turned = [_backwards(work, *one, int(work.pick(20, 100))) for one in TURNED]
    events = {"undone": examples.example(work, "example_undone", examples.FROM_URN2)}
    other = (*examples.FROM_URN2, examples.PASSER)
    events["not_undone"] = examples.example(work, "example_not_undone", other)
    work.keep("gated_reversal", {"scan": scan, "turned": turned, "examples": events})
    tables(work, scan, turned)
    for name in ("undone", "not_undone"):
        examples.table(work, name, events[name])
    work.draw(figure_reversal(scan, turned), "gated")
    pasts.run(work)


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

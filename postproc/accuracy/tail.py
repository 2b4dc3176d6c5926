"""The tail of the net current: who carries it, how it scatters, how long a run must be.

A particle that leaves channel 2 along the table's axis, or so that it meets the wall of channel 1
just at its middle, comes straight back to channel 2 without a bounce in an urn. Such orbits are
marginally stable: the nearer a particle comes to one the more rounds it makes. Here every passage
of channel 2 that comes straight from the middle of channel 1 is told from the rest by its time of
flight, and passages of one particle without a bounce in an urn are counted as the rounds of one
circulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

from postproc.accuracy.events import CROSSING1, CROSSING2, ENTRY, outward_stays, read_log, stories
from postproc.accuracy.scatter import GOAL, length_for_goal, scatter_with_error
from postproc.figures import style
from postproc.reading.results import Results
from postproc.theory.circuit import Circuit, flow2

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.accuracy.events import Log, Stories
    from postproc.study.study import Study

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

TRANSIENT = 1000.0  # time that is left out at the start of every run
WINDOW = 500.0  # shortest window, length/v
PAPER_RUN = 1e8  # collisions of a run of the paper
ROUNDS = 2 ** np.arange(14)  # rounds at which circulations are counted
FIT = (2, 128)  # rounds between which the law of circulations is fitted


@dataclass(frozen=True)
class Circulations:
    """Passages of channel 2 in one log, those after the transient; fields of shape (passage,).

    Attributes
    ----------
    time : when.
    sign : 1 from urn 2 to urn 1, the way of the net current, -1 the other.
    rounds : how many rounds the particle has made without a bounce in an urn; 0: not straight.
    slope : |u_y/u_x| of those that come straight from the middle of channel 1, NaN of the rest.
    all_rounds : the rounds by the stories' events, shape (event,).
    """

    time: Floats
    sign: NDArray[np.int64]
    rounds: NDArray[np.int64]
    slope: Floats
    all_rounds: NDArray[np.int64]


def straight_time(circuit: Circuit) -> float:
    """Return the time from the middle line to the periodic line along the axis."""
    radius = float(circuit.urn_radius)
    chords = sum(
        math.sqrt(radius**2 - 0.25 * float(width) ** 2)
        for width in (circuit.channel1_width, circuit.channel2_width)
    )
    return chords + 0.5 * float(circuit.channel1_length) + 0.5 * float(circuit.channel2_length)


def steepest(circuit: Circuit) -> float:
    """Return the largest slope of a straight way through an urn from one channel to the other."""
    chords = straight_time(circuit) - 0.5 * float(
        np.add(circuit.channel1_length, circuit.channel2_length)
    )
    return 0.5 * float(np.add(circuit.channel1_width, circuit.channel2_width)) / chords


def circulations(told: Stories, circuit: Circuit) -> Circulations:
    """Return the passages of channel 2 with the rounds made."""
    shortest = straight_time(circuit)
    longest = shortest * math.hypot(1.0, steepest(circuit)) * (1.0 + 1e-9)
    passes = np.flatnonzero(told.kind == CROSSING2)
    last = told.before[passes]  # of a particle that comes straight: its crossing of channel 1
    flight = np.where(last >= 0, told.time[passes] - told.time[last], math.inf)
    # from the middle of channel 1 on towards the urn that it now leaves
    straight = (flight <= longest) & (told.kind[last] == CROSSING1)
    straight &= told.where[last] + told.where[passes] == 33
    entry = np.where(straight, told.before[last], -1)
    first = np.where(entry >= 0, told.before[entry], -1)
    before = told.time[last] - told.time[first]
    round_before = (first >= 0) & (told.kind[first] == CROSSING2) & (before <= longest)
    round_before &= told.where[first] == told.where[passes]
    rounds = np.zeros(told.time.size, int)
    for place in np.flatnonzero(straight):
        rounds[passes[place]] = 1 + (rounds[first[place]] if round_before[place] else 0)
    slope = np.sqrt(np.clip((flight / shortest) ** 2 - 1.0, 0.0, None))
    slope = np.where(straight, slope, math.nan)
    sign = np.where(told.where[passes] == 21, 1, -1)
    order = np.argsort(told.time[passes], kind="stable")
    order = order[told.time[passes[order]] > TRANSIENT]
    columns = (told.time[passes], sign, rounds[passes], slope)
    return Circulations(*(column[order] for column in columns), rounds)


def urn_numbers(
    log: Log, told: Stories, circuit: Circuit, at_start: int, end: float
) -> tuple[float, float]:
    """Return the mean numbers inside urn 1 and urn 2 after the transient, channels left out.

    `at_start` is how many began in half 2.
    """
    crossed = (log.kind == CROSSING1) | (log.kind == CROSSING2)
    time = np.clip(log.time[crossed], TRANSIENT, end)
    number = at_start + np.cumsum(np.where(log.where[crossed] == 12, 1, -1))
    edges = np.concatenate([[TRANSIENT], time, [end]])
    duration = end - TRANSIENT
    half = np.concatenate([[at_start], number]) @ np.diff(edges) / duration
    through2 = np.count_nonzero((told.kind == CROSSING2) & (told.time > TRANSIENT))
    returning = through2 * 0.25 * math.pi * float(circuit.channel2_length)
    gate, start, stop = outward_stays(told)
    known = np.where(told.after >= 0, told.time[told.after], told.time)
    leaves = np.where(np.isfinite(told.turned), told.turned, known)
    held = []
    for one in (1, 2):
        outward = (stop - start)[(gate == one) & (start > TRANSIENT)].sum()
        entry = (told.kind == ENTRY) & (told.where == one) & (told.time > TRANSIENT)
        inward = (leaves - told.time)[entry].sum()
        held.append(float(outward + inward + returning) / duration)
    return float(circuit.number) - half - held[0], float(half - held[1])


def fed_by_gate(told: Stories, found: Integers, least: int = 8) -> tuple[int, int]:
    """Return how many circulations began with a reversal in gate 2, and how many there are.

    Counted are those of `least` rounds and more. `found` are the rounds of every event of `told`,
    0 of those that are no straight passage.
    """
    begun, total = 0, 0
    for place in np.flatnonzero((found == least) & (told.where == 21)):
        at = place
        for _ in range(least):  # from the last passage to the one before the first straight one
            at = told.before[told.before[told.before[at]]]
            if at < 0:
                break
        total += 1
        origin = told.before[at] if at >= 0 else -1
        begun += origin >= 0 and bool(np.isfinite(told.turned[origin])) and told.where[origin] == 2
    return begun, total


def in_windows(time: Floats, weight: Floats, length: float, end: float) -> Floats:
    """Return sums of `weight` per unit time over the whole windows between transient and end."""
    count = int((end - TRANSIENT) / length)
    edges = TRANSIENT + length * np.arange(count + 1)
    return np.histogram(time, edges, weights=np.asarray(weight, float))[0] / length


def long_runs(study: Study) -> Path:
    """Make the long runs at T = 7, the reference of chart two as well; return their file."""
    changes = {
        "run": {"duration": study.pick(1.0e6, 8.0e6)},
        "scan": {"replicas": int(study.pick(24, 64))},
    }
    return study.run("accuracy_tail", "tail", changes)


def total_time(study: Study) -> float:
    """Return the time that the long runs measured, all together."""
    with Results(long_runs(study)) as results:
        return float((results.value("time")[results.done] - TRANSIENT).sum())


def _ensemble(study: Study) -> dict[str, object]:
    """Return how the net current of long runs, and of windows cut from them, scatters."""
    with Results(long_runs(study)) as results:
        end, interval = float(results.value("time").min()), WINDOW
        net = []
        for replica in range(results.replicas):
            series = results.series(0, replica)
            flow = series.flows["flow1_12"] - series.flows["flow1_21"]
            net.append(flow[series.time > TRANSIENT + 0.5 * interval])
        shortest = min(flow.size for flow in net)  # rounding may cost the last entry
        net = np.array([flow[:shortest] for flow in net])
        per_time = float((results.value("collisions") / results.value("time")).mean())
        whole = np.abs(results.value("current1")[0])
    rows, size = [], 1
    while size <= net.shape[1]:
        count = net.shape[1] // size
        means = net[:, : count * size].reshape(net.shape[0], count, size).mean(axis=2)
        rows.append({"time": size * interval, **scatter_with_error(means)})
        size *= 2
    whole_runs = net.mean(axis=1, keepdims=True)
    rows.append({"time": net.shape[1] * interval, **scatter_with_error(whole_runs)})
    mean, error = net.mean(), net.mean(axis=1).std(ddof=1) / math.sqrt(net.shape[0])
    lengths = np.array([row["time"] for row in rows])
    widths = {name: np.array([row[name] for row in rows]) for name in ("half_width", "deviation")}
    paper = PAPER_RUN / per_time
    return {
        "replicas": net.shape[0], "duration": end, "mean": mean, "error": error,
        "lengths": rows, "currents": np.sort(whole), "collisions_per_time": per_time,
        "typical_time": length_for_goal(lengths, widths["half_width"], mean),
        "deviation_time": length_for_goal(lengths, widths["deviation"], mean),
        "paper_time": paper,
        "paper_half_width": np.interp(math.log(paper), np.log(lengths), widths["half_width"]),
        "paper_deviation": np.interp(math.log(paper), np.log(lengths), widths["deviation"]),
    }  # fmt: skip


def _split(study: Study) -> dict[str, object]:
    """Return who carries the current, from event logs."""
    logs, end = int(study.pick(6, 48)), study.pick(1.0e5, 2.0e5)
    duration = end - TRANSIENT
    found, parts, entries1, turned1, fed, circuit = [], [], 0, 0, np.zeros(2, int), None
    for seed in range(1, logs + 1):
        changes = {"particles": {"seed": 1000 + seed}, "run": {"duration": end}}
        path = study.run("accuracy_events", f"events_{seed}", changes, alone=True)
        with Results(path) as results:
            circuit, log = results.circuit(0), read_log(results)
            start = int(circuit.number) - int(results.value("urn1_number")[0])
        told = stories(log)
        one = circulations(told, circuit)
        straight, down = one.rounds > 0, one.sign > 0
        gate1 = (told.kind == ENTRY) & (told.where == 1)
        entries1 += np.count_nonzero(gate1)
        turned1 += np.count_nonzero(np.isfinite(told.turned[gate1]))
        fed += fed_by_gate(told, one.all_rounds)
        found.append(one)
        ways = [one.sign[straight].sum(), one.sign[~straight].sum(), down.sum(),
                (down & ~straight).sum(), (~down).sum()]  # fmt: skip
        parts.append(
            [*urn_numbers(log, told, circuit, start, end), *(way / duration for way in ways)]
        )
    sparse, inside, straight, rest, down, down_rest, up = np.array(parts).T
    expected = inside * float(flow2(circuit, 1.0))
    reached = np.array(
        [sum(np.count_nonzero(one.rounds == m) for one in found) for m in ROUNDS], float
    )
    slopes = np.concatenate([one.slope[one.rounds > 0] for one in found])
    windows = []
    for size in 2 ** np.arange(int(math.log2(duration / WINDOW)) + 1):
        length, columns = WINDOW * size, []
        for choose in (True, False):
            values = [
                in_windows(one.time, one.sign * ((one.rounds > 0) == choose), length, end)
                for one in found
            ]
            columns.append(scatter_with_error(np.array(values)))
        windows.append({"time": length, "straight": columns[0], "rest": columns[1]})
    lengths = np.array([row["time"] for row in windows])
    rest_widths = np.array([row["rest"]["half_width"] for row in windows])
    total = float((straight + rest).mean())
    zigzag = _zigzag(circuit)
    return {
        "logs": logs, "duration": duration, "urn2_number": inside.mean(),
        "straight": _mean(straight), "rest": _mean(rest), "total": _mean(straight + rest),
        "down_over_theory": _mean(down / expected),
        "rest_over_theory": _mean(down_rest / expected),
        "urn1_number": sparse.mean(), "down": _mean(down), "down_rest": _mean(down_rest),
        "down_expected": expected.mean(), "up": _mean(up),
        "up_expected": float(sparse.mean() * flow2(circuit, 1.0)),
        "fed_by_gate": fed[0], "fed_of": fed[1],
        "round_time": 2.0 * straight_time(circuit), "rounds": ROUNDS,
        "reached": reached, "law": _law(reached, logs * duration),
        "longest": max(int(one.rounds.max(initial=0)) for one in found),
        "rate_unit": logs * duration, "turned_gate1": turned1, "entries_gate1": entries1,
        "zigzag_slope": zigzag, "on_zigzag": float(np.mean(np.abs(slopes - zigzag) < 0.1 * zigzag)),
        "on_axis": float(np.mean(slopes < 0.1 * zigzag)),
        "slopes": np.quantile(slopes, [0.05, 0.5, 0.95]),
        "windows": windows, "rest_time": length_for_goal(lengths, rest_widths, total),
    }  # fmt: skip


def _mean(values: Floats) -> dict[str, float]:
    return {"mean": values.mean(), "error": values.std(ddof=1) / math.sqrt(values.size)}


def _zigzag(circuit: Circuit) -> float:
    """Return the slope of the orbit that meets the wall of channel 1 once, at its middle."""
    across = 2.0 * straight_time(circuit) - float(circuit.channel2_length)
    return float(circuit.channel1_width) / across


def _law(reached: Floats, time: float) -> dict[str, float]:
    """Fit rate = scale * rounds**-exponent to circulations that reach that many rounds."""
    chosen = (FIT[0] <= ROUNDS) & (FIT[1] >= ROUNDS) & (reached > 0)
    x, y = np.log(ROUNDS[chosen]), np.log(reached[chosen] / time)
    slope, level = np.polyfit(x, y, 1, w=np.sqrt(reached[chosen]))
    return {"exponent": -slope, "scale": math.exp(level)}


def figure_tail(ensemble: dict, split: dict) -> Figure:
    """Return the scatter of the current, the law of circulations, and the width against time."""
    made = style.figure(style.PAGE, 2.9)
    spread, law, width = made.subplots(1, 3)
    _draw_spread(spread, ensemble)
    rounds, reached = np.array(split["rounds"]), np.array(split["reached"], float)
    there = reached > 0
    rate = reached[there] / split["rate_unit"]
    law.errorbar(
        rounds[there], rate, rate / np.sqrt(reached[there]), fmt="o", color=style.BLUE,
        label="seen",
    )  # fmt: skip
    fit = split["law"]
    line = np.array([1.0, rounds[there][-1]])
    exponent = f"{fit['exponent']:.2f}"
    law.plot(
        line, fit["scale"] * line ** -fit["exponent"], "--", color=style.BLACK, lw=0.9,
        label=f"rounds$^{{-{exponent}}}$",
    )  # fmt: skip
    law.set_xscale("log")
    law.set_yscale("log")
    law.set_xlabel("rounds without a bounce in an urn")
    law.set_ylabel("circulations (per unit time)")
    law.set_title("(b)")
    law.legend()
    _draw_widths(width, ensemble, split)
    return made


def _draw_spread(axes: Axes, ensemble: dict) -> None:
    values = np.sort(np.array(ensemble["currents"], float))
    share = (np.arange(values.size) + 0.5) / values.size
    axes.plot(values, share, drawstyle="steps-mid", color=style.BLUE)
    axes.plot(values, share, "o", color=style.BLUE, ms=2.5)
    axes.axvline(ensemble["mean"], color=style.BLACK, ls="--", lw=0.9, label="mean")
    axes.axvspan(
        (1.0 - GOAL) * ensemble["mean"], (1.0 + GOAL) * ensemble["mean"], color=style.GREY,
        alpha=0.25, lw=0.0, label=f"$\\pm {100 * GOAL:g}$ %",
    )  # fmt: skip
    axes.set_ylim(0.0, 1.0)
    axes.set_xlabel("net current of a run\n(per unit time)")
    axes.set_ylabel("share of runs below")
    axes.set_title(f"(a)  {values.size} runs")
    axes.legend()


def _draw_widths(axes: Axes, ensemble: dict, split: dict) -> None:
    mean = ensemble["mean"]
    rows = [row for row in ensemble["lengths"] if row["runs"] >= 8]
    time = [row["time"] for row in rows]
    for name, mark, colour, label in (
        ("deviation", "s", style.BLUE, "standard deviation"),
        ("half_width", "o", style.VERMILION, "half of 68 %"),
    ):
        values, errors = (
            [100.0 * row[key] / mean for row in rows] for key in (name, f"{name}_error")
        )
        axes.errorbar(time, values, errors, fmt=f"{mark}-", color=colour, label=label)
    rest = [row for row in split["windows"] if row["rest"]["runs"] >= 8]
    values, errors = (
        [100.0 * row["rest"][key] / mean for row in rest]
        for key in ("half_width", "half_width_error")
    )
    axes.errorbar(
        [row["time"] for row in rest], values, errors,
        fmt="^-", color=style.GREEN, label="half of 68 %,\nwithout circulation",
    )  # fmt: skip
    axes.axhline(100.0 * GOAL, color=style.GREY, lw=0.9)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("run  (length / $v$)")
    axes.set_ylabel("scatter of the net current (%)")
    axes.set_ylim(bottom=0.06)
    axes.yaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1, 2, 5, 10]))
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_title("(c)")
    axes.legend(fontsize=6.5, loc="lower left")


def run(study: Study) -> None:
    """Run the ensemble and the logs, draw `tail`, keep the numbers."""
    numbers = {"ensemble": _ensemble(study), "split": _split(study)}
    study.keep("tail", numbers)
    study.draw(figure_tail(**numbers), "tail")

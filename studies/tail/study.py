"""The tail of the net current: its parts, its scatter, and the required length of a run.

Runs are made in build/tail/quick (minutes of one core), or full, and not repeated if they are
complete. Writes numbers to tail.json, the picture to tail.png. For the definition of circulations
see studies/circulations.py.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

import postproc
from postproc import study
from postproc.figures import style
from studies.circulations import ROUNDS, TRANSIENT, circulations, straight_time, urn_numbers
from studies.event_log import ENTRY, circuit_of, particle_events, read_log
from studies.tail.scatter import GOAL, length_for_goal, scatter_with_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from studies.event_log import Circuit, ParticleEvents

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

WINDOW = 500.0  # shortest window, length/v
PAPER_RUN = 1e8  # collisions of a run of the paper
FIT = (2, 128)  # rounds between which the law of circulations is fitted


def fed_by_gate(events: ParticleEvents, found: Integers, least: int = 8) -> tuple[int, int]:
    """Return the number of circulations that began with a reversal in gate 2, and of all.

    Circulations of `least` rounds and more are counted. `found` has the rounds of every event of
    `events`, 0 if it is not a straight passage.
    """
    begun, total = 0, 0
    for place in np.flatnonzero((found == least) & (events.where == 21)):
        at = place
        for _ in range(least):  # from the last passage to the one before the first straight one
            at = events.before[events.before[events.before[at]]]
            if at < 0:
                break
        total += 1
        origin = events.before[at] if at >= 0 else -1
        reversed_here = origin >= 0 and bool(np.isfinite(events.turned[origin]))
        begun += reversed_here and events.where[origin] == 2
    return begun, total


def in_windows(time: Floats, weight: Floats, length: float, end: float) -> Floats:
    """Return sums of `weight` per unit time in the complete windows between transient and end."""
    count = int((end - TRANSIENT) / length)
    edges = TRANSIENT + length * np.arange(count + 1)
    return np.histogram(time, edges, weights=np.asarray(weight, float))[0] / length


def _ensemble(work: study.Study) -> dict[str, object]:
    """Return the scatter of the net current of long runs, and of windows of them."""
    changes = {
        "run": {"duration": work.pick(1.0e6, 8.0e6)},
        "scan": {"replicas": int(work.pick(24, 64))},
    }
    path, interval = work.run("runs", "runs", changes), WINDOW
    data, series = postproc.open_results(path), postproc.open_results(path, group="series")
    net = (series.flow1_12 - series.flow1_21).to_numpy()
    net = net[:, series.time.to_numpy() > TRANSIENT + 0.5 * interval]
    net = net[:, ~np.isnan(net).any(axis=0)]  # the last entry of a run may be missing by rounding
    end = float(data.time.min())
    per_time = float((data.collisions / data.time).mean())
    whole = np.abs(data.current1.to_numpy())
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


def _split(work: study.Study) -> dict[str, object]:
    """Return the parts of the current, from event logs."""
    logs, end = int(work.pick(6, 48)), work.pick(1.0e5, 2.0e5)
    duration = end - TRANSIENT
    found, parts, entries1, turned1, fed, circuit = [], [], 0, 0, np.zeros(2, int), None
    for seed in range(1, logs + 1):
        changes = {"particles": {"seed": 1000 + seed}, "run": {"duration": end}}
        path = work.run("events", f"events_{seed}", changes, alone=True)
        data, log = postproc.open_results(path), read_log(path)
        circuit = circuit_of(data)
        start = int(data.number) - int(data.urn1_number)
        events = particle_events(log)
        one = circulations(events, circuit)
        straight, down = one.rounds > 0, one.sign > 0
        gate1 = (events.kind == ENTRY) & (events.where == 1)
        entries1 += np.count_nonzero(gate1)
        turned1 += np.count_nonzero(np.isfinite(events.turned[gate1]))
        fed += fed_by_gate(events, one.all_rounds)
        found.append(one)
        ways = [one.sign[straight].sum(), one.sign[~straight].sum(), down.sum(),
                (down & ~straight).sum(), (~down).sum()]  # fmt: skip
        parts.append(
            [*urn_numbers(log, events, circuit, start, end), *(way / duration for way in ways)]
        )
    sparse, inside, straight, rest, down, down_rest, up = np.array(parts).T
    each = circuit.channel2_width / (math.pi * circuit.urn_area)  # sent by a well mixed urn
    expected = inside * each
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
        "up_expected": float(sparse.mean() * each),
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
    """Return the slope of the orbit that hits the wall of channel 1 once, at its middle."""
    across = 2.0 * straight_time(circuit) - circuit.channel2_length
    return circuit.channel1_width / across


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


def run(work: study.Study) -> None:
    """Run the ensemble and the logs, draw `tail`, store the numbers."""
    numbers = {"ensemble": _ensemble(work), "split": _split(work)}
    work.keep("tail", numbers)
    work.draw(figure_tail(**numbers), "tail")


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

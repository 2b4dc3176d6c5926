"""Runs made after the first ones, and what follows from both.

Longer runs where both states take turns, repeats of the widths of hysteresis, and the second range
at several N. Every run is one line of runs.csv, with its histogram; all other tables are made from
runs.csv and from the tables of the first runs, so `tables` needs no runs at all.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import postproc
from studies.order_of_transition import channels, samples
from studies.order_of_transition.prediction import WIDTH

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from postproc.study import Study

    Floats = NDArray[np.float64]
    Row = dict[str, object]
    Key = tuple[str, int, float]

HERE = Path(__file__).resolve().parent
STARTS = (0.5, 0.95)  # share of urn 1
TRANSIENT = 5000.0
LENGTH = 2e4  # of a run, after the transient
INTERVAL = 20.0
LONG = 8.0  # lengths
BINS = [f"bin {k}" for k in range(samples.BINS.size - 1)]
RUN_FIELDS = ["circuit", "T", "N", "l", "w'", "time", "start", "replica", "chi", "m2", "m4",
              "passages", "left at", "correlation time", *BINS]  # fmt: skip
SIGNIFICANT = 3.0  # errors of a barrier: less is none
PASSED = 2  # passages a run, on average, from which on a barrier is given
NOTHING = dict.fromkeys(
    ("w'", "barrier", "barrier_error", "barrier_bias", "passages"), math.nan
)  # of no width


@dataclass(frozen=True)
class Later:
    """One circuit at one N; w' that are run, for `times` lengths."""

    name: str
    threshold: int
    reach: float
    number: int
    widths: tuple[float, ...]
    times: float = 1.0
    label: str = "later"


LATER = (
    Later("A", 5, 1000, 250, (0.0300, 0.0316, 0.0332, 0.0348, 0.0364, 0.0380), LONG),
    Later("A", 5, 1000, 500, (0.0284, 0.0292, 0.0300, 0.0308, 0.0324, 0.0340), LONG),
    Later("A", 5, 1000, 1000, (0.0268, 0.0276, 0.0284, 0.0292, 0.0300), LONG),
    Later("A", 5, 1000, 250, (0.0284, 0.0292), LONG, label="narrower"),
    Later("A", 5, 1000, 1000, (0.0308, 0.0324), LONG, label="wider"),
    Later("A", 5, 1000, 1500, (0.0276, 0.0284), LONG),
    Later("A", 5, 1000, 8000, (0.0244, 0.0260, 0.0276, 0.0292)),
    Later("D", 28, 4000, 1000, (0.074, 0.077, 0.080, 0.083), LONG),
    Later("D", 28, 4000, 2000, (0.070, 0.072, 0.074), LONG),
    Later("D", 28, 4000, 4000, (0.067, 0.068), LONG),
    Later("D", 28, 4000, 8000, (0.060, 0.062, 0.064, 0.066, 0.068)),
    # The second range, at the load of V (0.759 T, the channels counted), and within the predicted
    # range, 0.783 T. N l is such that all N have the same load.
    Later("V", 64, 4272, 4000, (0.002, 0.004, 0.006)),
    Later("V", 64, 4272, 4000, (0.008, 0.010, 0.012), label="wider"),
    Later("V", 64, 4169, 8000, (0.002, 0.004, 0.006)),
    Later("V", 64, 4169, 8000, (0.008, 0.010), label="wider"),
    Later("V", 64, 4120, 16000, (0.002, 0.004, 0.006)),
    Later("V", 64, 4095, 32000, (0.001,), label="narrower"),
    Later("V", 64, 4095, 32000, (0.0025, 0.0035)),
    Later("W", 64, 4300, 8000, (0.004, 0.008)),
    Later("W", 64, 4300, 8000, (0.012, 0.016, 0.020, 0.024), label="wider"),
    Later("W", 64, 4250, 16000, (0.004, 0.008)),
)
PREDICTED = (  # name, T, N l, N
    *(("A", 5, 1000, number) for number in (250, 500, 1000, 1500, 2000, 4000, 8000)),
    *(("B", 7, 1000, number) for number in (1000, 4000, 16000)),
    *(("C", 10, 1000, number) for number in (1000, 4000)),
    *(("D", 28, 4000, number) for number in (1000, 2000, 4000, 8000)),
    ("U", 64, 4200, 16000),
    ("V", 64, 4272, 4000), ("V", 64, 4169, 8000), ("V", 64, 4120, 16000),
    ("V", 64, 4095, 32000),
    ("W", 64, 4300, 8000), ("W", 64, 4250, 16000),
)  # fmt: skip
DIRECTED = (  # name, T, N l, N, w'
    *(("D", 28, 4000, 8000, width) for width in (0.058, 0.060, 0.064, 0.070, 0.072)),
    *(("A", 5, 1000, 1000, width) for width in (0.0276, 0.0280, 0.0284)),
    ("V", 64, 4169, 8000, 0.004), ("W", 64, 4300, 8000, 0.008), ("D", 28, 4000, 4000, 0.068),
    ("B", 7, 1000, 4000, 0.054), ("U", 64, 4200, 16000, 0.015), ("W", 64, 4300, 8000, 0.004),
    ("V", 64, 4120, 16000, 0.002), ("V", 64, 4120, 16000, 0.006),
)  # fmt: skip
DISCS = (("L7", 7, 1000, 4000, 0.016), ("L28", 28, 4000, 4000, 0.012))
SCALED = {"A": (250, 500, 1000), "D": (1000, 2000, 4000)}  # N of the fits of barriers
CROSSED = ("B", "C")
LEFT = (("W", 64, 4300, 8000), ("W", 64, 4250, 16000))  # and at which w':
LEFT_AT = (0.004, 0.008)


def text(value: object) -> str:
    """Return a number with four digits (a whole one with all), anything else as it is."""
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e6:
        return str(int(value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def read(work: Study, name: str) -> list[Row]:
    """Return the lines of a table of this study: of these runs, else the one beside the page."""
    path = work.folder / f"{name}.csv"
    with (path if path.exists() else HERE / f"{name}.csv").open(encoding="utf-8") as file:
        return [{key: _number(value) for key, value in row.items()} for row in csv.DictReader(file)]


def _number(value: str) -> object:
    try:
        return float(value)
    except ValueError:
        return value


def runs_of(work: Study, own: Later) -> list[Row]:
    """Make the runs of one circuit; return a line for each run."""
    groups: dict[str, dict[str, object]] = {
        "table": {"channel1_width": WIDTH, "channel1_length": own.reach / own.number},
        "particles": {"number": own.number, "seed": 2810},
        "gate": {"threshold": own.threshold},
        "run": {
            "duration": TRANSIENT + own.times * work.pick(0.1 * LENGTH, LENGTH),
            "transient_duration": TRANSIENT,
        },
        "scan": {"replicas": int(work.pick(2, 6)), "urn1_fraction": list(STARTS),
                 "channel2_width": list(own.widths)},
        "output": {"series_interval": INTERVAL},
    }  # fmt: skip
    made = work.run(groups, f"{own.name}_{own.number}_{own.label}")
    series, found = postproc.open_results(made, group="series"), []
    times = series.time.to_numpy()
    for place, width in enumerate(own.widths):
        at = series.isel({"channel2_width": place}, missing_dims="ignore")
        spread = 2.0 * at.urn1_number.transpose("urn1_fraction", "replica", "time").to_numpy()
        spread = spread / own.number - 1.0
        late = spread[:, :, times >= TRANSIENT][:, :, :-1]  # the last may be missing
        chi = np.abs(late)
        memory = samples.correlation_time(chi.reshape(-1, chi.shape[-1]), INTERVAL)
        for start, share in enumerate(STARTS):
            for replica, m in enumerate(late[start]):
                whole = np.abs(spread[start, replica, :-1])
                left = samples.left_at(whole, times[:-1], 2.0 * share - 1.0)
                row = [own.name, own.threshold, own.number, own.reach / own.number, width,
                       own.times, share, replica, float(np.abs(m).mean()), float((m**2).mean()),
                       float((m**4).mean()), samples.passages(np.abs(m)), left, memory,
                       *(int(one) for one in samples.histogram(m))]  # fmt: skip
                found.append(dict(zip(RUN_FIELDS, row, strict=True)))
    return found


def runs(work: Study) -> None:
    """Make all later runs; write runs.csv."""
    found = [row for own in LATER if work.full or own.number <= 1000 for row in runs_of(work, own)]
    work.table("runs", RUN_FIELDS, [[text(row[key]) for key in RUN_FIELDS] for row in found])


def _key(run: Row) -> Key:
    return run["circuit"], run["N"], run["w'"]


def _cumulant(sums: Floats) -> Floats:
    """Return Binder's cumulant of sums of <m^2>, <m^4> and 1 over runs, shape (sample, 3)."""
    second, fourth = (sums[:, :2] / sums[:, 2:]).T
    return 1.0 - fourth / (3.0 * second**2)


def widths_of(found: list[Row]) -> list[Row]:
    """Return one line for each circuit, N and w' of runs.csv, and their errors over runs."""
    table: list[Row] = []
    by_key: dict[Key, list[Row]] = {}
    for one in found:
        by_key.setdefault(_key(one), []).append(one)
    for (name, number, width), own in by_key.items():
        row: Row = {"circuit": name, "T": own[0]["T"], "N": number, "l": own[0]["l"], "w'": width}
        for share, label in zip(STARTS, ("equal", "full"), strict=True):
            mine = [one for one in own if one["start"] == share]
            chi = np.array([one["chi"] for one in mine])
            row[f"chi_{label}"], row[f"chi_{label}_error"] = samples.with_error(chi)
            row[f"kept_{label}"] = sum(math.isnan(one["left at"]) for one in mine)
        counts = np.array([[one[key] for key in BINS] for one in own])
        moments = np.array([[one["m2"], one["m4"], 1.0] for one in own])
        deep = samples.bootstrap(samples.barrier, counts)
        low = samples.bootstrap(_cumulant, moments)
        row |= {"cumulant": low.value, "cumulant_error": low.error, "barrier": deep.value,
                "barrier_error": deep.error, "barrier_bias": deep.bias,
                "passages": int(sum(one["passages"] for one in own)),
                "correlation_time": own[0]["correlation time"], "runs": len(own)}  # fmt: skip
        table.append(row)
    return table


def sizes_of(found: list[Row], table: list[Row], predicted: list[Row]) -> list[Row]:
    """Return one line for each circuit and N: barrier, least cumulant and equal weight."""
    sizes: list[Row] = []
    for name, number in dict.fromkeys((one["circuit"], one["N"]) for one in table):
        own = sorted((one for one in table if one["circuit"] == name and one["N"] == number),
                     key=lambda one: one["w'"])  # fmt: skip
        told = next(one for one in predicted if one["circuit"] == name and one["N"] == number)
        # so that weights are not those of the starts; fewer passages: no barrier is given
        turns = [one for one in own if one["passages"] >= PASSED * one["runs"]]
        deep = max(turns, key=lambda one: one["barrier"], default=NOTHING)
        low = min(own, key=lambda one: one["cumulant"])
        row = {"circuit": name, "T": own[0]["T"], "N": number, "barrier": deep["barrier"],
               "barrier_error": deep["barrier_error"], "barrier_bias": deep["barrier_bias"],
               "barrier_at": deep["w'"], "barrier_edge": _edge(deep, own),
               "passages": deep["passages"], "predicted, channels": told["barrier"],
               "cumulant": low["cumulant"], "cumulant_error": low["cumulant_error"],
               "cumulant_at": low["w'"], "cumulant_edge": _edge(low, own)}  # fmt: skip
        row |= dict.fromkeys(("equal", "equal_error", "barrier_equal", "mode_equal"), math.nan)
        row |= {"equal, channels": told["w' equal"], "jump, channels": told["jump"]}
        if deep["barrier"] > SIGNIFICANT * deep["barrier_error"]:
            width = np.array([one["w'"] for one in turns])
            counts = np.array([
                [[one[key] for key in BINS] for one in found if _key(one) == (name, number, at)]
                for at in width
            ])  # fmt: skip
            half = samples.bootstrap(
                lambda sums, width=width: np.array(
                    [samples.equal_weight(width, one) for one in sums]
                ),
                counts.transpose(1, 0, 2),
            )
            modes = [samples.upper_mode(one.sum(axis=0)) for one in counts]
            row |= {"equal": half.value, "equal_error": half.error,
                    "barrier_equal": _between(half.value, width, turns),
                    "mode_equal": float(np.interp(half.value, width, modes))}  # fmt: skip
        sizes.append(row)
    return sizes


def _between(at: float, width: Floats, rows: list[Row]) -> float:
    return float(np.interp(at, width, [one["barrier"] for one in rows]))


def _edge(one: Row, own: list[Row]) -> str:
    """Return whether a width is the first or last of those that were run."""
    if one not in own:
        return "none"
    return {0: "first", len(own) - 1: "last"}.get(own.index(one), "within")


def lines_of(sizes: list[Row]) -> list[Row]:
    """Return straight lines through barriers over N."""
    found: list[Row] = []
    for name, numbers in SCALED.items():
        own = [one for one in sizes if one["circuit"] == name and one["N"] in numbers]
        if len(own) < 3:
            continue
        count = [one["N"] for one in own]
        fit = samples.line(count, [one["barrier"] for one in own],
                           [one["barrier_error"] for one in own])  # fmt: skip
        told = samples.line(count, [one["predicted, channels"] for one in own], np.ones(len(own)))
        found.append({"circuit": name, "N": " ".join(f"{one:.0f}" for one in count),
                      "slope": fit.slope, "slope_error": fit.slope_error, "at 0": fit.height,
                      "at 0, error": fit.height_error, "chi squared": fit.misfit,
                      "freedoms": len(own) - 2, "slope predicted": told.slope,
                      "ratio": fit.slope / told.slope,
                      "ratio_error": fit.slope_error / told.slope})  # fmt: skip
    return found


def crossings_of(results: list[Row]) -> list[Row]:
    """Return where the cumulants of both N of B and C cross, by the first runs' table."""
    found: list[Row] = []
    for name in CROSSED:
        own = [one for one in results if one["circuit"] == name]
        numbers = sorted({one["N"] for one in own})
        width = np.array(sorted({one["w'"] for one in own}))
        cumulants, chi = (np.empty((2, width.size, 2)) for _ in range(2))
        for one in own:
            at = numbers.index(one["N"]), int(np.flatnonzero(width == one["w'"])[0])
            cumulants[at] = one["cumulant"], one["cumulant_error"]
            chi[at] = (0.5 * (one["chi_equal"] + one["chi_full"]),
                       0.5 * math.hypot(one["chi_equal_error"], one["chi_full_error"]))  # fmt: skip
        there = samples.crossing(width, tuple(numbers), cumulants, chi)
        found.append({
            "circuit": name, "w'": there.width[0], "w' error": there.width[1],
            "cumulant": there.cumulant[0], "cumulant_error": there.cumulant[1],
            "exponent": there.exponent[0], "exponent_error": there.exponent[1],
            "m^4: cumulant": samples.mean_field_cumulant(4), "m^4: exponent": 1 / 4,
            "m^6: cumulant": samples.mean_field_cumulant(6), "m^6: exponent": 1 / 6,
        })  # fmt: skip
    return found


def leaving_of(found: list[Row]) -> list[Row]:
    """Return what should keep equal urns within the second range, and when runs left them."""
    table: list[Row] = []
    for name, threshold, reach, number in LEFT:
        for width in LEFT_AT:
            own = channels.weight(channels.circuit(threshold, reach, number, width))
            wall, mode, _ = own.wells
            times = [one["left at"] for one in found
                     if (*_key(one), one["start"]) == (name, number, width, STARTS[0])]  # fmt: skip
            table.append({"circuit": name, "N": number, "w'": width,
                          "barrier predicted": -float(own.log[wall]),
                          "chi predicted": float(own.spread[mode]),
                          "first left at": min(times), "last left at": max(times),
                          "runs": len(times)})  # fmt: skip
    return table


def predicted(work: Study) -> None:
    """Write finite.csv: the prediction with particles in the channels, for each N."""
    found: list[Row] = []
    for name, threshold, reach, number in PREDICTED:
        one = channels.finite(threshold, reach, number)
        found.append({
            "circuit": name, "T": threshold, "N": number, "N l": reach, "x/T": one.load / threshold,
            "w' homogeneous from": one.homogeneous, "w' equal": one.equal,
            "w' polarised to": one.polarised, "jump": one.jump, "barrier": one.barrier,
            "barrier at": one.barrier_at,
        })  # fmt: skip
    for name, threshold, reach, number, radius in DISCS:
        own = channels.load_with_discs(threshold, reach, number, radius) / threshold
        found.append(dict.fromkeys(found[0], math.nan)
                     | {"circuit": name, "T": threshold, "N": number, "N l": reach, "x/T": own})
    _table(work, "finite", found)


def directions(work: Study) -> None:
    """Write directions.csv: what the theory with memory of directions has, at single widths."""
    found: list[Row] = []
    for name, threshold, reach, number, width in DIRECTED:
        one = channels.directed(channels.circuit(threshold, reach, number, width))
        found.append({
            "circuit": name, "T": threshold, "N": number, "w'": width,
            "homogeneous": one.homogeneous, "chi unstable": one.unstable, "chi stable": one.stable,
            "barrier": one.barrier, "gain": one.gain,
        })  # fmt: skip
        _table(work, "directions", found)


def tables(work: Study) -> None:
    """Write later.csv, later_sizes.csv, barrier_lines.csv, crossings.csv, leaving.csv."""
    found = read(work, "runs")
    table = widths_of(found)
    sizes = sizes_of(found, table, read(work, "finite"))
    _table(work, "later", table)
    _table(work, "later_sizes", sizes)
    lines = lines_of(sizes)
    if lines:
        _table(work, "barrier_lines", lines)
    _table(work, "crossings", crossings_of(read(work, "results")))
    if work.full:
        _table(work, "leaving", leaving_of(found))


def _table(work: Study, name: str, rows: Sequence[Row]) -> None:
    work.table(name, list(rows[0]), [[text(one) for one in row.values()] for row in rows])

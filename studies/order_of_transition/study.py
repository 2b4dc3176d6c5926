"""The order of the transition: histograms of chi, barriers, cumulants and hysteresis against N.

Runs circuits of one T and one N l at several N (l is shortened as N grows), over w', from equal
urns and from one nearly full; and the Lorentz circuit, T = 7 and 28. Parts, in this order:

    before      predictions.csv, ranges.csv: all particles in the urns; known before any run
    first       long.csv, lorentz.csv, results.csv, sizes.csv: the first runs
    predicted   finite.csv: with particles in the channels, for each N; no runs
    directions  directions.csv: the theory with memory of directions; no runs
    runs        runs.csv: later runs, with the histogram of each of them
    tables      later.csv, later_sizes.csv, barrier_lines.csv, crossings.csv, leaving.csv: no runs
    picture     order_of_transition.png, from tables

A part that needs a table that was not made takes the one beside the page. Quick: two replicas from
either start, N up to 4000 (later runs: 1000), some minutes of a core.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc import study
from studies.order_of_transition import later, picture, prediction
from studies.order_of_transition.samples import (
    HIGH,
    LOW,
    barrier,
    cumulant,
    histogram,
    jackknife,
    with_error,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Row = dict[str, object]

STARTS, INTERVAL, TRANSIENT, LONGER = later.STARTS, later.INTERVAL, later.TRANSIENT, later.LONG
HALFWAY = 0.3  # chi, at which the transition is said to be
MANY = 4000  # N: of the Lorentz circuit, and the most of a quick study
WIDE = 0.2  # w' of the Lorentz circuit
PARTED = 0.3  # difference of chi from both starts that is hysteresis
THRESHOLDS = (2, 4, 7, 10, 14, 28, 40, 48, 56, 64, 80, 100)
RATIOS = np.arange(0.6, 3.5, 0.01)


@dataclass(frozen=True)
class Case:
    """One T and one N l, so one load; w' that are run.

    Attributes
    ----------
    threshold : T.
    reach : N l.
    widths : of channel 2.
    numbers : N.
    """

    threshold: int
    reach: float
    widths: tuple[float, ...]
    numbers: tuple[int, ...]

    @property
    def load(self) -> float:
        """Return x, all particles in the urns: those in the channels are left out (`channels`)."""
        return float(self.reach * prediction.LOAD_PER_REACH)


def _widths(first: float, last: float, step: float) -> tuple[float, ...]:
    return tuple(float(one) for one in np.arange(first, last + 0.5 * step, step).round(6))


CASES = {
    "A": Case(5, 1000, _widths(0.018, 0.034, 0.0016), (500, 1000, 2000, 4000, 8000)),
    "D": Case(28, 4000, _widths(0.058, 0.074, 0.002), (1000, 2000, 4000, 8000)),
    "B": Case(7, 1000, _widths(0.050, 0.062, 0.0024), (1000, 4000)),
    "C": Case(10, 1000, _widths(0.080, 0.100, 0.005), (1000, 4000)),
    "V": Case(64, 4120, (0.004,), (16000,)),
    "U": Case(64, 4200, (0.015,), (16000,)),
}
# Where both states take turns: long runs of few particles, for barriers and cumulants.
LONG = {"A": Case(5, 1000, (0.0284, 0.0292, 0.0300), (250, 500, 1000, 1500))}
RADII = {7: (0.012, 0.013, 0.014, 0.015, 0.016), 28: (0.012, 0.013)}  # by T
NOTHING = dict.fromkeys(("barrier", "barrier_error", "w'"), math.nan)
FIELDS = ("circuit", "T", "N", "l", "w'", "chi_equal", "chi_equal_error", "chi_full",
          "chi_full_error", "cumulant", "cumulant_error", "barrier", "barrier_error",
          "crossed", "runs")  # fmt: skip


def rows_of(
    work: study.Study, name: str, case: Case, number: int, *, discs: float | None = None,
    times: float = 1.0, label: str = "",
) -> list[Row]:  # fmt: skip
    """Run one circuit at one N, over w' and both starts; return a row for each w'.

    Parameters
    ----------
    work, name, case, number : what is run.
    discs : radius of those in channel 2; None: there are none.
    times : as long as others.
    label : of the runs' files.
    """
    length = case.reach / number
    replicas, duration = int(work.pick(2, 6)), times * work.pick(1e4, 2e4)
    groups: dict[str, dict[str, object]] = {
        "table": {"channel1_width": prediction.WIDTH, "channel1_length": length},
        "particles": {"number": number, "seed": 2810},
        "gate": {"threshold": case.threshold},
        "run": {"duration": TRANSIENT + duration, "transient_duration": TRANSIENT},
        "scan": {"replicas": replicas, "urn1_fraction": list(STARTS)},
        "output": {"series_interval": INTERVAL},
    }
    if discs is None:
        groups["scan"]["channel2_width"] = list(case.widths)
    else:
        groups["table"] |= {"channel2_width": case.widths[0], "scatterers": lattice(discs)}
    made = work.run(groups, f"{name}_{number}{label}")
    whole, series = (postproc.open_results(made, group=group) for group in (None, "series"))
    rows: list[Row] = []
    for place, width in enumerate(case.widths):
        row: Row = {"circuit": name, "T": case.threshold, "N": number, "l": length, "w'": width}
        runs, crossed = [], 0
        for start, kept in enumerate(("chi_equal", "chi_full")):
            at = {"urn1_fraction": start, "channel2_width": place}
            row[kept], row[f"{kept}_error"] = with_error(
                whole.chi.isel(at, missing_dims="ignore").to_numpy()
            )
            looks = series.isel(at, missing_dims="ignore")
            spread = 2.0 * looks.urn1_number.to_numpy() / number - 1.0
            late = spread[:, looks.time.to_numpy() >= TRANSIENT][:, :-1]  # the last may be missing
            runs += list(late)
            chi = np.abs(late)
            both = (chi.min(axis=1) < LOW) & (chi.max(axis=1) > HIGH)
            crossed += int(both.sum())
        row["cumulant"], row["cumulant_error"] = jackknife(cumulant, runs)
        row["barrier"], row["barrier_error"] = jackknife(
            lambda one: float(barrier(histogram(one))), runs
        )
        row["crossed"], row["runs"] = crossed, len(runs)
        row["counts"] = histogram(np.concatenate(runs))
        rows.append(row)
    return rows


def lattice(radius: float) -> list[float]:
    """Return z, y, radius of the 15 discs of the Lorentz circuit: six columns, by turns 2 and 3."""
    found: list[float] = []
    for column in range(6):
        heights = (-0.25, 0.25) if column % 2 == 0 else (-0.5, 0.0, 0.5)
        for height in heights:
            found += [round((column + 0.5) / 6 - 0.5, 9), round(height * WIDE, 9), radius]
    return found


def predictions(work: study.Study) -> None:
    """Write what the gate's rule says of each circuit, and where the line is of first order."""
    found = {name: prediction.transition(case.threshold, case.load) for name, case in CASES.items()}
    rows = []
    for name, case in CASES.items():
        own = found[name]
        heights = (own.homogeneous, own.equal, own.polarised)
        chains = [(number, *prediction.chain(case.threshold, case.load, number, own))
                  for number in case.numbers]  # fmt: skip
        rows += [
            [name, case.threshold, number, later.text(case.load / case.threshold),
             *(later.text(one) for one in heights),
             *(later.text(prediction.width_of(one)) for one in heights),
             *(later.text(one) for one in (own.jump, own.barrier * number, deepest, lowest))]
            for number, deepest, lowest in chains
        ]  # fmt: skip
    head = ["circuit", "T", "N", "x/T", "k(0)", "k equal", "k largest", "w' of k(0)", "w' equal",
            "w' largest", "jump", "barrier", "barrier, chain", "least cumulant, chain"]  # fmt: skip
    work.table("predictions", head, rows)
    rows = [
        [str(threshold), *(f"{one:.4g}" for one in span)]
        for threshold in THRESHOLDS
        for span in prediction.ranges(threshold, RATIOS)
    ]
    work.table("ranges", ["T", "x/T from", "x/T to", "w'/w from", "w'/w to"], rows)


def sizes(rows: list[Row]) -> list[Row]:
    """Return for each circuit and N barrier, cumulant, hysteresis, jump and where they are."""
    found: list[Row] = []
    for name, number in dict.fromkeys((row["circuit"], row["N"]) for row in rows):
        own = [row for row in rows if row["circuit"] == name and row["N"] == number]
        # where the runs are one distribution, whatever their start
        turns = [row for row in own if 2 * row["crossed"] >= row["runs"]]
        deep = max(turns, key=lambda row: row["barrier"], default=NOTHING)
        low = min(own, key=lambda row: row["cumulant"])
        chi = np.array([row["chi_full"] for row in own])
        width = np.array([row["w'"] for row in own])
        parted = [row["w'"] for row in own if row["chi_full"] - row["chi_equal"] > PARTED]
        falls = np.flatnonzero((chi[:-1] >= HALFWAY) & (chi[1:] < HALFWAY))
        if falls.size:
            at = falls[-1]
            middle = np.interp(-HALFWAY, -chi[at : at + 2], width[at : at + 2])
        found.append({
            "circuit": name, "T": own[0]["T"], "N": number,
            "barrier": deep["barrier"], "barrier_error": deep["barrier_error"],
            "barrier_at": deep["w'"], "cumulant": low["cumulant"],
            "cumulant_error": low["cumulant_error"], "cumulant_at": low["w'"],
            "hysteresis_from": min(parted, default=math.nan),
            "hysteresis_to": max(parted, default=math.nan),
            "half": float(middle) if falls.size else math.nan,
        })  # fmt: skip
    return found


def first(work: study.Study) -> None:
    """Make the first runs and their tables."""
    long = [row for name, case in LONG.items() for number in case.numbers
            for row in rows_of(work, name, case, number, times=LONGER, label="_long")]  # fmt: skip
    work.table("long", FIELDS, _texts(long, FIELDS))
    discs = [
        {"radius": radius, **row}
        for name, threshold, reach in (("L7", 7, 1000), ("L28", 28, 4000))
        for radius in RADII[threshold]
        for row in rows_of(work, name, Case(threshold, reach, (WIDE,), (MANY,)), MANY,
                           discs=radius, label=f"_{radius:g}")
    ]  # fmt: skip
    work.table("lorentz", ("radius", *FIELDS), _texts(discs, ("radius", *FIELDS)))
    rows = [
        row for name, case in CASES.items() for number in case.numbers
        if work.full or number <= MANY for row in rows_of(work, name, case, number)
    ]  # fmt: skip
    work.table("results", FIELDS, _texts(rows, FIELDS))
    table = sizes(rows)
    work.table("sizes", list(table[0]), _texts(table, list(table[0])))


PARTS = {
    "before": predictions, "first": first, "predicted": later.predicted,
    "directions": later.directions, "runs": later.runs, "tables": later.tables,
    "picture": picture.draw,
}  # fmt: skip


def _texts(rows: list[Row], fields: Sequence[str]) -> list[list[str]]:
    return [[later.text(row[key]) for key in fields] for row in rows]


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, PARTS))

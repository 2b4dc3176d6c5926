"""The order of the transition: histograms of chi, barriers, cumulants and hysteresis against N.

Runs circuits of one T and one load at several N (l is shortened as N grows), over w', from equal
urns and from one nearly full; and the Lorentz circuit at one load, T = 7 and 28. Writes
predictions.csv and ranges.csv before any run, then long.csv, lorentz.csv, results.csv, sizes.csv
and order_of_transition.png, into build/order_of_transition/quick, or full. Quick: two replicas from
either start, N up to 4000, some minutes of a core.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc import study
from postproc.figures import style
from studies.order_of_transition import prediction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Row = dict[str, object]

STARTS = (0.5, 0.95)
INTERVAL = 20.0  # time between two records
TRANSIENT = 5000.0  # directions relax in 25/w^3 = 900
BINS = np.linspace(0.0, 1.0, 26)  # of |m|
LOW, HIGH = 0.15, 0.4  # chi: a run with values below and above has crossed
HALFWAY = 0.3  # chi that defines the transition
MANY = 4000  # N of the Lorentz circuit, and largest N of a quick study
LONGER = 8.0
WIDE = 0.2  # w' of the Lorentz circuit
PARTED = 0.3  # least difference of chi from both starts for hysteresis
THRESHOLDS = (2, 4, 7, 10, 14, 28, 40, 48, 56, 64, 80, 100)
RATIOS = np.arange(0.6, 3.5, 0.01)


@dataclass(frozen=True)
class Case:
    """One T and one N l, so one load, and the w' of runs.

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
        """Return x, of well mixed urns with a narrow channel 2."""
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
# Where both states alternate: long runs of few particles, for barriers and cumulants.
LONG = {"A": Case(5, 1000, (0.0284, 0.0292, 0.0300), (250, 500, 1000, 1500))}
RADII = {7: (0.012, 0.013, 0.014, 0.015, 0.016), 28: (0.012, 0.013)}  # by T
NOTHING = dict.fromkeys(("barrier", "barrier_error", "w'"), math.nan)
FIELDS = ("circuit", "T", "N", "l", "w'", "chi_equal", "chi_equal_error", "chi_full",
          "chi_full_error", "cumulant", "cumulant_error", "barrier", "barrier_error",
          "crossed", "runs")  # fmt: skip


def histogram(spread: Floats) -> Floats:
    """Return the histogram of |m| in `BINS`."""
    return np.histogram(np.abs(spread), BINS)[0].astype(float)


def barrier(counts: Floats) -> float:
    """Return the log of the deepest minimum between two modes, below the lower mode; 0: one mode.

    An empty bin counts 1/2.
    """
    filled = np.maximum(counts, 0.5)
    left, right = np.maximum.accumulate(filled), np.maximum.accumulate(filled[::-1])[::-1]
    return float(np.log(np.minimum(left, right) / filled).max())


def cumulant(spread: Floats) -> float:
    """Return Binder's cumulant, 1 - <m^4>/(3 <m^2>^2)."""
    return float(1.0 - (spread**4).mean() / (3.0 * (spread**2).mean() ** 2))


def with_error(values: Floats) -> tuple[float, float]:
    """Return mean and standard error over replicas."""
    return float(values.mean()), float(values.std(ddof=1) / math.sqrt(values.size))


def jackknife(function: Callable[[Floats], float], runs: list[Floats]) -> tuple[float, float]:
    """Return a function of all runs together, and its error by leaving out one run at a time."""
    count = len(runs)
    left = [function(np.concatenate(runs[:k] + runs[k + 1 :])) for k in range(count)]
    return function(np.concatenate(runs)), math.sqrt((count - 1) * np.var(left))


def rows_of(
    work: study.Study, name: str, case: Case, number: int, *, discs: float | None = None,
    times: float = 1.0, label: str = "",
) -> list[Row]:  # fmt: skip
    """Run one circuit at one N, over w' and both starts; return a row for each w'.

    Parameters
    ----------
    work, name, case, number : study, circuit and N.
    discs : radius of the discs in channel 2; None: there are none.
    times : factor of the duration.
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
        for start, column in enumerate(("chi_equal", "chi_full")):
            at = {"urn1_fraction": start, "channel2_width": place}
            row[column], row[f"{column}_error"] = with_error(
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
        row["barrier"], row["barrier_error"] = jackknife(lambda one: barrier(histogram(one)), runs)
        row["crossed"], row["runs"] = crossed, len(runs)
        row["counts"] = histogram(np.concatenate(runs))
        rows.append(row)
    return rows


def lattice(radius: float) -> list[float]:
    """Return z, y, radius of the 15 discs of the Lorentz circuit: columns of 2 and 3 alternate."""
    found: list[float] = []
    for column in range(6):
        heights = (-0.25, 0.25) if column % 2 == 0 else (-0.5, 0.0, 0.5)
        for height in heights:
            found += [round((column + 0.5) / 6 - 0.5, 9), round(height * WIDE, 9), radius]
    return found


def predictions(work: study.Study) -> dict[str, prediction.Transition]:
    """Write the predictions for each circuit, and where the transition is of first order."""
    found = {name: prediction.transition(case.threshold, case.load) for name, case in CASES.items()}
    rows = []
    for name, case in CASES.items():
        own = found[name]
        heights = (own.homogeneous, own.equal, own.polarised)
        chains = [(number, *prediction.chain(case.threshold, case.load, number, own))
                  for number in case.numbers]  # fmt: skip
        rows += [
            [name, case.threshold, number, _text(case.load / case.threshold),
             *(_text(one) for one in heights),
             *(_text(prediction.width_of(one)) for one in heights),
             _text(own.jump), _text(own.barrier * number), _text(deepest), _text(lowest)]
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
    return found


def sizes(rows: list[Row]) -> list[Row]:
    """Return for each circuit and N barrier, cumulant, hysteresis, jump and their w'."""
    found: list[Row] = []
    for name, number in dict.fromkeys((row["circuit"], row["N"]) for row in rows):
        own = [row for row in rows if row["circuit"] == name and row["N"] == number]
        # where the distribution does not depend on the start
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


def figure(rows: list[Row], long: list[Row], shown: dict[str, prediction.Transition]) -> Figure:
    """Return chi over w' of four circuits, histograms of one of them, and barriers over N."""
    made = style.figure(style.PAGE, 5.0)
    panels = made.subplots(2, 3)
    for axes, name in zip(panels.flat, "ABCD", strict=False):
        case = CASES[name]
        for place, number in enumerate(case.numbers):
            own = [row for row in rows if row["circuit"] == name and row["N"] == number]
            for label, look in (("chi_equal", "-o"), ("chi_full", "--s")):
                axes.plot([row["w'"] for row in own], [row[label] for row in own], look, ms=2.5,
                          lw=0.9, mfc="none", color=f"C{place}",
                          label=f"N = {number}" if look == "-o" and own else None)  # fmt: skip
        for k, dashes in ((shown[name].homogeneous, ":"), (shown[name].polarised, "-.")):
            axes.axvline(prediction.width_of(k), color="black", lw=0.8, ls=dashes)
        title = f"{name}: T = {case.threshold}, x = {case.load / case.threshold:.2f} T"
        axes.set(xlabel="w'/r", ylabel=r"$\chi$", ylim=(0, 1), title=title)
        axes.legend(fontsize=6, frameon=False)
    shares, depth = panels.flat[4:]
    middles = 0.5 * (BINS[:-1] + BINS[1:])
    for place, number in enumerate(LONG["A"].numbers):
        own = [row for row in long if row["N"] == number]
        row = max(own, key=lambda one: one["barrier"])
        density = row["counts"] / row["counts"].sum() / BINS[1]
        shares.semilogy(middles, density, lw=1.0, color=f"C{place}", label=f"N = {number}")
    shares.set(xlabel=r"$\chi$", ylabel="density", title="A: both states take turns")
    shares.legend(fontsize=6, frameon=False)
    for table, name, colour in ((sizes(long), "A", "C0"), (sizes(rows), "D", "C1")):
        own = [row for row in table if row["circuit"] == name and row["barrier"] >= 0.0]
        number = [row["N"] for row in own]
        error = [row["barrier_error"] for row in own]
        depth.errorbar(number, [row["barrier"] for row in own], error, fmt="o-", ms=3, lw=0.9,
                       color=colour, label=name)  # fmt: skip
        depth.plot(number, [shown[name].barrier * one for one in number], ":", color=colour)
    depth.set(xlabel="N", ylabel="barrier of log density", title="dotted: predicted")
    depth.legend(fontsize=6, frameon=False)
    return made


def run(work: study.Study) -> None:
    """Make all tables and pictures of the page."""
    shown = predictions(work)
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
    work.draw(figure(rows, long, shown), "order_of_transition")


def _texts(rows: list[Row], fields: Sequence[str]) -> list[list[str]]:
    return [[_text(row[key]) for key in fields] for row in rows]


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

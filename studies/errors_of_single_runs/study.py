"""Accuracy of the errors of single runs: tables and picture of the page in this folder.

Many runs of the same circuit and length, each with its own standard error, against their scatter.
The table has for each circuit, quantity and length: in how many runs the error is known (`told`),
the median of these errors over the true one, and how often the mean over all runs is within one and
two of them. Another table has the scatter of the net current at the reference point by the length
of a run. Prints first the correlation time of the current there, and the length for 1 %.
Quick: 40 runs of up to 37,000 time units, three minutes of a core; --full: half an hour.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc.figures import style
from studies.common import study
from studies.errors_of_single_runs.scatter import by_length, length_for_goal

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Found = dict[str, dict[float, dict[str, dict[str, float]]]]

REPLICAS = 200
ENOUGH = 0.5  # least share of runs with an error for a comparison
ASKED = (0.60, 0.76)  # expected share of runs within one error, drawn as a band
INTERVAL = 1000.0  # of the series for the correlation time
TRANSIENT = 2800.0  # three relaxation times of directions, 25 r^4/w^3
CORNERS = [-1.0, -0.4, 0.2, -1.15, 1.0, -0.55, 1.0, 0.45, -0.15, 1.05, -1.0, 0.5]  # crooked
# Parameters of each circuit besides w = 0.3, w' = 0.01, N = 1000, and the lengths of its runs.
LENGTHS = (18_500.0, 37_000.0, 75_000.0)
CIRCUITS: dict[str, tuple[int, dict[str, object], tuple[float, ...]]] = {
    "T = 7": (7, {}, (*LENGTHS, 150_000.0, 400_000.0)),
    "beside a transition, T = 16": (16, {}, (*LENGTHS, 150_000.0)),
    "free, T = 1000": (1000, {}, LENGTHS),
    "crooked hexagons, T = 7": (
        7, {"urn_shape": "polygon", "urn_vertices": CORNERS}, LENGTHS,
    ),
    "regular hexagons, T = 7": (7, {"urn_shape": "polygon", "urn_sides": 6}, LENGTHS[:1]),
}  # fmt: skip
QUANTITIES = ("chi", "polarised_current", "current1")
LABELS = dict(zip(QUANTITIES, ("chi", "polarised current", "current 1"), strict=True))


def held(values: Floats, errors: Floats) -> dict[str, float]:
    """Compare the errors of runs with the scatter of their averages.

    Parameters
    ----------
    values, errors : average and its own standard error of each run; NaN: the error is not known.

    Returns
    -------
    dict
        `told`: share of the runs that have an error; `true`: standard deviation of all averages;
        `ratio`: median of the errors over that; `one`, `two`: share of runs with an error that are
        within one and two errors of the mean of all. NaN if no run has an error.
    """
    known = np.isfinite(errors)
    off = np.abs(values - values.mean())[known] / errors[known]
    true = values.std(ddof=1)
    found = {"told": known.mean(), "true": true, "ratio": np.nan, "one": np.nan, "two": np.nan}
    if known.any():
        ratio = np.median(errors[known]) / true
        found |= {"ratio": ratio, "one": np.mean(off < 1.0), "two": np.mean(off < 2.0)}
    return {name: float(value) for name, value in found.items()}


def decay_time(values: Floats, interval: float, lags: tuple[int, int]) -> float:
    """Return the time in which an autocovariance falls by e, fitted between two lags.

    Parameters
    ----------
    values : series of runs, shape (run, time); fluctuations are about the mean at the same time.
    interval : time from one value to the next.
    lags : first and last lag of the fit, in intervals.
    """
    off = values - values.mean(axis=0)
    size = off.shape[1]
    lag = np.arange(lags[0], lags[1] + 1)
    together = [np.mean(off[:, : size - one] * off[:, one:]) for one in lag]
    return float(-interval / np.polyfit(lag, np.log(together), 1)[0])


def runs(
    work: study.Study, name: str, threshold: int, table: dict[str, object], length: float,
    replicas: int, series_interval: float = 0.0,
) -> Path:  # fmt: skip
    """Return the results file of runs of a length after the transient."""
    groups = {
        "table": {"channel1_width": 0.3, "channel2_width": 0.01, **table},
        "particles": {"number": 1000},
        "gate": {"threshold": threshold},
        "run": {"duration": TRANSIENT + length, "transient_duration": TRANSIENT},
        "scan": {"replicas": replicas},
        "output": {"series_interval": series_interval},
    }
    return work.run(groups, name)


def measure(
    work: study.Study, name: str, threshold: int, table: dict[str, object], length: float
) -> dict[str, dict[str, float]]:
    """Return `held` of each quantity, for runs of a length after the transient."""
    replicas = int(work.pick(40, REPLICAS))
    data = postproc.open_results(runs(work, name, threshold, table, length, replicas))
    return {
        name: held(data[name].values.ravel(), data[f"{name}_error"].values.ravel())
        for name in QUANTITIES
    }


def reference_currents(work: study.Study, length: float, replicas: int) -> Floats:
    """Return the series of the net current at T = 7, shape (run, time), an entry an `INTERVAL`.

    The polarity does not change, so it is the absolute current.
    """
    name = f"series_{length:.0f}"
    path = runs(work, name, 7, {}, length, replicas, INTERVAL)
    data = postproc.open_results(path, group="series")
    current = np.abs(data["flow2_12"] - data["flow2_21"]).transpose("replica", "time").values
    return current[:, int(TRANSIENT / INTERVAL) + 1 : -1]


def scatter(work: study.Study) -> None:
    """Write the table of the scatter of the net current; print the lengths for 1 %."""
    currents = reference_currents(work, 1.0e6, int(work.pick(24, 64)))
    rows, mean = by_length(currents, INTERVAL), float(currents.mean())
    names = ("deviation", "half_width")
    work.table("scatter", ("length", *(f"{one}{end}" for one in names for end in ("", "_error"))), [
        [f"{row['time']:.0f}",
         *(f"{100.0 * row[one + end] / mean:.3g}" for one in names for end in ("", "_error"))]
        for row in rows
    ])  # fmt: skip
    times = np.array([row["time"] for row in rows])
    lengths = [length_for_goal(times, np.array([row[one] for row in rows]), mean) for one in names]
    spread = currents.mean(axis=1)
    print(f"net current of runs of 1e6 at T = 7: {spread.min():.4f} to {spread.max():.4f}, "
          f"mean {mean:.4f} +- {spread.std(ddof=1) / spread.size**0.5:.2g}; 1 % takes "
          f"{lengths[0]:.2g} (standard deviation), {lengths[1]:.2g} (half of 68 %)")  # fmt: skip


def figure(found: Found, replicas: int) -> Figure:
    """Return the error over the true one, and how often it holds, against the length of a run.

    Only if half of the runs have one, since fewer are a selection; error bars are the statistical
    errors of the true one, and of a share, from this number of runs.
    """
    made = style.figure(style.PAGE, 5.2)
    panels = made.subplots(2, len(QUANTITIES), sharex=True, sharey="row")
    for column, name in zip(panels.T, QUANTITIES, strict=True):
        for (circuit, rows), colour, mark in zip(found.items(), style.CYCLE, "osD^v", strict=False):
            lengths = sorted(rows)
            seen = any(one["told"] >= ENOUGH for row in rows.values() for one in row.values())
            label = circuit if seen else f"{circuit}: none told"
            own = [rows[length][name] for length in lengths]
            enough = np.array([one["told"] >= ENOUGH for one in own])
            share, ratio, one = (
                np.where(enough, [float(line[key]) for line in own], np.nan)
                for key in ("told", "ratio", "one")
            )
            errors = (ratio / np.sqrt(2.0 * (replicas - 1)),
                      np.sqrt(one * (1.0 - one) / (replicas * share)))  # fmt: skip
            for axes, values, error in zip(column, (ratio, one), errors, strict=True):
                axes.errorbar(lengths, values, error, fmt=f"{mark}-", color=colour, mfc="none",
                              lw=0.8, label=label)  # fmt: skip
        column[0].axhline(1.0, color=style.GREY, lw=0.8)
        column[0].set(title=LABELS[name])
        column[1].axhspan(*ASKED, color=style.GREY, alpha=0.2, lw=0.0)
        column[1].set(xscale="log", xlabel="length of a run")
    panels[0, 0].set(ylabel="told error over true error", ylim=(0.0, 1.6), xlim=(4e3, 6e5))
    panels[1, 0].set(ylabel="share within one error", ylim=(0.4, 0.9))
    made.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return made


def run(work: study.Study) -> None:
    """Make all tables and pictures of the page."""
    currents = reference_currents(work, 400_000.0, int(work.pick(30, 100)))
    slow = decay_time(currents, INTERVAL, (8, 64))
    print(f"correlation time of the current at T = 7: {slow:.0f}")
    scatter(work)
    found: Found = {}
    for at, (label, (threshold, table, lengths)) in enumerate(CIRCUITS.items()):
        found[label] = {
            length: measure(work, f"circuit_{at}_{length:.0f}", threshold, table, length)
            for length in (lengths if work.full else lengths[:2])
        }
    head = ("circuit", "length", "quantity", "told", "ratio", "within 1", "within 2")
    work.table("errors", head, [
        [label, f"{length:,.0f}", LABELS[name], *_cells(one)]
        for label, rows in found.items() for length, row in rows.items()
        for name, one in row.items()
    ])  # fmt: skip
    work.draw(figure(found, int(work.pick(40, REPLICAS))), "errors_of_single_runs")


def _cells(one: dict[str, float]) -> list[str]:
    """Return a row's numbers; `-` if fewer than half of the runs have an error."""
    share = f"{100.0 * one['told']:.0f} %"
    if one["told"] < ENOUGH:
        return [share, "-", "-", "-"]
    return [share, f"{one['ratio']:.2f}", *(f"{100.0 * one[key]:.0f} %" for key in ("one", "two"))]


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

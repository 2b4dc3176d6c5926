"""Scatter of averages of runs by their length, and the length of a run for an accuracy."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

GOAL = 0.01  # required relative accuracy
REDRAWN = 400  # bootstrap samples for errors of a scatter


def scatter(values: Floats) -> dict[str, float]:
    """Return measures of the scatter of currents of runs of one length."""
    low, middle, high = np.quantile(values, [0.16, 0.5, 0.84])
    mean = values.mean()
    return {
        "runs": values.size, "mean": mean, "median": middle, "half_width": 0.5 * (high - low),
        "deviation": values.std(ddof=1) if values.size > 1 else math.nan,
        "off_by_goal": float(np.mean(np.abs(values - mean) > GOAL * mean)),
    }  # fmt: skip


def scatter_with_error(runs: Floats) -> dict[str, float]:
    """Return `scatter` of windows of several runs, shape (run, window), with its errors.

    Windows of one run are not independent, since circulations are longer: the errors are from
    bootstrap samples of whole runs.
    """
    random = np.random.default_rng(5)
    drawn = [runs[random.integers(0, len(runs), len(runs))] for _ in range(REDRAWN)]
    found = [scatter(one.ravel()) for one in drawn]
    errors = {
        f"{name}_error": float(np.std([one[name] for one in found], ddof=1))
        for name in ("half_width", "deviation")
    }
    return {**scatter(runs.ravel()), **errors}


def by_length(values: Floats, interval: float) -> list[dict[str, float]]:
    """Return `scatter_with_error` of windows of 1, 2, 4, ... intervals, and of whole runs.

    Parameters
    ----------
    values : series of runs, shape (run, time).
    interval : time from one value to the next.
    """
    count, sizes = values.shape[1], []
    while 2 ** len(sizes) <= count:
        sizes.append(2 ** len(sizes))
    rows = []
    for size in dict.fromkeys([*sizes, count]):
        windows = values[:, : count // size * size].reshape(len(values), -1, size).mean(axis=2)
        rows.append({"time": size * interval, **scatter_with_error(windows)})
    return rows


def length_for_goal(times: Floats, widths: Floats, mean: float) -> float:
    """Return the time above which the widths are below the goal.

    Between two lengths on a log-log line; beyond the longest as the square root of time, which
    holds once even the longest circulations are over.
    """
    excess = np.log(np.array(widths) / (GOAL * mean))
    late = np.flatnonzero(excess >= 0.0)
    if late.size == 0:
        return float(times[0])
    at = int(late[-1])
    if at == excess.size - 1:
        return float(times[-1] * math.exp(2.0 * excess[-1]))
    share = excess[at] / (excess[at] - excess[at + 1])
    return float(times[at] * (times[at + 1] / times[at]) ** share)

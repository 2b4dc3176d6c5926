"""Counts of intervals: sums of shorter ones, moments, and errors over independent runs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]


def summed(values: NDArray[np.generic], length: int) -> NDArray[np.generic]:
    """Return the sums over `length` intervals in succession, run by longer interval."""
    many = values.shape[1] // length
    return values[:, : many * length].reshape(values.shape[0], many, length).sum(axis=2)


def jackknife(totals: Floats, statistic: Callable[[Floats], Floats | float]) -> tuple:
    """Return a statistic of sums over all runs, and its error by leaving out one run at a time.

    Parameters
    ----------
    totals : what each run adds to the sums, shape (run, sum).
    statistic : a number, or an array of numbers, of the sums, shape (sum,).
    """
    whole = totals.sum(axis=0)
    left = np.array([statistic(whole - one) for one in totals])
    spread = ((left - left.mean(axis=0)) ** 2).sum(axis=0)
    return statistic(whole), np.sqrt(spread * (1.0 - 1.0 / len(totals)))


def ratio_totals(counts: Integers, count: int, flows: Floats) -> Floats:
    """Return for each run how many intervals have j, how many -j, and its flows; (run, 4).

    Parameters
    ----------
    counts : net counts, shape (run, interval).
    count : j.
    flows : with the current and against it, shape (run, 2).
    """
    many = [(counts == one).sum(axis=1) for one in (count, -count)]
    return np.column_stack([*many, flows]).astype(float)


def slope_and_difference(totals: Floats, count: int) -> Floats:
    """Return ln[P(j)/P(-j)]/j, and that less the logarithm of the ratio of flows."""
    slope = math.log(totals[0] / totals[1]) / count
    return np.array([slope, slope - math.log(totals[2] / totals[3])])


def moment_totals(counts: Integers, numbers: Floats, mean: float) -> Floats:
    """Return sums over the intervals of each run of powers of count and number; (run, 7).

    Parameters
    ----------
    counts : net counts, shape (run, interval).
    numbers : mean number of urn 1 in the interval, same shape; its mean is taken off.
    mean : of counts, taken off so that powers stay small.
    """
    x, n = counts - mean, numbers - numbers.mean()
    parts = [np.ones_like(x), x, x**2, x**3, n, n**2, x * n]
    return np.stack([one.sum(axis=1) for one in parts], axis=1)


def moments(totals: Floats) -> Floats:
    """Return variance of the count, third cumulant, and the variance that goes with the number.

    The last is the square of the covariance of both over the variance of the number.
    """
    _, x, xx, xxx, n, nn, xn = totals / totals[0]
    variance = xx - x**2
    third = xxx - 3.0 * x * xx + 2.0 * x**3
    spread = nn - n**2
    shared = (xn - x * n) ** 2 / spread if spread > 0.0 else 0.0
    return np.array([variance, third, shared])

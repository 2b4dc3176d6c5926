"""Statistics of runs that may take turns between two states: histograms, barriers, weights, errors.

Every run is reduced to sums (a histogram of |m|, moments, passages), so that errors come from
runs, which are independent, not from looks within a run, which are not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

BINS = np.linspace(0.0, 1.0, 26)  # of |m|
LOW, HIGH = 0.15, 0.4  # chi: a run that has been below and above has passed
EDGE = 1e-9  # of |m|: values at the edge of two bins are of the upper one
RESAMPLES = 400
WINDOW = 6.0  # correlation times over which correlations are summed


def histogram(spread: Floats) -> Floats:
    """Return how often |m| was in each of `BINS`."""
    return np.histogram(np.abs(spread) + EDGE, BINS)[0].astype(float)


def _depth(counts: Floats) -> Floats:
    """Return how far below the lower of the modes at either side the log of each bin is."""
    filled = np.maximum(counts, 0.5)
    left = np.maximum.accumulate(filled, axis=-1)
    right = np.maximum.accumulate(filled[..., ::-1], axis=-1)[..., ::-1]
    return np.log(np.minimum(left, right) / filled)


def minimum(counts: Floats) -> tuple[int, float]:
    """Return the bin of the deepest minimum between two modes, and its depth as in `barrier`."""
    depth = _depth(counts)
    return int(depth.argmax()), float(depth.max())


def barrier(counts: Floats) -> Floats:
    """Return the log of the deepest minimum between two modes, below the lower mode; 0: one mode.

    A bin that nobody visited counts half. Of histograms of shape (..., bin).
    """
    return _depth(counts).max(axis=-1)


def cumulant(spread: Floats) -> float:
    """Return Binder's, 1 - <m^4>/(3 <m^2>^2)."""
    return float(1.0 - (spread**4).mean() / (3.0 * (spread**2).mean() ** 2))


def with_error(values: Floats) -> tuple[float, float]:
    """Return mean and standard error over replicas."""
    return float(values.mean()), float(values.std(ddof=1) / math.sqrt(values.size))


def jackknife(function: Callable[[Floats], float], runs: list[Floats]) -> tuple[float, float]:
    """Return a function of all runs together, and its error by leaving out one run at a time."""
    count = len(runs)
    left = [function(np.concatenate(runs[:k] + runs[k + 1 :])) for k in range(count)]
    return function(np.concatenate(runs)), math.sqrt((count - 1) * np.var(left))


def passages(chi: Floats) -> int:
    """Return how often a run has gone from below `LOW` to above `HIGH` or back."""
    sides = np.where(chi < LOW, -1, np.where(chi > HIGH, 1, 0))
    sides = sides[sides != 0]
    return int((np.diff(sides) != 0).sum())


def left_at(chi: Floats, times: Floats, start: float) -> float:
    """Return when a run first reached the other state than that of its start; NaN: never."""
    other = chi > HIGH if start < HIGH else chi < LOW
    return float(times[other.argmax()]) if other.any() else math.nan


def correlation_time(runs: Floats, interval: float) -> float:
    """Return the integrated correlation time of runs, shape (run, look), about their common mean.

    Half the factor by which looks `interval` apart are fewer than they seem, in units of time;
    summed over `WINDOW` times itself. A run that is not longer gives a lower bound.
    """
    count = runs.shape[1]
    away = np.fft.rfft(runs - runs.mean(), 2 * count, axis=1)
    sums = np.fft.irfft((np.abs(away) ** 2).mean(axis=0))[:count]
    together = sums / np.arange(count, 0, -1)
    if together[0] <= 0.0:
        return 0.0
    total = np.cumsum(together / together[0]) - 0.5
    long = np.flatnonzero(np.arange(count) >= WINDOW * total)
    return float(interval * total[long[0] if long.size else -1])


@dataclass(frozen=True)
class Bootstrap:
    """What a function of the sum over runs is.

    Attributes
    ----------
    value, error, bias : of all runs; the scatter when runs are drawn anew, and how far their mean
        is off the value.
    """

    value: float
    error: float
    bias: float


def bootstrap(function: Callable[[Floats], Floats], runs: Floats, seed: int = 1) -> Bootstrap:
    """Return a function of the sum over runs, and its error by drawing runs with repetition.

    Parameters
    ----------
    function : of arrays as one run has it, shape (sample, ...), for all samples at once.
    runs : shape (run, ...).
    seed : of the drawing.
    """
    drawn = np.random.default_rng(seed).integers(0, len(runs), (RESAMPLES, len(runs)))
    found = function(runs[drawn].sum(axis=1))
    found = found[np.isfinite(found)]
    value = float(function(runs.sum(axis=0, keepdims=True))[0])
    if not found.size or math.isnan(value):
        return Bootstrap(value, math.nan, math.nan)
    return Bootstrap(value, float(found.std()), float(found.mean() - value))


def equal_weight(widths: Floats, counts: Floats) -> float:
    """Return w' where the polarised state has half the weight, NaN if no two widths bracket it.

    The minimum of the histogram where it is deepest divides the states; the log of the ratio of
    weights is interpolated.

    Parameters
    ----------
    widths, counts : w', and histograms of shape (width, bin).
    """
    walls = [minimum(one) for one in counts]
    wall = max(walls, key=lambda one: one[1])[0]
    beyond = counts[:, wall + 1 :].sum(axis=1) + 0.5 * counts[:, wall]
    before = counts[:, :wall].sum(axis=1) + 0.5 * counts[:, wall]
    odds = np.log(np.maximum(beyond, 0.5) / np.maximum(before, 0.5))
    falls = np.flatnonzero((odds[:-1] >= 0.0) & (odds[1:] < 0.0))
    if not falls.size:
        return math.nan
    at = slice(falls[-1], falls[-1] + 2)
    return float(np.interp(0.0, -odds[at], widths[at]))


def upper_mode(counts: Floats) -> float:
    """Return |m| of the mode beyond the minimum, by a parabola through ln of three bins."""
    wall = minimum(counts)[0]
    top = wall + int(counts[wall:].argmax())
    middles = 0.5 * (BINS[:-1] + BINS[1:])
    if not 0 < top < counts.size - 1:
        return float(middles[top])
    low, here, high = np.log(np.maximum(counts[top - 1 : top + 2], 0.5))
    return float(middles[top] + 0.5 * (BINS[1] - BINS[0]) * (low - high) / (low - 2 * here + high))


@dataclass(frozen=True)
class Line:
    """A weighted straight line: slope, height at 0, their errors, chi squared."""

    slope: float
    slope_error: float
    height: float
    height_error: float
    misfit: float


def line(x: ArrayLike, y: ArrayLike, error: ArrayLike) -> Line:
    """Return the straight line through values with errors."""
    places, values, errors = (np.asarray(one, float) for one in (x, y, error))
    design = np.stack([places, np.ones_like(places)], axis=1) / errors[:, None]
    spread = np.linalg.inv(design.T @ design)
    slope, height = spread @ design.T @ (values / errors)
    misfit = float((((values - slope * places - height) / errors) ** 2).sum())
    return Line(float(slope), math.sqrt(spread[0, 0]), float(height), math.sqrt(spread[1, 1]),
                misfit)  # fmt: skip


def mean_field_cumulant(power: int) -> float:
    """Return Binder's cumulant of the density exp(-m^power): 4 continuous, 6 tricritical."""
    second, fourth = (
        special.gamma((one + 1.0) / power) / special.gamma(1.0 / power) for one in (2, 4)
    )
    return float(1.0 - fourth / (3.0 * second**2))


@dataclass(frozen=True)
class Crossing:
    """Where cumulants of two N cross; each field is value and error.

    Attributes
    ----------
    width, cumulant : w' and the cumulant there.
    exponent : p, if chi there is as N^-p.
    """

    width: tuple[float, float]
    cumulant: tuple[float, float]
    exponent: tuple[float, float]


def crossing(
    widths: Floats, numbers: tuple[float, float], cumulants: Floats, chi: Floats, seed: int = 1
) -> Crossing:
    """Return where cumulants of two N cross, by straight lines between widths.

    Parameters
    ----------
    widths, numbers : w' and both N.
    cumulants, chi : values and errors, shape (N, w', 2).
    seed : of the drawing of values within their errors.
    """

    def solved(own: Floats, spread: Floats) -> tuple[float, float, float]:
        apart = own[0] - own[1]
        signs = np.flatnonzero(np.sign(apart[:-1]) != np.sign(apart[1:]))
        if not signs.size:
            return (math.nan,) * 3
        at = signs[-1]
        part = apart[at] / (apart[at] - apart[at + 1])
        between = (1.0 - part) * own[0, at] + part * own[0, at + 1]
        sizes = (1.0 - part) * spread[:, at] + part * spread[:, at + 1]
        power = math.log(sizes[0] / sizes[1]) / math.log(numbers[1] / numbers[0])
        return float(widths[at] + part * (widths[at + 1] - widths[at])), float(between), power

    draw = np.random.default_rng(seed)
    drawn = np.array([
        solved(draw.normal(cumulants[..., 0], cumulants[..., 1]),
               draw.normal(chi[..., 0], chi[..., 1]))
        for _ in range(RESAMPLES)
    ])  # fmt: skip
    values = solved(cumulants[..., 0], chi[..., 0])
    errors = np.nanstd(drawn, axis=0)
    pairs = [(float(one), float(two)) for one, two in zip(values, errors, strict=True)]
    return Crossing(*pairs)

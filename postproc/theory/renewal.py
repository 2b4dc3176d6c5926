"""The renewal gate: the exact rule of the gate under Poisson entries, instead of a window.

A gate with Poisson entries at rate e is a queue with unlimited servers: each entrant is inside for
(l/2)/cos(theta), theta from the cosine law, on average tau = pi l/4, and an entry that finds T
inside empties it. With C the mean time between emptyings the share of the entries that gets through
is exactly 1 - (T+1)/(e C).

For exponential times inside, e C would be the sum of 1/B(n, x) over n = 0 ... T, B Erlang's loss
formula at load x = e tau (a birth-death chain). The correction for the true times is a smooth
function of load and threshold up to T = 100, a polynomial in `renewal_fit.json` for the difference
of the logits of the shares. The study of the renewal gate makes it from deterministic solutions of
moment equations; the file has their differences from each other and from simulations.

In the limit of large T the number inside is deterministic: e times the integral of the probability
to be still inside. It reaches T at the time t, and the share is 1 - T/(e t).
Above T = 100 logits are interpolated, at equal coordinates along the transition, in powers of
1/sqrt(T) between that limit and thresholds up to 100: errors are up to 2e-3 at T = 200, 7e-3 at T =
400.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev
from scipy import special

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

FIT_FILE = Path(__file__).with_name("renewal_fit.json")
LARGEST_THRESHOLD = 100  # of the fit
KNOTS = (25, 40, 60, 100)  # thresholds from which larger ones are interpolated to the fluid
FLUID_RANGE = 0.98  # along the transition, within which the fluid's share is not 0 or 1
LOWEST, HIGHEST = 1e-3, 1e-3  # probabilities that bound the loads of the fit, see `load_range`
STEP = 1e-4  # relative step of the derivative


def load_range(threshold: ArrayLike) -> tuple[Floats, Floats]:
    """Return the loads between which the share falls from nearly 1 to nearly 0.

    At the lower one a Poisson number with that mean reaches T with probability `LOWEST`; at the
    upper one at most T enter within the time l/2 (no particle leaves sooner) with probability
    `HIGHEST`.
    """
    count = np.asarray(threshold, float)
    lower = special.gammaincinv(count, LOWEST)
    return lower, 0.5 * np.pi * special.gammainccinv(count + 1.0, HIGHEST)


def coordinates(threshold: ArrayLike, load: ArrayLike) -> tuple[Floats, Floats]:
    """Return the variables of the fit, both within -1 ... 1 over its range.

    The first is linear in log(load) between the ends of `load_range`, the second in 1/sqrt(T).
    """
    count = np.clip(np.asarray(threshold, float), 1.0, None)
    if (one := _only(count)) is not None:
        lower, upper = _range_of_one(one)
    else:
        lower, upper = (np.log(limit) for limit in load_range(count))
    along = 2.0 * (np.log(load) - lower) / (upper - lower) - 1.0
    least = 1.0 / np.sqrt(LARGEST_THRESHOLD)
    across = 2.0 * (1.0 / np.sqrt(count) - least) / (1.0 - least) - 1.0
    return along, np.clip(across, -1.0, 1.0)


def exponential_logit(threshold: ArrayLike, load: ArrayLike) -> Floats:
    """Return log(share/(1 - share)) for exponential times inside; T at least 1, loads above 0.

    The sum of 1/B(n, x) over n = 0 ... T is that of (T + 1)!/((T - k)! (k + 1)) x^-k over k = 0 ...
    T. Its term at k = 0 is T + 1; so the logit is the logarithm of the others over that.
    """
    count, x = np.broadcast_arrays(np.asarray(threshold, float), np.asarray(load, float))
    k = np.arange(1, int(count.max(initial=1.0)) + 1).reshape(-1, *[1] * x.ndim)
    terms = special.gammaln(count + 2.0) - special.gammaln(count - k + 1.0)
    terms = terms - np.log(k + 1.0) - k * np.log(x)
    top = terms.max(axis=0)
    return top + np.log(np.exp(terms - top).sum(axis=0)) - np.log(count + 1.0)


def _only(threshold: Floats) -> float | None:
    """Return the threshold if all are the same, else None."""
    if not threshold.size:
        return None
    first = threshold.flat[0]
    return float(first) if threshold.size == 1 or np.all(threshold == first) else None


@lru_cache(maxsize=4096)
def _range_of_one(threshold: float) -> tuple[Floats, Floats]:
    """Return the logarithms of `load_range`."""
    lower, upper = load_range(threshold)
    return np.log(lower), np.log(upper)


@cache
def _fluid_logits() -> tuple[Floats, Floats]:
    """Return coordinates along the transition and the fluid's logit there, for interpolation.

    It is solved by the angle a: T is reached at the time t with l/(2 t) = cos(a), the load is rho T
    with rho = (pi/2)/(a + tan(pi/4 - a/2)), and the share is sin(a) - a cos(a).
    """
    angle = 0.5 * np.pi * np.sin(0.5 * np.pi * np.linspace(1.0, 0.0, 4001)[1:-1]) ** 2
    relative_load = 0.5 * np.pi / (angle + np.tan(0.25 * np.pi - 0.5 * angle))
    along = 2.0 * np.log(relative_load) / np.log(0.5 * np.pi) - 1.0
    return along, special.logit(np.sin(angle) - angle * np.cos(angle))


def _least_logit(threshold: Floats, load: Floats) -> Floats:
    """Return a bound of the logit from below, minus infinity where the load is not below T.

    Without reversals the number inside is Poisson distributed, and with them it is never greater.
    So an entry finds T inside at most with the probability of T or more of the Poisson law, and
    then T + 1 particles are thrown out.
    """
    below = load < threshold
    count = np.where(below, threshold, 1.0)
    x = np.where(below, load, 0.5)
    out = special.xlogy(count, x) - x - special.gammaln(count + 1.0)
    out += np.log(count + 1.0) - np.log1p(-x / (count + 1.0))
    return np.where(below & (out < 0.0), np.log(-np.expm1(np.minimum(out, -1e-300))) - out, -np.inf)


@dataclass(frozen=True)
class RenewalGate:
    """The gate as a queue that is emptied; the module's docstring explains its share."""

    @cached_property
    def fit(self) -> dict[str, object]:
        """The fit, as written by the study of the renewal gate."""
        return json.loads(FIT_FILE.read_text())

    @cached_property
    def _coefficients(self) -> Floats:
        return np.array(self.fit["coefficients"])

    @cached_property
    def _slopes(self) -> Floats:
        return chebyshev.chebder(self._coefficients, axis=0)

    def logit(self, threshold: ArrayLike, load: ArrayLike) -> Floats:
        """Return log(share/(1 - share)); thresholds at least 1, loads above 0."""
        count, x = np.broadcast_arrays(np.asarray(threshold, float), np.asarray(load, float))
        large = count > LARGEST_THRESHOLD
        if not np.any(large):
            return self._fitted(count, x)
        found = self._fitted(np.minimum(count, LARGEST_THRESHOLD), x)
        return np.where(large, self._beyond(np.where(large, count, LARGEST_THRESHOLD), x), found)

    def _fitted(self, threshold: Floats, load: Floats) -> Floats:
        along, across = coordinates(threshold, load)
        inside = np.clip(along, -1.0, 1.0)
        correction = self._polynomial(self._coefficients, inside, across, threshold)
        beyond = along > 1.0
        if np.any(beyond):
            slope = self._polynomial(self._slopes, inside, across, threshold)
            correction = np.where(beyond, correction + slope * (along - 1.0), correction)
        return exponential_logit(threshold, load) + correction

    @staticmethod
    def _polynomial(
        coefficients: Floats, along: Floats, across: Floats, threshold: Floats
    ) -> Floats:
        """Return the polynomial in both coordinates; with one threshold it is one in `along`."""
        if _only(threshold) is None:
            return chebyshev.chebval2d(along, across, coefficients)
        series = chebyshev.chebval(across.flat[0], coefficients.T)
        return chebyshev.chebval(along, series)

    def _beyond(self, threshold: Floats, load: Floats) -> Floats:
        """Interpolate in 1/sqrt(T), by Lagrange's formula, between `KNOTS` and the fluid."""
        lower, upper = (np.log(limit) for limit in load_range(threshold))
        along = 2.0 * (np.log(load) - lower) / (upper - lower) - 1.0
        logits = []
        for knot in KNOTS:
            first, last = (np.log(limit) for limit in load_range(knot))
            with np.errstate(over="ignore"):
                own = np.exp(first + 0.5 * (last - first) * (1.0 + along))
            logits.append(self._fitted(np.full(own.shape, float(knot)), np.clip(own, 1e-3, 1e300)))
        within = np.clip(along, -FLUID_RANGE, FLUID_RANGE)
        logits.append(np.interp(within, *_fluid_logits()))
        places = np.array([*(1.0 / np.sqrt(knot) for knot in KNOTS), 0.0])
        at, total = 1.0 / np.sqrt(threshold), np.zeros(load.shape)
        for one, logit in enumerate(logits):
            others = np.delete(places, one)
            weight = np.prod([(at - other) / (places[one] - other) for other in others], axis=0)
            total = total + weight * logit
        return np.maximum(total, _least_logit(threshold, load))

    def share(self, threshold: ArrayLike, load: ArrayLike) -> Floats:
        """Return the share of the entries that gets through: 1 at load 0, 0 for T = 0."""
        return np.exp(self.log_share(threshold, load))

    def log_share(self, threshold: ArrayLike, load: ArrayLike) -> Floats:
        """Return log(share), finite where the share underflows."""
        count, x = np.broadcast_arrays(np.asarray(threshold, float), np.asarray(load, float))
        moves = (count > 0) & (x > 0.0)
        log_share = special.log_expit(
            self.logit(np.where(count > 0, count, 1.0), np.where(moves, x, 1.0))
        )
        return np.where(count > 0, np.where(x > 0.0, log_share, 0.0), -np.inf)

    def slope(self, threshold: ArrayLike, load: ArrayLike) -> Floats:
        """Return d(x share)/dx, by a central difference."""
        x = np.asarray(load, float)
        higher, lower = x * (1.0 + STEP), x * (1.0 - STEP)
        width = np.where(x > 0.0, higher - lower, 1.0)
        rise = higher * self.share(threshold, higher) - lower * self.share(threshold, lower)
        return np.where(x > 0.0, rise / width, self.share(threshold, x))


RENEWAL = RenewalGate()

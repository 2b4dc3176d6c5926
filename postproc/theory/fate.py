"""Probability that a particle with a given stay passes a gate, for any distribution of stays.

The gate is the queue of `renewal`: entries at rate e, each inside for a stay sigma, and an entry
that finds T inside empties it. With C the mean time between emptyings and q(sigma) the probability
to pass, it is exact that

    <q> = 1 - (T + 1)/(e C)         q(sigma) = (1 - 1/(e C)) S(sigma)         S(0) = 1

since one entrant in e C empties it; S is the probability that no later entry does within the stay.
T = 1 is solved in closed form: S = exp(-e sigma), <q> = p/(2 - p) with p = <exp(-e sigma)>.

For T > 1 both C and S are from equations of first passage. Without reversals the number inside at
the time t after an emptying would be Poisson, with the mean m(t) = e times the integral of the
probability to be still inside; the rate at which entries find T inside is u(t) = e P(number = T),
and

    u(t) = g(t) + integral of g(t') u(t | t') dt',

g(t) the density of the first such entry, u(t | t') the rate after one at t'. As a closure the T
particles that it finds are taken as any T that have entered since the emptying, each independently:
exact for T = 1. The error of this is small, and smaller still for its use, the *difference* between
the given distribution of stays and the cosine law; for the latter <q> is that of `renewal`.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg, optimize, special

from postproc.theory.renewal import RENEWAL

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.intp]

ANGLES = 24
STEPS, LAST = 64, 6.0  # of the time axis, and its end in shortest stays
CLOSED = 0.01  # least overall share at which the correction is from first passages
FREE = 1.0 - 1e-12  # overall share above which all particles pass
STEEPEST = 60.0  # power of S
SMALL = 1e-200
HUGE = 1e300  # chance over that of T inside, from which the latter is 0
LEAST = 1e-300  # chance of which the logarithm is taken for that of 0
LEAST_MEAN, AT_ONCE = 1e-30, 8  # of new ones; steps whose factors are multiplied before a logarithm


def cosine_law(half_length: float, count: int = ANGLES) -> tuple[Floats, Floats]:
    """Return stays (l/2)/cos(theta) of entries by the cosine law, and their shares."""
    sine, shares = directions(count)
    return half_length / np.sqrt((1.0 - sine) * (1.0 + sine)), shares


@cache
def directions(count: int = ANGLES) -> tuple[Floats, Floats]:
    """Return nodes s = sin(theta) between 0 and 1 and their weights, Gauss's in theta.

    Mean stays, which diverge where s is 1 as 1/cos(theta), are exact.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    angle = 0.25 * np.pi * (1.0 + nodes)
    return np.sin(angle), 0.25 * np.pi * weights * np.cos(angle)


def passing(threshold: int, rate: float, stays: Floats, shares: Floats) -> Floats:
    """Return the probability to pass a gate, for each of `stays`.

    Parameters
    ----------
    threshold : T.
    rate : entries per unit time.
    stays : times inside, ascending; the first is the shortest possible one, or close to it.
    shares : share of the entries with each stay, shape of `stays`, sum 1.
    """
    if threshold == 0:
        return np.zeros(stays.size)
    if threshold == 1:
        alone = np.exp(-rate * stays)
        return alone / (2.0 - shares @ alone)
    if RENEWAL.share(threshold, rate * float(shares @ stays)) > FREE:
        return np.ones(stays.size)
    overall = overall_share(threshold, rate, stays, shares)
    entering = 1.0 - (1.0 - overall) / (threshold + 1.0)
    log_alone = np.log(_undisturbed(threshold, rate, stays, shares, 1.0 - entering))

    def excess(power: float) -> float:
        return float(shares @ np.exp(power * log_alone)) * entering - overall

    if not excess(0.0) > 0.0:  # hardly any particle is reversed
        return np.full(stays.size, overall)
    power = optimize.brentq(excess, 0.0, STEEPEST) if excess(STEEPEST) < 0.0 else STEEPEST
    return entering * np.exp(power * log_alone)


def overall_share(threshold: int, rate: float, stays: Floats, shares: Floats) -> float:
    """Return <q>: that of the cosine law at this load, corrected for the distribution of stays.

    First passages give the correction down to shares of `CLOSED`; below, it is constant, so that
    shares are continuous.
    """
    mean_stay = float(shares @ stays)
    load = rate * mean_stay
    known = min(load, _closed_load(threshold))
    usual_stays, usual = cosine_law(float(stays.min()))
    out, usual_out = (
        min(_thrown_out(threshold, *law), 1.0 - CLOSED)
        for law in (
            (known / mean_stay, stays, shares),
            (known / float(usual @ usual_stays), usual_stays, usual),
        )
    )
    logit = float(RENEWAL.logit(threshold, load))
    if min(out, usual_out) > SMALL:
        logit += float(np.log(usual_out / out) + np.log1p(-out) - np.log1p(-usual_out))
    return float(special.expit(logit))


@cache
def _closed_load(threshold: int) -> float:
    """Return the load at which the share `CLOSED` passes a gate."""
    goal = special.logit(CLOSED)
    most = max(1e6, 10.0 * threshold)
    return float(
        optimize.brentq(lambda load: float(RENEWAL.logit(threshold, load)) - goal, 1e-3, most)
    )


def _lasting(stays: Floats, shares: Floats, time: Floats) -> tuple[Floats, Floats]:
    """Return the probability to be still inside at a time after entry, and its integral."""
    staying = (time[:, None] < stays) @ shares
    return staying, np.minimum(time[:, None], stays) @ shares


def _meeting(
    weights: ArrayLike, survive: Floats, last: Floats | float, mean: Floats, level: int
) -> Floats:
    """Return the chance that as many are inside as `level`, shape (case,).

    These are k others, with the probabilities `weights` of k = 0, 1, ... and each there with the
    probability p = `survive`; one more, with the probability `last`; and new ones, a Poisson number
    of the mean m = `mean`. Without the one more, the chance c_k for one k is up to a factor a
    Charlier polynomial of degree k, so that

        c_(k+1)/c_k = 1 - p + p b_k/m        b_k = level - k + k (1 - p) c_(k-1)/c_k,

    c_0 that of the Poisson number; with it, `level` - 1 others and new ones have c_k b_k/m. Up to
    k = `level` no term is negative.
    """
    mean, leave = np.maximum(mean, LEAST_MEAN), 1.0 - survive
    log = special.xlogy(level, mean) - mean - special.gammaln(level + 1.0)
    chance, grown, fewer = np.zeros(mean.size), np.ones(mean.size), level / mean
    for k, weight in enumerate(np.asarray(weights)):
        if k > 0:
            ratio = leave + survive * fewer
            grown = grown * ratio
            fewer = (level - k + k * leave / ratio) / mean
        if weight > 0.0 or k % AT_ONCE == 0:
            log, grown = log + np.log(np.maximum(grown, LEAST)), np.ones(mean.size)
        if weight > 0.0:
            chance += weight * np.exp(log) * (1.0 - last + last * fewer)
    return chance


@cache
def _pairs() -> tuple[Integers, Integers, Integers]:
    """Return the steps of each time after another one that is not 0, the latter's, and between."""
    row, column = np.tril_indices(STEPS + 1, -1)
    row, column = row[column > 0], column[column > 0]
    return row, column, row - column


def _first(meet: Floats, again: Floats) -> Floats:
    """Solve first = meet - again @ first step by step, with negative ones as 0.

    `again` is strictly lower triangular.
    """
    first = linalg.blas.dtrsv(np.eye(meet.size) + again, meet, lower=1, diag=1)
    if np.all(first >= 0.0):
        return first
    for at in range(meet.size):
        first[at] = max(meet[at] - again[at, :at] @ first[:at], 0.0)
    return first


def _thrown_out(threshold: int, rate: float, stays: Floats, shares: Floats) -> float:
    """Return (T + 1)/(e C) by the equation of first passage from an empty gate."""
    time = np.linspace(0.0, LAST * stays.min(), STEPS + 1)
    step = time[1]
    staying, filled = _lasting(stays, shares, time)
    _, longer = _lasting(stays, shares, np.concatenate([time, time[1:] + time[-1]]))
    meet = rate * _meeting([1.0], staying, 0.0, rate * filled, threshold)
    row, column, since = _pairs()
    survive = (longer[row] - filled[since]) / filled[column]
    survive, others = np.clip(survive, 0.0, 1.0), np.arange(threshold + 1) == threshold
    met = _meeting(others, survive, staying[since], rate * filled[since], threshold)
    again = np.zeros((STEPS + 1, STEPS + 1))
    again[row, column] = step * rate * met
    first = _first(meet, again)
    alive = 1.0 - step * (np.cumsum(first) - 0.5 * first)
    over = np.flatnonzero(alive <= 1e-4)
    end = over[0] if over.size else STEPS
    cycle = step * (alive[:end].sum() - 0.5)
    if not over.size:
        cycle += alive[-1] * (0.5 * step + alive[-1] / max(first[-1], SMALL))
    return min((threshold + 1.0) / (rate * cycle), 1.0)


def _undisturbed(threshold: int, rate: float, stays: Floats, shares: Floats, full: float) -> Floats:
    """Return S, the probability that no entry empties the gate within a stay, up to a power near 1.

    The number of other particles must not reach T. At the entry there are k < T, distributed as in
    a stationary queue with exponential stays that is full with the probability `full`; their
    residual stays are those of a queue that is not emptied.
    """
    mean_stay = float(shares @ stays)
    time = np.linspace(0.0, LAST * stays.min(), STEPS + 1)
    step = time[1]
    staying, filled = _lasting(stays, shares, time)
    residual, level = 1.0 - filled / mean_stay, threshold - 1
    found = _found(threshold, rate * mean_stay, full)[:threshold]
    found = found / found.sum()
    meet = rate * _meeting(found, residual, 0.0, rate * filled, level)
    again = rate * _meeting(np.arange(threshold) == level, residual, staying, rate * filled, level)
    first = _first(meet, linalg.toeplitz(step * again * (time > 0.0), np.zeros(time.size)))
    gone = step * (np.cumsum(first) - 0.5 * (first + first[0]))
    alone = np.maximum(1.0 - gone, 1e-12)
    hazard = max(first[-1] / alone[-1], SMALL)
    within = np.interp(stays, time, np.log(alone))
    return np.exp(np.maximum(within - hazard * np.maximum(stays - time[-1], 0.0), -600.0))


def _found(threshold: int, load: float, full: float) -> Floats:
    """Return probabilities of 0 ... T inside, for exponential stays and a load with P(T) = full."""

    def law(x: float) -> Floats:
        # the flow up from k returns from k + 1 or by an emptying: p_k in units of p_T
        chances = [1.0]
        for k in range(threshold, 0, -1):
            # x p_(k-1) = k p_k + x p_T
            chances.append(min(k / float(x) * chances[-1] + 1.0, HUGE))
        found = np.array(chances[::-1])
        return found / found.sum()

    low, high = 1e-3 * load, 1e3 * load + 10.0
    if not law(low)[-1] < full < law(high)[-1]:
        return law(load)
    return law(optimize.brentq(lambda x: law(x)[-1] - full, low, high))

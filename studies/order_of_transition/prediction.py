"""The order of the transition by the gate's rule: the curve k(d).

A gate is fed at a load x + d, the other at x - d, and lets J(x) = x q(x) through. Urns that
remember nothing, or the opening of entry alone, give loads back that are linear in what comes in.
So the sum of both loads is fixed, and channel 2 carries k times their difference. A state has

    k = k(d) = -(J(x + d) - J(x - d))/(2 d),     k(0) = -J'(x),

and is stable where k(d) falls. For well mixed urns k = w'/w, for two ports P12/(1 + a - 2 P12).
Where k(d) is largest at d = 0 the transition is continuous; elsewhere it is of first order, the
homogeneous state is stable for k > k(0), the polarised one for k < max k(d).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

from postproc.theory import ports
from postproc.theory.circuit import Circuit
from postproc.theory.renewal import RENEWAL

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

WIDTH = 0.3  # w; r = 1
LOAD_PER_REACH = WIDTH * float(1.0 / (8.0 * Circuit(1000, 7).urn_area))  # x over N l
PLACES = 800  # of d, evenly between 0 and x
NEAR_HALF = 1e-3  # of x: the first of them


def through(threshold: int, load: ArrayLike) -> Floats:
    """Return J(x) = x q(x)."""
    return np.asarray(load) * RENEWAL.share(threshold, load)


def places(count: int = PLACES) -> Floats:
    """Return d/x."""
    return np.concatenate([[NEAR_HALF], np.linspace(0.0, 1.0, count + 2)[1:-1]])


def curve(threshold: int, load: ArrayLike, count: int = PLACES) -> tuple[Floats, Floats]:
    """Return d/x, shape (place,), and k(d), shape (..., place), at loads x."""
    part = places(count)
    x = np.asarray(load, float)[..., None]
    apart = through(threshold, x * (1.0 + part)) - through(threshold, x * (1.0 - part))
    return part, -apart / (2.0 * x * part)


@dataclass(frozen=True)
class Transition:
    """The transition at one T and load, as channel 2 becomes wider.

    Attributes
    ----------
    homogeneous : k above which the homogeneous state is stable, k(0).
    polarised : k up to which a polarised one is, the largest k(d).
    jump : chi of the polarised state where both are as likely in a large circuit; 0: continuous.
    equal : k there.
    barrier : of the chain's -log P(chi) between both there, for each particle.
    """

    homogeneous: float
    polarised: float
    jump: float
    equal: float
    barrier: float


def potential(threshold: int, load: float, k: float) -> tuple[Floats, Floats]:
    """Return chi and log P(chi)/N, 0 at chi = 0, of the birth-death chain of a large circuit."""
    part = places()
    low, high = load * (1.0 - part), load * (1.0 + part)
    step = np.log((through(threshold, low) + k * low) / (through(threshold, high) + k * high))
    widths = np.diff(part, prepend=0.0)
    middle = 0.5 * (step + np.concatenate([[0.0], step[:-1]]))
    return part, np.cumsum(0.5 * middle * widths)


def transition(threshold: int, load: float) -> Transition:
    """Return the transition at one T and load."""
    part, k = curve(threshold, load)
    top = int(np.argmax(k))
    if part[top] < 0.02:  # below it the fit of q is not smooth enough
        return Transition(k[0], k[top], 0.0, k[0], 0.0)

    def wells(at: float) -> tuple[int, int, Floats]:
        weight = potential(threshold, load, at)[1]
        wall = int(np.argmin(weight[: top + 1]))
        return wall, wall + int(np.argmax(weight[wall:])), weight

    def difference(at: float) -> float:
        _, well, weight = wells(at)
        return float(weight[well])

    span = k[top] - k[0]
    # a homogeneous state unstable at all k >= 0 cannot be as likely at k = 0
    lower = max(k[0] + 1e-3 * span, 0.0)
    upper = k[top] - 1e-3 * span
    if difference(lower) <= 0.0:
        return Transition(k[0], k[top], math.nan, math.nan, math.nan)
    equal = float(optimize.brentq(difference, lower, upper))
    wall, well, weight = wells(equal)
    return Transition(k[0], k[top], float(part[well]), equal, -float(weight[wall]))


def conductance(width2: float) -> float:
    """Return k of two ports for a channel 2 of this width, w = 0.3 and r = 1."""
    one = ports.disc(Circuit(number=1000, threshold=7, channel2_width=width2))
    return one.across / (1.0 + one.return_chance - 2.0 * one.across)


@lru_cache(maxsize=64)
def width_of(k: float) -> float:
    """Return w' of a channel 2 that has k with two ports; NaN below 0."""
    if not k > 0.0:
        return math.nan
    return float(optimize.brentq(lambda width: conductance(width) - k, 1e-4, 0.25, xtol=1e-6))


def ranges(threshold: int, ratios: Floats) -> list[tuple[float, float, float, float]]:
    """Return where the transition is of first order: x/T from, to, and w'/w at either end.

    Ends of `ratios` stand for ends that are not within them.
    """
    part, k = curve(threshold, threshold * ratios, 200)
    top = k.argmax(axis=1)
    there = (k.max(axis=1) > 0.0) & (part[top] > 0.02)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], there.astype(int), [0]])))
    return [
        (float(ratios[low]), float(ratios[high - 1]), float(k[low].max()), float(k[high - 1].max()))
        for low, high in zip(edges[::2], edges[1::2], strict=True)
    ]


def chain(threshold: int, load: float, number: int, known: Transition) -> tuple[float, float]:
    """Return the largest barrier of log P(chi) over k, and the least cumulant, at a finite N.

    Of N2 as a birth-death chain with these gates, N2 urns' particles; in bins of 0.04 of chi.
    """
    count = np.arange(number + 1)
    sent = through(threshold, load * count / (0.5 * number))
    spread = 2.0 * count / number - 1.0
    bins = np.minimum((np.abs(spread) * 25).astype(int), 24)
    deepest, lowest = 0.0, 1.0
    for k in known.homogeneous + np.linspace(-0.5, 1.5, 81) * max(
        known.polarised - known.homogeneous, 0.2 * abs(known.homogeneous)
    ):
        out = sent + max(k, 1e-4) * load * count / (0.5 * number)
        weight = np.concatenate([[0.0], np.cumsum(np.log(out[:0:-1]) - np.log(out[1:]))])
        share = np.exp(weight - weight.max())
        share /= share.sum()
        filled = np.maximum(np.bincount(bins, share, 25), 1e-300)
        left, right = np.maximum.accumulate(filled), np.maximum.accumulate(filled[::-1])[::-1]
        deepest = max(deepest, float(np.log(np.minimum(left, right) / filled).max()))
        lowest = min(lowest, float(1.0 - share @ spread**4 / (3.0 * (share @ spread**2) ** 2)))
    return deepest, lowest

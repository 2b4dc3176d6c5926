"""Finite N: N2 as a birth-death chain with the theory's rates, its distribution and lifetimes.

A theory whose urns relax more slowly than N2 has its own chain in two variables
(`Theory.passages`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import interpolate

from postproc.cli import InputError
from postproc.theory.circuit import log_outflow
from postproc.theory.states import WELL_MIXED

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.states import Theory

    Floats = NDArray[np.float64]

FEWEST = 4  # particles of a chain with lifetimes
PART = 2**16  # places whose outflow is computed together, for the memory that it takes


@dataclass(frozen=True)
class Lifetimes:
    """Mean times until a state is left, in units of length/v.

    Attributes
    ----------
    homogeneous, polarised : lifetimes; infinite if there is no other state, zero if there is no
        such state. Of two polarised states it is the outer one.
    barrier : chi of the unstable state that the outer one is left for, NaN without one.
    polarised_share : probability of the stationary chain to be beyond the barrier; for urns that
        relax slowly, from the two lifetimes, and NaN if both are infinite.
    """

    homogeneous: float
    polarised: float
    barrier: float
    polarised_share: float


def between(places: Floats, values: Floats, wanted: ArrayLike) -> Floats:
    """Interpolate values, shape (..., place), by cubic splines; constant beyond the ends.

    The outflow of an urn has a peak that is only a few places wide: linear interpolation has an
    error of a tenth there.
    """
    places, order = np.unique(places, return_index=True)
    inside = np.clip(wanted, places[0], places[-1])
    return interpolate.CubicSpline(places, np.asarray(values)[..., order], axis=-1)(inside)


def log_rates(circuit: Circuit, theory: Theory = WELL_MIXED) -> tuple[Floats, Floats]:
    """Return the logarithms of the rates of N2 -> N2 + 1 and N2 -> N2 - 1 for N2 = 0 ... N."""
    number = int(circuit.number)
    if theory.outflows is not None:
        up, down = between(*theory.outflows(circuit), np.arange(number + 1))
        up[-1], down[0] = -np.inf, -np.inf
        return up, down
    out = np.full(number + 1, -np.inf)
    scale = math.log(math.pi * float(circuit.urn_area))
    parts = np.array_split(np.arange(1, number + 1), 1 + number // PART)
    out[1:] = np.concatenate([log_outflow(circuit, part) for part in parts]) - scale
    return out[::-1], out


def log_weights(log_up: Floats, log_down: Floats) -> Floats:
    """Return the logarithm of the stationary distribution of a chain, normalised."""
    moves = np.isfinite(log_up[:-1]) | np.isfinite(log_down[1:])  # else no particle passes
    steps = np.subtract(log_up[:-1], log_down[1:], out=np.zeros(moves.size), where=moves)
    weights = np.concatenate([[0.0], np.cumsum(steps)])
    weights -= weights.max()
    return weights - np.log(np.exp(weights).sum())


def time_up(log_up: Floats, log_down: Floats, start: int, stop: int) -> float:
    """Return the mean time from state `start` to state `stop` > start of a chain closed at 0."""
    weights = log_weights(log_up, log_down)
    with np.errstate(invalid="ignore"):  # the logarithm of a weight 0 is -inf
        below = np.logaddexp.accumulate(weights[:stop])
    steps = below - weights[:stop] - log_up[:stop]
    with np.errstate(over="ignore"):
        return float(np.exp(steps[start:]).sum())


def folded(log_up: Floats, log_down: Floats) -> tuple[Floats, Floats]:
    """Return the rates of |N2 - N/2|: state j is N2 = ceil(N/2) + j or its mirror image."""
    middle = log_up.size // 2
    up, down = log_up[middle:].copy(), log_down[middle:].copy()
    if log_up.size % 2:  # from N/2 both directions lead away
        up[0] = np.logaddexp(up[0], down[0])
    down[0] = -np.inf
    return up, down


def passages(
    circuit: Circuit, theory: Theory = WELL_MIXED
) -> tuple[Callable[[int, int], float], Floats | None]:
    """Return a function for the mean time from one state of `folded` to another.

    And the stationary distribution over these states, unless the theory has its own chain.
    """
    if theory.passages is not None:
        return theory.passages(circuit), None
    up, down = folded(*log_rates(circuit, theory))
    last = up.size - 1

    def passage(start: int, stop: int) -> float:
        if stop > start:
            return time_up(up, down, start, stop)
        return time_up(down[::-1], up[::-1], last - start, last - stop)

    return passage, np.exp(log_weights(up, down))


def lifetimes(circuit: Circuit, theory: Theory = WELL_MIXED) -> Lifetimes:
    """Return the lifetimes of the homogeneous and of the (outermost) polarised state.

    For circuits with equal urns and gates, and four particles or more (`InputError`): with fewer
    there is no state between the two.
    """
    if circuit.number < FEWEST:
        raise InputError(f"lifetimes need {FEWEST} particles or more")
    states = theory.states(circuit)
    polarised = [state for state in states if state.kind == "stable"]
    homogeneous = theory.homogeneous_kind(circuit) != "unstable"
    if not polarised:
        return Lifetimes(math.inf, 0.0, math.nan, 0.0)
    if not homogeneous and len(polarised) == 1:
        return Lifetimes(0.0, math.inf, math.nan, 1.0)
    # the outermost state is left inwards: for the homogeneous one, or for another polarised one
    number = int(circuit.number)
    barriers = [state.urn2_number for state in states if state.kind == "unstable"]
    barrier = max(barriers, default=0.5 * number)
    offset, last = (number + 1) // 2, number // 2
    wall = int(np.clip(round(barrier) - offset, 1, last - 1))
    far = int(np.clip(round(polarised[-1].urn2_number) - offset, wall + 1, last))
    near = 0
    if not homogeneous:
        near = int(np.clip(round(polarised[-2].urn2_number) - offset, 0, wall - 1))
    passage, weights = passages(circuit, theory)
    inside, outside = passage(near, wall), passage(far, wall)
    share = 1.0 / (1.0 + inside / outside)
    if weights is not None:
        share = min(1.0, float(weights[wall:].sum()))
    times = inside if homogeneous else 0.0, outside
    return Lifetimes(*times, 2.0 * barrier / number - 1.0, share)


def passage_times(
    circuit: Circuit,
    low: float,
    high: float,
    theory: Theory = WELL_MIXED,
) -> tuple[float, float]:
    """Return the chain's mean times from chi = 0 until chi >= high, and from 1 until chi <= low.

    Unlike `lifetimes` they are defined whether or not the theory has both states.
    """
    number = int(circuit.number)
    passage, _ = passages(circuit, theory)
    offset, last = (number + 1) // 2, number // 2
    above = int(np.clip(np.ceil(0.5 * number * (1.0 + high) - 1e-9) - offset, 1, last))
    below = int(np.clip(np.floor(0.5 * number * (1.0 + low) + 1e-9) - offset, 0, last - 1))
    return passage(0, above), passage(last, below)

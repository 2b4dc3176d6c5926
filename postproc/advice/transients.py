"""Transients of runs, for chi and for currents.

chi relaxes with the directions of particles, in 25 r^4/w^3, and next to a transition more slowly.
Near equal numbers it relaxes with the numbers, slowly where both gates reverse all and w' is small;
from equal numbers it takes as long to reach a polarised state.
The current of channel 2 still grows long after that: orbits of m rounds are filled only after the
time of m rounds, each decade of m carries about as much as the one before, and this ends where the
gate of the sparse urn reverses a circulating particle, after 1/(1 - q) rounds. The part that is
missing at an age is the rest of the sum of `postproc.theory.circulation`. It agrees with
measurements against the age of runs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy import integrate

from postproc.theory.circuit import eta, stability
from postproc.theory.circulation import circulating_at
from postproc.theory.direction import DIFFUSION
from postproc.theory.models import MODELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

RELAXATIONS = 3.0  # relaxation times of directions, and of numbers, in a transient
PLACES = 2001  # of N2, from equal numbers on
GROWN = 0.9  # of the way to a state, where the rest is small
# Times in radii, at speed 1:
SHORTEST = 1000.0  # transient
CRITICAL = 9000.0  # transient next to a transition: a margin (experiment 5 found 500 enough)
LONGEST = 1e6  # longest transient for a current, whose missing part is returned, and for numbers
AGES = np.geomspace(10.0, 1e12, 661)  # 60 a decade; the transient of chi may be above `LONGEST`


def circulation_rate(circuit: Circuit, dense: float, rounds: float) -> float:
    """Return the rate at which circulations of so many rounds or more begin.

    (n2/pi A) (w'^2/L) (1 + 2 l'/(L - l'))/m with d, d' the distances of the chords from the centre,
    L = 2 (d + d') + l + l'; `dense` is n2, the number in the dense urn.
    """
    returning = float(circuit.channel2_length)
    length = 2.0 * float(sum(circuit.chords)) + float(circuit.channel1_length) + returning
    share = returning / length
    beam = dense * float(circuit.channel2_width) ** 2 / (math.pi * float(circuit.urn_area) * length)
    return beam * (1.0 + 2.0 * share / (1.0 - share)) / rounds


def largest_radius(circuit: Circuit) -> float:
    """Return the radius of the larger urn, the unit of the times above."""
    return max(float(side.urn_radius) for side in circuit.sides)


def memory_time(circuit: Circuit) -> float:
    """Return the relaxation time of directions: 25 r^4/w^3, or a passage of both channels.

    Between openings wider than 1.9 r it is longer; there `SHORTEST` decides.
    """
    radius, width = float(circuit.urn_radius), float(circuit.channel1_width)
    visit = math.pi * float(circuit.urn_area) / width
    back = float(circuit.channel2_length) if float(circuit.channel2_width) else 0.0
    passage = 0.5 * math.pi * (float(circuit.channel1_length) + back)
    return max(visit / (6.0 * DIFFUSION * (width / radius) ** 2), passage)


def number_time(circuit: Circuit) -> float:
    """Return the time after which a run from equal numbers has left them, or fluctuates about them.

    A difference grows from N**0.5 with dN2/dt = eta, here for `GROWN` of the way to the state. It
    begins to grow at a time that scatters, by some of the times in which a difference grows or
    decays near equal numbers. These diverge next to a transition; here they are at most that of
    channel 2 alone, pi A/(2 w'). At most `LONGEST`.
    """
    if circuit.shape == "urn":
        return 0.0
    mixed = MODELS["renewal"].of(replace(circuit, scatterers=()))
    number, width, times = float(circuit.number), float(circuit.channel2_width), [0.0]
    for way, side in zip((-1.0, 1.0), mixed.sides, strict=True):
        first, last = 0.5 * (number + way * math.sqrt(number)), 0.5 * number * (1.0 + way)
        place = np.linspace(first, last, PLACES)
        growing = int(np.argmin(np.append(way * eta(mixed, place), 0.0) > 0.0))
        grown = 0.0
        if growing > 0:
            end = place[growing - 1]
            place = np.linspace(first, first + GROWN * (end - first), PLACES)
            grown = abs(float(integrate.trapezoid(1.0 / eta(mixed, place), place)))
        if near := max(width, abs(float(stability(side, width)))):
            near = 0.5 * math.pi * float(side.urn_area) / near
        times.append(grown + RELAXATIONS * near)
    return min(max(times), LONGEST * largest_radius(circuit))


def of_chi(circuit: Circuit, *, critical: bool) -> float:
    """Return the transient of chi, next to a transition or elsewhere."""
    radius = largest_radius(circuit)
    least = CRITICAL if critical else SHORTEST
    directions = RELAXATIONS * max(memory_time(side) for side in circuit.sides)
    slowest = max(least, directions / radius, number_time(circuit) / radius)
    return radius * 100.0 * math.ceil(0.01 * slowest)


def missing(circuit: Circuit, chi: float, transients: Floats, measured: Floats) -> Floats:
    """Return the part of the mean current over `measured` that is missing after each transient.

    Parameters
    ----------
    chi : mass spread of the state, urn 2 the fuller one.
    """
    if float(circuit.channel2_width) == 0.0 or MODELS["direction"].refusal(circuit):
        return np.zeros(np.shape(transients))
    lacking = _lacking(MODELS["direction"].of(circuit), chi)
    start = np.asarray(transients, float)
    ages = largest_radius(circuit) * AGES
    ends = [np.interp(age, ages, lacking) for age in (start, start + measured)]
    return (ends[1] - ends[0]) / measured


@lru_cache(maxsize=4)
def _lacking(circuit: Circuit, chi: float) -> Floats:
    """Return the integral of the missing current from the first of `AGES` to each of them."""
    number2 = 0.5 * float(circuit.number) * (1.0 + chi)
    ages = largest_radius(circuit) * AGES
    around = circulating_at(circuit, number2, np.append(ages, math.inf))
    return integrate.cumulative_trapezoid(around[-1] - around[:-1], ages, initial=0.0)


def of_current(
    circuit: Circuit, chi: float, allowed: float, *, shortest: float, times: float
) -> float:
    """Return the shortest transient after which at most `allowed` of the current is missing.

    Parameters
    ----------
    shortest : lower bound, the transient of chi.
    times : measured time over the transient.
    """
    radius = largest_radius(circuit)
    first = shortest / radius
    tried = radius * np.unique(np.ceil(first * np.geomspace(1.0, max(1.0, LONGEST / first), 91)))
    enough = np.flatnonzero(np.abs(missing(circuit, chi, tried, times * tried)) <= allowed)
    return float(tried[enough[0] if enough.size else -1])

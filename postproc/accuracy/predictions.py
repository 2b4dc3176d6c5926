"""What memory in the urns predicts for the deciding experiments, by formulas without a fit.

An urn remembers by which opening one came (two ports), who flies along the axis goes on doing so
(circulation), and the angle to the channel diffuses from visit to visit (directions). Lengths over
the speed v = 1; an urn has radius r, openings w and w', area A.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

DRAWN = 2**18  # visits, spread evenly
BOUNCES = 20000  # after which a visit is taken as it is
PLASTIC = 1.32471795724474602596  # of the sequence that spreads points evenly over a square
DIFFUSION = 0.065  # D of sin(theta) a visit, over (w/r)^2: of drawn visits, not of runs
DEGREES = 40  # even Legendre polynomials of cos(theta) over sin(theta)


@dataclass(frozen=True)
class Ports:
    """How an urn answers an entrant through either opening.

    Attributes
    ----------
    return_chance : a, in through channel 2 and out through channel 2.
    stay1, stay2 : mean time in the urn, in through channel 1 and 2, from chord to chord.
    """

    return_chance: float
    stay1: float
    stay2: float


def polygons(circuit: Circuit) -> float:
    """Return a for small w': only orbits that close as polygons of odd sides find opening 2 again.

    a = (w'/4r) sum over odd n >= 3, pi/n > asin(w/2r), of (1/n) sum over k coprime to n of
    sin(pi k/n).
    """
    radius, half = float(circuit.urn_radius), 0.5 * float(circuit.channel1_width)
    most = math.pi / math.asin(half / radius)
    total = 0.0
    for sides in range(3, math.ceil(most), 2):
        turns = [k for k in range(1, sides) if math.gcd(k, sides) == 1]
        total += sum(math.sin(math.pi * k / sides) for k in turns) / sides
    return 0.25 * float(circuit.channel2_width) / radius * total


def ports(circuit: Circuit) -> Ports:
    """Return the ports of the disc: visits through opening 2 integrated, w t1 + w' t2 = pi A."""
    radius, one, two = (
        float(value)
        for value in (circuit.urn_radius, circuit.channel1_width, circuit.channel2_width)
    )
    chance, stay2 = _visits(radius, two, one)
    stay1 = (math.pi * float(circuit.urn_area) - two * stay2) / one
    return Ports(chance, stay1, stay2)


@lru_cache
def _visits(radius: float, own: float, other: float) -> tuple[float, float]:
    """Return chance to leave by the own opening, and mean stay, of visits through it.

    Entries have the measure ds dy, s = sin(theta). From bounce to bounce the place on the circle
    turns by the same angle.
    """
    count = np.arange(1, DRAWN + 1)
    y = own * ((0.5 + count / PLASTIC) % 1.0 - 0.5)
    sine = 2.0 * ((0.5 + count / PLASTIC**2) % 1.0) - 1.0
    cosine = np.sqrt(1.0 - sine**2)
    chord = {name: math.sqrt(radius**2 - 0.25 * name**2) for name in (own, other)}
    arcs = np.array([math.asin(0.5 * own / radius), math.asin(0.5 * other / radius)])
    # in at x = chord, flying to the left
    along = chord[own] * cosine - y * sine
    flight = along + np.sqrt(along**2 + 0.25 * own**2 - y**2)
    place = np.arctan2(y + sine * flight, chord[own] - cosine * flight)
    heading = math.pi - np.arcsin(sine)
    incidence = np.angle(np.exp(1j * (heading - place)))
    turn = math.pi - 2.0 * incidence
    step = 2.0 * radius * np.cos(incidence)
    stay, returned = np.zeros(DRAWN), np.zeros(DRAWN, bool)
    inside = np.arange(DRAWN)
    time = flight
    for _ in range(BOUNCES):
        angle = np.abs(np.angle(np.exp(1j * place)))
        home, away = angle < arcs[0], math.pi - angle < arcs[1]
        out = home | away
        if out.any():
            depth = np.where(home, radius * np.cos(angle) - chord[own], 0.0)
            depth += np.where(away, -radius * np.cos(angle) - chord[other], 0.0)
            slant = np.abs(np.cos(place + incidence))
            stay[inside[out]] = (time - depth / slant)[out]
            returned[inside[out]] = home[out]
            left = ~out
            inside, place, turn, step, time, incidence = (
                part[left] for part in (inside, place, turn, step, time, incidence)
            )
        if inside.size == 0:
            break
        place, time = place + turn, time + step
    stay[inside] = time
    return float(returned.mean()), float(stay.mean())


def conductance(circuit: Circuit, found: Ports | None = None) -> float:
    """Return G of I = G (n2 - n1), n inside the urns, of two ports: k/(t1 + k (2 t1 - t2))."""
    one = found or ports(circuit)
    ratio = float(circuit.channel2_width) / float(circuit.channel1_width)
    across = ratio * (1.0 - one.return_chance)
    k = across / (1.0 + one.return_chance - 2.0 * across)
    return k / (one.stay1 + k * (2.0 * one.stay1 - one.stay2))


def mixed_conductance(circuit: Circuit) -> float:
    """Return G0 = w'/(pi A) of urns without memory."""
    return float(circuit.channel2_width) / (math.pi * float(circuit.urn_area))


def circulation_rate(circuit: Circuit, dense: float, rounds: float) -> float:
    """Return how many particles a unit of time begin to go round so many times or more.

    (n2/pi A) (w'^2/L) (1 + 2 s/(1 - s))/m with d, d' the distances of the chords from the centre,
    L = 2 (d + d') + l + l' and s = l'/L; `dense` is n2, how many the dense urn holds.
    """
    returning = float(circuit.channel2_length)
    length = 2.0 * float(sum(circuit.chords)) + float(circuit.channel1_length) + returning
    share = returning / length
    beam = dense * float(circuit.channel2_width) ** 2 / (math.pi * float(circuit.urn_area) * length)
    return beam * (1.0 + 2.0 * share / (1.0 - share)) / rounds


@lru_cache
def direction_weights() -> tuple[Floats, Floats]:
    """Return (l (l + 1), weight) of the parts of cos(theta) that decay, weights of sum 1.

    cos(theta) = sqrt(1 - s^2) in Legendre polynomials of s, evenly spread over (-1, 1).
    """
    nodes, widths = legendre.leggauss(400)
    degrees = np.arange(2, 2 * DEGREES + 1, 2)
    values = np.sqrt(1.0 - nodes**2)
    parts = np.array(
        [0.5 * np.sum(widths * values * legendre.Legendre.basis(one)(nodes)) for one in degrees]
    )
    weights = (2 * degrees + 1) * parts**2
    return degrees * (degrees + 1.0), weights / weights.sum()


def autocorrelation(diffusion: float, visits: ArrayLike) -> Floats:
    """Return the autocorrelation of cos(theta) so many visits apart, D d/ds (1 - s^2) d/ds."""
    rates, weights = direction_weights()
    return np.exp(-diffusion * np.multiply.outer(np.asarray(visits, float), rates)) @ weights


def memory_time(circuit: Circuit) -> float:
    """Return the relaxation time of directions, 25 r^4/w^3 for l = r or so."""
    radius, width = float(circuit.urn_radius), float(circuit.channel1_width)
    visit = math.pi * float(circuit.urn_area) / width
    return visit / (6.0 * DIFFUSION * (width / radius) ** 2)

"""What memory in the urns predicts for the deciding experiments, by formulas without a fit.

Who flies along the axis goes on doing so (circulation), and the angle to the channel diffuses from
visit to visit (directions). What an urn remembers of the opening by which one came is in
`theory.ports` and `theory.two_port`. Lengths over the speed v = 1; an urn has radius r, openings w
and w', area A.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre

from postproc.theory.direction import DIFFUSION

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

DEGREES = 40  # even Legendre polynomials of cos(theta) over sin(theta)


def mixed_conductance(circuit: Circuit) -> float:
    """Return G0 = w'/(pi A) of urns without memory."""
    return float(circuit.channel2_width) / (math.pi * float(circuit.urn_area))


def circulation_rate(circuit: Circuit, dense: float, rounds: float) -> float:
    """Return how many particles a unit of time begin to go round so many times or more.

    (n2/pi A) (w'^2/L) (1 + 2 l'/(L - l'))/m with d, d' the distances of the chords from the centre,
    L = 2 (d + d') + l + l'; `dense` is n2, how many the dense urn holds.
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

"""Predictions for the experiments only; others are in `postproc.advice.transients`."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre

from postproc.theory import direction
from postproc.theory.circuit import gate_load

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

DEGREES = 40  # even Legendre polynomials of cos(theta) over sin(theta)


def mixed_conductance(circuit: Circuit) -> float:
    """Return G0 = w'/(pi A) of urns without memory."""
    return float(circuit.channel2_width) / (math.pi * float(circuit.urn_area))


def held_in_channels(circuit: Circuit, in_urn: ArrayLike) -> tuple[Floats, Floats]:
    """Return how many particles of an urn are in the channels, in its half and in the other.

    Particles that get through spend tau in either gate and pi l'/4 in either half of channel 2.
    Reversed ones, T + 1 at a time, have entered one after the other: on average T/(2 nu) before.
    """
    load = gate_load(circuit, in_urn)
    share = circuit.gate.share(circuit.threshold, load)
    returning = np.asarray(circuit.channel2_width) * np.asarray(circuit.channel2_length)
    beyond = share * load + np.asarray(in_urn) * returning / (4.0 * circuit.urn_area)
    return beyond + (1.0 - share) * np.minimum(np.asarray(circuit.threshold), load), beyond


@lru_cache
def direction_weights() -> tuple[Floats, Floats]:
    """Return (l (l + 1), weight) of the parts of cos(theta) that decay, weights of sum 1.

    cos(theta) = sqrt(1 - s^2) in Legendre polynomials of s, uniform in (-1, 1).
    """
    nodes, widths = legendre.leggauss(400)
    degrees = np.arange(2, 2 * DEGREES + 1, 2)
    values = np.sqrt(1.0 - nodes**2)
    parts = np.array(
        [0.5 * np.sum(widths * values * legendre.Legendre.basis(one)(nodes)) for one in degrees]
    )
    weights = (2 * degrees + 1) * parts**2
    return degrees * (degrees + 1.0), weights / weights.sum()


def diffusion(radius: float, width: float) -> float:
    """Return D of directions per visit, by the second eigenvalue exp(-6 D) of K11 without w'."""
    kernel = direction.transfer(radius, width, direction.NARROWEST * radius).kernel[0, 0]
    first, second = np.sort(np.linalg.eigvals(kernel).real)[:-3:-1]
    return math.log(first / second) / 6.0


def autocorrelation(diffusion: float, visits: ArrayLike) -> Floats:
    """Return the autocorrelation of cos(theta) at a lag in visits, by D d/ds (1 - s^2) d/ds."""
    rates, weights = direction_weights()
    return np.exp(-diffusion * np.multiply.outer(np.asarray(visits, float), rates)) @ weights

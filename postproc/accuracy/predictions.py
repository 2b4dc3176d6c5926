"""Memory of the urns by formulas without a fit: circulation, and relaxation of directions.

Particles that move along the axis continue to do so (circulation), and the angle to the channel
diffuses from visit to visit (directions). The memory of the opening of entry is in `theory.ports`
and `theory.two_port`. Lengths are over the speed v = 1; an urn has radius r, openings w and w',
area A.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from postproc.theory.direction import DIFFUSION

if TYPE_CHECKING:
    from postproc.theory.circuit import Circuit

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


def memory_time(circuit: Circuit) -> float:
    """Return the relaxation time of directions, 25 r^4/w^3 for l = r or so."""
    radius, width = float(circuit.urn_radius), float(circuit.channel1_width)
    visit = math.pi * float(circuit.urn_area) / width
    return visit / (6.0 * DIFFUSION * (width / radius) ** 2)

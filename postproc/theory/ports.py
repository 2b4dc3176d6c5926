"""Memory of an urn of the opening of entry: probabilities and mean stays of its visits.

An urn has two ports, the openings to channels 1 and 2. Of the particles that enter through channel
2 the share a, the return probability, leaves through channel 2. Visits conserve the measure
cos(theta) dtheta dy, and reversed visits are visits too, so w P12 = w' P21 (P12: in through 1, out
through 2), and the four probabilities follow from one: P22 = a, P21 = 1 - a, P12 = (w'/w)(1 - a),
P11 = 1 - P12. The mean stays t1, t2 after entries through 1 and 2 obey w t1 + w' t2 = pi A, since
the urn is filled uniformly.

If two equal urns with the outflows e_i into channel 1 and f_i into channel 2 are stationary, the
current of either channel is J = f_2 - f_1, and P12 (e_2 - e_1) = (1 + a - 2 P12) J. So J is G times
the difference of the numbers in them, G = c/(t1 + c (2 t1 - t2)) with c = P12/(1 + a - 2 P12).

A well mixed urn has a = w'/(w + w') and t1 = t2. A disc has not, however small the openings: a
particle comes back along a nearly closed polygon that misses opening 1, and such polygons have few
sides (`returns`; where the openings are opposite an odd number).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from postproc.theory.returns import return_chance
from postproc.theory.visits import visits

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.visits import Pieces

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Ports:
    """Probabilities and mean stays of an urn, by the opening of entry.

    Attributes
    ----------
    return_chance : a, probability in through channel 2 and out through channel 2.
    across : P12, in through channel 1 and out through channel 2.
    stay1, stay2 : mean time in the urn, in through channel 1 and 2, from chord to chord.
    """

    return_chance: float
    across: float
    stay1: float
    stay2: float

    @property
    def conductance(self) -> float:
        """G of equal urns: the net current over the difference of the numbers in the urns."""
        c = self.across / (1.0 + self.return_chance - 2.0 * self.across)
        return c / (self.stay1 + c * (2.0 * self.stay1 - self.stay2))


def well_mixed(circuit: Circuit) -> Ports:
    """Return the ports of an urn without memory."""
    width1, width2 = float(circuit.channel1_width), float(circuit.channel2_width)
    across, stay = width2 / (width1 + width2), math.pi * float(circuit.urn_area) / (width1 + width2)
    return Ports(across, across, stay, stay)


def disc(circuit: Circuit) -> Ports:
    """Return the ports of the disc: probabilities by polygons, stays by integration over visits.

    Both are computed for the narrower opening; the identities above give the other's. With a closed
    channel 2 there is no memory.
    """
    widths = float(circuit.channel1_width), float(circuit.channel2_width)
    if widths[1] == 0.0:
        return well_mixed(circuit)
    filled = math.pi * float(circuit.urn_area)
    narrow, wide = sorted(widths)
    radius = float(circuit.urn_radius)
    back, stay = return_chance(radius, narrow, wide), mean_stay(radius, narrow, wide)
    other_stay = (filled - narrow * stay) / wide
    if widths[1] <= widths[0]:
        return Ports(back, widths[1] / widths[0] * (1.0 - back), other_stay, stay)
    return Ports(1.0 - widths[0] / widths[1] * (1.0 - back), 1.0 - back, stay, other_stay)


@lru_cache(maxsize=512)
def mean_stay(radius: float, own: float, other: float) -> float:
    """Return the mean time in the urn, in through the opening of width `own`."""
    return sum(
        float((part.nodes()[1] * stays(radius, part, own, other)).sum())
        for part in visits(radius, own, other).parts()
    )


def stays(radius: float, found: Pieces, own: float, other: float) -> Floats:
    """Return the times of visits through openings of widths `own` and `other`, from chord to chord.

    n segments of 2 r cos(psi) minus the ends between arc and chord of either opening; at the nodes
    of the pieces, shape (2, piece).
    """
    place, _ = found.nodes()
    chord = {width: math.sqrt(radius**2 - 0.25 * width**2) for width in (own, other)}
    leaving = place + found.shift
    behind = np.where(found.same, chord[own], chord[other])
    ends = (radius * np.cos(place) - chord[own]) / np.cos(place - found.incidence)
    ends += (radius * np.cos(leaving) - behind) / np.cos(leaving + found.incidence)
    return 2.0 * radius * found.segments * np.cos(found.incidence) - ends

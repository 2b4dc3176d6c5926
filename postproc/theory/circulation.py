"""Particles that fly round and round through both channels, and the current they carry.

A particle that leaves channel 2 nearly along the axis, or so that the wall of channel 1 reflects it
back, crosses both urns without a bounce and comes back to channel 2. Unfolded at the walls of channel
1 it is displaced by eps = u Lam - k w a round (slope u, k reflections, Lam the way outside channel 2:
urn, channel 1, urn), and is lost if that takes it beyond the edge of channel 2. Inside channel 2 the
walls reflect; unfolded there its place x turns by u l' on a circle of circumference w'. So a round is

    x -> x + eps, lost unless |x| < w'/2          x -> x + u l' mod w'

and V_m is the volume in (y, sin(theta)) that lasts m rounds. Near each k it falls as 1/m, for the
axis as 2 (w'^2/L)(1 + 2 s/(1 - s))/m, L = Lam + l', s = l'/L.

The gate of a dense urn turns back nearly all, as a flat mirror: it fills these orbits with rho_2 =
e_2/(2w), what flows out of that urn, on top of those that come round already. On orbits that have
made m rounds the density is c_m = (1 - q_2) rho_2 + q_1 c_(m-1), c_0 = rho_2, where two urns that
forget would have (1 - q_2) rho_2 + q_1 rho_1. What is more of it is the circulating current,

    q_1 (rho_2 - rho_1) V_1 + (q_1 - q_2) rho_2 (sum over m > 1 of q_1^(m-1) V_m),

less the same for those that go round the other way, 1 and 2 exchanged. q is that of the shortest
stay, l/2. It is 0 where both urns are alike.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from postproc.theory import fate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

ROUNDS = 400  # iterated; from there on V_m falls as 1/m
PLACES = 96  # of x
SLOPES = 64  # on either side of each k, over DECADES of eps
DECADES = 4.0


@lru_cache(maxsize=64)
def _volumes(
    width1: float, width2: float, across: tuple[float, float], length1: float, length2: float
) -> Floats:
    """Return V_m for m = 1 ... ROUNDS; `across` are d + d' of urns 1 and 2."""
    outside = sum(across) + length1
    rungs = np.linspace(-DECADES, 0.0, SLOPES + 1)
    size = 10.0 ** (0.5 * (rungs[1:] + rungs[:-1]))
    weight = np.diff(np.concatenate([[0.0], 10.0 ** rungs[1:]]))
    eps, weight = width2 * np.concatenate([-size, size]), width2 * np.tile(weight, 2)
    x = width2 * ((np.arange(PLACES) + 0.5) / PLACES - 0.5)
    reach = 0.5 * (width1 + width2) / max(across)  # the steepest slope through both openings
    volumes = np.zeros(ROUNDS)
    for k in range(int(reach * outside / width1 + 1.0) + 1):
        slope = (k * width1 + eps) / outside
        chosen = (slope > 0.0) & (slope < reach)
        u, shift = np.meshgrid(slope[chosen], x, indexing="ij")[0], eps[chosen]
        share = weight[chosen] / outside * (1.0 + slope[chosen] ** 2) ** -1.5
        share = share * 2.0 * width2 / PLACES  # both signs of the slope
        volumes += _lasting(u, shift, x, share, (width1, width2, *across, length2))
    return volumes


def _lasting(u: Floats, eps: Floats, x: Floats, share: Floats, table: tuple[float, ...]) -> Floats:
    """Return the volume that lasts 1 ... ROUNDS rounds, of slopes `u` (slope, place)."""
    width1, width2, across1, across2, length2 = table
    at = np.broadcast_to(x, u.shape).ravel().copy()
    row, slope = np.repeat(np.arange(u.shape[0]), x.size), u.ravel()
    found = np.zeros(ROUNDS)
    for m in range(ROUNDS):
        moved = at + eps[row]
        lasts = np.abs(moved) < 0.5 * width2
        # into channel 1, and out of it
        lasts &= np.abs(at + slope * across1) < 0.5 * width1
        lasts &= np.abs(moved - slope * across2) < 0.5 * width1
        at, row, slope = moved[lasts], row[lasts], slope[lasts]
        found[m] = share[row].sum()
        at = np.mod(at + slope * length2 + 0.5 * width2, width2) - 0.5 * width2
    return found


def volumes(circuit: Circuit) -> Floats:
    """Return V_m, the volume in (y, sin(theta)) that makes m = 1 ... ROUNDS rounds."""
    across = tuple(float(sum(one.chords)) for one in circuit.sides)
    return _volumes(
        float(circuit.channel1_width), float(circuit.channel2_width), across,
        float(circuit.channel1_length), float(circuit.channel2_length),
    )  # fmt: skip


def series(lasting: Floats, share: float) -> float:
    """Return the sum over m > 1 of share^(m-1) V_m, with V_m as 1/m beyond the last."""
    m = np.arange(1, lasting.size + 1)
    total = float((share ** (m[1:] - 1) * lasting[1:]).sum())
    decay = -np.log(min(max(share, 1e-300), 1.0 - 1e-12))
    beyond = special.exp1(decay * (lasting.size + 0.5)) * np.exp(decay)
    return total + float(lasting[-1] * lasting.size * beyond)


def circulating_current(circuit: Circuit, entries: Floats) -> float:
    """Return the current of channel 2 from urn 2 to urn 1 that goes round.

    Parameters
    ----------
    entries : e, what urns 1 and 2 send into channel 1 per unit time, shape (2,).
    """
    if float(circuit.channel2_width) == 0.0:
        return 0.0
    lasting, sides = volumes(circuit), circuit.sides
    stays, shares = fate.cosine_law(0.5 * float(circuit.channel1_length))
    density = np.asarray(entries, float) / (2.0 * float(circuit.channel1_width))
    q = [
        float(fate.passing(int(one.threshold), float(rate), stays, shares)[0])
        for one, rate in zip(sides, entries, strict=True)
    ]

    def around(sparse: int, dense: int) -> float:
        first = q[sparse] * (density[dense] - density[sparse]) * lasting[0]
        rest = (q[sparse] - q[dense]) * density[dense] * series(lasting, q[sparse])
        return float(first + rest)

    return around(0, 1) - around(1, 0)

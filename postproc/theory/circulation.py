"""Particles that fly round and round through both channels, and the current they carry.

A particle that leaves channel 2 nearly along the axis, or so that the wall of channel 1 reflects it
back, crosses both urns without a bounce and comes back to channel 2. Unfolded at the walls of
channel 1 it is displaced by eps = u Lam - k w a round (slope u, k reflections, Lam the way outside
channel 2: urn, channel 1, urn), and is lost if that takes it beyond the edge of channel 2. Inside
channel 2 the walls reflect; unfolded there its place x turns by u l' on a circle of circumference
w'. So a round is

    x -> x + eps, lost unless |x| < w'/2          x -> x + u l' mod w'

and every round loses one arc of that circle, next to the edge, of length |eps| (more where channel
1's mouths cut off too). What lasts m rounds is what m such arcs, each turned by eps + u l' against
the one before, leave uncovered. Integrated over slopes that is V_m, a volume in (y, sin(theta));
it falls as 1/m, so that each decade of m carries as much current as the one before.

The gate of a dense urn turns back nearly all, as a flat mirror: it fills these orbits with rho_2 =
e_2/(2w), what flows out of that urn, on top of those that come round already. On orbits that have
made m rounds the density is c_m = (1 - q_2) rho_2 + q_1 c_(m-1), with c_0 = f_2/(2w') in channel 2,
where two urns that forget would have (1 - q_2) rho_2 + q_1 rho_1. What is more of it circulates,

    q_1 (c_0 - rho_1) V_1 + ((1 - q_2) rho_2 - (1 - q_1) c_0) (sum over m > 1 of q_1^(m-1) V_m),

less the same for those that go round the other way, 1 and 2 exchanged. q is that of the shortest
stay, l/2. It is 0 where both urns are alike. Each passes urn 2 for certain, where the two ports
have it pass by the chance P12 already, and urn 1 where they send it back by the chance a; the rest
is a source between the openings, to which the urns answer (`response`).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from postproc.theory import fate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.ports import Ports

    Floats = NDArray[np.float64]

ROUNDS = 128  # looked at; from there on V_m falls as 1/m
LATE = 32  # rounds from which the 1/m is taken
SAMPLES = 14  # of the numbers of rounds
PARTS = 12  # of w', turned by which a place comes back after as many rounds: told apart
LADDER = np.geomspace(3e-4, 0.1, 19)  # of w', towards each of these


@lru_cache(maxsize=64)
def _volumes(
    width1: float, width2: float, across: tuple[float, float], length1: float, length2: float
) -> Floats:
    """Return V_m for m = 1 ... ROUNDS; `across` are d + d' of urns 1 and 2."""
    outside = sum(across) + length1
    reach = 0.5 * (width1 + width2) / max(across)  # the steepest slope through both openings
    rounds = np.unique(np.geomspace(1, ROUNDS, SAMPLES).round().astype(int))
    found = np.zeros(rounds.size)
    for k in range(int(reach * outside / width1 + 1.0) + 1):
        slope, weight = _slopes(k * width1, width2, outside, length2, reach)
        shift = slope * outside - k * width1
        above = np.minimum(0.5 * width2 - np.maximum(shift, 0.0), 0.5 * width1 - slope * across[0])
        below = 0.5 * width1 - slope * across[1] + shift
        below = np.minimum(0.5 * width2 + np.minimum(shift, 0.0), below)
        lost = width2 - np.maximum(above + below, 0.0)
        share = 2.0 * weight * (1.0 + slope**2) ** -1.5  # slopes of both signs
        turn = shift + slope * length2
        found += [share @ _uncovered(width2, lost, turn, int(m)) for m in rounds]
    every = np.arange(1, ROUNDS + 1)
    return np.exp(np.interp(np.log(every), np.log(rounds), np.log(np.maximum(found, 1e-300))))


def _slopes(
    across1: float, width2: float, outside: float, length2: float, reach: float
) -> tuple[Floats, Floats]:
    """Return slopes u and weights where |u Lam - `across1`| < w', with `across1` = k w.

    They crowd where a round turns by a simple part of w', for there a place may last.
    """
    low = max((across1 - width2) / outside, 0.0)
    high = min((across1 + width2) / outside, reach)
    if high <= low:
        return np.zeros(0), np.zeros(0)
    whole = outside + length2
    first, last = ((one * whole - across1) / width2 for one in (low, high))
    n = np.arange(1, PARTS + 1)
    parts = [np.arange(np.floor(first * q), np.ceil(last * q) + 1.0) / q for q in n]
    middle = np.unique(np.concatenate(parts).round(12))
    ends = (middle[:, None] + np.concatenate([-LADDER, [0.0], LADDER])).ravel()
    ends = (ends * width2 + across1) / whole
    # and where u Lam = k w, on a ladder too
    still = (across1 + width2 * np.concatenate([-LADDER, [0.0], LADDER])) / outside
    ends = np.unique(np.concatenate([[low, high], ends, still]))
    ends = ends[(ends >= low) & (ends <= high)]
    return 0.5 * (ends[1:] + ends[:-1]), np.diff(ends)


def _uncovered(around: float, arc: Floats, turn: Floats, count: int) -> Floats:
    """Return what `count` arcs, each turned against the last, leave of circles; shape (circle,)."""
    places = np.sort(np.mod(np.arange(count) * turn[:, None], around), axis=1)
    gaps = np.diff(places, axis=1, append=places[:, :1] + around)
    return np.maximum(gaps - arc[:, None], 0.0).sum(axis=1)


def volumes(circuit: Circuit) -> Floats:
    """Return V_m, the volume in (y, sin(theta)) that makes m = 1 ... ROUNDS rounds."""
    across = tuple(float(sum(one.chords)) for one in circuit.sides)
    return _volumes(
        float(circuit.channel1_width), float(circuit.channel2_width), across,
        float(circuit.channel1_length), float(circuit.channel2_length),
    )  # fmt: skip


def series(lasting: Floats, share: float, rounds: float = math.inf) -> float:
    """Return the sum of share^(m-1) V_m over 1 < m <= `rounds`, with V_m as 1/m beyond the last."""
    m = np.arange(1, lasting.size + 1)
    total = float((share ** (m[1:] - 1) * lasting[1:])[m[1:] <= rounds].sum())
    if rounds <= lasting.size:
        return total
    decay = -np.log(min(max(share, 1e-300), 1.0 - 1e-12))
    ends = special.exp1(decay * (np.array([lasting.size, rounds]) + 0.5)) * np.exp(decay)
    return total + float((m * lasting)[LATE - 1 :].mean() * (ends[0] - ends[1]))


def round_time(circuit: Circuit) -> float:
    """Return how long a round takes at speed 1: across both urns and through both channels."""
    across = sum(float(sum(one.chords)) for one in circuit.sides)
    return across + float(circuit.channel1_length) + float(circuit.channel2_length)


def response(one: Ports) -> float:
    """Return the current that a source of 1 between an urn's openings drives, urns' numbers kept.

    J (1 + a - 2 P12) = P12 (e_2 - e_1) + source, t1 (e_2 - e_1) = n_2 - n_1 - (2 t1 - t2) J.
    """
    drop = one.across * (2.0 - one.stay2 / one.stay1)
    return 1.0 / (1.0 + one.return_chance - 2.0 * one.across + drop)


def circulating_current(
    circuit: Circuit, urns: Sequence[Ports], entries: Floats, across: Floats,
    age: ArrayLike = math.inf,
) -> Floats:  # fmt: skip
    """Return the current of channel 2 from urn 2 to urn 1 that goes round, at each age.

    Parameters
    ----------
    urns : the ports of urns 1 and 2.
    entries, across : e and f, what they send into channels 1 and 2 per unit time, shape (2,).
    age : of the run, of any shape: orbits of more rounds than have been flown by then are not
        filled yet.
    """
    if float(circuit.channel2_width) == 0.0:
        return np.zeros(np.shape(age))
    lasting = volumes(circuit)
    stays, shares = fate.cosine_law(0.5 * float(circuit.channel1_length))
    into_gate = np.asarray(entries, float) / (2.0 * float(circuit.channel1_width))
    in_channel = np.asarray(across, float) / (2.0 * float(circuit.channel2_width))
    q = [
        float(fate.passing(int(one.threshold), float(rate), stays, shares)[0])
        for one, rate in zip(circuit.sides, entries, strict=True)
    ]
    rounds = np.asarray(age, float) / round_time(circuit)

    def around(sparse: int, dense: int) -> Floats:
        first = q[sparse] * (in_channel[dense] - into_gate[sparse]) * lasting[0]
        fed = (1.0 - q[dense]) * into_gate[dense] - (1.0 - q[sparse]) * in_channel[dense]
        sums = [series(lasting, q[sparse], float(one)) for one in rounds.flat]
        rest = fed * np.reshape(sums, rounds.shape)
        source = (1.0 - urns[dense].across) * (first + rest) + urns[sparse].return_chance * rest
        return response(urns[sparse]) * source

    return around(0, 1) - around(1, 0)

"""Circulations: passages of channel 2 that come straight from the middle of channel 1.

A particle that leaves channel 2 along the table's axis, or such that it hits the wall of channel 1
exactly at its middle, returns straight to channel 2 without a wall hit in an urn. Such orbits are
marginally stable: the closer a particle is to one the more rounds it makes. Passages of channel 2
that come straight from the middle of channel 1 are recognised by their time of flight, and those of
one particle without a wall hit in an urn are counted as the rounds of one circulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studies.common.event_log import CROSSING1, CROSSING2, ENTRY, outward_stays

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from studies.common.event_log import Log, ParticleEvents

    Floats = NDArray[np.float64]

TRANSIENT = 1000.0  # time that is left out at the start of every run
ROUNDS = 2 ** np.arange(14)  # rounds at which circulations are counted


@dataclass(frozen=True)
class Circulations:
    """Passages of channel 2 in one log after the transient; fields of shape (passage,).

    Attributes
    ----------
    time : time of the passage.
    sign : 1 from urn 2 to urn 1, the direction of the net current, else -1.
    rounds : number of rounds of the particle without a wall hit in an urn; 0: not straight.
    all_rounds : the rounds at each event of `ParticleEvents`, shape (event,).
    """

    time: Floats
    sign: NDArray[np.int64]
    rounds: NDArray[np.int64]
    all_rounds: NDArray[np.int64]


def straight_time(circuit: Circuit) -> float:
    """Return the time from the middle line to the periodic line along the axis."""
    return float(sum(circuit.chords)) + 0.5 * (circuit.channel1_length + circuit.channel2_length)


def steepest(circuit: Circuit) -> float:
    """Return the largest slope of a straight way through an urn from one channel to the other."""
    return 0.5 * (circuit.channel1_width + circuit.channel2_width) / float(sum(circuit.chords))


def circulations(events: ParticleEvents, circuit: Circuit) -> Circulations:
    """Return the passages of channel 2 with the rounds made."""
    shortest = straight_time(circuit)
    longest = shortest * math.hypot(1.0, steepest(circuit)) * (1.0 + 1e-9)
    passes = np.flatnonzero(events.kind == CROSSING2)
    last = events.before[passes]  # for a straight passage: the crossing of channel 1
    flight = np.where(last >= 0, events.time[passes] - events.time[last], math.inf)
    # the crossing of channel 1 was towards the urn that the particle now leaves
    straight = (flight <= longest) & (events.kind[last] == CROSSING1)
    straight &= events.where[last] + events.where[passes] == 33
    entry = np.where(straight, events.before[last], -1)
    first = np.where(entry >= 0, events.before[entry], -1)
    before = events.time[last] - events.time[first]
    round_before = (first >= 0) & (events.kind[first] == CROSSING2) & (before <= longest)
    round_before &= events.where[first] == events.where[passes]
    rounds = np.zeros(events.time.size, int)
    for place in np.flatnonzero(straight):
        rounds[passes[place]] = 1 + (rounds[first[place]] if round_before[place] else 0)
    sign = np.where(events.where[passes] == 21, 1, -1)
    order = np.argsort(events.time[passes], kind="stable")
    order = order[events.time[passes[order]] > TRANSIENT]
    columns = (events.time[passes], sign, rounds[passes])
    return Circulations(*(column[order] for column in columns), rounds)


def numbers_in_time(
    log: Log, at_start: int, end: float, added_by: int
) -> tuple[NDArray[np.int64], Floats]:
    """Return the numbers in a half of the table after the transient, and how long each lasts.

    `at_start` began in it; crossings in the direction `added_by`, 12 or 21, add one.
    """
    crossed = (log.kind == CROSSING1) | (log.kind == CROSSING2)
    change = np.where(log.where[crossed] == added_by, 1, -1)
    edges = np.concatenate([[TRANSIENT], np.clip(log.time[crossed], TRANSIENT, end), [end]])
    return at_start + np.concatenate([[0], np.cumsum(change)]), np.diff(edges)


def urn_numbers(
    log: Log, events: ParticleEvents, circuit: Circuit, at_start: int, end: float
) -> tuple[float, float]:
    """Return the mean numbers inside urn 1 and urn 2 after the transient, channels left out.

    `at_start` is the number that began in half 2.
    """
    number, lasting = numbers_in_time(log, at_start, end, 12)
    duration = end - TRANSIENT
    half = number @ lasting / duration
    through2 = np.count_nonzero((events.kind == CROSSING2) & (events.time > TRANSIENT))
    returning = through2 * 0.25 * math.pi * circuit.channel2_length
    gate, start, stop = outward_stays(events)
    known = np.where(events.after >= 0, events.time[events.after], events.time)
    leaves = np.where(np.isfinite(events.turned), events.turned, known)
    held = []
    for one in (1, 2):
        outward = (stop - start)[(gate == one) & (start > TRANSIENT)].sum()
        entry = (events.kind == ENTRY) & (events.where == one) & (events.time > TRANSIENT)
        inward = (leaves - events.time)[entry].sum()
        held.append(float(outward + inward + returning) / duration)
    return circuit.number - half - held[0], float(half - held[1])

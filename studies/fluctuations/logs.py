"""Counts of channel 2 from event logs, with and without those that particles repeat going round.

A repeat is a passage of channel 2 by a particle that passed it the same way one round earlier,
without a bounce in an urn: a straight way takes the time L along the axis, or a little more. What
has a bounce takes longer. A train is a passage and the repeats that follow it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studies.circulations import steepest, straight_time
from studies.event_log import CROSSING2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from studies.event_log import Circuit, Log

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

ROUNDING = 1e-9


@dataclass(frozen=True)
class Passages:
    """Passages of channel 2, by particle and then time; fields of shape (passage,).

    Attributes
    ----------
    time : when.
    sign : 1 from urn 2 to urn 1, -1 back.
    repeat : whether it repeats the particle's passage before.
    """

    time: Floats
    sign: Integers
    repeat: NDArray[np.bool_]

    @property
    def trains(self) -> tuple[Floats, Integers, Integers]:
        """When each train begins, its sign, and how many passages it has."""
        first = np.flatnonzero(~self.repeat)
        return self.time[first], self.sign[first], np.diff(np.append(first, self.time.size))

    def counts(self, begin: float, end: float, step: float, *, repeats: bool) -> Integers:
        """Return net counts of intervals, with or without repeats."""
        kept = repeats | ~self.repeat
        kept &= (self.time >= begin) & (self.time < end)
        place = ((self.time[kept] - begin) / step).astype(int)
        many = round((end - begin) / step)
        return np.rint(np.bincount(place, self.sign[kept], many)[:many]).astype(int)


def round_time(circuit: Circuit) -> float:
    """Return the time L of a round along the axis."""
    return 2.0 * straight_time(circuit)


def passages(log: Log, circuit: Circuit) -> Passages:
    """Return the passages of channel 2 of an event log."""
    there = np.flatnonzero(log.kind == CROSSING2)
    there = there[np.argsort(log.particle[there], kind="stable")]
    time, where, particle = log.time[there], log.where[there], log.particle[there]
    shortest = round_time(circuit)
    longest = shortest * math.hypot(1.0, steepest(circuit))
    gap = np.diff(time)
    same = (np.diff(particle) == 0) & (np.diff(where) == 0)
    same &= (gap >= shortest * (1.0 - ROUNDING)) & (gap <= longest * (1.0 + ROUNDING))
    return Passages(time, np.where(where == 21, 1, -1), np.concatenate([[False], same]))

"""Counts of channel 2 with circulations: independent crossings, and trains of crossings.

A particle that goes round m times without a bounce in an urn crosses channel 2 m times, a round's
time L apart: a train. Trains begin independently of each other at rates that the theory of
circulation has; all other crossings are taken to be independent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import gammaln, ive, logsumexp

from postproc.theory import circulation, two_port
from studies.common.theories import THEORIES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

LONGEST = 2**17  # crossings of a train
LATE = 64  # rounds from which rates are taken to fall as exp(-R m)/m
REPEATS = 300  # crossings by trains in an interval, at most, for P(J_t = j)


@dataclass(frozen=True)
class Trains:
    """Trains of crossings, and all others.

    Attributes
    ----------
    rate : how often per unit time trains of 2, 3, ... crossings begin, shape (train,).
    period : time L between the crossings of one train.
    with_, against : rates of the other crossings, with the current and against it.
    """

    rate: Floats
    period: float
    with_: float
    against: float

    @property
    def crossings(self) -> Floats:
        """How many each train has, shape (train,)."""
        return np.arange(2.0, self.rate.size + 2.0)

    @property
    def flow(self) -> float:
        """Crossings by trains per unit time."""
        return float(self.rate @ self.crossings)

    @property
    def current(self) -> float:
        """Net current."""
        return self.with_ + self.flow - self.against

    def cumulant(self, order: int, time: float) -> float:
        """Return the cumulant of the count in an interval, over its length."""
        part = float(self.rate @ powers_in_window(self.crossings, self.period, time, order))
        return self.with_ + (-1) ** order * self.against + part / time

    def in_window(self, time: float) -> Floats:
        """Return the rates at which trains have 0, 1, 2, ... crossings in an interval, times t."""
        whole, part = divmod(time / self.period, 1.0)
        whole, many = int(whole), self.crossings
        found = np.zeros(whole + 2)
        for k in range(1, whole + 1):  # trains that begin or end in the interval
            found[k] += 2.0 * self.rate[many > k].sum()
        for m in range(2, min(whole, self.rate.size + 1) + 1):  # and that do both
            found[m] += self.rate[m - 2] * (time / self.period - (m - 1.0))
        longer = np.maximum(many - whole, 0.0) * self.rate  # or neither
        found[whole] += (1.0 - part) * (longer - np.sign(longer) * self.rate).sum()
        found[whole + 1] += part * longer.sum()
        found *= self.period
        found[0] = 0.0
        return found

    def slopes(self, time: float, counts: Sequence[int]) -> Floats:
        """Return ln[P(J_t = j)/P(J_t = -j)]/j of each count j."""
        several = self.in_window(time)
        chance = np.zeros(REPEATS)  # of n crossings by trains
        chance[0] = math.exp(-several.sum())
        for n in range(1, REPEATS):
            k = np.arange(1, min(n, several.size - 1) + 1)
            chance[n] = (k * several[k]) @ chance[n - k] / n
        n = np.arange(REPEATS)
        with np.errstate(divide="ignore"):
            log_chance = np.log(chance)

        def log_probability(count: int) -> float:
            return float(logsumexp(self._log_others(count - n, time) + log_chance))

        return np.array([(log_probability(j) - log_probability(-j)) / j for j in counts])

    def _log_others(self, count: NDArray[np.int64], time: float) -> Floats:
        """Return ln P of a net count of the other crossings (Skellam's distribution)."""
        mean, size = 2.0 * time * math.sqrt(self.with_ * self.against), np.abs(count)
        with np.errstate(divide="ignore"):
            bessel = np.log(ive(size, mean)) + mean
        small = size * math.log(0.5 * mean) - gammaln(size + 1.0) + mean**2 / (4.0 * (size + 1.0))
        bessel = np.where(np.isfinite(bessel), bessel, small)
        tilt = 0.5 * count * math.log(self.with_ / self.against)
        return bessel + tilt - (self.with_ + self.against) * time


def powers_in_window(crossings: Floats, period: float, time: float, order: int) -> Floats:
    """Return the integral, over where an interval lies, of a power of the crossings in it.

    Parameters
    ----------
    crossings : of each train.
    period : time between them.
    time : length of the interval.
    order : the power.
    """
    whole, part = divmod(time / period, 1.0)
    sums = np.concatenate([[0.0], np.cumsum(np.arange(1.0, whole + 1.0) ** order)])
    short = crossings <= whole
    last = np.minimum(crossings, whole + 1.0).astype(int) - 1
    edges = 2.0 * sums[np.where(short, last, int(whole))]
    both = (time / period - (crossings - 1.0)) * crossings**order
    more = crossings - whole
    inner = (more - 1.0) * (1.0 - part) * whole**order + more * part * (whole + 1.0) ** order
    return period * (edges + np.where(short, both, inner))


def begun(circuit: Circuit) -> tuple[Floats, float]:
    """Return the rates of trains by crossings, from 2 on, and the time of a round.

    From the theory of circulation, for particles from urn 2, the dense one; from some round on
    rates fall as exp(-R m)/m, R the fraction that the gate of the other urn reverses. A particle
    that is reversed there ends its train: that it may come back is left out.
    """
    own = THEORIES["two_port"].of(circuit)
    state = max(THEORIES["two_port"].solve_stable(own), key=lambda one: one.urn2_number)
    straight = two_port.straight_at(own, state.urn2_number)
    reached = np.zeros(circulation.ROUNDS + 2)  # rates of the c-th crossing of a train
    place, slope, _, weights = straight.begun(1, np.random.default_rng(1))
    origin = weights.sum(axis=0)
    made = np.ones(slope.size, int)
    for _, _, left, urn, through in straight.rounds(1, place, slope, np.random.default_rng(2)):
        made[left] = np.where(through, made[left] + 1, -LONGEST)
        down = left[(urn == 1) & (made[left] > 0) & (made[left] < reached.size)]
        reached += np.bincount(made[down], origin[down], reached.size)
    ended = 1.0 - float(straight.share[0])
    many = np.arange(2, LONGEST + 1)
    known = np.arange(LATE, reached.size)
    height = (known * np.exp(ended * known) * reached[known]).mean()
    late = height * np.exp(-ended * many) / many
    rates = np.where(many <= LATE, reached[np.minimum(many, LATE)], late)
    rates = np.minimum.accumulate(rates)
    return -np.diff(np.append(rates, 0.0)), circulation.round_time(own)

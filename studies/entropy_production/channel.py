"""What entered channel 1, given what left it: the weight of all pasts, many particles, any T.

If entries are Poisson, a past weighs the product of its entries' rates. All pasts have the same
particles that leave; so one weighs as much as if all had been turned, times the ratio of the rates
for each that came through, which is known once that is at the middle line. Pasts are weighed
together, going back: two that have the same particles in the channel, doing the same, are one, with
the sum of their weights. Whom a hypothetical reversal turned is decided only where it makes a
difference: where a particle would enter if it was turned, or be at the middle line if it was not.
"""

from __future__ import annotations

import math
from bisect import insort
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from studies.entropy_production.selection import selected

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from studies.entropy_production.flights import Pass

NEVER = -math.inf


class Gate(NamedTuple):
    """A gate in a past.

    Attributes
    ----------
    outward : passes on their way out of it, the one that leaves last first.
    counted : (when it entered, pass) of those that are counted and known, in the order of time.
    unknown : how many more of `outward` are counted, since they are turned at `fired`.
    fired : time of that reversal, minus infinity if `unknown` is 0.
    next : time, going back, at which something happens in it; minus infinity if nothing does.
    """

    outward: tuple[int, ...]
    counted: tuple[tuple[float, int], ...]
    unknown: int
    fired: float
    next: float


class Situation(NamedTuple):
    """Both gates in a past, and the next time, going back, at which something happens to them."""

    gates: tuple[Gate, Gate]
    next: float


def _both(which: int, gate: Gate, other: Gate) -> Situation:
    """Return a past with such a gate 1 (`which` 0) or 2 (1), and such another."""
    gates = (gate, other) if which == 0 else (other, gate)
    return Situation(gates, gate.next if gate.next > other.next else other.next)


class Past(NamedTuple):
    """A situation, the weight of all histories that follow it, and whether the true one is such."""

    situation: Situation
    weight: float
    true: bool

    @property
    def inside(self) -> int:
        """Return how many particles are in the channel."""
        return sum(len(gate.outward) + len(gate.counted) for gate in self.situation.gates)


@dataclass(frozen=True)
class Weighed:
    """How much all pasts weigh, over the weight of the true one, as the depth grows.

    Attributes
    ----------
    time : of each particle that leaves channel 1, descending.
    log_ratio : logarithm of this ratio just before.
    pasts : how many were told apart then, before the selection.
    """

    time: NDArray[np.float64]
    log_ratio: NDArray[np.float64]
    pasts: NDArray[np.int64]

    def mean(self, end: float, low: float, high: float) -> float:
        """Return the mean of the logarithm over depths from `low` to `high` before `end`."""
        back = np.concatenate([[0.0], end - self.time])
        grid = low + (np.arange(64) + 0.5) / 64.0 * (high - low)
        return float(np.interp(grid, back, np.concatenate([[0.0], self.log_ratio])).mean())


class Channel:
    """Passes through channel 1, and the rule by which pasts of what left it are found."""

    def __init__(self, passes: Sequence[Pass], threshold: int, rates: Sequence[float]) -> None:
        """Take passes in the order in which they leave, and the rates of entries from both urns."""
        self.passes = passes
        self.threshold = threshold
        self.rates = rates
        self.left = [one.left for one in passes]
        self.half = [one.half for one in passes]
        self.middle = [one.left - one.half for one in passes]
        self.ratio = [rates[2 - one.exit.side] / rates[one.exit.side - 1] for one in passes]

    def truth(self, time: float) -> Situation:
        """Return the true past at a time."""
        outward: tuple[list[int], list[int]] = ([], [])
        counted: tuple[list, list] = ([], [])
        for at, one in enumerate(self.passes):
            if one.entered > time or one.left <= time:
                continue
            if time < min(one.turned, one.entered + one.half):
                insort(counted[one.entry.side - 1], (one.entered, at))
            else:
                outward[one.exit.side - 1].insert(0, at)
        one, other = (self._gate(tuple(out), tuple(came), 0, NEVER, time)
                      for out, came in zip(outward, counted, strict=True))  # fmt: skip
        return _both(0, one, other)

    def _gate(
        self, outward: tuple[int, ...], counted: tuple[tuple[float, int], ...], unknown: int,
        fired: float, now: float,
    ) -> Gate:  # fmt: skip
        """Return a gate with its next time, which is before `now`."""
        following = counted[-1][0] if counted else NEVER
        if outward:
            middle = self.middle
            latest = max([middle[at] for at in outward])
            following = max(following, latest)
            if unknown:
                for at in outward:
                    mirrored = 2.0 * fired - self.left[at]
                    if following < mirrored < now and self.left[at] > fired:
                        following = mirrored
        return Gate(outward, counted, unknown, fired, following)

    def _undecided(self, gate: Gate, now: float) -> int:
        """Return how many of those on their way out may have been turned at `fired`."""
        left, middle, fired = self.left, self.middle, gate.fired
        return len([at for at in gate.outward
                    if left[at] > fired and middle[at] < now
                    and 2.0 * fired - left[at] < now])  # fmt: skip

    def _step(self, past: Situation) -> Iterator[tuple[Situation, float, bool]]:
        """Yield what may be just before the next time.

        Each with the factor of its weight, and whether it is so in the history if `past` is.
        """
        now = past.next
        which = 0 if past.gates[0].next == now else 1
        gate, other = past.gates[which], past.gates[1 - which]
        if gate.counted and gate.counted[-1][0] == now:
            gone = self._gate(gate.outward, gate.counted[:-1], gate.unknown, gate.fired, now)
            yield _both(which, gone, other), 1.0, True
            return
        for at in gate.outward:
            middle = self.middle[at] == now
            mirrored = 2.0 * gate.fired - self.left[at]
            if not middle and not (mirrored == now and gate.unknown):
                continue
            candidate = gate.unknown > 0 and self.left[at] > gate.fired and mirrored <= now
            others = tuple([one for one in gate.outward if one != at])
            was_turned = candidate and self.passes[at].turned == gate.fired
            if candidate:
                counted = gate.counted
                if mirrored < now:
                    counted = tuple(sorted((*counted, (mirrored, at))))
                rest = gate.unknown - 1
                turned = self._gate(others, counted, rest, gate.fired if rest else NEVER, now)
                yield _both(which, turned, other), 1.0, was_turned
                if self._undecided(gate, now) < gate.unknown:
                    return
            if not middle:
                same = self._gate(gate.outward, gate.counted, gate.unknown, gate.fired, now)
                yield _both(which, same, other), 1.0, not was_turned
            elif len(other.counted) + other.unknown < self.threshold:
                # came through from the other gate, if that has not T already
                out = self._gate(others, gate.counted, gate.unknown, gate.fired, now)
                entered = self.left[at] - 2.0 * self.half[at]
                counted = tuple(sorted((*other.counted, (entered, at))))
                there = self._gate(other.outward, counted, other.unknown, other.fired, now)
                yield _both(which, out, there), self.ratio[at], not was_turned
            return
        raise AssertionError("nothing happens at the next time")

    def _until(self, past: Past, time: float, found: dict[tuple[Gate, Gate], Past]) -> None:
        """Add to `found` what may be at a time: what is the same becomes one, with both weights."""
        todo = [past]
        while todo:
            one, weight, true = todo.pop()
            if one.next <= time:
                _, before, was = found.get(one.gates, (one, 0.0, False))
                found[one.gates] = Past(one, weight + before, true or was)
            else:
                todo.extend(Past(other, weight * factor, true and so)
                            for other, factor, so in self._step(one))  # fmt: skip

    def _leaves(
        self, past: Situation, at: int, side: int
    ) -> Iterator[tuple[Situation, float, bool]]:
        """Yield what may have been just before a particle left, as `_step` does."""
        gate, other, now = past.gates[side - 1], past.gates[2 - side], self.left[at]
        entrant = self.passes[at].turned == now
        out = self._gate((*gate.outward, at), gate.counted, gate.unknown, gate.fired, now)
        yield _both(side - 1, out, other), 1.0, not entrant
        if not gate.counted and not gate.unknown and len(gate.outward) >= self.threshold:
            when = now if self.threshold else NEVER
            fired = self._gate(gate.outward, (), self.threshold, when, now)
            yield _both(side - 1, fired, other), 1.0, entrant

    def weigh(
        self, begin: float, end: float, most: int, random: np.random.Generator
    ) -> Weighed:
        """Weigh all pasts of what left between two times.

        Of more than `most`, the true one and others selected at random go on, with their weights
        over the chances that they had: the sum is unbiased, the mean of its logarithm too small by
        about half of its relative variance. A past with many particles in the channel has still to
        explain them: it has less of a chance.
        """
        rate = sum(self.rates)
        present = self.truth(end)
        pasts = [Past(present, 1.0, true=True)]
        first, last = np.searchsorted(self.left, [begin, end])
        through = sorted(((one.left - one.half, math.log(self.ratio[at]))
                          for at, one in enumerate(self.passes)
                          if math.isinf(one.turned) and begin < one.left - one.half <= end),
                         reverse=True)  # fmt: skip
        times, ratios, counts = [], [], []
        log_all, log_true, known = 0.0, 0.0, 0
        for at in range(last - 1, first - 1, -1):
            now, side = self.left[at], self.passes[at].exit.side
            found: dict[tuple[Gate, Gate], Past] = {}
            for past in pasts:
                self._until(past, now, found)
            while known < len(through) and through[known][0] > now:
                log_true += through[known][1]
                known += 1
            total = sum(one.weight for one in found.values())
            times.append(now)
            ratios.append(log_all + math.log(total) - log_true)
            counts.append(len(found))
            kept = list(found.values())
            if len(kept) > most:
                true = [one for one in kept if one.true]
                others = [one for one in kept if not one.true]
                taken, chance = selected(
                    [one.weight * rate**-one.inside for one in others], most - 1, random
                )
                kept = true + [
                    others[place]._replace(weight=others[place].weight / over)
                    for place, over in zip(taken.tolist(), chance.tolist(), strict=True)
                ]
            log_all += math.log(total)
            pasts = [Past(other, one.weight * factor / total, one.true and so)
                     for one in kept
                     for other, factor, so in self._leaves(one.situation, at, side)]  # fmt: skip
            if not any(one.true for one in pasts):
                raise AssertionError("the true past is not among all")
        return Weighed(np.array(times), np.array(ratios), np.array(counts))


def share_of_two_pasts(points: int = 1000) -> float:
    """Return the share of firings after which a state has two pasts: two particles, T = 1.

    The gate reverses A, which entered tau before B: tau is uniform up to theta_A, the time from the
    chord to the middle line. Both may have come through instead if theta_B > 2 theta_A - tau or
    theta_A > 2 theta_B + tau. By the cosine law theta is 1/(2 cos) of an angle with a density
    proportional to cos; that of A is weighted by theta_A. Midpoint rule.
    """
    middles = (np.arange(points) + 0.5) / points
    cosine, part = np.cos(0.5 * math.pi * middles)[:, None], middles[None, :]  # tau/theta_A
    above = 1.0 - np.sqrt(1.0 - (cosine / (2.0 - part)) ** 2)
    limit = np.maximum(1.0 - part, 2.0 * cosine)
    return float((above + np.sqrt(1.0 - (2.0 * cosine / limit) ** 2)).mean())


def pairs(passes: Sequence[Pass]) -> tuple[int, int]:
    """Return how many states of two particles in channel 1 have two pasts, T = 1.

    Of those that the gate reversed, and of those that came through. Only two that leave the same
    gate, one after the other, are looked at, by the two inequalities of `share_of_two_pasts`: what
    others do is neglected.
    """
    reversed_pairs = through = 0
    for side in (1, 2):
        for first, second in pairwise(one for one in passes if one.exit.side == side):
            tau = second.left - first.left
            if first.particle == second.particle or tau >= second.half:
                continue
            if math.isinf(first.turned) and math.isinf(second.turned):
                through += 1
            elif first.turned == second.turned == first.left:
                reversed_pairs += (first.half > 2.0 * second.half - tau
                                   or second.half > 2.0 * first.half + tau)  # fmt: skip
    return reversed_pairs, through

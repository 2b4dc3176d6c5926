"""Entries into channel 1, given its exits: the weight of all pasts, many particles, any T.

If entries are Poisson, the weight of a past is the product of its entries' rates. All pasts have
the same exits; so the weight is that of all particles reversed, times the ratio of the rates for
each that came through, which is known once it is at the middle line. Pasts are computed together,
backwards in time: two with the same particles in the channel, in the same states, are one, with the
sum of their weights. Which particles a hypothetical reversal has reversed is decided only when it
matters: where a particle would enter if it was reversed, or be at the middle line if it was not.
"""

from __future__ import annotations

import math
from bisect import insort
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from studies.entropy_production.flights import Pass

NEVER = -math.inf


class Gate(NamedTuple):
    """A gate in a past.

    Attributes
    ----------
    outward : passes that move outwards, the one that leaves last first.
    counted : (time of entry, pass) of those that are counted and known, in the order of time.
    unknown : how many more of `outward` are counted, since they are reversed at `fired`.
    fired : time of that reversal, minus infinity if `unknown` is 0.
    """

    outward: tuple[int, ...]
    counted: tuple[tuple[float, int], ...]
    unknown: int
    fired: float


class Situation(NamedTuple):
    """Both gates in a past, and the time of their next event backwards in time."""

    gates: tuple[Gate, Gate]
    next: float


class Past(NamedTuple):
    """A situation, the weight of all histories that follow it, and whether the true one does."""

    situation: Situation
    weight: float
    true: bool

    @property
    def inside(self) -> int:
        """Return the number of particles in the channel."""
        return sum(len(gate.outward) + len(gate.counted) for gate in self.situation.gates)


@dataclass(frozen=True)
class Weighed:
    """Weight of all pasts, over that of the true one, against depth.

    Attributes
    ----------
    time : times at which particles leave channel 1, descending.
    log_ratio : logarithm of this ratio just before.
    pasts : number of different pasts then.
    lost : largest share of the weight dropped at one of them; most of it would have become invalid.
    """

    time: NDArray[np.float64]
    log_ratio: NDArray[np.float64]
    pasts: NDArray[np.int64]
    lost: float


class Channel:
    """Passes through channel 1, and the rule that gives the pasts of their exits."""

    def __init__(self, passes: Sequence[Pass], threshold: int, rates: Sequence[float]) -> None:
        """Take passes in the order in which they leave, and the rates of entries from both urns."""
        self.passes = passes
        self.threshold = threshold
        self.rates = rates
        self.left = [one.left for one in passes]
        self.half = [one.half for one in passes]
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
        gates = (Gate(tuple(out), tuple(came), 0, NEVER)
                 for out, came in zip(outward, counted, strict=True))  # fmt: skip
        return self._situation(*gates, time)

    def _situation(self, one: Gate, other: Gate, now: float) -> Situation:
        """Return a past with its next time, which is before `now`."""
        following = NEVER
        for gate in (one, other):
            if gate.counted:
                following = max(following, gate.counted[-1][0])
            for at in gate.outward:
                following = max(following, self.left[at] - self.half[at])
                if gate.unknown:
                    mirrored = 2.0 * gate.fired - self.left[at]
                    if mirrored < now and self.left[at] > gate.fired:
                        following = max(following, mirrored)
        return Situation((one, other), following)

    def _undecided(self, gate: Gate, now: float) -> int:
        """Return how many of those moving outwards may have been reversed at `fired`."""
        return sum(
            self.left[at] > gate.fired
            and max(self.left[at] - self.half[at], 2.0 * gate.fired - self.left[at]) < now
            for at in gate.outward
        )

    def _step(self, past: Situation) -> Iterator[tuple[Situation, float, bool]]:
        """Yield the possible situations just before the next time.

        Each with the factor of its weight, and whether it is the true one if `past` is.
        """
        now = past.next
        for which, gate in enumerate(past.gates):
            if gate.counted and gate.counted[-1][0] == now:
                gone = gate._replace(counted=gate.counted[:-1])
                yield self._with(past, which, gone), 1.0, True
                return
            for at in gate.outward:
                middle = self.left[at] - self.half[at] == now
                mirrored = 2.0 * gate.fired - self.left[at]
                candidate = gate.unknown > 0 and self.left[at] > gate.fired and mirrored <= now
                if not middle and not (candidate and mirrored == now):
                    continue
                others = tuple(one for one in gate.outward if one != at)
                was_turned = candidate and self.passes[at].turned == gate.fired
                if candidate:
                    counted = gate.counted
                    if mirrored < now:
                        counted = tuple(sorted((*counted, (mirrored, at))))
                    rest = gate.unknown - 1
                    fired = gate.fired if rest else NEVER
                    turned = Gate(others, counted, rest, fired)
                    yield self._with(past, which, turned), 1.0, was_turned
                    if self._undecided(gate, now) < gate.unknown:
                        return
                if not middle:
                    yield self._with(past, which, gate), 1.0, not was_turned
                elif (through := self._through(past, which, at, others)) is not None:
                    yield through, self.ratio[at], not was_turned
                return
        raise AssertionError("nothing happens at the next time")

    def _through(
        self, past: Situation, which: int, at: int, others: tuple[int, ...]
    ) -> Situation | None:
        """Return the past in which a pass came from the other gate; None if that counts T."""
        gate, other = past.gates[which], past.gates[1 - which]
        if len(other.counted) + other.unknown == self.threshold:
            return None
        entered = self.left[at] - 2.0 * self.half[at]
        other = other._replace(counted=tuple(sorted((*other.counted, (entered, at)))))
        gate = gate._replace(outward=others)
        pair = (gate, other) if which == 0 else (other, gate)
        return self._situation(*pair, past.next)

    def _with(self, past: Situation, which: int, gate: Gate) -> Situation:
        pair = (gate, past.gates[1]) if which == 0 else (past.gates[0], gate)
        return self._situation(*pair, past.next)

    def _until(self, past: Past, time: float, found: dict[tuple[Gate, Gate], Past]) -> None:
        """Add to `found` the possible pasts at a time; equal ones are merged, with both weights."""
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
        """Yield the possible situations just before a particle left, as `_step` does."""
        gate, now = past.gates[side - 1], self.left[at]
        entrant = self.passes[at].turned == now
        out = gate._replace(outward=(*gate.outward, at))
        pair = (out, past.gates[1]) if side == 1 else (past.gates[0], out)
        yield self._situation(*pair, now), 1.0, not entrant
        if not gate.counted and not gate.unknown and len(gate.outward) >= self.threshold:
            fired = Gate(gate.outward, (), self.threshold, now if self.threshold else NEVER)
            pair = (fired, past.gates[1]) if side == 1 else (past.gates[0], fired)
            yield self._situation(*pair, now), 1.0, entrant

    def weigh(self, begin: float, end: float, most: int) -> Weighed:
        """Compute the weight of all pasts of the exits between two times.

        Of more than `most` pasts, the true one and the heaviest are continued: then the sum is too
        small. The weight of a past with many particles in the channel is reduced by the rates of
        their entries.
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
        log_all, log_true, known, lost = 0.0, 0.0, 0, 0.0
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
            heaviest = list(found.values())
            if len(heaviest) > most:
                heaviest.sort(key=lambda one: (not one.true, -one.weight * rate ** -one.inside))
                lost = max(lost, sum(one.weight for one in heaviest[most:]) / total)
                heaviest = heaviest[:most]
            log_all += math.log(total)
            pasts = [Past(other, one.weight * factor / total, one.true and so)
                     for one in heaviest
                     for other, factor, so in self._leaves(one.situation, at, side)]  # fmt: skip
            if not any(one.true for one in pasts):
                raise AssertionError("the true past is not among all")
        return Weighed(np.array(times), np.array(ratios), np.array(counts), lost)

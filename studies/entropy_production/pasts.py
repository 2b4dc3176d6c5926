"""All pasts of a present state of few particles, with the exact rule of the gates.

Backwards in time every particle flies with its velocity turned. One that reaches a chord from the
urn left its gate there: either it had come through, or been turned before, and flies on towards the
middle line; or the gate fired at that instant, and it is back in the urn. The second is possible if
no particle is counted in that gate; then any T of those on their way out were counted. A past is
invalid where it comes to more than T that are counted: the last entry would have made the gate
fire.

Rounding errors grow too fast for a run back over more than some 60 time units. So particles that do
in a past what they did in the history take their passes from there. Those that did not are computed
from where they parted; they are typical of the past, if not exact. Of too many pasts
some are selected at random.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from studies.entropy_production.flights import Ray
from studies.entropy_production.selection import selected

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import ArrayLike, NDArray

    from studies.entropy_production.flights import Pass, Start, Table

    Floats = NDArray[np.float64]

AWAY, OUTWARD, COUNTED = 0, 1, 2  # in forward time: not in channel 1, on the way out of it, counted
UNKNOWN = -1
NOWHERE = Ray(0, 0.0, 1.0, 0.0)


class Backward(NamedTuple):
    """A particle of a past: what it does, going back, and when that ends.

    Attributes
    ----------
    status : AWAY until `until`, when it comes into its gate; OUTWARD until it is at the middle
        line; COUNTED until it is at the chord.
    until : time before the present.
    since : if OUTWARD, when it came in.
    ray : at the chord where it came in, or will come in or leave; the gate is `ray.side`.
    known : index of its pass in the history, as long as it does what it did there.
    """

    status: int
    until: float
    since: float
    ray: Ray
    known: int = UNKNOWN


class History:
    """The passes of each particle, and the present: a time between passes."""

    def __init__(self, passes: Sequence[Pass], number: int) -> None:
        self.passes: list[list[Pass]] = [[] for _ in range(number)]
        for one in sorted(passes, key=lambda one: one.entered):
            self.passes[one.particle].append(one)
        self.entered = [[one.entered for one in mine] for mine in self.passes]

    def state(self, time: float) -> list[Backward]:
        """Return the state at a time, as pasts begin."""
        return [
            self._present(particle, int(np.searchsorted(entered, time, "right")) - 1, time)
            for particle, entered in enumerate(self.entered)
        ]

    def _present(self, particle: int, known: int, time: float) -> Backward:
        """Return a particle at a time, the pass that it is in or had last being known."""
        if known < 0:  # it has not been in channel 1 yet
            return Backward(AWAY, math.inf, 0.0, NOWHERE)
        one = self.passes[particle][known]
        if time < min(one.turned, one.entered + one.half):
            return Backward(COUNTED, time - one.entered, 0.0, _back(one.entry), known)
        since, ray = time - one.left, _back(one.exit)
        if since >= 0.0:
            return Backward(AWAY, since, 0.0, ray, known)
        return Backward(OUTWARD, since + one.half, since, ray, known)


class Tree:
    """The rule, back from one present, at `time` of a history if there is one."""

    def __init__(
        self, table: Table, threshold: int, history: History | None = None, time: float = 0.0
    ) -> None:
        self.table, self.threshold, self.history, self.time = table, threshold, history, time
        # branches, and numbers of the same state, ask for the same ones again and again
        self.excursion = lru_cache(maxsize=2**14)(table.excursion)

    def pasts(self, present: Sequence[Backward], depth: float) -> list[list[Backward]]:
        """Return all pasts of a state at a depth; that of the history, if known, is the first."""
        return [past for past, *_ in self._until(list(present), 1.0, depth, true=True)]

    def number(
        self, present: Sequence[Backward], depths: ArrayLike, most: int, random: np.random.Generator
    ) -> Floats:
        """Return how many pasts a state of a history has, at ascending depths.

        Of more than `most` at one of the depths, the true past and others selected at random go on,
        and count for more. Then the number is unbiased, the mean of its logarithm too small.
        """
        found = []
        pasts = [(list(present), 1.0, True)]
        for depth in np.asarray(depths, float):
            there = [one for past, weight, true in pasts
                     for one in self._until(past, weight, depth, true=true)]  # fmt: skip
            found.append(sum(weight for _, weight, _ in there))
            if len(there) > most:
                others = [one for one in there if not one[2]]
                taken, chance = selected([weight for _, weight, _ in others], most - 1, random)
                there = [one for one in there if one[2]] + [
                    (others[at][0], others[at][1] / over, False)
                    for at, over in zip(taken.tolist(), chance.tolist(), strict=True)
                ]
            pasts = there
        return np.array(found)

    def _until(
        self, past: list[Backward], weight: float, depth: float, *, true: bool
    ) -> Iterator[tuple[list[Backward], float, bool]]:
        """Yield what a past may be at a depth, with its weight, and whether it is the true one."""
        todo = [(past, true)]
        while todo:
            one, so = todo.pop()
            branches = [one]
            while branches:
                one = branches.pop(0)
                todo.extend((other, False) for other in branches)
                untils = [particle.until for particle in one]
                now = min(untils)
                if now > depth:
                    yield one, weight, so
                    break
                branches = self._before(one, untils.index(now))

    def _before(self, past: list[Backward], first: int) -> list[list[Backward]]:
        """Return what may have been before something happens to a particle, what was first."""
        one, gate = past[first], past[first].ray.side
        if one.status == COUNTED:
            return [_with(past, {first: self._gone(first, one)})]
        if one.status == OUTWARD:
            before = _with(past, {first: self._through(first, one)})
            now_counted = len([at for at, other in enumerate(before)
                               if other.status == COUNTED and other.ray.side != gate])  # fmt: skip
            return [before] * (now_counted <= self.threshold)
        flight = self._with_known(first, one, fired=False)
        half = 0.5 * self.table.channel1_length / one.ray.axial
        flight = flight._replace(status=OUTWARD, until=one.until + half, since=one.until)
        branches = [_with(past, {first: flight})]
        if any(other.status == COUNTED and other.ray.side == gate for other in past):
            return branches
        others = [at for at, other in enumerate(past)
                  if other.status == OUTWARD and other.ray.side == gate]  # fmt: skip
        entrant = self._with_known(first, one, fired=True)
        for chosen in combinations(others, self.threshold):
            turned = {at: self._turned(at, past[at], one.until) for at in chosen}
            branches.append(_with(past, {first: self._gone(first, entrant), **turned}))
            if all(other.known != UNKNOWN for other in (entrant, *turned.values())):
                branches.insert(0, branches.pop())  # as in the history
        return branches

    def _with_known(self, particle: int, one: Backward, *, fired: bool) -> Backward:
        """Return a particle that comes into a gate, or is its entrant; what it did, if so."""
        if one.known != UNKNOWN:
            did = self.history.passes[particle][one.known]
            if (did.turned == did.left) != fired:
                return one._replace(known=UNKNOWN)
        return one

    def _gone(self, particle: int, one: Backward) -> Backward:
        """Return a counted particle, or an entrant, that leaves channel 1, going back."""
        if one.known > 0:
            did = self.history.passes[particle][one.known - 1]
            return Backward(AWAY, self.time - did.left, 0.0, _back(did.exit), one.known - 1)
        away, back = self.excursion(one.ray)
        return Backward(AWAY, one.until + away, 0.0, back)

    def _through(self, particle: int, one: Backward) -> Backward:
        """Return a particle at the middle line, which was counted in the other gate before."""
        if one.known != UNKNOWN:
            did = self.history.passes[particle][one.known]
            if math.isinf(did.turned):
                return Backward(COUNTED, self.time - did.entered, 0.0, _back(did.entry), one.known)
        half = one.until - one.since
        ray = self.table.along(one.ray, 2.0 * half)._replace(side=3 - one.ray.side)
        return Backward(COUNTED, one.until + half, 0.0, ray)

    def _turned(self, particle: int, one: Backward, now: float) -> Backward:
        """Return a particle on its way out as it was before the gate turned it at this instant."""
        if one.known != UNKNOWN:
            did = self.history.passes[particle][one.known]
            if self.time - did.turned == now:
                return Backward(COUNTED, self.time - did.entered, 0.0, _back(did.entry), one.known)
        stay = now - one.since
        return Backward(COUNTED, now + stay, 0.0, self.table.along(one.ray, 2.0 * stay))


def turned_start(table: Table, one: Start) -> Backward:
    """Return a particle of a past that begins, going back, at such a start."""
    if not one.inside:
        return Backward(AWAY, one.time, 0.0, one.ray)
    if one.time > 0.0:  # heads, backwards, for the chord
        return Backward(COUNTED, one.time, 0.0, one.ray)
    half = 0.5 * table.channel1_length / one.ray.axial
    return Backward(OUTWARD, one.time + half, one.time, one.ray)


def _back(ray: Ray) -> Ray:
    return ray._replace(lateral=-ray.lateral)


def _with(past: list[Backward], changed: dict[int, Backward]) -> list[Backward]:
    """Return a past with some particles changed."""
    branch = list(past)
    for at, one in changed.items():
        branch[at] = one
    return branch


def coordinates(table: Table, past: Sequence[Backward], depth: float) -> Floats | None:
    """Return x, y, ux, uy of a past's particles in the program's frame, forward in time.

    None if one of them was in channel 2 since it left channel 1, or has never been in that.
    """
    rows = []
    for one in past:
        ray = _back(one.ray)
        if one.status == AWAY:
            found = None if math.isinf(one.until) else table.in_urn(ray, one.until - depth)
            if found is None:
                return None
            place, velocity = found
        else:
            stay = one.until - depth if one.status == COUNTED else depth - one.since
            inward = 1.0 if one.status == COUNTED else -1.0
            now = table.along(ray, inward * stay)
            place = complex(-table.chords[0] - stay * now.axial, now.y)
            velocity = complex(-inward * now.axial, now.lateral)
        sign = 2 * ray.side - 3
        middle = place.real + table.chords[0] + 0.5 * table.channel1_length
        rows.append((sign * middle, place.imag, sign * velocity.real, velocity.imag))
    return np.array(rows)

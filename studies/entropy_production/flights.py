"""Particles one by one, r = 1: excursions between visits to channel 1, and its gates.

Between leaving channel 1 and entering it again a particle is alone: `excursion`. So a history is a
list of passes through channel 1, and the gates' rule decides how each ends: `histories`. Both urns
have one frame: its origin the centre, channel 1 at negative x, channel 2 at positive x.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from studies.event_log import Circuit

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy as np

CROSSING, ENTRY = 0, 1  # at one instant, crossings of the middle line come first
LONGEST = 10**7  # bounces of a visit


class Ray(NamedTuple):
    """A particle at the chord of channel 1.

    Attributes
    ----------
    side : urn, 1 or 2.
    y : its place on the chord.
    axial, lateral : velocity along the channel (positive: the way it goes) and across.
    """

    side: int
    y: float
    axial: float
    lateral: float


class Start(NamedTuple):
    """Where a particle is at time 0.

    Attributes
    ----------
    inside : whether it is in channel 1.
    time : if inside and heading for the middle line, when it was at the chord (negative); inside
        and heading for the chord, when it will be there; in an urn or channel 2, when it will enter
        channel 1.
    ray : then. In the direction of its flight, into channel 1 or out of it.
    """

    inside: bool
    time: float
    ray: Ray


class Pass(NamedTuple):
    """A pass through channel 1, from a chord to the same or the other.

    Attributes
    ----------
    particle : from 0.
    entered, left : times.
    entry, exit : rays, into the channel and out of it.
    half : time from the chord to the middle line.
    turned : when a gate turned it back; infinite if none did.
    """

    particle: int
    entered: float
    entry: Ray
    left: float
    exit: Ray
    half: float
    turned: float


@dataclass(frozen=True)
class Table(Circuit):
    """A circuit between urns of radius 1, and the rays in it."""

    @property
    def area(self) -> float:
        """Area of the table."""
        channels = (
            self.channel1_width * self.channel1_length + self.channel2_width * self.channel2_length
        )
        return 2.0 * self.urn_area + channels

    def entries(self, number: int) -> float:
        """Return the rate at which `number` particles enter from one urn in equilibrium."""
        return number * self.channel1_width / (math.pi * self.area)

    def along(self, ray: Ray, time: float) -> Ray:
        """Return a ray in channel 1 after some time, or before if negative: across, not along."""
        y, lateral = fold(ray.y + ray.lateral * time, ray.lateral, self.channel1_width)
        return ray._replace(y=y, lateral=lateral)

    def visit(
        self, place: complex, velocity: complex
    ) -> tuple[float, int, float, float, float]:
        """Return length of a flight from a point of an urn, the channel where it ends, the ray."""
        chord1, chord2 = self.chords
        along = place.real * velocity.real + place.imag * velocity.imag
        first = -along + math.sqrt(along**2 + 1.0 - abs(place) ** 2)
        impact = place + first * velocity
        impact /= abs(impact)
        normal = impact.real * velocity.real + impact.imag * velocity.imag
        turn = (impact + 2.0 * normal * (velocity - 2.0 * normal * impact)) * impact.conjugate()
        turn /= abs(turn)
        now, bounces = impact, 0
        while -chord1 <= now.real <= chord2:
            now *= turn
            bounces += 1
            if bounces > LONGEST:
                raise ArithmeticError(f"a visit of more than {LONGEST} bounces")
        now /= abs(now)
        velocity *= now * impact.conjugate()
        velocity /= abs(velocity)
        channel, chord = (1, -chord1) if now.real < 0.0 else (2, chord2)
        beyond = (now.real - chord) / velocity.real
        length = first + 2.0 * normal * bounces - beyond
        y = now.imag - beyond * velocity.imag
        return length, channel, y, abs(velocity.real), velocity.imag

    def flight(self, side: int, place: complex, velocity: complex) -> tuple[float, Ray]:
        """Return when a particle at a point of an urn enters channel 1, and the ray then."""
        time, channel, y, axial, lateral = self.visit(place, velocity)
        while channel == 2:
            duration = self.channel2_length / axial
            y, lateral = fold(y + lateral * duration, lateral, self.channel2_width)
            side = 3 - side
            again = self.visit(complex(self.chords[1], y), complex(-axial, lateral))
            time += duration + again[0]
            _, channel, y, axial, lateral = again
        return time, Ray(side, y, axial, lateral)

    def excursion(self, ray: Ray) -> tuple[float, Ray]:
        """Return how long a particle that leaves channel 1 stays away, and the ray it enters by."""
        place = complex(-self.chords[0], ray.y)
        return self.flight(ray.side, place, complex(ray.axial, ray.lateral))

    def in_urn(self, ray: Ray, time: float) -> tuple[complex, complex] | None:
        """Return place and velocity some time after leaving channel 1, None if in channel 2."""
        place, velocity = complex(-self.chords[0], ray.y), complex(ray.axial, ray.lateral)
        while True:
            along = place.real * velocity.real + place.imag * velocity.imag
            length = -along + math.sqrt(along**2 + 1.0 - abs(place) ** 2)
            if time <= length:
                return place + time * velocity, velocity
            place += length * velocity
            place /= abs(place)
            if place.real > self.chords[1]:
                return None
            velocity = -(place**2) * velocity.conjugate()
            time -= length

    def start(self, x: float, y: float, ux: float, uy: float) -> Start:
        """Return where a particle is, from place and velocity in the program's frame."""
        side, sign = (2, 1.0) if x > 0.0 else (1, -1.0)
        first, second = self.chords
        place = complex(sign * x - 0.5 * self.channel1_length - first, y)
        velocity = complex(sign * ux, uy)
        if place.real < -first:
            depth, axial = -first - place.real, abs(velocity.real)
            time = math.copysign(depth / axial, velocity.real)
            return Start(True, time, self.along(Ray(side, y, axial, uy), time))
        if place.real <= second:
            return Start(False, *self.flight(side, place, velocity))
        # in channel 2: as if it came out of its end
        depth, axial = place.real - second, abs(velocity.real)
        if velocity.real > 0.0:
            side, depth = 3 - side, self.channel2_length - depth
        time = depth / axial
        y, lateral = fold(y + uy * time, uy, self.channel2_width)
        away, ray = self.flight(side, complex(second, y), complex(-axial, lateral))
        return Start(False, time + away, ray)

    def random_starts(self, random: np.random.Generator, number: int) -> list[Start]:
        """Draw a state from Liouville's measure: uniform in the table and in direction."""
        first, second = self.chords
        far = 0.5 * self.channel1_length + first + second + 0.5 * self.channel2_length
        starts: list[Start] = []
        drawn = random.random  # as `uniform` draws, which takes longer for a single number
        while len(starts) < number:
            x, y = 2.0 * far * drawn() - far, 2.0 * drawn() - 1.0
            inner = abs(x) - 0.5 * self.channel1_length - first
            if inner < -first:
                within = abs(y) < 0.5 * self.channel1_width
            elif inner > second:
                within = abs(y) < 0.5 * self.channel2_width
            else:
                within = inner**2 + y**2 < 1.0
            if within:
                angle = 2.0 * math.pi * drawn()
                starts.append(self.start(x, y, math.cos(angle), math.sin(angle)))
        return starts


def fold(y: float, lateral: float, width: float) -> tuple[float, float]:
    """Return place and velocity across a channel, from the place between walls that reflect."""
    walls = math.floor(y / width + 0.5)
    y -= walls * width
    return (-y, -lateral) if walls % 2 else (y, lateral)


def histories(  # noqa: C901 -- the loop over events, of three kinds
    table: Table, threshold: int, starts: Sequence[Start], duration: float
) -> tuple[list[Pass], list[tuple[float, int, int, int]]]:
    """Return all passes that begin in the time given, and those of the start; and the log.

    Passes are in the order of their ends. The log has (time, kind, gate, particle), kinds as those
    of `studies.event_log`, without crossings of channel 2; the number of a reversal is how many it
    turns. Particles are numbered from 1 in it.
    """
    queue: list[tuple[float, int, int, int]] = []
    entered: list[tuple[float, Ray]] = [(0.0, one.ray) for one in starts]
    counted: tuple[set[int], set[int], set[int]] = (set(), set(), set())
    version = [0] * len(starts)
    passes: list[Pass] = []
    log: list[tuple[float, int, int, int]] = []

    def half(ray: Ray) -> float:
        return 0.5 * table.channel1_length / ray.axial

    def leave(particle: int, side: int, turned: float) -> None:
        """Put the rest of the pass into the list, the next entry into the queue."""
        since, ray = entered[particle]
        inside = 2.0 * (turned - since) if math.isfinite(turned) else 2.0 * half(ray)
        out = table.along(ray, inside)._replace(side=side)
        passes.append(Pass(particle, since, ray, since + inside, out, half(ray), turned))
        away, back = table.excursion(out)
        version[particle] += 1
        entered[particle] = (since + inside + away, back)
        heapq.heappush(queue, (since + inside + away, ENTRY, particle, version[particle]))

    for particle, one in enumerate(starts):
        if not one.inside:
            entered[particle] = (one.time, one.ray)
            heapq.heappush(queue, (one.time, ENTRY, particle, 0))
        elif one.time <= 0.0:
            entered[particle] = (one.time, one.ray)
            counted[one.ray.side].add(particle)
            heapq.heappush(queue, (one.time + half(one.ray), CROSSING, particle, 0))
        else:  # came through, or was turned, before: as if it had come through
            since = one.time - 2.0 * half(one.ray)
            entry = table.along(one.ray, -2.0 * half(one.ray))._replace(side=3 - one.ray.side)
            entered[particle] = (since, entry)
            leave(particle, one.ray.side, math.inf)
    # those that entered in time are followed until they leave
    while queue[0][0] < duration or any(
        entered[one][0] < duration for one in counted[1] | counted[2]
    ):
        time, kind, particle, which = heapq.heappop(queue)
        if which != version[particle]:
            continue
        ray = entered[particle][1]
        gate = ray.side
        if kind == CROSSING:
            counted[gate].remove(particle)
            log.append((time, 3, 12 if gate == 1 else 21, particle + 1))
            leave(particle, 3 - gate, math.inf)
            continue
        log.append((time, 1, gate, particle + 1))
        counted[gate].add(particle)
        if len(counted[gate]) <= threshold:
            heapq.heappush(queue, (time + half(ray), CROSSING, particle, which))
            continue
        log.append((time, 2, gate, len(counted[gate])))
        for one in counted[gate]:
            leave(one, gate, time)
        counted[gate].clear()
    passes.sort(key=lambda one: one.left)
    return passes, log


def firings(log: Iterable[tuple[float, int, int, int]]) -> int:
    """Return how many reversals a log has."""
    return sum(kind == 2 for _, kind, _, _ in log)

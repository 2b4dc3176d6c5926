"""All visits to a disc with two opposite openings, as deterministic sums over pieces.

A visit that enters through an opening meets the circle, traced back, at an angle y within that
opening's arc, |y| < asin(w/2r), measured from its middle. Every wall hit then adds the same angle
delta, the segment's, whose angle of incidence psi = (pi - delta)/2 is conserved. Entries by the
cosine law fill (delta, y) with the density r sin(delta/2)/2 (lines: r cos(psi) dpsi dy). Lines that
meet the arc of an opening at both ends never cross its chord: they are not visits and are left out.
At a given delta the whole arc of starts rotates rigidly: after n segments it is shifted by n delta,
and the part that then overlaps an opening leaves. So the visits of one delta are a few *pieces*,
intervals of y that leave together; over delta they change smoothly between values at which ends of
arcs meet, which are known beforehand. With two Gauss nodes between these, sums over pieces are
accurate to 3e-4, and to 1e-4 if an opening is at least 0.3 r wide.

The next shift that overlaps an opening is found by Euclid's algorithm, not step by step: visits of
a million segments cost as much as those of ten.

The number of cells grows as the square of r over the wider opening. If that is below `NARROW` of r,
both openings are enlarged by the same factor such that it is `NARROW`; positions are scaled back,
and the number of segments is increased by this factor. In the limit of narrow openings that is
exact: the positions y + n delta mod 2 pi, in units of the opening, are heights of a lattice with a
point for each n, and over delta all such lattices become equally likely, whatever the incidence.
The error of mean stays is less than 0.4 %. (The return probability needs none of this: `returns`.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

TURN = 2.0 * math.pi
TOUCH = 1e-13  # arcs that overlap by less do not touch
NARROW = 0.05  # of r: narrower openings are scaled up
LEAST_ORDER = 24  # least number of segments up to which ends of arcs are distinguished
NEAREST = 1e-6  # distance from a rational part of a turn at which the grid towards it ends
RUNGS = 12  # points of that grid
EVEN = 8000  # additional cells of equal width, for visits of more segments
LONGEST = 1e7  # segments; longer visits are left out
AT_ONCE = 16384  # cases of `first_multiple` at a time
TOGETHER = 4096  # pieces at a time, few enough for the fast memory of a processor


@dataclass(frozen=True)
class Pieces:
    """The visits that enter through one opening; fields of shape (piece,).

    Attributes
    ----------
    weight : share of the entries per unit of y; times `high - low`, the piece's share of them all.
    incidence : psi, between 0 and pi/2; the mirror images with -psi are in the weights.
    low, high : interval of y of the piece at entry.
    shift : y at exit, from the middle of the opening of exit, minus y at entry.
    segments : number of segments; for narrow openings, on average.
    same : whether it leaves through the opening of entry.
    """

    weight: Floats
    incidence: Floats
    low: Floats
    high: Floats
    shift: Floats
    segments: Floats
    same: Flags

    @property
    def share(self) -> Floats:
        """Share of each piece in all entries, shape (piece,)."""
        return self.weight * (self.high - self.low)

    def nodes(self) -> tuple[Floats, Floats]:
        """Return nodes y and weights (shares of all entries), three per piece: shape (3, piece)."""
        middle, half = 0.5 * (self.high + self.low), 0.5 * (self.high - self.low)
        gap = math.sqrt(0.6) * half
        weights = np.array([[5.0], [8.0], [5.0]]) / 18.0
        return np.stack([middle - gap, middle, middle + gap]), weights * self.share

    def parts(self, chosen: Flags | None = None) -> Iterator[Pieces]:
        """Yield the pieces, all or those that are chosen, some at a time."""
        places = np.arange(self.weight.size) if chosen is None else np.flatnonzero(chosen)
        for start in range(0, places.size, TOGETHER):
            some = places[start : start + TOGETHER]
            yield Pieces(*(one.take(some) for one in vars(self).values()))


def first_multiple(step: Floats, turn: Floats, low: Floats, high: Floats) -> Floats:
    """Return the smallest n >= 0 with n step mod turn between low and high; inf without one.

    0 <= low < high < turn, 0 < step < turn; all of shape (case,). If no multiple of the step is
    between, n step - m turn is, for the smallest m with m (turn mod step) between -high and -low,
    mod step: the same problem with smaller numbers (Euclid).
    """
    levels = []
    places, found = np.arange(step.size), np.full(step.size, np.inf)
    while places.size:
        count = np.ceil(low / step)
        hit = count * step <= high
        found[places] = np.where(hit, count, np.inf)
        missed = np.flatnonzero(~hit)
        places, step, turn, low, high = (x.take(missed) for x in (places, step, turn, low, high))
        levels.append((places, step, turn, low))
        rest = np.mod(turn, step)
        on = np.flatnonzero(rest > TOUCH * step)
        places, step, turn, below, above = (x.take(on) for x in (places, rest, step, low, high))
        low, high = turn - np.mod(above, turn), turn - np.mod(below, turn)
    for places, step, turn, low in reversed(levels):
        found[places] = np.ceil((low + turn * found.take(places)) / step)
    return found


def _next(delta: Floats, angle: Floats, low: Floats, high: Floats) -> Floats:
    """Return the smallest n >= 0 with angle + n delta within low ... high, mod a turn."""
    if delta.size > AT_ONCE:
        parts = [slice(at, at + AT_ONCE) for at in range(0, delta.size, AT_ONCE)]
        return np.concatenate([_next(delta[x], angle[x], low[x], high[x]) for x in parts])
    behind = np.mod(angle - low, TURN)
    width = high - low
    found = np.zeros(delta.size)
    ahead = np.flatnonzero(behind > width)
    start = TURN - behind[ahead]
    end = np.minimum(start + width[ahead], TURN * (1.0 - 1e-15))
    found[ahead] = first_multiple(delta[ahead], np.full(ahead.size, TURN), start, end)
    return found


def _nodes(own: float, other: float) -> tuple[Floats, Floats]:
    """Return nodes and weights over delta = 0 ... pi, by two a cell.

    `own` and `other` are the openings' half angles. Cells end where, after n <= `order` segments,
    an end of the arc of starts meets an end of an opening, and on a grid towards each rational part
    of a turn, near which visits are long.
    """
    longest = TURN / max(own, other)
    order = max(int(longest) + 8, LEAST_ORDER)
    n = np.arange(1, order + 1)
    count = n // 2 + 1
    n = np.repeat(n, count)
    k = np.arange(n.size) - np.repeat(np.cumsum(count) - count, count)
    lowest = np.gcd(k, n) == 1  # else fewer segments do the same
    part, corners = TURN * k[lowest] / n[lowest], n[lowest]
    ends = [part + gap / corners for gap in (-2.0 * own, 0.0, 2.0 * own)]
    lowest = np.gcd(2 * k + 1, n) == 1
    opposite, corners = math.pi * (2 * k[lowest] + 1) / n[lowest], n[lowest]
    ends += [opposite + (one * own + two * other) / corners for one in (-1, 1) for two in (-1, 1)]
    rungs = np.geomspace(NEAREST, 0.1, RUNGS)
    part, corners = (TURN * k / n)[n < 0.25 * longest], n[n < 0.25 * longest]
    near = part[:, None] + np.concatenate([-rungs, rungs]) / corners[:, None]
    places = np.concatenate([np.linspace(0.0, math.pi, EVEN + 1), *ends, near.ravel()])
    places = np.unique(places[(places >= 0.0) & (places <= math.pi)])
    places = places[np.concatenate([[True], np.diff(places) > 1e-12])]
    middle, half = 0.5 * (places[1:] + places[:-1]), 0.5 * np.diff(places)
    gap = half / math.sqrt(3.0)
    return np.concatenate([middle - gap, middle + gap]), np.concatenate([half, half])


def visits(radius: float, own_width: float, other_width: float) -> Pieces:
    """Return all visits that enter a disc through one of two opposite openings.

    Parameters
    ----------
    radius : r of the disc.
    own_width, other_width : chords of the opening of entry and of the other, below 2r.
    """
    wider = max(own_width, other_width) / radius
    scale = max(1.0, NARROW / wider)
    found = unit_disc(scale * own_width / radius, scale * other_width / radius)
    if scale == 1.0:
        return found
    return Pieces(
        scale * found.weight, found.incidence, found.low / scale, found.high / scale,
        found.shift / scale, found.segments * scale, found.same,
    )  # fmt: skip


@lru_cache(maxsize=64)
def unit_disc(own_width: float, other_width: float) -> Pieces:
    """Return the visits to a disc of radius 1."""
    own, other = (math.asin(0.5 * width) for width in (own_width, other_width))
    delta, weight = _nodes(own, other)
    weight = weight * np.sin(0.5 * delta)
    node, low, high = np.arange(delta.size), np.full(delta.size, -own), np.full(delta.size, own)
    segments = np.ones(delta.size)
    rows = []
    while node.size:
        step = delta[node]
        turns = [
            segments
            + _next(step, segments * step - centre, -half - high + TOUCH, half - low - TOUCH)
            for centre, half in ((0.0, own), (math.pi, other))
        ]
        same, segments = turns[0] <= turns[1], np.minimum(*turns)
        soon = segments < LONGEST
        node, low, high, segments, same = (x[soon] for x in (node, low, high, segments, same))
        half = np.where(same, own, other)
        shift = np.mod(segments * delta[node] - np.where(same, 0.0, math.pi) + math.pi, TURN)
        shift -= math.pi
        first = np.clip(-half - shift, low, high)  # it may be outside by rounding
        last = np.clip(half - shift, first, high)
        rows.append((node, first, last, shift, segments, same))
        segments = np.where(last > first, segments, segments + 1.0)
        left, right = first - low > TOUCH, high - last > TOUCH
        low, high = (
            np.concatenate([one[left], other_end[right]])
            for one, other_end in ((low, last), (first, high))
        )
        node, segments = (np.concatenate([x[left], x[right]]) for x in (node, segments))
    node, low, high, shift, segments, same = (np.concatenate(x) for x in zip(*rows, strict=True))
    # a segment that ends on the arc where it begins has not crossed the opening
    there = (high > low) & ~(same & (segments == 1))
    node, low, high, shift, segments, same = (
        x[there] for x in (node, low, high, shift, segments, same)
    )
    weight = weight[node]
    weight = weight / np.sum(weight * (high - low))
    incidence = 0.5 * (math.pi - delta[node])
    return Pieces(weight, incidence, low, high, shift, segments, same)

"""Urns that are polygons: corners, area, and the sides at which the axis leaves them.

An outline is a tuple of corners (x, y), counterclockwise, in its own frame, with channel 1 at +x.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

UPRIGHT = 2.0**-39  # lean of a side, of the outline's size, up to which it is upright

Outline = tuple[tuple[float, float], ...]


def outline_of(corners: Iterable[Iterable[float]]) -> Outline:
    """Return corners as an outline that runs counterclockwise."""
    found = tuple((float(x), float(y)) for x, y in corners)
    return found if _enclosed(found) > 0.0 else found[::-1]


def regular(sides: int, radius: float) -> Outline:
    """Return a regular polygon with an even number of sides, vertical where the axis leaves it."""
    angles = math.pi * (2.0 * np.arange(sides) + 1.0) / sides
    return tuple(zip(radius * np.cos(angles), radius * np.sin(angles), strict=True))


def area(outline: Outline) -> float:
    """Return the area that an outline encloses."""
    return abs(_enclosed(outline))


def _enclosed(outline: Outline) -> float:
    x, y = np.transpose(outline)
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def is_simple(outline: Outline) -> bool:
    """Return whether no corner is repeated, and sides do not cross or touch each other."""
    corners = np.asarray(outline)
    sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    count, low, high = len(sides), sides.min(axis=1), sides.max(axis=1)
    if (sides[:, 0] == sides[:, 1]).all(axis=1).any():
        return False
    for k in range(count - 2):
        later = np.arange(k + 2, count - (k == 0))
        (a, b), (c, d) = sides[k], np.swapaxes(sides[later], 0, 1)
        beside = _turn(a, b, c) * _turn(a, b, d) > 0.0
        beside |= _turn(c, d, a) * _turn(c, d, b) > 0.0
        apart = (low[later] > high[k]).any(axis=1) | (high[later] < low[k]).any(axis=1)
        if not (beside | apart).all():
            return False
    return True


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return the sign of the turn from b - a to c - a."""
    (x1, y1), (x2, y2) = (b - a).T, (c - a).T
    return np.sign(x1 * y2 - y1 * x2)


def opening_side(outline: Outline, way: float) -> int | None:
    """Return the side that the axis crosses last to the right (1) or to the left (-1).

    By the index of the corner, from 0, at which it begins; None if there is none.
    """
    farthest, found = -math.inf, None
    for k, ((x1, y1), (x2, y2)) in enumerate(zip(outline, outline[1:] + outline[:1], strict=True)):
        if y1 * y2 < 0.0 and way * (x := x1 - (x2 - x1) * y1 / (y2 - y1)) > farthest:
            farthest, found = way * x, k
    return found


def ends(outline: Outline) -> tuple[float, float]:
    """Return x where channel 1 begins, and where channel 2 does (or x of the farthest wall)."""
    x = np.transpose(outline)[0]
    sides = opening_side(outline, 1.0), opening_side(outline, -1.0)
    right = x.max() if sides[0] is None else x[sides[0]]
    left = x.min() if sides[1] is None else x[sides[1]]
    return float(right), float(left)


def widest(outline: Outline, way: float) -> float:
    """Return the upper bound of the width of channel 1 (1) or 2 (-1), 0 without an upright side."""
    side = opening_side(outline, way)
    if side is None:
        return 0.0
    (x1, y1), (x2, y2) = outline[side], outline[(side + 1) % len(outline)]
    if abs(x2 - x1) > UPRIGHT * np.abs(np.transpose(outline)[0]).max():
        return 0.0
    return 2.0 * min(abs(y1), abs(y2))


def centred(outline: Outline) -> Floats:
    """Return the corners, shape (corner, 2), relative to the middle between both ends."""
    return np.asarray(outline) - [0.5 * sum(ends(outline)), 0.0]

"""Visits to a disc drawn at random: how often one that enters by channel 2 leaves by it again.

All chords of a visit turn the point of impact by the same angle, so nothing is needed but places on
the arc. Radius 1; channel 2 is at the angle 0, channel 1 opposite.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

TOGETHER = 500_000  # visits at a time
LONGEST = 200_000  # chords, after which a visit is given up


def drawn_returns(
    width: float, ratio: float, count: int, seed: int = 1, longest: int = LONGEST
) -> tuple[int, int, int]:
    """Draw visits that enter by channel 2; return how many left by it, by channel 1, by neither.

    Entries are uniform over lines: the place uniform on the arc of the opening, sin(incidence)
    uniform. Lines that meet that arc twice never cross the opening's chord and are left out, so
    the three numbers add up to less than `count`. "Neither": given up after
    `longest` chords.

    Parameters
    ----------
    width : w, in radii.
    ratio : w'/w.
    count : visits to draw.
    seed : of the random numbers.
    longest : chords of a visit, at most.
    """
    draw = np.random.default_rng(seed)
    found = np.zeros(3, dtype=np.int64)
    while count > 0:
        found += _some(width, ratio, min(count, TOGETHER), draw, longest)
        count -= TOGETHER
    back, across, neither = (int(one) for one in found)
    return back, across, neither


def _some(
    width: float, ratio: float, count: int, draw: np.random.Generator, longest: int
) -> NDArray[np.int64]:
    own, other = math.asin(0.5 * ratio * width), math.asin(0.5 * width)  # half angles
    turn = math.pi - 2.0 * np.arcsin(draw.uniform(-1.0, 1.0, count))
    place = _within(draw.uniform(-own, own, count) + turn)
    inside = np.abs(place) >= own
    place, turn = place[inside], turn[inside]
    back, across = 0, 0
    for _ in range(longest):
        size = np.abs(place)
        here, there = size < own, size > math.pi - other
        gone = here | there
        if gone.any():
            back += int(here.sum())
            across += int(there.sum())
            place, turn = place[~gone], turn[~gone]
            if not place.size:
                break
        place = _within(place + turn)
    return np.array([back, across, place.size])


def _within(angle: Floats) -> Floats:
    """Return angles that are below 3 pi in size, brought into -pi ... pi."""
    angle = np.where(angle > math.pi, angle - 2.0 * math.pi, angle)
    return np.where(angle < -math.pi, angle + 2.0 * math.pi, angle)


def narrow_chance(ratio: float) -> float:
    """Return the chance of return in the limit of narrow channels, w'/w at most 1 (theory.md)."""
    two, plus, minus = (
        float(special.spence(1.0 - x)) for x in (2.0 * ratio / (1.0 + ratio), -ratio, ratio)
    )
    return 4.0 / (math.pi**2 * ratio) * ((1.0 + ratio) * two + plus - minus)


def deep_ratio(ratio: float, chance: float) -> float:
    """Return the current over that of `window` between perfect valves, for a chance of return.

    The dense gate passes none and the sparse gate all. Then the equations of two ports have the
    net current N w'/(pi A) (1 - a)/(1 + a), and those of `window` N w'/(pi A)/(1 + 2 w'/w).
    """
    return (1.0 + 2.0 * ratio) * (1.0 - chance) / (1.0 + chance)


def deep_limit(ratio: float) -> float:
    """Return `deep_ratio` in the limit of narrow channels, a function of w'/w alone."""
    return deep_ratio(ratio, narrow_chance(ratio))

"""Tables that several studies have: urns of four shapes, and lattices of discs in channel 2."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from postproc.theory.circuit import Circuit

if TYPE_CHECKING:
    from collections.abc import Sequence

DISC, SQUARE, REGULAR, IRRATIONAL = "disc", "square", "regular hexagon", "crooked hexagon"
# Slopes of its sides are fractions other than 0, 1 and -1, so all angles are irrational parts of pi
CROOKED = (
    (0.9, -0.55), (0.9, 0.48), (0.13, 1.07), (-0.85, 0.44), (-0.85, -0.52), (-0.21, -0.97),
)  # fmt: skip


def area_of(corners: Sequence[Sequence[float]]) -> float:
    """Return the area that corners enclose, counterclockwise."""
    x, y = np.transpose(corners)
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def urn_area(channel2_width: float, channel1_width: float = 0.3) -> float:
    """Return the area of an urn, a disc of radius 1 up to the chords of its openings."""
    return float(Circuit(1, 1, channel1_width, channel2_width).urn_area)


def shapes(width: float) -> dict[str, dict[str, object]]:
    """Return the keys of `&table` by shape: all urns have the area of the disc of radius 1.

    Parameters
    ----------
    width : width of channel 2; channel 1 has 0.3.
    """
    area = urn_area(width)
    stretch = math.sqrt(area / area_of(CROOKED))
    radii = {sides: math.sqrt(2.0 * area / (sides * math.sin(2.0 * math.pi / sides)))
             for sides in (4, 6)}  # fmt: skip
    polygon = {"urn_shape": "polygon"}
    return {
        DISC: {},
        SQUARE: polygon | {"urn_sides": 4, "urn_radius": radii[4]},
        REGULAR: polygon | {"urn_sides": 6, "urn_radius": radii[6]},
        IRRATIONAL: polygon | {"urn_vertices": [stretch * one for xy in CROOKED for one in xy]},
    }


def lattice(columns: int, radius: float, width: float = 0.2, length: float = 1.0) -> list[float]:
    """Return z, y, radius of discs in columns of two, and of three, half of them in the walls."""
    found: list[float] = []
    for column in range(columns):
        z = length * ((column + 0.5) / columns - 0.5)
        heights = (-0.25, 0.25) if column % 2 == 0 else (-0.5, 0.0, 0.5)
        for height in heights:
            found += [round(z, 9), round(height * width, 9), radius]
    return found

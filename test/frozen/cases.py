"""The odd tables of the frozen answers, and where their particles start."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .frozen_file import EXACT

if TYPE_CHECKING:
    from collections.abc import Callable

Particle = tuple[float, float, float, float]


@dataclass
class Table:
    """A table as the namelist has it."""

    shape: str = "circuit"
    radius: float = 1.0
    width1: float = 0.3
    length1: float = 1.0
    width2: float = 0.01
    length2: float = 1.0

    @property
    def chord1(self) -> float:
        """Distance of the chord of channel 1 from the centre of its urn."""
        return math.sqrt(self.radius**2 - self.width1**2 / 4)

    @property
    def chord2(self) -> float:
        """Distance of the chord of channel 2 from the centre of its urn."""
        return math.sqrt(self.radius**2 - self.width2**2 / 4)

    @property
    def centre(self) -> float:
        """Place of the centre of urn 2; that of urn 1 is at minus that."""
        return self.length1 / 2 + self.chord1


@dataclass
class Case:
    """A run: its table, its gate, its length, its particles."""

    name: str
    about: str
    table: Table
    threshold: int
    duration: float
    start: Callable[[Table, np.random.Generator], list[Particle]]
    time_step: float = 1 / 128
    start_time: float = 0.0
    seed: int = 1
    engines: tuple[str, ...] = EXACT

    def particles(self) -> list[Particle]:
        """Draw the particles, on a grid of whole parts of the radius."""
        return self.start(self.table, np.random.default_rng(self.seed))


def on_grid(value: float, radius: float, parts: int = 4096) -> float:
    """Round to a multiple of a 4096th of the power of two below the radius."""
    unit = 2.0 ** math.floor(math.log2(radius)) / parts
    return round(value / unit) * unit


def direction(angle: float) -> tuple[float, float]:
    """Give a direction whose components have few digits; its length is only nearly 1."""
    return on_grid(math.cos(angle), 1.0), on_grid(math.sin(angle), 1.0)


def in_urns(
    number: int, share: float = 0.5
) -> Callable[[Table, np.random.Generator], list[Particle]]:
    """Put particles at random in the urns, that share of them in urn 1."""

    def start(table: Table, rng: np.random.Generator) -> list[Particle]:
        found: list[Particle] = []
        while len(found) < number:
            side = -1 if len(found) < share * number else 1
            x, y = rng.uniform(-1, 1, 2) * table.radius
            inside = math.hypot(x, y) < 0.99 * table.radius
            if inside and -0.99 * table.chord1 < x < 0.99 * table.chord2:
                place = on_grid(side * (table.centre + x), table.radius)
                height = on_grid(y, table.radius)
                found.append((place, height, *direction(rng.uniform(0, 2 * math.pi))))
        return found

    return start


def beams(table: Table, rng: np.random.Generator) -> list[Particle]:
    """Aim at tiny openings along the axis, with slopes from none to ones that hit the walls."""
    found: list[Particle] = []
    for k in range(32):
        side = -1 if k % 2 else 1
        x = on_grid(side * (table.centre + rng.uniform(-0.9, 0.9)), 1.0)
        y = on_grid(rng.uniform(-0.4, 0.4), 1.0, 2**32) * table.width1
        slope = 0.0 if k < 4 else rng.choice([-1, 1]) * 2.0 ** -int(rng.integers(18, 26))
        found.append((x, y, rng.choice([-1.0, 1.0]), slope))
    return [(float(x), float(y), float(u), float(v)) for x, y, u, v in found]


def in_channels(table: Table, rng: np.random.Generator) -> list[Particle]:
    """Start in both gates, more of them than the threshold, in channel 2, and in the urns."""
    found: list[Particle] = []
    for k in range(12):
        x = on_grid(rng.uniform(-0.49, 0.49) * table.length1, 1.0)
        y = on_grid(rng.uniform(-0.49, 0.49) * table.width1, 1.0)
        found.append((x, y, *direction(0.5 * rng.uniform(-1, 1) + math.pi * (k % 2))))
    begin = table.centre + table.chord2
    for k in range(8):
        x = on_grid(begin + rng.uniform(0.01, 0.49) * table.length2, 1.0) * (1 if k % 2 else -1)
        y = on_grid(rng.uniform(-0.49, 0.49) * table.width2, 1.0)
        found.append((x, y, *direction(rng.uniform(0, 2 * math.pi))))
    return found + in_urns(20)(table, rng)


def grazing(table: Table, rng: np.random.Generator) -> list[Particle]:
    """Whisper along the walls, stand across channels, fly along diameters and the axis."""
    found: list[Particle] = []
    for k in range(12):
        side = -1 if k % 2 else 1
        depth = 2.0 ** -(2 + k)
        angle = on_grid(rng.uniform(0.7, 2.4), 1.0)
        x = on_grid(side * (table.centre - math.cos(angle) * (1 - depth)), 1.0, 2**20)
        y = on_grid(math.sin(angle) * (1 - depth), 1.0, 2**20)
        found.append((x, y, *direction(math.atan2(math.cos(angle), side * math.sin(angle)))))
    end = on_grid(table.centre + table.chord2 + table.length2 / 4, 1.0)
    found += [(-0.25, 0.0625, 0.0, 1.0), (0.25, -0.0625, 0.0, -1.0), (end, 0.0, 0.0, 1.0)]
    found += [(-end, 0.0, 0.0, -1.0), (-1.5, 0.0, 1.0, 0.0), (1.5, 0.0, 1.0, 0.0)]
    found += [(-1.75, 0.03125, 1.0, 0.0), (1.75, 0.03125, -1.0, 0.0)]
    return found + in_urns(20)(table, rng)


def mirror_images(table: Table, rng: np.random.Generator) -> list[Particle]:
    """Start in fours, mirrored in both axes: whatever happens, happens four times at once."""
    found: list[Particle] = []
    for x, y, ux, uy in in_urns(12, 0.0)(table, rng):
        found += [(x, y, ux, uy), (-x, y, -ux, uy), (x, -y, ux, -uy), (-x, -y, -ux, -uy)]
    order = rng.permutation(len(found))
    return [found[k] for k in order]


def at_one_instant(table: Table, rng: np.random.Generator) -> list[Particle]:
    """Enter gates at one instant, to the last bit, as others cross; the corners are 3-4-5."""
    del table
    found: list[Particle] = []
    for k in range(6):
        x, y, side = 1.5, (k - 2.5) / 8, -1.0 if k % 2 else 1.0
        found.append((side * x, y, -side, 0.0))
        found.append((side * (x - 1.0), y / 2 + 0.03125, -side, 0.0))
    for y in (0.25, -0.25, 0.5, -0.5):
        found += [(-1.5, y, 0.75, 1.0), (1.5, y, -0.75, 1.0), (1.5, y, 0.75, -1.0)]
    found += [(-1.5, 0.0, 1.0, 0.75), (1.5, 0.0, -1.0, 0.75), (1.5, 0.0, -1.0, -0.75)]
    order = rng.permutation(len(found))
    return [found[k] for k in order]


CASES = [
    Case("paper", "the paper's table", Table(), 2, 32.0, in_urns(60)),
    Case("closed", "no channel 2", Table(width1=0.375, width2=0.0), 1, 40.0, in_urns(40, 1.0)),
    Case(
        "single_urn",
        "one urn with an end wall",
        Table("urn", length1=0.5),
        1,
        32.0,
        in_urns(50, 1.0),
    ),
    Case(
        "tiny",
        "openings of a millionth, beams that meet them",
        Table(width1=2.0**-20, width2=2.0**-20),
        1,
        16.0,
        beams,
        time_step=0.007,
        seed=2,
    ),
    Case(
        "wide",
        "openings nearly as wide as the urns",
        Table(width1=1.875, length1=0.5, width2=1.875, length2=0.25),
        5,
        8.0,
        in_urns(24),
    ),
    Case(
        "long",
        "channels much longer than the urns",
        Table(radius=0.5, width1=0.25, length1=8.0, width2=0.125, length2=6.0),
        2,
        20.0,
        in_urns(80),
    ),
    Case(
        "short",
        "channels much shorter than the urns",
        Table(radius=2.0, width1=0.5, length1=2.0**-6, width2=0.25, length2=2.0**-7),
        1,
        60.0,
        in_urns(50),
        time_step=2.0**-9,
    ),
    Case(
        "channels",
        "particles that start in gates, more than T, and in channel 2",
        Table(width1=0.5, length1=2.0, width2=0.25, length2=1.5),
        3,
        26.0,
        in_channels,
    ),
    Case(
        "grazing",
        "along the walls, across the channels, along diameters",
        Table(width1=0.25, width2=0.125),
        2,
        20.0,
        grazing,
    ),
    Case(
        "mirrored",
        "four images of each particle: four events at a time",
        Table(radius=1.25, width1=0.75, width2=0.25),
        2,
        24.0,
        mirror_images,
    ),
    Case(
        "instant",
        "entries of one instant, on a table of whole 3-4-5 triangles",
        Table(radius=1.25, width1=1.5, width2=0.0),
        3,
        5.9375,
        at_one_instant,
        engines=("collision", "synchronous"),
    ),
    Case(
        "always",
        "T = 0: every entry is turned back",
        Table(width1=0.5, width2=0.125),
        0,
        26.0,
        in_urns(40, 0.25),
    ),
    Case(
        "never",
        "T = N: nobody is turned back",
        Table(width1=0.5, width2=0.125),
        40,
        26.0,
        in_urns(40, 1.0),
    ),
    Case(
        "late",
        "the clock begins at 1e12",
        Table(radius=1.5, width1=0.75, length1=0.75, width2=0.0625, length2=2.5),
        2,
        45.0,
        in_urns(50),
        start_time=1.0e12,
    ),
    Case(
        "lopsided",
        "a narrow channel 1 and a wide channel 2",
        Table(width1=0.125, length1=3.0, width2=1.5, length2=0.0625),
        1,
        20.0,
        in_urns(60),
        time_step=2.0**-6,
    ),
]

# What the program itself has for `--self-test`: few particles and events.
OWN = Case(
    "circuit", "two urns, both channels", Table(width1=0.75, width2=0.375), 1, 20.0, in_urns(16)
)

# For `reservoir`, which draws random numbers: run below the namelist, with a seed of its own.
STOCHASTIC = [
    Case(
        "reservoir",
        "urns without memory",
        Table(width1=0.5, length1=1.5, width2=0.25, length2=0.75),
        2,
        24.0,
        in_urns(40),
    ),
    Case(
        "reservoir_urn",
        "one urn without memory",
        Table("urn", radius=1.5, width1=0.75, length1=1.5),
        3,
        24.0,
        in_urns(40, 1.0),
    ),
]

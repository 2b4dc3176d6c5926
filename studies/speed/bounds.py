"""Figures of a benchmark: the rows of its tables, and the required figures with their bounds."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table

from postproc import cli

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

FORMAT = "battery-bench-1"
RATES = {
    "collisions": "collisions_per_second",
    "visits": "visits_per_second",
    "time": "particle_time_per_second",
}
# the cost that a table measures
SUBJECTS = {
    "engines": "collisions",
    "number": "time",
    "threshold": "visits",
    "openings": "visits",
    "collision": "time",
    "map": "collisions",
}
Key = tuple[Any, ...]
CASE = ("engine", "number", "threshold", "channel1_width", "channel2_width", "sides")

MAP_POINTS, MAP_COLLISIONS = 25 * 25, 1e8


@dataclass(frozen=True)
class Figure:
    """A required figure.

    Attributes
    ----------
    name : its description.
    values : measured values, one for each round; empty if it could not be measured.
    bound : lower or upper bound.
    at_least : whether larger is better.
    aim : aim beyond the bound.
    note : why there is no value, or how it was measured.
    """

    name: str
    values: tuple[float, ...]
    bound: float
    at_least: bool = False
    aim: float | None = None
    note: str = ""

    @property
    def reached(self) -> bool | None:
        """Tell whether the median is within the bound; None if there is none."""
        if not self.values:
            return None
        median = statistics.median(self.values)
        return median >= self.bound if self.at_least else median <= self.bound


class Rows:
    """The rows of all tables of one run, by table and case."""

    def __init__(self, rows: Sequence[dict[str, Any]]) -> None:
        self.by_key: dict[Key, dict[str, Any]] = {}
        self.first: dict[str, Key] = {}  # of each table; its costs are relative to this row
        for row in rows:
            key = (row["table"], *(({"sides": 0} | row)[name] for name in CASE))
            self.by_key[key] = row
            self.first.setdefault(row["table"], key)

    def rates(self, key: Key, rate: str) -> tuple[float, ...]:
        """Return a rate (of `RATES`) of a row, one value for each round."""
        return tuple(self.by_key[key][RATES[rate]])

    def costs(self, key: Key, reference: Key | None = None) -> tuple[float, ...]:
        """Return the cost of a row relative to the first or another row, a value for each round."""
        rate = SUBJECTS.get(key[0], "collisions")
        base = self.rates(reference or self.first[key[0]], rate)
        return tuple(one / other for one, other in zip(base, self.rates(key, rate), strict=True))

    def find(self, table: str, **wanted: float | str) -> Key:
        """Return the one row of a table whose case has these values."""
        found = [
            key for key, row in self.by_key.items() if row["table"] == table and all(
                row.get(name, 0) == value for name, value in wanted.items())
        ]  # fmt: skip
        if len(found) != 1:
            raise cli.InputError(f"{len(found)} rows of table {table} have {wanted}")
        return found[0]


def figures(
    rows: Rows, memory: Sequence[float], instructions: Sequence[float], no_count: str = ""
) -> list[Figure]:
    """Return the required figures.

    Parameters
    ----------
    rows : all tables.
    memory : peak memory of a run of 1e7 particles, in bytes for each.
    instructions : those of a wall collision; empty if they were not counted.
    no_count : why they were not.
    """
    excursion = rows.find("engines", engine="excursion")
    others = [rows.find("engines", engine=name) for name in ("collision", "synchronous")]
    wide, tiny = (rows.find("openings", channel1_width=width) for width in (0.3, 1e-6))
    few, many = (rows.find("number", number=number) for number in (1000, 1_000_000))
    discs = [rows.find("lorentz", engine=name) for name in ("excursion", "collision")]
    hexagon = rows.find("visits", sides=6, channel2_width=0.01)
    samples = [rows.rates(key, "collisions") for key in rows.by_key if key[0] == "map"]
    minutes = [
        MAP_POINTS * statistics.mean(MAP_COLLISIONS / rate for rate in turn) / 60.0
        for turn in zip(*samples, strict=True)
    ]
    return [
        Figure(
            "wall collisions a second, excursion",
            rows.rates(excursion, "collisions"), 1.5e8, at_least=True, aim=2.5e8,
        ),
        Figure("instructions a wall collision", tuple(instructions), 22.0, aim=15.0, note=no_count),
        Figure("ratio to collision", rows.costs(others[0], excursion), 15.0, at_least=True),
        Figure("ratio to synchronous", rows.costs(others[1], excursion), 40.0, at_least=True),
        Figure("ratio to collision, 20 scatterers", rows.costs(discs[1], discs[0]), 5.0,
               at_least=True),
        Figure("wall hits a second, visits to hexagons", rows.rates(hexagon, "collisions"), 1e8,
               at_least=True),
        Figure("visit, w = w' = 1e-6 over 0.3", rows.costs(tiny, wide), 3.0),
        Figure("time unit and particle, 1e6 over 1e3", rows.costs(many, few), 2.0),
        Figure("bytes a particle, N = 1e7", tuple(memory), 100.0),
        Figure("half the map, minutes", tuple(minutes), 12.0, note="from 25 of 625 points"),
    ]  # fmt: skip


def value_text(value: float) -> str:
    """Return a figure as text for the tables."""
    return f"{value:.2e}".replace("e+0", "e") if abs(value) >= 1e4 else f"{value:.4g}"


def printed(title: str, rows: Iterable[Sequence[str]], *heads: str) -> Table:
    """Return a table whose columns but the first and those without a head are right-aligned."""
    table = Table(title=title, title_justify="left", caption_justify="left", box=box.SIMPLE,
                  pad_edge=False, collapse_padding=True)  # fmt: skip
    for at, head in enumerate(heads):
        table.add_column(head, justify="right" if at and head else "left", no_wrap=not at)
    for row in rows:
        table.add_row(*row)
    return table


def summary(found: Sequence[Figure]) -> Table:
    """Return the figures beside their bounds."""
    verdicts = {True: "[green]reached", False: "[red bold]NOT reached", None: "not measured"}
    rows = []
    for one in found:
        seen = ["", "", ""]
        if one.values:
            seen = [value_text(of(one.values)) for of in (statistics.median, min, max)]
        bound = f"{'>=' if one.at_least else '<='} {value_text(one.bound)}"
        aim = "" if one.aim is None else value_text(one.aim)
        rows.append([one.name, *seen, bound, aim, verdicts[one.reached]])
    heads = ("figure", "median", "least", "most", "bound", "aim", "")
    table = printed("What must be reached", rows, *heads)
    table.caption = "\n".join(f"{one.name}: {one.note}" for one in found if one.note)
    return table

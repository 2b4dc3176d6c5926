"""Changes between two runs of the benchmarks: files, and ratios with their spread."""

from __future__ import annotations

import json
import statistics
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from postproc import cli
from studies.speed.bounds import FORMAT, SUBJECTS, Figure, Rows, printed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from rich.table import Table

    from studies.speed.bounds import Key


# A figure measured once (memory, instructions) has no spread; a smaller difference is no change.
LEAST = 1e-3


@dataclass(frozen=True)
class Run:
    """Contents of a file of `run`."""

    path: Path
    about: dict[str, Any]
    rows: Rows
    figures: dict[str, Figure]


def load(path: Path) -> Run:
    """Read a file of `run`; raise `InputError` if it is none."""
    try:
        found = json.loads(cli.existing_file(path).read_text())
        if found["format"] != FORMAT:
            raise ValueError(f"its format is not {FORMAT}")
        reached = {
            one["name"]: Figure(one["name"], tuple(one["values"]), one["bound"], one["at_least"])
            for one in found["figures"]
        }
        return Run(path, found, Rows(found["rows"]), reached)
    except (OSError, KeyError, TypeError, ValueError) as problem:
        raise cli.InputError(f"{path}: not the JSON of a benchmark: {problem}") from problem


@dataclass(frozen=True)
class Change:
    """New over old of one figure: ratio of the medians, and the range of all rounds' ratios."""

    name: str
    ratio: float
    least: float
    most: float
    more_is_better: bool

    @property
    def mark(self) -> str:
        """Return 'better' or 'worse' if the range excludes 1, else nothing."""
        if self.least <= 1.0 + LEAST and self.most >= 1.0 - LEAST:
            return ""
        return "better" if (self.ratio > 1.0) == self.more_is_better else "worse"


def change(
    name: str, old: Sequence[float], new: Sequence[float], *, more_is_better: bool
) -> Change:
    """Return the change between the rounds of two runs."""
    ratio = statistics.median(new) / statistics.median(old)
    return Change(name, ratio, min(new) / max(old), max(new) / min(old), more_is_better)


def name_of(key: Key) -> str:
    """Return a row's table and case in words."""
    table, engine, *numbers, sides = key
    flown = f"{sides} sides" if sides else engine
    return "{:9s} {:11s} N={:<7d} T={:<4d} w={:<5.2g} w'={:.2g}".format(table, flown, *numbers)


def changes(old: Run, new: Run) -> list[tuple[str, list[Change]]]:
    """Return the changes of the figures, and of the rate and the relative cost of each row."""
    pairs = [
        (one, new.figures[name])
        for name, one in old.figures.items()
        if one.values and name in new.figures and new.figures[name].values
    ]
    reached = [
        change(one.name, one.values, other.values, more_is_better=one.at_least)
        for one, other in pairs
    ]
    rates, costs = [], []
    for key in old.rows.by_key:
        if key not in new.rows.by_key:
            continue
        rate = SUBJECTS.get(key[0], "collisions")
        name = name_of(key)
        both = (old.rows.rates(key, rate), new.rows.rates(key, rate))
        rates.append(change(name, *both, more_is_better=True))
        if key != old.rows.first[key[0]] and key != new.rows.first[key[0]]:
            both = (old.rows.costs(key), new.rows.costs(key))
            costs.append(change(name, *both, more_is_better=False))
    if not reached and not rates:
        raise cli.InputError(f"{old.path} and {new.path} have no figure in common")
    return [
        ("What must be reached", reached),
        ("Rates: collisions, visits or particle time a second, as the table has them", rates),
        ("Costs over the first row of the table, in the same run", costs),
    ]


def table_of(title: str, found: Sequence[Change]) -> Table:
    """Return changes as a table."""
    colours = {"better": "[green]better", "worse": "[red bold]worse", "": ""}
    rows = [[one.name, *(f"{value:.3f}" for value in (one.ratio, one.least, one.most)),
             colours[one.mark]] for one in found]  # fmt: skip
    return printed(title, rows, "figure", "new/old", "least", "most", "")

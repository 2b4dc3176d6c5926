"""History of a machine: the medians of several runs of the benchmarks, side by side."""

from __future__ import annotations

import statistics
from typing import TYPE_CHECKING

from rich import box
from rich.table import Table

from postproc import cli
from postproc.speed.bounds import SUBJECTS, value_text
from postproc.speed.changes import load, name_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from postproc.speed.changes import Run

SHOWN = 5  # number of the last runs that fit in a line


def kept(folder: Path) -> list[Run]:
    """Return the runs of a folder, oldest first; raise `InputError` if there is none."""
    found = sorted(map(load, folder.glob("*.json")), key=lambda one: str(one.about.get("date")))
    if not found:
        raise cli.InputError(f"{folder}: no files of a benchmark (make bench)")
    return found


def lines_of(runs: Sequence[Run]) -> Iterator[tuple[str, list[float | None]]]:
    """Yield each figure and each row of any run: its name, and its median in each run."""
    names = dict.fromkeys(name for run in runs for name in run.figures)
    for name in names:
        values = [run.figures[name].values if name in run.figures else () for run in runs]
        yield name, [statistics.median(some) if some else None for some in values]
    for key in dict.fromkeys(key for run in runs for key in run.rows):
        rate = SUBJECTS.get(key[0], "collisions")
        yield (
            name_of(key),
            [
                statistics.median(run.rows.rates(key, rate)) if key in run.rows else None
                for run in runs
            ],
        )


def history(runs: Sequence[Run]) -> tuple[list[str], Table]:
    """Return a line for each run, and the medians of the last runs."""
    about = ("date", "processor", "commit")
    descriptions = [
        f"{number}: " + ", ".join(str(run.about.get(key, "unknown")) for key in about)
        for number, run in enumerate(runs, 1)
    ]
    first = max(len(runs) - SHOWN, 0)
    table = Table(
        title="Medians", title_justify="left", box=box.SIMPLE, pad_edge=False,
        collapse_padding=True,
    )  # fmt: skip
    table.add_column("", no_wrap=True)
    for number in range(first, len(runs)):
        table.add_column(str(number + 1), justify="right", no_wrap=True)
    for name, values in lines_of(runs[first:]):
        table.add_row(name, *("" if one is None else value_text(one) for one in values))
    return descriptions, table

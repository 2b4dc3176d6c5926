"""Two builds of `bench`, run in turn: how much faster one is, in processor time."""

from __future__ import annotations

import resource
import statistics
import subprocess
from dataclasses import dataclass
from typing import TYPE_CHECKING

from postproc import cli
from studies.speed.bounds import printed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from rich.table import Table

ROUNDS = 5
# engine, number, threshold, widths and collisions of `bench single`: a second or so each
POINTS: dict[str, tuple[str, ...]] = {
    "N = 1000, T = 7, w = 0.3, w' = 0.01": ("excursion", "1000", "7", "0.3", "0.01", "4e8"),
    "T = 18": ("excursion", "1000", "18", "0.3", "0.01", "4e8"),
    "T = 23": ("excursion", "1000", "23", "0.3", "0.01", "4e8"),
    "N = 100, T = 1": ("excursion", "100", "1", "0.3", "0.01", "4e8"),
    "w = w' = 1e-6": ("excursion", "1000", "7", "1e-6", "1e-6", "1e13"),
    "N = 1e6, T = 7000": ("excursion", "1000000", "7000", "0.3", "0.01", "4e8"),
    "engine synchronous": ("synchronous", "1000", "7", "0.3", "0.01", "3e6"),
    "engine collision": ("collision", "1000", "7", "0.3", "0.01", "1.5e7"),
}


@dataclass(frozen=True)
class Ratio:
    """Processor time of one program over that of another, a value for each pair of runs."""

    name: str
    values: tuple[float, ...]


def processor_seconds(program: Path, words: Sequence[str]) -> float:
    """Return the processor time of one run of `bench single`."""
    collisions = str(round(float(words[-1])))
    command = [str(program), "single", *words[:-1], collisions]
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    try:
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as problem:
        raise cli.InputError(f"{program}: {problem.strerror}") from problem
    spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    if ended.returncode or not ended.stdout.strip().isdigit():
        raise cli.InputError(f"{' '.join(command)}: {ended.stderr.strip()[:300] or 'failed'}")
    return spent


def ratio(name: str, old: Path, new: Path, rounds: int) -> Ratio:
    """Return how many times as fast `new` is as `old` at a point of `POINTS`, in pairs of runs."""
    values = []
    for turn in range(rounds):
        # The order alternates, so that neither always runs after the other.
        pair = (old, new) if turn % 2 == 0 else (new, old)
        spent = {program: processor_seconds(program, POINTS[name]) for program in pair}
        values.append(spent[old] / spent[new])
    return Ratio(name, tuple(values))


def table_of(found: Sequence[Ratio]) -> Table:
    """Return ratios as a table: median, least and most of the pairs."""
    rows = [[one.name, *(f"{of(one.values):.2f}" for of in (statistics.median, min, max))]
            for one in found]  # fmt: skip
    return printed("Times as fast as the base", rows, "point", "median", "least", "most")

"""Runs of the program `bench`: tables, peak memory, instructions."""

from __future__ import annotations

import datetime
import json
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from postproc import cli
from studies.speed.bounds import FORMAT, RATES, SUBJECTS, Rows, figures, printed, summary

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console
    from rich.table import Table

MANY = 10_000_000  # particles of the run whose memory is measured
MANY_COLLISIONS = 1_000_000_000
COUNTED = (20_000_000, 80_000_000)  # collisions of the two runs whose instructions are counted


@dataclass(frozen=True)
class Case:
    """A row of a table: parameters, time of a round (s), warm-up (time units).

    `engine` may be `visits`: passages through an urn alone. `sides`: of polygons; 0: discs.
    """

    engine: str = "excursion"
    number: int = 1000
    threshold: int = 7
    channel1_width: float = 0.3
    channel2_width: float = 0.01
    sides: int = 0
    scatterers: int = 0
    seconds: float = 0.5
    warm_up: float = 50.0


NUMBERS = ((100, 1), (10_000, 70), (100_000, 700))
# by name: title, cases
TABLES: dict[str, tuple[str, list[Case]]] = {
    "engines": ("Engines, N = 1000, T = 7, w = 0.3, w' = 0.01", [
        Case(one) for one in ("excursion", "collision", "synchronous", "reservoir", "timestep")]),
    "number": ("Number of particles, T/N = 0.007", [
        Case(warm_up=1000.0), *(Case("excursion", *one) for one in NUMBERS),
        Case("excursion", 1_000_000, 7000, seconds=1.0)]),
    "threshold": (
        "Threshold, N = 1000: small, the working point, at the transition, N (no gate)",
        [Case(threshold=one) for one in (7, 1, 2, 15, 16, 17, 1000)]),
    "openings": ("Openings, N = 1000, T = 7, w = w'", [
        Case(channel1_width=one, channel2_width=one)
        for one in (0.3, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)]),
    "collision": ("Engine collision: number of particles", [
        Case("collision"), *(Case("collision", *one) for one in NUMBERS),
        Case("collision", 1_000_000, 7000, seconds=1.0, warm_up=5.0)]),
    "shapes": (
        "Shapes of urns: discs, regular polygons; many particles, whose visits come in large "
        "batches", [Case("excursion", *NUMBERS[2], sides=one) for one in (0, 4, 6, 24)]),
    "visits": ("Visits alone, in batches of 1024: discs, regular hexagons", [
        Case("visits", 1024, 0, channel2_width=width, sides=sides)
        for width in (0.01, 0.3) for sides in (0, 6)]),
    "lorentz": ("20 discs in channel 2, w' = 0.3", [
        Case(one, channel2_width=0.3, scatterers=20) for one in ("excursion", "collision")]),
    "map": (
        "Map of Fig. numris: 25 of its points, as its five by five parts have them in the middle",
        [Case(threshold=3 + k - k % 5, channel2_width=0.002 + 0.098 * (0.1 + 0.2 * (k % 5)),
              seconds=0.15) for k in range(25)]),
}  # fmt: skip


def _failed(command: Sequence[str], problem: str) -> cli.InputError:
    return cli.InputError(f"{' '.join(command)}: {problem.strip()[-300:] or 'failed'}")


def measured(program: Path, name: str) -> tuple[list[str], list[dict]]:
    """Return version, commit and compiler of the program, and the rows of a table."""
    cases = [asdict(case) for case in TABLES[name][1]]
    told = "".join(f"{' '.join(map(str, case.values()))}\n" for case in cases)
    command = [str(program), "table"]
    done = subprocess.run(
        cli.ended_with_python(command), input=told, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise _failed(command, done.stdout + done.stderr)
    about, lines = done.stdout.splitlines()[:3], done.stdout.splitlines()[3:]
    rates = [[float(one) for one in line.split()] for line in lines]
    names = RATES.values()
    return about, [
        {"table": name, **case, **dict(zip(names, rates[3 * k : 3 * k + 3], strict=True))}
        for k, case in enumerate(cases)
    ]


def rows_of(title: str, rows: Rows, name: str) -> Table:
    """Return a table: medians over the rounds, and after +- half the range in per cent."""

    def spread(values: Sequence[float]) -> str:
        return f"+-{50.0 * (max(values) - min(values)) / statistics.median(values):.1f}%"

    lines = []
    for key in (one for one in rows.by_key if one[0] == name):
        _, engine, number, threshold, *widths, sides = key
        hits, visits, time = (rows.rates(key, rate) for rate in RATES)
        costs = rows.costs(key)
        lines.append([
            f"{sides} sides" if sides else engine, str(number), str(threshold),
            *(f"{one:.2g}" for one in widths), f"{statistics.median(hits):.2e}", spread(hits),
            f"{statistics.median(visits):.2e}", f"{1e9 / statistics.median(time):.3e}",
            f"{statistics.median(costs):.2f}", spread(costs),
        ])  # fmt: skip
    cost = f"{SUBJECTS.get(name, 'collisions')}, cost over the first"
    return printed(title, lines, "engine", "N", "T", "w", "w'", "collisions/s", "", "visits/s",
                   "ns a time and particle", cost, "")  # fmt: skip


def processor() -> str:
    """Return name, family and model of the processor, as Linux gives them."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")[0].splitlines()
    told = dict(map(str.strip, line.split(":", 1)) for line in lines if ":" in line)
    name, family, model = (told.get(key, "unknown")
                           for key in ("model name", "cpu family", "model"))  # fmt: skip
    return f"{name}, family {family} model {model}"


# The system counts what a process has when it starts another: a small one starts the run.
MEASURED = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def peak_memory(program: Path, number: int = MANY, collisions: int = MANY_COLLISIONS) -> float:
    """Return the peak memory of a run in bytes for each particle."""
    command = [str(program), "single", "excursion"]
    command += [str(word) for word in (number, 7 * number // 1000, 0.3, 0.01, collisions)]
    words = [sys.executable, "-I", "-S", "-c", MEASURED, *command]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise _failed(command, ended.stderr)
    return float(ended.stdout) * 1024.0 / number


def count_instructions(program: Path, valgrind: str, lengths: tuple[int, int] = COUNTED) -> float:
    """Return the instructions of a wall collision, from two runs that differ only in length."""
    with tempfile.TemporaryDirectory() as folder:
        commands = [
            [
                valgrind, "--tool=callgrind", f"--callgrind-out-file={folder}/{length}",
                str(program), "single", "excursion", "1000", "7", "0.3", "0.01", str(length),
            ]
            for length in lengths
        ]  # fmt: skip
        runs = [
            subprocess.Popen(
                cli.ended_with_python(command), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                text=True, cwd=folder,
            )
            for command in commands
        ]  # fmt: skip
        outputs = [run.communicate() for run in runs]
    seen = []
    for command, run, (output, complained) in zip(commands, runs, outputs, strict=True):
        collected = re.search(r"Collected\s*:\s*(\d+)", complained)
        if run.returncode or collected is None or not output.strip().isdigit():
            raise _failed(command, complained)
        seen.append((int(collected[1]), int(output)))
    (few, few_collisions), (many, many_collisions) = seen
    return (many - few) / (many_collisions - few_collisions)


def run(program: Path, counted: Path, output: Path, console: Console) -> None:
    """Run all benchmarks, print and write the results."""
    if not program.exists():
        raise cli.InputError(f"{program}: no such program (make bench builds it)")
    cli.output_folder(output.parent)
    console.print(f"processor: {processor()}", highlight=False)
    console.print("Medians of rounds in which the rows of a table run in turn; +- half of least to "
                  "most.")  # fmt: skip
    found: list[dict] = []
    for name, (title, _) in TABLES.items():
        about, rows = measured(program, name)
        found += rows
        console.print(rows_of(title, Rows(rows), name))
    memory = [peak_memory(program)]
    instructions, no_count = [], ""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        no_count = "valgrind is not installed"
    elif not counted.exists():
        no_count = "no build for x86-64-v3 (make bench)"
    else:
        instructions = [count_instructions(counted, valgrind)]
    reached = figures(Rows(found), memory, instructions, no_count)
    written = {
        **dict(zip(("version", "commit", "compiler"), about, strict=True)),
        "processor": processor(), "rows": found, "format": FORMAT,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "figures": [vars(one) | {"reached": one.reached} for one in reached],
    }  # fmt: skip
    output.write_text(json.dumps(written, indent=1) + "\n")
    console.print(summary(reached))
    console.print(f"Written: {output}", soft_wrap=True, highlight=False)

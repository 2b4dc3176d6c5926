"""Benchmarks: the speed tables, what must be reached, and what changed between two runs.

`run` (`make bench`) lets build/bin/bench print its tables, takes the peak memory of a run of 1e7
particles, counts instructions where valgrind is installed, prints the figures beside their bounds
and writes everything as JSON. All times are taken by the Fortran program itself.
`compare OLD.json NEW.json` prints the ratio of each figure of two such files with its spread: from
the least of one file's rounds over the greatest of the other's to the reverse. What is wholly off 1
is marked. Rounds of one run share the state of the machine: between two runs of the same program on
a shared machine all rates may differ alike, costs relative to a row of the same run do not.
"""

from __future__ import annotations

import datetime
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from postproc import cli
from postproc.benchmark_changes import changes, load, parsed, table_of
from postproc.benchmark_figures import FORMAT, Rows, figures, summary

if TYPE_CHECKING:
    from collections.abc import Sequence

    from postproc.benchmark_changes import Run

ROOT = Path(__file__).resolve().parent.parent
MANY = 10_000_000  # particles of the run whose memory is looked at
MANY_COLLISIONS = 1_000_000_000
COUNTED = (20_000_000, 80_000_000)  # collisions of the two runs whose instructions are counted


def _spoken(command: Sequence[str], problem: str) -> cli.InputError:
    return cli.InputError(f"{' '.join(command)}: {problem.strip()[:300] or 'failed'}")


def peak_memory(program: Path, number: int = MANY, collisions: int = MANY_COLLISIONS) -> float:
    """Return the bytes a particle at the peak of a run of its own."""
    threshold = 7 * number // 1000
    command = [str(program), "memory", "excursion"]
    command += [str(word) for word in (number, threshold, 0.3, 0.01, collisions)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    kilobytes = run.stdout.strip()
    if run.returncode or not kilobytes.isdigit() or int(kilobytes) == 0:
        raise _spoken(command, run.stdout + run.stderr)
    return int(kilobytes) * 1024.0 / number


def count_instructions(program: Path, valgrind: str, lengths: tuple[int, int] = COUNTED) -> float:
    """Return the instructions of a wall collision, from two runs that differ in length alone."""
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
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder
            )
            for command in commands
        ]
        said = [run.communicate() for run in runs]
    seen = []
    for command, run, (printed, complained) in zip(commands, runs, said, strict=True):
        collected = re.search(r"Collected\s*:\s*(\d+)", complained)
        if run.returncode or collected is None or not printed.strip().isdigit():
            raise _spoken(command, complained[-300:])
        seen.append((int(collected[1]), int(printed)))
    (few, few_collisions), (many, many_collisions) = seen
    return (many - few) / (many_collisions - few_collisions)


def run(program: Path, counted: Path, output: Path, console: Console) -> None:
    """Run all benchmarks, print and write them."""
    if not program.exists():
        raise cli.InputError(f"{program}: no such program (make build)")
    cli.output_folder(output.parent)
    command = [str(program), "--json", str(output)]
    if subprocess.run(command, check=False).returncode:
        raise _spoken(command, "")
    found = parsed(output)
    memory = [peak_memory(program)]
    instructions, no_count = [], ""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        no_count = "valgrind is not installed"
    elif not counted.exists():
        no_count = "no build for x86-64-v3 (make bench)"
    else:
        instructions = [count_instructions(counted, valgrind)]
    reached = figures(Rows(found["rows"]), memory, instructions, no_count)
    found |= {
        "format": FORMAT,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "figures": [vars(one) | {"reached": one.reached} for one in reached],
    }
    output.write_text(json.dumps(found, indent=1) + "\n")
    console.print(summary(reached))
    console.print(f"Written: {output}", soft_wrap=True, highlight=False)


def _said(name: str, one: Run) -> str:
    return f"{name}: " + ", ".join(
        str(one.about.get(key, "unknown")) for key in ("date", "processor", "commit")
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmarks, or compare two runs."""
    options = cli.parser("benchmarks", __doc__)
    parts = options.add_subparsers(dest="part", required=True, metavar="run|compare")
    runs = parts.add_parser("run", help="run all benchmarks")
    runs.add_argument("--program", type=Path, default=ROOT / "build/bin/bench")
    runs.add_argument(
        "--counted", type=Path, default=ROOT / "build/counted/bin/bench",
        help="the same program built for x86-64-v3, for callgrind",
    )  # fmt: skip
    runs.add_argument(
        "--output", metavar="FILE.json", type=Path, help="default: build/bench/DATE-TIME.json"
    )
    both = parts.add_parser("compare", help="compare two files of run")
    both.add_argument("old", metavar="OLD.json", type=Path)
    both.add_argument("new", metavar="NEW.json", type=Path)
    given = options.parse_args(arguments)
    console = Console(width=None if sys.stdout.isatty() else 100)
    if given.part == "run":
        now = f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d-%H%M%S}.json"
        run(given.program, given.counted, given.output or ROOT / "build/bench" / now, console)
        return 0
    old, new = load(given.old), load(given.new)
    found = changes(old, new)
    for name, one in (("old", old), ("new", new)):
        console.print(_said(name, one), soft_wrap=True, highlight=False, markup=False)
    for title, part in found:
        console.print(table_of(title, part))
    marked = sum(bool(one.mark) for _, part in found for one in part)
    console.print(f"{marked} of {sum(len(part) for _, part in found)} changed beyond the spread.")
    return 0


if __name__ == "__main__":
    sys.exit(cli.run(main))

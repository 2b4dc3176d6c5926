"""Runs of the program `bench`: tables, peak memory, instructions."""

from __future__ import annotations

import datetime
import json
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from postproc import cli
from studies.speed.bounds import FORMAT, Rows, figures, summary
from studies.speed.changes import parsed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from studies.speed.changes import Run

MANY = 10_000_000  # particles of the run whose memory is measured
MANY_COLLISIONS = 1_000_000_000
COUNTED = (20_000_000, 80_000_000)  # collisions of the two runs whose instructions are counted


def _spoken(command: Sequence[str], problem: str) -> cli.InputError:
    return cli.InputError(f"{' '.join(command)}: {problem.strip()[:300] or 'failed'}")


def peak_memory(program: Path, number: int = MANY, collisions: int = MANY_COLLISIONS) -> float:
    """Return the peak memory of a run in bytes for each particle."""
    threshold = 7 * number // 1000
    command = [str(program), "memory", "excursion"]
    command += [str(word) for word in (number, threshold, 0.3, 0.01, collisions)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    kilobytes = run.stdout.strip()
    if run.returncode or not kilobytes.isdigit() or int(kilobytes) == 0:
        raise _spoken(command, run.stdout + run.stderr)
    return int(kilobytes) * 1024.0 / number


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
                cli.ended_with_python(command),
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                cwd=folder,
            )
            for command in commands
        ]
        outputs = [run.communicate() for run in runs]
    seen = []
    for command, run, (printed, complained) in zip(commands, runs, outputs, strict=True):
        collected = re.search(r"Collected\s*:\s*(\d+)", complained)
        if run.returncode or collected is None or not printed.strip().isdigit():
            raise _spoken(command, complained[-300:])
        seen.append((int(collected[1]), int(printed)))
    (few, few_collisions), (many, many_collisions) = seen
    return (many - few) / (many_collisions - few_collisions)


def run(program: Path, counted: Path, output: Path, console: Console) -> None:
    """Run all benchmarks, print and write the results."""
    if not program.exists():
        raise cli.InputError(f"{program}: no such program (make bench builds it)")
    cli.output_folder(cli.file_to_write(output).parent)
    command = [str(program), "--json", str(output)]
    if subprocess.run(cli.ended_with_python(command), check=False).returncode:
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


def said(name: str, one: Run) -> str:
    """Return the program and the date of the figures in a file."""
    return f"{name}: " + ", ".join(
        str(one.about.get(key, "unknown")) for key in ("date", "processor", "commit")
    )

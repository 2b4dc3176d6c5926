"""Efficiency of an ensemble on several ranks: speed-up, overhead of a task, cost of a rank.

`speedup` runs a scan of 50 points in turn on one rank and on two (or `--ranks`), round after round,
so that a machine whose speed drifts slows both alike, and gives the ratio of each round, of wall
time and of the processor time of the ranks: the second is what the first would be if
nothing else ran.
`overhead` runs many tasks with hardly any work, and gives the overhead of one, as a share of a
task of one second.
`ranks` starts more and more ranks than there are processors for tasks with hardly any work, and
gives the seconds to start and to end, tasks per second, and memory per rank.

Prints JSON.
"""

from __future__ import annotations

import json
import os
import re
import resource
import statistics
import subprocess
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from postproc import cli
from postproc.launcher import LAUNCHER, own_environment
from studies.common import study

SCAN = """&particles
  number = {number}
/
&gate
  threshold = {threshold}
/
&run
  collisions = {collisions}
  transient_collisions = {transient}
/
&scan
  channel2_width_range = 0.002, 0.1, {points}
  replicas = {replicas}
/
&output
  file = 'scan.h5'
/
"""

ENVIRONMENT = {**own_environment(), **LAUNCHER}


@dataclass(frozen=True)
class Cost:
    """Cost of one run: wall seconds, processor seconds of all ranks, memory of a rank in MB."""

    wall: float
    processor: float
    memory: float


def scan_text(
    points: int, collisions: int, number: int = 1000, threshold: int = 7, replicas: int = 1
) -> str:
    """Return the namelist of a scan over w'."""
    return SCAN.format(
        number=number,
        threshold=threshold,
        collisions=collisions,
        transient=collisions // 2,
        points=points,
        replicas=replicas,
    )


def run(program: Path, text: str, ranks: int, *, watch: bool = False) -> Cost:
    """Run a scan in a folder of its own; raise if a task is missing at the end."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "scan.nml").write_text(text)
        command = [str(program), "--quiet", "scan.nml"]
        # One rank is started by mpirun as well, since starting takes time. Ranks are not bound to a
        # processor, so that they can avoid one on which another process runs.
        command = ["mpirun", "--bind-to", "none", "-n", str(ranks), *command]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        began = time.perf_counter()
        process = subprocess.Popen(
            command, cwd=folder, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        memory = _memory_of_ranks(process, program) if watch else [0.0]
        output, _ = process.communicate()
        wall = time.perf_counter() - began
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if process.returncode:
            text = output.decode(errors="replace")[:600].strip()
            raise cli.InputError(f"{' '.join(command)}: {text}")
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Cost(wall, spent, max(memory, default=0.0))


def _memory_of_ranks(process: subprocess.Popen[bytes], program: Path) -> list[float]:
    """Watch a run until it ends; return the mean memory of a rank over time, in MB."""
    seen: list[float] = []
    name = program.resolve().name

    def watch() -> None:
        while process.poll() is None:
            shares = [share for number in _children(process.pid) if (share := _share(number, name))]
            if shares:
                seen.append(statistics.mean(shares) / 1024.0)
            time.sleep(0.3)

    watcher = threading.Thread(target=watch)
    watcher.start()
    process.wait()
    watcher.join()
    return seen


def _children(parent: int) -> list[int]:
    found: list[int] = []
    for path in Path(f"/proc/{parent}/task").glob("*/children"):
        with suppress(OSError):
            found += [int(word) for word in path.read_text().split()]
    return found


def _share(number: int, name: str) -> float:
    """Return the proportional set size of a process in kB; 0 if it is another program."""
    with suppress(OSError):
        if Path(f"/proc/{number}/comm").read_text().strip() == name:
            text = Path(f"/proc/{number}/smaps_rollup").read_text()
            found = re.search(r"^Pss: +(\d+) kB", text, re.MULTILINE)
            return float(found.group(1)) if found else 0.0
    return 0.0


def speedup(program: Path, ranks: int, points: int, collisions: int, rounds: int) -> dict[str, Any]:
    """Compare several ranks with one on the same scan, in turn."""
    text = scan_text(points, collisions)
    found = []
    for turn in range(rounds):
        # The order alternates from round to round.
        order = (1, ranks) if turn % 2 == 0 else (ranks, 1)
        costs = {n: run(program, text, n) for n in order}
        one, more = costs[1], costs[ranks]
        found.append(
            {
                "wall_seconds": [round(one.wall, 3), round(more.wall, 3)],
                "processor_seconds": [round(one.processor, 3), round(more.processor, 3)],
                "speedup": round(one.wall / more.wall, 3),
                "processor_speedup": round(ranks * one.processor / more.processor, 3),
            }
        )
    return {
        "ranks": ranks,
        "points": points,
        "collisions": collisions,
        "rounds": found,
        "median_speedup": statistics.median(row["speedup"] for row in found),
        "best_speedup": max(row["speedup"] for row in found),
        "median_processor_speedup": statistics.median(row["processor_speedup"] for row in found),
    }


def overhead(program: Path, tasks: int, rounds: int) -> dict[str, Any]:
    """Return the overhead of a task: many tasks against few, both with hardly any work."""
    few = scan_text(1, 1000, number=100, threshold=3, replicas=1)
    many = scan_text(1, 1000, number=100, threshold=3, replicas=tasks + 1)
    wall, processor = [], []
    for _ in range(rounds):
        least, most = run(program, few, 1), run(program, many, 1)
        wall.append((most.wall - least.wall) / tasks)
        processor.append((most.processor - least.processor) / tasks)
    return {
        "tasks": tasks,
        "wall_seconds_a_task": statistics.median(wall),
        "processor_seconds_a_task": statistics.median(processor),
        "share_of_a_task_of_one_second": statistics.median(wall),
    }


def many_ranks(program: Path, numbers: list[int], tasks: int) -> list[dict[str, Any]]:
    """Run tasks with hardly any work on more ranks than there are processors."""
    rows = []
    for ranks in numbers:
        few = run(program, scan_text(1, 1000, number=100, threshold=3), ranks)
        text = scan_text(1, 1000, number=100, threshold=3, replicas=tasks)
        found = run(program, text, ranks, watch=True)
        rows.append(
            {
                "ranks": ranks,
                "start_and_end_seconds": round(few.wall, 2),
                "tasks": tasks,
                "wall_seconds": round(found.wall, 2),
                "processor_seconds_a_rank": round(found.processor / ranks, 3),
                "memory_a_rank_mb": round(found.memory, 1),
            }
        )
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Measure what the command line asks for."""
    options = study.parser(__file__, __doc__)
    options.add_argument("what", choices=("speedup", "overhead", "ranks"))
    options.add_argument("--program", type=Path, default=Path("build/bin/battery"), metavar="FILE")
    options.add_argument("--ranks", type=int, nargs="+", default=[2], help="default: 2")
    options.add_argument("--points", type=int, default=50, help="of the scan (50)")
    options.add_argument("--collisions", type=int, default=100_000_000, help="a point (100000000)")
    options.add_argument("--tasks", type=int, default=2000, help="with next to no work (2000)")
    options.add_argument("--rounds", type=int, default=5, help="default: 5")
    chosen = options.parse_args(arguments)
    program = chosen.program.resolve()
    if not os.access(program, os.X_OK):
        raise cli.InputError(f"{chosen.program}: no such program (make build makes it)")
    smallest = min(*chosen.ranks, chosen.points, chosen.collisions, chosen.tasks, chosen.rounds)
    if smallest < 1:
        raise cli.InputError("all numbers must be above 0")
    if chosen.what == "speedup":
        found: Any = speedup(
            program, chosen.ranks[0], chosen.points, chosen.collisions, chosen.rounds
        )
    elif chosen.what == "overhead":
        found = overhead(program, chosen.tasks, chosen.rounds)
    else:
        found = many_ranks(program, chosen.ranks, chosen.tasks)
    print(json.dumps(found, indent=2))
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

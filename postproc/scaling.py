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
from pathlib import Path
from typing import Any

from postproc import cli
from postproc.speed.scaling import many_ranks, overhead, speedup


def main(arguments: list[str] | None = None) -> int:
    """Measure what the command line asks for."""
    options = cli.parser("scaling", __doc__)
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

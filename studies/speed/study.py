"""Benchmarks: tables of the speed, and required figures.

`make bench` lets build/bin/bench measure its tables, takes the peak memory of a run of 1e7
particles, counts instructions where valgrind is installed, prints the figures beside their bounds
and writes everything as JSON in build/bench. All times are taken by the Fortran program itself,
processor time.
Rounds of one run share the state of the machine: between two runs of the same program on a shared
machine all rates may change by the same factor, costs relative to a row of the same run do not.
With BASE (`make bench BASE=COMMIT`) it runs another build of `bench` and the present one in turn,
and prints how many times as fast the present one is, in processor time.
"""

from __future__ import annotations

import datetime
import sys
from pathlib import Path

from rich.console import Console

from postproc import cli
from studies.common import study
from studies.common.study import ROOT
from studies.speed.benchmarks import run
from studies.speed.ratios import POINTS, ROUNDS, ratio, table_of

BENCH = ROOT / "build/bench"


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmarks, or compare two programs."""
    options = study.parser(__file__, __doc__)
    options.add_argument(
        "base", metavar="BASE", type=Path, nargs="?",
        help="another build of `bench`, to be compared; absent: run all benchmarks",
    )  # fmt: skip
    options.add_argument("--program", type=Path, default=ROOT / "build/bin/bench")
    options.add_argument(
        "--counted", type=Path, default=ROOT / "build/x86-64-v3/bin/bench",
        help="the same program built for x86-64-v3, for callgrind",
    )  # fmt: skip
    options.add_argument(
        "--output", metavar="FILE.json", type=Path, help="default: build/bench/DATE-TIME.json"
    )
    options.add_argument("--rounds", type=cli.allowed(int, 1), default=ROUNDS, help="pairs of runs")
    given = options.parse_args(arguments)
    console = Console(width=None if sys.stdout.isatty() else 100)
    if given.base is None:
        now = f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d-%H%M%S}.json"
        run(given.program, given.counted, given.output or BENCH / now, console)
    else:
        found = [ratio(name, given.base, given.program, given.rounds) for name in POINTS]
        console.print(table_of(found))
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

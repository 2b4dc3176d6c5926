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
import sys
from pathlib import Path

from rich.console import Console

from postproc import cli
from postproc.speed.benchmarks import ROOT, run, said
from postproc.speed.changes import changes, load, table_of


def main(arguments: list[str] | None = None) -> int:
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
        console.print(said(name, one), soft_wrap=True, highlight=False, markup=False)
    for title, part in found:
        console.print(table_of(title, part))
    marked = sum(bool(one.mark) for _, part in found for one in part)
    console.print(f"{marked} of {sum(len(part) for _, part in found)} changed beyond the spread.")
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

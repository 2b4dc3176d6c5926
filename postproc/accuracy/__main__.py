"""Makes the speed-accuracy charts, the tables, and the page that shows them.

Parts are made in order; a run that is complete is not repeated, one that was interrupted goes on.
"""

from __future__ import annotations

import importlib
import importlib.util
import time
from pathlib import Path

from postproc import cli
from postproc.accuracy.job import ROOT, Job
from postproc.figures import style

# each a module of this package with run(job); the page comes last, from what the others kept
PARTS = (
    "trajectories", "stability", "polygons", "reversal", "gated_reversal", "pasts", "tail",
    "observables", "ladder_map", "page",
)  # fmt: skip


def there(part: str) -> bool:
    """Tell whether there is such a module."""
    return importlib.util.find_spec(f"postproc.accuracy.{part}") is not None


def make(part: str, job: Job) -> None:
    """Make one part, and say how long it took."""
    began = time.monotonic()
    importlib.import_module(f"postproc.accuracy.{part}").run(job)
    print(f"{part}: {time.monotonic() - began:.0f} s", flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Make all parts, or those that are named."""
    known = [part for part in PARTS if there(part)]
    options = cli.parser("accuracy", __doc__)
    options.add_argument(
        "parts", metavar="PART", nargs="*", help=f"parts to make, by default all: {' '.join(known)}"
    )
    options.add_argument("--full", action="store_true", help="long runs (hours)")
    options.add_argument("--afresh", action="store_true", help="discard the runs that are there")
    options.add_argument(
        "--publish", action="store_true", help="copy the page and its figures into docs"
    )
    options.add_argument("--ranks", type=int, default=2, help="MPI ranks (default: 2)")
    options.add_argument(
        "--program", type=Path, default=ROOT / "build/bin/battery", help="the built program"
    )
    options.add_argument(
        "--output", metavar="DIR", type=Path, help="default: build/accuracy/quick, or full"
    )
    given = options.parse_args(arguments)
    wrong = [part for part in given.parts if part not in known]
    if wrong:
        raise cli.InputError(f"there is no part {wrong[0]}; allowed: {' '.join(known)}")
    if not given.program.exists():
        raise cli.InputError(f"{given.program}: no such program (make build)")
    folder = given.output or ROOT / "build/accuracy" / ("full" if given.full else "quick")
    job = Job(folder, given.full, given.program, given.ranks, given.afresh, given.publish)
    style.figure()  # sets the look
    for part in given.parts or known:
        make(part, job)
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

"""Makes the five experiments that decide whether urns remember: predicted, measured, one table.

Runs are made in build/experiments/quick (about two minutes of one core), or full (ten times as
much); what is complete is not repeated. Numbers are written to experiments.json there.
"""

from __future__ import annotations

from pathlib import Path

from postproc import cli
from postproc.accuracy import experiments, experiments_page
from postproc.figures import style
from postproc.study.study import ROOT, Study


def main(arguments: list[str] | None = None) -> int:
    """Make the experiments, print the page, write it and its figure."""
    options = cli.parser("experiments", __doc__)
    options.add_argument("--full", action="store_true", help="long runs")
    options.add_argument("--afresh", action="store_true", help="discard the runs that are there")
    options.add_argument("--publish", action="store_true", help="write page and figure into docs")
    options.add_argument(
        "--ranks", type=cli.integer(1), default=2, help="MPI ranks of an ensemble (default: 2)"
    )
    options.add_argument(
        "--program", type=Path, default=ROOT / "build/bin/battery", help="the built program"
    )
    options.add_argument(
        "--output", metavar="DIR", type=Path, help="default: build/experiments/quick, or full"
    )
    given = options.parse_args(arguments)
    if not given.program.exists():
        raise cli.InputError(f"{given.program}: no such program (make build)")
    folder = given.output or ROOT / "build/experiments" / ("full" if given.full else "quick")
    study = Study(folder, given.full, given.program, given.ranks, given.afresh)
    numbers = experiments.run(study)
    text = experiments_page.page(numbers)
    print(text)
    places = [folder, *([ROOT / "docs"] if given.publish else [])]
    for place in places:
        (cli.output_folder(place) / "experiments.md").write_text(text, encoding="utf-8")
    style.save(experiments_page.figure(numbers), folder, "experiments")
    if given.publish:
        picture = (folder / "experiments.png").read_bytes()
        (ROOT / "docs/experiments.png").write_bytes(picture)
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

"""Writes one self-contained HTML page about a run: warnings, maps, replicas, series, table.

The page needs no network. Maps and curves show the values at the point under the mouse, in all of
them at once; a click shows the replicas of that point, their series and its namelist; the table can
be sorted, and saved as CSV.
"""

from __future__ import annotations

from pathlib import Path

from postproc import cli
from postproc.figures.theories import add_models
from postproc.reporting import report


def main(arguments: list[str] | None = None) -> int:
    """Write FILE.html."""
    options = cli.parser("report", __doc__)
    options.add_argument("files", metavar="FILE.h5", type=Path, nargs="+")
    cli.add_verify(options)
    add_models(options)
    cli.add_output(options)
    given = options.parse_args(arguments)
    path = given.output / f"{given.files[0].stem}.html"
    print(report(given.files, path, theory=given.theory, verify=given.verify))
    return 0

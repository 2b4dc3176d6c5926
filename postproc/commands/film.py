"""Makes a film of the circuit from the snapshots of a run.

The film shows the table with its particles; a gate flashes when it reverses (if the run has an
event log); below are chi and the net current of channel 2, from urn 2 to urn 1, against time (the
current if the run has a series). Snapshots follow each other, as they are. MP4, or GIF with
`--gif`. Its name begins with that of the results file, and has --point and --replica if they are
given, as that of a figure.
"""

from __future__ import annotations

from pathlib import Path

from postproc import cli
from postproc.figures.film import SECONDS, film


def main(arguments: list[str] | None = None) -> int:
    """Write FILE_film.mp4 or FILE_film.gif."""
    options = cli.parser("film", __doc__)
    options.add_argument("file", metavar="FILE.h5", type=Path)
    cli.add_task(options)
    about = "longest that it may last (default: 30)"
    options.add_argument("--seconds", type=float, default=SECONDS, help=about)
    options.add_argument("--gif", action="store_true", help="write a GIF, not an MP4")
    cli.add_output(options)
    given = options.parse_args(arguments)
    task = {"point": given.point, "replica": given.replica}
    told = [f"{key}={value}" for key, value in task.items() if value is not None]
    name = "_".join([given.file.stem, "film", *told])
    path = given.output / f"{name}.{'gif' if given.gif else 'mp4'}"
    print(film(given.file, path, seconds=given.seconds, verify=given.verify, **task))
    return 0

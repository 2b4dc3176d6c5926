"""Makes a film of the circuit from the snapshots of a run.

The film shows the table with its particles; a gate flashes when it reverses (if the run has an
event log); below are chi and the net current of channel 2 against time (the current if the run has
a series). Snapshots within 0.6 time units of each other are joined by straight flight, others
follow each other. MP4, or GIF with `--gif`.
"""

from __future__ import annotations

import sys

from postproc import cli
from postproc.figures.film import CLOSE, SECONDS, joined, read_scenes, write
from postproc.reading.results import Results


def main(arguments: list[str] | None = None) -> int:
    """Write film.mp4 or film.gif."""
    options = cli.parser("film", __doc__)
    cli.add_task(options)
    options.add_argument("--seconds", type=float, default=SECONDS, help="length (default: 30)")
    options.add_argument("--gif", action="store_true", help="write a GIF, not an MP4")
    cli.add_output(options)
    given = options.parse_args(arguments)
    if not 0.0 < given.seconds <= 3600.0:
        raise cli.InputError(f"--seconds {given.seconds} must lie above 0 and up to 3600")
    with Results(given.file, verify=given.verify) as results:
        scenes = read_scenes(results, *results.task(given.point, given.replica))
        results.say_if_partial()
    if not joined(scenes.times):
        print(
            f"{given.file}: snapshots more than {CLOSE} apart follow each other without flight",
            file=sys.stderr,
        )
    folder = cli.output_folder(given.output)
    path = cli.file_to_write(folder / ("film.gif" if given.gif else "film.mp4"))
    write(scenes, given.seconds, path)
    print(path)
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

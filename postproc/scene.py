"""Draws the table to scale with the particles of a snapshot.

Fig. model of PRE 103, 032119 (2021) with the particles of the run. A gate counts the particles
inside it that move to the other gate; when an entry makes the count exceed T, all of them are
reversed. So a particle is marked as *counted* if it is in a gate and moves to the other gate, and
as *next to be turned back* if moreover the count of its gate is nearer to exceeding T.
"""

from __future__ import annotations

from postproc import cli
from postproc.figures import style
from postproc.figures.scene import figure_scene
from postproc.reading.results import Results


def main(arguments: list[str] | None = None) -> int:
    """Write scene.png and scene.pdf."""
    options = cli.parser("scene", __doc__)
    cli.add_task(options)
    options.add_argument("--snapshot", type=int, help="which snapshot, from 1 (default: the last)")
    cli.add_output(options)
    given = options.parse_args(arguments)
    with Results(given.file, verify=given.verify) as results:
        index = -1 if given.snapshot is None else given.snapshot - 1
        if given.snapshot is not None and given.snapshot < 1:
            raise cli.InputError(f"--snapshot {given.snapshot} must be at least 1")
        point, replica = results.task(given.point, given.replica)
        snapshot = results.snapshot(point, replica, index)
        made = figure_scene(results.any_circuit(point), snapshot)
        style.note(made.axes[0], results.remark)
        results.say_if_partial()
    style.save(made, given.output, "scene")
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

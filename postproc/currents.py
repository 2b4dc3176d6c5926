"""Draws flows and net currents against time, with their values by theories, and eta.

The picture of Fig. comp05 of PRE 103, 032119 (2021), for one task of a run with a series.
"""

from __future__ import annotations

from postproc import cli
from postproc.figures import style
from postproc.figures.currents import figure_currents
from postproc.figures.models import add_models, named
from postproc.reading.results import Results


def main(arguments: list[str] | None = None) -> int:
    """Write currents.png and currents.pdf."""
    options = cli.parser("currents", __doc__)
    cli.add_task(options)
    add_models(options)
    cli.add_output(options)
    given = options.parse_args(arguments)
    with Results(given.file, verify=given.verify) as results:
        models = named(given.model or ())
        made = figure_currents(results, *results.task(given.point, given.replica), models)
        results.say_if_partial()
    style.save(made, given.output, "currents")
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

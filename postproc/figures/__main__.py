"""Draws a figure of the paper, by its label, from the files of one or several runs.

model   the table (no file, or one with a snapshot)
app1    the single urn of the appendix, likewise
numris  maps of chi and polarised current over T and w', for either start (runs from both, in any
        order)
comp05  flows and net currents against time, a panel a point, eta below
comp06  chi and net current against time from chi(0) = 1
comp01  polarised current against T/N and against chi, for several w'
app2    current of the single urn against T/N
app3    its relative difference from theory
app4    it and theory divided by N

and two that the paper has not:

lifetimes    lifetimes of both states against N, from series that begin in them
one_channel  maps of chi over l, w, r and T without channel 2 (a scan over two of them each, in any
             order), and where the transition is

Theories are drawn by name (--model NAME ...): those of `theory --model`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from postproc import cli
from postproc.figures import appendix, maps, style
from postproc.figures.circuits import figure_comp01, figure_comp05, figure_comp06
from postproc.figures.model import figure_app1, figure_model
from postproc.figures.models import add_models, named
from postproc.figures.one_channel import figure_one_channel
from postproc.figures.passages import figure_lifetimes
from postproc.reading.results import opened

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

    Drawing = Callable[..., Figure]


TABLES: dict[str, Drawing] = {"model": figure_model, "app1": figure_app1}  # no theory, or file
FIGURES: dict[str, Drawing] = {
    **TABLES,
    "numris": maps.figure_numris,
    "comp05": figure_comp05,
    "comp06": figure_comp06,
    "comp01": figure_comp01,
    "app2": appendix.figure_app2,
    "app3": appendix.figure_app3,
    "app4": appendix.figure_app4,
    "lifetimes": figure_lifetimes,
    "one_channel": figure_one_channel,
}

SHAPES = dict.fromkeys(("app1", "app2", "app3", "app4"), "urn")


def main(arguments: list[str] | None = None) -> int:
    """Write NAME.png and NAME.pdf."""
    options = cli.parser("figures", __doc__)
    options.add_argument("name", metavar="NAME", choices=sorted(FIGURES))
    options.add_argument("files", metavar="FILE.h5", type=Path, nargs="*")
    cli.add_verify(options)
    add_models(options)
    cli.add_output(options)
    given = options.parse_args(arguments)
    if not given.files and given.name not in TABLES:
        raise cli.InputError(f"figure {given.name} needs at least one file of results")
    with opened(given.files, verify=given.verify) as files:
        for results in files:
            if results.shape != SHAPES.get(given.name, "circuit"):
                raise cli.InputError(
                    f"{results.path}: a run of shape '{results.shape}', not of figure {given.name}"
                )
        models = {"models": named(given.model)} if given.model else {}
        made = FIGURES[given.name](files, **({} if given.name in TABLES else models))
        remarks = [results.remark for results in files if results.remark]
        if remarks:
            style.note(made.axes[0], "; ".join(remarks))
        for results in files:
            results.say_if_partial()
    style.save(made, given.output, given.name)
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

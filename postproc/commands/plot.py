"""Draws results by name, from one results file or several: NAME.png and NAME.pdf.

The names of files begin with that of the (first) results file, and end with what was chosen by
--select, --point, --replica and --snapshot. Names are what is drawn, or the
labels of the paper's figures:

phase_diagram   maps of chi and polarised current over T and w', a row for each start (numris)
flows           flows and net currents against time, a panel a point, eta below (comp05)
relaxation      chi and polarised current against time, mean and band over replicas (comp06)
curves          polarised current against T/N, or another key, and against chi (comp01)
characteristic  voltage ln(N2/N1) and power against the net current over a scan, as of w', or files
                of several numbers of discs in channel 2
lifetimes       lifetimes of both states against N, from series that begin in them
scene           the table of one point to scale with the particles of a snapshot
circuit, urn    the table with its lengths named, no file or one point with snapshots (model, app1)
urn_current, urn_difference, urn_scaled
                current of the single urn against T/N, its relative difference from theory, both
                divided by N (app2, app3, app4)

A figure shows each point that it is given, or refuses; --select KEY=VALUE and --point choose, and
--replica takes one replica of each point. Theories are drawn by name (--theory NAME ... or
--theory NAME,NAME): those of `theory --theory`.
"""

from __future__ import annotations

import argparse
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING

from postproc import cli
from postproc.figures import appendix, maps, style
from postproc.figures.circuits import (
    figure_characteristic,
    figure_curves,
    figure_flows,
    figure_relaxation,
)
from postproc.figures.lengths import figure_circuit, figure_urn
from postproc.figures.passages import figure_lifetimes
from postproc.figures.scene import figure_scene
from postproc.figures.theories import add_models, asked
from postproc.reading.grid import dataset_of, selected
from postproc.reading.points import (
    by_point,
    files_of,
    means,
    need_only,
    remark,
    say,
    task_of,
    with_tasks,
)
from postproc.theory.models import left_out

if TYPE_CHECKING:
    from collections.abc import Callable

    import xarray as xr
    from matplotlib.figure import Figure

FIGURES: dict[str, Callable[..., Figure]] = {
    "phase_diagram": maps.figure_phase_diagram,
    "flows": figure_flows,
    "relaxation": figure_relaxation,
    "curves": figure_curves,
    "characteristic": figure_characteristic,
    "lifetimes": figure_lifetimes,
    "scene": figure_scene,
    "circuit": figure_circuit,
    "urn": figure_urn,
    "urn_current": appendix.figure_urn_current,
    "urn_difference": appendix.figure_urn_difference,
    "urn_scaled": appendix.figure_urn_scaled,
}
LABELS = {
    "numris": "phase_diagram", "comp05": "flows", "comp06": "relaxation", "comp01": "curves",
    "model": "circuit", "app1": "urn", "app2": "urn_current", "app3": "urn_difference",
    "app4": "urn_scaled",
}  # fmt: skip
WITHOUT_FILE = ("circuit", "urn")
OF_MEANS = ("phase_diagram", "curves", "characteristic")
ONE_POINT = ("scene", *WITHOUT_FILE)
ANY_SHAPE = ("circuit", "scene", "flows")


def main(arguments: list[str] | None = None) -> int:
    """Write FILE_NAME.png and FILE_NAME.pdf."""
    options = cli.parser("plot", __doc__)
    options.add_argument("name", metavar="NAME", choices=sorted([*FIGURES, *LABELS]))
    options.add_argument("files", metavar="FILE.h5", type=Path, nargs="*")
    options.add_argument(
        "--select", metavar="KEY=VALUE", nargs="+", action="extend", type=_pair, default=[],
        help="only the points with these values of scanned keys; a key twice: either value",
    )  # fmt: skip
    cli.add_task(options)
    options.add_argument(
        "--snapshot", type=cli.allowed(int, 0), metavar="K",
        help="which snapshot a scene shows, from 0 (default: the last)",
    )  # fmt: skip
    add_models(options)
    cli.add_output(options)
    given = options.parse_args(arguments)
    name = LABELS.get(given.name, given.name)
    if given.snapshot is not None and name != "scene":
        raise cli.InputError(f"--snapshot is for figure scene, not {given.name}; "
                             "--select KEY=VALUE chooses points")  # fmt: skip
    if not given.files:
        of_results = [given.select, given.theory or [], given.point, given.replica]
        if name not in WITHOUT_FILE or of_results != [[], [], None, None]:
            raise cli.InputError(f"figure {given.name} needs at least one file of results")
        style.save(FIGURES[name](), given.output, given.name)
        return 0
    data = selected(dataset_of(given.files, verify=given.verify), given.select)
    points = by_point(data)
    task_of(points, given.point, given.replica)  # refuses a task that is not there
    # A task that was chosen is all that there is, for any figure.
    chosen = {key: vars(given)[key] for key in ("point", "replica") if vars(given)[key] is not None}
    if given.replica is not None:
        points = by_point(data.isel(replica=[given.replica]))
    points = with_tasks(points if given.point is None else points.isel(point=[given.point]))
    shape = str(points.attrs.get("shape", "circuit"))
    if (shape == "urn") != name.startswith("urn") and name not in ANY_SHAPE:
        raise cli.InputError(f"{files_of(points)}: a run of shape '{shape}', not of "
                             f"figure {given.name}")  # fmt: skip
    made = _drawn(name, points, given)
    hidden = int(points["two_states"].sum()) if name in OF_MEANS else 0
    not_shown = f"in two states, not shown: {hidden} of {points.sizes['point']} points"
    notes = [remark(points), not_shown if hidden else ""]
    full = int((means(points, "chi")[0] >= 1.0).sum()) if name == "characteristic" else 0
    notes.append(f"U is infinite (chi = 1), not shown: {full} of {points.sizes['point']} points"
                 if full else "")  # fmt: skip
    if "models" in signature(FIGURES[name]).parameters:
        discs = any(one.scatterers for one in points["circuit"].values)
        notes.append("no theory has discs in channel 2" if discs else "")
    style.note(made.axes[0], "; ".join(filter(None, notes)))
    say(points, *notes, "" if given.theory or name not in OF_MEANS
        else left_out(points["circuit"].values))  # fmt: skip
    if given.snapshot is not None:
        chosen["snapshot"] = given.snapshot
    told = [f"{key}={value:.15g}" for key, value in [*given.select, *chosen.items()]]
    style.save(made, given.output, "_".join([given.files[0].stem, given.name, *told]))
    return 0


def _drawn(name: str, points: xr.Dataset, given: argparse.Namespace) -> Figure:
    """Return the figure."""
    draw = FIGURES[name]
    words = signature(draw).parameters
    more: dict[str, object] = {}
    if name in ONE_POINT:
        need_only(points)
    if given.theory:
        if "models" not in words:
            raise cli.InputError(f"figure {given.name} has no place for a theory")
        more["models"] = asked(points, given.theory)
    if given.snapshot is not None:
        more["snapshot"] = given.snapshot
    return draw(points, **more)


def _pair(text: str) -> tuple[str, float]:
    """Return KEY=VALUE as a pair."""
    key, _, value = text.partition("=")
    try:
        return key.strip(), float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: KEY=VALUE is wanted") from None

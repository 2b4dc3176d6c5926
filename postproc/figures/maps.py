"""Maps of chi and polarised current over T and w' with the theory's lines, Fig. numris."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from postproc import cli
from postproc.figures import style
from postproc.figures.models import default
from postproc.reading.points import gather

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.reading.points import Points
    from postproc.reading.results import Results
    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]
    Line = tuple[Floats, Floats, str, str]


def grid(points: Points, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Return T, w' and `values` as a map, shape (w', T), NaN where there is no point.

    Raises `InputError` if two points have the same place.
    """
    thresholds, columns = np.unique(points.threshold, return_inverse=True)
    widths, rows = np.unique(points.channel2_width, return_inverse=True)
    filled = np.full((widths.size, thresholds.size), np.nan)
    if len(set(zip(rows, columns, strict=True))) < values.size:
        raise cli.InputError("two points have the same T, w' and start: a map shows one")
    filled[rows, columns] = values
    return thresholds, widths, filled


def edges(centres: Floats) -> Floats:
    """Return the borders of cells with these centres, shape one longer."""
    if centres.size == 1:
        return centres[0] + np.array([-0.5, 0.5]) * max(abs(centres[0]), 1e-3)
    middle = 0.5 * (centres[1:] + centres[:-1])
    first, last = 2.0 * centres[0] - middle[0], 2.0 * centres[-1] - middle[-1]
    return np.concatenate([[first], middle, [last]])


def by_start(points: Points) -> list[tuple[str, Points]]:
    """Return the points of each chi(0), by increasing chi(0), with a title."""
    return [
        (rf"$\chi(0) = {start:.3g}$", points.where(points.start == start))
        for start in np.unique(points.start)
    ]


def common_circuit(files: Sequence[Results], points: Points) -> Circuit:
    """Return the circuit of the first point; raise `InputError` if more than T and w' varies.

    Runs of as many collisions have different ages.
    """
    places = zip(points.file, points.point, strict=True)
    circuits = [files[file].circuit(int(point)) for file, point in places]
    if len({replace(one, threshold=0, channel2_width=0.0, age=0.0) for one in circuits}) > 1:
        raise cli.InputError("this figure needs runs that differ in T, w' and start alone")
    return circuits[0]


def _draw(axes: Axes, points: Points, values: Floats, look: dict[str, object]) -> object:
    thresholds, widths, filled = grid(points, values)
    axes.set_facecolor("#D0D0D0")
    number = points.number[0]
    mesh = axes.pcolormesh(
        edges(thresholds) / number, edges(widths), np.ma.masked_invalid(filled), **look
    )
    mesh.set_rasterized(True)
    return mesh


def transition_lines(points: Points, circuit: Circuit, models: Sequence[Model]) -> list[Line]:
    """Return (T/N, w', dashes, label) of the transition lines of theories that have one."""
    last, lines = int(points.threshold.max()) + 1, []
    for model in models:
        thresholds, widths = model.transition_line(circuit, 1, last)
        if np.isfinite(widths).any():
            lines.append((thresholds / float(circuit.number), widths, model.dashes, model.label))
    return lines


def tricritical_places(circuit: Circuit, models: Sequence[Model]) -> Floats:
    """Return T/N and w' where transitions of theories change from a jump (left) to continuous.

    Shape (2, theory with such a point).
    """
    found = [place for model in models if (place := model.tricritical_place(circuit))]
    return np.reshape(found, (-1, 2)).T / [[float(circuit.number)], [1.0]]


def _draw_lines(axes: Axes, points: Points, lines: Sequence[Line], marks: Floats) -> None:
    for fraction, widths, dashes, label in lines:
        axes.plot(fraction, widths, ls=dashes, label=f"transition, {label}", **style.on_map())
    if marks.size:
        axes.scatter(*marks, s=26, marker="D", color=style.BLACK, edgecolors="white", lw=0.8,
                     zorder=3, label="tricritical: a jump on the left")  # fmt: skip
    low, high = edges(np.unique(points.channel2_width))[[0, -1]]
    axes.set_ylim(max(low, 0.0), high)
    borders = edges(np.unique(points.threshold)) / points.number[0]
    axes.set_xlim(borders[0], borders[-1])


@style.settings()
def figure_numris(files: Sequence[Results], models: Sequence[Model] = ()) -> Figure:
    """Return maps of chi and current, a row for each start, and of the difference of two starts.

    The current is counted along the instantaneous polarity: one with a fixed sign would cancel if
    the polarity reverses in a run.
    """
    models = models or default(files)
    points = gather(files)
    circuit = common_circuit(files, points)
    lines, marks = transition_lines(points, circuit, models), tricritical_places(circuit, models)
    starts = by_start(points)
    rows = len(starts) + (len(starts) == 2)
    made = style.figure(style.PAGE, 0.5 + 2.35 * rows)
    panels = made.subplots(rows, 2, squeeze=False, sharex=True, sharey=True)
    most = float(np.nanmax(points.along, initial=0.0)) or 1.0  # no current without channel 2
    looks = [
        ("chi", r"mass spread $\chi$", {"vmin": 0.0, "vmax": 1.0, "cmap": "viridis"}),
        ("along", "polarised current (per unit time)",
         {"vmin": 0.0, "vmax": most, "cmap": "magma"}),
    ]  # fmt: skip
    for row, (name, part) in enumerate(starts):
        for axes, (field, label, look) in zip(panels[row], looks, strict=True):
            mesh = _draw(axes, part, getattr(part, field), look)
            _draw_lines(axes, part, lines, marks)
            made.colorbar(mesh, ax=axes, label=label, pad=0.02)
            axes.set_title(f"{name}")
    if len(starts) == 2:
        _draw_differences(made, panels[-1], starts, lines, marks, looks)
    for axes in panels[-1]:
        style.label_fraction(axes)
    for axes in panels[:, 0]:
        axes.set_ylabel("$w'$")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    style.legend_above(made, handles, labels, 3, fontsize=7.5)
    return made


def _draw_differences(
    made: Figure,
    panels: Sequence[Axes],
    starts: list[tuple[str, Points]],
    lines: Sequence[Line],
    marks: Floats,
    looks: list[tuple[str, str, dict[str, object]]],
) -> None:
    """Draw the result of the more polarised start minus that of the other."""
    (name, one), (other_name, other) = starts
    places = [list(zip(part.threshold, part.channel2_width, strict=True)) for part in (one, other)]
    pairs = [(places[0].index(key), at) for at, key in enumerate(places[1]) if key in places[0]]
    if not pairs:
        raise cli.InputError("figure numris: the two starts have no point in common")
    first, second = np.array(pairs).T
    chosen = np.zeros(other.number.size, bool)
    chosen[second] = True
    common = other.where(chosen)
    for axes, (field, label, _) in zip(panels, looks, strict=True):
        difference = getattr(other, field)[second] - getattr(one, field)[first]
        most = max(float(np.nanmax(np.abs(difference))), 1e-9)
        look = {"vmin": -most, "vmax": most, "cmap": "PuOr"}
        mesh = _draw(axes, common, difference, look)
        _draw_lines(axes, common, lines, marks)
        made.colorbar(mesh, ax=axes, label=f"difference of\n{label}", pad=0.02)
        axes.set_title(f"{other_name} less {name}")

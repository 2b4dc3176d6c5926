"""Maps of chi and polarised current over two keys, over T and w' with transition lines (numris)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from postproc import cli
from postproc.figures import style
from postproc.figures.theories import default

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.reading.points import Points
    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]
    Keys = tuple[str, str]  # along the axes of a map
    Line = tuple[Floats, Floats, str, str]

STARTS = ("urn1_number", "urn1_fraction")
THRESHOLDS = ("threshold", "threshold_fraction")
WIDTH = "channel2_width"
SYMBOLS = {
    "number": "$N$", "threshold": "$T$", "threshold_fraction": "$T/N$", "channel1_width": "$w$",
    "channel1_length": r"$\ell$", "channel2_width": "$w'$", "channel2_length": r"$\ell'$",
    "urn_radius": "$r$",
}  # fmt: skip
LOOKS = {
    "chi": (r"mass spread $\chi$", {"vmin": 0.0, "vmax": 1.0, "cmap": "viridis"}),
    "polarised_current": ("polarised current (per unit time)", {"vmin": 0.0, "cmap": "magma"}),
}


def equals(name: str, value: float) -> str:
    """Return "name = value" for a legend or title, with the symbol of a key."""
    if name not in SYMBOLS:
        return f"{name} = {value:.4g}"
    return f"${SYMBOLS[name].strip('$')} = {value:.4g}$"


def axes_of(keys: Sequence[str]) -> Keys:
    """Return the keys along the axes of maps, "" for none: T across and w' up, if scanned."""
    names = sorted((name for name in keys if name not in STARTS),
                   key=lambda name: (name not in THRESHOLDS, name == WIDTH))  # fmt: skip
    up = WIDTH if WIDTH in names[1:] else "".join(names[1:2])
    return "".join(names[:1]), up


def map_axes(points: Points) -> Keys:
    """Return the keys along the axes of a map; raise `InputError` unless there are two."""
    across, up = axes_of(list(points.keys))
    if not up:
        found = f"{across} alone was scanned" if across else "here is one point"
    else:
        places = set(zip(points.keys[across], points.keys[up], strict=True))
        if any(len(set(one)) < len(places) for one in zip(*places, strict=True)):
            return across, up
        found = f"{across} and {up} change together"
    raise cli.InputError(f"a map needs two keys, {found}: figure 'curves' shows it")


def columns_of(points: Points, keys: Keys) -> tuple[tuple[Floats, str], tuple[Floats, str]]:
    """Return the values along the axes of a map at each point, and their labels; T as T/N."""
    found = []
    for name in keys:
        values, label = points.column(name), SYMBOLS.get(name, name)
        if name == "threshold" and np.unique(points.number).size == 1:
            values, label = values / points.number, "$T/N$"
        found.append((values, label))
    return found[0], found[1]


def grid(points: Points, keys: Keys, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the values along x and y, and `values` as a map, shape (y, x), NaN without a point.

    Raises `InputError` if two points have the same place.
    """
    (across, _), (up, _) = columns_of(points, keys)
    x, columns = np.unique(across, return_inverse=True)
    y, rows = np.unique(up, return_inverse=True)
    filled = np.full((y.size, x.size), np.nan)
    if len(set(zip(rows, columns, strict=True))) < values.size:
        raise cli.InputError("two points have the same T, w' and start: a map shows one")
    filled[rows, columns] = values
    return x, y, filled


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


def has_lines(keys: Keys) -> bool:
    """Tell whether theories have lines over these keys: T and w'."""
    return keys[0] in THRESHOLDS and keys[1] == WIDTH


def of_theory(points: Points, keys: Keys, models: Sequence[Model]) -> tuple[list[Line], Floats]:
    """Return lines and tricritical points of theories; raise `InputError` over other keys."""
    if models and not has_lines(keys):
        raise cli.InputError(
            f"theories have lines over threshold and {WIDTH}, not over {' and '.join(keys)}"
        )
    if points.beyond_theory(0) or not models:
        return [], np.empty((2, 0))
    circuit = points.circuit(0)
    return transition_lines(points, circuit, models), tricritical_places(circuit, models)


def draw_map(
    axes: Axes, points: Points, keys: Keys, values: Floats, look: dict[str, object]
) -> QuadMesh:
    """Draw values at points as cells, grey where there is none; return matplotlib's mesh."""
    x, y, filled = grid(points, keys, values)
    axes.set_facecolor("#D0D0D0")
    mesh = axes.pcolormesh(edges(x), edges(y), np.ma.masked_invalid(filled), **look)
    mesh.set_rasterized(True)
    (across, label_across), (up, label_up) = columns_of(points, keys)
    axes.set(xlabel=label_across, ylabel=label_up, xlim=edges(np.unique(across))[[0, -1]])
    low, high = edges(np.unique(up))[[0, -1]]
    axes.set_ylim(max(low, 0.0), high)
    return mesh


def draw_lines(axes: Axes, lines: Sequence[Line], marks: Floats) -> None:
    """Draw lines, and tricritical points in the frame; the limits of the axes stay."""
    limits = axes.get_xlim(), axes.get_ylim()
    for fraction, widths, dashes, label in lines:
        axes.plot(fraction, widths, ls=dashes, label=f"transition, {label}", **style.on_map())
    marks = marks[:, [axes.viewLim.contains(*one) for one in marks.T]]
    if marks.size:
        axes.scatter(*marks, s=26, marker="D", color=style.BLACK, edgecolors="white", lw=0.8,
                     zorder=3, label=r"tricritical: left of it $\chi$ jumps")  # fmt: skip
    axes.set(xlim=limits[0], ylim=limits[1])


def values_of(points: Points, name: str) -> tuple[Floats, str, dict[str, object]]:
    """Return means over replicas of a variable, a label, and the look of their map."""
    if name not in LOOKS and not (points.has(name) and "replica" in points.data[name].dims):
        raise cli.InputError(f"there is no variable {name!r} of runs to draw, such as chi")
    about = points.data[name].attrs if points.has(name) else {}
    label, look = LOOKS.get(name, (about.get("long_name", name), {}))
    return points.mean(name)[0], label, dict(look)


@style.settings()
def figure_phase_diagram(points: Points, models: Sequence[Model] = ()) -> Figure:
    """Return maps of chi and current, a row for each start, and of the difference of two starts.

    The current is counted along the instantaneous polarity: one with a fixed sign would cancel if
    the polarity reverses in a run.
    """
    keys = map_axes(points)
    points.need_only(*keys, "start")
    models = models or (default(points) if has_lines(keys) else ())
    lines, marks = of_theory(points, keys, models)
    starts = by_start(points)
    rows = len(starts) + (len(starts) == 2)
    made = style.figure(style.PAGE, 0.5 + 2.35 * rows)
    panels = made.subplots(rows, 2, squeeze=False, sharex=True, sharey=True)
    most = float(np.nanmax(points.current, initial=0.0)) or 1.0  # no current without channel 2
    for row, (name, part) in enumerate(starts):
        for axes, quantity in zip(panels[row], LOOKS, strict=True):
            values, label, look = values_of(part, quantity)
            mesh = draw_map(axes, part, keys, values, {"vmax": most, **look})
            draw_lines(axes, lines, marks)
            made.colorbar(mesh, ax=axes, pad=0.02)
            axes.set_title(f"{label}\n{name}")
            axes.label_outer()
    if len(starts) == 2:
        _draw_differences(made, panels[-1], keys, starts, lines, marks)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    style.legend_above(made, handles, labels, 3, fontsize=7.5)
    return made


def _draw_differences(
    made: Figure,
    panels: Sequence[Axes],
    keys: Keys,
    starts: list[tuple[str, Points]],
    lines: Sequence[Line],
    marks: Floats,
) -> None:
    """Draw the result of the more polarised start minus that of the other."""
    (name, one), (other_name, other) = starts
    places = [list(zip(*map(part.column, keys), strict=True)) for part in (one, other)]
    pairs = [(places[0].index(key), at) for at, key in enumerate(places[1]) if key in places[0]]
    if not pairs:
        raise cli.InputError("figure numris: the two starts have no point in common")
    first, second = np.array(pairs).T
    for axes, quantity in zip(panels, LOOKS, strict=True):
        values, label, _ = values_of(other, quantity)
        difference = values[second] - values_of(one, quantity)[0][first]
        most = max(float(np.nanmax(np.abs(difference), initial=0.0)), 1e-9)
        look = {"vmin": -most, "vmax": most, "cmap": "PuOr"}
        mesh = draw_map(axes, other.where(second), keys, difference, look)
        draw_lines(axes, lines, marks)
        made.colorbar(mesh, ax=axes, pad=0.02)
        axes.set_title(f"{label}\n{other_name} less {name}")
        axes.label_outer()

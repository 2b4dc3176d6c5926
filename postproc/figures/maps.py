"""Maps of chi and polarised current over two keys, over T and w' with transition lines (numris)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator

from postproc import cli
from postproc.figures import style
from postproc.reading.points import (
    FRACTIONS,
    PARAMETERS,
    files_of,
    groups,
    keys_of,
    means,
    need_only,
    second_values,
    with_first,
)
from postproc.theory.models import defaults

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

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
    "urn_radius": "$r$", "threshold2": "$T_2$", "urn_radius2": "$r_2$", "start": r"$\chi(0)$",
    "scatterer_count": r"$\mathrm{discs}$",
}  # fmt: skip
LOOKS = {
    "chi": (r"mass spread $\chi$", {"vmin": 0.0, "vmax": 1.0, "cmap": "viridis"}),
    "polarised_current": ("polarised current (per unit time)", {"cmap": "magma"}),
}


def equals(name: str, value: float, among: ArrayLike = ()) -> str:
    """Return "name = value" for a legend or title, with the symbol of a key.

    It differs from that of other values `among` the points.
    """
    digits = style.digits_apart(among, 6)
    if name not in SYMBOLS:
        return f"{name} = {style.brief(value, digits)}"
    return f"${SYMBOLS[name].strip('$')} = {style.in_math(value, digits)}$"


def axes_of(keys: Sequence[str]) -> Keys:
    """Return the keys along the axes of maps, "" for none: T across and w' up, if scanned."""
    names = sorted((name for name in keys if name not in STARTS),
                   key=lambda name: (name not in THRESHOLDS, name == WIDTH))  # fmt: skip
    up = WIDTH if WIDTH in names[1:] else "".join(names[1:2])
    return "".join(names[:1]), up


def map_axes(points: xr.Dataset) -> Keys:
    """Return the keys along the axes of a map; raise `InputError` unless there are two."""
    keys = keys_of(points)
    across, up = axes_of(list(keys))
    figure = "curves" if across or not keys else "relaxation"
    of_one = ", for one start (--select)" if across and {*keys} & {*STARTS} else ""
    if not up:
        alone = across or "".join(keys)
        found = f"{alone} alone was scanned" if alone else "here is one point"
        both = [name for name, one in second_values(points).items() if np.unique(one).size > 1]
        if both:
            raise cli.InputError(
                f"a map needs two keys other than the start, {' and '.join(with_first(both))} "
                "change together: battery-postproc table shows them"
            )
    else:
        pairs = set(zip(keys[across], keys[up], strict=True))
        if any(len(set(one)) < len(pairs) for one in zip(*pairs, strict=True)):
            return across, up
        found = f"{across} and {up} change together"
    raise cli.InputError(
        f"a map needs two keys other than the start, {found}: figure {figure!r} shows it{of_one}"
    )


def map_of(points: xr.Dataset, keys: Keys, values: Sequence[object] | Floats) -> pd.DataFrame:
    """Return `values` at points as a map over two keys, shape (up, across), NaN without a point.

    Raises `InputError` if two points have the same place.
    """
    across, up = (places(points, name) for name in keys)
    try:
        return pd.Series(values, [up, across]).unstack()
    except ValueError as problem:  # duplicates
        names = (*FRACTIONS.values(), *PARAMETERS)
        others = [name for name in names if name not in keys and name in points
                  and np.unique(points[name]).size > 1]  # fmt: skip
        raise cli.InputError(
            f"{files_of(points)}: two points have the same {', '.join(keys)} and chi(0), a map "
            f"shows one: choose, --select {(others or ['KEY'])[0]}=VALUE"
        ) from problem


def places(points: xr.Dataset, key: str) -> Floats:
    """Return the places of points along a key; T/N is that of the whole T that was run."""
    as_share = key == "threshold_fraction" and np.unique(points["number"]).size == 1
    return (points["threshold"] / points["number"] if as_share else points[key]).values


def edges(centres: Floats) -> Floats:
    """Return the borders of cells with these centres, shape one longer."""
    if centres.size == 1:
        return centres[0] + np.array([-0.5, 0.5]) * max(abs(centres[0]), 1e-3)
    middle = 0.5 * (centres[1:] + centres[:-1])
    first, last = 2.0 * centres[0] - middle[0], 2.0 * centres[-1] - middle[-1]
    return np.concatenate([[first], middle, [last]])


def by_start(points: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
    """Return the points of each chi(0), by increasing chi(0), with a title."""
    return [(equals("start", one["start"]), part) for one, part in groups(points, "start")]


def transition_lines(points: xr.Dataset, models: Sequence[Model]) -> list[Line]:
    """Return (T/N, w', dashes, label) of the transition lines of theories that have one."""
    circuit, lines = points["circuit"].values[0], []
    last = math.ceil(edges(np.unique(points["threshold"].astype(float)))[-1])  # of the map
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


def of_theory(points: xr.Dataset, keys: Keys, models: Sequence[Model]) -> tuple[list[Line], Floats]:
    """Return lines and tricritical points of theories; raise `InputError` over other keys."""
    if models and not has_lines(keys):
        raise cli.InputError(
            f"theories have lines over threshold and {WIDTH}, not over {' and '.join(keys)}"
        )
    circuit = points["circuit"].values[0]
    if circuit.beyond_theory or not models:
        return [], np.empty((2, 0))
    return transition_lines(points, models), tricritical_places(circuit, models)


def colours_of(currents: Floats) -> tuple[float, float]:
    """Return the least and the greatest value of the colours: 0 and all currents lie between them.

    Along the polarity a current is negative where the fuller urn is the larger and thinner one.
    """
    low, high = (float(end.reduce(np.ravel(currents), initial=0.0)) for end in (np.fmin, np.fmax))
    return (low, high) if low < high else (0.0, 1.0)  # as without channel 2


def draw_map(
    axes: Axes, points: xr.Dataset, keys: Keys, shown: pd.DataFrame, look: dict[str, object]
) -> QuadMesh:
    """Draw a map of points as cells, grey where there is none; return matplotlib's mesh."""
    x, y = (edges(one.to_numpy(float)) for one in (shown.columns, shown.index))
    labels, number = [SYMBOLS.get(name, name) for name in keys], np.unique(points["number"])
    if keys[0] == "threshold" and number.size == 1:
        x, labels[0] = x / number[0], SYMBOLS["threshold_fraction"]
    axes.set_facecolor("#D0D0D0")
    mesh = axes.pcolormesh(x, y, np.ma.masked_invalid(shown), shading="flat", **look)
    mesh.set_rasterized(True)
    axes.set(xlabel=labels[0], ylabel=labels[1], xlim=x[[0, -1]], ylim=(max(y[0], 0.0), y[-1]))
    axes.xaxis.set_major_locator(MaxNLocator(5))
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


def values_of(points: xr.Dataset, name: str) -> tuple[Floats, str, dict[str, object]]:
    """Return means over replicas of a variable, a label, and the look of their map.

    Raises `InputError` if there is no such variable, or no point has a mean.
    """
    of_runs = isinstance(name, str) and name in points and "replica" in points[name].dims
    if not (of_runs or name in [*LOOKS]):
        raise cli.InputError(f"there is no variable {name!r} of runs to draw, such as chi")
    about = points[name].attrs if name in points else {}
    label, look = LOOKS.get(name, (about.get("long_name", name), {}))
    values = means(points, name)[0]
    if not np.isfinite(values).any():
        raise cli.InputError(
            f"{files_of(points)}: no point has a mean of {name!r}; there is none of the current "
            "without channel 2, of chi in the single urn, and of replicas in two states"
        )
    if name == "polarised_current":
        look = look | dict(zip(("vmin", "vmax"), colours_of(values), strict=True))
    return values, label, dict(look)


@style.settings()
def figure_phase_diagram(points: xr.Dataset, models: Sequence[Model] = ()) -> Figure:
    """Return maps of chi and current, a row for each start, and of the difference of two starts.

    The current is counted along the instantaneous polarity: one with a fixed sign would cancel if
    the polarity reverses in a run.
    """
    keys = map_axes(points)
    need_only(points, *keys, "start")
    models = models or (defaults(points["circuit"].values) if has_lines(keys) else ())
    lines, marks = of_theory(points, keys, models)
    starts = [(name, {one: map_of(part, keys, means(part, one)[0]) for one in LOOKS})
              for name, part in by_start(points)]  # fmt: skip
    low, high = colours_of(np.concatenate([one["polarised_current"].values.ravel()
                                           for _, one in starts]))  # fmt: skip
    rows = list(starts)
    if len(starts) == 2:
        (name, one), (other_name, other) = starts
        rows.append((f"{other_name} less {name}", {key: other[key] - one[key] for key in LOOKS}))
        if rows[-1][1]["chi"].isna().all(axis=None):
            raise cli.InputError("figure numris: the two starts have no point in common")
    made = style.figure(style.PAGE, 0.5 + 2.35 * len(rows))
    panels, limits = made.subplots(len(rows), 2, squeeze=False, sharex=True, sharey=True), []
    for row, (name, drawn) in enumerate(rows):
        for axes, (quantity, shown) in zip(panels[row], drawn.items(), strict=True):
            label, look = LOOKS[quantity]
            if row == len(starts):
                most = max(1e-9, shown.abs().max(axis=None))
                look = {"vmin": -most, "vmax": most, "cmap": "PuOr"}
            mesh = draw_map(axes, points, keys, shown, {"vmin": low, "vmax": high, **look})
            limits.append([axes.get_xlim(), axes.get_ylim()])
            made.colorbar(mesh, ax=axes, pad=0.02)
            axes.set_title(f"{label}\n{name}")
            axes.label_outer()
    low_ends, high_ends = np.min(limits, axis=0)[:, 0], np.max(limits, axis=0)[:, 1]
    for axes in panels.flat:
        axes.set(xlim=(low_ends[0], high_ends[0]), ylim=(low_ends[1], high_ends[1]))
        draw_lines(axes, lines, marks)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    style.legend_above(made, handles, labels, 3, fontsize=7.5)
    return made

"""Maps of chi of the one-channel model over its lengths and T.

Without channel 2 an urn sends out J(n), through its gate alone. The homogeneous state is unstable
where J' < 0 at N/2. Lines are where N w l/(8 T A) = 1, the load of either gate at N/2 being T, and
where J' = 0 by theories. Runs begin with chi(0) > 0, so where the transition is not continuous they
change at J(N1) = J(N2) of their start, beyond which chi grows from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from postproc.figures import style
from postproc.theory.circuit import gate_load, log_outflow
from postproc.theory.models import MODELS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]
    LoadOf = Callable[[Circuit, Floats], Floats]
    Line = tuple[LoadOf, str, str]

# Possible axes of a plane, in this order: fields of a circuit, and their symbols.
KEYS = {
    "channel1_length": "$l$",
    "channel1_width": "$w$",
    "urn_radius": "$r$",
    "threshold": "$T$",
}
PAIR = (MODELS["window"], MODELS["renewal"])  # the paper's, and the exact J(N1) = J(N2)
LEVELS = (0.25, 0.5)  # chi at the transition: half the paper's initial chi, and this chi
PLACES = 201  # along x and along y, at which a line is searched for
COLUMNS = 3  # maps side by side
DRAWN = np.linspace(0.5, 1.3, 41)  # N w l/(8 T A) at which theories' chi is drawn
LOADS = np.linspace(0.4, 1.6, 121)  # N w l/(8 T A) at which theories are evaluated


@dataclass(frozen=True)
class Plane:
    """A scan of the one-channel model over two of its lengths and T.

    Attributes
    ----------
    circuit : a circuit with the values of the other keys.
    keys : keys along x and y, of `KEYS`.
    x, y : its values; where T varies it does along y.
    chi : mean over the replicas, shape (y, x).
    start : chi at the beginning.
    """

    circuit: Circuit
    keys: tuple[str, str]
    x: Floats
    y: Floats
    chi: Floats
    start: float

    def at(self, x: Floats, y: Floats) -> Circuit:
        """Return the circuits of places, arrays that broadcast."""
        return replace(self.circuit, **dict(zip(self.keys, (x, y), strict=True)))


def relative_load(circuit: Circuit) -> Floats:
    """Return N w l/(8 T A): the load of a gate at N/2 over T, 1 on the published line."""
    half = 0.5 * np.asarray(circuit.number, float)
    return np.asarray(gate_load(circuit, half) / np.asarray(circuit.threshold, float))


def slope_load(circuit: Circuit, thresholds: Floats, model: Model) -> Floats:
    """Return N w l/(8 T A) where J' = 0 at N/2 by a theory, for each T.

    It depends on N and T only: without channel 2, lengths enter only by the load of the gates.
    """
    own, half = model.of(_of_loads(circuit, thresholds)), 0.5 * float(circuit.number)
    inside = np.full((LOADS.size, thresholds.size), half)
    return crossing(LOADS, own.gate.slope(own.threshold, gate_load(own, inside)))


def start_load(circuit: Circuit, thresholds: Floats, model: Model, start: float) -> Floats:
    """Return N w l/(8 T A) where J(N1) = J(N2) at chi = `start` by a theory, for each T.

    Below it chi decreases from there, above it chi increases.
    """
    own, half = model.of(_of_loads(circuit, thresholds)), 0.5 * float(circuit.number)
    shape = (LOADS.size, thresholds.size)
    few, many = (
        log_outflow(own, np.full(shape, half * (1.0 + sign * start))) for sign in (-1.0, 1.0)
    )
    return crossing(LOADS, few - many)


def _of_loads(circuit: Circuit, thresholds: Floats) -> Circuit:
    """Return a circuit with l such that N w l/(8 T A) is that of `LOADS`, for each T."""
    whole = np.asarray(thresholds, float)[None, :]
    unit = relative_load(replace(circuit, channel1_length=1.0, threshold=whole))
    return replace(circuit, channel1_length=LOADS[:, None] / unit, threshold=whole)


def crossing(y: Floats, values: Floats) -> Floats:
    """Return where each column of `values`, shape (y, x), goes through 0: the mean, or NaN."""
    low, high = values[:-1], values[1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        passed = np.sign(low) * np.sign(high) < 0.0
        share = np.where(passed, low / (low - high), 0.0)
    places = y[:-1, None] + share * np.diff(y)[:, None]
    count = passed.sum(axis=0)
    total = np.where(passed, places, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), math.nan)


def line(plane: Plane, load_of: LoadOf, x: Floats | None = None) -> tuple[Floats, Floats]:
    """Return (x, y) where N w l/(8 T A) is `load_of` at this T, NaN if there is no such point.

    It is evaluated at integer T and interpolated in between.
    """
    if x is None:
        x = np.linspace(plane.x[0], plane.x[-1], PLACES)
    if plane.keys[1] == "threshold":
        y = np.arange(plane.y[0], plane.y[-1] + 1.0)
        wanted = load_of(plane.circuit, y)[:, None]
    else:
        y = np.linspace(plane.y[0], plane.y[-1], PLACES)
        wanted = load_of(plane.circuit, np.array([plane.circuit.threshold]))
    circuit = plane.at(x[None, :], y[:, None])
    # the load itself, since it and T times such a ratio are nearly linear in T
    apart = (relative_load(circuit) - wanted) * np.asarray(circuit.threshold, float)
    return x, crossing(y, apart)


def published_load(_: Circuit, thresholds: Floats) -> Floats:
    """Return N w l/(8 T A) of the published line, for each T."""
    return np.ones(thresholds.size)


def lines_of(start: float) -> dict[str, Line]:
    """Return N w l/(8 T A) of each line as a function of circuit and T, and its look, by label.

    The line for the initial state, chi = `start`, is that of the exact gate.
    """
    found: dict[str, Line] = {r"$N w \ell / 8 T A = 1$": (published_load, "-", style.BLACK)}
    for model in PAIR:
        label = f"$J' = 0$, {model.label}"
        found[label] = (partial(slope_load, model=model), model.dashes, style.BLACK)
    last = PAIR[-1]
    label = f"$J(N_1) = J(N_2)$ at $\\chi(0)$, {last.label}"
    found[label] = (partial(start_load, model=last, start=start), "-", style.PURPLE)
    return found


def transitions(plane: Plane) -> dict[str, Floats]:
    """Return N w l/(8 T A) at the transition, by runs and by theories, for each column of a plane.

    By runs: where chi is one of `LEVELS`. By theories: where J' = 0, and where J(N1) = J(N2) at the
    start of the runs. NaN where it is not in the plane.
    """
    places = {f"runs, chi = {level:g}": crossing(plane.y, plane.chi - level) for level in LEVELS}
    theories = {"J' = 0": slope_load, "start": partial(start_load, start=plane.start)}
    for name, load_of in theories.items():
        for model in PAIR:
            _, y = line(plane, partial(load_of, model=model), plane.x)
            places[f"{name}, {model.label}"] = y
    return {
        name: relative_load(plane.at(plane.x, y)) if np.isfinite(y).any() else y
        for name, y in places.items()
    }


def table(planes: Sequence[Plane]) -> str:
    """Return N w l/(8 T A) at the transitions as text, a column for each plane.

    Means and, for runs, standard deviations over the columns in which the runs cross the lower of
    `LEVELS`. The published line is at 1.
    """
    lines = ["N w l/(8 T A) at the transition, over two of the lengths and T"]
    for number in sorted({int(plane.circuit.number) for plane in planes}):
        group = [plane for plane in planes if plane.circuit.number == number]
        found = [transitions(plane) for plane in group]
        symbols = [", ".join(KEYS[key].strip("$") for key in plane.keys) for plane in group]
        width = max(map(len, found[0]))
        head = f"N = {number}"
        lines.append(f"{head:{width}s}" + "".join(f"{one:>16s}" for one in symbols))
        for name in found[0]:
            cells = (_cell(one[name], one[f"runs, chi = {LEVELS[0]:g}"], name) for one in found)
            lines.append(f"{name:{width}s}" + "".join(f"{cell:>16s}" for cell in cells))
    return "\n".join(lines)


def _cell(loads: Floats, measured: Floats, name: str) -> str:
    known = loads[np.isfinite(loads) & np.isfinite(measured)]
    if known.size == 0:
        return "-"
    return f"{known.mean():.3f}" + (f" +- {known.std():.3f}" if name.startswith("runs") else "")


@style.settings()
def figure(planes: Sequence[Plane]) -> Figure:
    """Return a map for each plane, and below chi at one T against N w l/(8 T A)."""
    numbers = sorted({int(plane.circuit.number) for plane in planes})
    groups = [[one for one in planes if one.circuit.number == number] for number in numbers]
    rows = [math.ceil(len(group) / COLUMNS) for group in groups]
    together = [group for group in map(_of_one_threshold, groups) if group]
    heights = [1.0] * sum(rows) + [1.2] * bool(together)
    made = style.figure(style.PAGE, 0.5 + 1.9 * sum(heights))
    grid = made.add_gridspec(len(heights), 2 * COLUMNS, height_ratios=heights)
    panels = []
    for row, group in zip(np.cumsum([0, *rows]), groups, strict=False):
        for at, plane in enumerate(group):
            column = 2 * (at % COLUMNS)
            panels.append(made.add_subplot(grid[row + at // COLUMNS, column : column + 2]))
            mesh = _draw_map(panels[-1], plane, lines_of(plane.start))
        panels[-len(group)].set_title(_title(group[0]))
    made.colorbar(mesh, ax=panels, label=r"mass spread $\chi$", pad=0.01, aspect=40)
    for at, group in enumerate(together):
        width = 2 * COLUMNS // len(together)
        axes = made.add_subplot(grid[-1, width * at : width * (at + 1)])
        _draw_together(axes, group)
    handles, labels = panels[0].get_legend_handles_labels()
    style.legend_above(made, handles, labels, 2, fontsize=7.5)
    return made


def _of_one_threshold(group: Sequence[Plane]) -> list[Plane]:
    return [plane for plane in group if "threshold" not in plane.keys]


def _title(plane: Plane) -> str:
    return rf"$N = {int(plane.circuit.number)}$, $\chi(0) = {plane.start:g}$"


def _draw_map(axes: Axes, plane: Plane, lines: dict[str, Line]) -> QuadMesh:
    mesh = axes.pcolormesh(
        plane.x, plane.y, plane.chi, vmin=0.0, vmax=1.0, shading="nearest", rasterized=True
    )
    for label, (load_of, dashes, colour) in lines.items():
        look = style.on_map(colour, 1.0)
        axes.plot(*line(plane, load_of), ls=dashes, label=label, **look)
    axes.set_xlabel(KEYS[plane.keys[0]], labelpad=1)
    axes.set_ylabel(KEYS[plane.keys[1]], labelpad=1)
    return mesh


def _draw_together(axes: Axes, group: Sequence[Plane]) -> None:
    """Draw chi of planes with one T against N w l/(8 T A), by runs and by theories."""
    for plane, colour in zip(group, style.CYCLE, strict=False):
        loads = relative_load(plane.at(plane.x[None, :], plane.y[:, None]))
        symbols = ", ".join(KEYS[key] for key in plane.keys)
        axes.plot(
            loads.ravel(), plane.chi.ravel(), ".", ms=1.2, color=colour, rasterized=True,
            label=f"over {symbols}",
        )  # fmt: skip
    circuit = group[0].circuit
    lengths = DRAWN * float(circuit.channel1_length) / relative_load(circuit)
    for model in PAIR:
        states = [model.stable_state(replace(circuit, channel1_length=one)) for one in lengths]
        spreads = [math.nan if one is None else one.mass_spread for one in states]
        axes.plot(DRAWN, spreads, color=style.ORANGE, ls=model.dashes, lw=1.2,
                  label=rf"$\chi$, {model.label}")  # fmt: skip
    for load_of, dashes, colour in lines_of(group[0].start).values():
        (place,) = load_of(circuit, np.array([circuit.threshold]))
        axes.axvline(place, color=colour, ls=dashes, lw=0.9, zorder=0)
    axes.set_xlim(DRAWN[0], DRAWN[-1])
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel(r"$N w \ell / 8 T A$")
    axes.set_ylabel(r"$\chi$")
    axes.set_title(f"$N = {int(circuit.number)}$, $T = {int(circuit.threshold)}$")
    axes.legend(loc="lower right", markerscale=5, fontsize=6.5, frameon=True, framealpha=1.0,
                edgecolor="none")  # fmt: skip

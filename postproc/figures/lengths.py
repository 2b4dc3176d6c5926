"""The table with its lengths named: Fig. model of the paper, and Fig. app1, the single urn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from postproc.figures import style
from postproc.figures.scene import counted_by, draw_table, ways
from postproc.reading.groups import Snapshot, snapshot_of
from postproc.reading.points import task_of
from postproc.theory.circuit import Circuit

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 40  # particles of a run that are drawn, at most
# wider than in the paper's runs, so that all lengths are visible
EXAMPLE = Circuit(SHOWN, 7, channel1_width=0.5, channel1_length=1.2, channel2_width=0.2)
URN = Circuit(SHOWN, 7, channel1_width=0.5, channel1_length=1.2, channel2_width=0.0, shape="urn")


def example_snapshot(circuit: Circuit, count: int = SHOWN, seed: int = 4) -> Snapshot:
    """Return particles uniform in urns and channels, with random directions."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(-1.0, 1.0, (2, 100 * count)) * [[circuit.end], [circuit.urn_radius]]
    from_centre = np.abs(x) - circuit.urn_centre
    urn = np.hypot(from_centre, y) < 0.96 * circuit.urn_radius
    urn &= from_centre > -circuit.chords[0]
    gate = (np.abs(x) < 0.5 * circuit.channel1_length) & (np.abs(y) < 0.45 * circuit.channel1_width)
    back = (from_centre > circuit.chords[1]) & (np.abs(y) < 0.4 * circuit.channel2_width)
    there = x < 0.0 if circuit.shape == "urn" else True
    inside = np.flatnonzero((urn | gate | back) & there)[:count]
    angle = random.uniform(0.0, 2.0 * np.pi, inside.size)
    return Snapshot(0.0, x[inside], y[inside], np.cos(angle), np.sin(angle))


def _measure(
    axes: Axes, ends: tuple[float, float], level: float, text: str, vertical: bool = False
) -> None:
    """Draw a double arrow between `ends` at `level` on the other axis, with its name."""
    start, stop = ((level, end) if vertical else (end, level) for end in ends)
    arrow = {"arrowstyle": "<->", "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", start, stop, arrowprops=arrow)
    middle = 0.5 * (ends[0] + ends[1])
    if vertical:
        axes.text(level + 0.04, middle, text, ha="left", va="center")
    else:
        axes.text(middle, level - 0.05, text, ha="center", va="top")


def figure_circuit(points: xr.Dataset | None = None) -> Figure:
    """Return the table, with some particles of the first complete task's first snapshot, if any."""
    return _figure(EXAMPLE, points)


def figure_urn(points: xr.Dataset | None = None) -> Figure:
    """Return the single urn of the appendix, with its gate and its end wall."""
    return _figure(URN, points)


@style.settings()
def _figure(circuit: Circuit, points: xr.Dataset | None) -> Figure:
    if points is None:
        snapshot, said = example_snapshot(circuit), ""
    else:
        task = task_of(points, None, None)
        circuit, full = points["circuit"].values[task[0]], snapshot_of(points, *task, 0)
        step = -(-full.x.size // SHOWN)
        parts = [part[::step] for part in (full.x, full.y, full.ux, full.uy)]
        snapshot = Snapshot(full.time, *parts)
        said = f"{parts[0].size} of {full.x.size} particles, $t = {full.time:g}$"
    made = style.figure(style.PAGE if circuit.shape == "circuit" else style.COLUMN * 1.2, 2.9)
    made.set_layout_engine("none")  # the labels are outside of the axes
    axes = made.add_axes((0.03, 0.02, 0.94, 0.94))
    made.text(0.98, 0.98, said, ha="right", va="top", fontsize=8)
    draw_table(axes, circuit)
    counted = counted_by(circuit, snapshot) > 0
    colour = np.where(counted, style.VERMILION, style.BLUE)
    axes.scatter(snapshot.x, snapshot.y, s=10, c=colour, lw=0, zorder=3)
    axes.quiver(
        *(snapshot.x, snapshot.y, snapshot.ux, snapshot.uy),
        color=colour,
        angles="xy",
        scale_units="xy",
        scale=6.0 / circuit.urn_radius,
        width=0.002 if circuit.shape == "circuit" else 0.0035,
        zorder=3,
        clip_on=False,
    )
    _name_lengths(axes, circuit)
    return made


def _name_lengths(axes: Axes, circuit: Circuit) -> None:
    half1, reach = 0.5 * circuit.channel1_width, 0.5 * circuit.channel1_length
    for number, (way, side) in enumerate(ways(circuit), start=1):
        radius = side.urn_radius
        ends = sorted((way * reach, 0.0))
        _measure(axes, ends, -half1 - 0.1 * radius, r"$\ell/2$")
        axes.text(way * 0.5 * reach, half1 + 0.06 * radius, f"gate {number}", ha="center")
        top = radius if side.outline is None else max(y for _, y in side.outline)
        axes.text(way * side.urn_centre, top + 0.06 * radius, f"urn {number}", ha="center")
        if circuit.channel2_width > 0.0:
            start, under = side.urn_centre + side.chords[1], -0.5 * circuit.channel2_width
            _measure(axes, (way * start, way * side.end), under - 0.1 * radius, r"$\ell'/2$")
    if circuit.shape == "circuit":
        _measure(axes, (-half1, half1), 0.6 * reach, "$w$", vertical=True)
    else:
        _measure(axes, (-half1, half1), 0.1 * radius, "$w$", vertical=True)
        look = {"ha": "center", "va": "center", "rotation": 90}
        axes.text(0.34 * radius, 0.0, "end wall", **look)
        axes.set_xlim(right=0.45 * radius)
    if circuit.outline is None:
        _name_radii(axes, circuit)
    if circuit.channel2_width > 0.0:
        axes.text(side.end + 0.06, 0.0, "$w'$", va="center")


def _name_radii(axes: Axes, circuit: Circuit) -> None:
    """Name r at the last urn, or that of each if they differ."""
    sides = ways(circuit)
    alike = len({float(side.urn_radius) for _, side in sides}) == 1
    for number, (way, side) in enumerate(sides, start=1):
        if alike and number < len(sides):
            continue
        radius, last = side.urn_radius, way * float(side.urn_centre)
        angle = np.radians(130.0)
        tip = (last - radius * np.cos(angle), radius * np.sin(angle))
        arrow = {"arrowstyle": "->", "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tip, (last, 0.0), arrowprops=arrow)
        name = "$r$" if alike else f"$r_{number}$"
        axes.text(last + 0.42 * radius, 0.36 * radius, name, ha="left")

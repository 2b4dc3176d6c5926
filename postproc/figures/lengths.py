"""The table with its lengths named: Fig. model of the paper, and Fig. app1, the single urn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.path import Path

from postproc.figures import style
from postproc.figures.scene import counted_by, draw_table, walls, ways
from postproc.reading.groups import Snapshot, snapshot_of
from postproc.reading.points import task_of
from postproc.theory.circuit import Circuit

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 40  # particles of a run that are drawn, at most
ROOM = 2.5  # least radius with a name in the disc, in widths of that
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


def _measure(axes: Axes, ends: tuple[float, float], level: float, vertical: bool = False) -> None:
    """Draw a double arrow between `ends` at `level` on the other axis."""
    start, stop = ((level, end) if vertical else (end, level) for end in ends)
    arrow = {"arrowstyle": "<->", "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", start, stop, arrowprops=arrow)


def _size(axes: Axes, text: str) -> tuple[float, float]:
    """Return width and height of a text in the units of the axes."""
    shown = axes.text(0.0, 0.0, text)
    box = shown.get_window_extent().transformed(axes.transData.inverted())
    shown.remove()
    return box.width, box.height


def _name(
    axes: Axes, circuit: Circuit, ends: tuple[float, float], level: float, text: str, way: int
) -> None:
    """Name what lies between `ends`, the inner first, above (way = 1) or below (-1) a level.

    A text that is wider goes on outwards. It stands where no wall and no other text is, with a line
    to what it names if that is not at the level; where the picture has no such place, on white.
    """
    middle, side, others = 0.5 * (ends[0] + ends[1]), "center", [*axes.texts]
    if middle != 0.0 and _size(axes, text)[0] > abs(ends[1] - ends[0]):
        side = "left" if ends[1] > ends[0] else "right"
    look = {"ha": side, "va": "baseline" if way > 0 else "top"}
    shown = axes.text(middle if side == "center" else ends[0], level, text, **look)
    taken = [one.get_window_extent() for one in others if one.get_text()]
    lines = [Path(axes.transData.transform(one)) for one in walls(circuit)]
    step, at = 0.25 * _size(axes, text)[1], level
    while any(one.intersects_bbox(shown.get_window_extent(), filled=False) for one in lines) or any(
        one.overlaps(shown.get_window_extent()) for one in taken
    ):
        at += way * step
        shown.set_y(at)
    box, page = shown.get_window_extent(), axes.figure.bbox
    if not page.y0 <= box.y0 < box.y1 <= page.y1:
        look = {"fc": "white", "lw": 0.0, "pad": 0.5}
        shown.update({"y": level, "va": "top" if way > 0 else "bottom", "bbox": look})
        return
    if at != level:
        axes.plot([middle] * 2, [level, at - way * step], color=style.BLACK, lw=0.5)


def figure_circuit(points: xr.Dataset | None = None) -> Figure:
    """Return the table, with some particles of the first complete task's first snapshot, if any."""
    return _figure(EXAMPLE, points)


def figure_urn(points: xr.Dataset | None = None) -> Figure:
    """Return the single urn of the appendix, with its gate and its end wall."""
    return _figure(URN, points)


def _figure(circuit: Circuit, points: xr.Dataset | None) -> Figure:
    if points is None:
        snapshot, said = example_snapshot(circuit), ""
    else:
        task = task_of(points, None, None)
        circuit, full = points["circuit"].values[task[0]], snapshot_of(points, *task, 0)
        step = -(-full.x.size // SHOWN)
        parts = [part[::step] for part in (full.x, full.y, full.ux, full.uy)]
        snapshot = Snapshot(full.time, *parts)
        said = f"{parts[0].size} of {full.x.size} particles, $t = {style.in_math(full.time, 6)}$"
    return picture_of(circuit, snapshot, said)


@style.settings()
def picture_of(circuit: Circuit, snapshot: Snapshot, said: str = "") -> Figure:
    """Return the table of a circuit with its lengths, the particles of a snapshot and a remark."""
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
    with style.measured(made):
        _name_lengths(axes, circuit)
    return made


def _name_lengths(axes: Axes, circuit: Circuit) -> None:
    """Name urns, gates and lengths; two halves that have no room for a name have one together."""
    half1, reach = 0.5 * circuit.channel1_width, 0.5 * circuit.channel1_length
    alone, sides = circuit.shape != "circuit", ways(circuit)
    if alone:
        # room for the names of w and of the end wall
        axes.set_xlim(right=max(0.45 * circuit.urn_radius, 0.1 * circuit.channel1_length))
    axes.apply_aspect()  # or texts cannot be compared with lengths
    # Distances of names are shares of this: of the radius, unless that is small in the picture.
    unit = max(4.0 * _size(axes, "$w$")[1], *(float(side.urn_radius) for _, side in sides))
    above, below = half1 + 0.06 * unit, -half1 - 0.1 * unit
    for number, (way, side) in enumerate(sides, start=1):
        radius, centre = float(side.urn_radius), way * float(side.urn_centre)
        top = radius if side.outline is None else max(y for _, y in side.outline)
        name = f"urn {number}" + _name_radius(axes, circuit, number)
        _name(axes, circuit, (centre - way * radius, centre + way * radius), top + 0.06 * unit,
              name, 1)  # fmt: skip
    if alone or _size(axes, "gate 1")[0] < reach:
        for number, (way, _) in enumerate(sides, start=1):
            _name(axes, circuit, (0.0, way * reach), above, f"gate {number}", 1)
    else:
        _name(axes, circuit, (-reach, reach), above, "gates 1, 2", 1)
    halves = alone or _size(axes, r"$\ell/2$")[0] < reach
    for ends in [(0.0, way * reach) for way, _ in sides] if halves else [(-reach, reach)]:
        _measure(axes, ends, below)
        _name(axes, circuit, ends, below - 0.05 * unit, r"$\ell/2$" if halves else r"$\ell$", -1)
    for way, side in sides if circuit.channel2_width > 0.0 else ():
        ends = way * float(side.urn_centre + side.chords[1]), way * float(side.end)
        level = -0.5 * circuit.channel2_width - 0.1 * unit
        _measure(axes, ends, level)
        _name(axes, circuit, ends, level - 0.05 * unit, r"$\ell'/2$", -1)
    at = _name_width(axes, circuit, unit)
    if alone:
        look = {"ha": "left", "va": "center", "rotation": 90}
        axes.text(at + 0.04 * unit, 0.0, "end wall", **look)
    if circuit.channel2_width > 0.0:
        axes.text(sides[-1][1].end + 0.06 * unit, 0.0, "$w'$", va="center")


def _name_width(axes: Axes, circuit: Circuit, unit: float) -> float:
    """Name w, within gate 2 if it has room; where walls would cross the name, it is outside.

    Return where its name ends.
    """
    half1, reach = 0.5 * circuit.channel1_width, 0.5 * circuit.channel1_length
    (width, height), gap, level = _size(axes, "$w$"), 0.04 * unit, 0.1 * unit
    free, crossed = 0.0, False
    if circuit.shape == "circuit":
        free = reach - gap - width  # for the arrow, with its name within the gate
        crossed = 0.5 * height > circuit.channel1_width
        level = (0.8 if crossed else 0.6) * reach
        level = min(level, free) if free > 0.0 else level
    _measure(axes, (-half1, half1), level, vertical=True)
    if crossed and free > 0.0:
        _name(axes, circuit, (level - width, level + width), half1 + 0.06 * unit, "$w$", 1)
    else:
        level = reach if crossed else level
        axes.text(level + gap, 0.0, "$w$", ha="left", va="center")
    return level + gap + width


def _name_radius(axes: Axes, circuit: Circuit, number: int) -> str:
    """Write the name of the radius in the disc; of equal discs only in the last.

    Return "" or, where the disc has no room, what is added to the name of the urn.
    """
    sides = ways(circuit)
    alike = len({float(side.urn_radius) for _, side in sides}) == 1
    if circuit.outline is not None or (alike and number < len(sides)):
        return ""
    way, side = sides[number - 1]
    radius, last = float(side.urn_radius), way * float(side.urn_centre)
    name = "$r$" if alike else f"$r_{number}$"
    if radius < ROOM * max(_size(axes, name)):
        return f", {name}"
    angle = np.radians(130.0)
    tip = (last - radius * np.cos(angle), radius * np.sin(angle))
    arrow = {"arrowstyle": "->", "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, (last, 0.0), arrowprops=arrow)
    axes.text(last + 0.42 * radius, 0.36 * radius, name, ha="left")
    return ""

"""The table to scale with the particles of a snapshot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Circle, Rectangle

from postproc.figures import style
from postproc.reading.groups import snapshot_of
from postproc.reading.points import task_of
from postproc.theory import outlines

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.reading.groups import Snapshot
    from postproc.theory.circuit import Circuit

GATE_TINT = "#8080802E"
ROUNDING = 1e-9  # of a place on a wall
SLOWEST = 1e-12  # |ux| below this times l/r counts as 0 in a channel


def ways(circuit: Circuit) -> list[tuple[float, Circuit]]:
    """Return each side as (sign of x, circuit with both sides like it)."""
    sides = zip((-1.0, 1.0), circuit.sides, strict=True)
    return list(sides) if circuit.shape == "circuit" else [(-1.0, circuit)]


def walls(circuit: Circuit) -> list[NDArray[np.float64]]:
    """Return the walls as polylines of shape (vertex, 2): of urns, and of channels from them on."""
    half1, half2 = 0.5 * circuit.channel1_width, 0.5 * circuit.channel2_width
    lines = []
    if circuit.shape != "circuit":
        lines.append(np.array([[0.0, -half1], [0.0, half1]]))
    for way, side in ways(circuit):
        outline = side.outline or _arcs(side, half1, half2)
        first = outlines.opening_side(outline, 1.0)
        corner = np.roll(outline, -first - 1, axis=0)
        corner -= [corner[0, 0] + 0.5 * float(side.channel1_length), 0.0]
        begins, far = float(corner[0, 0]), float(-side.urn_centre - side.chords[1])
        last = np.array([[begins, -half1], [0.0, -half1]])
        line = [np.array([[0.0, half1], [begins, half1]])]
        if half2 > 0.0:
            second = outlines.opening_side(outline, -1.0)
            cut = (second - first - 1) % len(corner) + 1
            end = -float(side.end)
            line += [corner[:cut], np.array([[far, half2], [end, half2]])]
            lines.append(np.vstack(line) * [-way, 1.0])
            line, corner = [np.array([[end, -half2], [far, -half2]])], corner[cut:]
        lines.append(np.vstack([*line, corner, last]) * [-way, 1.0])
    return lines


def _arcs(side: Circuit, half1: float, half2: float) -> outlines.Outline:
    """Return the arcs of a disc between its openings as an outline."""
    start, stop = (math.asin(half / side.urn_radius) for half in (half1, half2))
    angle = np.linspace(start, math.pi - stop, 400)
    around = np.append(angle, -angle[::-1])
    return tuple(
        zip(side.urn_radius * np.cos(around), side.urn_radius * np.sin(around), strict=True)
    )


def counted_by(circuit: Circuit, snapshot: Snapshot) -> NDArray[np.int_]:
    """Return the gate that counts each particle: in it, moving to the other; 0 for none.

    Who moves across the channel, up to rounding, never gets through and is not counted.
    """
    counted = np.abs(snapshot.x) <= 0.5 * circuit.channel1_length
    if circuit.outline is not None:  # an urn may reach over the channel
        counted &= np.abs(snapshot.y) <= 0.5 * circuit.channel1_width * (1.0 + ROUNDING)
    counted &= np.abs(snapshot.ux) > SLOWEST * circuit.channel1_length / circuit.urn_radius
    left = snapshot.x < 0.0
    counted &= np.where(left, snapshot.ux > 0.0, snapshot.ux < 0.0)
    return np.where(counted, np.where(left, 1, 2), 0)


def next_gate(circuit: Circuit, snapshot: Snapshot) -> int:
    """Return the gate whose count is nearer to exceeding its T; 0: both are empty."""
    gate = counted_by(circuit, snapshot)
    first, second = np.count_nonzero(gate == 1), np.count_nonzero(gate == 2)
    if first == second == 0:
        return 0
    one, two = circuit.sides
    return 1 if one.threshold - first <= two.threshold - second else 2


def draw_table(axes: Axes, circuit: Circuit) -> None:
    """Draw walls, shaded gates, the middle line and the periodic lines."""
    half1 = 0.5 * circuit.channel1_width
    reach = 0.5 * circuit.channel1_length
    for way, _ in ways(circuit):
        left = -reach if way < 0 else 0.0
        axes.add_patch(Rectangle((left, -half1), reach, 2 * half1, fc=GATE_TINT, lw=0, zorder=0))
        axes.plot([way * reach] * 2, [-half1, half1], color=style.GREY, lw=0.7, ls=":", zorder=1)
    for wall in walls(circuit):
        axes.plot(*wall.T, color=style.ink(), lw=1.0, solid_joinstyle="miter", zorder=2)
    if circuit.shape == "circuit":
        axes.plot([0, 0], [-half1, half1], color=style.ink(), lw=0.8, ls="--", zorder=1)
        if circuit.channel2_width > 0.0:
            for way, side in ways(circuit):
                high = max(0.5 * circuit.channel2_width, 0.06 * side.urn_radius)
                end = way * side.end
                axes.plot([end, end], [-high, high], color=style.ink(), lw=0.8, ls="--")
    draw_scatterers(axes, circuit)
    axes.set_aspect("equal")
    axes.set_axis_off()


def draw_scatterers(axes: Axes, circuit: Circuit) -> None:
    """Draw the discs in channel 2, clipped at its walls; one on the periodic line at both ends."""
    half, length = 0.5 * float(circuit.channel2_width), 0.5 * float(circuit.channel2_length)
    for way, side in ways(circuit):
        # Urn 1 and its half, z > 0, lie at x < 0.
        line = way * float(side.end)
        corner = min(line, line - way * length), -half
        channel = Rectangle(corner, length, 2.0 * half, transform=axes.transData)
        for z, y, radius in circuit.scatterers:
            if radius - way * z > 0.0:
                disc = Circle((line + z, y), radius, fc=style.GREY, ec=style.ink(), lw=0.6)
                axes.add_patch(disc).set_clip_path(channel)
                disc.set_in_layout(False)  # the layout would ignore its clip path


def _kinds(circuit: Circuit, snapshot: Snapshot) -> list[tuple[NDArray[np.bool_], str, str, bool]]:
    """Return which particles are of a kind, its colour and name, and whether a gate counts them."""
    gate, left = counted_by(circuit, snapshot), snapshot.x < 0.0
    free, nearer = gate == 0, (gate > 0) & (gate == next_gate(circuit, snapshot))
    if circuit.shape != "circuit":
        return [
            (free, style.SKY, "not counted", False),
            (~free, style.ORANGE, "counted by the gate", True),
        ]
    return [
        (free & left, style.SKY, "half 1", False),
        (free & ~left, style.GREEN, "half 2", False),
        (~free & ~nearer, style.ORANGE, "counted by a gate", True),
        (nearer, style.VERMILION, "counted by the gate closer to $T$", True),
    ]


def draw_particles(
    axes: Axes, circuit: Circuit, snapshot: Snapshot, size: float = 3.0, counted_size: float = 27.0
) -> list[PathCollection]:
    """Draw the particles as dots, the counted ones larger and ringed; sizes are of their area.

    Return a collection for each kind of particles, with its label.
    """
    return [
        axes.scatter(
            snapshot.x[which], snapshot.y[which], s=counted_size if counted else size, c=colour,
            label=label, ec=style.ink() if counted else "none", lw=0.4, zorder=3 + counted,
        )
        for which, colour, label, counted in _kinds(circuit, snapshot)
    ]  # fmt: skip


def explain(axes: Axes) -> None:
    """Name the colours of particles below the table."""
    style.legend_below(axes, 4, handletextpad=0.2, fontsize=7, frameon=False)


def _draw_channel(axes: Axes, circuit: Circuit, snapshot: Snapshot) -> None:
    """Draw channel 1 enlarged, with the velocities as arrows."""
    draw_table(axes, circuit)
    draw_particles(axes, circuit, snapshot, 9.0, 45.0)
    reach, half1 = 0.5 * circuit.channel1_length, 0.5 * circuit.channel1_width
    near = (np.abs(snapshot.x) <= 1.25 * reach) & (np.abs(snapshot.y) <= 1.5 * half1)
    for which, colour, _, _ in _kinds(circuit, snapshot):
        axes.quiver(
            *(one[near & which] for one in (snapshot.x, snapshot.y, snapshot.ux, snapshot.uy)),
            color=colour,
            angles="xy",
            scale_units="xy",
            scale=1.0 / (0.07 * circuit.channel1_length),
            width=0.0022,
            zorder=3,
        )
    axes.set_xlim(-1.25 * reach, (1.25 if circuit.shape == "circuit" else 0.05) * reach)
    axes.set_ylim(-1.6 * half1, 1.6 * half1)


def figure_scene(points: xr.Dataset, snapshot: int = -1) -> Figure:
    """Return a snapshot of the first complete task: the whole table, and channel 1 enlarged."""
    task = task_of(points, None, None)
    return picture_of(points["circuit"].values[task[0]], snapshot_of(points, *task, snapshot))


@style.settings()
def picture_of(circuit: Circuit, snapshot: Snapshot) -> Figure:
    """Return the picture of a snapshot of a circuit."""
    made = style.figure(style.PAGE, 4.6)
    whole, channel = made.subplots(2, 1, height_ratios=(1.35, 1.0))
    draw_table(whole, circuit)
    draw_particles(whole, circuit, snapshot)
    in_first = int(np.count_nonzero(snapshot.x < 0.0))
    total = snapshot.x.size
    spread = abs(total - 2 * in_first) / total
    title = f"$t = {style.in_math(snapshot.time, 6)}$    $N = {total}$"
    if circuit.shape == "circuit":
        title += f"    $N_1 = {in_first}$    $N_2 = {total - in_first}$    $\\chi = {spread:.3f}$"
    whole.set_title(title, loc="center")
    _draw_channel(channel, circuit, snapshot)
    look = {"ncols": 4, "handletextpad": 0.2}
    made.legend(*whole.get_legend_handles_labels(), loc="outside lower center", **look)
    _name_gates(channel, circuit, counted_by(circuit, snapshot))
    return made


def _name_gates(axes: Axes, circuit: Circuit, counted: NDArray[np.int_]) -> None:
    """Write above the enlarged channel what each gate counts, in two lines if it is short."""
    texts = [f"gate {gate}: {np.count_nonzero(counted == gate)} counted, $T = {side.threshold}$"
             for gate, (_, side) in enumerate(ways(circuit), start=1)]  # fmt: skip
    titles = [axes.set_title(text, loc=place, fontsize=8)
              for text, place in zip(texts, ("left", "right"), strict=False)]  # fmt: skip
    with style.measured(axes.figure) as made:
        made.draw_without_rendering()
        boxes = [one.get_window_extent() for one in titles]
    if boxes[0].x1 + 0.5 * boxes[0].height > boxes[-1].x0 and len(boxes) > 1:
        for one in titles:
            one.set_text("")
        axes.set_title("\n".join(texts), loc="center", fontsize=8)

"""Draws the table to scale with the particles of a snapshot.

Fig. model of PRE 103, 032119 (2021) with what the run had in it. A gate counts the particles inside
it that head for the other gate; when an entrant makes the count exceed T, all those turn back. So a
particle is marked as *counted* if it is in a gate and heads for the other gate, and as *next to be
turned back* if moreover its gate is the one whose count is nearer to exceeding T.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Rectangle

from postproc import cli, style
from postproc.results import Results

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.results import Snapshot

GATE_TINT = "#E8E8E8"


@dataclass(frozen=True)
class Table:
    """The table: origin in the middle of channel 1, urn 1 at x < 0; lengths as in `Circuit`."""

    urn_radius: float = 1.0
    channel1_width: float = 0.3
    channel1_length: float = 1.0
    channel2_width: float = 0.01
    channel2_length: float = 1.0
    shape: str = "circuit"

    @property
    def chords(self) -> tuple[float, float]:
        """Distances of the chords of channels 1 and 2 from the centre of an urn."""
        second = self.channel2_width if self.shape == "circuit" else 0.0
        one, two = (
            float(np.sqrt(self.urn_radius**2 - 0.25 * width**2))
            for width in (self.channel1_width, second)
        )
        return one, two

    @property
    def urn_centre(self) -> float:
        """Distance of the centres of the urns from the middle of channel 1."""
        return 0.5 * self.channel1_length + self.chords[0]

    @property
    def end(self) -> float:
        """Distance of the periodic line (or of the far wall) from the middle of channel 1."""
        if self.shape != "circuit" or self.channel2_width == 0.0:
            return self.urn_centre + self.urn_radius
        return self.urn_centre + self.chords[1] + 0.5 * self.channel2_length

    def walls(self) -> list[NDArray[np.float64]]:
        """Return the walls as polylines of shape (vertex, 2)."""
        half1, half2 = 0.5 * self.channel1_width, 0.5 * self.channel2_width
        closed = self.shape != "circuit" or self.channel2_width == 0.0
        start = np.arcsin(half1 / self.urn_radius)
        stop = np.pi - (0.0 if closed else np.arcsin(half2 / self.urn_radius))
        angle = np.linspace(start, stop, 400)
        arc_x = -self.urn_centre + self.urn_radius * np.cos(angle)
        arc_y = self.urn_radius * np.sin(angle)
        upper = [np.append(0.0, arc_x), np.append(half1, arc_y)]
        if not closed:
            upper = [np.append(upper[0], -self.end), np.append(upper[1], half2)]
        quarter = np.column_stack(upper)
        sides = (1.0, -1.0) if self.shape == "circuit" else (1.0,)
        lines = [quarter * (side, flip) for side in sides for flip in (1.0, -1.0)]
        if self.shape != "circuit":
            lines.append(np.array([[0.0, -half1], [0.0, half1]]))
        return lines


def table_of(results: Results, point: int) -> Table:
    """Return the table of a parameter point."""
    circuit = results.circuit(point)
    return Table(
        circuit.urn_radius,
        circuit.channel1_width,
        circuit.channel1_length,
        circuit.channel2_width,
        circuit.channel2_length,
        results.shape,
    )


def gate_of(table: Table, x: NDArray[np.float64]) -> NDArray[np.int_]:
    """Return in which gate each particle is: 1, 2, or 0 for none; shape (particle,)."""
    inside = np.abs(x) <= 0.5 * table.channel1_length
    return np.where(inside, np.where(x < 0.0, 1, 2), 0)


def counted_by(table: Table, snapshot: Snapshot) -> NDArray[np.int_]:
    """Return which gate counts each particle: in it and heading for the other; 0 for none."""
    gate = gate_of(table, snapshot.x)
    heads = np.where(gate == 1, snapshot.ux > 0.0, snapshot.ux < 0.0)
    return np.where(heads, gate, 0)


def next_gate(table: Table, snapshot: Snapshot) -> int:
    """Return the gate whose count is nearer to exceeding T (the fuller one); 0: both are empty."""
    gate = counted_by(table, snapshot)
    first, second = np.count_nonzero(gate == 1), np.count_nonzero(gate == 2)
    if first == second == 0:
        return 0
    return 1 if first >= second else 2


def draw_table(axes: Axes, table: Table) -> None:
    """Draw walls, shaded gates, the middle line and the periodic lines."""
    half1 = 0.5 * table.channel1_width
    reach = 0.5 * table.channel1_length
    sides = (-1.0, 1.0) if table.shape == "circuit" else (-1.0,)
    for side in sides:
        left = -reach if side < 0 else 0.0
        axes.add_patch(Rectangle((left, -half1), reach, 2 * half1, fc=GATE_TINT, lw=0, zorder=0))
        axes.plot([side * reach] * 2, [-half1, half1], color=style.GREY, lw=0.7, ls=":", zorder=1)
    for wall in table.walls():
        axes.plot(*wall.T, color=style.BLACK, lw=1.0, solid_joinstyle="miter", zorder=2)
    if table.shape == "circuit":
        axes.plot([0, 0], [-half1, half1], color=style.BLACK, lw=0.8, ls="--", zorder=1)
        if table.channel2_width > 0.0:
            high = max(0.5 * table.channel2_width, 0.06 * table.urn_radius)
            for side in sides:
                axes.plot([side * table.end] * 2, [-high, high], color=style.BLACK, lw=0.8, ls="--")
    axes.set_aspect("equal")
    axes.set_axis_off()


def _colours(table: Table, snapshot: Snapshot) -> tuple[NDArray[np.str_], NDArray[np.bool_]]:
    """Return the colour of each particle, and whether it is counted by a gate."""
    counted = counted_by(table, snapshot)
    next_one = next_gate(table, snapshot)
    colour = np.where(snapshot.x < 0.0, style.SKY, style.GREEN)
    colour = np.where(counted > 0, style.ORANGE, colour)
    return np.where((counted > 0) & (counted == next_one), style.VERMILION, colour), counted > 0


def draw_particles(axes: Axes, table: Table, snapshot: Snapshot, size: float = 3.0) -> None:
    """Draw the particles as dots, the counted ones larger and ringed."""
    colour, counted = _colours(table, snapshot)
    x, y = snapshot.x, snapshot.y
    axes.scatter(x[~counted], y[~counted], s=size, c=colour[~counted], lw=0, zorder=3)
    axes.scatter(
        x[counted], y[counted], s=4 * size, c=colour[counted], ec=style.BLACK, lw=0.4, zorder=4
    )


def _draw_channel(axes: Axes, table: Table, snapshot: Snapshot) -> None:
    """Draw channel 1 enlarged, with the velocities as arrows."""
    draw_table(axes, table)
    draw_particles(axes, table, snapshot, size=9.0)
    colour, _ = _colours(table, snapshot)
    reach, half1 = 0.5 * table.channel1_length, 0.5 * table.channel1_width
    near = (np.abs(snapshot.x) <= 1.25 * reach) & (np.abs(snapshot.y) <= 1.5 * half1)
    axes.quiver(
        snapshot.x[near],
        snapshot.y[near],
        snapshot.ux[near],
        snapshot.uy[near],
        color=colour[near],
        angles="xy",
        scale_units="xy",
        scale=1.0 / (0.07 * table.channel1_length),
        width=0.0022,
        zorder=3,
    )
    axes.set_xlim(-1.25 * reach, (1.25 if table.shape == "circuit" else 0.05) * reach)
    axes.set_ylim(-1.6 * half1, 1.6 * half1)


def _count_text(table: Table, snapshot: Snapshot, threshold: int) -> list[str]:
    counted = counted_by(table, snapshot)
    gates = (1, 2) if table.shape == "circuit" else (1,)
    return [
        f"gate {gate}: {np.count_nonzero(counted == gate)} counted, $T = {threshold}$"
        for gate in gates
    ]


def _legend(made: Figure, table: Table) -> None:
    looks = [(style.SKY, "half 1", False)]
    if table.shape == "circuit":
        looks.append((style.GREEN, "half 2", False))
    looks += [
        (style.ORANGE, "counted: heads for the other gate", True),
        (style.VERMILION, "counted, in the gate nearer to a reversal", True),
    ]
    handles = [
        made.axes[0].scatter([], [], s=22 if ring else 10, c=colour, label=label)
        for colour, label, ring in looks
    ]
    for handle, (_, _, ring) in zip(handles, looks, strict=True):
        handle.set_edgecolor(style.BLACK if ring else "none")
        handle.set_linewidth(0.4)
    made.legend(handles=handles, loc="outside lower center", ncols=4, handletextpad=0.2)


def figure_scene(table: Table, snapshot: Snapshot, threshold: int) -> Figure:
    """Return the picture of a snapshot: the whole table, and channel 1 enlarged."""
    made = style.figure(style.PAGE, 4.6)
    whole, channel = made.subplots(2, 1, height_ratios=(1.35, 1.0))
    draw_table(whole, table)
    draw_particles(whole, table, snapshot)
    in_first = int(np.count_nonzero(snapshot.x < 0.0))
    total = snapshot.x.size
    spread = abs(total - 2 * in_first) / total
    title = f"$t = {snapshot.time:g}$    $N = {total}$"
    if table.shape == "circuit":
        title += f"    $N_1 = {in_first}$    $N_2 = {total - in_first}$    $\\chi = {spread:.3f}$"
    whole.set_title(title, loc="center")
    _draw_channel(channel, table, snapshot)
    texts = _count_text(table, snapshot, threshold)
    for text, where in zip(texts, ("left", "right"), strict=False):
        channel.set_title(text, loc=where, fontsize=8)
    _legend(made, table)
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Write scene.png and scene.pdf."""
    options = cli.parser("scene", __doc__)
    options.add_argument("file", metavar="FILE.h5", type=Path)
    options.add_argument(
        "--point", type=int, help="parameter point, from 1 (default: the first done)"
    )
    options.add_argument("--replica", type=int, help="replica, from 1 (default: the first done)")
    options.add_argument("--snapshot", type=int, help="which snapshot, from 1 (default: the last)")
    cli.add_output(options)
    given = options.parse_args(arguments)
    with Results(given.file) as results:
        index = -1 if given.snapshot is None else given.snapshot - 1
        if given.snapshot is not None and given.snapshot < 1:
            raise cli.InputError(f"--snapshot {given.snapshot} must be at least 1")
        point, replica = results.task(given.point, given.replica)
        snapshot = results.snapshot(point, replica, index)
        table, threshold = table_of(results, point), int(results.circuit(point).threshold)
        made = figure_scene(table, snapshot, threshold)
        style.note(made.axes[0], results.remark)
        results.say_if_partial()
    style.save(made, given.output, "scene")
    return 0


if __name__ == "__main__":
    sys.exit(cli.run(main))

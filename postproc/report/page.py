"""One self-contained HTML page about a run."""

from __future__ import annotations

import base64
import html
import io
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex

from postproc import cli
from postproc.figures import maps
from postproc.figures.currents import figure_currents
from postproc.figures.scene import figure_scene
from postproc.reading.points import gather
from postproc.reading.results import Results
from postproc.report.warn import explanations, warnings
from postproc.theory.circuit import homogeneous_kind, single_urn_current
from postproc.theory.gates import WINDOW
from postproc.theory.renewal import RENEWAL
from postproc.theory.states import stable_state

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.reading.points import Points
    from postproc.theory.gates import Gate

    Floats = NDArray[np.float64]

PICTURES = 6  # most points of which pictures are put on the page
WARNINGS = 12  # that are shown at once
CELLS = (18, 44)  # least and greatest size of the map's cells, CSS pixels
BROAD = 430  # width that a map should have if its cells may, CSS pixels
BAR = (20, 100)  # steps of the bar of colours beside a map, and its height in CSS pixels
HERE = Path(__file__).parent


def embedded(made: Figure, text: str) -> str:
    """Return a figure as an HTML image that carries its own data."""
    buffer = io.BytesIO()
    made.savefig(buffer, dpi=130, metadata={"Software": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="{html.escape(text)}" src="data:image/png;base64,{data}">'


def _rows(cells: Sequence[Sequence[str]], head: Sequence[str]) -> str:
    top = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in cells
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _run_section(results: Results) -> str:
    known = results.attributes
    kept = ("version", "git_commit", "created", "status", "mpi_ranks", "mpi_library", "compiler")
    cells = [(name.replace("_", " "), known[name]) for name in kept if name in known]
    done = results.done
    cells.append(("tasks", f"{np.count_nonzero(done)} of {done.size} complete"))
    collisions = np.nansum(np.where(done, results.value("collisions"), 0.0))
    seconds = np.nansum(np.where(done, results.value("cpu_seconds"), 0.0))
    cells.append(("wall collisions", f"{collisions:.4g}"))
    cells.append(("processor time", f"{seconds:.4g} s"))
    if seconds > 0.0:
        cells.append(("speed", f"{collisions / seconds:.3g} collisions a second, one core"))
    namelist = html.escape(known.get("namelist", ""))
    return (
        _rows(cells, ("", ""))
        + f"<details><summary>Namelist</summary><pre>{namelist}</pre></details>"
    )


def _listed(found: Sequence[str]) -> str:
    if not found:
        return '<p class="good">None.</p>'
    items = [f"<li>{html.escape(text)}</li>" for text in found]
    shown = f"<ul>{''.join(items[:WARNINGS])}</ul>"
    if len(items) > WARNINGS:
        summary = f"<summary>{len(items) - WARNINGS} more</summary>"
        shown += f"<details>{summary}<ul>{''.join(items[WARNINGS:])}</ul></details>"
    return shown


def _pair(mean: float, error: float) -> str:
    return "-" if not np.isfinite(mean) else f"{mean:.4g} ± {error:.1g}"


def _table_section(results: Results, points: Points) -> str:
    head = ("T", "w'", "w", "N", "start chi", "chi", "net current")
    head += ("paper's chi", "current", "renewal gate's chi", "current")
    cells = []
    for at in range(points.number.size):
        expected = [
            text
            for gate in (WINDOW, RENEWAL)
            for text in _expected(results, at, points.chi[at], gate)
        ]
        cells.append(
            (
                f"{points.threshold[at]:.0f}",
                f"{points.channel2_width[at]:.4g}",
                f"{points.channel1_width[at]:.4g}",
                f"{points.number[at]:.0f}",
                f"{points.start[at]:.3g}",
                _pair(points.chi[at], points.chi_error[at]),
                _pair(points.current[at], points.current_error[at]),
                *expected,
            )
        )
    return _rows(cells, head)


def _expected(results: Results, point: int, chi: float, gate: Gate) -> tuple[str, str]:
    """Return chi and net current of a theory's stable state nearer to the measured chi."""
    circuit = results.circuit(point, gate)
    if results.shape != "circuit":
        current = single_urn_current(circuit)
        return "-", f"{float(current):.4g}"
    state = stable_state(circuit)
    homogeneous = homogeneous_kind(circuit) != "unstable"
    if state is None or (homogeneous and not chi > 0.5 * state.mass_spread):
        return "0", "0"
    return f"{state.mass_spread:.4g}", f"{state.net_current:.4g}"


def svg_map(points: Points, values: Floats, errors: Floats, name: str, colours: str) -> str:
    """Return a map over T and w' as SVG; cells carry their text for the mouse in `data-text`."""
    thresholds, widths, filled = maps.grid(points, values)
    _, _, spread = maps.grid(points, errors)
    top = np.nanmax(filled) if np.isfinite(filled).any() else 1.0
    most = max(float(top), 1.0 if name == "chi" else 1e-12)
    cell = int(np.clip(BROAD // thresholds.size, *CELLS))
    left, bottom = 64, 40
    width, height = left + cell * thresholds.size + 84, max(cell * widths.size, 110) + bottom + 8
    parts = [f'<svg width="{width}" height="{height}" role="img" aria-label="map of {name}">']
    for row, column in np.ndindex(filled.shape):
        value, x = filled[row, column], left + cell * column
        y = 4 + cell * (widths.size - 1 - row)
        colour = to_hex(mpl.colormaps[colours](value / most)) if np.isfinite(value) else "#d0d0d0"
        text = (
            f"T = {thresholds[column]:.0f}, w' = {widths[row]:.4g}: {name} "
            f"{_pair(value, spread[row, column])}"
        )
        parts.append(
            f'<rect x="{x}" y="{y}" width="{cell}" height="{cell}" fill="{colour}" '
            f'data-text="{html.escape(text)}"/>'
        )
    base = 4 + cell * widths.size
    every = max(1, -(-thresholds.size // 12))
    for column in range(0, thresholds.size, every):
        x = left + cell * (column + 0.5)
        parts.append(f'<text x="{x}" y="{base + 15}" class="mid">{thresholds[column]:.0f}</text>')
    every = max(1, -(-widths.size // 16))
    for row in range(0, widths.size, every):
        y = 8 + cell * (widths.size - 0.5 - row)
        parts.append(f'<text x="{left - 5}" y="{y}" class="end">{widths[row]:.3g}</text>')
    middle = left + 0.5 * cell * thresholds.size
    parts.append(f'<text x="{middle}" y="{base + 33}" class="mid">T</text>')
    parts.append(f'<text x="4" y="{4 + 0.5 * cell * widths.size}">w\'</text>')
    parts.append(_colour_bar(left + cell * thresholds.size + 18, most, colours))
    return "".join(parts) + "</svg>"


def _colour_bar(x: float, most: float, colours: str) -> str:
    """Return the bar beside a map, from 0 at the bottom to `most` at the top."""
    steps, height = BAR
    step = height / steps
    parts = [
        f'<rect x="{x}" y="{4 + step * (steps - 1 - at):.2f}" width="12" height="{step + 0.5}" '
        f'fill="{to_hex(mpl.colormaps[colours]((at + 0.5) / steps))}"/>'
        for at in range(steps)
    ]
    for share in (0.0, 0.5, 1.0):
        y = 8 + height * (1.0 - share)
        parts.append(f'<text x="{x + 16}" y="{y}">{share * most:.3g}</text>')
    return "".join(parts)


def _captioned(picture: str, caption: str) -> str:
    return f"<figure>{picture}<figcaption>{caption}</figcaption></figure>"


def _map_section(points: Points) -> str:
    sections = []
    for name, part in maps.by_start(points):
        for number in np.unique(part.number):
            for width in np.unique(part.channel1_width):
                chosen = part.where((part.number == number) & (part.channel1_width == width))
                if chosen.number.size == 0:
                    continue
                start = name.replace("$", "").replace(r"\chi", "chi")
                title = f"N = {number:.0f}, w = {width:g}"
                if np.isfinite(chosen.chi).any():
                    title += f", {start}"
                sections.append(f'<h3>{html.escape(title)}</h3><div class="maps">')
                if np.isfinite(chosen.chi).any():
                    chi = svg_map(chosen, chosen.chi, chosen.chi_error, "chi", "viridis")
                    sections.append(_captioned(chi, "mass spread chi"))
                current = svg_map(
                    chosen, chosen.current, chosen.current_error, "net current", "magma"
                )
                sections.append(_captioned(current, "net current, per unit time") + "</div>")
    return "".join(sections)


def _pictures(results: Results) -> str:
    parts = []
    for point in np.flatnonzero(results.done.any(axis=1))[:PICTURES]:
        replica = int(np.flatnonzero(results.done[point])[0])
        for draw in (_picture_currents, _picture_scene):
            try:
                made = draw(results, int(point), replica)
            except cli.InputError:
                continue  # that run kept no series, or no snapshots
            parts.append(f"<figure>{embedded(made, 'picture of a point')}</figure>")
    return "".join(parts) or "<p>The run kept neither series nor snapshots.</p>"


def _picture_currents(results: Results, point: int, replica: int) -> Figure:
    return figure_currents(results, point, replica)


def _picture_scene(results: Results, point: int, replica: int) -> Figure:
    return figure_scene(results.circuit(point), results.snapshot(point, replica, -1))


def page(results: Results) -> str:
    """Return the whole page."""
    results.need_tasks()
    points = gather([results])
    found, explained = warnings(results), explanations(results)
    sections = {
        "What was run": _run_section(results),
        f"Warnings ({len(found)})": _listed(found),
        **({"What looks strange, and is not": _listed(explained)} if explained else {}),
        "Map": '<p id="reading">Put the mouse on a cell of a map.</p>' + _map_section(points),
        "Pictures": _pictures(results),
        "Averages": _table_section(results, points),
    }
    body = "".join(f"<section><h2>{title}</h2>{text}</section>" for title, text in sections.items())
    template = (HERE / "page.html").read_text()
    name = html.escape(results.path.name)
    return template.replace("@TITLE@", name).replace("@BODY@", body)

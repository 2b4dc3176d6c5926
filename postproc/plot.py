"""Figures as functions: each draws results into axes, and returns what matplotlib's own return.

`data` is a dataset of `open_results` or `merge`, or a part of one, such as
`data.sel(channel2_width=0.02)`; `ax` are axes to draw into, None: the current ones of pyplot.
Points that a figure has no place for are refused. `theory` names theories: "window" (the paper's),
"renewal" or "direction".
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from postproc.figures import circuits, currents, maps, passages, theories
from postproc.figures import scene as scenes
from postproc.reading.points import Points

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection, QuadMesh
    from matplotlib.container import ErrorbarContainer
    from matplotlib.lines import Line2D

    from postproc.theory.model import Model

__all__ = ["characteristic", "curves", "flows", "lifetimes", "phase_diagram", "relaxation", "scene"]


def phase_diagram(
    data: xr.Dataset, ax: Axes | None = None, *, variable: str = "chi",
    theory: str | Sequence[str] = (), **look: object,
) -> QuadMesh:  # fmt: skip
    """Draw a map of means over replicas, over T/N and w' with transition lines, or over other keys.

    Parameters
    ----------
    data, ax
        As above.
    variable
        What is shown, such as "chi" or "polarised_current".
    theory
        Whose lines are drawn, over T/N and w'; `Circuit.transition_line` has them as arrays.
    look
        Given to `Axes.pcolormesh`, such as `cmap` or `vmax`.

    Returns
    -------
    matplotlib.collections.QuadMesh
        For a colour bar.
    """
    points = Points(data)
    points.need_only(*maps.map_axes(points))
    axes = _axes(ax)
    values, _, own = maps.values_of(points, variable)
    mesh = maps.draw_map(axes, points, values, own | look)
    maps.draw_lines(axes, *maps.of_theory(points, _theories(points, theory)))
    return mesh


def curves(
    data: xr.Dataset, ax: Axes | None = None, *, variable: str = "polarised_current",
    against: str = "", theory: str | Sequence[str] = (),
) -> list[ErrorbarContainer]:  # fmt: skip
    """Draw means over replicas with errors against the key that was scanned, theories as lines.

    Of two keys one is along the axis (T or N, if scanned), the other has a mark for each value.

    Parameters
    ----------
    data, ax, theory
        As above.
    variable
        What is drawn, such as "chi" or "polarised_current".
    against
        Another variable along the axis, such as "chi"; "": the key.
    """
    points = Points(data)
    drawn = _theories(points, theory)
    return circuits.draw_curves(_axes(ax), points, drawn, variable, against)


def relaxation(
    data: xr.Dataset, ax: Axes | None = None, *, variable: str = "chi",
    theory: str | Sequence[str] = (),
) -> list[Line2D]:  # fmt: skip
    """Draw chi, or "polarised_current", against time: mean and standard deviation over the replicas.

    A colour for each point; theories' stable states as lines. The runs need a series.
    """
    points = circuits.with_tasks(Points(data))
    return circuits.draw_relaxation(_axes(ax), points, _theories(points, theory), variable)


def flows(
    data: xr.Dataset, ax: Axes | None = None, *, replica: int = 0,
    theory: str | Sequence[str] = (),
) -> list[ErrorbarContainer]:  # fmt: skip
    """Draw the four flows and both net currents of one point against time, from a series."""
    points = Points(data)
    points.need_only()
    circuit, series = points.any_circuit(0), points.series(0, replica)
    drawn = _theories(points, theory)
    return currents.draw_flows(_axes(ax), circuit, series, drawn, points.number2_at_start(0))


def scene(
    data: xr.Dataset, ax: Axes | None = None, *, replica: int = 0, snapshot: int = -1
) -> list[PathCollection]:
    """Draw the table of one point to scale with the particles of a snapshot, by default the last.

    Particles that a gate counts are larger; `ax.legend()` names the colours.
    """
    points = Points(data)
    points.need_only()
    axes, circuit = _axes(ax), points.any_circuit(0)
    scenes.draw_table(axes, circuit)
    return scenes.draw_particles(axes, circuit, points.snapshot(0, replica, snapshot))


def lifetimes(
    data: xr.Dataset, ax: Axes | None = None, *, theory: str | Sequence[str] = ()
) -> list[ErrorbarContainer]:
    """Draw how long the homogeneous and the polarised state last, against N, from series.

    Marks are measured, by first passages of the replicas; lines are those of a theory's chain.
    """
    points = Points(data)
    return passages.draw_lifetimes(_axes(ax), passages.measured(points), _theories(points, theory))


def characteristic(
    data: xr.Dataset, ax: Axes | None = None, *, theory: str | Sequence[str] = ()
) -> list[Line2D]:
    """Draw U = ln(n2/n1) against the net current J over a scan, as of w', and the power J U.

    n1 and n2 are the densities in the urns. The open circuit is where J = 0; beyond the largest
    power the battery collapses at the transition.
    """
    points = Points(data)
    return circuits.draw_characteristic(_axes(ax), points, _theories(points, theory))


def _axes(ax: Axes | None) -> Axes:
    """Return the axes to draw into."""
    from matplotlib import pyplot as plt  # noqa: PLC0415 (not every user has a display)

    return ax or plt.gca()


def _theories(points: Points, theory: str | Sequence[str]) -> tuple[Model, ...]:
    """Return theories by their names; raise `InputError` if one does not apply."""
    return theories.asked(points, [theory] if isinstance(theory, str) else theory)

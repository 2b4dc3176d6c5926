"""Figures as functions: each draws results into axes, and returns what matplotlib's own return.

`data` is a dataset of `open_results` or `merge`, or a part of one, such as
`data.sel(channel2_width=0.02)`; `ax` are axes to draw into, None: the current ones of pyplot.
Points that a figure has no place for are refused. `theory` names theories: "window" (the paper's),
"renewal" or "direction".
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from postproc.figures import circuits, currents, maps, passages
from postproc.figures import scene as scenes
from postproc.figures.theories import asked
from postproc.reading.groups import series_of, snapshot_of
from postproc.reading.points import by_point, groups, need_only, task_of, with_tasks

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection, QuadMesh
    from matplotlib.container import ErrorbarContainer
    from matplotlib.lines import Line2D

__all__ = ["characteristic", "curves", "flows", "lifetimes", "phase_diagram", "relaxation", "scene"]


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__


def phase_diagram(
    data: xr.Dataset, ax: Axes | None = None, *, variable: str = "chi",
    theory: str | Sequence[str] = (), **look: object,
) -> QuadMesh:  # fmt: skip
    """Draw a map of means over replicas, over T/N and w' with transition lines, or over other keys.

    Parameters
    ----------
    data
        Results of `open_results` or `merge`, or a part of them, with two keys that were scanned.
    ax
        Axes to draw into; None: the current ones of pyplot.
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

    Examples
    --------
    >>> import postproc
    >>> data = postproc.open_results("map.h5")
    >>> mesh = phase_diagram(data, theory="window", cmap="magma")
    >>> mesh.get_array().shape
    (2, 2)
    """
    points = with_tasks(by_point(data))
    values, _, own = maps.values_of(points, variable)
    keys = maps.map_axes(points)
    need_only(points, *keys)
    lines, marks = maps.of_theory(points, keys, asked(points, theory))
    axes = _axes(ax)
    if look.get("norm") is not None:  # which has bounds of its own
        own = {name: value for name, value in own.items() if name not in ("vmin", "vmax")}
    mesh = maps.draw_map(axes, points, keys, maps.map_of(points, keys, values), own | look)
    maps.draw_lines(axes, lines, marks)
    return mesh


def curves(
    data: xr.Dataset, ax: Axes | None = None, *, variable: str = "polarised_current",
    against: str = "", theory: str | Sequence[str] = (),
) -> list[ErrorbarContainer]:  # fmt: skip
    """Draw means over replicas with errors against the key that was scanned, and theories.

    Of two keys one is along the axis (T or N, if scanned), the other has a mark for each value.

    Parameters
    ----------
    data
        Results of `open_results` or `merge`, or a part of them, with at most two keys that were
        scanned.
    ax
        Axes to draw into; None: the current ones of pyplot.
    variable
        What is drawn, such as "chi" or "polarised_current".
    against
        Another variable along the axis, such as "chi"; "": the key.
    theory
        One or several names. A theory has the state that it reaches from the start of the runs.

    Returns
    -------
    list of matplotlib.container.ErrorbarContainer
        One for each value of the second key.

    Examples
    --------
    >>> import postproc
    >>> drawn = curves(postproc.open_results("map.h5"), variable="chi", theory="window")
    >>> [one.get_label() for one in drawn]
    ["$w' = 0.01$", "$w' = 0.05$"]
    """
    points = with_tasks(by_point(data))
    drawn = asked(points, theory)
    return circuits.draw_curves(_axes(ax), points, drawn, variable, against)


def relaxation(
    data: xr.Dataset, ax: Axes | None = None, *, variable: str = "chi",
    theory: str | Sequence[str] = (),
) -> list[Line2D]:  # fmt: skip
    """Draw a variable against time: mean over replicas, and a band of their standard deviation.

    Long series are averaged over short times, and replicas of several lengths are shown up to the
    end of the shortest. chi begins at the start; the current is the mean over intervals of the
    series, drawn at their middles, and counts from the urn that is fuller at their ends. Where the
    fuller urn changes within intervals it is too small, which a warning says: a shorter
    `series_interval` is better.

    Parameters
    ----------
    data
        Results of `open_results` or `merge`, or a part of them, with a series; at most six points,
        each of which has a colour.
    ax
        Axes to draw into; None: the current ones of pyplot.
    variable
        "chi" or "polarised_current".
    theory
        One or several names, whose states that are reached are drawn as lines.

    Returns
    -------
    list of matplotlib.lines.Line2D
        The mean of each point; the first replica of one whose replicas are in two states.

    Examples
    --------
    >>> import postproc
    >>> data = postproc.open_results("map.h5").sel(channel2_width=0.01)
    >>> [line.get_label() for line in relaxation(data)]
    ['$T = 2$', '$T = 7$']
    """
    points = circuits.few_points(by_point(data))
    return circuits.draw_relaxation(_axes(ax), points, asked(points, theory), variable)


def flows(
    data: xr.Dataset, ax: Axes | None = None, *, replica: int = 0,
    theory: str | Sequence[str] = (),
) -> list[ErrorbarContainer]:  # fmt: skip
    """Draw the four flows and both net currents of one run against time, from a series.

    Net currents are counted round the circuit: that of channel 1 is `current1` of a dataset, that
    of channel 2, from urn 2 to urn 1, is -`current2`.

    Parameters
    ----------
    data
        One point of `open_results` or `merge`, such as `data.sel(threshold=7)`, with a series.
    ax
        Axes to draw into; None: the current ones of pyplot.
    replica
        Which one, from 0.
    theory
        One or several names, whose flows and net currents are drawn as lines.

    Returns
    -------
    list of matplotlib.container.ErrorbarContainer
        One for each flow.

    Examples
    --------
    >>> import postproc
    >>> data = postproc.open_results("map.h5").sel(threshold=7, channel2_width=0.01)
    >>> len(flows(data, theory="window"))
    4
    """
    points = by_point(data)
    task = task_of(points, 0, replica)
    need_only(points)
    circuit, (series,) = points["circuit"].values[0], series_of(points, *task)
    (start,) = circuits.starts_of(points)
    return currents.draw_flows(_axes(ax), circuit, series, asked(points, theory), start)


def scene(
    data: xr.Dataset, ax: Axes | None = None, *, replica: int = 0, snapshot: int = -1,
    legend: bool = True,
) -> list[PathCollection]:  # fmt: skip
    """Draw the table of one point to scale with its particles; those that a gate counts are larger.

    Parameters
    ----------
    data
        One point of `open_results` or `merge`, such as `data.sel(threshold=7)`, with snapshots.
    ax
        Axes to draw into; None: the current ones of pyplot.
    replica
        Which one, from 0.
    snapshot
        Which one, from 0, or from the end if negative; by default the last.
    legend
        Whether the colours are named below the table.

    Returns
    -------
    list of matplotlib.collections.PathCollection
        One for each colour.

    Examples
    --------
    >>> import postproc
    >>> data = postproc.open_results("map.h5").sel(threshold=7, channel2_width=0.01)
    >>> drawn = scene(data, snapshot=0)
    >>> sum(len(one.get_offsets()) for one in drawn)
    200
    """
    points = by_point(data)
    task = task_of(points, 0, replica)
    need_only(points)
    axes, circuit = _axes(ax), points["circuit"].values[0]
    scenes.draw_table(axes, circuit)
    drawn = scenes.draw_particles(axes, circuit, snapshot_of(points, *task, snapshot))
    if legend:
        scenes.explain(axes)
    return drawn


def lifetimes(
    data: xr.Dataset, ax: Axes | None = None, *, theory: str | Sequence[str] = ()
) -> list[ErrorbarContainer]:
    """Draw how long the homogeneous and the polarised state last, against N.

    Parameters
    ----------
    data
        Results of `open_results` or `merge`, or a part of them, with series, of one l and w' and
        one T at each N: first passages of the replicas are measured, drawn as marks.
    ax
        Axes to draw into; None: the current ones of pyplot.
    theory
        One or several names, whose birth-death chains are drawn as lines.

    Returns
    -------
    list of matplotlib.container.ErrorbarContainer
        One for each state from which runs began.

    Examples
    --------
    >>> import postproc
    >>> data = postproc.open_results("map.h5").sel(threshold=7, channel2_width=0.01)
    >>> len(lifetimes(data, theory="window"))
    1
    """
    points = with_tasks(by_point(data))
    need_only(points, "number", "start")
    for _, part in groups(points, "number"):  # T may change with N alone
        need_only(part, "start")
    return passages.draw_lifetimes(_axes(ax), passages.measured(points), asked(points, theory))


def characteristic(
    data: xr.Dataset, ax: Axes | None = None, *, theory: str | Sequence[str] = ()
) -> list[Line2D]:
    """Draw U = ln(N2/N1) against the net current J over a scan, as of w', and the power J U.

    N2 and N1 are the numbers of particles in the fuller and in the emptier half, as in chi, each
    with its halves of the channels: U = ln((1 + chi)/(1 - chi)). J is the polarised current.
    The open circuit is where J = 0; beyond the largest power the battery collapses at the
    transition: there J and U are those of fluctuations.

    Parameters
    ----------
    data
        Results of `open_results` or `merge`, or a part of them, with one key that was scanned.
    ax
        Axes to draw into; None: the current ones of pyplot.
    theory
        One or several names, whose voltage is drawn, as a line or as marks at the points.

    Returns
    -------
    list of matplotlib.lines.Line2D
        Those of U and of J U.

    Examples
    --------
    >>> import postproc
    >>> data = postproc.open_results("map.h5").sel(threshold=7)
    >>> voltage, power = characteristic(data, theory="window")
    >>> bool((power.get_ydata() == voltage.get_xdata() * voltage.get_ydata()).all())
    True
    """
    points = with_tasks(by_point(data))
    return circuits.draw_characteristic(_axes(ax), points, asked(points, theory))


def _axes(ax: Axes | None) -> Axes:
    """Return the axes to draw into."""
    from matplotlib import pyplot as plt  # noqa: PLC0415 (not every user has a display)

    return ax or plt.gca()

"""Both charts of the ladder: errors against processor time, a panel for each quantity.

Filled marks are significant errors, open ones with an arrow are bounds, faint ones belong to a
rung without a result at some points. A ring: errors cancel. Lines: expected errors of runs in that
time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from postproc.figures import style
from studies.accuracy import ladder
from studies.accuracy.ladder_errors import TIMES, expected, pareto
from studies.common import numbers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from studies.accuracy.ladder_map import Floats

# engines: discs, squares and triangles; theories: crosses
LOOKS = {
    "excursion": ("o", style.BLUE), "collision": ("s", style.SKY),
    "synchronous": ("D", style.BLACK), "reservoir": ("^", style.GREEN),
    "window": ("P", style.VERMILION), "renewal": ("X", style.ORANGE), "direction": ("X", "#6A3D9A"),
}  # fmt: skip
STEPPED = (">", style.GREY)  # timestep, whatever its step
WIDE = {"collision": 8.0, "synchronous": 4.0}  # sizes of marks that coincide, one inside the other
LEAST = 3e-4  # error below which the map's chart does not go
FAINT = 0.4  # opacity of a rung without a result at some points
# of the first chart: end of a line at which its step is written, and side of the line
STEP_LABELS = {
    "timestep 0.1": (-1, "right", "bottom"), "timestep 0.03": (0, "left", "bottom"),
    "timestep 0.01": (-1, "right", "top"), "timestep 0.003": (0, "left", "bottom"),
    "timestep 0.001": (0, "left", "bottom"),
}  # fmt: skip
BELOW = {"timestep 0.03": -7}  # position of the label of a step that does not fit above its mark
RING = {"color": style.BLACK, "mfc": "none", "ms": 10, "mew": 0.6}


def look(line: dict) -> tuple[str, str]:
    """Return mark and colour of a rung."""
    return LOOKS.get(line["name"], STEPPED)


def _chart(
    rows: Sequence[dict], titles: dict[str, str], draw: Callable[[Axes, dict, str], None],
    height: float, **limits: object,
) -> tuple[Figure, Sequence[Axes]]:  # fmt: skip
    """Return a panel for each quantity, the first with entries for the legend."""
    made = style.figure(style.PAGE, height)
    panels = made.subplots(1, len(titles), sharey=True)
    for axes, (quantity, title) in zip(panels, titles.items(), strict=True):
        for line in rows:
            draw(axes, line, quantity)
        axes.set(xscale="log", yscale="log", **limits)
        axes.set_title(title, fontsize=8.5)
    for line in rows:
        if not line["name"].startswith("timestep"):
            mark, colour = look(line)
            panels[0].plot([], [], mark, color=colour, label=ladder.label(line["name"]))
    mark, colour = STEPPED
    panels[0].plot([], [], mark, color=colour, label="timestep, step beside it")
    panels[0].plot([], [], marker=r"$\downarrow$", mew=0.0, ms=7, ls="none", color=style.BLACK,
                   label="open, with arrow: a bound")  # fmt: skip
    panels[0].plot([], [], "-", color=style.BLACK, lw=0.8, label="line: to be expected of a run")
    return made, panels


def _draw(
    axes: Axes, line: dict, at: float, size: float, error: float, bound: float, alpha: float,
    run: tuple[Floats, Sequence[float]] | None,
) -> None:  # fmt: skip
    """Draw an error, or its bound if `alpha` is 0; for a run what is to be expected."""
    mark, colour = look(line)
    if alpha:
        axes.errorbar([at], [size], [error], fmt=mark, color=colour, ms=5, alpha=alpha)
    else:
        numbers.bound(axes, at, bound, mark, colour, WIDE.get(line["name"], 5.0))
    if run is not None:
        axes.plot(*run, "-", color=colour, lw=0.8)


def figure_observables(rows: Sequence[dict]) -> Figure:
    """Return the chart of the reference point: relative errors."""

    def draw(axes: Axes, line: dict, quantity: str) -> None:
        one = line[quantity]
        if one["bias"] is None or not math.isfinite(one["bias"]):
            return
        size, error, at, run = abs(one["bias"]), one["bias_error"], one["seconds"], None
        if line["kind"] != "theory":
            times = np.geomspace(min(ladder.least_cost(line, quantity), at), 100.0 * at, 60)
            bias = 0.0 if line["kind"] == "exact" else size
            run = times, np.hypot(bias, one["relative_error"] * np.sqrt(at / times))
        _draw(axes, line, at, size, error, size + error, float(size > 2.0 * error), run)
        if line["name"] in STEP_LABELS:
            end, across, along = STEP_LABELS[line["name"]]
            axes.text(run[0][end], run[1][end], line["name"].split()[1], fontsize=6,
                      color=look(line)[1], ha=across, va=along)  # fmt: skip

    titles = {"chi": r"$\chi$ at $T = 7$", "current": "net current at $T = 7$",
              "transition": "$T$ of the upper transition"}  # fmt: skip
    made, panels = _chart(rows, titles, draw, 3.9, xlim=(5e-4, 5e3), ylim=(5e-5, 2.0),
                          xlabel="CPU time (s)")  # fmt: skip
    panels[0].set_ylabel("relative error")
    made.legend(loc="outside upper center", ncols=4, fontsize=7)
    return made


def figure_map(rows: Sequence[dict]) -> Figure:
    """Return the chart of the map, with the best that can be had in each time."""

    def draw(axes: Axes, line: dict, quantity: str) -> None:
        one, run = line[quantity], None
        at, size = one["seconds"], one["bias"]
        if quantity == "transition" and one["missing"]:
            return
        bound = max(math.hypot(size, one["bias_error"]), LEAST)
        if one["cancels"]:
            axes.plot([at], [size if one["seen"] else bound], "o", **RING)
        if line["kind"] != "theory":
            times = np.geomspace(2.0 * one["approach"], 1e3 * at, 80)
            run = times, [expected(line, quantity, float(seconds)) for seconds in times]
        alpha = (FAINT if one["missing"] else 1.0) if one["seen"] else 0.0
        _draw(axes, line, at, size, one["bias_error"], bound, alpha, run)
        if line["name"].startswith("timestep"):
            axes.annotate(
                line["name"].split()[1], (at, size if one["seen"] else bound),
                (0, BELOW.get(line["name"], 7)), textcoords="offset points", fontsize=6,
                color=look(line)[1], ha="center", va="center",
            )  # fmt: skip

    titles = {"chi": r"error of $\chi$", "current": r"relative error of current over $\chi$",
              "transition": "relative error of transition $T$"}  # fmt: skip
    made, panels = _chart(rows, titles, draw, 4.1, xlim=(5e-4, 1e4), ylim=(LEAST, 2.0),
                          xlabel="processor time of a point (s)")  # fmt: skip
    best = {"color": "#F0E442", "lw": 4.0}
    for axes, quantity in zip(panels, titles, strict=True):
        axes.plot(TIMES, pareto(rows, quantity), solid_capstyle="butt", zorder=0.5, **best)
    panels[0].set_ylabel("root mean square over the map")
    panels[0].plot([], [], ">", color=style.GREY, alpha=FAINT, label="faint: no answer at some")
    panels[0].plot([], [], "o", label="ring: errors cancel", **RING)
    panels[0].plot([], [], "-", label="Pareto line", **best)
    made.legend(loc="outside upper center", ncols=4, fontsize=7)
    return made

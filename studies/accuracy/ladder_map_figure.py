"""Chart of the ladder over the map: error of chi, current over chi, and transition against cost."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from postproc.figures import style
from studies.accuracy import ladder
from studies.accuracy.ladder import QUANTITIES
from studies.accuracy.ladder_errors import TIMES, expected, pareto
from studies.accuracy.observables import explain, look

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAMES = {
    "chi": r"error of $\chi$",
    "current": r"relative error of current over $\chi$",
    "transition": "relative error of transition $T$",
}
LIMITS = (3e-4, 2.0)  # of errors
FAINT = 0.4  # opacity of a rung without a result at some points
BELOW = {"timestep 0.03": -7}  # position of the label of a step that does not fit above its mark


def figure(rows: Sequence[dict]) -> Figure:
    """Return the chart.

    Filled marks are significant errors, open ones with an arrow are bounds, faint ones belong to a
    rung without a result at some points. A ring: errors cancel. Lines: expected errors of runs in
    that time.
    """
    made = style.figure(style.PAGE, 4.1)
    panels = made.subplots(1, len(QUANTITIES), sharey=True)
    for axes, quantity in zip(panels, QUANTITIES, strict=True):
        best = pareto(rows, quantity)
        axes.plot(TIMES, best, color=style.YELLOW, lw=4.0, solid_capstyle="butt", zorder=0.5)
        for line in rows:
            _draw_rung(axes, line, quantity)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlim(5e-4, 1e4)
        axes.set_ylim(*LIMITS)
        axes.set_xlabel("processor time of a point (s)")
        axes.set_title(NAMES[quantity], fontsize=8.5)
    panels[0].set_ylabel("root mean square over the map")
    for line in rows:
        if not line["name"].startswith("timestep"):
            mark, colour = look(line)
            panels[0].plot([], [], mark, color=colour, label=ladder.label(line["name"]))
    explain(panels[0])
    panels[0].plot([], [], ">", color=style.GREY, alpha=FAINT, label="faint: no answer at some")
    panels[0].plot([], [], "o", color=style.BLACK, mfc="none", ms=10, mew=0.6,
                   label="ring: errors cancel")  # fmt: skip
    panels[0].plot([], [], "-", color=style.YELLOW, lw=4.0, label="Pareto line")
    made.legend(loc="outside upper center", ncols=4, fontsize=7)
    return made


def _draw_rung(axes: Axes, line: dict, quantity: str) -> None:
    one, (mark, colour) = line[quantity], look(line)
    at, size = one["seconds"], one["bias"]
    if quantity == "transition" and one["missing"]:
        return
    if one["seen"]:
        faint = FAINT if one["missing"] else 1.0
        axes.errorbar([at], [size], [one["bias_error"]], fmt=mark, color=colour, ms=5, alpha=faint)
    else:
        size = max(math.hypot(size, one["bias_error"]), LIMITS[0])
        style.bound(axes, at, size, mark, colour)
    if one["cancels"]:
        axes.plot([at], [size], "o", color=style.BLACK, mfc="none", ms=10, mew=0.6)
    if line["kind"] != "theory":
        times = np.geomspace(2.0 * one["approach"], 1e3 * at, 80)
        shown = [expected(line, quantity, float(seconds)) for seconds in times]
        axes.plot(times, shown, "-", color=colour, lw=0.8)
    if line["name"].startswith("timestep"):
        axes.annotate(
            line["name"].split()[1], (at, size), (0, BELOW.get(line["name"], 7)),
            textcoords="offset points", fontsize=6, color=colour, ha="center", va="center",
        )  # fmt: skip

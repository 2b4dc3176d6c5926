"""Picture of the experiments, from their stored numbers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.legend_handler import HandlerTuple
from scipy import stats

from postproc.figures import style
from postproc.theory.direction import DIFFUSION
from studies.common.numbers import bound
from studies.experiments import predictions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TAILS = [[0.1587], [0.8413]]  # ends of the error bars of counts: 68 % of Poisson's distribution
NONE = -math.log(0.05)  # upper bound of the expected number of events if none is observed (95 %)
BESIDE = 1.12  # factor by which marks at one number of rounds are separated


def figure(numbers: dict) -> Figure:
    """Return directions, sizes and circulations, measured and predicted."""
    made = style.figure(style.PAGE, 3.6)
    directions, sizes, turns = made.subplots(1, 3)
    _draw_directions(directions, numbers["curves"])
    _draw_sizes(sizes, numbers["rows"])
    _draw_turns(turns, numbers["laws"])
    return made


def _draw_directions(axes: Axes, curves: Sequence[dict]) -> None:
    for curve, colour, mark in zip(curves, style.CYCLE, "os^", strict=False):
        scaled = np.array(curve["lags"]) * curve["width"] ** 2
        look = {"fmt": mark, "color": colour, "mfc": "none"}
        label = f"$w = {curve['width']:g}$"
        axes.errorbar(scaled, curve["mean"], curve["error"], label=label, **look)
    line = np.linspace(0.0, 4.2, 200)
    values = predictions.autocorrelation(DIFFUSION, line)
    axes.plot(line, values, color=style.BLACK, lw=0.9, label="predicted")
    axes.set_xlabel("visits $\\times\\, (w/r)^2$")
    axes.set_ylabel(r"autocorrelation of $\cos\theta$")
    axes.set_ylim(0.0, 1.0)
    axes.set_title("(a)  directions")
    axes.legend(fontsize=7)


def _draw_sizes(axes: Axes, rows: Sequence[dict]) -> None:
    for what, colour, label in (
        ("conductance", style.BLUE, "conductance"),
        ("flow", style.VERMILION, "sparse gate"),
    ):
        for size, (mark, shift) in {"r = 1": ("o", -0.12), "r = 2": ("s", 0.12)}.items():
            mine = [row for row in rows if row["experiment"] == 3 and row["what"].startswith(what)
                    and size in row["what"]]  # fmt: skip
            place = [float(row["what"].rsplit("= ", 1)[1]) + shift for row in mine]
            values, errors = ([row[key] for row in mine] for key in ("measured", "error"))
            look = {"fmt": mark, "color": colour, "mfc": colour if size == "r = 2" else "none"}
            axes.errorbar(place, values, errors, label=f"{label}, ${size}$", **look)
            if what == "conductance":
                for x, row in zip(place, mine, strict=True):
                    axes.plot([x - 0.25, x + 0.25], [row["predicted"]] * 2, color=colour, lw=0.9)
    axes.axhline(1.0, color=style.GREY, ls="--", lw=0.8)
    axes.plot([], [], color=style.BLUE, lw=0.9, label="two ports alone")
    axes.set_ylim(top=1.27)
    axes.set_xlabel("$T$")
    axes.set_ylabel("over that of urns without memory")
    axes.set_title("(b)  two sizes, equal loads")
    axes.legend(fontsize=6, loc="upper left")


def _draw_turns(axes: Axes, laws: Sequence[dict]) -> None:
    for at, (law, mark) in enumerate(zip(laws, "os^D", strict=False)):
        rounds, reached = np.array(law["rounds"], float), np.array(law["reached"], float)
        colour, dashes = style.CYCLE[at], ("-", "--", ":", "-.")[at]
        there = reached > 0
        none = np.flatnonzero(~there)[:1]  # longer circulations include these rounds
        place = rounds * BESIDE ** (at - 1.5)
        counts = reached[there]
        ends = stats.chi2.ppf(TAILS, [2.0 * counts, 2.0 * counts + 2.0]) / 2.0
        look = {"fmt": mark, "color": colour, "mfc": "none", "ms": 3.5}
        label = f"$w' = {law['width']:g}$, $\\ell' = {law['length']:g}$"
        axes.errorbar(place[there], counts / law["time"], np.abs(ends - counts) / law["time"],
                      label=label, **look)  # fmt: skip
        for one in none:
            bound(axes, place[one], NONE / law["time"], mark, colour, 3.5)
        axes.plot(rounds, law["predicted"] / rounds, color=colour, ls=dashes, lw=0.8,
                  label="predicted")  # fmt: skip
    axes.set_xlim(0.6, 2e4)
    axes.set_ylim(2e-7, 1e-1)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("rounds $m$ or more")
    axes.set_ylabel("circulations (per unit time)")
    axes.set_title("(c)  circulation")
    handles, labels = axes.get_legend_handles_labels()
    lines, marks = handles[: len(laws)], handles[len(laws) :]
    pairs = list(zip(marks, lines, strict=True))
    axes.legend(pairs, labels[len(laws) :], fontsize=6, loc="upper right", handlelength=3.5,
                title="marks measured, lines predicted", title_fontsize=6,
                handler_map={tuple: HandlerTuple(None)})  # fmt: skip

"""The picture of the page, from its tables: one colour for each N, prediction lines for each N."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.lines import Line2D

from postproc.figures import style
from studies.order_of_transition import later, samples

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from postproc.study import Study

    Row = dict[str, object]

NUMBERS = (250, 500, 1000, 1500, 2000, 4000, 8000, 16000, 32000)
COLOURS = dict(zip(NUMBERS, (style.ORANGE, style.BROWN, style.BLUE, style.BLACK, style.VERMILION,
                             style.GREEN, style.PURPLE, style.VIOLET,
                             style.SKY), strict=True))  # fmt: skip
LOOKS = {"equal": {"ls": "-", "marker": "o"}, "full": {"ls": "--", "marker": "s"}}
TITLES = {
    "A": "A: T = 5, x = 2.27 to 2.37 T", "B": "B: T = 7, x = 1.66, 1.68 T",
    "C": "C: T = 10, x = 1.14, 1.17 T", "D": "D: T = 28, x = 1.58 to 1.67 T",
    "V": "V: T = 64, x = 0.76 T", "W": "W: T = 64, x = 0.78 T",
}  # fmt: skip
BARRIER_TICKS = (250, 500, 1000, 2000, 4000)
TOP, STEP = 1.03, 0.03  # chi, where bars of the predicted ranges are


def _chi(axes: Axes, rows: list[Row], over: str = "w'", **extra: object) -> None:
    for label, look in LOOKS.items():
        own = sorted(rows, key=lambda row: row[over])
        axes.errorbar(
            [row[over] for row in own], [row[f"chi_{label}"] for row in own],
            [row[f"chi_{label}_error"] for row in own], ms=2.5, lw=0.8, mfc="none", elinewidth=0.8,
            capsize=1.5, **look, **extra,
        )  # fmt: skip


def _transition(axes: Axes, name: str, rows: list[Row], predicted: list[Row]) -> None:
    """Draw chi over w' of one circuit, and above it where two states are predicted at each N."""
    numbers = sorted({row["N"] for row in rows if row["circuit"] == name})
    for place, number in enumerate(numbers):
        _chi(axes, [row for row in rows if row["circuit"] == name and row["N"] == number],
             color=COLOURS[number])  # fmt: skip
        told = [row for row in predicted if row["circuit"] == name and row["N"] == number]
        for row in told:
            first, last = (row[f"w' {end}"] for end in ("homogeneous from", "polarised to"))
            if not last > 0.0:
                continue
            height = TOP + STEP * place
            axes.plot([first if first > 0.0 else 0.0, last], [height, height], lw=1.6,
                      color=COLOURS[number], marker="|", ms=4)  # fmt: skip
            axes.plot([row["w' equal"]], [height], "d", ms=3, color=COLOURS[number])
    axes.axhline(1.0, color="0.6", lw=0.5)
    axes.set(xlabel="w'/r", ylabel=r"$\chi$", ylim=(0, TOP + STEP * 5.5), title=TITLES[name])
    axes.set_yticks(np.linspace(0.0, 1.0, 6))


def _histograms(axes: Axes, work: Study, name: str) -> None:
    """Draw histograms at the w' where the barrier is largest, for each N."""
    runs, middles = later.read(work, "runs"), 0.5 * (samples.BINS[:-1] + samples.BINS[1:])
    sizes = [row for row in later.read(work, "later_sizes") if row["circuit"] == name]
    for row in sizes:
        if row["N"] == 8000 and name != "V":
            continue
        counts = np.array([
            [one[key] for key in later.BINS] for one in runs
            if (one["circuit"], one["N"], one["w'"]) == (name, row["N"], row["barrier_at"])
        ]).sum(axis=0)  # fmt: skip
        axes.semilogy(middles, counts / counts.sum() / samples.BINS[1], lw=1.0,
                      color=COLOURS[row["N"]], label=f"w' = {row['barrier_at']:.4g}")  # fmt: skip
    axes.set(xlabel="|m|", ylabel="density of |m|", ylim=(1e-3, None),
             title=f"{name}: largest barrier")  # fmt: skip
    axes.legend(fontsize=5.5, frameon=False, loc="lower center")


def _barriers(axes: Axes, work: Study) -> None:
    sizes, told = later.read(work, "later_sizes"), later.read(work, "finite")
    for name, colour, mark in (("A", style.BLUE, "o"), ("D", style.VERMILION, "s")):
        own = [row for row in sizes if row["circuit"] == name and row["N"] in later.SCALED[name]]
        axes.errorbar([row["N"] for row in own], [row["barrier"] for row in own],
                      [row["barrier_error"] for row in own], fmt=f"{mark}-", ms=3, lw=0.9,
                      capsize=1.5, color=colour, label=f"{name}, runs")  # fmt: skip
        lines = [row for row in told if row["circuit"] == name and row["N"] <= 4000]
        axes.plot([row["N"] for row in lines], [row["barrier"] for row in lines], f"{mark}--",
                  lw=0.9, ms=3, mfc="none", color=colour, label=f"{name}, predicted")  # fmt: skip
    axes.set(xlabel="N", ylabel="barrier of ln P", ylim=(0.4, 60), xlim=(200, 5000),
             xscale="log", yscale="log", title="barriers, largest over w'")  # fmt: skip
    axes.set_xticks(BARRIER_TICKS, [str(number) for number in BARRIER_TICKS])
    axes.minorticks_off()
    axes.legend(fontsize=6, frameon=False, loc="upper left")


def draw(work: Study) -> None:
    """Make the picture."""
    made: Figure = style.figure(style.PAGE, 8.2)
    panels = made.subplots(4, 3).flat
    first, table = later.read(work, "results"), later.read(work, "later")
    predicted = later.read(work, "finite")
    for name in "ADBC":
        _transition(next(panels), name, first, predicted)
    for name in "VW":
        _transition(next(panels), name, table, predicted)
    for name in "ADV":
        _histograms(next(panels), work, name)
    _barriers(next(panels), work)
    axes = next(panels)
    discs = later.read(work, "lorentz")
    for name, colour in (("L7", style.BLUE), ("L28", style.VERMILION)):
        _chi(axes, [row for row in discs if row["circuit"] == name], "radius", color=colour)
        axes.plot([], [], color=colour, label=f"T = {name[1:]}")
    axes.legend(fontsize=6, frameon=False)
    axes.set(xlabel="radius of discs/r", ylabel=r"$\chi$", ylim=(0, 1), title="Lorentz, N = 4000")
    legend = next(panels)
    legend.axis("off")
    marks = [Line2D([], [], color=colour, lw=1.5, label=f"N = {number}")
             for number, colour in COLOURS.items()]  # fmt: skip
    marks += [
        Line2D([], [], color="black", lw=0.8, ms=3, mfc="none", label="runs from equal urns",
               **LOOKS["equal"]),
        Line2D([], [], color="black", lw=0.8, ms=3, mfc="none", label="runs from a full urn",
               **LOOKS["full"]),
        Line2D([], [], color="black", lw=1.6, marker="|", ms=4,
               label="predicted: two stable states"),
        Line2D([], [], color="black", lw=0, marker="d", ms=3, label="predicted: equal weight"),
    ]  # fmt: skip
    legend.legend(handles=marks, fontsize=6, frameon=False, loc="center")
    work.draw(made, "order_of_transition")

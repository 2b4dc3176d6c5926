"""Page and figure of the five deciding experiments, from the numbers that they have kept."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.legend_handler import HandlerTuple
from scipy import stats

from postproc.accuracy import predictions
from postproc.figures import style
from postproc.study.text import measured, number, table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TAILS = [[0.1587], [0.8413]]  # ends of the error bars of counts: 68 % of Poisson's distribution
NONE = -math.log(0.05)  # events expected where none is seen, at most (95 %)
BESIDE = 1.12  # by how much marks of one number of rounds are drawn apart
CLOSE = 3.0  # standard errors within which a prediction counts as met
HEADS = ("quantity", "urns without memory", "memory", "measured", "off by")
TITLES = {
    1: "Directions last from visit to visit",
    2: "An urn remembers by which opening one came",
    3: "Larger urns do not forget more",
    4: "Who flies along the axis goes on doing so",
    5: "The transient near the upper transition",
}
TEXTS = {
    1: "Single urn without a gate, N = T = 100. From entry to entry of one particle: cos(theta) "
    "is the time that the flight to the end wall would take along the axis over that which it "
    "takes. sin(theta) diffuses with the generator D d/ds (1 - s^2) d/ds, D r^2/w^2 = 1/6 - "
    "1/pi^2 = 0.0653 a visit in the limit of narrow openings, and nearly so for all w; with the "
    "mean stay, which goes as 1/w, that is the law of w^3 of the relaxation in time.",
    2: "Circuit without gates (T = N = 1000), w = 0.3, w' = 0.01. Orbits that come back to an "
    "opening of two that lie opposite are polygons, and those with an even number of sides "
    "meet the other opening first: only odd ones return.",
    3: "w = 0.3, w' = 0.01, l = l' = 1, loads equal: r = 1 with N = 1000, r = 2 with N = 4000. "
    "The paper expects its theory to hold the better the more particles there are and the "
    "smaller the openings. By memory the conductance keeps its excess (the chance to return "
    "goes as w'/w whatever r is), and what the sparse gate lets through falls further behind, "
    "since directions last 16 times as long. The column memory has two ports alone, without "
    "circulation.",
    4: "T = 7, w = 0.3. The rate at which particles begin to go round so many times or more "
    "without a bounce in an urn is (n2/pi A) (w'^2/L) (1 + 2 l'/(L - l'))/m, with the measured "
    "number n2 in the dense urn.",
    5: "N = 1000, w' = 0.01, from chi(0) = 0.4; T where chi falls through 0.3, averages over "
    "5000 time units. If chi took 3000 time units to relax there, as this project supposed "
    "before, an average that begins after 500 would be off by the number under memory.",
}  # fmt: skip

FOUND = {
    1: "met. The curves of three widths fall together where visits are counted in (r/w)^2.",
    2: "met.",
    3: "met in kind: the conductance comes no closer to 1 in the larger urns, within its errors, "
    "and the sparse gate goes further away. What the conductance has over two ports at r = 1, "
    "T = 7 is circulation: it carries 0.04 of 1 "
    "([measured](accuracy.md#the-tail-of-the-net-current)).",
    4: "in part. Rates fall as 1/m or a little slower, and grow nearly as w'^2. Their size is 10 "
    "to 100 % above the formula, and a shorter channel 2 raises them where the formula lowers "
    "them. That is open.",
    5: "not met, for the better: after 500 time units the average is what it is after 5000.",
}


def verdict(rows: Sequence[dict]) -> list[str]:
    """Return a line an experiment: how many predictions are met, and how far off the worst is."""
    lines = []
    for one, title in TITLES.items():
        mine = [row for row in rows if row["experiment"] == one and _known(row["predicted"])]
        off = [(row["measured"] - row["predicted"]) / row["error"] for row in mine]
        met = sum(abs(value) < CLOSE for value in off)
        worst = max(off, key=abs)
        lines.append(
            f"{one}. {title}: {met} of {len(mine)} numbers within {CLOSE:g} standard errors, "
            f"the worst off by {worst:+.1f}."
        )
    return lines


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def _row(row: dict) -> list[str]:
    predicted = row["predicted"]
    off = (row["measured"] - predicted) / row["error"] if _known(predicted) else None
    return [
        row["what"],
        number(row["mixed"], 4),
        number(predicted, 4),
        _value(row["measured"], row["error"]),
        "-" if off is None else f"{off:+.1f}",
    ]


def _value(value: float, error: float) -> str:
    if abs(value) >= 1e-3 or value == 0.0:
        return measured(value, error)
    power = math.floor(math.log10(abs(value)))
    scaled = measured(value / 10.0**power, error / 10.0**power)
    return f"({scaled})e{power}"


def page(numbers: dict) -> str:
    """Return docs/experiments.md."""
    rows = numbers["rows"]
    sections = [
        f"## {one}. {title}\n\n{_wrapped(TEXTS[one])}\n\n"
        f"{_wrapped(f'Found, in the long runs of 22 November 2026: {FOUND[one]}')}\n\n"
        + table(HEADS, [_row(row) for row in rows if row["experiment"] == one])
        for one, title in TITLES.items()
    ]
    lines = "\n".join(verdict(rows))
    options = " --full" if numbers["full"] else ""
    head = _wrapped(
        f"Made by `python -m postproc.experiments{options}`; every number below is read from "
        "`experiments.json`, which it wrote. Predictions are formulas without a fitted number "
        '(`postproc/accuracy/predictions.py`). "Off by" is measured less predicted, in standard '
        "errors of the measurement. Urns without memory are what the paper's theory has. Time in "
        "lengths over the speed v = 1."
    )
    picture = "Autocorrelation of directions, conductance and gates of two sizes, circulations"
    parts = [
        "# Five experiments that decide whether urns remember", head, lines,
        f"![{picture}](experiments.png)", *sections,
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def _wrapped(text: str) -> str:
    return textwrap.fill(text, 118, break_long_words=False, break_on_hyphens=False)


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
    values = predictions.autocorrelation(predictions.DIFFUSION, line)
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
        none = np.flatnonzero(~there)[:1]  # whoever goes round longer has gone round so often
        place = rounds * BESIDE ** (at - 1.5)
        counts = reached[there]
        ends = stats.chi2.ppf(TAILS, [2.0 * counts, 2.0 * counts + 2.0]) / 2.0
        look = {"fmt": mark, "color": colour, "mfc": "none", "ms": 3.5}
        label = f"$w' = {law['width']:g}$, $\\ell' = {law['length']:g}$"
        axes.errorbar(place[there], counts / law["time"], np.abs(ends - counts) / law["time"],
                      label=label, **look)  # fmt: skip
        for one in none:
            style.bound(axes, place[one], NONE / law["time"], mark, colour, 3.5)
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

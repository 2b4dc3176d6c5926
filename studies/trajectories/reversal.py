"""Free circuit with all velocities reversed at the time t: distance from the start after 2t.

Without rounding all particles return exactly. A rounding error at the reversal grows as exp(lambda
t) on the way back, so in a precision eps the start is lost after ln(1/eps)/lambda: 36.7/lambda in
double.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from postproc.figures import style
from studies.common.probes import EPSILON, PRECISIONS, Question
from studies.common.text import number
from studies.trajectories.growth import (
    ASTRAY,
    COLOUR,
    NUMBER,
    asked,
    by_name,
    horizon,
    predicted_horizon,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from studies.common import study

ENGINES = ("collision", "excursion")
TIMES = (1, 2, 5, 10, 20, 40, 60, 80, 100, 125, 150, 175, 200, 225, 250, 275, 300, 350, 400, 450,
         500, 550, 600, 650)  # fmt: skip
STEP, STEP_TIMES = 1e-3, (1, 2, 5, 10, 20, 30, 40, 50, 60)


def questions() -> list[Question]:
    """Return the questions: both exact engines in all precisions, and a fixed step."""
    made = [
        Question(f"reversal-{engine}-{precision}", precision,
                 ("reversal", engine, "0", "start.txt", str(NUMBER), *map(str, TIMES)))
        for engine in ENGINES for precision in reversed(PRECISIONS)
    ]  # fmt: skip
    words = ("reversal", "timestep", str(STEP), "start.txt", str(NUMBER), *map(str, STEP_TIMES))
    return [*made, Question("reversal-timestep-real64", "real64", words)]


def measure(answer: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the numbers of one engine and precision."""
    errors = [np.array([float(value) for value in line["error"]]) for line in answer]
    return {
        "engine": answer[0]["engine"], "precision": answer[0]["precision"],
        "time": [float(line["time"]) for line in answer],
        "median": [float(np.median(one)) for one in errors],
        "worst": [float(one.max()) for one in errors],
        "returned": [float((one < ASTRAY).mean()) for one in errors],
    }  # fmt: skip


def figure_return(rows: Sequence[dict[str, Any]], rate: float) -> Figure:
    """Draw the median distance from the start against the time of the reversal."""
    made = style.figure(style.PAGE * 0.75, 3.4)
    axes = made.subplots()
    for row in rows:
        line = {"collision": "-", "excursion": "--"}.get(row["engine"], ":")
        colour = COLOUR[row["precision"]] if row["engine"] in ENGINES else style.BLACK
        label = f"{row['engine']}, {row['precision']}"
        median = np.maximum(row["median"], 1e-36)
        axes.semilogy(row["time"], median, line, color=colour, label=label)
    for precision in PRECISIONS:
        ends = np.array([0.0, math.log(1 / EPSILON[precision]) / rate])
        grown = EPSILON[precision] * np.exp(rate * ends)
        axes.semilogy(ends, grown, "-.", color=style.GREY, lw=0.8)
    axes.plot([], [], "-.", color=style.GREY, lw=0.8, label=r"$\epsilon\,e^{\lambda t}$")
    axes.set_xlabel("time t at which all velocities are turned")
    axes.set_ylabel("median distance from the start at 2t")
    axes.set_ylim(1e-36, 1e2)
    axes.legend(fontsize=7, loc="lower right")
    return made


def table(work: study.Study, numbers: dict[str, Any]) -> None:
    """Write the times at which half of the particles are astray, predicted and measured."""
    rows = []
    for name, time in numbers["horizon"].items():
        engine, precision = name.split()
        known = None if engine == "timestep" else numbers["predicted_horizon"][precision]
        rows.append([f"`{engine}`", precision, number(known, 3), number(time, 3)])
    work.table("reversal", ["engine", "precision", "predicted", "half are astray after"], rows)


def run(work: study.Study) -> None:
    """Run forwards and back; store the numbers, draw `reversal`."""
    tangent, answers = asked(work, questions())
    rate = float(tangent["lyapunov"])
    rows = [measure(answer) for answer in answers]
    found = {
        "lyapunov": rate, "number": NUMBER,
        "predicted_horizon": predicted_horizon(rate), "horizon": by_name(rows, horizon),
        "rows": rows,
    }  # fmt: skip
    work.keep("reversal", found)
    table(work, found)
    work.draw(figure_return(rows, rate), "reversal")

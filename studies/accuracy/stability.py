"""Errors in the cases in which methods fail, for each engine and precision."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import TYPE_CHECKING, Any

import numpy as np

from postproc.figures import style
from studies.common import text
from studies.common.probes import PRECISIONS, Answer, Question, ask
from studies.common.visits import BITS, compared_visits

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure

    from studies.common.study import Study

    Row = dict[str, Any]

ENGINES = ("excursion", "collision", "synchronous", "timestep", "reservoir")
# wall collisions of the long run: quick, and how many times as many if full
COLLISIONS = {
    ("excursion", "real32"): 1e8, ("excursion", "real64"): 1e8, ("excursion", "real128"): 1e7,
    ("collision", "real32"): 1e8, ("collision", "real64"): 1e8, ("collision", "real128"): 5e6,
    ("synchronous", "real32"): 1e6, ("synchronous", "real64"): 1e6, ("synchronous", "real128"): 2e4,
    ("timestep", "real32"): 1e6, ("timestep", "real64"): 1e6, ("timestep", "real128"): 2e4,
    ("reservoir", "real32"): 1e8, ("reservoir", "real64"): 1e8, ("reservoir", "real128"): 1e7,
}  # fmt: skip
FULL = 100
VISITS = ((0.3, 0.01), (1e-6, 1e-6))  # w, w'
REQUIRED = 1e-12  # required error of a visit in real64, over its condition number


def pick(answer: Answer, case: str) -> list[Row]:
    """Return the lines of a case."""
    return [line for line in answer if line["case"] == case]


def number(value: object) -> float:
    """Return a value of the probe as a float; null is NaN."""
    return math.nan if value is None else float(value)  # type: ignore[arg-type]


def short(value: float) -> str:
    """Write a number with two digits, a whole one without a point."""
    if math.isnan(value):
        return "none"
    if value == round(value) and abs(value) < 1e4:
        return str(round(value))
    mantissa, power = f"{value:.1e}".split("e")
    return f"{mantissa}e{int(power)}"


def whispering(answer: Answer, truth: Answer) -> str:
    """Return the largest error of the time of entry into the gate, and up to which angle."""
    worst, least = 0.0, math.inf
    sticks = stopped = 0
    for mine, exact in zip(pick(answer, "whispering"), pick(truth, "whispering"), strict=False):
        if mine["value"] is None:
            stopped += mine["ended"].strip() == "stopped"
            sticks += mine["trapped"]
            continue
        worst = max(worst, abs(float(Decimal(mine["value"]) - Decimal(exact["value"]))))
        least = min(least, float(mine["parameter"]))
    if not math.isfinite(least):
        return "-"
    notes = [f"{sticks} stick" if sticks else "", f"{stopped} too slow" if stopped else ""]
    tail = ", ".join(note for note in notes if note)
    return f"{short(worst)} down to {short(least)}" + (f"; {tail}" if tail else "")


def corners(answer: Answer, _: Answer) -> str:
    """Return how many paths beside the corner are wrong, and the largest distance of those."""
    wrong = pick(answer, "corner shots on the wrong side")
    if not wrong:
        return "-"
    far = number(pick(answer, "corner farthest wrong shot")[0]["value"])
    return f"{short(number(wrong[0]['value']))}, within {short(far)}"


def axial(answer: Answer, truth: Answer) -> str:
    """Return the error of the height after 100 time units, largest of all, and at slope 0."""
    lines = pick(answer, "along the axis")
    if not lines:
        return "-"
    error = [abs(float(Decimal(mine["value"]) - Decimal(exact["value"])))
             for mine, exact in zip(lines, pick(truth, "along the axis"), strict=True)]  # fmt: skip
    return f"{short(max(error[2:-1]))}; slope 0: {short(error[-1])}"


def across(answer: Answer, _: Answer) -> str:
    """Return the largest relative error of the crossing time, and the slowest crossing."""
    lines = pick(answer, "across a channel")
    seen = [line for line in lines[:-1] if line["value"] is not None]
    if not seen:
        return "-"
    worst = max(abs(number(line["value"])) for line in seen)
    slowest = min(float(line["parameter"]) for line in seen)
    return f"{short(worst)} down to {short(slowest)}; u_x = 0: {lines[-1]['trapped']} trapped"


def diameters(answer: Answer, _: Answer) -> str:
    """Return the error of a diameter after 2000 time units, and whether it is found trapped."""
    lines = pick(answer, "upright diameter") + pick(answer, "slanted diameter")
    if not lines:
        return "-"
    off = max(number(line["value"]) for line in lines)
    return f"{short(off)}; {sum(line['trapped'] for line in lines)} of 2 trapped"


def ties(answer: Answer, _: Answer) -> str:
    """Return how many orders in memory, of 4 x 24, change the fate of a particle."""
    lines = pick(answer, "ties")
    return short(sum(number(line["value"]) for line in lines)) if lines else "-"


def extreme(name: str) -> Callable[[Answer, Answer], str]:
    """Return a function that counts particles lost, NaN or in the wrong half in an extreme case."""

    def count(answer: Answer, _: Answer) -> str:
        line = pick(answer, name)[0]
        text = short(line["lost"] + line["not_a_number"] + abs(number(line["value"])))
        return text + (f"; stopped at t = {short(number(line['reached']))}"
                       if line["ended"].strip() == "stopped" else "")  # fmt: skip

    return count


def late_clock(answer: Answer, _: Answer) -> str:
    """Return the largest difference of an event's time since the start."""
    value = number(pick(answer, "clock at 1e12")[0]["value"])
    return "other events" if value < 0 else short(value)


def long_run(answer: Answer, _: Answer) -> str:
    """Return hits, lost particles, the drift of the speed and the distance beyond a wall."""
    line = pick(answer, "long run")[0]
    wrong = abs(number(pick(answer, "long run, count of half 1")[0]["value"]))
    lost = line["lost"] + line["not_a_number"] + int(wrong)
    return (f"{short(float(line['hits']))} hits: {lost} lost, "
            f"{short(number(line['speed_error']))}, {short(number(line['value']))}")  # fmt: skip


DESCRIPTIONS: dict[str, Callable[[Answer, Answer], str]] = {
    "whispering, 1e-3 ... 1e-12: error of the exit time": whispering,
    "beside a corner, 2^-4 ... 2^-59: shots of 1120 on the wrong side": corners,
    "along the axis, slope 1e-5 ... 1e-15: error of y at t = 100": axial,
    "across a channel, u_x = 1e-3 ... 1e-15: relative error of the crossing's time": across,
    "two diameters: how far off at t = 2000": diameters,
    "four entries at one time: orders in memory of 96 that matter": ties,
    "N = 1: lost": extreme("N = 1"),
    "T = 0: lost": extreme("T = 0"),
    "w' = 0: lost": extreme("w' = 0"),
    "w one digit below 2r: lost": extreme("w near 2r"),
    "w = w' = 1.9999: lost": extreme("w and w' near 2r"),
    "w = w' = 1e-9: lost": extreme("openings of 1e-9"),
    "clock at 1e12: event times differ by": late_clock,
    "long run: lost, off the speed, beyond a wall": long_run,
}


def table(answers: dict[tuple[str, str], Answer]) -> list[Row]:
    """Return the rows: a case, an engine, and the result of each precision."""
    truth = answers["excursion", "real128"]
    return [
        {"case": case, "engine": engine,
         **{precision: describe(answers[engine, precision], truth) for precision in PRECISIONS}}
        for case, describe in DESCRIPTIONS.items() for engine in ENGINES
    ]  # fmt: skip


def lines_of(rows: Sequence[Row]) -> list[list[str]]:
    """Return lines of the page's table; engines without trajectories lack some cases."""
    lines = []
    last = ""
    for row in rows:
        cells = [row[precision] for precision in PRECISIONS]
        if all(cell == "-" for cell in cells):
            continue
        lines.append([row["case"] if row["case"] != last else "", f"`{row['engine']}`", *cells])
        last = row["case"]
    return lines


def tables(study: Study, rows: Sequence[Row], visits: Sequence[Row]) -> None:
    """Write the tables of the page: every case, and single visits."""
    study.table("stability", ["case", "engine", *PRECISIONS], lines_of(rows))
    head = ["`excursion`", "w", "visits", "worst error over condition", "other side of a corner"]
    study.table("visits", head, [
        [row["input"], *(text.number(row[name], digits) for name, digits in
                         (("channel1_width", 1), ("visits", 2), ("worst", 2))), str(row["corner"])]
        for row in visits
    ])  # fmt: skip


def figure_visits(rows: Sequence[Row]) -> Figure:
    """Draw the errors of single visits over their condition number, in units of the precision."""
    made = style.figure(style.COLUMN * 1.4, 3.0)
    axes = made.subplots()
    for row, colour in zip(rows, style.CYCLE, strict=False):
        counts = np.array(row["histogram"], float)
        edge = 10.0 ** (np.arange(-len(counts), 0) / 10)
        use = (counts > 0) & (edge > 1e-22)
        axes.loglog(edge[use], counts[use] / counts.sum(), ".-", color=colour,
                    label=f"{row['input']}, w = {row['channel1_width']:.2g}")  # fmt: skip
    axes.axvline(
        REQUIRED, color=style.GREY, ls="--", lw=0.8, label=f"allowed in real64: {REQUIRED:g}"
    )
    axes.set_xlabel("error of a visit over its condition number")
    axes.set_ylabel("share of visits")
    made.legend(loc="outside upper center", ncols=2, fontsize=7)
    return made


def run(study: Study) -> None:
    """Run every engine in every precision; store the table, draw `visits`."""
    study.folder.mkdir(parents=True, exist_ok=True)
    seconds = str(study.pick(0.3, 5.0))
    pairs = [(engine, precision) for engine in ENGINES for precision in reversed(PRECISIONS)]
    questions = [
        Question(f"stability-{engine}-{precision}", precision,
                 ("stability", engine, str(int(COLLISIONS[engine, precision]
                                               * study.pick(1, FULL))), seconds),
                 study.pick(900, 90000))
        for engine, precision in pairs
    ]  # fmt: skip
    words = {f"{one:g}": ("disc", str(one), str(other)) for one, other in VISITS}
    compared = compared_visits(study, "visits", words, study.pick(1e6, 1e7))
    answers = dict(zip(pairs, ask(study, questions), strict=True))
    rows = table(answers)
    compared.sort(key=lambda row: BITS[row["input"]])
    numbers = {"table": rows, "visits": compared}
    study.keep("stability", numbers)
    tables(study, rows, compared)
    seen = [row for row in compared if row["same"] > row["visits"] / 2]
    study.draw(figure_visits(seen), "visits")

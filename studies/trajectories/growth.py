"""Error of a trajectory against its cost: every engine, every precision, steps over five decades.

All start from the same file and are compared with the engine `collision` in quadruple precision.
Two paths that differ by a rounding error separate as exp(lambda t); lambda is measured from the
errors and, independently, from the tangent map of the free billiard.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal
from typing import TYPE_CHECKING, Any

import numpy as np

from postproc.figures import style
from studies.common.probes import EPSILON, PRECISIONS, Answer, Question, ask
from studies.common.text import number

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from studies.common import study

    Floats = NDArray[np.float64]

NUMBER = 400
GATES = {"free": NUMBER, "gated": 7}  # thresholds
EXACT = ("excursion", "collision", "synchronous")
TIMES = (1, 2, 5, 10, 20, 30, 40, 50, *range(60, 300, 20), *range(300, 650, 50))
STEP_TIMES = (1, 2, 5, 10)
COMPARED = 10.0  # the time at which engines are compared
# steps, and the precisions in which they are affordable
STEPS = {
    "real32": (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6),
    "real64": (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6),
    "real128": (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4),
}
ORDER_STEPS = (3e-5, 3e-3)  # the order is fitted between these
REFERENCE = ("collision", "real128")
ASTRAY = 0.1  # distance above which a particle is on another path
WIDTH1, WIDTH2 = 0.3, 0.01
AROUND = 2.0 * (1.0 + math.sqrt(1.0 - WIDTH1**2 / 4) + math.sqrt(1.0 - WIDTH2**2 / 4))  # length

COLOUR = {"real32": style.VERMILION, "real64": style.BLUE, "real128": style.GREEN}
MARKER = {"excursion": "s", "collision": "o", "synchronous": "^", "timestep": "."}


@dataclass(frozen=True)
class Case:
    """One run: the gate's case, engine, precision, and step (0 for exact engines)."""

    gate: str
    engine: str
    precision: str
    step: float = 0.0

    def question(self) -> Question:
        """Return the question to the probe."""
        times = STEP_TIMES if self.step else TIMES
        step = f"-{self.step:.0e}" if self.step else ""
        return Question(
            f"trajectory-{self.gate}-{self.engine}-{self.precision}{step}",
            self.precision,
            ("trajectory", self.engine, repr(self.step), "start.txt", str(NUMBER),
             str(GATES[self.gate]), *map(str, times)),
        )  # fmt: skip


def cases() -> list[Case]:
    """List all runs; the reference of each gate comes first."""
    made = []
    for gate in GATES:
        made += [Case(gate, engine, precision)
                 for engine in ("collision", "excursion", "synchronous")
                 for precision in reversed(PRECISIONS)]  # fmt: skip
        made += [Case(gate, "timestep", precision, step)
                 for precision in PRECISIONS for step in STEPS[precision]]  # fmt: skip
    return made


def start_file(number: int, seed: int = 1) -> str:
    """Return lines x y ux uy of particles uniform in the urns, half in each, of all directions."""
    random = np.random.default_rng(seed)
    centre = 0.5 + math.sqrt(1.0 - WIDTH1**2 / 4)
    lines = []
    while len(lines) < number:
        x, y = random.uniform(-1.0, 1.0, 2)
        angle = random.uniform(0.0, 2.0 * math.pi)
        if math.hypot(x, y) < 0.98:
            side = 1 if len(lines) % 2 else -1
            one = (side * (centre + x), y, math.cos(angle), math.sin(angle))
            lines.append(" ".join(repr(float(value)) for value in one))
    return "\n".join(lines) + "\n"


def places(answer: Answer) -> dict[float, list[list[Decimal]]]:
    """Return [x, y] of all particles by time."""
    return {float(one["time"]): [one["x"], one["y"]] for one in answer if "time" in one}


def distances(found: list[list[Decimal]], truth: list[list[Decimal]]) -> Floats:
    """Return the distance of each particle from the reference, with the period of the circuit."""
    across = [float(abs(a - b)) for a, b in zip(found[0], truth[0], strict=True)]
    up = [float(a - b) for a, b in zip(found[1], truth[1], strict=True)]
    return np.hypot([min(value, abs(AROUND - value)) for value in across], up)


def event_errors(answer: Answer, truth: Answer, until: float) -> tuple[Floats, float]:
    """Return errors of event times as long as a particle has the right events, and their share.

    A gate's reversals are left out: they belong to no particle.
    """
    mine, theirs = (_by_particle(one, until) for one in (answer, truth))
    errors: list[float] = []
    total = sum(map(len, theirs.values()))
    for particle, events in theirs.items():
        for event, expected in zip(mine.get(particle, []), events, strict=False):
            if event[1:] != expected[1:]:
                break
            errors.append(abs(float(event[0] - expected[0])))
    return np.array(errors), len(errors) / max(total, 1)


def _by_particle(answer: Answer, until: float) -> dict[int, list[tuple[Decimal, int, int]]]:
    log = next(one for one in answer if "event_time" in one)
    events: dict[int, list[tuple[Decimal, int, int]]] = {}
    columns = (log[name] for name in ("event_time", "kind", "where", "particle"))
    for time, kind, where, particle in zip(*columns, strict=True):
        if int(kind) != 2 and float(time) <= until:
            events.setdefault(int(particle), []).append((time, int(kind), int(where)))
    return events


def measure(case: Case, answer: Answer, truth: Answer) -> dict[str, Any]:
    """Return the numbers of one run against the reference."""
    here, there = places(answer), places(truth)
    head = next(one for one in answer if "engine" in one)
    errors = {time: distances(here[time], there[time]) for time in here}
    events, share = event_errors(answer, truth, COMPARED)
    floor = EPSILON[case.precision] * 1e-6  # for logarithms of differences that are 0
    return {
        "gate": case.gate, "engine": case.engine, "precision": case.precision, "step": case.step,
        "seconds_per_particle_time": float(head["seconds_per_particle_time"]),
        "time": list(errors),
        "median": [float(np.median(one)) for one in errors.values()],
        "mean_log": [float(np.log(np.maximum(one, floor)).mean()) for one in errors.values()],
        "worst": [float(one.max()) for one in errors.values()],
        "astray": [float((one > ASTRAY).mean()) for one in errors.values()],
        "not_a_number": int(sum(not np.isfinite(one).all() for one in errors.values())),
        "event_median": float(np.median(events)) if events.size else math.nan,
        "events_right": share,
    }  # fmt: skip


def fit_growth(row: dict[str, Any]) -> float:
    """Return lambda from the mean logarithm of the error, while hardly any particle is astray."""
    time, mean, astray = (np.array(row[name]) for name in ("time", "mean_log", "astray"))
    use = (time >= 30) & (astray < 0.06)
    return float(np.polyfit(time[use], mean[use], 1)[0]) if use.sum() > 2 else math.nan


def horizon(row: dict[str, Any]) -> float:
    """Return the time at which the median error exceeds `ASTRAY`; NaN if it does not."""
    time, median = np.array(row["time"], float), np.array(row["median"])
    past = np.flatnonzero(median > ASTRAY)
    if past.size == 0 or past[0] == 0:
        return math.nan
    at = past[0]
    ends = np.log(np.maximum(median[at - 1 : at + 1], 1e-300))
    share = (math.log(ASTRAY) - ends[0]) / (ends[1] - ends[0])
    return float(time[at - 1] + share * (time[at] - time[at - 1]))


def predicted_horizon(rate: float) -> dict[str, float]:
    """Return by precision when an error of rounding has grown to `ASTRAY`."""
    return {name: math.log(ASTRAY / eps) / rate for name, eps in EPSILON.items()}


def by_name(rows: Sequence[dict[str, Any]], of: Callable[[dict], float]) -> dict[str, float]:
    """Return a number of each row by engine and precision."""
    return {f"{row['engine']} {row['precision']}": of(row) for row in rows}


def orders(rows: Sequence[dict[str, Any]], gate: str, precision: str) -> dict[str, float]:
    """Return the orders of `timestep`: of positions, event times, and the share astray."""
    mine = [row for row in rows if row["engine"] == "timestep" and row["gate"] == gate
            and row["precision"] == precision
            and ORDER_STEPS[0] <= row["step"] <= ORDER_STEPS[1]]  # fmt: skip
    step = np.log([row["step"] for row in mine])
    at = [row["time"].index(COMPARED / 2) for row in mine]
    values = {
        "place": [row["median"][k] for row, k in zip(mine, at, strict=True)],
        "event_time": [row["event_median"] for row in mine],
        "worst": [row["astray"][-1] + 0.5 / NUMBER for row in mine],
    }
    return {name: float(np.polyfit(step, np.log(value), 1)[0]) for name, value in values.items()}


def find(rows: Sequence[dict[str, Any]], **wanted: object) -> list[dict[str, Any]]:
    """Return the rows with these values."""
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def at_compared(row: dict[str, Any], name: str = "median") -> float:
    """Return a row's number at the time of comparison."""
    return row[name][row["time"].index(COMPARED)]


def _cost_panel(axes: Axes, rows: Sequence[dict[str, Any]], gate: str, what: str) -> None:
    for precision in PRECISIONS:
        steps = find(rows, gate=gate, engine="timestep", precision=precision)
        value = [at_compared(row) if what == "places" else row["event_median"] for row in steps]
        cost = [row["seconds_per_particle_time"] for row in steps]
        label = f"timestep, {precision}"
        axes.loglog(cost, value, ".-", color=COLOUR[precision], lw=0.9, label=label)
        for engine in EXACT:
            for row in find(rows, gate=gate, engine=engine, precision=precision):
                if (engine, precision) == REFERENCE:
                    axes.axvline(row["seconds_per_particle_time"], color=COLOUR[precision], ls=":")
                    continue
                error = at_compared(row) if what == "places" else row["event_median"]
                axes.loglog(row["seconds_per_particle_time"], error, MARKER[engine],
                            color=COLOUR[precision], mfc="none", ms=5)  # fmt: skip
    axes.set_ylim(1e-36, 10)
    axes.set_yticks([1e-32, 1e-24, 1e-16, 1e-8, 1])


def figure_cost(rows: Sequence[dict[str, Any]]) -> Figure:
    """Draw error against cost: positions and event times, free and gated."""
    made = style.figure(style.PAGE, 5.4)
    panels = made.subplots(2, 2, sharex=True, sharey=True)
    for line, gate in zip(panels, GATES, strict=True):
        for axes, what in zip(line, ("places", "event times"), strict=True):
            _cost_panel(axes, rows, gate, what)
            name = "free circuit" if gate == "free" else "gated, T = 7"
            axes.set_title(f"{what}, {name}")
    for axes in panels[1]:
        axes.set_xlabel("seconds per particle and time unit")
    for axes in panels[:, 0]:
        axes.set_ylabel(f"median error at t = {COMPARED:g}")
    for engine in EXACT:
        panels[0, 1].plot([], [], MARKER[engine], color=style.BLACK, mfc="none", ms=5, label=engine)
    panels[0, 1].plot([], [], ":", color=COLOUR["real128"], label="cost of the reference")
    handles, labels = panels[0, 1].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside lower center", ncols=3)
    return made


def figure_growth(rows: Sequence[dict[str, Any]], rate: float, found: dict[str, Any]) -> Figure:
    """Draw the growth of errors in time, and the errors of `timestep` against the step.

    Lines have the rates of the tangent map: of many particles for a long time, and of these
    particles for this time, which their errors follow.
    """
    rates = {rate: (":", "all"), found["lyapunov_same_start"]: ("-.", "these particles")}
    made = style.figure(style.PAGE, 3.8)
    left, right = made.subplots(1, 2)
    for precision in PRECISIONS:
        for engine, line in (("collision", "-"), ("excursion", "--")):
            for row in find(rows, gate="free", engine=engine, precision=precision):
                if (engine, precision) != REFERENCE:
                    left.semilogy(row["time"], np.maximum(row["median"], 1e-36), line,
                                  color=COLOUR[precision],
                                  label=f"{engine}, {precision}")  # fmt: skip
        for growth, (dashes, _) in rates.items():
            time = np.array([0.0, math.log(1 / EPSILON[precision]) / growth])
            left.semilogy(time, EPSILON[precision] * np.exp(growth * time), dashes,
                          color=style.GREY, lw=0.9)  # fmt: skip
    for growth, (dashes, whose) in rates.items():
        left.plot(
            [],
            [],
            dashes,
            color=style.GREY,
            lw=0.9,
            label=rf"$\epsilon\,e^{{\lambda t}}$, $\lambda = {growth:.3f}$: {whose}",
        )
    left.set_xlabel("time")
    left.set_ylabel("median error of places, free circuit")
    left.set_ylim(1e-36, 1e2)
    left.set_yticks([1e-32, 1e-24, 1e-16, 1e-8, 1])
    left.legend(fontsize=6.5, loc="lower right")
    for precision in PRECISIONS:
        steps = find(rows, gate="free", engine="timestep", precision=precision)
        step = [row["step"] for row in steps]
        right.loglog(step, [at_compared(row) for row in steps], "o-", color=COLOUR[precision],
                     mfc="none", label=f"median, {precision}")  # fmt: skip
        right.loglog(step, [at_compared(row, "astray") or math.nan for row in steps], "x--",
                     color=COLOUR[precision], lw=0.7,
                     label=f"share astray, {precision}")  # fmt: skip
    order = found["order"]["free"]["place"]
    right.set_title(f"timestep: order {order:.2f}", fontsize=9)
    right.set_xlabel("step h")
    right.set_ylabel(f"error of places at t = {COMPARED:g}")
    right.legend(fontsize=7)
    return made


def table(work: study.Study, numbers: dict[str, Any]) -> None:
    """Write cost, error, growth and horizons of every exact engine in the free circuit."""
    rows = []
    for row in find(numbers["rows"], gate="free"):
        if row["engine"] not in EXACT:
            continue
        name = f"{row['engine']} {row['precision']}"
        known = (row["engine"], row["precision"]) == REFERENCE
        rows.append([
            f"`{row['engine']}`", row["precision"], number(row["seconds_per_particle_time"], 2),
            "reference" if known else number(at_compared(row), 2),
            *(number(numbers[key].get(name), 3) for key in ("fitted", "horizon", "horizon_gated")),
        ])  # fmt: skip
    head = ["engine", "precision", "seconds per particle and time unit", "median error at t = 10",
            "lambda", "horizon, free", "horizon, T = 7"]  # fmt: skip
    work.table("growth", head, rows)


def asked(work: study.Study, questions: Sequence[Question]) -> tuple[dict, list[Answer]]:
    """Return the growth rate of the tangent map, and the answers to questions about the start."""
    work.folder.mkdir(parents=True, exist_ok=True)
    (work.folder / "start.txt").write_text(start_file(NUMBER), encoding="utf-8")
    words = ("lyapunov", str(WIDTH1), str(WIDTH2), str(int(work.pick(2000, 20000))), "2000")
    ((tangent,), *answers) = ask(work, [Question("lyapunov", "real64", words), *questions])
    return tangent, answers


def run(work: study.Study) -> None:
    """Run all engines in all precisions; draw `cost` and `growth`."""
    todo = cases()
    same_start = Question(
        "lyapunov-start", "real64",
        ("lyapunov", str(WIDTH1), str(WIDTH2), str(NUMBER), "250", "start.txt"),
    )  # fmt: skip
    tangent, ((same,), *answers) = asked(work, [same_start, *(case.question() for case in todo)])
    truth = {case.gate: answer for case, answer in zip(todo, answers, strict=True)
             if (case.engine, case.precision) == REFERENCE}  # fmt: skip
    rows = [measure(case, answer, truth[case.gate])
            for case, answer in zip(todo, answers, strict=True)]  # fmt: skip
    rate = float(tangent["lyapunov"])
    free = [row for row in find(rows, gate="free") if row["engine"] in EXACT]
    compared = [row for row in free if (row["engine"], row["precision"]) != REFERENCE]
    found = {
        "number": NUMBER, "lyapunov": rate, "lyapunov_error": float(tangent["error"]),
        "lyapunov_same_start": float(same["second_half"]),
        "fitted": by_name(compared, fit_growth), "horizon": by_name(compared, horizon),
        "horizon_gated": by_name(
            [row for row in find(rows, gate="gated") if row["engine"] in EXACT], horizon),
        "predicted_horizon": predicted_horizon(rate),
        "order": {gate: orders(rows, gate, "real64") for gate in GATES},
        "rows": rows,
    }  # fmt: skip
    work.keep("trajectories", found)
    table(work, found)
    work.draw(figure_cost(rows), "cost")
    work.draw(figure_growth(rows, rate, found), "growth")

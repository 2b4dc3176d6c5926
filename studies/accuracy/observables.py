"""Chart two: the errors of the paper's observables against cost, for every rung of the ladder.

Quantities: chi and the net current at T = 7, and the T of the upper transition, where chi falls
through 0.3; N = 1000, w = 0.3, w' = 0.01, r = l = l' = 1. Every engine gets the same CPU time, in
eight replicas, whose scatter is the statistical error. The bias is the difference to long runs of
`excursion`. A theory has no statistical error; its cost is the time to solve it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from postproc.advice import transients
from postproc.reading.grid import open_results
from studies.accuracy import charts, ladder
from studies.accuracy.ladder import QUANTITIES, Answer
from studies.common.numbers import with_errors
from studies.common.text import measured, number, seconds

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from studies.common.study import Study

# Net currents of other sets of runs of this length (docs/theory.md#circulation): mean, error, total
# time.
OTHER_SETS = ((1.0147, 0.0015, 2.4e7), (1.0165, 0.0021, 4.0e7))
TRANSIENT = 500.0  # of battery.nml
AVERAGED = (2, 7, 14, 18)  # T at which the paper's average is compared with that over time


def long_runs(study: Study) -> Path:
    """Make long runs at T = 7; return their file."""
    changes = {
        "run": {"duration": study.pick(1.0e6, 8.0e6)},
        "scan": {"replicas": int(study.pick(24, 64))},
    }
    return study.run("long", "long", changes)


def total_time(path: Path) -> float:
    """Return the total measured time of runs."""
    results = open_results(path)
    return float((results["time"] - results["transient_time"]).sum())


def reference(study: Study) -> dict[str, Answer]:
    """Return the quantities from long runs of `excursion`; the current also from the other sets."""
    path = long_runs(study)
    found = ladder.battery_answers(path)
    one = found["current"]
    sets = ((one.value, one.error, total_time(path)), *OTHER_SETS)
    found["own_current"] = one
    found["current"] = Answer(*by_time(sets), one.seconds)
    changes = {"run": {"duration": study.pick(2.0e5, 2.0e6)}, "scan": {"replicas": 16}}
    changes["particles"] = {"seed": 77}  # so that it is independent of the rung
    path = study.run("transition", "transition_reference", changes)
    found["transition"] = ladder.transition_answer(path)
    return found


def by_time(sets: Sequence[tuple[float, float, float]]) -> tuple[float, float]:
    """Return mean and error of sets (mean, error, time), weighted by their time.

    Not by their errors: a set with a long circulation has a larger mean and a larger error.
    """
    value, error, time = np.array(sets).T
    weight = time / time.sum()
    return float(weight @ value), float(np.hypot.reduce(weight * error))


def lacking(spent: float, per_time: float, chi: float) -> float:
    """Return the relative part of the mean current that is missing in a rung's runs of finite age.

    Parameters
    ----------
    spent, per_time : CPU time of all runs, and per unit of time.
    chi : of the stationary state.
    """
    lasting = spent / (per_time * ladder.REPLICAS) - TRANSIENT
    one = np.ones(1)
    return float(transients.missing(ladder.BATTERY, chi, TRANSIENT * one, lasting * one)[0])


def averages(study: Study) -> list[dict[str, float]]:
    """Return chi averaged over time and, as the paper does, over wall collisions, for several T.

    Both are from the same runs of `collision`, so that their difference has a small error.
    """
    changes = {
        "run": {"engine": "collision", "duration": study.pick(4.0e3, 4.0e4)},
        "scan": {"threshold": list(AVERAGED)},
        "gate": {"threshold": None},
        "particles": {"urn1_number": 500},
    }
    rows = []
    results = open_results(study.run("battery", "averages", changes))
    for threshold in AVERAGED:
        one = results.sel(threshold=threshold)
        time, hits = (one[name].values for name in ("chi", "chi_collision"))
        seen = with_errors(chi=time, less=hits - time)
        rows.append({"threshold": threshold, "error": seen.pop("chi_error"), **seen})
    return rows


def row(name: str, kind: str, answers: dict[str, Answer], truth: dict[str, Answer]) -> dict:
    """Return one rung's line: values, errors, costs, and biases relative to the reference.

    `kind` is "theory", "exact" or "model".
    """
    line: dict[str, object] = {"name": name, "kind": kind}
    for quantity in QUANTITIES:
        one, true = answers[quantity], truth[quantity]
        line[quantity] = {
            "value": one.value, "error": one.error, "seconds": one.seconds,
            "bias": one.value / true.value - 1.0,
            "bias_error": math.hypot(one.error, true.error) / true.value,
            "relative_error": one.error / true.value,
        }  # fmt: skip
    return line


def _with_bias(one: dict) -> str:
    if not math.isfinite(one["value"]):
        return f"none from {ladder.SCANNED[0]} to {ladder.SCANNED[-1]}"
    if one["error"]:
        off = measured(100.0 * one["bias"], 100.0 * one["bias_error"])
        return f"{measured(one['value'], one['error'])} ({off} %)"
    return f"{number(one['value'], 4)} ({number(100.0 * one['bias'], 2)} %)"


def tables(study: Study, rows: Sequence[dict], averaged: Sequence[dict]) -> None:
    """Write the tables of the page: the rungs, and the paper's average beside that over time."""
    titles = ("chi, T = 7", "net current, T = 7", "transition T")
    study.table("rungs", ["rung", "CPU time", *(f"{title} (bias)" for title in titles)], [
        [ladder.label(line["name"]), seconds(line["chi"]["seconds"]),
         *(_with_bias(line[q]) for q in QUANTITIES)]
        for line in rows
    ])  # fmt: skip
    study.table("averages", ["T", "chi, average over time", "by collisions less that"], [
        [str(one["threshold"]), measured(one["chi"], one["error"]),
         measured(one["less"], one["less_error"])]
        for one in averaged
    ])  # fmt: skip


def run(study: Study) -> None:
    """Run every rung, draw `observables`, store the numbers."""
    truth = reference(study)
    rows = [
        row(model.name, "theory", ladder.theory_answers(model), truth)
        for model in ladder.theories()
    ]
    for rung in (*ladder.RUNGS, *(ladder.LONGER if study.full else ())):
        answers, per_time = ladder.run_rung(study, rung, study.pick(10.0, 200.0))
        line = row(rung.name, "exact" if rung.exact else "model", answers, truth)
        if rung.exact:
            line["lack"] = lacking(answers["current"].seconds, per_time, truth["chi"].value)
        rows.append({**line, "per_time": per_time})
    numbers = {
        "reference": {name: vars(one) for name, one in truth.items()}, "rows": rows,
        "reference_time": total_time(long_runs(study)),
        "averages": averages(study),
    }  # fmt: skip
    study.keep("observables", numbers)
    tables(study, rows, numbers["averages"])
    study.draw(charts.figure_observables(rows), "observables")

"""The ladder over the map: the error of every rung at points of T and w', against processor time.

Quantities: chi, the polarised current over chi, so that an error of chi does not hide one of the
conductance, and the T at which chi falls through 0.3 at each w'. Runs begin polarised. Their
transient is three relaxation times of directions, or 9000 next to a transition; the reference has
twice that, which shows whether it was enough. It is part of the cost of every run. Errors are root
mean squares over the points, less the statistical errors of the runs.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from postproc.advice.advice import HALFWAY
from postproc.advice.transients import of_chi
from postproc.reading.grid import open_results
from studies.accuracy import charts, ladder
from studies.accuracy.ladder import BATTERY, LONGER, QUANTITIES, RUNGS
from studies.accuracy.ladder_errors import SURE, TOLERANCES, cancelling, cheapest
from studies.common.text import number, percent, seconds

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from postproc.theory.model import Model
    from studies.accuracy.ladder import Rung
    from studies.common.study import Study

    Floats = NDArray[np.float64]

# T well below the upper transition of a w', and across it
SLICES = {
    0.01: ((6, 9, 12), (14, 15, 16, 17, 18)),
    0.025: ((7, 9, 11), (13, 14, 15, 16, 17)),
    0.06: ((9, 10, 11), (12, 13, 14, 15, 16)),
}
FAST = ("excursion", "reservoir")  # cheap enough for replicas, whose scatter gives the errors
SLOWEST = "timestep 0.003"  # in full runs only
HEADS = {"chi": "chi", "current": "current over chi", "transition": "transition T"}
SHOWN = {"chi": lambda value: number(value, 2), "current": percent, "transition": percent}


@dataclass(frozen=True)
class Told:
    """Results of a rung at all points, in the order of `SLICES`; every field has shape (point,).

    Attributes
    ----------
    chi, current : mean, and polarised current over chi; NaN where there is none.
    chi_error, current_error : standard errors; 0 of a theory, NaN of a single run.
    seconds : processor time per unit of time; of a theory that of a point.
    measured, transient : measured time of all replicas, and transient of each; 0 of a theory.
    """

    chi: Floats
    current: Floats
    chi_error: Floats
    current_error: Floats
    seconds: Floats
    measured: Floats
    transient: Floats


def points() -> list[tuple[float, int, bool]]:
    """Return (w', T, whether the point is next to the transition) of all points."""
    return [
        (width, threshold, bool(zone))
        for width, zones in SLICES.items()
        for zone, thresholds in enumerate(zones)
        for threshold in thresholds
    ]


def transients() -> tuple[float, float]:
    """Return the transients away from a transition and next to one."""
    away, near = (of_chi(BATTERY, critical=critical) for critical in (False, True))
    return away, near


def ask(model: Model, ages: Floats) -> Told:
    """Return a theory's results and its processor time, that of other programs included.

    ages : those of runs at each point, for theories whose current grows with the age.
    """
    found = []
    for (width, threshold, _), age in zip(points(), ages.tolist(), strict=True):
        one = replace(BATTERY, channel2_width=width, threshold=threshold, age=age)
        if not found:
            ladder.ask(model, one)  # reads and prepares what is needed once
        began = _processor()
        chi, current = ladder.ask(model, one)
        found.append((chi, abs(current) / chi if chi else math.nan, _processor() - began))
    chi, current, seconds = np.array(found).T
    none = np.zeros(chi.size)
    return Told(chi, current, none, none, seconds, none, none)


def _processor() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def run_points(
    study: Study, rung: Rung, measured: float, replicas: int, *, doubled: bool = False
) -> Told:
    """Run an engine at all points, for `measured` each; `doubled`: with twice the transient."""
    columns = []
    name = "reference" if doubled else ladder.stem(rung)
    for width, zones in SLICES.items():
        for transient, thresholds in zip(transients(), zones, strict=True):
            wait = 2.0 * transient if doubled else transient
            changes = {
                "table": {"channel2_width": width},
                "particles": {"seed": 6 if doubled else 5},
                "run": {
                    **ladder.engine_keys(rung),
                    "duration": wait + measured,
                    "transient_duration": wait,
                },
                "scan": {"threshold": list(thresholds), "replicas": replicas},
            }
            stem = f"map_{name}_{width:g}_{thresholds[0]}".replace(".", "p")
            columns.append(_read(study.run("ladder_map", stem, changes), wait))
    return Told(*np.concatenate(columns, axis=1))


def _read(path: Path, transient: float) -> Floats:
    """Return the fields of `Told` of a file, shape (field, point)."""
    results = open_results(path)
    names = ("chi", "polarised_current", "cpu_seconds", "time")
    chi, current, seconds, time = (results[name].values for name in names)
    count, waited = chi.shape[1], np.full(len(chi), transient)
    per_time = seconds.sum(axis=1) / time.sum(axis=1)
    return np.array(
        [*ladder.shares(chi, current), per_time, time.sum(axis=1) - count * waited, waited]
    )


def scatter(truth: Told) -> Told:
    """Return the standard errors of one unit of measured time as `Told`, for runs of one replica.

    From long runs of the billiard, whose measured time is far longer than their correlation time.
    """
    root = np.sqrt(truth.measured)
    return replace(
        truth, chi_error=truth.chi_error * root, current_error=truth.current_error * root
    )


def with_errors(result: Told, one_unit: Told) -> Told:
    """Return a rung's results with the billiard's errors if it has none of its own."""
    root = np.sqrt(np.maximum(result.measured, 1.0))
    return replace(
        result,
        chi_error=np.where(np.isnan(result.chi_error), one_unit.chi_error / root, result.chi_error),
        current_error=np.where(
            np.isnan(result.current_error), one_unit.current_error / root, result.current_error
        ),
    )


def transitions(result: Told) -> tuple[Floats, Floats]:
    """Return the T at which chi falls through `HALFWAY` at each w', and its standard error."""
    widths, thresholds, near = (np.array(column) for column in zip(*points(), strict=True))
    found = []
    for width in SLICES:
        at = np.flatnonzero((widths == width) & near)
        value = ladder.transition(thresholds[at], result.chi[at])
        moved = []
        for one in at:
            chi = result.chi.copy()
            chi[one] += result.chi_error[one]
            moved.append(ladder.transition(thresholds[at], chi[at]) - value)
        found.append((value, math.sqrt(np.sum(np.square(moved)))))
    values, errors = np.array(found).T
    return values, errors


def _of(result: Told, quantity: str) -> tuple[Floats, Floats]:
    if quantity == "transition":
        return transitions(result)
    if quantity == "chi":
        return result.chi, result.chi_error
    return result.current, result.current_error


def compare(result: Told, truth: Told, quantity: str) -> dict[str, float]:
    """Return the error of a rung over the points that are polarised in the reference.

    Absolute for chi, relative for the others. `bias`: root mean square of the differences, less the
    errors of both; `bias_error`: its error; `seen`: whether it is significant; `missing`: number of
    points without a result of the rung; `chance`: root mean square of the rung's statistical error.
    """
    (value, error), (true, its) = _of(result, quantity), _of(truth, quantity)
    polarised = np.isfinite(true) if quantity == "transition" else truth.chi > HALFWAY
    known = polarised & np.isfinite(value)
    size = np.ones(true.size) if quantity == "chi" else true
    off, own = ((value - true) / size)[known], (error / size)[known]
    noise = np.hypot(own, (its / size)[known])
    count = max(1, off.size)
    square = float(np.sum(off**2 - noise**2)) / count
    apart = math.sqrt(float(np.sum(2.0 * noise**4 + 4.0 * off**2 * noise**2))) / count
    bias = math.sqrt(max(square, 0.0))
    return {
        "bias": bias,
        "bias_error": apart / (2.0 * bias) if square > apart else math.sqrt(max(apart, 0.0)),
        "seen": bool(square > SURE * apart and off.size),
        "missing": int(np.sum(polarised) - np.sum(known)),
        "chance": math.sqrt(float(np.sum(own**2)) / count),
    }


def price(result: Told, truth: Told, quantity: str) -> dict[str, float]:
    """Return the cost of a point: `seconds` in all, and `approach`, the part of the transients.

    For a transition that of all thresholds of one w'. Theories have no transient.
    """
    near = np.array([zone for _, _, zone in points()])
    chosen = near if quantity == "transition" else truth.chi > HALFWAY
    many = near.sum() / len(SLICES) if quantity == "transition" else 1.0
    if not result.measured.any():
        return {"seconds": float(many * result.seconds[chosen].mean()), "approach": 0.0}
    approach = (result.seconds * result.transient)[chosen].mean()
    measured = (result.seconds * result.measured)[chosen].mean()
    return {"seconds": float(many * (approach + measured)), "approach": float(many * approach)}


def row(name: str, kind: str, result: Told, truth: Told) -> dict[str, object]:
    """Return a rung's line; `kind` is "theory", "exact" or "model"."""
    line: dict[str, object] = {"name": name, "kind": kind}
    for quantity in QUANTITIES:
        line[quantity] = {**compare(result, truth, quantity), **price(result, truth, quantity)}
    return line


def doubling(once: Told, twice: Told) -> dict[str, float]:
    """Compare runs with one and with two transients: difference of chi over its error."""
    sigmas = (once.chi - twice.chi) / np.hypot(once.chi_error, twice.chi_error)
    worst = int(np.argmax(np.abs(sigmas)))
    width, threshold, _ = points()[worst]
    return {
        "points": sigmas.size,
        "root_mean_square": math.sqrt(float(np.mean(sigmas**2))),
        "worst": float(sigmas[worst]),
        "worst_width": width,
        "worst_threshold": threshold,
        "mean_near": float(np.mean((once.chi - twice.chi)[[near for *_, near in points()]])),
    }


def _choice(one: tuple[str, float | None]) -> str:
    return "none" if one[1] is None else f"{ladder.label(one[0])}, {seconds(one[1])}"


def tables(study: Study, numbers: dict) -> None:
    """Write the tables of the page: errors and costs of the rungs, the cheapest for each error."""
    head = ["rung", "a point costs", *(f"error of {HEADS[name]}" for name in QUANTITIES)]
    study.table("map_rungs", head, [
        [ladder.label(line["name"]), seconds(line["chi"]["seconds"]),
         *(_error(line[name], name) for name in QUANTITIES)]
        for line in numbers["rows"]
    ])  # fmt: skip
    study.table("map_choice", ["error", *(HEADS[name] for name in QUANTITIES)], [
        [f"{one['error']:g}", *(_choice(one[name]) for name in QUANTITIES)]
        for one in numbers["choice"]
    ])  # fmt: skip


def _error(one: dict, quantity: str) -> str:
    """Return a rung's error: a bound if it is not significant, a star if errors cancel."""
    known = one["bias"] if one["seen"] else (one["bias"] ** 2 + one["bias_error"] ** 2) ** 0.5
    if quantity == "transition" and one["missing"]:
        return "none in reach"
    text = f"{'' if one['seen'] else '< '}{SHOWN[quantity](known)}{' *' if one['cancels'] else ''}"
    return f"{text} ({one['missing']} without)" if one["missing"] else text


def run(study: Study) -> None:
    """Compute every rung at every point, draw `ladder_map`, store the numbers."""
    rungs = {rung.name: rung for rung in (*RUNGS, *LONGER)}
    measured = study.pick(1.2e5, 1.2e6)
    truth = run_points(study, rungs["excursion"], measured, 16, doubled=True)
    one_unit, ages = scatter(truth), truth.transient + 0.5 * measured
    rows = [row(model.name, "theory", ask(model, ages), truth) for model in ladder.theories()]
    once = truth
    for rung in RUNGS:
        if rung.name == SLOWEST and not study.full:
            continue
        fast = rung.name in FAST
        result = run_points(study, rung, study.pick(*(3e4, 3e5) if fast else (1500.0, 15000.0)),
                          8 if fast else 1)  # fmt: skip
        if rung.name == "excursion":
            once = result
        result = with_errors(result, one_unit)
        rows.append(row(rung.name, "exact" if rung.exact else "model", result, truth))
    for line in rows:
        for quantity in QUANTITIES:
            line[quantity]["cancels"] = line["name"] in cancelling(rows, quantity)
    numbers = {
        "rows": rows,
        "points": [list(one) for one in points()],
        "chi": truth.chi.tolist(),
        "chi_error": truth.chi_error.tolist(),
        "polarised": int(np.sum(truth.chi > HALFWAY)),
        "transients": list(transients()),
        "transitions": [one.tolist() for one in transitions(truth)],
        "doubling": doubling(once, truth),
        "choice": [
            {"error": error, **{name: cheapest(rows, name, error) for name in QUANTITIES}}
            for error in TOLERANCES
        ],
    }
    study.keep("ladder_map", numbers)
    tables(study, numbers)
    study.draw(charts.figure_map(rows), "ladder_map")

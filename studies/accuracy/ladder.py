"""The ladder of models: its rungs, the result of each for the battery, and its cost."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from postproc.advice.advice import transition_between as transition
from postproc.reading.grid import open_results
from postproc.theory.circuit import Circuit
from postproc.theory.direction import transfer
from postproc.theory.models import MODELS
from postproc.theory.ports import mean_stay
from postproc.theory.returns import return_chance
from postproc.theory.visits import unit_disc
from studies.common.numbers import mean_of, transition_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from postproc.theory.model import Model
    from studies.common.study import Study

    Floats = NDArray[np.float64]

BATTERY = Circuit(1000, 7)  # of the map, but for T and w'
THRESHOLDS = tuple(range(10, 26))  # at which a theory is evaluated for its transition
SCANNED = (14, 15, 16, 17, 18)  # at which an engine is run for the transition
THEORIES = ("window", "renewal", "direction")
QUANTITIES = ("chi", "current", "transition")
REPLICAS = 8  # of a rung
SHORTEST = 1000.0  # shortest duration of a run, transient included


@dataclass(frozen=True)
class Rung:
    """An engine, with its step.

    Attributes
    ----------
    name : its name in tables.
    engine, step : as in the namelist; step 0: none.
    seconds : CPU time per unit of time at N = 1000, roughly, by which CPU time is allotted.
    exact : whether it is the paper's model itself, event by event.
    """

    name: str
    engine: str
    seconds: float
    step: float = 0.0
    exact: bool = False


RUNGS = (
    Rung("excursion", "excursion", 2.6e-6, exact=True),
    Rung("collision", "collision", 6.5e-5, exact=True),
    Rung("synchronous", "synchronous", 3.5e-4, exact=True),
    Rung("reservoir", "reservoir", 2.0e-6),
    *(
        Rung(f"timestep {step:g}", "timestep", 3.3e-6 / step + 3.0e-5, step)
        for step in (0.1, 0.03, 0.01, 0.003)
    ),
)
LONGER = (Rung("timestep 0.001", "timestep", 3.3e-3, 0.001),)  # if there is time


@dataclass(frozen=True)
class Answer:
    """Value of one quantity by a rung.

    Attributes
    ----------
    value, error : mean over replicas and its standard error (0 for a theory).
    seconds : CPU time of all replicas.
    """

    value: float
    error: float
    seconds: float


def theories() -> list[Model]:
    """Return the theories that a user chooses from, the cheapest first."""
    return [MODELS[name] for name in THEORIES]


def label(name: str) -> str:
    """Return the name of a rung in tables and legends: a theory's label, an engine's name."""
    return MODELS[name].label if name in MODELS else name


def ask(model: Model, circuit: Circuit) -> tuple[float, float]:
    """Return a theory's chi and net current of the stable polarised state, zeros if there is none.

    Caches are cleared before each call: the memory of the urns is computed anew.
    """
    for cached in (unit_disc, return_chance, mean_stay, transfer):
        cached.cache_clear()
    stable = model.solve_stable(circuit)
    return (stable[-1].mass_spread, stable[-1].net_current) if stable else (0.0, 0.0)


def theory_answers(model: Model) -> dict[str, Answer]:
    """Return a theory's results and its time (after a first call that reads and prepares)."""
    ask(model, BATTERY)
    began = time.process_time()
    chi, current = ask(model, BATTERY)
    single = time.process_time() - began
    began = time.process_time()
    spreads = [ask(model, replace(BATTERY, threshold=one))[0] for one in THRESHOLDS]
    scan = time.process_time() - began
    return {
        "chi": Answer(chi, 0.0, single),
        "current": Answer(current, 0.0, single),
        "transition": Answer(transition(THRESHOLDS, spreads), 0.0, scan),
    }


def battery_answers(path: Path) -> dict[str, Answer]:
    """Return chi and net current of a file with one point; errors from its replicas alone."""
    results = open_results(path)
    results = results.where(results["task_status"] == 0, drop=True)
    seconds = float(results["cpu_seconds"].sum())
    values = {
        "chi": results["chi"].values.ravel(),
        # signed: the run begins with urn 2 full, whose battery drives 1 -> 2 in channel 1
        "current": results["current1"].values.ravel(),
    }
    return {name: Answer(*map(float, mean_of(value)), seconds) for name, value in values.items()}


def transition_answer(path: Path) -> Answer:
    """Return the transition of a file with a scan of T."""
    results = open_results(path)
    seconds = float(results["cpu_seconds"].sum())
    transition = transition_of(results["threshold"].values, results["chi"].values)
    return Answer(*transition, seconds)


def shares(chi: Floats, current: Floats) -> tuple[Floats, ...]:
    """Return chi and current over chi of points, shape (point, replica), and the errors of both.

    NaN: errors of one replica, and the share at chi = 0.
    """
    mean, count = chi.mean(axis=1), chi.shape[1]
    ratio = current.mean(axis=1) / np.where(mean > 0.0, mean, math.nan)
    if count == 1:
        return mean, ratio, *[np.full(mean.size, math.nan)] * 2
    left = (current - ratio[:, None] * chi) / mean[:, None]
    return mean, ratio, *(one.std(axis=1, ddof=1) / math.sqrt(count) for one in (chi, left))


def least_cost(line: dict, quantity: str) -> float:
    """Return the CPU time of one short run (of each T of the transition)."""
    return line["per_time"] * SHORTEST * (len(SCANNED) if quantity == "transition" else 1)


def stem(rung: Rung) -> str:
    """Return a rung's name for names of files."""
    return rung.name.replace(" ", "_").replace(".", "p")


def engine_keys(rung: Rung) -> dict[str, object]:
    """Return the namelist keys of a rung's engine."""
    return {"engine": rung.engine, **({"time_step": rung.step} if rung.step else {})}


def seconds_per_time(path: Path) -> float:
    """Return the CPU time of a run per unit of time, in s."""
    results = open_results(path)
    return float(results["cpu_seconds"].sum() / results["time"].sum())


def run_rung(study: Study, rung: Rung, seconds: float) -> tuple[dict[str, Answer], float]:
    """Run the battery and the transition, each for that much CPU time.

    Returns the answers, and the CPU time per unit of time at T = 7.
    """
    length = max(SHORTEST, seconds / (rung.seconds * REPLICAS))
    changes = {"run": {**engine_keys(rung), "duration": float(f"{length:.2g}")}}
    battery = study.run("battery", f"battery_{stem(rung)}", changes)
    answers = battery_answers(battery)
    length = max(SHORTEST, 3.0 * seconds / (rung.seconds * REPLICAS * len(SCANNED)))
    changes = {
        "run": {**engine_keys(rung), "duration": float(f"{length:.2g}")},
        "scan": {"threshold": list(SCANNED)},
    }
    path = study.run("transition", f"transition_{stem(rung)}", changes)
    answers["transition"] = transition_answer(path)
    return answers, seconds_per_time(battery)

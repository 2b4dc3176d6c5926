"""Which rung of the ladder is good enough for a quantity, and how long its runs must be.

A pilot tells: short runs of `excursion` in independent replicas. Their scatter says how long a run
meets a tolerance, their mean, with its error, how far off each theory is. So nothing is taken from
other circuits, and what is advised holds for unlike urns as well. Chances are Student's, for the
scatter of few replicas is itself uncertain.

Transients follow the slowest relaxation, that of directions, 25 r^4/w^3. For the current more
replicas are advised instead of longer ones: a particle that goes round and round may do so for all
of a run. It begins with the chance R a unit of time, lasts m rounds or more with 1/m, at most until
the sparse gate turns it back, and so adds R min(t/L, 1/(1 - q))/t to the variance of a mean over t.
"""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from postproc.accuracy import ladder, predictions
from postproc.reading.results import Results
from postproc.running import run
from postproc.theory.circuit import gate_load
from postproc.theory.models import MODELS
from postproc.theory.renewal import RENEWAL

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.models import Model

    Floats = NDArray[np.float64]
    Groups = dict[str, dict[str, object]]

QUANTITIES = ("chi", "polarised_current", "transition")
SURE = 0.95  # chance with which the advised run meets the tolerance
REPLICAS = 16  # of a pilot
RELAXATIONS = 3.0  # of directions, that a transient lasts
SHORTEST = 1000.0  # transient in radii
CRITICAL = 3000.0  # time in which chi relaxes next to a transition
FEWEST, MOST = 4, 16  # replicas of an advised run; more where they are worth more than length
POLARISED = 0.05  # share of urn 1 at the start
THEORIES = ("window", "renewal", "two_port", "direction")  # by what they cost
ACROSS = 5  # thresholds of a scan across a transition


@dataclass(frozen=True)
class Pilot:
    """What short runs say.

    Attributes
    ----------
    value : of the quantity, mean of the replicas.
    scatter : standard deviation of one replica.
    circulating : variance of a replica that particles which go round add, however long it is.
    transient, measured : time of a replica before and while it is measured.
    per_time : processor time of a unit of time, of all thresholds that are run, in s.
    seconds : processor time of all of the pilot.
    """

    value: float
    scatter: float
    circulating: float
    transient: float
    measured: float
    per_time: float
    seconds: float


@dataclass(frozen=True)
class Advice:
    """What to do.

    Attributes
    ----------
    rung : a theory of `postproc.theory --model`, or the engine `excursion`.
    replicas, duration, transient_duration : of the runs, as in the namelist; 0 of a theory.
    urn1_number : how many begin in urn 1.
    cpu_seconds : processor time of it, without the pilot's.
    confidence : chance that the tolerance is met.
    reason : in a sentence.
    expected : the pilot's value.
    pilot_seconds : what it took to find out.
    thresholds : of a scan across the transition.
    """

    rung: str
    replicas: int
    duration: float
    transient_duration: float
    urn1_number: int
    cpu_seconds: float
    confidence: float
    reason: str
    expected: float
    pilot_seconds: float
    thresholds: list[int] | None = None


def transient_of(circuit: Circuit, quantity: str) -> float:
    """Return how long a run must go before it counts."""
    slowest = max(
        max(RELAXATIONS * predictions.memory_time(side), SHORTEST * float(side.urn_radius))
        for side in circuit.sides
    )
    return max(slowest, CRITICAL) if quantity == "transition" else slowest


def table_of(circuit: Circuit) -> Groups:
    """Return the groups of a namelist that describe a circuit."""
    one, two = circuit.sides
    names = ("channel1_width", "channel1_length", "channel2_width", "channel2_length")
    return {
        "table": {
            "urn_radius": [float(one.urn_radius), float(two.urn_radius)],
            **{name: float(getattr(circuit, name)) for name in names},
        },
        "particles": {"number": int(circuit.number)},
        "gate": {"threshold": [int(one.threshold), int(two.threshold)]},
    }


def runs(
    groups: Groups, quantity: str, thresholds: list[int] | None, length: Mapping[str, object]
) -> Path:
    """Run `excursion` from a polarised start; return the file. `length`: replicas and durations."""
    length = dict(length)
    scan: dict[str, object] = {"replicas": length.pop("replicas")}
    given = {key: dict(value) for key, value in groups.items() if key in ("table", "gate")}
    particles = dict(groups["particles"])
    particles["urn1_number"] = start_of(groups, quantity)
    particles["seed"] = length.pop("seed", 1)
    if thresholds:
        given.pop("gate", None)
        scan["threshold"] = thresholds
    given |= {"particles": particles, "run": {"engine": "excursion", **length}, "scan": scan}
    folder = Path(tempfile.mkdtemp(prefix="advice"))
    return run({**given, "output": {"file": "runs.h5"}}, folder=folder, quiet=True)


def start_of(groups: Groups, quantity: str) -> int:
    """Return how many begin in urn 1: those the namelist names, else a twentieth or a third."""
    number, named = int(groups["particles"]["number"]), groups["particles"].get("urn1_number")
    share = 0.3 if quantity == "transition" else POLARISED
    return int(named) if named is not None else round(share * number)


def read(file: Path, quantity: str) -> tuple[float, float, float]:
    """Return value, scatter of a replica, and processor time of a file of runs; it is removed."""
    with Results(file) as results:
        seconds, replicas = float(results.value("cpu_seconds").sum()), results.replicas
        if quantity != "transition":
            values = results.value(quantity)[0]
            found = float(values.mean()), float(values.std(ddof=1)), seconds
    if quantity == "transition":
        answer, _ = ladder.transition_answer(file)
        found = answer.value, answer.error * math.sqrt(replicas), seconds
    file.unlink()
    for rest in file.parent.iterdir():
        rest.unlink()
    file.parent.rmdir()
    return found


def pilot(groups: Groups, circuit: Circuit, quantity: str, thresholds: list[int] | None) -> Pilot:
    """Run it."""
    transient = transient_of(circuit, quantity)
    length = {"replicas": REPLICAS, "duration": 2.0 * transient, "transient_duration": transient}
    value, scatter, seconds = read(runs(groups, quantity, thresholds, length), quantity)
    around = circulating(circuit, transient) if quantity == "polarised_current" else 0.0
    per_time = seconds / (REPLICAS * 2.0 * transient)
    return Pilot(value, scatter, around, transient, transient, per_time, seconds)


def circulating(circuit: Circuit, duration: float) -> float:
    """Return what particles that go round add to the variance of a current over a time."""
    if float(circuit.channel2_width) == 0.0:
        return 0.0
    said, theory = MODELS["renewal"].of(circuit)
    stable = [state for state in theory.states(said) if state.kind == "stable"]
    if not stable:
        return 0.0
    number, found = float(circuit.number), 0.0
    for state in stable:
        dense = max(state.urn2_number, number - state.urn2_number)
        side = circuit.sides[0 if state.urn2_number > 0.5 * number else 1]  # the sparse one
        turned = 1.0 - float(RENEWAL.share(side.threshold, gate_load(side, number - dense)))
        length = 2.0 * float(sum(side.chords)) + float(side.channel1_length)
        rounds = min(duration / (length + float(side.channel2_length)), 1.0 / max(turned, 1e-12))
        rate = predictions.circulation_rate(side, dense, 1.0)
        found = max(found, rate * rounds / duration)
    return found


def thresholds_of(circuit: Circuit) -> list[int]:
    """Return thresholds across the upper transition, about where two ports have it.

    Raises `ValueError` where there is none.
    """
    at = transition_of(circuit, MODELS["two_port"])
    if not math.isfinite(at):
        raise ValueError("two ports know no transition along T of this circuit")
    middle, step = round(1.03 * at), max(1, round(0.05 * at))
    return [max(1, middle + step * k) for k in range(-(ACROSS // 2), ACROSS // 2 + 1)]


def transition_of(circuit: Circuit, model: Model) -> float:
    """Return the T, between whole ones, at which a theory's chi falls through `ladder.HALFWAY`.

    By halves of the range between a T that polarises and one that does not.
    """

    def chi(threshold: int) -> float:
        said, theory = model.of(replace(circuit, threshold=threshold, gate2_threshold=None))
        stable = [state.mass_spread for state in theory.states(said) if state.kind == "stable"]
        return max(stable, default=0.0)

    load = float(gate_load(circuit, 0.5 * float(circuit.number)))
    tried = [max(1, round(load * factor)) for factor in (1.0, 0.7, 0.85, 1.2)]
    low = next((one for one in tried if chi(one) >= ladder.HALFWAY), None)
    if low is None:
        return math.nan
    high = max(low + 1, round(3.0 * load) + 2)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if chi(middle) >= ladder.HALFWAY else (low, middle)
    return ladder.transition([low, high], [chi(low), chi(high)])


def theory_says(
    circuit: Circuit, model: Model, quantity: str, spread: float | None
) -> tuple[float, float]:
    """Return what a theory says, NaN if nothing, and its processor time.

    Of several stable states that whose chi is nearest to `spread`.
    """
    began = time.process_time()
    if quantity == "transition":
        value = transition_of(circuit, model)
        return value, time.process_time() - began
    said, theory = model.of(circuit)
    stable = [state for state in theory.states(said) if state.kind == "stable"]
    if stable and spread is not None:
        state = min(stable, key=lambda one: abs(one.mass_spread - spread))
    elif stable:
        state = max(stable, key=lambda one: one.mass_spread)
    else:
        return math.nan, time.process_time() - began
    value = state.mass_spread if quantity == "chi" else abs(state.net_current)
    return value, time.process_time() - began


def chance_of_theory(found: Pilot, value: float, tolerance: float) -> float:
    """Return the chance that a theory's value is within a tolerance of what is true."""
    error = math.sqrt((found.scatter**2 + found.circulating) / REPLICAS)
    within = tolerance * abs(found.value)
    low, high = ((value - found.value + sign * within) / error for sign in (-1.0, 1.0))
    return float(stats.t.cdf(high, REPLICAS - 1) - stats.t.cdf(low, REPLICAS - 1))


def length_of_runs(found: Pilot, tolerance: float) -> tuple[int, float]:
    """Return replicas and time measured in each, such that the tolerance is met with `SURE`."""
    wanted = tolerance * abs(found.value) / float(stats.t.ppf(0.5 * (1.0 + SURE), REPLICAS - 1))
    alone = found.scatter**2 * found.measured / wanted**2  # time, if there were no rounds
    if found.circulating > 0.0:
        measured = found.measured
        count = alone / measured + found.circulating / wanted**2
        return max(FEWEST, math.ceil(count)), measured
    replicas = int(np.clip(math.ceil(alone / found.measured), FEWEST, MOST))
    return replicas, max(alone / replicas, 0.25 * found.measured)


def advise(groups: Groups, circuit: Circuit, quantity: str, tolerance: float) -> Advice:
    """Return the cheapest rung that meets a relative tolerance with the chance `SURE`.

    Parameters
    ----------
    groups : of the namelist: table, particles, gate.
    circuit : the same.
    quantity : one of `QUANTITIES`.
    """
    thresholds = thresholds_of(circuit) if quantity == "transition" else None
    found = pilot(groups, circuit, quantity, thresholds)
    replicas, measured = length_of_runs(found, tolerance)
    cost = replicas * (found.transient + measured) * found.per_time
    start = start_of(groups, quantity)
    scatter = math.sqrt(found.scatter**2 + found.circulating) / abs(found.value)
    told = f"A pilot of {REPLICAS} runs has {found.value:.4g}, each scatters by {scatter:.2g} of it"
    off = []
    for name in THEORIES:
        value, seconds = theory_says(
            circuit, MODELS[name], quantity, found.value if quantity == "chi" else None
        )
        if seconds >= cost or not math.isfinite(value):
            continue
        chance = chance_of_theory(found, value, tolerance)
        if chance >= SURE:
            reason = (
                f"{told}; the theory {name} says {value:.4g}, "
                f"{100.0 * abs(value / found.value - 1.0):.2g} % off, in less time than runs take."
            )
            return Advice(name, 0, 0.0, 0.0, start, seconds, chance, reason, found.value,
                          found.seconds, thresholds)  # fmt: skip
        off.append(f"{name} by {100.0 * abs(value / found.value - 1.0):.2g} %")
    reason = f"{told}; theories that cost less are off: {', '.join(off) or 'none'}."
    return Advice("excursion", replicas, float(f"{found.transient + measured:.4g}"),
                  float(f"{found.transient:.4g}"), start, cost, SURE, reason, found.value,
                  found.seconds, thresholds)  # fmt: skip

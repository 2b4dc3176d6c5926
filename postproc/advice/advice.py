"""The cheapest theory or engine that is accurate enough for a quantity, and the number of runs.

The advice is from a pilot: short runs of `excursion` in independent replicas. From their scatter
follows how many such replicas meet a tolerance, from their mean and its error the error of each
theory. So nothing is taken from other circuits, and the advice holds for unequal urns as well.
Probabilities are from Student's distribution, since the scatter of few replicas is itself
uncertain.

More replicas are advised, not longer ones: the scatter of replicas of another length is not known
if the length is comparable to their correlation time. Each measures for twice its transient
(`transients`): that of chi or, for a current, the one that the tolerance requires. A quarter of the
tolerance is left for the part of the current that is missing since the run is young; the rest is
for the statistical error of the replicas. So the pilot of a current is repeated if its transient
was too short.

A circulating particle may make rounds for the whole run. Circulations begin at the rate R, make m
rounds or more with the probability 1/m, at most until the gate of the sparse urn reverses them, and
so add R min(t/L, 1/(1 - q))/t to the variance of a mean over t.

A pilot is data: if its own error meets the tolerance, no more runs are necessary.
"""

from __future__ import annotations

import math
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from postproc.advice import transients
from postproc.cli import InputError
from postproc.progress import doing
from postproc.reading.grid import open_results
from postproc.reading.points import by_point
from postproc.running import RunError, plan, run
from postproc.theory.circuit import gate_load
from postproc.theory.models import MODELS, ancestry
from postproc.theory.renewal import RENEWAL

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]
    Groups = dict[str, dict[str, object]]

QUANTITIES = ("chi", "polarised_current", "transition")
SURE = 0.95  # probability with which the advised runs meet the tolerance
REPLICAS = 16  # of a pilot
FROM_ZERO = 3.0  # errors of its mean, by which that must differ from 0
NOT_SAID = 1e-4  # of a value: what is lacking below this is rounding, or does not matter
LACKING = 0.25  # of the tolerance: part of a current that may be missing in a young run
NEAR = 1.1  # factor by which a pilot's transient may be shorter than its own result requires
LARGE = 0.75  # chi below which the circuit may be close to a transition
MEASURED = 2.0  # transients that a replica measures
FEWEST = 4  # replicas of advised runs
OUTLYING = 7.0  # standard over median deviation, beyond which some are far from most; 1.5 if normal
LEAST_DEVIATION = 0.1  # of runs of few particles that leave a state
START_SHARE = 0.05  # share of urn 1 at the start
SCAN = 8.0  # number of states that a theory computes for its transition, about
PATIENCE = 5.0  # s, limit for a finer theory, which shows whether errors cancel
ACROSS = 5  # thresholds of a scan across a transition
LEAST = 1e-300  # error where replicas do not scatter
TRIED = 100_000  # particles of a run from which the cost of a pilot is estimated
HALFWAY = 0.3  # chi at the transition, between integer T on a straight line
SHIFTS = 4  # times that thresholds are moved if chi does not fall through `HALFWAY` there


@dataclass(frozen=True)
class Pilot:
    """Results of the pilot, short runs of `excursion`.

    Attributes
    ----------
    value : mean of the quantity over the replicas.
    scatter : standard deviation of one replica.
    circulating : variance of a replica that circulating particles add.
    transient, measured : time of a replica before and during the measurement.
    per_time : processor time per unit of time, for all thresholds of the runs, in s.
    seconds : processor time of the whole pilot.
    thresholds : T of the runs, for a transition.
    lacking : by how much the value is too small since the run is young, by theory.
    chi : mean of chi, which tells the state of a theory that is compared.
    """

    value: float
    scatter: float
    circulating: float
    transient: float
    measured: float
    per_time: float
    seconds: float
    thresholds: list[int] | None = None
    lacking: float = 0.0
    chi: float = math.nan

    @property
    def error(self) -> float:
        """Standard deviation of one replica, circulation included."""
        return math.sqrt(self.scatter**2 + self.circulating)


@dataclass(frozen=True)
class Advice:
    """Advised theory or runs.

    Attributes
    ----------
    rung : a theory of `theory --theory`, or the engine `excursion`.
    replicas, duration, transient_duration : of the runs, as in the namelist; 0 of a theory.
        With `cpu_seconds` 0 they are the pilot's, and `expected` is the answer.
    urn1_number : number of particles that begin in urn 1.
    cpu_seconds : processor time, without the pilot's; 0: the pilot is enough.
    confidence : probability that the tolerance is met.
    reason : in sentences.
    expected : the pilot's value.
    pilot_seconds : processor time of the pilot.
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


def namelist_of(
    groups: Groups, quantity: str, thresholds: list[int] | None, length: Mapping[str, object]
) -> Groups:
    """Return runs of `excursion` from a polarised start. `length`: replicas and durations."""
    length = dict(length)
    scan: dict[str, object] = {"replicas": length.pop("replicas")}
    given = {key: dict(value) for key, value in groups.items() if key in ("table", "gate")}
    particles = dict(groups["particles"])
    particles["urn1_number"] = start_of(groups, quantity)
    particles.setdefault("seed", 1)
    if thresholds:
        given.pop("gate", None)
        scan["threshold"] = thresholds
    given |= {"particles": particles, "run": {"engine": "excursion", **length}, "scan": scan}
    return {**given, "output": {"file": "runs.h5"}}


def cost_of(
    groups: Groups, quantity: str, thresholds: list[int] | None, length: Mapping[str, object]
) -> float:
    """Return an estimate of the processor time of such runs, in s.

    The program measures one; for many particles a smaller one at the same density, since it takes
    minutes to place 1e8, and the time is proportional to their number, or grows somewhat faster.
    """
    number = int(groups["particles"]["number"])
    share = min(1.0, TRIED / number)
    tried = {key: dict(value) for key, value in groups.items()}
    tried["particles"] = {"number": round(share * number)}
    tried["particles"]["urn1_number"] = round(share * start_of(groups, quantity))
    gates = thresholds[len(thresholds) // 2 :][:1] if thresholds else groups["gate"]["threshold"]
    tried["gate"] = {"threshold": [round(share * one) for one in np.atleast_1d(gates).tolist()]}
    one = namelist_of(tried, quantity, None, {**length, "replicas": 1})
    with tempfile.TemporaryDirectory(prefix="advice") as folder, doing("how long a run takes"):
        seconds = plan(one, folder=folder).seconds
    return seconds * int(length["replicas"]) * len(thresholds or [1]) / share


def runs(
    groups: Groups, quantity: str, thresholds: list[int] | None, length: Mapping[str, object]
) -> Outcome:
    """Make the runs of `namelist_of`; return their results."""
    namelist = namelist_of(groups, quantity, thresholds, length)
    with tempfile.TemporaryDirectory(prefix="advice") as folder:
        try:
            with doing(f"runs of {quantity}, {length['replicas']} replicas"):
                return read(run(namelist, folder=folder, quiet=True), quantity)
        except RunError as problem:
            raise InputError(f"the runs of {quantity} failed: {problem}") from problem


def start_of(groups: Groups, quantity: str) -> int:
    """Return how many begin in urn 1: as in the namelist, else a twentieth or a third."""
    number, named = int(groups["particles"]["number"]), groups["particles"].get("urn1_number")
    share = 0.3 if quantity == "transition" else START_SHARE
    return int(named) if named is not None else round(share * number)


@dataclass(frozen=True)
class Outcome:
    """Results of runs: value, scatter of a replica, chi (of each threshold), processor time."""

    value: float
    scatter: float
    chi: Floats
    seconds: float


def read(file: Path, quantity: str) -> Outcome:
    """Return the results of runs; raise `InputError` where these leave their state."""
    data = open_results(file)
    chi, seconds = np.atleast_2d(data["chi"]), float(data["cpu_seconds"].sum())
    away = chi - np.median(chi)
    # Not if one particle has changed the urn.
    least = min(2.0 / float(data["number"].max()), LEAST_DEVIATION)
    few = np.std(away) > max(OUTLYING * np.median(abs(away)), least)
    if quantity != "transition" and (few or by_point(data)["two_states"].any()):
        raise InputError(
            f"the runs of {quantity} have no mean: some leave the state in which they begin, "
            "see lifetimes; other values of urn1_number, or longer runs, may be in one state"
        )
    if quantity == "transition":
        value, scatter = transition_of_runs(np.atleast_1d(data["threshold"]), chi)
    else:
        value, scatter = float(data[quantity].mean()), float(data[quantity].std(ddof=1))
    return Outcome(value, scatter, chi.mean(axis=1), seconds)


def transition_between(thresholds: ArrayLike, chi: ArrayLike) -> float:
    """Return the T at which chi falls through `HALFWAY`, the last one; NaN if it does not."""
    at, values = np.asarray(thresholds, float), np.asarray(chi, float)
    falls = np.flatnonzero((values[:-1] >= HALFWAY) & (values[1:] < HALFWAY))
    if falls.size == 0:
        return math.nan
    k = falls[-1]
    share = (values[k] - HALFWAY) / (values[k] - values[k + 1])
    return float(at[k] + share * (at[k + 1] - at[k]))


def transition_of_runs(thresholds: Floats, chi: Floats) -> tuple[float, float]:
    """Return the T at which the mean chi of replicas falls through, and a replica's scatter of it.

    Runs at different T are independent: the variances that they add to the transition add up.
    """
    mean = chi.mean(axis=1)
    value, square, count = transition_between(thresholds, mean), 0.0, chi.shape[1]
    for at, error in enumerate(chi.std(axis=1, ddof=1) / math.sqrt(count)):
        moved = [transition_between(thresholds, mean + sign * error * np.eye(mean.size)[at])
                 for sign in (-1.0, 1.0)]  # fmt: skip
        square += (0.5 * (moved[1] - moved[0])) ** 2
    return value, math.sqrt(square * count)


def pilot(
    groups: Groups, circuit: Circuit, quantity: str, tolerance: float,
    longest: float = math.inf,
) -> Pilot:  # fmt: skip
    """Make the pilot; repeat it with another transient or other thresholds if its result requires.

    Raises `InputError` if it would take more than `longest` of processor time in all, in s.
    """
    thresholds = thresholds_of(circuit) if quantity == "transition" else None
    transient, seconds = transients.of_chi(circuit, critical=quantity == "transition"), 0.0
    for _ in range(SHIFTS):
        length = {
            "replicas": REPLICAS, "transient_duration": transient,
            "duration": (1.0 + MEASURED) * transient,
        }  # fmt: skip
        if math.isfinite(longest):
            expected_seconds = seconds + cost_of(groups, quantity, thresholds, length)
            if expected_seconds > longest:
                raise InputError(
                    f"the pilot takes about {expected_seconds:.2g} s of a processor; "
                    f"--pilot-seconds {math.ceil(1.5 * expected_seconds)} lets it"
                )
        outcome, of_this = runs(groups, quantity, thresholds, length), transient
        seconds += outcome.seconds
        if thresholds and not (math.isfinite(outcome.value) and math.isfinite(outcome.scatter)):
            thresholds = moved(thresholds, outcome.chi)
            continue
        if not thresholds:
            transient = max(transient, transient_of(circuit, quantity, tolerance, outcome))
        if transient <= NEAR * of_this:
            break
    measured, around, lacking = MEASURED * of_this, 0.0, 0.0
    if quantity == "polarised_current":
        around = circulating(circuit, measured)
        lacking = float(transients.missing(circuit, float(outcome.chi[0]), of_this, measured))
    per_time = outcome.seconds / (REPLICAS * (of_this + measured))
    return Pilot(outcome.value, outcome.scatter, around, of_this, measured, per_time, seconds,
                 thresholds, lacking, float(outcome.chi[0]))  # fmt: skip


def transient_of(circuit: Circuit, quantity: str, tolerance: float, outcome: Outcome) -> float:
    """Return the transient that a quantity requires within a tolerance, from results of runs."""
    chi = float(outcome.chi[0])
    settled = transients.of_chi(circuit, critical=not chi > LARGE)
    if quantity != "polarised_current" or not math.isfinite(outcome.value):
        return settled
    allowed = LACKING * tolerance * abs(outcome.value)
    return transients.of_current(circuit, chi, allowed, shortest=settled, times=MEASURED)


def moved(thresholds: list[int], chi: Floats) -> list[int]:
    """Return as many thresholds farther up if chi is still large at the last one, else down."""
    span = thresholds[-1] - thresholds[0]
    first = thresholds[0] + (span if chi[-1] >= HALFWAY else -span)
    return across(max(1, first), max(1, span // (ACROSS - 1)))


def across(first: int, step: int) -> list[int]:
    """Return thresholds of a scan."""
    return [first + step * k for k in range(ACROSS)]


def circulating(circuit: Circuit, duration: float) -> float:
    """Return the variance that circulating particles add to a mean current over a time."""
    if float(circuit.channel2_width) == 0.0:
        return 0.0
    stable = MODELS["renewal"].solve_stable(circuit)
    if not stable:
        return 0.0
    circuit = MODELS["renewal"].of(circuit)
    number, found = float(circuit.number), 0.0
    for state in stable:
        dense = max(state.urn2_number, number - state.urn2_number)
        side = circuit.sides[0 if state.urn2_number > 0.5 * number else 1]  # the sparse one
        turned = 1.0 - float(RENEWAL.share(side.threshold, gate_load(side, number - dense)))
        length = 2.0 * float(sum(side.chords)) + float(side.channel1_length)
        rounds = min(duration / (length + float(side.channel2_length)), 1.0 / max(turned, 1e-12))
        rate = transients.circulation_rate(side, dense, 1.0)
        found = max(found, rate * rounds / duration)
    return found


def thresholds_of(circuit: Circuit) -> list[int]:
    """Return thresholds across the upper transition, around that of the theory `renewal`.

    If that theory has none, around the number that a gate holds at equal densities.
    """
    at = transition_of(circuit, MODELS["renewal"])
    if not math.isfinite(at):
        at = float(gate_load(circuit, 0.5 * float(circuit.number)))
    middle, step = round(at), max(1, round(0.05 * at))
    return across(max(1, middle - (ACROSS // 2) * step), step)


def transition_of(circuit: Circuit, model: Model) -> float:
    """Return the T, between whole ones, at which a theory's chi falls through `HALFWAY`.

    By halves of the range between a T that polarises and one that does not.
    """

    @cache
    def chi(threshold: int) -> float:
        at_threshold = replace(circuit, threshold=threshold, gate2_threshold=None)
        return max((one.mass_spread for one in model.solve_stable(at_threshold)), default=0.0)

    load = float(gate_load(circuit, 0.5 * float(circuit.number)))
    tried = [max(1, round(load * factor)) for factor in (1.0, 0.7, 0.85, 1.2)]
    low = next((one for one in tried if chi(one) >= HALFWAY), None)
    if low is None:
        return math.nan
    high = max(low + 1, round(3.0 * load) + 2)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if chi(middle) >= HALFWAY else (low, middle)
    return transition_between([low, high], [chi(low), chi(high)])


def theory_says(
    circuit: Circuit, model: Model, quantity: str, spread: float
) -> tuple[float, float]:
    """Return a theory's value, NaN if it has none, and its processor time.

    Of several stable states that whose chi is nearest to `spread`, or, if that is NaN, largest.
    """
    began = time.process_time()
    if quantity == "transition":
        value = transition_of(circuit, model)
        return value, time.process_time() - began
    stable = model.solve_stable(circuit)
    if stable and math.isfinite(spread):
        state = min(stable, key=lambda one: abs(one.mass_spread - spread))
    elif stable:
        state = max(stable, key=lambda one: one.mass_spread)
    else:
        return math.nan, time.process_time() - began
    value = state.mass_spread
    if quantity == "polarised_current":
        value = state.polarised_current(circuit.number)
    return value, time.process_time() - began


def chance_of_theory(
    found: Pilot, value: float, tolerance: float, other_error: float = 0.0
) -> float:
    """Return the probability that a theory's value is within a tolerance of the true value.

    Or of another measurement, which has a standard error of its own.
    """
    error = max(LEAST, math.hypot(found.error / math.sqrt(REPLICAS), other_error))
    off, within = value - found.value - found.lacking, tolerance * abs(found.value)
    ends = (off + np.array([-within, within])) / error
    return float(np.diff(special.stdtr(REPLICAS - 1, ends))[0])


def chance_of_runs(
    found: Pilot, replicas: int, tolerance: float, other_error: float = 0.0
) -> float:
    """Return the probability that so many replicas meet a tolerance, as `chance_of_theory`."""
    error = max(LEAST, math.hypot(found.error / math.sqrt(replicas), other_error))
    within = tolerance * abs(found.value)
    ends = (found.lacking + np.array([-within, within])) / error
    return float(np.diff(special.stdtr(REPLICAS - 1, ends))[0])


def replicas_for(found: Pilot, tolerance: float) -> int:
    """Return how many replicas meet the tolerance, less `lacking`, with the probability `SURE`.

    If `lacking` exceeds the tolerance no number does: then the number that the scatter requires.
    """
    wanted = tolerance * abs(found.value)
    left = wanted - abs(found.lacking)
    wanted = left if left > 0.0 else wanted
    wanted /= float(special.stdtrit(REPLICAS - 1, 0.5 * (1.0 + SURE)))
    return max(FEWEST, math.ceil((found.error / wanted) ** 2))


def advise(
    groups: Groups, circuit: Circuit, quantity: str, tolerance: float, found: Pilot | None = None,
    *, longest: float = math.inf,
) -> Advice:  # fmt: skip
    """Return the cheapest rung that meets a relative tolerance with the probability `SURE`.

    If that is an engine and the pilot is enough, its runs. The time is not limited; it is part of
    the advice. If the quantity does not exist, or is not told from 0, the rung is "none".

    Parameters
    ----------
    groups : of the namelist: table, particles, gate.
    circuit : the same.
    quantity : one of `QUANTITIES`.
    found : results of a pilot, if one was made.
    longest : largest processor time of a pilot, in s.
    """
    found = found or pilot(groups, circuit, quantity, tolerance, longest=longest)
    start = start_of(groups, quantity)
    rest = (found.value, found.seconds, found.thresholds)
    error = found.error / math.sqrt(REPLICAS)
    if not (math.isfinite(error) and abs(found.value) > FROM_ZERO * error):
        known = math.isfinite(found.value) and math.isfinite(error)
        told = f" that differs from 0, {found.value:.2g} +- {error:.2g}" if known else ""
        reason = (f"A pilot of {REPLICAS} runs finds no {quantity}{told}: nothing to be within a "
                  "tolerance")  # fmt: skip
        if found.thresholds:
            reason += f" of; chi does not fall through {HALFWAY} at T = {found.thresholds}"
        return Advice("none", 0, 0.0, 0.0, start, math.nan, 0.0, f"{reason}.", *rest)
    replicas = replicas_for(found, tolerance)
    cost = replicas * (found.transient + found.measured) * found.per_time
    needed = (
        f"A pilot of {REPLICAS} runs from {start} of {circuit.number} in urn 1 has "
        f"{found.value:.4g} +- {error:.1g}, "
        f"each scatters by {found.error / abs(found.value):.2g} of it"
    )
    if abs(found.lacking) > NOT_SAID * abs(found.value):
        needed += (
            f"; behind a transient of {found.transient:g} it lacks "
            f"{100.0 * found.lacking / abs(found.value):.2g} % by theory, for circulations are "
            "still filling up"
        )
    enough = replicas <= REPLICAS
    met = " The pilot itself meets the tolerance." if enough else ""
    off = []
    for name, model in MODELS.items():
        value, seconds = _theory_within(circuit, model, found, quantity, cost)
        if seconds >= cost or not math.isfinite(value):
            continue
        chance = chance_of_theory(found, value, tolerance)
        apart = f"{100.0 * _apart(found, value):.2g} %"
        if chance >= SURE:
            reason = (
                f"{needed}; the theory {name} says {value:.4g}, {apart} off, in less time than "
                f"runs take.{_cancelling(circuit, name, found, quantity, tolerance)}{met}"
            )
            return Advice(name, 0, 0.0, 0.0, start, seconds, chance, reason, *rest)
        off.append(f"{name} by {apart}")
    reason = f"{needed}; theories that cost less are off: {', '.join(off) or 'none'}.{met}"
    if enough:
        replicas, cost = REPLICAS, 0.0
    chance = chance_of_runs(found, replicas, tolerance)
    return Advice("excursion", replicas, found.transient + found.measured, found.transient, start,
                  cost, chance, reason, *rest)  # fmt: skip


def _theory_within(
    circuit: Circuit, model: Model, found: Pilot, quantity: str, longest: float
) -> tuple[float, float]:
    """Return a theory's value and its processor time; NaN and infinity if that is too long.

    Also if it does not apply to the circuit, finds no state, or uses random numbers: the
    probabilities take a theory's value as exact.
    """
    least = model.seconds * (SCAN if quantity == "transition" else 1.0)
    if least >= longest or model.refusal(circuit):
        return math.nan, math.inf
    spread = found.value if quantity == "chi" else found.chi
    with doing(f"theory {model.name}"), suppress(InputError):
        return theory_says(circuit, model, quantity, spread)
    return math.nan, math.inf


def _apart(found: Pilot, value: float) -> float:
    """Return the difference of a theory from the pilot, corrected by `lacking`."""
    return abs(value - found.value - found.lacking) / abs(found.value)


def _cancelling(
    circuit: Circuit, name: str, found: Pilot, quantity: str, tolerance: float
) -> str:  # fmt: skip
    """Return a remark if errors of a theory cancel: a theory with more physics is less accurate."""
    for finer in (one for one in MODELS if name in ancestry(one)[:-1]):
        value, _ = _theory_within(circuit, MODELS[finer], found, quantity, PATIENCE)
        if math.isfinite(value) and chance_of_theory(found, value, tolerance) < 1.0 - SURE:
            return (
                f" There errors cancel: {finer}, which has all of its physics and more, is "
                f"{100.0 * _apart(found, value):.2g} % off; do not rely on {name} elsewhere."
            )
    return ""

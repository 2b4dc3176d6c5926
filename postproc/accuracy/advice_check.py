"""Checks advice against long runs: python -m postproc.accuracy.advice_check [POINTS [SEED]].

Circuits are drawn at random, with tolerances from 0.3 to 10 %, for currents from 1 %. The advised
runs are made, with other seeds unless the pilot is the answer, and compared with runs whose
transient is ten times as long. These measure for five times as long as well, so that half as many
are enough. Their error makes the promised probability somewhat smaller (`here`; `sure` is that of
the advice). Prints a line for each point, then how often the tolerance was met, how often that was
promised, and two standard deviations of this number; exit code 1 if they disagree by more. Takes
about half an hour of one core.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from postproc import cli
from postproc.accuracy import advice
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS

if TYPE_CHECKING:
    from postproc.accuracy.advice import Advice, Groups, Pilot

OLDER = 10.0  # transient of the long runs, over the pilot's; they measure for the same time
FEWER = 0.5  # replicas of the long runs, over those that would be advised
LARGEST = 60.0  # s, processor time of the long runs beyond which they are not made
TOLERANCES = {"chi": (0.003, 0.1), "polarised_current": (0.003, 0.01), "transition": (0.003, 0.1)}
KINDS = ("chi", "polarised_current", "chi", "polarised_current", "transition")


def drawn(random: np.random.Generator) -> Circuit:
    """Draw a circuit of a few hundred particles, with random urns and lengths."""
    number = int(random.integers(150, 500))
    return Circuit(
        number,
        max(3, round(number * random.uniform(0.005, 0.02))),
        round(random.uniform(0.25, 0.4), 3),
        round(random.uniform(0.01, 0.04), 4),
        round(random.uniform(0.9, 1.1), 3),
        round(random.uniform(0.7, 1.5), 2),
        round(random.uniform(0.5, 1.5), 2),
    )


def done(groups: Groups, circuit: Circuit, quantity: str, given: Advice) -> float:
    """Return the value that is found by following the advice."""
    if given.replicas == 0:
        spread = given.expected if quantity == "chi" else None
        return advice.theory_says(circuit, MODELS[given.rung], quantity, spread)[0]
    if given.cpu_seconds == 0.0:
        return given.expected
    length = {
        "replicas": given.replicas, "duration": given.duration,
        "transient_duration": given.transient_duration, "seed": 2,
    }  # fmt: skip
    return advice.runs(groups, quantity, given.thresholds, length).value


def length_of_truth(found: Pilot, replicas: int) -> dict[str, int | float]:
    """Return the length of runs that are ten times as old as the pilot, for so many replicas."""
    transient = OLDER * found.transient
    return {
        "replicas": max(math.ceil(FEWER * replicas), advice.REPLICAS), "seed": 3,
        "duration": 2.0 * transient, "transient_duration": transient,
    }  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Draw points, follow the advice, print the table."""
    options = cli.parser("accuracy.advice_check", __doc__)
    options.add_argument("points", metavar="POINTS", nargs="?", type=cli.integer(1), default=40)
    options.add_argument("seed", metavar="SEED", nargs="?", type=cli.integer(0), default=1)
    words = options.parse_args(arguments)
    wanted, random = words.points, np.random.default_rng(words.seed)
    met, promised, counted, left = [], [], 0, [0, 0]
    print(f"{'N':>4} {'T':>3} {'w':>5} {'w2':>6} {'quantity':18} {'within':>6} {'rung':10} "
          f"{'cost/s':>7} {'sure':>5} {'here':>5} {'found':>7} {'truth':>7} {'off':>8} "
          "met")  # fmt: skip
    while counted < wanted:
        circuit, quantity = drawn(random), KINDS[counted % len(KINDS)]
        tolerance = float(10.0 ** random.uniform(*np.log10(TOLERANCES[quantity])))
        groups = advice.table_of(circuit)
        if quantity == "polarised_current":
            stable = advice.theory_says(circuit, MODELS["direction"], "chi", None)[0]
            if not stable > 0.3:
                continue  # no current to speak of
        found = advice.pilot(groups, circuit, quantity, tolerance)
        given = advice.advise(groups, circuit, quantity, tolerance, found)
        if given.rung == "none":
            left[1] += 1
            continue
        replicas = advice.replicas_for(found, tolerance)
        length = length_of_truth(found, replicas)
        if length["replicas"] * length["duration"] * found.per_time > LARGEST:
            left[0] += 1
            continue
        outcome = advice.runs(groups, quantity, found.thresholds, length)
        true, error = outcome.value, outcome.scatter / math.sqrt(length["replicas"])
        value = done(groups, circuit, quantity, given)
        off = value / true - 1.0
        met.append(abs(off) <= tolerance)
        promised.append(
            advice.chance_of_runs(found, given.replicas, tolerance, error) if given.replicas
            else advice.chance_of_theory(found, value, tolerance, error)
        )  # fmt: skip
        counted += 1
        print(f"{circuit.number:4d} {circuit.threshold:3d} {circuit.channel1_width:5.3f} "
              f"{circuit.channel2_width:6.4f} {quantity:18} {tolerance:6.4f} {given.rung:10} "
              f"{given.cpu_seconds:7.3f} {given.confidence:5.3f} {promised[-1]:5.3f} {value:7.4g} "
              f"{true:7.4g} {off:+8.4f} {'yes' if met[-1] else 'NO'}", flush=True)  # fmt: skip
    print(f"left out: {left[0]} beyond {LARGEST:g} s, {left[1]} without the quantity")
    chances = np.array(promised)
    two_sigma = 2.0 * math.sqrt(float((chances * (1.0 - chances)).sum()))
    promise = f"promised {chances.sum():.1f} +- {two_sigma:.1f} (two sigma)"
    print(f"met {sum(met)} of {counted}; {promise}")
    return 0 if abs(sum(met) - chances.sum()) <= two_sigma else 1


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

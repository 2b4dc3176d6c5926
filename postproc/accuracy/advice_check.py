"""Whether advice is right, by hand: python -m postproc.accuracy.advice_check [POINTS [SEED]].

Circuits are drawn, with tolerances from 0.3 to 10 %. What is advised is done, with seeds of its
own, and held against runs so long that their error is a third of that of the advice; circuits that
would need too long are left out. Printed: a line a point, and last how often the tolerance was met,
how often that was promised, and two standard deviations of chance. Takes minutes of one core.
"""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

import numpy as np

from postproc.accuracy import advice
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS

if TYPE_CHECKING:
    from postproc.accuracy.advice import Advice, Groups, Pilot

SHARPER = 3.0  # how much smaller the error of what is held against is
LARGEST = 8.0  # processor time of what it is held against, in s, beyond which none is made
KINDS = ("chi", "chi", "polarised_current", "chi", "transition")


def drawn(random: np.random.Generator) -> Circuit:
    """Return a circuit of some hundred particles, with urns and lengths of its own."""
    number = int(random.integers(200, 700))
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
    """Return what comes out where the advice is followed."""
    if given.replicas == 0:
        spread = given.expected if quantity == "chi" else None
        return advice.theory_says(circuit, MODELS[given.rung], quantity, spread)[0]
    length = {
        "replicas": given.replicas, "duration": given.duration,
        "transient_duration": given.transient_duration, "seed": 2,
    }  # fmt: skip
    return advice.read(advice.runs(groups, quantity, given.thresholds, length), quantity)[0]


def truth(
    groups: Groups, circuit: Circuit, quantity: str, given: Advice, tolerance: float
) -> tuple[float, float]:
    """Return the quantity from long runs, and their standard error; NaN if they are too long."""
    found: Pilot = advice.pilot(groups, circuit, quantity, given.thresholds)
    replicas, measured = advice.length_of_runs(found, 2.1 * tolerance / SHARPER)
    if replicas * (found.transient + measured) * found.per_time > LARGEST:
        return math.nan, math.nan
    replicas, measured = max(replicas, 8), max(measured, found.transient)
    length = {
        "replicas": replicas, "duration": 2.0 * found.transient + measured,
        "transient_duration": 2.0 * found.transient, "seed": 3,
    }  # fmt: skip
    file = advice.runs(groups, quantity, given.thresholds, length)
    value, scatter, _ = advice.read(file, quantity)
    return value, scatter / math.sqrt(replicas)


def main(words: list[str]) -> int:
    """Draw points, follow the advice, print the table."""
    wanted = int(words[0]) if words else 40
    random = np.random.default_rng(int(words[1]) if len(words) > 1 else 1)
    met, promised, said = [], [], 0
    print(f"{'N':>4} {'T':>3} {'w':>5} {'w2':>6} {'quantity':18} {'within':>6} {'rung':10} "
          f"{'cost/s':>7} {'sure':>5} {'found':>7} {'truth':>7} {'off':>8} met")  # fmt: skip
    while said < wanted:
        circuit, quantity = drawn(random), KINDS[said % len(KINDS)]
        tolerance = float(10.0 ** random.uniform(-2.5 if quantity == "chi" else -2.0, -1.0))
        groups = advice.table_of(circuit)
        if quantity == "polarised_current":
            stable = advice.theory_says(circuit, MODELS["two_port"], "chi", None)[0]
            if not stable > 0.5:
                continue  # no current to speak of
        try:
            given = advice.advise(groups, circuit, quantity, tolerance)
        except ValueError:
            continue  # no transition
        true, _ = truth(groups, circuit, quantity, given, tolerance)
        if not (math.isfinite(true)):
            continue
        value = done(groups, circuit, quantity, given)
        off = value / true - 1.0
        met.append(abs(off) <= tolerance)
        promised.append(given.confidence)
        said += 1
        print(f"{circuit.number:4d} {circuit.threshold:3d} {circuit.channel1_width:5.3f} "
              f"{circuit.channel2_width:6.4f} {quantity:18} {tolerance:6.4f} {given.rung:10} "
              f"{given.cpu_seconds:7.3f} {given.confidence:5.3f} {value:7.4g} {true:7.4g} "
              f"{off:+8.4f} {'yes' if met[-1] else 'NO'}", flush=True)  # fmt: skip
    chances = np.array(promised)
    sigma = math.sqrt(float((chances * (1.0 - chances)).sum()))
    print(
        f"met {sum(met)} of {said}; promised {chances.sum():.1f} +- {2.0 * sigma:.1f} (two sigma)"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

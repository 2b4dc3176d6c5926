"""The ladder over the map in numbers: expected error, the Pareto front, errors that cancel.

A rung's line has its name, its kind ("theory", "exact" or "model"), and for each quantity `bias`,
`bias_error`, `chance`, `missing` (`ladder_map.compare`), `seconds` and `approach`
(`ladder_map.price`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from postproc.theory.models import MODELS, ancestry

if TYPE_CHECKING:
    from collections.abc import Sequence

TIMES = np.geomspace(1e-4, 1e5, 361)  # processor time of the Pareto front, in s
TOLERANCES = (0.1, 0.03, 0.01, 0.003)  # required errors
SURE = 2.0  # number of standard errors above which a difference is significant
# engines, each with all physics of those before it, and more; `reservoir` has all of this theory
STEPS = ("timestep 0.1", "timestep 0.03", "timestep 0.01", "timestep 0.003")
BELOW_RESERVOIR = "renewal"


def expected(line: dict, quantity: str, seconds: float) -> float:
    """Return the expected error of a rung for a processor time per point; inf: no result yet.

    Runs measure for at least the length of their transient; their statistical error falls with the
    root of the measured time. The exact engines have no bias.
    """
    one = line[quantity]
    if one["missing"]:
        return math.inf
    if line["kind"] == "theory":
        return one["bias"] if seconds >= one["seconds"] else math.inf
    left, done = seconds - one["approach"], one["seconds"] - one["approach"]
    if left < one["approach"]:
        return math.inf
    bias = 0.0 if line["kind"] == "exact" else one["bias"]
    return math.hypot(bias, one["chance"] * math.sqrt(done / left))


def pareto(rows: Sequence[dict], quantity: str) -> list[float]:
    """Return the error of the best rung for each of `TIMES`; inf: none has a result by then."""
    return [min(expected(line, quantity, float(one)) for line in rows) for one in TIMES]


def cheapest(rows: Sequence[dict], quantity: str, error: float) -> tuple[str, float]:
    """Return the cheapest rung with at most this error, and its cost in s; "none", inf."""
    for seconds in TIMES:
        errors = [expected(line, quantity, float(seconds)) for line in rows]
        if min(errors) <= error:
            return rows[errors.index(min(errors))]["name"], float(seconds)
    return "none", math.inf


def families() -> list[tuple[str, ...]]:
    """Return sequences of rungs, each rung with all the physics of those before it, and more."""
    theories = [ancestry(name) for name in MODELS]
    return [*theories, (*ancestry(BELOW_RESERVOIR), "reservoir"), STEPS]


def cancelling(rows: Sequence[dict], quantity: str) -> list[str]:
    """Return rungs whose errors cancel: one with all their physics and more is less accurate."""
    by_name = {line["name"]: line[quantity] for line in rows}
    found = []
    for family in families():
        there_are = [name for name in family if name in by_name]
        for at, name in enumerate(there_are):
            own = by_name[name]
            for finer in (by_name[other] for other in there_are[at + 1 :]):
                apart = SURE * math.hypot(own["bias_error"], finer["bias_error"])
                worse = finer["bias"] > own["bias"] + apart or finer["missing"] > own["missing"]
                if worse and not own["missing"] and name not in found:
                    found.append(name)
    return found

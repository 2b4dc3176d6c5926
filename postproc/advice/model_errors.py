"""Errors of models for a given circuit, from the map model_errors.csv.

The map has N = 1000, w = 0.3, r = l = l' = 1. Another circuit corresponds to the point with the
same threshold over the number that a gate holds at equal densities, and the same w'/w. Circuits
beyond the map, and unequal urns, have no entry.
"""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

from postproc.theory.circuit import Circuit, gate_load

BATTERY = Circuit(1000, 7)  # of the map, but for T and w'
TABLE = Path(__file__).with_name("model_errors.csv")
COLUMNS = {
    "chi": ("off_chi", "chi"),
    "polarised_current": ("off_share", "current over chi"),
    "transition": ("off_transition", "the transition"),
}
BEYOND = 1.25  # factor by which a circuit may lie beyond the edge of the map


@cache
def _table() -> list[dict[str, str]]:
    with TABLE.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def nearest(circuit: Circuit) -> tuple[int, float] | None:
    """Return T and w' of the map's nearest point in logarithms; None: beyond the map."""
    if not circuit.alike or float(circuit.channel2_width) == 0.0:
        return None
    widths = float(circuit.channel2_width) / float(circuit.channel1_width)
    width = widths * float(BATTERY.channel1_width)
    loads = [
        float(gate_load(one, 0.5 * float(one.number)))
        for one in (replace(BATTERY, channel2_width=width), circuit)
    ]
    here = float(circuit.threshold) * loads[0] / loads[1], width
    points = {(int(row["T"]), float(row["w2"])) for row in _table()}
    for at, value in enumerate(here):
        known = [point[at] for point in points]
        if not min(known) / BEYOND <= value <= max(known) * BEYOND:
            return None

    def distance(point: tuple[int, float]) -> float:
        return math.hypot(*(math.log(a / b) for a, b in zip(here, point, strict=True)))

    return min(points, key=distance)


def words(circuit: Circuit, quantity: str) -> str:
    """Return the errors of the models there in a sentence, the best first; empty: not known."""
    point = nearest(circuit)
    if point is None:
        return ""
    column, name = COLUMNS[quantity]
    here = [row for row in _table() if (int(row["T"]), float(row["w2"])) == point]
    known = sorted(
        (abs(float(row[column])), row["model"]) for row in here
        if math.isfinite(float(row[column])) and row["other_state"] == "0"
    )  # fmt: skip
    if not known:
        return ""
    errors = ", ".join(f"{model} {100.0 * off:.2g} %" for off, model in known)
    return (
        f" At the nearest point of the map (T = {point[0]}, "
        f"w' = {point[1]:g}, N = 1000, w = 0.3) {name} is off by: {errors}."
    )

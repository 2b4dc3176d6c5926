"""Options of a command line that describe a circuit, named like the keys of the namelist."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from postproc import cli
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS, defaults
from postproc.theory.outlines import outline_of, regular, widest

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from postproc.theory.model import Model
    from postproc.theory.outlines import Outline


def circuit_options(name: str, description: str | None) -> argparse.ArgumentParser:
    """Return a parser for a circuit by the namelist's keys, and a theory."""
    options = cli.parser(name, description)
    options.add_argument("--number", type=int, required=True, help="N, how many particles")
    both = "one for both, or urn 1's and urn 2's"
    options.add_argument(
        "--threshold", type=int, nargs="+", required=True, metavar="T", help=f"T, {both}"
    )
    options.add_argument(
        "--urn-radius", type=float, nargs="+", default=[1.0], metavar="R",
        help=f"r, {both} (default: 1.0)",
    )  # fmt: skip
    for key, default, meaning in (
        ("channel1-width", 0.3, "w"),
        ("channel1-length", 1.0, "l, both gates together"),
        ("channel2-width", 0.01, "w', 0 for the one-channel model"),
        ("channel2-length", 1.0, "l', both halves together"),
    ):
        options.add_argument(
            f"--{key}", type=float, default=default, help=f"{meaning} (default: {default})"
        )
    meanings = "; ".join(f"{one}: {model.meaning}" for one, model in MODELS.items())
    options.add_argument(
        "--urn-sides", type=int, metavar="N", help="sides of urns that are regular polygons"
    )
    options.add_argument(
        "--urn-vertices", type=float, nargs="+", metavar="X",
        help="corners x1 y1 x2 y2 ... of both urns, x to channel 1",
    )  # fmt: skip
    options.add_argument(
        "--model", choices=tuple(MODELS),
        help=f"{meanings} (default: window, and beside it direction, or renewal for polygons)",
    )  # fmt: skip
    return options


def given_models(given: argparse.Namespace, circuit: Circuit) -> tuple[Model, ...]:
    """Return the theory that is named, or the default ones for a circuit."""
    return (MODELS[given.model],) if given.model else defaults([circuit])


def given_circuit(given: argparse.Namespace) -> Circuit:
    """Return the circuit of the options, checked; the model chooses its gate."""
    _check(given)
    names = {field.name for field in fields(Circuit)} - {"gate", "occupation", "shape"}
    values = {name: value for name, value in vars(given).items()
              if name in names and value is not None}  # fmt: skip
    values["threshold"], *other_threshold = given.threshold
    values["urn_radius"], *other_radius = given.urn_radius
    return Circuit(
        **values,
        **_given_outlines(given),
        gate2_threshold=other_threshold[0] if other_threshold else None,
        urn2_radius=other_radius[0] if other_radius else None,
    )


def beside(models: Sequence[Model], answers: Sequence[dict[str, object]]) -> dict[str, object]:
    """Return the answer of the first theory, and under its name that of each other one."""
    others = zip(models[1:], answers[1:], strict=True)
    return answers[0] | {model.name: answer for model, answer in others}


def _given_outlines(given: argparse.Namespace) -> dict[str, Outline | None]:
    """Return the outlines of urns that are polygons."""
    if given.urn_vertices:
        return {"outline": outline_of(np.reshape(given.urn_vertices, (-1, 2)))}
    if given.urn_sides:
        one, *others = (regular(given.urn_sides, radius) for radius in given.urn_radius)
        return {"outline": one, "urn2_outline": others[0] if others else None}
    return {}


def _check(given: argparse.Namespace) -> None:
    """Raise `InputError` with all problems of the values."""
    corners = given.urn_vertices or (0.0,) * 6
    sides = given.urn_sides or 4
    rules = [
        (
            len(corners) % 2 == 0 and len(corners) >= 6,
            "--urn-vertices takes two numbers for each of three corners or more",
        ),
        (sides >= 4 and sides % 2 == 0, f"--urn-sides {sides} must be even, from 4 up"),
        (not (given.urn_vertices and given.urn_sides), "--urn-sides stands beside --urn-vertices"),
        (given.number >= 1, f"--number {given.number} must be at least 1"),
        (len(given.threshold) <= 2, "--threshold takes one number or two"),
        (len(given.urn_radius) <= 2, "--urn-radius takes one number or two"),
    ]
    rules += [(one >= 0, f"--threshold {one} must not be negative") for one in given.threshold]
    for radius in given.urn_radius:
        rules.append((0 < radius < math.inf, f"--urn-radius {radius} must be positive"))
    diameter = 2.0 * min(given.urn_radius)
    if all(good for good, _ in rules) and (given.urn_vertices or given.urn_sides):
        diameter = min(widest(one) for one in _given_outlines(given).values() if one)
    rules += [
        (
            0 < given.channel1_width < diameter,
            f"--channel1-width {given.channel1_width} must lie above 0 and below 2r = {diameter}",
        ),
        (
            0 <= given.channel2_width < diameter,
            f"--channel2-width {given.channel2_width} must be at least 0 and below 2r = {diameter}",
        ),
        (
            0 < given.channel1_length < math.inf,
            f"--channel1-length {given.channel1_length} must be positive",
        ),
        (
            0 < given.channel2_length < math.inf,
            f"--channel2-length {given.channel2_length} must be positive",
        ),
    ]
    problems = [text for good, text in rules if not good]
    if problems:
        raise cli.InputError("; ".join(problems))

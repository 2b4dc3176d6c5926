"""Options of a command line that describe a circuit, named like the keys of the namelist."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING

from postproc import cli
from postproc.theory.circuit import Circuit
from postproc.theory.gates import WINDOW
from postproc.theory.renewal import RENEWAL

if TYPE_CHECKING:
    import argparse


def circuit_options(name: str, description: str | None) -> argparse.ArgumentParser:
    """Return a command line that describes a circuit by the namelist's keys."""
    options = cli.parser(name, description)
    options.add_argument("--number", type=int, required=True, help="N, how many particles")
    options.add_argument("--threshold", type=int, required=True, help="T of the gates")
    for key, default, meaning in (
        ("urn-radius", 1.0, "r"),
        ("channel1-width", 0.3, "w"),
        ("channel1-length", 1.0, "l, both gates together"),
        ("channel2-width", 0.01, "w', 0 for the one-channel model"),
        ("channel2-length", 1.0, "l', both halves together"),
    ):
        options.add_argument(
            f"--{key}", type=float, default=default, help=f"{meaning} (default: {default})"
        )
    options.add_argument(
        "--gate",
        choices=("window", "renewal"),
        default="window",
        help="the paper's window of time tau, or the gate's own rule (default: window)",
    )
    options.add_argument(
        "--occupation", action="store_true", help="tell those in the channels from those in urns"
    )
    return options


def given_circuit(given: argparse.Namespace) -> Circuit:
    """Return the circuit of the options, checked."""
    _check(given)
    gate = RENEWAL if given.gate == "renewal" else WINDOW
    names = {field.name for field in fields(Circuit)} - {"gate", "shape"}
    values = {name: value for name, value in vars(given).items() if name in names}
    return Circuit(**values, gate=gate)


def _check(given: argparse.Namespace) -> None:
    """Raise with every problem of the values given."""
    diameter = 2.0 * given.urn_radius
    rules = (
        (given.number >= 1, f"--number {given.number} must be at least 1"),
        (given.threshold >= 0, f"--threshold {given.threshold} must not be negative"),
        (0 < given.urn_radius < math.inf, f"--urn-radius {given.urn_radius} must be positive"),
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
    )
    problems = [text for good, text in rules if not good]
    if problems:
        raise cli.InputError("; ".join(problems))

"""Options of a command line that describe a circuit, named like the keys of the namelist."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import TYPE_CHECKING

from postproc import circuits, cli
from postproc.theory.circuit import PAPERS_AGE
from postproc.theory.models import MODELS, defaults

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model


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
        "--theory", "--model", choices=tuple(MODELS),
        help=f"{meanings} (default: window, and beside it direction, or renewal for polygons and "
        "unequal gates or urns)",
    )  # fmt: skip
    return options


def given_models(given: argparse.Namespace, circuit: Circuit) -> tuple[Model, ...]:
    """Return the theory that is named, or the default ones for a circuit."""
    return (MODELS[given.theory],) if given.theory else defaults([circuit])


def given_circuit(given: argparse.Namespace) -> Circuit:
    """Return the circuit of the options, checked; the model chooses its gate."""
    values = {one.name: getattr(given, one.name) for one in fields(circuits.Circuit)}
    for key in ("threshold", "urn_radius"):
        values[key] = values[key][0] if len(values[key]) == 1 else values[key]
    age = getattr(given, "age", None)
    try:
        return circuits.Circuit(**values).model(PAPERS_AGE if age is None else age)
    except cli.InputError as problem:
        text = str(problem)
        for key in values:
            text = re.sub(rf"(^|; ){key} = ", rf"\1--{key.replace('_', '-')} = ", text)
        raise cli.InputError(text) from None


def beside(models: Sequence[Model], answers: Sequence[dict[str, object]]) -> dict[str, object]:
    """Return the answer of the first theory, and under its name that of each other one."""
    others = zip(models[1:], answers[1:], strict=True)
    return answers[0] | {model.name: answer for model, answer in others}

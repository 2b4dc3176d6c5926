"""Default theories of the figures, and the option that names them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from postproc.cli import InputError
from postproc.progress import each
from postproc.theory.models import FEW, MODELS, defaults

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from postproc.reading.points import Points
    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]


def named(names: Sequence[str]) -> tuple[Model, ...]:
    """Return models by their names, in that order; raise `InputError` if there is none of one."""
    for name in names:
        if name not in MODELS:
            raise InputError(f"there is no theory {name!r}; there are {', '.join(MODELS)}")
    return tuple(MODELS[name] for name in names)


def default(points: Points) -> tuple[Model, ...]:
    """Return the theories to draw beside points where none is named, `theory.models.defaults`.

    None if there are discs in channel 2, which no theory has.
    """
    return () if points.scatterers else defaults(points.circuits())


def asked(points: Points, names: Sequence[str]) -> tuple[Model, ...]:
    """Return theories by their names; raise `InputError` if one does not apply to all points."""
    models = named(names)
    for point, circuit in enumerate(points.circuits() if models else ()):
        if points.beyond_theory(point):
            what = circuit.unlike or "discs in channel 2"
            raise InputError(f"{points.files}: no theory is drawn beside {what}, at point {point}")
        for model in models:
            if refused := model.refusal(circuit):
                known = ", ".join(one for one in MODELS if not MODELS[one].refusal(circuit))
                raise InputError(f"{points.files}: {refused}; those that apply: {known}")
    return models


def add_models(options: argparse.ArgumentParser) -> None:
    """Add `--theory NAME ...`, the theories to draw."""
    options.add_argument(
        "--theory",
        "--model",
        metavar="NAME",
        nargs="+",
        choices=sorted(MODELS),
        help=f"theories to draw: {', '.join(MODELS)} (default: window and direction, which takes "
        f"two seconds a point; window and renewal for more than {FEW} points, and polygons)",
    )


def spread_and_current(
    model: Model, circuit: Circuit, thresholds: Sequence[int]
) -> tuple[Floats, Floats]:
    """Return chi and net current of the stable polarised state at each T, NaN without one."""
    states = [model.stable_state(replace(circuit, threshold=int(one)))
              for one in each(thresholds, f"states, {model.label}, threshold")]  # fmt: skip
    found = [
        (math.nan, math.nan) if one is None else (one.mass_spread, one.net_current)
        for one in states
    ]
    spread, current = np.reshape(found, (-1, 2)).T
    return spread, current

"""Default theories of the figures, and the option that names them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from postproc.progress import each
from postproc.theory.models import FEW, MODELS, defaults

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from postproc.reading.results import Results
    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]


def named(names: Iterable[str]) -> tuple[Model, ...]:
    """Return models by their names, in that order."""
    return tuple(MODELS[name] for name in names)


def default(files: Sequence[Results]) -> tuple[Model, ...]:
    """Return the theories to draw beside files where none is named, `theory.models.defaults`.

    None if there are discs in channel 2, which no theory has.
    """
    if any(one.scatterers for one in files):
        return ()
    return defaults(one.any_circuit(point) for one in files for point in range(one.points))


def add_models(options: argparse.ArgumentParser) -> None:
    """Add `--model NAME ...`, the theories to draw."""
    options.add_argument(
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

"""Default theories of the figures, and the option that names them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from postproc.progress import each
from postproc.theory.models import MODELS
from postproc.theory.programs import there

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]


def named(names: Iterable[str]) -> tuple[Model, ...]:
    """Return models by their names, in that order."""
    return tuple(MODELS[name] for name in names)


# for circuits: the paper's, the exact rule of the gate with well mixed urns, and the best
ALL = named(("window", "renewal_occupation", "direction"))
PAIR = (ALL[0], ALL[-1])  # for figures of two theories
QUICK = ALL[:2]  # for figures in which the best would take a minute
# of the single urn
WELL_MIXED = (ALL[0], replace(MODELS["renewal"], dashes="-"), ALL[1])


def best() -> tuple[Model, ...]:
    """Return the theories of `ALL`, the last one that of walkers where they are built."""
    return (*ALL[:-1], MODELS["one_particle"]) if there("one_particle") else ALL


def add_models(options: argparse.ArgumentParser) -> None:
    """Add `--model NAME ...`, the theories to draw."""
    options.add_argument(
        "--model",
        metavar="NAME",
        nargs="+",
        choices=sorted(MODELS),
        help=f"theories to draw: {', '.join(MODELS)} (default: what the figure has room for)",
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

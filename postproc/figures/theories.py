"""Default theories of the figures, and the option that names them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from postproc.cli import InputError
from postproc.theory.models import FEW, MODELS, defaults, named

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from postproc.reading.points import Points
    from postproc.theory.model import Model


def default(points: Points) -> tuple[Model, ...]:
    """Return the theories to draw beside points where none is named, `theory.models.defaults`.

    None if there are discs in channel 2, which no theory has.
    """
    return () if points.scatterers else defaults(points.circuits)


def asked(points: Points, names: Sequence[str]) -> tuple[Model, ...]:
    """Return theories by their names; raise `InputError` if one does not apply to all points."""
    circuits = points.circuits if names else []
    for point in range(len(circuits)):
        if points.beyond_theory(point):
            what = circuits[point].unlike or "discs in channel 2"
            raise InputError(f"{points.files}: no theory is drawn beside {what}, at point {point}")
    return named(names, circuits)


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

"""Theories of the figures by name, and the option that names them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from postproc.cli import InputError
from postproc.reading.points import files_of
from postproc.theory.models import FEW, MODELS, named

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    import xarray as xr

    from postproc.theory.model import Model


def asked(points: xr.Dataset, names: str | Sequence[str]) -> tuple[Model, ...]:
    """Return theories by their names; raise `InputError` if one does not apply to all points."""
    circuits = points["circuit"].values if names else []
    for at, circuit in enumerate(circuits):
        if circuit.beyond_theory:
            what = circuit.unlike or "there are discs in channel 2"
            raise InputError(
                f"{files_of(points)}: no theory is drawn where {what}, as at point {at}"
            )
    return named(names, circuits)


def add_models(options: argparse.ArgumentParser) -> None:
    """Add `--theory NAME ...`, the theories to draw."""
    options.add_argument(
        "--theory",
        "--model",
        metavar="NAME",
        nargs="+",
        action="extend",
        choices=sorted(MODELS),
        help=f"theories to draw: {', '.join(MODELS)} (default: window and direction, which takes "
        f"two seconds a point; window and renewal for more than {FEW} points, and polygons)",
    )

"""Programs that theories run: they read lines of arguments and write lines of numbers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from postproc.cli import InputError, ended_with_python

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

FOLDER = Path(__file__).resolve().parents[2] / "build/bin"
#: Folder of `make install`: that of the Python that runs `battery-postproc`.
INSTALLED = Path(sys.prefix) / "bin"


def place_of(name: str) -> Path:
    """Return the path of a program: built in this checkout, or installed; else the former."""
    places = [folder / name for folder in (FOLDER, INSTALLED)]
    return next((place for place in places if place.is_file()), places[0])


def there(name: str) -> bool:
    """Tell whether a program has been built."""
    return place_of(name).is_file()


def absence(name: str) -> str:
    """Return where a program was searched for and how to build it; empty: it exists."""
    if there(name):
        return ""
    return f"{name}: no such program in {FOLDER} (make build) or {INSTALLED} (make install)"


def answers(name: str, lines: Sequence[str]) -> NDArray[np.float64]:
    """Run a program; return the numbers of its output, a row for each line.

    Raises
    ------
    InputError : the program does not exist, or it fails.
    """
    text = "".join(f"{line}\n" for line in lines)
    program = place_of(name)
    if absent := absence(name):
        raise InputError(absent)
    try:
        done = subprocess.run(
            ended_with_python([program]), input=text, capture_output=True, text=True, check=True
        )
    except subprocess.CalledProcessError as problem:
        raise InputError(f"{program}: {problem.stderr.strip() or problem}") from problem
    return np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])

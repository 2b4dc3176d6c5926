"""Programs that theories ask: lines of words in, lines of numbers out."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from postproc.cli import InputError, ended_with_python

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

FOLDER = Path(__file__).resolve().parents[2] / "build/bin"


def there(name: str) -> bool:
    """Tell whether a program has been built."""
    return (FOLDER / name).is_file()


def answers(name: str, lines: Sequence[str]) -> NDArray[np.float64]:
    """Ask a program; return the numbers of its answer, a row a line.

    Raises
    ------
    InputError : the program is not there, or it fails.
    """
    text = "".join(f"{line}\n" for line in lines)
    program = FOLDER / name
    if not there(name):
        raise InputError(f"{program}: no such file (make build builds it)")
    try:
        done = subprocess.run(
            ended_with_python([program]), input=text, capture_output=True, text=True, check=True
        )
    except subprocess.CalledProcessError as problem:
        raise InputError(f"{program}: {problem.stderr.strip() or problem}") from problem
    return np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])

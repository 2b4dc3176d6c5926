"""Programs of studies that read lines of arguments and write lines of numbers."""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

import numpy as np

from postproc.cli import InputError, ended_with_python
from studies.common.study import ROOT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


def answers(name: str, lines: Sequence[str]) -> NDArray[np.float64]:
    """Run the program `build/bin/NAME`; return the numbers of its output, a row for each line.

    Raises
    ------
    InputError : the program does not exist, or it fails.
    """
    program = ROOT / "build/bin" / name
    if not program.is_file():
        raise InputError(f"{program}: no such program (make build/bin/{name})")
    try:
        done = subprocess.run(
            ended_with_python([program]), input="".join(f"{line}\n" for line in lines),
            capture_output=True, text=True, check=True,
        )  # fmt: skip
    except subprocess.CalledProcessError as problem:
        raise InputError(f"{program}: {problem.stderr.strip() or problem}") from problem
    return np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])

"""Answers of theories that cost seconds, kept under build/ for the next picture.

A file an answer, named by what it depends on: the question, the circuit, the program that is asked
and the modules of this package. So nothing that is old is ever found.
"""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from postproc.theory.programs import FOLDER

if TYPE_CHECKING:
    from collections.abc import Callable

    from postproc.theory.circuit import Circuit

PLACE = FOLDER.parent / "theory"


def kept(question: str, circuit: Circuit, compute: Callable[[], object]) -> object:
    """Return what `compute` says, as JSON has it, from an earlier time if it was asked before.

    Where nothing can be written nothing is kept.
    """
    asked = f"{question} {circuit!r} {_version()}"
    path = PLACE / f"{hashlib.sha256(asked.encode()).hexdigest()}.json"
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = compute()
    try:
        if FOLDER.is_dir():
            PLACE.mkdir(exist_ok=True)
            path.write_text(json.dumps(found), encoding="utf-8")
    except OSError:
        pass
    return found


@cache
def _version() -> str:
    """Return what tells this program and these modules from others."""
    told = hashlib.sha256()
    for path in sorted([*Path(__file__).parent.glob("*.[pj]*"), FOLDER / "one_particle"]):
        if path.is_file():
            told.update(path.read_bytes())
    return told.hexdigest()

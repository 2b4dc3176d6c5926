"""Answers of theories that cost seconds, kept under build/ for the next picture.

A file an answer, named by what it depends on: the question, the circuit, the program that is asked
and the modules of this package. It says so inside as well. So nothing that is old, damaged, or
somebody else's is ever believed.
"""

from __future__ import annotations

import hashlib
import json
import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from postproc.progress import doing
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
        told = json.loads(path.read_text(encoding="utf-8"))
        if told["asked"] == asked:
            return told["found"]
    except (OSError, ValueError, KeyError, TypeError):
        pass
    with doing(f"{' '.join(question.split()[:2])}, {circuit.brief}"):
        found = compute()
    try:
        if FOLDER.is_dir():
            PLACE.mkdir(exist_ok=True)
            half = path.with_suffix(f".{os.getpid()}")
            half.write_text(json.dumps({"asked": asked, "found": found}), encoding="utf-8")
            half.replace(path)
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

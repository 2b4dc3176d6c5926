"""Cache in the user's folder of results of theories that take seconds.

Each result has a file, named by all that it depends on: the question, the circuit, and the modules
of this package. The file contains this key as well, and a digest of the result. So a result that is
old, damaged, or of another circuit is never used.
"""

from __future__ import annotations

import hashlib
import json
import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from postproc.cli import InputError, replaced
from postproc.progress import doing

if TYPE_CHECKING:
    from collections.abc import Callable

    from postproc.theory.circuit import Circuit


def place() -> Path:
    """Return the folder of the cache, in $XDG_CACHE_HOME or ~/.cache."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    try:
        base = Path(given) if Path(given).is_absolute() else Path.home() / ".cache"
    except RuntimeError:  # a user without a home: a place in which nothing can be kept
        base = Path(os.devnull)
    return base / "battery" / "theory"


def kept(question: str, circuit: Circuit, compute: Callable[[], object]) -> object:
    """Return the result of `compute`, as JSON has it, from the cache if it was computed before.

    If the folder is not writable nothing is stored.
    """
    key = f"{question} {circuit!r} {_version()}"
    path = place() / f"{hashlib.sha256(key.encode()).hexdigest()}.json"
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        if stored["asked"] == key and stored["digest"] == _digest(stored["found"]):
            return stored["found"]
    except (OSError, ValueError, KeyError, TypeError):
        pass
    with doing(f"{' '.join(question.split()[:2])}, {circuit.brief}"):
        found = compute()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"asked": key, "digest": _digest(found), "found": found})
        with replaced(path) as half:
            half.write_text(text, encoding="utf-8")
    except (OSError, InputError):
        pass
    return found


def _digest(found: object) -> str:
    """Return a digest of a result, the same before and after it was stored as JSON."""
    return hashlib.sha256(json.dumps(found).encode()).hexdigest()


@cache
def _version() -> str:
    """Return a digest of the modules and their data."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.[pj]*")):
        digest.update(path.read_bytes())
    return digest.hexdigest()

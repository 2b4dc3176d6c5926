"""The probes, for tests: built, and asked."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from studies.common.probes import PRECISIONS, Question, ask
from studies.common.study import ROOT, Study


def make_probes() -> None:
    """Build the physics in three precisions; skip where there is no make."""
    if shutil.which("make") is None:
        pytest.skip("there is no make")
    command = ["make", *(f"build/bin/accuracy-{precision}" for precision in PRECISIONS)]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def run_probe(study: Study, precision: str, *words: object) -> list[dict]:
    """Ask one question; return the lines of its answer."""
    name = "-".join(map(str, (precision, *words))).replace("/", "_")
    return ask(study, [Question(name[:100], precision, tuple(map(str, words)))])[0]

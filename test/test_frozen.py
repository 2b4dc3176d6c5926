"""Frozen answers: what the engines found on odd tables in November 2026, they find for ever.

Events must be the same in the same order; times and places may differ by what rounding grew to
when `test/frozen/freeze.py` made the files, with a margin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
from frozen.frozen_file import FOLDER, Frozen, read_frozen
from support.program import run

if TYPE_CHECKING:
    from pathlib import Path

CASES = {path.stem: read_frozen(path) for path in sorted(FOLDER.glob("*.txt"))}
RUNS = [
    (name, answer, engine)
    for name, frozen in CASES.items()
    for answer, found in frozen.answers.items()
    for engine in found.engines
]
COLUMNS = ("kind", "where", "particle")


def live(folder: Path, frozen: Frozen, engine: str) -> Path:
    """Run a case by an engine; give the results."""
    (folder / "case.nml").write_text(frozen.input_of(engine), encoding="utf-8")
    (folder / "start.txt").write_text(frozen.particles, encoding="utf-8")
    ended = run("--quiet", "case.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    return folder / "out.h5"


def test_there_are_a_dozen_tables_of_hundreds_of_events() -> None:
    """What is compared below is not nothing."""
    assert len(CASES) >= 12
    assert {engine for _, _, engine in RUNS} == {
        "excursion",
        "collision",
        "synchronous",
        "timestep",
    }
    events = np.concatenate(
        [one.events for frozen in CASES.values() for one in frozen.answers.values()]
    )
    assert len(events) > 2000
    assert set(events[:, 0]) == {1, 2, 3, 4}


@pytest.mark.parametrize(
    ("name", "answer", "engine"), RUNS, ids=[f"{name}-{engine}" for name, _, engine in RUNS]
)
def test_frozen(tmp_path: Path, name: str, answer: str, engine: str) -> None:
    """Events in their order, exactly; times and the places at the end, nearly."""
    wanted = CASES[name].answers[answer]
    with h5py.File(live(tmp_path, CASES[name], engine)) as file:
        events = np.stack([file[f"events/{key}"][()] for key in COLUMNS], axis=1)
        times = file["events/time"][()]
        final = np.stack([file[f"final/{key}"][0, 0] for key in ("x", "y", "ux", "uy")], axis=1)
    common = min(len(events), len(wanted.events))
    parted = np.flatnonzero((events[:common] != wanted.events[:common]).any(axis=1))
    where = parted[0] if parted.size else common
    assert events.tolist() == wanted.events.tolist(), (
        f"the histories part at event {where} of {len(wanted.events)}"
    )
    assert np.abs(times - wanted.times).max() <= wanted.tolerance
    assert np.abs(final - wanted.final).max() <= wanted.final_tolerance

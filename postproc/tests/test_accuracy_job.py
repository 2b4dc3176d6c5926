"""What the parts of the accuracy package share: runs are resumed or replaced, numbers are kept."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from postproc import cli
from postproc.accuracy.job import NAMELISTS, Job, namelist_text
from postproc.reading.results import Results
from postproc.tests.commands import call

if TYPE_CHECKING:
    from pathlib import Path

SHORT = {"run": {"duration": 20.0, "transient_duration": 1.0}, "scan": {"replicas": 2}}


def test_run_is_kept_and_another_input_replaces_it(tmp_path: Path) -> None:
    job = Job(tmp_path)
    path = job.battery("battery", "one", SHORT)
    written = path.stat().st_mtime_ns
    assert job.battery("battery", "one", SHORT) == path
    assert path.stat().st_mtime_ns == written
    job.battery("battery", "one", {**SHORT, "gate": {"threshold": 9}})
    with Results(path) as results:
        assert results.value("threshold")[0] == 9.0
    path.write_bytes(b"not results")
    job.battery("battery", "one", SHORT)
    with Results(path) as results:
        assert results.value("threshold")[0] == 7.0


def test_bad_input_is_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(cli.InputError, match="threshold"):
        Job(tmp_path).battery("battery", "bad", {"gate": {"threshold": -1}})
    with pytest.raises(cli.InputError, match="accuracy_nothing"):
        Job(tmp_path).battery("nothing", "bad")


def test_changes_add_replace_and_remove_keys() -> None:
    text = namelist_text(
        NAMELISTS / "accuracy_battery.nml",
        {"particles": {"urn1_number": None, "number": 10}, "limits": {"wall_minutes": 1}},
    )
    assert "urn1_number" not in text
    assert "number = 10" in text
    assert "wall_minutes = 1" in text


def test_kept_numbers_are_plain_json(tmp_path: Path) -> None:
    job = Job(tmp_path)
    assert job.kept("part") is None
    job.keep("part", {"a": np.array([1.5, math.nan]), "b": {1: np.int64(3)}, "c": (math.inf, "x")})
    assert job.kept("part") == {"a": [1.5, None], "b": {"1": 3}, "c": [None, "x"]}
    json.loads((tmp_path / "part.json").read_text())


def test_unknown_part_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("accuracy", ["nothing"]) == cli.EXIT_BAD_INPUT
    assert "allowed: " in capsys.readouterr().err

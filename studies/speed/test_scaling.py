"""Scaling: what it says of a program whose speed and failures are known."""

from __future__ import annotations

import json
import stat
from typing import TYPE_CHECKING

import pytest

from postproc import cli
from studies.speed import scaling

if TYPE_CHECKING:
    from pathlib import Path

# Counts its runs beside itself; each rank works as long as the scan's points ask for.
PROGRAM = """#!/bin/sh
grep -q "channel2_width_range = 0.002, 0.1, 3" scan.nml || exit 1
echo run >> {log}
"""


def _program(folder: Path, text: str) -> Path:
    path = folder / "battery"
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_scan_is_a_namelist_with_its_numbers() -> None:
    text = scaling.scan_text(50, 1000, number=20, threshold=3, replicas=4)
    assert "channel2_width_range = 0.002, 0.1, 50" in text
    assert "transient_collisions = 500\n" in text
    assert text.count("&") == text.count("\n/") == 5


def test_each_round_runs_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = _program(tmp_path, PROGRAM.format(log=tmp_path / "log"))
    command = ["speedup", "--program", str(program), "--points", "3", "--rounds", "2"]
    assert cli.run(scaling.main, command) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found["rounds"]) == 2
    assert found["ranks"] == 2
    # One rank and two, twice.
    assert (tmp_path / "log").read_text().count("run") == 6
    ratio = found["rounds"][0]["wall_seconds"]
    assert found["rounds"][0]["speedup"] == pytest.approx(ratio[0] / ratio[1], rel=0.05)


def test_run_that_fails_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = _program(tmp_path, PROGRAM.format(log=tmp_path / "log"))
    command = ["speedup", "--program", str(program), "--points", "4", "--rounds", "1"]
    assert cli.run(scaling.main, command) == cli.EXIT_BAD_INPUT
    assert "error: mpirun" in capsys.readouterr().err


def test_missing_program_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["overhead", "--program", str(tmp_path / "none")]
    assert cli.run(scaling.main, command) == cli.EXIT_BAD_INPUT
    assert "no such program" in capsys.readouterr().err

"""What starts ranks, and what ends Python: neither makes a run go astray."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from support.program import ENVIRONMENT, PROGRAM

import postproc

if TYPE_CHECKING:
    from collections.abc import Callable

CASE = {
    "particles": {"number": 100},
    "gate": {"threshold": 5},
    "run": {"duration": 20.0},
    "scan": {"replicas": 2},
}
ENDLESS = """
import postproc, sys
case = {"particles": {"number": 100}, "gate": {"threshold": 5}, "scan": {"replicas": 4}}
postproc.run({**case, "run": {"duration": 1e8}}, ranks=int(sys.argv[1]), folder=sys.argv[2])
"""
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {**ENVIRONMENT, "BATTERY_PROGRAM": str(PROGRAM)}.items():
        monkeypatch.setenv(name, value)


@pytest.mark.parametrize(
    ("file", "options"),
    [("plain.h5", ["--tag-output"]), ("results: z.h5", []), ('"a" b.h5', ["--wdir", "elsewhere"])],
)
def test_the_path_is_not_taken_from_the_screen(
    tmp_path: Path, file: str, options: list[str]
) -> None:
    """A launcher may write before each line, or change the folder."""
    (tmp_path / "elsewhere").mkdir()
    options = [str(tmp_path / one) if one == "elsewhere" else one for one in options]
    case, start = {**CASE, "output": {"file": file}}, ["mpirun", *options, "-n"]
    made = postproc.run(case, ranks=2, folder=tmp_path / "here", quiet=True, launcher=start)
    there = postproc.run(case, ranks=2, folder=tmp_path / "here", quiet=True, launcher=start)
    assert made == there == tmp_path / ("elsewhere" if "--wdir" in options else "here") / file
    assert postproc.open_results(made).attrs["status"] == "complete"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the system cannot do that")
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_run_ends_with_its_python(tmp_path: Path, ranks: int) -> None:
    words = [sys.executable, "-c", ENDLESS, str(ranks), str(tmp_path)]
    python = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.DEVNULL)
    try:
        assert comes_true((tmp_path / "battery.h5.tasks").exists)
        assert working_in(tmp_path)
    finally:
        python.send_signal(signal.SIGKILL)
        python.wait()
    try:
        assert comes_true(lambda: not working_in(tmp_path))
    finally:
        for process in working_in(tmp_path):
            os.kill(process, signal.SIGKILL)


def comes_true(condition: Callable[[], bool]) -> bool:
    end = time.monotonic() + 60.0
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return condition()


def working_in(folder: Path) -> list[int]:
    """Return the processes whose folder that is."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if (process / "cwd").readlink() == folder:
                found.append(int(process.name))
        except OSError:  # ended, or of someone else
            continue
    return found

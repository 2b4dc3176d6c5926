"""`battery --self-test`: what is installed works, and where it does not, it says so."""

from __future__ import annotations

import re
import resource
import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest
from support.program import ALONE, PROGRAM, ROOT, run

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("ranks", [0, 3])
def test_a_good_program_passes_and_leaves_nothing(tmp_path: Path, ranks: int) -> None:
    done = run("--self-test", folder=tmp_path, ranks=ranks)
    assert done.returncode == 0, done.stderr
    first, *tests, last = done.stdout.splitlines()
    assert first.endswith(f"on {max(ranks, 1)} rank{'s' if ranks else ''}")
    assert last == f"all {len(tests)} tests passed"
    assert all(line.endswith(": passed") for line in tests)
    assert {line.split(",")[0] for line in tests[:-1]} == {
        "excursion", "collision", "synchronous", "timestep", "reservoir"}  # fmt: skip
    assert tests[-1].startswith(f"{2 * max(ranks, 1)} tasks, results file")
    assert list(tmp_path.iterdir()) == []


def test_another_answer_is_found(tmp_path: Path) -> None:
    """In a copy of the program, one digit of an event's time in one log is another."""
    text = (ROOT / "src/run/frozen_logs.f90").read_text(encoding="utf-8")
    log = text[text.index(":: timestep_circuit(") :]
    event = re.findall(r"'(\d \d+ \d+ \d+\.\d+)'", log)[9].encode()
    program = PROGRAM.read_bytes()
    assert program.count(event) == 1
    wrong = event[:-6] + bytes([(event[-6] - 48 + 5) % 10 + 48]) + event[-5:]
    other = tmp_path / "battery"
    shutil.copy(PROGRAM, other)
    other.write_bytes(program.replace(event, wrong))
    done = subprocess.run([other, "--self-test"], cwd=tmp_path, env=ALONE, text=True,
                          capture_output=True, check=False)  # fmt: skip
    assert done.returncode == 1
    failed = [line for line in done.stdout.splitlines() if "FAILED" in line]
    assert len(failed) == 1
    assert re.fullmatch(r"timestep, two urns, \d+ events: FAILED: event 10 of \d+ differs "
                        r"\(rank 0\)", failed[0])  # fmt: skip
    assert done.stderr == "battery: 1 of 9 tests failed\n"


def test_a_file_that_cannot_be_written_is_found(tmp_path: Path) -> None:
    def no_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    done = subprocess.run(
        [PROGRAM, "--self-test"],
        cwd=tmp_path,
        env=ALONE,
        text=True,
        preexec_fn=no_files,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert "results file written and read back: FAILED: " in done.stdout
    # Open MPI 5 says first that it cannot write a file of its own.
    assert done.stderr.endswith("battery: 1 of 9 tests failed\n")


def test_it_takes_no_file(tmp_path: Path) -> None:
    done = run("--self-test", "case.nml", folder=tmp_path)
    assert done.returncode == 2
    assert "case.nml: --self-test takes no file" in done.stderr

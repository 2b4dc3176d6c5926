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
        "excursion", "collision", "synchronous"}  # fmt: skip
    assert tests[-1].startswith(f"{2 * max(ranks, 1)} tasks, results file")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("array", "row", "at", "found"),
    [("event", 0, 0, "event 1 of 48 differs"), ("event", 9, -6, "event 10 of 48 differs"),
     ("event", 47, -6, "event 48 of 48 differs"), ("final", 15, -6, "the final state differs")],
)  # fmt: skip
def test_another_answer_is_found(tmp_path: Path, array: str, row: int, at: int, found: str) -> None:
    """In a copy of the program, one digit of an event's kind or time, or of a final state."""
    text = (ROOT / "src/ensemble/self_test.f90").read_text(encoding="utf-8")
    line = re.findall(r"'(.*)'", text[text.index(f":: {array}_lines(") :])[row].encode()
    program = PROGRAM.read_bytes()
    assert program.count(line) == 1
    wrong = bytearray(line)
    wrong[at] = (line[at] - 48 + 5) % 10 + 48
    other = tmp_path / "battery"
    shutil.copy(PROGRAM, other)
    other.write_bytes(program.replace(line, wrong))
    done = subprocess.run([other, "--self-test"], cwd=tmp_path, env=ALONE, text=True,
                          capture_output=True, check=False)  # fmt: skip
    assert done.returncode == 1
    failed = [line for line in done.stdout.splitlines() if "FAILED" in line]
    engines = [f"{engine}, two urns, 48 events: FAILED: {found} (rank 0)"
               for engine in ("excursion", "collision", "synchronous")]  # fmt: skip
    assert failed[:3] == engines
    if array == "final":
        assert failed[3].endswith("the final state of task 1 in the file differs")
    assert len(failed) == (4 if array == "final" else 3)
    assert done.stderr == f"battery: {len(failed)} of 4 tests failed\n"


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
    assert done.stderr.endswith("battery: 1 of 4 tests failed\n")

"""`battery --partial`: what is finished of a run, whatever the run is doing meanwhile."""

from __future__ import annotations

import resource
import shutil
import signal
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest
from support.partial import PARTIAL, check_true
from support.program import (
    assert_same,
    contents,
    finish,
    rank_processes,
    run,
    send,
    start,
    wait_for,
    write_case,
)

if TYPE_CHECKING:
    from pathlib import Path

TASKS = 24


# Tasks of a tenth of a second with all kinds of output but events.
CASE = {
    "particles": {"number": 500},
    "run": {"duration": 20000.0, "transient_duration": 500.0},
    "scan": {"threshold": "2, 4, 6", "replicas": TASKS // 3},
    "output": {"file": "'out.h5'", "series_interval": 1000.0, "snapshot_times": "0, 500",
               "final_state": ".true."},
}  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of the run without interruption."""
    folder = tmp_path_factory.mktemp("whole")
    write_case(CASE, folder)
    assert run("case.nml", folder=folder, ranks=2).returncode == 0
    return folder / "out.h5"


def test_beside_a_run_and_after_its_death_and_then_it_grows(tmp_path: Path, whole: Path) -> None:
    """Renamed to the output it goes on like any other partial file, also without the journal."""
    write_case(CASE, tmp_path)
    ended = run("--partial", "case.nml", folder=tmp_path)
    assert (ended.returncode, "no task is finished yet" in ended.stderr) == (2, True)
    process = start("case.nml", folder=tmp_path, ranks=2)
    numbers = rank_processes(process, 2)
    journal = tmp_path / "out.h5.tasks"
    # A file that is not empty may have no whole record yet.
    assert wait_for(lambda: run("--partial", "case.nml", folder=tmp_path).returncode == 0, process)
    send(numbers, signal.SIGSTOP)
    shutil.copy(whole, tmp_path / PARTIAL)  # as of a run before --overwrite
    ended = run("--partial", "case.nml", folder=tmp_path)
    assert (ended.returncode, "has more finished tasks than there are" in ended.stderr) == (2, True)
    assert_same(tmp_path / PARTIAL, whole)
    (tmp_path / PARTIAL).unlink()
    assert run("--partial", "case.nml", folder=tmp_path).returncode == 0
    beside = check_true(tmp_path / PARTIAL, whole)
    assert 0 < beside < TASKS
    send(numbers, signal.SIGKILL)
    finish(process)
    assert not (tmp_path / "out.h5").exists()
    before = sorted(path.name for path in journal.iterdir())
    assert run("--partial", "case.nml", folder=tmp_path, ranks=2).returncode == 0
    assert beside <= check_true(tmp_path / PARTIAL, whole) < TASKS
    assert sorted(path.name for path in journal.iterdir()) == before
    shutil.rmtree(journal)
    (tmp_path / "out.h5.owner").unlink(missing_ok=True)
    (tmp_path / PARTIAL).rename(tmp_path / "out.h5")
    ended = run("case.nml", folder=tmp_path, ranks=2)
    assert ended.returncode == 0, ended.stderr
    assert_same(tmp_path / "out.h5", whole)


def test_two_at_once_while_a_run_overwrites_and_ends(tmp_path: Path, whole: Path) -> None:
    """Each writes a file that is true, or has none to write."""
    write_case(CASE, tmp_path)
    (tmp_path / "out.h5").write_bytes(whole.read_bytes())
    process = start("--overwrite", "case.nml", folder=tmp_path, ranks=2)

    def ask(at: int) -> list[int]:
        counts = []
        while process.poll() is None:
            ended = run("--partial", "case.nml", folder=tmp_path)
            if ended.returncode == 0:
                kept = tmp_path / f"kept{at}.h5"
                kept.write_bytes((tmp_path / PARTIAL).read_bytes())
                counts.append(check_true(kept, whole))
            else:
                assert ended.returncode == 2, ended.stderr
                assert "no task" in ended.stderr or "has more" in ended.stderr, ended.stderr
        return counts

    with ThreadPoolExecutor() as pool:
        counts = {one for found in pool.map(ask, (0, 1)) for one in found}
    assert finish(process).returncode == 0
    assert counts
    assert_same(tmp_path / "out.h5", whole)
    assert sorted(path.name for path in tmp_path.glob("*.partial*")) == [PARTIAL]


@pytest.mark.parametrize("limit", [(32, 512), (64, 64)])
def test_more_rank_files_than_may_be_open(
    tmp_path: Path, whole: Path, limit: tuple[int, int]
) -> None:
    """The limit is raised where that is allowed; otherwise no file is left out silently."""
    write_case(CASE, tmp_path)
    process = start("case.nml", folder=tmp_path)
    journal = tmp_path / "out.h5.tasks"
    # A file that is not empty may have no whole record yet.
    assert wait_for(lambda: run("--partial", "case.nml", folder=tmp_path).returncode == 0, process)
    send([process.pid], signal.SIGKILL)
    finish(process)
    (tmp_path / PARTIAL).unlink()
    results = (journal / "rank_0").read_bytes()
    for rank in range(101):
        (journal / f"rank_{rank}").write_bytes(b"")
    # The one with results is opened last.
    last = list(journal.glob("rank_*"))[-1]
    last.write_bytes(results)
    ended = run(
        "--partial", "case.nml", folder=tmp_path,
        prepare=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, limit),
    )  # fmt: skip
    if limit[1] > 100:
        assert ended.returncode == 0, ended.stderr
        assert check_true(tmp_path / PARTIAL, whole) > 0
    else:
        assert (ended.returncode, "101 files" in ended.stderr) == (1, True), ended.stderr
        assert not (tmp_path / PARTIAL).exists()


@pytest.mark.parametrize("there", ["text", "another input"])
def test_only_a_partial_file_of_its_own_input_is_replaced(
    tmp_path: Path, whole: Path, there: str
) -> None:
    write_case(CASE, tmp_path, scan={"channel2_width": "0.02"})
    if there == "text":
        (tmp_path / PARTIAL).write_text("mine\n")
    else:
        (tmp_path / PARTIAL).write_bytes(whole.read_bytes())
    before = (tmp_path / PARTIAL).read_bytes()
    ended = run("--partial", "case.nml", folder=tmp_path)
    assert (ended.returncode, "move it away" in ended.stderr) == (2, True)
    assert (tmp_path / PARTIAL).read_bytes() == before


def test_of_results_that_are_complete_it_is_a_copy(tmp_path: Path, whole: Path) -> None:
    write_case(CASE, tmp_path)
    (tmp_path / "out.h5").write_bytes(whole.read_bytes())
    ended = run("--partial", "case.nml", folder=tmp_path)
    assert ended.stdout == f"{PARTIAL}: has {TASKS} of {TASKS} tasks\n"
    assert contents(tmp_path / PARTIAL).keys() == contents(whole).keys()
    assert_same(tmp_path / PARTIAL, whole)

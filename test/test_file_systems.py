"""File systems that lack locks (NFS, Lustre), a sync of folders, or for a moment an answer."""

from __future__ import annotations

import errno
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
from support.program import (
    ROOT,
    assert_same,
    call_failing,
    command_of,
    finish,
    kill_all,
    run,
    under_way,
    write_case,
)

ENOTSUPP = 524  # of the kernel, without a name in errno.h
LACKS = [("NO_FLOCK", number) for number in (errno.ENOLCK, errno.EOPNOTSUPP, ENOTSUPP)]
LACKS += [("NO_FOLDER_SYNC", number)
          for number in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EBADF)]  # fmt: skip
LACKS += [("NO_SYNC_FOR_READING", errno.EACCES), ("SIGNALS", 1),
          ("NO_REMOVAL_OF_OPEN", errno.ETXTBSY), ("NO_REPLACEMENT", errno.EEXIST),
          ("NO_REPLACEMENT", errno.EPERM)]  # fmt: skip
READ = "import postproc; print(int(postproc.open_results('out.h5')['chi'].count()))"


CASE = {
    "particles": {"number": 60},
    "gate": {"threshold": 2},
    "run": {"duration": 2000},
    "output": {"file": "'out.h5'"},
}


@pytest.mark.full
@pytest.mark.parametrize(("name", "number"), LACKS)
def test_a_file_system_that_lacks_a_call_is_as_good(
    lacking: str, tmp_path: Path, name: str, number: int
) -> None:
    """A stop, its resumption, the same again, `--check`, growth and `open_results` all succeed."""
    without = {"LD_PRELOAD": lacking, name: str(number)}

    def done(*words: str, code: int = 0) -> str:
        ended = run(*words, "case.nml", folder=tmp_path, environment=without)
        assert (ended.returncode, ended.stderr) == (code, "")
        return ended.stdout

    write_case(CASE, tmp_path, scan={"replicas": 2}, limits={"wall_minutes": "1e-6"})
    # A run that was killed has left its lock, with the number of a process longer than any here.
    of_killed = f"{socket.gethostname()} 4194303999 2026-11-29 12:00:00.000"
    (tmp_path / "out.h5.owner").write_text(of_killed)
    done("--quiet", code=3)
    assert not (tmp_path / "out.h5.owner").exists()
    write_case(CASE, tmp_path, scan={"replicas": 2})
    assert "going on" in done()
    assert "is complete" in done()
    assert "is complete" in done("--check")
    write_case(CASE, tmp_path, scan={"replicas": 3})
    assert "going on: 2 of 3" in done()
    read = subprocess.run(
        [sys.executable, "-c", READ], cwd=tmp_path, capture_output=True, text=True, check=False,
        env={**os.environ, **without, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert (read.stdout, read.stderr) == ("3\n", "")
    write_case(CASE, tmp_path / "calm", scan={"replicas": 3})
    assert run("--quiet", "case.nml", folder=tmp_path / "calm").returncode == 0
    assert_same(tmp_path / "out.h5", tmp_path / "calm/out.h5")


def test_a_user_whom_the_machine_does_not_know_runs_it(lacking: str, tmp_path: Path) -> None:
    """As in containers; Open MPI 4 crashes there."""
    write_case(CASE, tmp_path)
    words = ["env", "-u", "HOME", f"LD_PRELOAD={lacking}", "NO_USER=1", *command_of("case.nml")]
    ended = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.full
def test_a_failing_disk_is_an_error_for_a_folder_too(lacking: str, tmp_path: Path) -> None:
    write_case(CASE, tmp_path, scan={"replicas": 2})
    failing = {"LD_PRELOAD": lacking, "NO_FOLDER_SYNC": str(errno.EIO)}
    ended = run("--quiet", "case.nml", folder=tmp_path, environment=failing)
    assert ended.returncode == 1
    assert "Input/output error" in ended.stderr


def test_results_that_cannot_be_read_back_leave_the_journal(lacking: str, tmp_path: Path) -> None:
    unpublished(tmp_path, lacking)
    assert "going on: 2 of 2" in run("case.nml", folder=tmp_path).stdout


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE, errno.EACCES])
@pytest.mark.parametrize(
    ("call", "name"),
    [
        ("opendir", "out.h5.tasks"), ("readdir", "out.h5.tasks"), ("stat", "out.h5.tasks"),
        ("stat", "rank_0"), ("access", "rank_0"), ("access", "plan"),
        ("access", "out.h5"), ("lstat", "out.h5"),
    ],
)  # fmt: skip
def test_an_error_does_not_say_that_a_file_is_missing(
    lacking: str, tmp_path: Path, call: str, name: str, number: int
) -> None:
    """No finished task is computed again: the run ends, or goes on as without the error."""
    if name == "out.h5":
        write_case(CASE, tmp_path, scan={"replicas": 2})
        run("--quiet", "case.nml", folder=tmp_path)
        write_case(CASE, tmp_path, scan={"replicas": 3})
    else:
        unpublished(tmp_path, lacking)
    whole = shutil.copytree(tmp_path, tmp_path / "whole")
    run("--quiet", "case.nml", folder=whole)
    for option in ("--check", "--partial", "--quiet"):
        for after in (1, 2, 3):
            away = call_failing(lacking, call, name, number, after)
            run(option, "case.nml", folder=tmp_path, environment=away)
    run("--quiet", "case.nml", folder=tmp_path)
    seconds = []
    for folder in (whole, tmp_path):
        with h5py.File(folder / "out.h5") as file:
            assert set(file["task_status"][()].ravel()) == {0}
            seconds.append(file["cpu_seconds"][0, :2].tolist())
    assert seconds[0] == seconds[1]


@pytest.mark.parametrize("after", [1, 16, 46])
def test_results_that_hdf5_cannot_read_are_one_line(
    lacking: str, tmp_path: Path, after: int
) -> None:
    """Also where their digest is right, so that they are not damaged: the disk fails for HDF5."""
    write_case(CASE, tmp_path, scan={"replicas": 2})
    assert run("--quiet", "case.nml", folder=tmp_path).returncode == 0
    away = call_failing(lacking, "pread64", "out.h5", errno.EIO, after)
    read = subprocess.run(
        [sys.executable, "-m", "postproc", "table", "out.h5"], cwd=tmp_path, capture_output=True,
        text=True, check=False, env={**os.environ, **away, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert read.returncode == 2
    assert len(read.stderr.splitlines()) == 1


def test_results_that_the_system_cannot_close_are_no_crash(lacking: str, tmp_path: Path) -> None:
    """As on a disk that has gone away; HDF5 1.10 crashes if its close of a file fails."""
    write_case(CASE, tmp_path, scan={"replicas": 2})
    assert run("--quiet", "case.nml", folder=tmp_path).returncode == 0
    write_case(CASE, tmp_path, scan={"replicas": 3})
    for after in range(1, 5):
        away = call_failing(lacking, "close", "out.h5", errno.ENOTCONN, after)
        ended = run("--check", "case.nml", folder=tmp_path, environment=away)
        assert ended.returncode in {0, 1, 2}
        assert "SIGSEGV" not in ended.stderr


def test_a_lock_file_that_cannot_be_looked_at_is_an_error(lacking: str, tmp_path: Path) -> None:
    """It is that of a run that is dead; the next one neither waits for ever nor takes it."""
    write_case(CASE, tmp_path, run={"duration": 1e12}, limits={"checkpoint_minutes": 0.001})
    process, _ = under_way("--quiet", "case.nml", folder=tmp_path)
    kill_all(process)
    finish(process)
    away = call_failing(lacking, "lstat", "out.h5.owner", errno.ESTALE)
    ended = run("--quiet", "case.nml", folder=tmp_path, environment=away)
    assert (ended.returncode, "Stale file handle" in ended.stderr) == (2, True)
    assert (tmp_path / "out.h5.owner").exists()


def test_overwrite_does_not_go_on_from_a_journal_that_it_cannot_see(
    lacking: str, tmp_path: Path
) -> None:
    unpublished(tmp_path, lacking)
    away = call_failing(lacking, "stat", "out.h5.tasks", errno.EIO)
    ended = run("--overwrite", "--quiet", "case.nml", folder=tmp_path, environment=away)
    assert ended.returncode == 1
    assert "out.h5.tasks: is not a folder, or cannot be read, and is kept" in ended.stderr
    assert "going on: 2 of 2" in run("case.nml", folder=tmp_path).stdout


def test_overwrite_keeps_results_where_no_journal_can_begin(lacking: str, tmp_path: Path) -> None:
    write_case(CASE, tmp_path, scan={"replicas": 2})
    run("--quiet", "case.nml", folder=tmp_path)
    away = call_failing(lacking, "mkdir", "out.h5.tasks", errno.EDQUOT)
    ended = run("--overwrite", "--quiet", "case.nml", folder=tmp_path, environment=away)
    assert (ended.returncode, "cannot be made: Disk quota exceeded" in ended.stderr) == (1, True)
    assert "out.h5 is complete" in run("case.nml", folder=tmp_path).stdout


@pytest.mark.parametrize(
    ("call", "end", "number"),
    [("renameat2", "out.h5", errno.ESTALE), ("rename", "tasks/plan", errno.EEXIST),
     ("rename", "tasks/plan", errno.ENOENT)],
)  # fmt: skip
def test_what_was_renamed_though_the_answer_was_lost_is_there(
    lacking: str, tmp_path: Path, call: str, end: str, number: int
) -> None:
    write_case(CASE, tmp_path, scan={"replicas": 2})
    away = call_failing(lacking, call, end, number)
    ended = run("--quiet", "case.nml", folder=tmp_path, environment=away)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert sorted(path.name for path in tmp_path.glob("out.h5*")) == ["out.h5"]


def test_what_a_file_server_leaves_in_the_journal_is_no_error(tmp_path: Path) -> None:
    """A file that is removed while it is open elsewhere keeps a hidden name (NFS, sshfs)."""
    write_case(CASE, tmp_path, scan={"replicas": 2}, limits={"wall_minutes": "1e-6"})
    assert run("--quiet", "case.nml", folder=tmp_path).returncode == 3
    (tmp_path / "out.h5.tasks/.nfs0001").touch()
    write_case(CASE, tmp_path, scan={"replicas": 2})
    for _ in range(2):
        ended = run("--quiet", "case.nml", folder=tmp_path)
        assert (ended.returncode, ended.stderr) == (0, "")


def unpublished(folder: Path, lacking: str) -> None:
    """Leave a journal with all results in a folder: the results file could not be read back."""
    write_case(CASE, folder, scan={"replicas": 2})
    away = call_failing(lacking, "read", "out.h5.part", errno.EIO)
    ended = run("--quiet", "case.nml", folder=folder, environment=away)
    assert ended.returncode == 1
    assert "out.h5.part cannot be read to its end: Input/output error" in ended.stderr
    assert sorted(path.name for path in folder.glob("out.h5*")) == ["out.h5.tasks"]

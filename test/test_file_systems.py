"""File systems that lack something: locks (NFS, Lustre), or a sync of folders."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from support.program import ROOT, assert_same, run, write_case

if TYPE_CHECKING:
    from pathlib import Path

ENOTSUPP = 524  # of the kernel, without a name in errno.h
LACKS = [("NO_FLOCK", number) for number in (errno.ENOLCK, errno.EOPNOTSUPP, ENOTSUPP)]
LACKS += [("NO_FOLDER_SYNC", number)
          for number in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EBADF)]  # fmt: skip
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
    done("--quiet", code=3)
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


@pytest.mark.full
def test_a_failing_disk_is_an_error_for_a_folder_too(lacking: str, tmp_path: Path) -> None:
    write_case(CASE, tmp_path, scan={"replicas": 2})
    failing = {"LD_PRELOAD": lacking, "NO_FOLDER_SYNC": str(errno.EIO)}
    ended = run("--quiet", "case.nml", folder=tmp_path, environment=failing)
    assert ended.returncode == 1
    assert "Input/output error" in ended.stderr


def test_results_that_cannot_be_read_back_leave_the_journal(lacking: str, tmp_path: Path) -> None:
    write_case(CASE, tmp_path, scan={"replicas": 2})
    failing = {"LD_PRELOAD": lacking, "NO_READ_OF": "/out.h5.part", "NO_READ": str(errno.EIO)}
    ended = run("--quiet", "case.nml", folder=tmp_path, environment=failing)
    assert ended.returncode == 1
    assert "out.h5.part cannot be read to its end: Input/output error" in ended.stderr
    assert sorted(path.name for path in tmp_path.glob("out.h5*")) == ["out.h5.tasks"]
    assert "going on: 2 of 2" in run("case.nml", folder=tmp_path).stdout

"""The program with MPICH in place of Open MPI: the same tests, and the same bits."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from support.program import ROOT, contents, make, namelist, run

if TYPE_CHECKING:
    from pathlib import Path

PROGRAM = ROOT / "build/mpich/bin/battery"
# For the program of MPICH under its own mpirun.
WITH_MPICH = {**os.environ, "MPI": "mpich", "MPIFC": "mpifort.mpich", "FPM_FC": "mpifort.mpich",
              "BATTERY_PROGRAM": str(PROGRAM), "BATTERY_MPIRUN": "mpirun.mpich"}  # fmt: skip
# What says how the program was built.
OF_THE_BUILD = {"/@mpi_library", "/@compiler_options", "/@git_commit"}
# Starts, ranks, signals, kills, tasks in any order.
END_TO_END = "ranks or killed or signal or stopped_again"

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(
        not (shutil.which("mpifort.mpich") and shutil.which("mpirun.mpich")),
        reason="MPICH is not installed (mpich, libmpich-dev, libhdf5-mpich-dev)",
    ),
]


def ended_well(*command: str) -> None:
    """Run a command with MPICH; what it printed is shown if it fails."""
    ended = subprocess.run(
        command, cwd=ROOT, env=WITH_MPICH, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, (ended.stdout + ended.stderr)[-4000:]


@pytest.fixture(scope="module", autouse=True)
def _built() -> None:
    """Build the program with MPICH, in a folder of its own."""
    make("build", "MPI=mpich", "MPIFC=mpifort.mpich")


def test_the_tests_of_ranks_pass() -> None:
    """Those in Fortran, with every check of the debug build."""
    folder = ROOT / "build/mpich/test_package"
    ended_well(sys.executable, "test/run", "test/test_ranks.pf", "--flavour", "debug",
               "--folder", str(folder))  # fmt: skip


def test_ensembles_survive_the_same() -> None:
    """The tests of ensembles that stop, kill and resume ranks."""
    ended_well(sys.executable, "-m", "pytest", "-q", "test/test_ensemble.py", "-k", END_TO_END)


def test_the_bits_are_those_of_open_mpi(tmp_path: Path) -> None:
    """On two ranks of each; the file says which MPI it was."""
    text = namelist(
        particles={"number": 100}, gate={"threshold": 3}, run={"collisions": 1_000_000},
        scan={"channel2_width": "0.01, 0.1", "replicas": 2}, output={"file": "'out.h5'"},
    )  # fmt: skip
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "case.nml").write_text(text)
    assert run("case.nml", folder=tmp_path / "one", ranks=2).returncode == 0
    subprocess.run(["mpirun.mpich", "-n", "2", str(PROGRAM), "case.nml"],
                   cwd=tmp_path / "other", check=True, capture_output=True)  # fmt: skip
    found = [contents(tmp_path / name / "out.h5") for name in ("one", "other")]
    one, other = found
    assert one["/@mpi_library"][0].startswith("Open MPI")
    assert re.fullmatch(r"MPICH Version: [\d.]+", other["/@mpi_library"][0])
    assert one.keys() == other.keys()
    assert {name for name in one if one[name] != other[name]} <= OF_THE_BUILD

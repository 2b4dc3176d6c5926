"""The example jobs for a cluster: their shell, their directives (test_slurm.py runs them)."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted((ROOT / "namelists").glob("slurm*.sh"))


def directives(text: str) -> dict[str, str]:
    """Read the #SBATCH lines before the first command, as sbatch does; test_slurm.py asks it."""
    head = re.match(r"(?:#.*\n|\s*\n)*", text)[0]
    return dict(re.findall(r"^#SBATCH --([\w-]+)=?(\S*)", head, re.MULTILINE))


@pytest.fixture(params=SCRIPTS, ids=lambda script: script.name)
def script(request: pytest.FixtureRequest) -> Path:
    """Give each example."""
    return request.param


def test_shell_accepts_the_script(script: Path) -> None:
    """Bash reads the script without complaint."""
    checked = subprocess.run(["bash", "-n", script], capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stderr) == (0, "")


def test_directives_come_before_any_command(script: Path) -> None:
    """Every directive stands before any command, and what an example needs is among them."""
    text = script.read_text()
    found = directives(text)
    assert len(found) == sum(line.startswith("#SBATCH") for line in text.splitlines())
    assert {"ntasks", "time", "signal", "requeue"} <= found.keys()
    # A job that is queued again goes on with the same log.
    assert found["open-mode"] == "append"
    # What else a site must change is there to be uncommented.
    assert {"##SBATCH --partition=NAME", "##SBATCH --account=NAME"} <= set(text.splitlines())
    assert "# module load " in text


def test_signal_reaches_the_program(script: Path) -> None:
    """A signal that saves the state, a minute or more before; B: only to a script that hears it."""
    signal = directives(script.read_text())["signal"]
    name, _, seconds = signal.removeprefix("B:").partition("@")
    assert name in {"USR1", "TERM", "INT"}
    assert int(seconds) >= 60
    hears = f"trap 'stopped=yes; kill -{name}" in script.read_text()
    assert signal.startswith("B:") == hears


@pytest.mark.parametrize("name", ["slurm.sh", "slurm_mpirun.sh"])
@pytest.mark.parametrize("argument", [[], ["mine.nml"]], ids=["none", "one"])
def test_a_job_runs_the_namelist_that_it_is_given(
    tmp_path: Path, name: str, argument: list[str]
) -> None:
    """As `sbatch SCRIPT FILE.nml` passes it; without one that of the example."""
    for command in ("srun", "mpirun", "build/bin/battery"):
        (tmp_path / command).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / command).write_text('#!/bin/sh\necho "$@"\n')
        (tmp_path / command).chmod(0o755)
    told = subprocess.run(
        ["bash", ROOT / "namelists" / name, *argument], cwd=tmp_path, check=True, text=True,
        env={"PATH": f"{tmp_path}:/usr/bin:/bin"}, stdout=subprocess.PIPE,
    ).stdout  # fmt: skip
    assert told.split()[-1] == (argument or ["namelists/phase_diagram.nml"])[0]


def test_an_array_has_a_namelist_and_an_output_for_each_element() -> None:
    """As many elements as namelists, each with an output file of its own."""
    text = (ROOT / "namelists/slurm_array.sh").read_text()
    pattern = re.search(r"namelists=\((.*)\)", text)
    assert pattern
    files = sorted(ROOT.glob(pattern[1]))
    outputs = {re.search(r"file *= *'(.*)'", file.read_text())[1] for file in files}
    assert directives(text)["array"] == f"0-{len(files) - 1}"
    assert len(outputs) == len(files)

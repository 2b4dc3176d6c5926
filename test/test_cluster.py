"""The example job for a cluster: its shell, its directives, and what it runs."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = ROOT / "namelists/slurm.sh"

# Options of sbatch that an example may use, and what they take (sbatch's manual, 22.05).
COUNT = r"\d+"
TIME = r"(\d+-)?\d{1,2}(:\d{2}){0,2}"
OPTIONS = {
    "job-name": r"[\w.-]+",
    "ntasks": COUNT,
    "nodes": rf"{COUNT}(-{COUNT})?",
    "ntasks-per-node": COUNT,
    "cpus-per-task": COUNT,
    "mem-per-cpu": r"\d+[KMGT]?",
    "time": TIME,
    "partition": r"[\w.-]+",
    "account": r"[\w.-]+",
    "output": r"[\w.%/-]+",
    "error": r"[\w.%/-]+",
    "open-mode": r"append|truncate",
    "signal": r"(R?B?:)?(USR1|USR2|TERM|INT|\d{1,2})(@\d{1,5})?",
    "requeue": None,
    "no-requeue": None,
}


def directives(text: str) -> dict[str, str | None]:
    """Read the #SBATCH lines before the first command, as sbatch does.

    Raises
    ------
    ValueError : an option that sbatch does not have, or a value that it does not take.
    """
    found: dict[str, str | None] = {}
    for line in text.splitlines():
        if not line.startswith("#"):
            if line.strip():
                break
            continue
        if not line.startswith("#SBATCH"):
            continue
        for word in shlex.split(line.removeprefix("#SBATCH"), comments=True):
            name, _, value = word.removeprefix("--").partition("=")
            if not word.startswith("--") or name not in OPTIONS:
                raise ValueError(f"no such option: {word}")
            pattern = OPTIONS[name]
            if (pattern is None) == bool(value) or not re.fullmatch(pattern or "", value):
                raise ValueError(f"no such value: {word}")
            found[name] = value or None
    return found


def test_shell_accepts_the_script() -> None:
    """Bash reads the script without complaint."""
    checked = subprocess.run(["bash", "-n", SCRIPT], capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stderr) == (0, "")


def test_directives_are_those_of_sbatch() -> None:
    """Every directive is an option of sbatch with a value that it takes, before any command."""
    text = SCRIPT.read_text()
    found = directives(text)
    assert len(found) == text.count("#SBATCH")
    assert {"ntasks", "time", "signal", "requeue"} <= found.keys()
    # A job that is queued again goes on with the same log.
    assert found["open-mode"] == "append"


def test_signal_is_one_that_the_program_hears() -> None:
    """All ranks get the signal (no B:), one that saves the state, a minute or more before."""
    name, _, seconds = str(directives(SCRIPT.read_text())["signal"]).partition("@")
    assert name in {"USR1", "TERM", "INT"}
    assert int(seconds) >= 60


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("--requeue", "--requeu"),
        ("--requeue", "--requeue=yes"),
        ("USR1@120", "USR7@120"),
        ("--time=04:00:00", "--time=4hours"),
        ("--open-mode=append", "--open-mode=add"),
        ("--ntasks=64", "--ntasks"),
        ("--ntasks=64", "-ntasks=64"),
    ],
)
def test_wrong_directives_are_found(old: str, new: str) -> None:
    """The check of the directives finds what sbatch refuses."""
    text = SCRIPT.read_text()
    assert old in text
    with pytest.raises(ValueError, match="no such"):
        directives(text.replace(old, new))


def test_what_it_runs_is_there() -> None:
    """The namelist of the job is in the project, and exit code 3 queues the job again."""
    text = SCRIPT.read_text()
    (command,) = re.findall(r"^srun +(.*)$", text, re.MULTILINE)
    program, *arguments = shlex.split(command)
    assert program == "build/bin/battery"
    assert (ROOT / arguments[-1]).is_file()
    fake = 'srun() { return $CODE; }; scontrol() { echo "$@"; }; SLURM_JOB_ID=7\n'
    for code, said in ((3, "requeue 7\n"), (0, ""), (1, "")):
        ended = subprocess.run(
            ["bash", "-c", f"CODE={code}; {fake}{text}"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert (ended.returncode, ended.stdout) == (code, said)

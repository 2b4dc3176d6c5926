"""A map grows in five steps, killed and stopped on the way, on other ranks at each start.

Each step adds values to a list, replicas, or a precision. In the end the file must have the bits of
one undisturbed run of the whole; a smaller namelist in between must be refused.
"""

from __future__ import annotations

import random
import signal
import sys
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Any

from support.program import kill_all, namelist, rank_processes, send, start

from .common import Outcome, attempt, command_line, ended, unlike

PRECISION = {"chi_replica_error": 0.02, "largest_replicas": 24}
STEPS: list[dict[str, dict[str, Any]]] = [
    {"scan": {"channel2_width": "0.1", "replicas": 2}},
    {"scan": {"channel2_width": "0.01, 0.1", "replicas": 2}},
    {"scan": {"channel2_width": "0.01, 0.1", "threshold": "1, 2", "replicas": 3}},
    {"scan": {"channel2_width": "0.01, 0.03, 0.1", "threshold": "1, 2, 4", "replicas": 16}},
    {
        "scan": {"channel2_width": "0.01, 0.03, 0.1", "threshold": "1, 2, 4", "replicas": 16},
        "precision": PRECISION,
    },
]


def write(folder: Path, step: int) -> None:
    """Write the namelist of a step."""
    case = {
        "particles": {"number": 100},
        "gate": {"threshold": 2},
        "run": {"duration": 3000},
        "output": {"file": "'out.h5'", "series_interval": 100, "final_state": ".true."},
        "limits": {"checkpoint_minutes": 0.0005},
    }
    (folder / "case.nml").write_text(namelist(**case, **STEPS[step]), encoding="utf-8")


@cache
def whole() -> Path:
    """Give the results of one run of the last step."""
    folder = Path(tempfile.mkdtemp(prefix="whole-"))
    write(folder, len(STEPS) - 1)
    found = attempt("--quiet", "case.nml", folder=folder)
    assert found.code == 0, found.words
    return folder / "out.h5"


def disturb(folder: Path, choice: random.Random) -> None:
    """Start the step that is written, and kill or stop it."""
    ranks = choice.choice([0, 1, 2, 3])
    process = start("--quiet", "case.nml", folder=folder, ranks=ranks)
    numbers = rank_processes(process, ranks)
    time.sleep(choice.uniform(0.0, 0.8))
    if choice.random() < 0.6 or not numbers:
        kill_all(process)
    else:
        send(numbers, choice.choice([signal.SIGTERM, signal.SIGUSR1]))
    ended(process)


def complete(folder: Path, choice: random.Random) -> str:
    """Run the step that is written to its end; tell what is wrong."""
    for _ in range(10):
        # Ranks that outlive their mpirun may still own the output.
        found = attempt("case.nml", folder=folder, ranks=choice.choice([0, 1, 2, 3]))
        if found.code != 2:
            break
        time.sleep(1.0)
    return found.wrong({0})


def shrinks(folder: Path, step: int) -> str:
    """Tell whether the step before, which is smaller, was let in."""
    if step == 0:
        return ""
    write(folder, step - 1)
    before = (folder / "out.h5").read_bytes()
    found = attempt("case.nml", folder=folder)
    same = (folder / "out.h5").read_bytes() == before
    return "" if found.code == 2 and same else f"shrank: exit {found.code}"


def grow(folder: Path, choice: random.Random) -> Outcome:
    """Grow one map; some steps are never completed."""
    outcome = Outcome(0)
    for step in range(len(STEPS)):
        write(folder, step)
        for _ in range(choice.randint(0, 3)):
            outcome.tried += 1
            disturb(folder, choice)
        if step < len(STEPS) - 1 and choice.random() < 0.5:
            continue
        if wrong := complete(folder, choice) or shrinks(folder, step):
            outcome.findings.append(f"step {step}: {wrong}")
            return outcome
    if wrong := unlike(folder / "out.h5", whole()):
        outcome.findings.append(f"the results file {wrong}")
    left = sorted(path.name for path in folder.iterdir())
    if not outcome.findings and left != ["case.nml", "out.h5"]:
        outcome.findings.append(f"left behind: {left}")
    return outcome


if __name__ == "__main__":
    sys.exit(command_line("growth", grow, __doc__ or ""))

"""The ensemble under attack, its undisturbed results, and a run of it that was killed half way."""

from __future__ import annotations

import atexit
import functools
import shutil
import signal
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from support.program import finish, namelist, run, send, start, wait_for

if TYPE_CHECKING:
    from subprocess import Popen

TASKS = 4
ENGINES = {
    "excursion": 80_000_000,
    "collision": 1_000_000,
    "synchronous": 200_000,
    "timestep": 40_000,
    "reservoir": 40_000_000,
}


def write(folder: Path, engine: str = "excursion", **groups: dict[str, Any]) -> None:
    """Write the ensemble, some keys changed."""
    case: dict[str, dict[str, Any]] = {
        "particles": {"number": 200},
        "gate": {"threshold": 3},
        "run": {"engine": f"'{engine}'", "collisions": ENGINES[engine], "time_step": 0.004},
        "scan": {"channel2_width": "0.01, 0.1", "replicas": TASKS // 2},
        "output": {
            "file": "'out.h5'",
            "series_interval": 100,
            "snapshot_times": "0, 100",
            "final_state": ".true.",
        },
        "limits": {"checkpoint_minutes": 0.0005},
    }
    for group, keys in groups.items():
        case[group] = {**case[group], **keys}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.nml").write_text(namelist(**case), encoding="utf-8")


@functools.cache
def workshop() -> Path:
    """Give a folder that lasts as long as this program."""
    folder = Path(tempfile.mkdtemp(prefix="attack-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@functools.cache
def undisturbed(engine: str = "excursion", threshold: int = 3, collisions: int = 0) -> Path:
    """Give the results of a run that nobody disturbs; collisions 0: as many as usual."""
    # Trials at the same time may each make them.
    folder = Path(tempfile.mkdtemp(dir=workshop()))
    write(
        folder,
        engine,
        gate={"threshold": threshold},
        run={"collisions": collisions or ENGINES[engine]},
    )
    found = run("--quiet", "case.nml", folder=folder)
    assert found.returncode == 0, found.stderr
    return folder / "out.h5"


@functools.cache
def half_way() -> Path:
    """Give a folder with a run killed after a finished task, with states of the next."""
    # On a busy machine a run may get by between two looks: then there is another.
    for number in range(5):
        folder = workshop() / f"half_way_{number}"
        write(folder)
        process = start("--quiet", "case.nml", folder=folder)
        found = stopped_half_way(process, folder / "out.h5.tasks")
        send([process.pid], signal.SIGKILL)
        finish(process)
        if found:
            return folder
    raise AssertionError("no run was seen half way")


def stopped_half_way(process: Popen[str], journal: Path) -> bool:
    """Stop a run that has a finished task and both states of the next; false if it has ended."""

    def far_enough() -> bool:
        # A generation is away for a moment while it is made anew: look while nothing moves.
        send([process.pid], signal.SIGSTOP)
        part = journal / "rank_0"
        if (part.exists() and part.stat().st_size > 0
                and len(list(journal.glob("task_*.[ab]"))) == 2):  # fmt: skip
            return True
        send([process.pid], signal.SIGCONT)
        return False

    return wait_for(far_enough, process)

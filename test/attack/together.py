"""Several runs of one output at once: the same input, or another one with `--overwrite`.

Each must end with exit 0 or 2, one at least with 0, and what is there in the end are the results
of one input, whole.
"""

from __future__ import annotations

import random
import signal
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from support.program import rank_processes, send, start

from .common import Outcome, attempt, command_line, ended, unlike
from .scene import undisturbed, write

if TYPE_CHECKING:
    import subprocess
    from pathlib import Path

THRESHOLDS = (3, 4)


@dataclass
class Run:
    """One of the runs: its input, its ranks (0: without mpirun), its process."""

    threshold: int
    ranks: int
    process: subprocess.Popen[str]


def launch(folder: Path, choice: random.Random) -> list[Run]:
    """Start a few runs within a moment."""
    for threshold in THRESHOLDS:
        write(folder, gate={"threshold": threshold})
        (folder / "case.nml").rename(folder / f"case{threshold}.nml")
    runs = []
    other_inputs = choice.random() < 0.5
    for k in range(choice.choice([2, 2, 3, 4])):
        threshold = choice.choice(THRESHOLDS) if other_inputs and k else THRESHOLDS[0]
        words = ["--overwrite"] if threshold != THRESHOLDS[0] or choice.random() < 0.2 else []
        ranks = choice.choice([0, 0, 2])
        process = start(*words, f"case{threshold}.nml", folder=folder, ranks=ranks)
        runs.append(Run(threshold, ranks, process))
        time.sleep(choice.choice([0.0, choice.uniform(0.0, 0.05), choice.uniform(0.0, 0.5)]))
    return runs


def attack(folder: Path, choice: random.Random) -> Outcome:
    """Start a few runs, kill one of them perhaps, and look at what is left."""
    outcome = Outcome()
    runs = launch(folder, choice)
    victim = choice.randrange(len(runs)) if choice.random() < 0.3 else None
    if victim is not None:
        send(rank_processes(runs[victim].process, runs[victim].ranks)[:1], signal.SIGKILL)
    winners = set()
    for k, one in enumerate(runs):
        found = ended(one.process)
        if found.code == 0:
            winners.add(one.threshold)
        if k != victim and (wrong := found.wrong({0, 2})):
            outcome.findings.append(f"run {k} of {len(runs)}, T = {one.threshold}, "
                                    f"{one.ranks} ranks: {wrong}")
    if victim is None and not winners:
        outcome.findings.append(f"none of {len(runs)} runs got through")
    if winners and all(unlike(folder / "out.h5", undisturbed(threshold=one)) for one in winners):
        outcome.findings.append(f"the file is not that of any run with exit 0 (T = {winners})")
    for threshold in THRESHOLDS:
        found = attempt("--overwrite", f"case{threshold}.nml", folder=folder)
        if wrong := found.wrong({0}) or unlike(folder / "out.h5", undisturbed(threshold=threshold)):
            outcome.findings.append(f"in peace afterwards, T = {threshold}: {wrong}")
    return outcome


if __name__ == "__main__":
    sys.exit(command_line("together", attack, __doc__ or ""))

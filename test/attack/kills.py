"""Random signals to random processes of an ensemble, with other ranks at each start.

Each campaign starts an ensemble again and again; ranks, or mpirun, or all of them get signals at
random times. In the end it is run in peace: its results must be the bits of an undisturbed run.
"""

from __future__ import annotations

import random
import signal
import sys
import time
from typing import TYPE_CHECKING

from support.program import kill_all, rank_processes, send, start

from .common import Outcome, attempt, command_line, ended, unlike
from .scene import ENGINES, undisturbed, write

if TYPE_CHECKING:
    from pathlib import Path

SIGNALS = [signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGUSR1]
MOST_STARTS = 8


def has_begun(folder: Path, numbers: list[int]) -> bool:
    """Tell whether rank 0 has the output, and so MPI has started all ranks."""
    try:
        owner = (folder / "out.h5.owner").read_text(encoding="utf-8").split()
    except OSError:
        return False
    return any(str(number) in owner for number in numbers)


def disturb(folder: Path, choice: random.Random, outcome: Outcome) -> bool:
    """Start it and send signals; tell whether it was complete all the same."""
    ranks = choice.choice([0, 1, 2, 3, 4])
    victims = choice.choice(["one", "all", "mpirun", "everything"])
    process = start("case.nml", folder=folder, ranks=ranks)
    numbers = rank_processes(process, ranks) if choice.random() < 0.9 else []
    begun = True
    for _ in range(choice.choice([1, 1, 1, 2, 3])):
        what = choice.choice(SIGNALS)
        time.sleep(choice.choice([choice.uniform(0, 0.1), choice.uniform(0, 0.6)]))
        outcome.tried += 1
        begun = begun and has_begun(folder, numbers)
        if victims == "everything":
            kill_all(process)
        elif victims == "mpirun" or not numbers:
            send([process.pid], what)
        else:
            send([choice.choice(numbers)] if victims == "one" else numbers, what)
    found = ended(process)
    # Ranks that are killed while MPI starts leave mpirun, or the others, waiting for ever.
    if found.hung and (begun or not numbers):
        outcome.findings.append(f"{ranks} ranks, signals to {victims}: hung")
    # Without mpirun the exit code is the program's own.
    if ranks == 0 and victims != "everything" and found.code not in {
        0, 3, -signal.SIGKILL, 128 + signal.SIGTERM, 128 + signal.SIGINT, 128 + signal.SIGUSR1,
        # Before it has begun to listen.
        -signal.SIGTERM, -signal.SIGINT, -signal.SIGUSR1,
    }:
        outcome.findings.append(f"exit {found.code}: {found.words[-400:]}")
    return found.code == 0


def campaign(folder: Path, choice: random.Random) -> Outcome:
    """Disturb one ensemble until it is complete, or in peace at last."""
    outcome = Outcome(0)
    engine = choice.choice(["excursion", "excursion", *ENGINES])
    write(folder, engine)
    for _ in range(choice.randint(1, MOST_STARTS)):
        if disturb(folder, choice, outcome) or outcome.findings:
            break
    # Ranks that outlive their mpirun may still own the output; they end, and it is taken over.
    for _ in range(10):
        found = attempt("case.nml", folder=folder, ranks=choice.choice([0, 1, 2, 3]))
        if found.code != 2:
            break
        time.sleep(1.0)
    if wrong := found.wrong({0}):
        outcome.findings.append(f"{engine}, at last: {wrong}")
    elif wrong := unlike(folder / "out.h5", undisturbed(engine)):
        outcome.findings.append(f"{engine}: the results file {wrong}")
    left = sorted(path.name for path in folder.iterdir())
    if not outcome.findings and left != ["case.nml", "out.h5"]:
        outcome.findings.append(f"left behind: {left}")
    return outcome


if __name__ == "__main__":
    sys.exit(command_line("kills", campaign, __doc__ or ""))

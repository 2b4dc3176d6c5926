"""Random signals to random processes of an ensemble, with other ranks at each start.

Each campaign starts an ensemble again and again; ranks, or mpirun, or all of them get signals at
random times. In the end it is run in peace: its results must be the bits of an undisturbed run.
Beside half of them `--partial` writes what is finished, all the time: its files must be true.

An `mpirun` of Open MPI whose ranks are all dead may wait for itself for ever (docs/internals.md).
Such a one is ended by SIGINT as a user would end it, and is counted apart.
"""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from threading import Event, Thread
from typing import TYPE_CHECKING

from support.partial import PARTIAL, check_true
from support.program import descendants, is_program, kill_all, rank_processes, send, start

from .common import PATIENCE, Ended, Outcome, attempt, command_line, ended, unlike
from .scene import ENGINES, undisturbed, write

if TYPE_CHECKING:
    from pathlib import Path

SIGNALS = [signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGUSR1]
MOST_STARTS = 8


# Seconds without a rank after which mpirun will not end by itself.
LONELY = 10.0


def ended_by_hand(process: subprocess.Popen[str], outcome: Outcome) -> Ended:
    """Wait for the end; an mpirun that has no rank left gets SIGINT until it ends."""
    end, seen = time.monotonic() + PATIENCE, time.monotonic()
    while time.monotonic() < end:
        try:
            process.wait(0.1)
            break
        except subprocess.TimeoutExpired:
            if any(is_program(number) for number in descendants(process.pid)):
                seen = time.monotonic()
        if time.monotonic() - seen > LONELY:
            outcome.apart += 1
            # The first one asks mpirun to end, which it does not hear; the second one ends it.
            for _ in range(3):
                send([process.pid], signal.SIGINT)
                time.sleep(1.0)
            break
    return ended(process)


def disturb(folder: Path, choice: random.Random, outcome: Outcome) -> bool:
    """Start it and send signals; tell whether it was complete all the same."""
    ranks = choice.choice([0, 1, 2, 3, 4])
    victims = choice.choice(["one", "all", "mpirun", "everything"])
    process = start("case.nml", folder=folder, ranks=ranks)
    numbers = rank_processes(process, ranks) if choice.random() < 0.9 else []
    for _ in range(choice.choice([1, 1, 1, 2, 3])):
        what = choice.choice(SIGNALS)
        time.sleep(choice.choice([choice.uniform(0, 0.1), choice.uniform(0, 0.6)]))
        outcome.tried += 1
        if victims == "everything":
            kill_all(process)
        elif victims == "mpirun" or not numbers:
            send([process.pid], what)
        else:
            send([choice.choice(numbers)] if victims == "one" else numbers, what)
    found = ended_by_hand(process, outcome) if ranks else ended(process)
    if found.hung:
        outcome.findings.append(f"{ranks} ranks, signals to {victims}: hung")
    # Without mpirun the exit code is the program's own.
    if (
        ranks == 0
        and victims != "everything"
        and found.code
        not in {
            0,
            3,
            -signal.SIGKILL,
            128 + signal.SIGTERM,
            128 + signal.SIGINT,
            128 + signal.SIGUSR1,
            # Before it has begun to listen.
            -signal.SIGTERM,
            -signal.SIGINT,
            -signal.SIGUSR1,
        }
    ):
        outcome.findings.append(f"exit {found.code}: {found.words[-400:]}")
    return found.code == 0


def look_into(folder: Path, whole: Path, over: Event, outcome: Outcome) -> None:
    """Write partial files until it is over, and compare them with the whole results."""
    while not over.is_set():
        found = attempt("--partial", "case.nml", folder=folder)
        outcome.tried += 1
        if wrong := found.wrong({0, 2}):
            outcome.findings.append(f"--partial: {wrong}")
        elif found.code == 0:
            try:
                check_true(folder / PARTIAL, whole)
            except (AssertionError, OSError, RuntimeError, KeyError, ValueError) as problem:
                outcome.findings.append(f"--partial: {problem}")
        over.wait(0.1)


def campaign(folder: Path, choice: random.Random) -> Outcome:
    """Disturb one ensemble until it is complete, or in peace at last."""
    outcome, over = Outcome(0), Event()
    engine = choice.choice(["excursion", "excursion", *ENGINES])
    write(folder, engine)
    beside = Thread(target=look_into, args=(folder, undisturbed(engine), over, outcome))
    if choice.random() < 0.5:
        beside.start()
    for _ in range(choice.randint(1, MOST_STARTS)):
        if disturb(folder, choice, outcome) or outcome.findings:
            break
    over.set()
    if beside.ident:
        beside.join()
        (folder / PARTIAL).unlink(missing_ok=True)
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

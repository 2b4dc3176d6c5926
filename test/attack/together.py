"""Several runs of one output at once: the same input, or another one with `--overwrite`.

Each must end with exit 0 or 2, one at least with 0, and what is there in the end are the results
of one input, whole. Some runs have ranks that are not alike: started in another folder, where a
journal of another run is, with other words or another environment. Such a run ends with exit 2,
or with 0 where all that counts is the same, and the other folder stays as it is.
"""

from __future__ import annotations

import random
import shutil
import signal
import sys
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from support.program import Rank, listing, rank_processes, send, start

from .common import Outcome, attempt, command_line, ended, unlike
from .scene import half_way, undisturbed, write

if TYPE_CHECKING:
    import subprocess
    from pathlib import Path

THRESHOLDS = (3, 4)
# What a rank may be given besides, or in place of its words.
OTHER_WORDS = (
    ["--check"],
    ["--help"],
    ["--version"],
    ["--quiet"],
    ["--overwrit"],
    ["x.nml"],
    ["--"],
)
ENVIRONMENTS = (
    {},
    {},
    {"TMPDIR": "/nowhere"},
    {"LC_ALL": "C"},
    {"HOME": ""},
    {"TZ": "Asia/Tokyo"},
    {"OMP_NUM_THREADS": "3"},
    {"HDF5_USE_FILE_LOCKING": "FALSE"},
    {"COLUMNS": "1"},
)


@dataclass
class Run:
    """One of the runs: its input, its ranks (0: without mpirun), its process, its exit codes."""

    threshold: int
    ranks: int
    process: subprocess.Popen[str]
    allowed: set[int] = field(default_factory=lambda: {0, 2})


def unlike_ranks(folder: Path, words: list[str], choice: random.Random) -> tuple[list[Rank], bool]:
    """Draw ranks that may differ; tell whether they differ in folder or words, so are refused."""
    # The folder by another path is the same folder.
    folders = [folder, folder, folder.parent / "link", folder.parent / "other"]
    ranks = [Rank(words, choice.choice(folders), choice.choice(ENVIRONMENTS))
             for _ in range(choice.choice([2, 3]))]  # fmt: skip
    for rank in ranks:
        if choice.random() < 0.25:
            rank.arguments = choice.choice([[*words, *choice.choice(OTHER_WORDS)],
                                            choice.choice(OTHER_WORDS)])  # fmt: skip
    there = {rank.folder == folders[-1] for rank in ranks}
    return ranks, len(there) > 1 or len({tuple(rank.arguments) for rank in ranks}) > 1


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
        words.append(f"case{threshold}.nml")
        ranks = choice.choice([0, 0, 2])
        runs.append(Run(threshold, ranks, start(*words, folder=folder, ranks=ranks)))
        time.sleep(choice.choice([0.0, choice.uniform(0.0, 0.05), choice.uniform(0.0, 0.5)]))
    return runs


def launch_unlike(folder: Path, choice: random.Random) -> Run:
    """Start a run whose ranks are not all alike, beside a folder with a journal of another run."""
    (folder.parent / "link").symlink_to(folder)
    other = folder.parent / "other"
    shutil.copytree(half_way(), other)
    for path in folder.glob("*.nml"):
        shutil.copy(path, other)
    while True:
        words = [f"case{THRESHOLDS[0]}.nml"]
        ranks, refused = unlike_ranks(folder, words, choice)
        # All in the other folder, or all with other words, is another test.
        if ranks[0].folder != other and (refused or ranks[0].arguments == words):
            break
    process = start(folder=folder, ranks=ranks)
    return Run(THRESHOLDS[0], len(ranks), process, {2} if refused else {0, 2})


def attack(folder: Path, choice: random.Random) -> Outcome:
    """Start a few runs, kill one of them perhaps, and look at what is left."""
    outcome = Outcome()
    runs = launch(folder, choice)
    victim = choice.randrange(len(runs)) if choice.random() < 0.3 else None
    other = folder.parent / "other"
    runs.append(launch_unlike(folder, choice))
    before = listing(half_way())
    if victim is not None:
        send(rank_processes(runs[victim].process, runs[victim].ranks)[:1], signal.SIGKILL)
    winners = set()
    for k, one in enumerate(runs):
        found = ended(one.process)
        if found.code == 0 and one.allowed != {2}:
            winners.add(one.threshold)
        if k != victim and (wrong := found.wrong(one.allowed)):
            outcome.findings.append(
                f"run {k} of {len(runs)}, T = {one.threshold}, {one.ranks} ranks: {wrong}"
            )
    after = {name: what for name, what in listing(other).items() if not name.startswith("case")}
    if after != {name: what for name, what in before.items() if not name.startswith("case")}:
        outcome.findings.append(f"another run's folder was changed: {sorted(after)}")
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

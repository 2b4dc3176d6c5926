"""What the attacks share: seeded trials, runs that may end in any way, cases that are kept.

By hand: `cd test; ../build/venv/bin/python -m attack.NAME --seed 1 --count 100 --jobs 2`. The last
line is `N tried, M found`, with how many `mpirun` had to be ended by hand, if any. What a trial
that found something left on disk is kept in `build/attack/NAME/SEED-NUMBER`; `--only NUMBER` with
the same seed repeats that trial.
"""

from __future__ import annotations

import argparse
import random
import shutil
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from support.program import ROOT, contents, kill_all, start

if TYPE_CHECKING:
    from collections.abc import Callable

# A run that lasts longer hangs.
PATIENCE = 60.0
# Words of a program that broke, in place of one that said what is wrong.
BROKEN = (
    "Backtrace",
    "Fortran runtime error",
    "Error termination",
    "SIGSEGV",
    "SIGFPE",
    "HDF5-DIAG",
    "Program received signal",
    "Error allocating",
    "ERROR STOP",
)


@dataclass
class Outcome:
    """What came of one trial: how much was tried, what is wrong, and what is another's fault."""

    tried: int = 1
    apart: int = 0
    findings: list[str] = field(default_factory=list)


@dataclass
class Ended:
    """The end of a run."""

    code: int
    output: str
    errors: str
    hung: bool = False

    @property
    def words(self) -> str:
        """Everything that it said."""
        return self.output + self.errors

    def broken(self) -> str:
        """Tell how the run broke, if it did: hung, died of a signal, or said so."""
        if self.hung:
            return f"hung for {PATIENCE:.0f} s"
        if self.code < 0 or self.code >= 128:
            return f"died with {self.code}: {self.errors[-300:]}"
        for word in BROKEN:
            if word in self.words:
                return f"{word}: {self.words[-600:]}"
        return ""

    def wrong(self, allowed: set[int]) -> str:
        """Tell what is wrong with the end: broken, another code, or a failure without a message."""
        if self.broken():
            return self.broken()
        if self.code not in allowed:
            return f"exit {self.code}: {self.words[-600:]}"
        if self.code in (1, 2) and not self.errors.strip():
            return f"exit {self.code} without a message"
        return ""


def ended(process: subprocess.Popen[str]) -> Ended:
    """Wait for the end of a run, whatever it is; one that hangs is killed."""
    try:
        output, errors = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        kill_all(process)
        output, errors = process.communicate()
        return Ended(process.returncode, output, errors, hung=True)
    return Ended(process.returncode, output, errors)


def attempt(*arguments: str, folder: Path, ranks: int = 0) -> Ended:
    """Run to the end."""
    return ended(start(*arguments, folder=folder, ranks=ranks))


def unlike(path: Path, wanted: Path) -> str:
    """Tell how the contents of a results file differ from the wanted ones; empty: not at all."""
    try:
        found, right = contents(path), contents(wanted)
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        return f"cannot be read: {error}"
    names = [name for name in right.keys() | found.keys() if found.get(name) != right.get(name)]
    return f"differs in {sorted(names)[:8]}" if names else ""


Attack = Callable[[Path, random.Random], Outcome] if TYPE_CHECKING else object


def trial(name: str, attack: Attack, seed: int, number: int) -> Outcome:
    """Make one trial in a folder of its own, which is kept if it found anything."""
    with tempfile.TemporaryDirectory(prefix="attack-") as folder:
        place = Path(folder) / "case"
        place.mkdir()
        outcome = attack(place, random.Random(f"{name} {seed} {number}"))
        if outcome.findings:
            kept = ROOT / f"build/attack/{name}/{seed}-{number}"
            shutil.rmtree(kept, ignore_errors=True)
            kept.parent.mkdir(parents=True, exist_ok=True)
            subprocess.run(["cp", "-a", place, kept], check=False)
            (kept / "FOUND").write_text("\n".join(outcome.findings) + "\n", encoding="utf-8")
    return outcome


def trials(name: str, attack: Attack, seed: int, numbers: range, jobs: int = 1) -> Outcome:
    """Make many trials; each finding is printed with what repeats it."""
    total = Outcome(0)
    with ThreadPoolExecutor(jobs) as pool:
        outcomes = pool.map(lambda number: trial(name, attack, seed, number), numbers)
        for number, outcome in zip(numbers, outcomes, strict=True):
            total.tried += outcome.tried
            total.apart += outcome.apart
            for finding in outcome.findings:
                total.findings.append(f"--seed {seed} --only {number}: {finding}")
                print(f"{name} {total.findings[-1]}", flush=True)
    return total


def command_line(name: str, attack: Attack, about: str) -> int:
    """Do what the command line says; give 1 if anything was found."""
    parser = argparse.ArgumentParser(description=about.split("\n", 1)[0])
    parser.add_argument("--seed", type=int, default=1, help="of the random choices")
    parser.add_argument("--count", type=int, default=20, help="how many trials")
    parser.add_argument("--jobs", type=int, default=1, help="trials at a time")
    parser.add_argument("--only", type=int, help="the number of one trial, to repeat it")
    words = parser.parse_args()
    numbers = range(words.count) if words.only is None else range(words.only, words.only + 1)
    total = trials(name, attack, words.seed, numbers, words.jobs)
    apart = f", {total.apart} ended by hand" if total.apart else ""
    print(f"{total.tried} tried, {len(total.findings)} found{apart}")
    return 1 if total.findings else 0

"""Damage to the journal of an interrupted run, or to a complete results file.

After it, the same command must end with the bits of an undisturbed run, or with exit 1 or 2 and a
message; it must not say "is complete" of a file that is not what it was, nor hang, nor die.
"""

from __future__ import annotations

import os
import random
import shutil
import sys
from pathlib import Path

from .common import Outcome, attempt, command_line, unlike
from .scene import half_way, undisturbed, write

WAYS = [
    "flip",
    "flip",
    "flip",
    "cut",
    "cut",
    "zero",
    "noise",
    "longer",
    "empty",
    "gone",
    "swap",
    "copy",
    "folder",
    "link",
    "dangling",
    "loop",
    "fifo",
]

# A message may have a line for each key, and one that says what to do.
MOST_LINES = 4


def spoil_bytes(path: Path, way: str, choice: random.Random) -> str:
    """Change bytes of a file."""
    data = bytearray(path.read_bytes())
    at = choice.randrange(max(len(data), 1))
    room = choice.choice([8, 64, 512, 4096])
    if way == "flip" and data:
        bit = choice.randrange(8)
        data[at] ^= 1 << bit
        way = f"bit {bit} of byte {at} flipped"
    elif way == "cut":
        data = data[:at]
    elif way in ("zero", "noise"):
        block = bytes(room) if way == "zero" else choice.randbytes(room)
        data[at : at + room] = block[: len(data) - at]
    elif way == "longer":
        data += choice.choice([bytes(room), choice.randbytes(room), bytes(data[:room])])
    elif way == "empty":
        data = bytearray()
    path.write_bytes(data)
    return f"{way} at {at} ({room})"


def spoil_place(path: Path, other: Path, way: str) -> str:
    """Put something else where a file was."""
    aside = path.parent / "aside"
    if way == "swap":
        path.rename(aside)
        other.rename(path)
        aside.rename(other)
        return f"swapped with {other.name}"
    if way == "copy":
        data = other.read_bytes()
        path.write_bytes(data)
        return f"holds what {other.name} holds"
    path.unlink()
    if way == "folder":
        path.mkdir()
        (path / "thing").write_text("x", encoding="utf-8")
    elif way == "link":
        path.symlink_to(os.path.relpath(other, path.parent))
    elif way == "dangling":
        path.symlink_to("nowhere")
    elif way == "loop":
        path.symlink_to(path.name)
    elif way == "fifo":
        os.mkfifo(path)
    return way


def spoil(files: list[Path], choice: random.Random) -> str:
    """Damage one of the files in one way."""
    path, way = choice.choice(files), choice.choice(WAYS)
    if path.is_symlink() or not path.is_file():
        return "nothing more"
    if way in ("flip", "cut", "zero", "noise", "longer", "empty"):
        return f"{path.name}: {spoil_bytes(path, way, choice)}"
    other = choice.choice(files)
    if other == path or other.is_symlink() or not other.is_file():
        other = path.parent / "case.nml" if (path.parent / "case.nml").exists() else path
    return f"{path.name}: {spoil_place(path, other, way if other != path else 'gone')}"


def attack(folder: Path, choice: random.Random) -> Outcome:
    """Damage one folder in one way, or in a few, and run the same command."""
    outcome = Outcome()
    write(folder)
    namelist = (folder / "case.nml").read_bytes()
    whole = choice.random() < 0.4
    if whole:
        shutil.copy(undisturbed(), folder / "out.h5")
    else:
        shutil.copytree(half_way(), folder, dirs_exist_ok=True)
    files = sorted([folder / "out.h5"] if whole else (folder / "out.h5.tasks").iterdir())
    done = [spoil(files, choice) for _ in range(choice.choice([1, 1, 1, 2, 3]))]
    (folder / "case.nml").write_bytes(namelist)
    told = "; ".join(done)
    ranks = choice.choice([0, 0, 0, 2])
    found = attempt("case.nml", folder=folder, ranks=ranks)
    if (folder / "case.nml").read_bytes() != namelist:
        outcome.findings.append(f"{told}: the namelist was overwritten")
    # mpirun adds lines of its own.
    if ranks == 0 and len(found.errors.splitlines()) > MOST_LINES:
        outcome.findings.append(f"{told}: not one message: {found.errors[:1000]}")
    if wrong := found.wrong({0, 1, 2}):
        outcome.findings.append(f"{told}: {wrong}")
    elif found.code == 0:
        results = folder / "out.h5"
        if (
            "is complete" in found.output
            and whole
            and (not results.is_file() or results.read_bytes() != undisturbed().read_bytes())
        ):
            outcome.findings.append(f"{told}: 'is complete', but it is not what it was")
        elif wrong := unlike(results, undisturbed()):
            outcome.findings.append(f"{told}: exit 0, and the results file {wrong}")
    return outcome


if __name__ == "__main__":
    sys.exit(command_line("damage", attack, __doc__ or ""))

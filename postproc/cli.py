"""What every command line of the package shares: one-line errors, exit 2, places to write to."""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path
from typing import IO, TYPE_CHECKING, NoReturn

from postproc import progress

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

EXIT_BAD_INPUT = 2
COMMAND = "battery-postproc"  # all commands as one, where the package is installed


# Becomes the program that it is given, once the system knows to stop that when Python is gone.
# The process that Python starts does this, for between fork and exec nothing of Python is safe.
ENDED_WITH = """
import ctypes, os, signal, sys
parent, *command = sys.argv[1:]
prctl = getattr(ctypes.CDLL(None), "prctl", None)
if prctl is not None:
    prctl(1, int(signal.SIGUSR1), 0, 0, 0)  # PR_SET_PDEATHSIG, which exec keeps
if os.getppid() != int(parent):
    sys.exit(1)
try:
    os.execvp(command[0], command)
except OSError as problem:
    print(f"{command[0]}: {problem.strerror}", file=sys.stderr)
    sys.exit(2)
"""


class InputError(ValueError):
    """What the user gave cannot be used; the message is one line that says why."""


class Parser(argparse.ArgumentParser):
    """Argument parser that answers a bad command line with one line and exit 2."""

    def error(self, message: str) -> NoReturn:
        """Print one line, leave with exit 2."""
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: error: {message} (--help explains)\n")

    def _print_message(self, message: str, file: IO[str] | None = None) -> None:
        """Print help; where argparse passes over a full device, `run` says so."""
        (file or sys.stderr).write(message)
        (file or sys.stderr).flush()


def parser(name: str, description: str | None) -> Parser:
    """Return a parser for the command NAME, described by the module's docstring."""
    installed = Path(sys.argv[0]).name == COMMAND
    return Parser(
        prog=f"{COMMAND} {name}" if installed else f"python -m postproc.{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_output(options: argparse.ArgumentParser) -> None:
    """Add `--output DIR`, by default the folder the command is called from."""
    options.add_argument(
        "--output", metavar="DIR", type=Path, default=Path(), help="folder to write to (default: .)"
    )


def add_task(options: argparse.ArgumentParser) -> None:
    """Add a file of results, and `--point` and `--replica` that choose a task in it."""
    options.add_argument("file", metavar="FILE.h5", type=Path)
    for key, meaning in (("point", "parameter point"), ("replica", "replica")):
        told = f"{meaning}, from 1 (default: the first done)"
        options.add_argument(f"--{key}", type=integer(1), help=told)


def existing_file(path: Path) -> Path:
    """Return `path`, which must be that of a file: a pipe or a device may have no end."""
    try:
        there = path.exists()
    except OSError as problem:
        raise InputError(f"{path}: {problem.strerror}") from problem
    if not there:
        raise InputError(f"{path}: no such file")
    if path.is_dir():
        raise InputError(f"{path}: is a folder, not a file")
    if not path.is_file():
        raise InputError(f"{path}: is a pipe or a device, not a file")
    return path


def path_of(value: object, name: str) -> Path:
    """Return a path that a caller gave as the argument `name`; raise `InputError` if it is none."""
    if not isinstance(value, (str, os.PathLike)) or not str(value) or "\0" in str(value):
        raise InputError(f"{name} = {value!r}: must be a path")
    return Path(value)


def ended_with_python(command: Sequence[str | Path]) -> list[str]:
    """Return a command that ends when the thread of Python that starts it does, however it ends.

    Where the system can do that (Linux): by SIGUSR1, at which the program saves its state, and
    which launchers pass on.
    """
    words = [str(word) for word in command]
    return [sys.executable, "-I", "-S", "-c", ENDED_WITH, str(os.getpid()), *words]


def integer(low: int, high: int = 2**31 - 1) -> Callable[[str], int]:
    """Return what turns a word of the command line into an integer from `low` to `high`."""

    def read(text: str) -> int:
        value = int(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{value} must be at least {low} and at most {high}")
        return value

    read.__name__ = "int"
    return read


def number(low: float, high: float = 1e100) -> Callable[[str], float]:
    """Return what turns a word of the command line into a number from `low` to `high`."""

    def read(text: str) -> float:
        value = float(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} must be at least {low} and at most {high}")
        return value

    read.__name__ = "float"
    return read


def finite(value: object) -> object:
    """Return a value as JSON can hold it: numpy's numbers as Python's, NaN and infinity as None."""
    if isinstance(value, dict):
        return {str(key): finite(one) for key, one in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [finite(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def output_folder(path: Path) -> Path:
    """Return the folder `path`, made if it is not there yet."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError(f"cannot make folder {path}: {problem.strerror}") from problem
    return path


def run(main: Callable[[list[str] | None], int], arguments: list[str] | None = None) -> int:
    """Call `main`; turn what the user or the machine did wrong into one line and exit 2.

    That is an `InputError`, and what the system says no to: a file or folder, memory, a full
    device for what is printed.
    """
    try:
        try:
            with progress.told():
                return main(arguments)
        finally:
            sys.stdout.flush()
    except InputError as problem:
        message = str(problem)
    except OSError as problem:
        message = _said(problem)
    except MemoryError as problem:
        message = f"not enough memory: {problem}" if str(problem) else "not enough memory"
    _forget_output()
    print(f"error: {printable(' '.join(message.splitlines()))}", file=sys.stderr)
    return EXIT_BAD_INPUT


def printable(text: str) -> str:
    """Return text for a terminal: what would move its cursor, or do worse, is shown as escapes."""
    shown = (one if one.isprintable() else ascii(one)[1:-1] for one in text)
    return "".join(shown)


def _said(problem: OSError) -> str:
    """Return what the system says, and about which file."""
    reason = problem.strerror or str(problem)
    return f"{problem.filename}: {reason}" if problem.filename else reason


def _forget_output() -> None:
    """Drop what could not be printed, or Python tries again at its end, with a traceback."""
    try:
        sys.stdout.flush()
    except OSError:
        with Path(os.devnull).open("w", encoding="utf-8") as nothing:
            os.dup2(nothing.fileno(), sys.stdout.fileno())

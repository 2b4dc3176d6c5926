"""What every command line of the package shares: one-line errors, exit 2, places to write to."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

EXIT_BAD_INPUT = 2


class InputError(Exception):
    """What the user gave cannot be used; the message is one line that says why."""


class Parser(argparse.ArgumentParser):
    """Argument parser that answers a bad command line with one line and exit 2."""

    def error(self, message: str) -> NoReturn:
        """Print one line, leave with exit 2."""
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: error: {message} (--help explains)\n")


def parser(name: str, description: str | None) -> Parser:
    """Return a parser for `python -m postproc.NAME`, described by the module's docstring."""
    return Parser(
        prog=f"python -m postproc.{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_output(options: argparse.ArgumentParser) -> None:
    """Add `--output DIR`, by default the folder the command is called from."""
    options.add_argument(
        "--output", metavar="DIR", type=Path, default=Path(), help="folder to write to (default: .)"
    )


def output_folder(path: Path) -> Path:
    """Return the folder `path`, made if it is not there yet."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError(f"cannot make folder {path}: {problem.strerror}") from problem
    return path


def run(main: Callable[[Sequence[str] | None], int], arguments: Sequence[str] | None = None) -> int:
    """Call `main`; turn an `InputError` into one line on standard error and exit 2."""
    try:
        return main(arguments)
    except InputError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return EXIT_BAD_INPUT

"""Progress of slow computations, on standard error once a command has taken more than 3 s.

A slow computation is marked by `doing`, or iterates over its parts with `each`; both can be nested.
A command that `cli.run` calls has a thread that prints all current computations as one line: on a
terminal in place, every second, and removed at the end; elsewhere a line after 3, 6, 12, 24 ... s,
so that a log of hours has a dozen. Nothing is printed if a module is called from other Python code.
"""

from __future__ import annotations

import shutil
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    One = TypeVar("One")

SILENT = 3.0  # seconds before the first line
AGAIN = 1.0  # seconds from one line to the next on a terminal
ERASED = "\r\x1b[K"


@dataclass(eq=False)
class Part:
    """A current computation.

    Attributes
    ----------
    what : description of the computation.
    total : number of its parts, if known; then `what` describes one of them.
    done : number of finished parts.
    """

    what: str
    total: int | None = None
    done: int = 0

    def __str__(self) -> str:
        """Return the description with the progress."""
        return self.what if self.total is None else f"{self.what} {self.done + 1} of {self.total}"


_under_way: list[Part] = []
_writing = threading.Lock()  # held while a line is written or removed
_on_screen = threading.Event()  # whether a terminal shows one


@contextmanager
def doing(what: str, total: int | None = None) -> Iterator[Part]:
    """Report a computation until the block ends; the block may increase `done` of the part."""
    part = Part(what, total)
    _under_way.append(part)
    try:
        yield part
    finally:
        _under_way.remove(part)
        with _writing:
            if not _under_way and _on_screen.is_set():
                _on_screen.clear()
                _write(sys.stderr, ERASED)


def each(things: Sequence[One], what: str) -> Iterator[One]:
    """Yield the items and report which of how many is computed; `what` describes one."""
    with doing(what, len(things)) as part:
        for one in things:
            yield one
            part.done += 1


@contextmanager
def told() -> Iterator[None]:
    """Report current computations as long as the block lasts."""
    over = threading.Event()
    teller = threading.Thread(target=_report, args=(over, sys.stderr), daemon=True)
    teller.start()
    try:
        yield
    finally:
        over.set()
        teller.join()


def _report(over: threading.Event, stream: IO[str]) -> None:
    began, pause, terminal = time.monotonic(), SILENT, stream.isatty()
    while not over.wait(pause):
        passed = time.monotonic() - began
        pause = AGAIN if terminal else passed
        with _writing:
            line = ": ".join(map(str, list(_under_way)))
            if not line:
                continue
            line = f"{passed:.0f} s: {line}"
            if terminal:
                columns = shutil.get_terminal_size().columns - 1
                _write(stream, f"{ERASED}{line[:columns]}")
                _on_screen.set()
            else:
                _write(stream, f"{line}\n")


def _write(stream: IO[str], text: str) -> None:
    try:
        stream.write(text)
        stream.flush()
    except (OSError, ValueError):  # the output is closed
        pass

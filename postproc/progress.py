"""How far slow computations are: told to standard error once a command has taken more than 3 s.

What may take long says what it is (`doing`) or goes through its parts with `each`; both may stand
in each other. A command that `cli.run` calls has a thread beside it that tells, as one line, all
that is under way: on a terminal in place, every second, and gone when it is done; elsewhere a line
after 3, 6, 12, 24 ... s, so that a log of hours has a dozen. Nothing is told where a module is
called from other Python.
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

SILENT = 3.0  # seconds before anything is told
AGAIN = 1.0  # seconds from one line to the next on a terminal
ERASED = "\r\x1b[K"


@dataclass(eq=False)
class Part:
    """A computation that is under way.

    Attributes
    ----------
    what : it is.
    total : how many parts it has, if that is known; `what` names one of them then.
    done : how many of these are done.
    """

    what: str
    total: int | None = None
    done: int = 0

    def __str__(self) -> str:
        """Say what is under way."""
        return self.what if self.total is None else f"{self.what} {self.done + 1} of {self.total}"


_under_way: list[Part] = []
_writing = threading.Lock()  # a line, or taking it away
_on_screen = threading.Event()  # whether a terminal shows one


@contextmanager
def doing(what: str, total: int | None = None) -> Iterator[Part]:
    """Say what is computed until the block ends; `done` of what it gives may be counted up."""
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
    """Give one after the other, and say which of how many is computed; `what` names one."""
    with doing(what, len(things)) as part:
        for one in things:
            yield one
            part.done += 1


@contextmanager
def told() -> Iterator[None]:
    """Tell what is under way as long as the block lasts."""
    over = threading.Event()
    teller = threading.Thread(target=_tell, args=(over, sys.stderr), daemon=True)
    teller.start()
    try:
        yield
    finally:
        over.set()
        teller.join()


def _tell(over: threading.Event, stream: IO[str]) -> None:
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
                room = shutil.get_terminal_size().columns - 1
                _write(stream, f"{ERASED}{line[:room]}")
                _on_screen.set()
            else:
                _write(stream, f"{line}\n")


def _write(stream: IO[str], text: str) -> None:
    try:
        stream.write(text)
        stream.flush()
    except (OSError, ValueError):  # nobody listens any more
        pass

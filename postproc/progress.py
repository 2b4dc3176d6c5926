"""Progress of slow computations, on a terminal once a command has taken more than 3 s.

A slow computation is marked by `doing`, or iterates over its parts with `each`; both can be nested.
Nothing is shown where standard error is no terminal, or of what other Python code calls.
"""

from __future__ import annotations

import sys
import threading
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rich.progress import Progress

    One = TypeVar("One")

SILENT = 3.0  # seconds before anything is shown
_shown: ContextVar[Progress | None] = ContextVar("shown", default=None)  # by the current command


@contextmanager
def doing(what: str, total: int | None = None) -> Iterator[Callable[[], object]]:
    """Show a computation until the block ends; the block calls what it gets after each part."""
    progress = _shown.get()
    if progress is None:
        yield lambda: None
        return
    task = progress.add_task(what, total=total)
    try:
        yield lambda: progress.advance(task)
    finally:
        progress.remove_task(task)
        if not progress.tasks:  # or what is printed next would be erased with it
            progress.refresh()


def each(things: Sequence[One], what: str) -> Iterator[One]:
    """Yield the items and show how many are done; `what` describes one."""
    with doing(what, len(things)) as advance:
        for one in things:
            yield one
            advance()


@contextmanager
def told() -> Iterator[None]:
    """Show current computations as long as the block lasts."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console  # noqa: PLC0415 (takes a tenth of a second)
    from rich.progress import Progress  # noqa: PLC0415

    # What is printed goes where it would go without.
    progress = Progress(console=Console(stderr=True), transient=True, redirect_stdout=False,
                        redirect_stderr=False)  # fmt: skip
    start = threading.Timer(SILENT, progress.start)
    start.start()
    before = _shown.set(progress)
    try:
        yield
    finally:
        _shown.reset(before)
        start.cancel()
        start.join()
        progress.stop()

"""Calls the commands of the package as `battery-postproc NAME` does."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from postproc import cli

if TYPE_CHECKING:
    from collections.abc import Sequence


def call(name: str, arguments: Sequence[str]) -> int:
    """Run a command with these arguments; return its exit code."""
    try:
        return cli.run(importlib.import_module(f"postproc.commands.{name}").main, arguments)
    except SystemExit as stop:
        return int(stop.code or 0)

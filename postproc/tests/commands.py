"""Calls the commands of the package as `python -m postproc.NAME` does."""

from __future__ import annotations

import importlib
import importlib.util
from typing import TYPE_CHECKING

from postproc import cli

if TYPE_CHECKING:
    from collections.abc import Sequence


def call(name: str, arguments: Sequence[str]) -> int:
    """Run `postproc.NAME` with these arguments; return its exit code."""
    found = importlib.util.find_spec(f"postproc.{name}")
    inner = ".__main__" if found.submodule_search_locations else ""
    try:
        return cli.run(importlib.import_module(f"postproc.{name}{inner}").main, arguments)
    except SystemExit as stop:
        return int(stop.code or 0)

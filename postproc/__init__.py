"""Results, theory, figures, film and report of the battery program.

`Circuit` is a circuit and what the theories say of it; `run` starts a run; `open_results` gives
its results as an `xarray.Dataset` on the grid of its scan, `table` as a table. docs/python.md shows
how.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from postproc.circuits import Circuit
    from postproc.cli import InputError
    from postproc.reading.grid import open_results
    from postproc.reading.table import mean_error, table
    from postproc.running import RunError, run, write_namelist

__version__ = "0.4.0"
__all__ = [
    "Circuit", "InputError", "RunError", "__version__", "mean_error", "open_results", "run",
    "table", "write_namelist",
]  # fmt: skip

# Imported at their first use, so that commands that need no xarray start without it.
_PLACES = {
    "Circuit": "postproc.circuits",
    "InputError": "postproc.cli",
    "RunError": "postproc.running",
    "mean_error": "postproc.reading.table",
    "open_results": "postproc.reading.grid",
    "run": "postproc.running",
    "table": "postproc.reading.table",
    "write_namelist": "postproc.running",
}


def __getattr__(name: str) -> object:
    """Return a public name of the package, imported at its first use."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    """Return the public names, and not those of modules."""
    return sorted(__all__)

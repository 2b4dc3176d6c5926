"""Results, theory, figures, film and report of the battery program.

`open_results` gives a results file as an `xarray.Dataset` on the grid of its scan;
`write_namelist` and `run` start runs. docs/python.md shows how.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from postproc.reading.grid import open_results
    from postproc.running import RunError, run, write_namelist

__version__ = "0.4.0"
__all__ = ["RunError", "__version__", "open_results", "run", "write_namelist"]

# Imported at their first use, so that commands that need no xarray start without it.
_PLACES = {
    "open_results": "postproc.reading.grid",
    "RunError": "postproc.running",
    "run": "postproc.running",
    "write_namelist": "postproc.running",
}


def __getattr__(name: str) -> object:
    """Return a public name of the package, imported at its first use."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_PLACES[name]), name)

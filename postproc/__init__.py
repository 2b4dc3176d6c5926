"""Results, theory, figures, film and report of the battery program.

`Circuit` is a circuit and what the theories say of it; `run` starts a run; `open_results` gives
its results as an `xarray.Dataset` on the grid of its scan, `table` as a table; `plot` draws them.
docs/python.md shows how.
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from postproc import plot
    from postproc.advice.question import advise
    from postproc.circuits import Circuit
    from postproc.cli import InputError
    from postproc.figures.film import film
    from postproc.reading.grid import merge, open_results
    from postproc.reading.points import mean_error
    from postproc.reading.residences import residences
    from postproc.reading.table import table
    from postproc.reporting import report
    from postproc.running import RunError, plan, run, write_namelist

__version__ = "0.4.0"
# Where each public name is: imported at its first use, so that a command starts with what it needs.
_PLACES = {
    "Circuit": "postproc.circuits",
    "InputError": "postproc.cli",
    "RunError": "postproc.running",
    "advise": "postproc.advice.question",
    "film": "postproc.figures.film",
    "mean_error": "postproc.reading.points",
    "merge": "postproc.reading.grid",
    "open_results": "postproc.reading.grid",
    "plan": "postproc.running",
    "plot": "postproc.plot",
    "report": "postproc.reporting",
    "residences": "postproc.reading.residences",
    "run": "postproc.running",
    "table": "postproc.reading.table",
    "write_namelist": "postproc.running",
}
__all__ = [
    "Circuit", "InputError", "RunError", "__version__", "advise", "film", "mean_error", "merge",
    "open_results", "plan", "plot", "report", "residences", "run", "table", "write_namelist",
]  # fmt: skip
# Modules that were commands before version 0.4.0, and what they are now.
_RENAMED = {
    "currents": "plot flows", "scene": "plot scene", "figures": "plot",
    **{one: one for one in ("advise", "film", "lifetimes", "plot", "report", "table", "theory")},
}  # fmt: skip


def _answer_old_command(words: list[str]) -> None:
    """End with one line where Python was started with -m postproc.NAME, as before 0.4.0."""
    if "-m" not in words[:-1]:
        return
    name = words[words.index("-m") + 1]
    if name.startswith("postproc.") and not name.endswith("__main__"):
        new = _RENAMED.get(name.removeprefix("postproc."))
        if new is not None:
            sys.exit(f"error: python -m {name} is battery-postproc {new} since version 0.4.0")


if sys.argv[:1] == ["-m"]:
    _answer_old_command(sys.orig_argv)


def __getattr__(name: str) -> object:
    """Return a public name of the package, imported at its first use."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(_PLACES[name])
    return module if name == "plot" else getattr(module, name)


def __dir__() -> list[str]:
    """Return the public names, and not those of modules."""
    return sorted(__all__)

"""Prints a table of results, one row a point: means over replicas with errors, and theories.

The table is CSV. Columns are the parameters of the points, then each mean with its standard error,
the number of complete replicas, and the results of theories if any are named.
"""

from __future__ import annotations

import sys
from pathlib import Path

from postproc import cli
from postproc.reading.table import table
from postproc.theory.models import MODELS


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    options = cli.parser("table", __doc__)
    options.add_argument("files", metavar="FILE.h5", type=Path, nargs="+")
    options.add_argument(
        "--theory", metavar="NAME", nargs="+", action="extend", choices=tuple(MODELS), default=[],
        help=f"theories beside the runs: {', '.join(MODELS)}",
    )  # fmt: skip
    given = options.parse_args(arguments)
    table(given.files, theory=given.theory).to_csv(sys.stdout, index=False, float_format="%.8g")
    return 0

"""Makes `renewal_fit.json`: solves the renewal gate's equations on a grid and fits its share.

Solves them (`equations.py`) at pairs of threshold and load: order 2, with 8 cells to
a time l/2 everywhere, with 16 for small thresholds (the cells' error falls with their width to the
power 1.5), and orders 2 and 3 with 6 cells at a few thresholds. Both differences are small and
smooth; polynomials for them correct the grid, and one for the whole (the logit of the share less
that of the closed form for exponential times) is what `renewal.py` reads. T = 1 is known exactly.
Hours on one core; `--data` keeps the solutions. With `--entries` the checks are simulated anew;
otherwise the last simulations (4e8 entries each) are compared with again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from postproc import cli
from postproc.theory.renewal import FIT_FILE, RenewalGate
from studies.common import study
from studies.renewal_gate.fit import CHECKED, checks, fit, grid, read_solutions, simulate, solve


def main(arguments: list[str] | None = None) -> int:
    """Solve, fit, check, write."""
    options = study.parser(__file__, __doc__)
    options.add_argument(
        "--entries", type=cli.allowed(int, 1), help="simulate the checks anew, so many entries"
    )
    options.add_argument(
        "--processes", type=cli.allowed(int, 1, 4096), default=2, help="how many at a time"
    )
    options.add_argument(
        "--data", type=Path, metavar="FILE.csv", help="keep the solutions here; reuse them"
    )
    given: argparse.Namespace = options.parse_args(arguments)
    if given.data and given.data.exists():
        rows, shares = read_solutions(given.data)
    else:
        rows = grid()
        shares = solve(rows, given.processes)
        if given.data:
            table = np.column_stack([rows, shares])
            np.savetxt(given.data, table, delimiter=",", fmt="%.17g")
    written = fit(rows, shares)
    gate = RenewalGate()
    gate.__dict__["fit"] = written
    if given.entries:
        simulated = simulate(np.array(CHECKED), given.entries, given.processes, seed=1001)
    else:
        known = json.loads(FIT_FILE.read_text())["checks"]
        simulated = tuple(np.array([one[key] for one in known]) for key in ("share", "error"))
    written["checks"] = checks(gate, *simulated)
    FIT_FILE.write_text(json.dumps(written, indent=1) + "\n")
    missed = [abs(one["fit_less_share"]) for one in written["checks"]]
    print(f"fit against the solutions: at most {written['largest_misfit']:.1e}")
    print(f"against simulations: at most {max(missed):.1e}")
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

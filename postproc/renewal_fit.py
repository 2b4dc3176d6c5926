"""Makes `renewal_fit.json`: simulates the renewal gate and fits its share (some 20 minutes).

Compiles `renewal_gate.f90`, runs it at the nodes of a grid of loads and thresholds (T = 1 is known
exactly), fits the difference of the logits of the share and of the closed form for exponential
times by a Chebyshev polynomial in the coordinates of `renewal.py`, weighted by the errors of the
simulations, and checks it against other simulations, four times as long, that it has not seen.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev
from scipy import special

from postproc import cli
from postproc.renewal import (
    FIT_FILE,
    RenewalGate,
    coordinates,
    exponential_share,
    load_range,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

THRESHOLDS = (*range(1, 13), 14, 16, 18, 20, 22, 25, 28, 32, 36, 40, 48, 56, 64, 80, 100)
LOADS = 20  # a threshold
DEGREES = (10, 7)  # of the polynomial, along the load and across the thresholds
CHECKED = ((1, 1.0), (2, 2.0), (2, 5.0), (4, 3.0), (4, 12.0), (7, 5.0), (7, 12.0), (10, 10.0))
CHECKED += ((13, 17.0), (15, 12.0), (18, 12.0), (18, 20.0), (25, 24.0), (30, 40.0), (70, 75.0))


def simulate(points: Floats, entries: int, processes: int, seed: int) -> tuple[Floats, Floats]:
    """Return the share that gets through and its standard error, for rows (threshold, load)."""
    source = Path(__file__).with_name("renewal_gate.f90")
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "renewal_gate"
        subprocess.run(
            ["gfortran", "-O3", "-march=native", "-J", folder, "-o", program, source], check=True
        )
        pieces = [points[start::processes] for start in range(processes)]
        with ThreadPoolExecutor(processes) as pool:
            seeds = range(seed, seed + processes)
            results = list(
                pool.map(lambda piece, own: _run(program, piece, entries, own), pieces, seeds)
            )
    shares, errors = np.empty(len(points)), np.empty(len(points))
    for start, (share, error) in enumerate(results):
        shares[start::processes], errors[start::processes] = share, error
    return shares, errors


def _run(program: Path, points: Floats, entries: int, seed: int) -> tuple[Floats, Floats]:
    lines = "".join(f"{load!r} {int(threshold)} {entries}\n" for threshold, load in points.tolist())
    lines = f"{seed}\n{lines}"
    done = subprocess.run([program], input=lines, capture_output=True, text=True, check=True)
    _, threshold, cycles, total, squares = np.array(
        [[float(word) for word in line.split()] for line in done.stdout.splitlines()]
    ).T
    mean = total / cycles
    error = np.sqrt((squares / cycles - mean**2) / cycles)
    out = (threshold + 1.0) / mean
    return 1.0 - out, out * error / mean


def share_of_one(load: Floats) -> Floats:
    """Return the exact share for T = 1: with p the chance that nobody enters during one's stay.

    From an entry into an empty gate nu C - 1 = 1 + p (nu C - 1), so the share is p/(2 - p).
    """
    nodes, weights = np.polynomial.legendre.leggauss(200)
    angle = 0.25 * np.pi * (nodes + 1.0)
    stay = np.exp(-np.multiply.outer(load / (0.5 * np.pi), 1.0 / np.cos(angle)))
    alone = stay @ (0.25 * np.pi * weights * np.cos(angle))
    return alone / (2.0 - alone)


def grid() -> Floats:
    """Return the places of the fit, rows (threshold, load): Chebyshev nodes in log(load)."""
    nodes = np.cos(np.pi * (np.arange(LOADS) + 0.5) / LOADS)
    rows = []
    for threshold in THRESHOLDS:
        lower, upper = (np.log(limit) for limit in load_range(threshold))
        loads = np.exp(lower + 0.5 * (upper - lower) * (1.0 + nodes))
        rows += [(threshold, load) for load in loads]
    return np.array(rows)


def fit(points: Floats, shares: Floats, errors: Floats) -> Floats:
    """Return the coefficients, shape (DEGREES[0] + 1, DEGREES[1] + 1)."""
    good = (shares > 5.0 * errors) & (shares < 1.0)
    threshold, load = points[good].T
    share, error = shares[good], errors[good]
    through, out = exponential_share(threshold, load)
    difference = special.logit(share) - (np.log(through) - np.log(out))
    scatter = error / (share * (1.0 - share))
    matrix = chebyshev.chebvander2d(*coordinates(threshold, load), DEGREES)
    weight = 1.0 / np.hypot(scatter, 1e-4)
    solution, *_ = np.linalg.lstsq(matrix * weight[:, None], difference * weight, rcond=None)
    return solution.reshape(np.array(DEGREES) + 1)


def main(arguments: Sequence[str] | None = None) -> int:
    """Simulate, fit, check, write."""
    options = cli.parser("renewal_fit", __doc__)
    options.add_argument("--entries", type=int, default=100_000_000, help="entries a place")
    options.add_argument("--processes", type=int, default=2, help="simulations at a time")
    options.add_argument(
        "--data", type=Path, metavar="FILE.csv", help="keep the simulations here; reuse them"
    )
    given: argparse.Namespace = options.parse_args(arguments)
    points = grid()
    if given.data and given.data.exists():
        points, shares, errors = np.split(np.loadtxt(given.data, delimiter=","), [2, 3], axis=1)
        shares, errors = shares[:, 0], errors[:, 0]
    else:
        shares, errors = simulate(points, given.entries, given.processes, seed=1)
        if given.data:
            table = np.column_stack([points, shares, errors])
            np.savetxt(given.data, table, delimiter=",", fmt="%.12g")
    single = points[:, 0] == 1
    shares[single] = share_of_one(points[single, 1])
    errors[single] = np.minimum(1e-5, 1e-2 * shares[single])
    coefficients = fit(points, shares, errors)
    gate = RenewalGate()
    gate.__dict__["fit"] = {"coefficients": coefficients.tolist()}
    apart = gate.share(*points.T) - shares
    checks = np.array(CHECKED)
    checked, checked_errors = simulate(checks, 4 * given.entries, given.processes, seed=1001)
    missed = gate.share(*checks.T) - checked
    written = {
        "entries_per_place": given.entries,
        "places": len(points),
        "largest_difference": float(np.abs(apart).max()),
        "mean_square_difference_in_errors": float(np.mean((apart / np.maximum(errors, 1e-6)) ** 2)),
        "checks": [
            dict(zip(("threshold", "load", "share", "error", "fit_less_share"), row, strict=True))
            for row in np.column_stack([checks, checked, checked_errors, missed]).tolist()
        ],
        "coefficients": coefficients.tolist(),
    }
    FIT_FILE.write_text(json.dumps(written, indent=1) + "\n")
    print(f"fit against the simulations: at most {np.abs(apart).max():.1e}")
    print(f"against runs it has not seen: at most {np.abs(missed).max():.1e}")
    return 0


if __name__ == "__main__":
    sys.exit(cli.run(main))

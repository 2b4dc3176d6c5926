"""The fit of the renewal gate's share: solutions on a grid, polynomials, checks."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev
from scipy import special

from postproc.cli import InputError, existing_file
from postproc.theory.renewal import (
    RenewalGate,
    coordinates,
    exponential_logit,
    load_range,
)
from studies.renewal_gate.equations import share, share_of_one, simulated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

THRESHOLDS = (*range(2, 13), 14, 16, 18, 20, 22, 25, 30, 36, 45, 60, 80, 100)
LOADS = 16  # for each threshold
FINE = (*range(2, 13), 60)  # thresholds at which cells of half the width are used as well
THIRD = (3, 4, 6, 8, 12, 18, 25)  # thresholds at which the third order is solved as well
THIRD_LOADS = 8
POWER = 1.5  # of the width of the cells, in their error
DEGREES = (13, 10)  # of the polynomial, along the load and across the thresholds
CELL_DEGREES, THIRD_DEGREES = (10, 4), (7, 3)
CHECKED = ((1, 1.0), (2, 2.0), (2, 5.0), (4, 3.0), (4, 12.0), (7, 5.0), (7, 12.0), (10, 10.0))
CHECKED += ((13, 17.0), (15, 12.0), (18, 12.0), (18, 20.0), (25, 24.0), (30, 40.0), (70, 75.0))


def solve(rows: Floats, processes: int = 1) -> Floats:
    """Return the shares for rows (threshold, load, order, cells) by the equations."""
    with ProcessPoolExecutor(processes) as pool:
        found = [pool.submit(share, int(threshold), load, int(order), int(cells))
                 for threshold, load, order, cells in rows.tolist()]  # fmt: skip
        return np.array([one.result() for one in found])


def simulate(
    points: Floats, entries: int, processes: int = 1, seed: int = 1
) -> tuple[Floats, Floats]:
    """Return the share that gets through and its standard error, for rows (threshold, load)."""
    with ProcessPoolExecutor(processes) as pool:
        found = [pool.submit(simulated, int(threshold), load, entries, seed + at)
                 for at, (threshold, load) in enumerate(points.tolist())]  # fmt: skip
        shares, errors = np.transpose([one.result() for one in found])
    return shares, errors


def loads(threshold: int, count: int) -> Floats:
    """Return the loads of the grid at a threshold: Chebyshev nodes in log(load)."""
    nodes = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    lower, upper = (np.log(limit) for limit in load_range(threshold))
    return np.exp(lower + 0.5 * (upper - lower) * (1.0 + nodes))


def grid() -> Floats:
    """Return the cases to solve, rows (threshold, load, order, cells)."""
    rows = [(t, x, 2, 8) for t in THRESHOLDS for x in loads(t, LOADS)]
    rows += [(t, x, 2, 16) for t in FINE for x in loads(t, LOADS)]
    rows += [(t, x, order, 6) for t in THIRD for x in loads(t, THIRD_LOADS) for order in (2, 3)]
    return np.array(rows)


def _weights(share: Floats) -> Floats:
    return 1.0 / np.hypot(1e-5 / (share * (1.0 - share)), 1e-4)


def _polynomial(points: Floats, values: Floats, share: Floats, degrees: tuple[int, int]) -> Floats:
    matrix = chebyshev.chebvander2d(*coordinates(*points), degrees)
    weight = _weights(share)
    solution, *_ = np.linalg.lstsq(matrix * weight[:, None], values * weight, rcond=None)
    return solution.reshape(np.array(degrees) + 1)


def _difference(
    rows: Floats, shares: Floats, one: tuple[int, int], other: tuple[int, int]
) -> tuple[Floats, Floats, Floats]:
    """Return points (threshold, load), logit difference of two (order, cells), and the share."""
    table = {(*row[:2].round(6), *row[2:]): s for row, s in zip(rows, shares, strict=True)}
    places = [key[:2] for key in table if key[2:] == one and (*key[:2], *other) in table]
    first = np.array([table[(*place, *one)] for place in places])
    second = np.array([table[(*place, *other)] for place in places])
    return np.array(places).T, (first - second) / (second * (1.0 - second)), second


def fit(rows: Floats, shares: Floats) -> dict[str, object]:
    """Return coefficients, shape DEGREES + 1, and measures of their accuracy."""
    cell_places, cell_step, cell_share = _difference(rows, shares, (2, 16), (2, 8))
    cell_step *= 1.0 + 1.0 / (2.0**POWER - 1.0)
    third_places, third_step, third_share = _difference(rows, shares, (3, 6), (2, 6))
    by_cells = _polynomial(cell_places, cell_step, cell_share, CELL_DEGREES)
    by_third = _polynomial(third_places, third_step, third_share, THIRD_DEGREES)
    chosen = (rows[:, 2] == 2) & (rows[:, 3] == 8)
    points, share = rows[chosen, :2].T, shares[chosen]
    along, across = coordinates(*points)
    logit = special.logit(share) + chebyshev.chebval2d(along, across, by_cells)
    third = chebyshev.chebval2d(along, across, by_third)
    logit += np.where(points[0] > 2, third, 0.0)  # the second order is exact up to T = 2
    exact = loads(1, LOADS)
    points = np.hstack([points, [np.ones(LOADS), exact]])
    logit = np.concatenate([logit, special.logit(share_of_one(exact))])
    share = special.expit(logit)
    coefficients = _polynomial(points, logit - exponential_logit(*points), share, DEGREES)
    fitted = exponential_logit(*points) + chebyshev.chebval2d(*coordinates(*points), coefficients)
    return {
        "places": len(share),
        "largest_misfit": float(np.abs(special.expit(fitted) - share).max()),
        "largest_step_by_cells": _largest(cell_step, cell_share),
        "largest_step_by_third_order": _largest(third_step, third_share),
        "coefficients": coefficients.tolist(),
    }


def _largest(step: Floats, share: Floats) -> float:
    return float(np.abs(step * share * (1.0 - share)).max())


def checks(gate: RenewalGate, shares: Floats, errors: Floats) -> list[dict[str, float]]:
    """Return for each of `CHECKED` the simulated share, its error and the difference of the fit."""
    points = np.array(CHECKED)
    missed = gate.share(*points.T) - shares
    names = ("threshold", "load", "share", "error", "fit_less_share")
    rows = np.column_stack([points, shares, errors, missed]).tolist()
    return [dict(zip(names, row, strict=True)) for row in rows]


def read_solutions(path: Path) -> tuple[Floats, Floats]:
    """Read a file of `--data`: the rows of the grid, and the share of each."""
    table, rows = np.loadtxt(existing_file(path), delimiter=",", ndmin=2), len(grid())
    if table.shape != (rows, 5) or not np.isfinite(table).all():
        raise InputError(f"{path}: not the {rows} rows of 5 numbers of a fit")
    return table[:, :-1], table[:, -1]

"""Means and transitions of replicas with their errors, tables of numbers, error bars and bounds."""

from __future__ import annotations

import csv
import math
from typing import TYPE_CHECKING

import numpy as np

from postproc.advice.advice import transition_between

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Row = dict[str, object]


def mean_of(values: ArrayLike) -> tuple[Floats, Floats]:
    """Return mean and standard error over the first axis: of independent groups, runs or draws."""
    known = np.asarray(values, float)
    return known.mean(axis=0), known.std(axis=0, ddof=1) / math.sqrt(len(known))


def with_errors(**values: ArrayLike) -> dict[str, float]:
    """Return for each name its mean, and as NAME_error its standard error."""
    found = {}
    for name, one in values.items():
        found[name], found[f"{name}_error"] = map(float, mean_of(one))
    return found


def said(row: Row, name: str, digits: int) -> str:
    """Return a number of a row with its error."""
    return f"{row[name]:.{digits}f} ± {row[f'{name}_error']:.{digits}f}"


def transition_of(thresholds: Floats, chi: Floats) -> tuple[float, float]:
    """Return the T at which chi, shape (threshold, replica), falls through 0.3, and its error.

    The error is that of replicas: one is left out at a time (jackknife).
    """
    count = chi.shape[1]
    without = np.array(
        [transition_between(thresholds, np.delete(chi, k, axis=1).mean(axis=1))
         for k in range(count)]
    )  # fmt: skip
    error = math.sqrt((count - 1) / count * np.sum((without - without.mean()) ** 2))
    return transition_between(thresholds, chi.mean(axis=1)), error


def read_table(path: Path) -> list[Row]:
    """Return the rows of a table, numbers as numbers."""
    with path.open(encoding="utf-8") as file:
        return [{key: _value(text) for key, text in row.items()} for row in csv.DictReader(file)]


def _value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def bars(
    axes: Axes, rows: Sequence[Row], across: str | ArrayLike, up: str, error: str = "",
    **look: object,
) -> None:  # fmt: skip
    """Draw a column of rows with its errors, of the column `error` or UP_error.

    `across` is another column, or a place for each row.
    """
    x = [row[across] for row in rows] if isinstance(across, str) else across
    y, off = (np.array([row[name] for row in rows], float) for name in (up, error or f"{up}_error"))
    axes.errorbar(x, y, off, **({"ms": 3.5} | look))


def bound(axes: Axes, x: float, y: float, mark: str, colour: str, size: float = 5.0) -> None:
    """Draw an upper bound: an open mark with an arrow downwards."""
    axes.plot([x], [y], mark, color=colour, mfc="none", ms=size)
    axes.annotate("", (x, y), (0, -15), textcoords="offset points",
                  arrowprops={"arrowstyle": "<-", "color": colour})  # fmt: skip

"""Whether the errors of single runs are right: python -m postproc.accuracy.own_errors [PICTURE].

Many runs of the same circuit and length, each with its own standard error, against their scatter.
Printed for each circuit, quantity and length: in how many runs the error is told, the root mean
square of the told ones over the true one, and how often the mean over all runs is within one and
two of them. The picture shows the ratio against the length. Takes a quarter of an hour of a core.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np

import postproc

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

REPLICAS = 200
TRANSIENT = 2800.0  # three relaxation times of directions, 25 r^4/w^3
CORNERS = [-1.0, -0.4, 0.2, -1.15, 1.0, -0.55, 1.0, 0.45, -0.15, 1.05, -1.0, 0.5]  # crooked
# What is asked of each circuit besides w = 0.3, w' = 0.01, N = 1000, and the lengths of its runs.
LENGTHS = (5600.0, 18_500.0, 37_000.0, 75_000.0)
CIRCUITS: dict[str, tuple[int, dict[str, object], tuple[float, ...]]] = {
    "T = 7": (7, {}, (*LENGTHS, 150_000.0, 400_000.0)),
    "beside a transition, T = 16": (16, {}, (*LENGTHS, 150_000.0)),
    "free, T = 1000": (1000, {}, LENGTHS),
    "crooked hexagons, T = 7": (
        7, {"urn_shape": "polygon", "urn_vertices": CORNERS}, LENGTHS,
    ),
    "regular hexagons, T = 7": (7, {"urn_shape": "polygon", "urn_sides": 6}, LENGTHS[1:2]),
}  # fmt: skip
QUANTITIES = ("chi", "polarised_current", "current1")


def held(values: Floats, errors: Floats) -> dict[str, float]:
    """Return how the errors of runs compare with the scatter of their averages.

    Parameters
    ----------
    values, errors : average and its own standard error of each run; NaN errors are not told.

    Returns
    -------
    dict
        `told`: share of the runs that have an error; `true`: standard deviation of all averages;
        `ratio`: root mean square of the told errors over that; `one`, `two`: share of the told ones
        that are not farther from the mean of all than one and two errors. NaN where none is told.
    """
    known = np.isfinite(errors)
    off = np.abs(values - values.mean())[known] / errors[known]
    true = values.std(ddof=1)
    found = {"told": known.mean(), "true": true, "ratio": np.nan, "one": np.nan, "two": np.nan}
    if known.any():
        root = np.sqrt(np.mean(errors[known] ** 2))
        found |= {"ratio": root / true, "one": np.mean(off < 1.0), "two": np.mean(off < 2.0)}
    return {name: float(value) for name, value in found.items()}


def measure(threshold: int, table: dict[str, object], length: float) -> dict[str, dict[str, float]]:
    """Return `held` of each quantity, of runs of a length after the transient."""
    groups = {
        "table": {"channel1_width": 0.3, "channel2_width": 0.01, **table},
        "particles": {"number": 1000},
        "gate": {"threshold": threshold},
        "run": {"duration": TRANSIENT + length, "transient_duration": TRANSIENT},
        "scan": {"replicas": REPLICAS},
        "output": {"file": "runs.h5"},
    }
    with tempfile.TemporaryDirectory() as folder:
        data = postproc.open_results(postproc.run(groups, folder=folder, quiet=True))
    return {
        name: held(data[name].values.ravel(), data[f"{name}_error"].values.ravel())
        for name in QUANTITIES
    }


def draw(found: dict[str, dict[float, dict[str, dict[str, float]]]], path: Path) -> None:
    """Draw the told error over the true one against the length of a run."""
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.6), sharey=True, layout="constrained")
    for panel, name in zip(axes, QUANTITIES[:2], strict=True):
        for label, rows in found.items():
            lengths = list(rows)
            ratio = [rows[length][name]["ratio"] for length in lengths]
            panel.plot(lengths, ratio, "o-", label=label)
        panel.axhline(1.0, color="0.6", lw=0.8)
        panel.set(xscale="log", xlabel="length of a run", title=name.replace("_", " "))
    axes[0].set(ylabel="told error over true error", ylim=(0.0, 2.0))
    axes[0].legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=130)


def main() -> None:
    """Run all circuits at all lengths, print a line each, and draw the picture if asked for."""
    found: dict[str, dict[float, dict[str, dict[str, float]]]] = {}
    print("| circuit | length | quantity | told | told/true | within 1 | within 2 |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for label, (threshold, table, lengths) in CIRCUITS.items():
        found[label] = {length: measure(threshold, table, length) for length in lengths}
        for length, row in found[label].items():
            for name, one in row.items():
                print(f"| {label} | {length:.0f} | {name} | {one['told']:.0%} | {one['ratio']:.2f} "
                      f"| {one['one']:.0%} | {one['two']:.0%} |", flush=True)  # fmt: skip
    if len(sys.argv) > 1:
        draw(found, Path(sys.argv[1]))


if __name__ == "__main__":
    main()

"""Whether the errors of single runs are right: python -m postproc.accuracy.own_errors [PICTURE].

Many runs of the same circuit and length, each with its own standard error, against their scatter.
Printed for each circuit, quantity and length: in how many runs the error is told, the root mean
square of the told ones over the true one, and how often the mean over all runs is within one and
two of them. The picture shows the ratio against the length. Takes a quarter of an hour of a core.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc import cli
from postproc.figures import style

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

REPLICAS = 200
ENOUGH = 0.5  # share of runs that tell an error, from which on these are compared
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
    """Draw the told error over the true one against the length of a run.

    Only where half of the runs tell one, since fewer are a selection; error bars are the chance
    that the true one is known with, from the scatter of so many runs.
    """
    made = style.figure(style.PAGE, 3.2)
    panels = made.subplots(1, len(QUANTITIES), sharex=True, sharey=True)
    for axes, name in zip(panels, QUANTITIES, strict=True):
        for (circuit, rows), colour, mark in zip(found.items(), style.CYCLE, "osD^v", strict=False):
            lengths = sorted(rows)
            seen = any(one["told"] >= ENOUGH for row in rows.values() for one in row.values())
            label = circuit if seen else f"{circuit}: none told"
            told = [rows[length][name] for length in lengths]
            ratio = np.array([one["ratio"] if one["told"] >= ENOUGH else np.nan for one in told])
            axes.errorbar(lengths, ratio, ratio / np.sqrt(2.0 * (REPLICAS - 1)), fmt=f"{mark}-",
                          color=colour, mfc="none", lw=0.8, label=label)  # fmt: skip
        axes.axhline(1.0, color=style.GREY, lw=0.8)
        axes.set(xscale="log", xlabel="length of a run", title=name.replace("_", " "))
    panels[0].set(ylabel="told error over true error", ylim=(0.0, 1.6), xlim=(4e3, 6e5))
    made.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    style.save(made, path.parent, path.stem)


def main(arguments: list[str] | None = None) -> int:
    """Run all circuits at all lengths, print a line each, and draw the picture if asked for."""
    options = cli.parser("accuracy.own_errors", __doc__)
    options.add_argument("picture", metavar="PICTURE", type=Path, nargs="?")
    picture = options.parse_args(arguments).picture
    found: dict[str, dict[float, dict[str, dict[str, float]]]] = {}
    print("| circuit | length | quantity | told | told/true | within 1 | within 2 |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for label, (threshold, table, lengths) in CIRCUITS.items():
        found[label] = {length: measure(threshold, table, length) for length in lengths}
        for length, row in found[label].items():
            for name, one in row.items():
                print(f"| {label} | {length:.0f} | {name} | {one['told']:.0%} | {one['ratio']:.2f} "
                      f"| {one['one']:.0%} | {one['two']:.0%} |", flush=True)  # fmt: skip
    if picture:
        draw(found, picture)
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

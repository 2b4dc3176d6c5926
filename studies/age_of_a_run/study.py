"""Current and chi against the age of a run: python studies/age_of_a_run/study.py [--full].

Runs the namelists beside it (or takes their results where they are in the folder) and writes
results.csv and age_of_a_run.png: means in logarithmic bins of age with errors over replicas, and
the current of the theory two_port at those ages. Quick: 40 replicas to an age of 1e4, half a
minute. --full: as the namelists say, about ten minutes of a core and 0.3 GB.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import math
import subprocess
import sys
from pathlib import Path

import f90nml
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

PLACE = Path(__file__).resolve().parent
sys.path.insert(0, str(PLACE.parents[1]))

import postproc  # noqa: E402 (of the checkout, whose folder is known only now)

POINTS = ("reference", "inside", "near_transition")
QUICK = {"replicas": 40, "duration": 1e4}
BINS = 4  # a decade of age
FIELDS = ("point", "T", "w2", "from", "to", "current", "current_error", "theory", "chi",
          "chi_error", "replicas")  # fmt: skip


def results_of(name: str, folder: Path, *, full: bool) -> Path:
    """Run a namelist, or a quick one like it; return its results file."""
    groups = f90nml.read(PLACE / f"{name}.nml").todict()
    if not full:
        groups["scan"]["replicas"] = QUICK["replicas"]
        groups["run"]["duration"] = QUICK["duration"]
        groups["output"]["file"] = f"{name}_quick.h5"
    return postproc.run(groups, folder=folder)


def theory(groups: dict, ages: list[float]) -> list[float]:
    """Return the current that the theory two_port has at each age."""
    words = ["--number", groups["particles"]["number"], "--threshold", groups["gate"]["threshold"]]
    for key in ("channel1_width", "channel2_width"):
        words += [f"--{key.replace('_', '-')}", groups["table"][key]]
    words += ["--model", "two_port", "--age", *ages]
    command = [sys.executable, "-m", "postproc.theory", *map(str, words)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=PLACE.parents[1])
    return [one["net_current"] for one in json.loads(done.stdout)["by_age"]]


def bins_of(longest: float, interval: float) -> np.ndarray:
    """Return the edges of bins of age, whole intervals, the first 0."""
    count = round(BINS * math.log10(longest / interval)) + 1
    edges = np.geomspace(interval, longest, count)
    return np.unique(np.concatenate([[0.0], np.round(edges / interval) * interval]))


def middle(low: float, high: float) -> float:
    """Return the age at which a bin is drawn."""
    return math.sqrt(max(low, 0.1 * high) * high)


def rows_of(name: str, file: Path) -> list[dict[str, object]]:
    """Return a row for each bin of age."""
    groups = f90nml.read(PLACE / f"{name}.nml").todict()
    data = postproc.open_results(file, group="series").squeeze()
    time = data.time.to_numpy()
    number, first = float(groups["particles"]["number"]), data.urn1_number.to_numpy()
    # of the urn that is the fuller one at the end of each interval
    current = (data.flow2_21 - data.flow2_12).to_numpy() * np.sign(0.5 * number - first)
    spread = np.abs(1.0 - 2.0 * first / number)
    edges = bins_of(time[-1], time[1] - time[0])
    bins = list(itertools.pairwise(edges.tolist()))
    found = []
    for (low, high), said in zip(bins, theory(groups, [middle(*one) for one in bins]), strict=True):
        here = (time > low) & (time <= high)
        row = {"point": name, "T": groups["gate"]["threshold"],
               "w2": groups["table"]["channel2_width"], "from": low, "to": high, "theory": said,
               "replicas": first.shape[0]}  # fmt: skip
        for quantity, values in (("current", current), ("chi", spread)):
            own = np.nanmean(values[:, here], axis=1)  # a run may end just before its last entry
            row[quantity] = own.mean()
            row[f"{quantity}_error"] = own.std(ddof=1) / math.sqrt(own.size)
        found.append(row)
    return found


def draw(rows: list[dict[str, object]], path: Path) -> None:
    """Draw current and chi against age, over what they are at the end."""
    made, panels = plt.subplots(1, 2, figsize=(7.5, 3.2), layout="constrained")
    for at, name in enumerate(POINTS):
        own = [row for row in rows if row["point"] == name]
        ages = [middle(row["from"], row["to"]) for row in own]
        label = f"T = {own[0]['T']}, w' = {own[0]['w2']:g}"
        for axes, quantity in zip(panels, ("current", "chi"), strict=True):
            last = own[-1][quantity]
            axes.errorbar(
                ages, [100.0 * (row[quantity] / last - 1.0) for row in own],
                [100.0 * row[f"{quantity}_error"] / last for row in own],
                fmt="osD"[at], ms=3.5, lw=1.0, color=f"C{at}", label=label,
            )  # fmt: skip
        end = own[-1]["theory"]
        shown = [100.0 * (row["theory"] / end - 1.0) for row in own]
        panels[0].plot(ages, shown, "-", color=f"C{at}", lw=1.0)
    for axes, title in zip(panels, ("net current of channel 2", "chi"), strict=True):
        axes.set_xscale("log")
        axes.set_xlabel("age of the run")
        axes.set_title(title, fontsize=10)
        axes.axhline(0.0, color="0.7", lw=0.7, zorder=0)
    panels[0].set_ylabel("off from its value at the end (%)")
    panels[0].set_ylim(-8.0, 2.0)
    panels[1].legend(fontsize=8)
    made.savefig(path, dpi=150)


def main() -> None:
    """Run, write the table and the picture."""
    options = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    options.add_argument("--full", action="store_true", help="as the namelists say")
    options.add_argument("--runs", type=Path, default=Path("age_runs"), help="folder of results")
    options.add_argument("--output", type=Path, help="of table and picture (default: --runs)")
    given = options.parse_args()
    rows = []
    for name in POINTS:
        rows += rows_of(name, results_of(name, given.runs, full=given.full))
    place = given.output or given.runs
    place.mkdir(parents=True, exist_ok=True)
    with (place / "results.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, FIELDS, lineterminator="\n")
        table.writeheader()
        table.writerows(
            {key: f"{value:.6g}" if isinstance(value, float) else value
             for key, value in row.items()} for row in rows
        )  # fmt: skip
    draw(rows, place / "age_of_a_run.png")


if __name__ == "__main__":
    main()

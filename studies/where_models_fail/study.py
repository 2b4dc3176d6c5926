"""Where each model fails on the map of T and w': python studies/where_models_fail/study.py.

Runs map.nml beside it (or takes its results where they are in the folder), asks four theories at
each point, and writes results.csv and where_models_fail.png. Two minutes of a core or so.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

PLACE = Path(__file__).resolve().parent
ROOT = PLACE.parents[1]
sys.path.insert(0, str(ROOT))

import postproc  # noqa: E402 (of the checkout, whose folder is known only now)

MODELS = ("window", "renewal", "two_port", "direction")
POLARISED = 0.3  # chi from which on a state is called so
BOUNDS = (0.01, 0.03, 0.1)
COLOURS = ("tab:green", "gold", "tab:orange", "tab:red")


def rows_of(file: Path) -> list[dict[str, float | str]]:
    """Return a row for each point and model."""
    data, found = postproc.open_results(file, theory=list(MODELS)), []
    for threshold in data.threshold.to_numpy():
        for width in data.channel2_width.to_numpy():
            here = data.sel(threshold=threshold, channel2_width=width)
            chi, current = here.chi.to_numpy(), here.polarised_current.to_numpy()
            spread, share = float(chi.mean()), float(current.mean() / chi.mean())
            for model in MODELS:
                said = here.sel(theory=model)
                theirs, net = float(said.theory_chi), abs(float(said.theory_polarised_current))
                both = spread > POLARISED and theirs > 0.0
                found.append({
                    "T": int(threshold), "w2": float(width), "model": model, "chi": spread,
                    "chi_error": chi.std(ddof=1) / math.sqrt(chi.size), "current_over_chi": share,
                    "model_chi": theirs,
                    "off_chi": theirs / spread - 1.0 if both else math.nan,
                    "off_share": net / theirs / share - 1.0 if both else math.nan,
                    "other_state": int((theirs > POLARISED) != (spread > POLARISED)),
                })  # fmt: skip
    return found


def draw(rows: list[dict[str, float | str]], path: Path) -> None:
    """Draw a panel for each model and quantity; a cross is where model and runs differ in state."""
    made, panels = plt.subplots(2, len(MODELS), figsize=(10.0, 5.0), layout="constrained",
                                sharex=True, sharey=True)  # fmt: skip
    widths = sorted({row["w2"] for row in rows})
    for column, model in enumerate(MODELS):
        own = [row for row in rows if row["model"] == model]
        for axes, quantity in zip(panels[:, column], ("off_chi", "off_share"), strict=True):
            for row in own:
                at, off = (widths.index(row["w2"]), row["T"]), row[quantity]
                if row["other_state"]:
                    axes.plot(*at, "x", color="black", ms=7)
                elif math.isnan(off):
                    axes.plot(*at, ".", color="0.75", ms=4)
                else:
                    colour = COLOURS[int(np.searchsorted(BOUNDS, abs(off)))]
                    axes.plot(*at, "s", color=colour, ms=9)
        panels[0, column].set_title(f"{model}: chi", fontsize=9)
        panels[1, column].set_title(f"{model}: current over chi", fontsize=9)
        panels[1, column].set_xticks(range(len(widths)), [f"{one:g}" for one in widths], fontsize=7)
        panels[1, column].set_xlabel("w'")
    for axes in panels[:, 0]:
        axes.set_ylabel("T")
    words = ("below 1 %", "1 to 3 %", "3 to 10 %", "above 10 %")
    for colour, word in zip(COLOURS, words, strict=True):
        panels[0, 0].plot([], [], "s", color=colour, label=word)
    panels[0, 0].plot([], [], "x", color="black", label="polarised in one of both only")
    panels[0, 0].plot([], [], ".", color="0.75", label="not polarised in either")
    made.legend(loc="outside upper center", ncols=6, fontsize=8)
    made.savefig(path, dpi=130)


def main() -> None:
    """Run, ask, write the table and the picture."""
    options = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    options.add_argument("--runs", type=Path, default=Path("map_runs"), help="folder of results")
    options.add_argument("--output", type=Path, help="of table and picture (default: --runs)")
    given = options.parse_args()
    rows = rows_of(postproc.run(PLACE / "map.nml", folder=given.runs))
    place = given.output or given.runs
    with (place / "results.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(
            {key: f"{value:.6g}" if isinstance(value, float) else value
             for key, value in row.items()} for row in rows
        )  # fmt: skip
    draw(rows, place / "where_models_fail.png")


if __name__ == "__main__":
    main()

"""Current and chi against the age of a run.

Runs the namelists of this folder, into build/age_of_a_run/quick, or full, and writes results.csv
and age_of_a_run.png: means in logarithmic bins of age with errors over replicas, and the current of
the theory two_port at those ages. Quick: 40 replicas to an age of 1e4, half a minute. --full: the
namelists unchanged, about ten minutes of a core and 0.3 GB.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import f90nml
import numpy as np

import postproc
from postproc.figures import style
from studies.common import study
from studies.common.numbers import bars, with_errors
from studies.common.theories import told

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POINTS = ("reference", "inside", "near_transition")
QUICK = {"scan": {"replicas": 40}, "run": {"duration": 1e4}}
BINS = 4  # per decade of age
FIELDS = ("point", "T", "w2", "from", "to", "current", "current_error", "theory", "chi",
          "chi_error", "replicas")  # fmt: skip


def bins_of(longest: float, interval: float) -> np.ndarray:
    """Return the edges of bins of age, multiples of the interval, from 0."""
    count = round(BINS * math.log10(longest / interval)) + 1
    edges = np.geomspace(interval, longest, count)
    return np.unique(np.concatenate([[0.0], np.round(edges / interval) * interval]))


def middle(low: float, high: float) -> float:
    """Return the age at which a bin is drawn."""
    return math.sqrt(max(low, 0.1 * high) * high)


def rows_of(work: study.Study, name: str) -> list[dict[str, object]]:
    """Run a namelist, or a quick one like it; return a row for each bin of age."""
    groups = f90nml.read(work.place / f"{name}.nml")
    file = work.run(name, name, {} if work.full else QUICK)
    data = postproc.open_results(file, group="series").squeeze()
    time = data.time.to_numpy()
    number, first = float(groups["particles"]["number"]), data.urn1_number.to_numpy()
    # polarised current: of the urn that is the fuller one at the end of each interval
    current = (data.flow2_21 - data.flow2_12).to_numpy() * np.sign(0.5 * number - first)
    spread = np.abs(1.0 - 2.0 * first / number)
    edges = bins_of(time[-1], time[1] - time[0])
    bins = list(itertools.pairwise(edges.tolist()))
    keys = {"threshold": groups["gate"]["threshold"], "number": groups["particles"]["number"]}
    keys |= {key: groups["table"][key] for key in ("channel1_width", "channel2_width")}
    theory = [told("two_port", middle(*one), **keys)["roots"][-1] for one in bins]
    found = []
    for (low, high), predicted in zip(bins, theory, strict=True):
        here = (time > low) & (time <= high)
        row = {"point": name, "T": groups["gate"]["threshold"],
               "w2": groups["table"]["channel2_width"], "from": low, "to": high,
               "theory": predicted["net_current"], "replicas": first.shape[0]}  # fmt: skip
        for quantity, values in (("current", current), ("chi", spread)):
            # a run may end just before its last entry
            row |= with_errors(**{quantity: np.nanmean(values[:, here], axis=1)})
        found.append(row)
    return found


def figure(rows: list[dict[str, object]]) -> Figure:
    """Return current and chi against age, over their final values."""
    made = style.figure(style.PAGE, 3.2)
    panels = made.subplots(1, 2)
    for at, name in enumerate(POINTS):
        own = [row for row in rows if row["point"] == name]
        ages = [middle(row["from"], row["to"]) for row in own]
        label = f"T = {own[0]['T']}, w' = {own[0]['w2']:g}"
        for axes, quantity in zip(panels, ("current", "chi"), strict=True):
            last = own[-1][quantity]
            error = f"{quantity}_error"
            off = [{"off": 100.0 * (row[quantity] / last - 1.0), "off_error": 100.0 * row[error]
                    / last} for row in own]  # fmt: skip
            bars(axes, off, ages, "off", fmt="osD"[at], lw=1.0, color=f"C{at}", label=label)
        end = own[-1]["theory"]
        shown = [100.0 * (row["theory"] / end - 1.0) for row in own]
        panels[0].plot(ages, shown, "-", color=f"C{at}", lw=1.0)
    for axes, title in zip(panels, ("net current of channel 2", "chi"), strict=True):
        axes.set_xscale("log")
        axes.set_xlabel("age of the run")
        axes.set_title(title, fontsize=10)
        axes.axhline(0.0, color="0.7", lw=0.7, zorder=0)
    panels[0].set_ylabel("off from its value at the end (%)")
    panels[0].set_ylim(-10.5, 2.0)
    panels[1].legend(fontsize=8)
    return made


def run(work: study.Study) -> None:
    """Run, write the table and the picture."""
    rows = [row for name in POINTS for row in rows_of(work, name)]
    work.rows("results", [{key: row[key] for key in FIELDS} for row in rows], 6)
    work.draw(figure(rows), "age_of_a_run")


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

"""Counts of channel 2 with and against the current: tables and picture of the page in this folder.

Quick: a tenth of the time of the namelists, a minute of a core. --full: the namelists unchanged,
some minutes of a core and 0.1 GB.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import f90nml
import numpy as np

import postproc
from postproc import study
from postproc.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = list[dict[str, object]]

CASES = {
    "free": "free",
    "gated": "T = 7",
    "gated_reservoir": "T = 7, reservoir",
    "wide": "T = 12",
    "wide_reservoir": "T = 12, reservoir",
}
SHORT = (0.5, 1.0, 2.0, 4.0)
LONG = (1.0, 4.0, 16.0, 64.0, 256.0, 1000.0, 4000.0, 10000.0)
FEWEST = 25  # counts of -j for a ratio
PARTS = 4  # of each run, for errors of variances


def counts_of(work: study.Study, name: str) -> tuple[np.ndarray, float, float]:
    """Return net counts per replica and interval, its length, and ln of the ratio of flows."""
    groups = f90nml.read(work.place / f"{name}.nml")
    transient, duration = (groups["run"][key] for key in ("transient_duration", "duration"))
    length = work.pick(0.1, 1.0) * (duration - transient)
    path = work.run(name, name, {"run": {"duration": transient + length}})
    data = postproc.open_results(path, group="series").squeeze()
    time = data.time.to_numpy()
    step = float(time[1] - time[0])
    # A run may end just before its last entry.
    stationary = (time > transient) & (time < time[-1])
    net = (data.flow2_21 - data.flow2_12).to_numpy()[:, stationary] * step
    counts = np.rint(net)
    if not np.allclose(net, counts, atol=1e-6):
        message = f"{name}: flows of an interval are no whole counts"
        raise ValueError(message)
    flows = [float(data[key].to_numpy()[:, stationary].mean()) for key in ("flow2_21", "flow2_12")]
    return counts.astype(int), step, math.log(flows[0] / flows[1])


def summed(counts: np.ndarray, length: int) -> np.ndarray:
    """Return the counts of longer intervals, replica by interval."""
    many = counts.shape[1] // length
    return counts[:, : many * length].reshape(counts.shape[0], many, length).sum(axis=2)


def slopes(name: str, counts: np.ndarray, step: float, predicted: float) -> Rows:
    """Return ln P(j)/P(-j) over j for each length and each j with enough counts."""
    rows = []
    for length in SHORT:
        whole = summed(counts, round(length / step))
        for j in range(1, 9):
            with_, against = int((whole == j).sum()), int((whole == -j).sum())
            if min(with_, against) >= FEWEST:
                slope, error = math.log(with_ / against), math.sqrt(1 / with_ + 1 / against)
                rows.append({"case": name, "t": length, "j": j, "slope": slope / j,
                             "error": error / j, "predicted": predicted})  # fmt: skip
    return rows


def variances(name: str, counts: np.ndarray, step: float) -> Rows:
    """Return the variance of counts per unit time, and 2 mean/variance, by length.

    Each run is divided into parts; errors are those of means over replicas and parts.
    """
    rows = []
    mean = counts.mean() / step
    for length in LONG:
        whole = summed(counts, round(length / step))
        usable = whole.shape[1] // PARTS
        if usable < 2:
            continue
        parts = whole[:, : usable * PARTS].reshape(-1, usable)
        # About the mean of all: the mean of a part would remove slower fluctuations.
        spread = ((parts - mean * length) ** 2).mean(axis=1) / length
        rows.append({"case": name, "t": length, "current": mean, "variance_rate": spread.mean(),
                     "error": spread.std(ddof=1) / math.sqrt(spread.size),
                     "slope": 2.0 * mean / spread.mean()})  # fmt: skip
    return rows


def figure(ratios: Rows, spreads: Rows) -> Figure:
    """Return ln P(j)/P(-j) against j at t = 1, and the rate of the variance against t."""
    made = style.figure(style.PAGE, 3.4)
    panels = made.subplots(1, 2)
    for at, (name, label) in enumerate(CASES.items()):
        mark = {"fmt": "osD^v"[at], "ms": 4.5, "color": f"C{at}", "label": label, "lw": 1.0,
                "mfc": "white" if "reservoir" in name else f"C{at}"}  # fmt: skip
        own = [row for row in ratios if row["case"] == name and row["t"] == 1.0]
        panels[0].errorbar([row["j"] for row in own], [row["slope"] * row["j"] for row in own],
                           [row["error"] * row["j"] for row in own], **mark)  # fmt: skip
        panels[0].plot([0.0, 6.0], [0.0, 6.0 * own[0]["predicted"]], color=f"C{at}", lw=0.8)
        own = [row for row in spreads if row["case"] == name]
        first = own[0]["variance_rate"]
        panels[1].errorbar([row["t"] for row in own], [row["variance_rate"] / first for row in own],
                           [row["error"] / first for row in own], **mark)  # fmt: skip
    panels[0].set(xlabel="net crossings j of channel 2 in one time unit", ylabel="ln P(j)/P(-j)",
                  ylim=(-0.5, 10.5))  # fmt: skip
    panels[1].legend(fontsize=8, loc="upper left")
    panels[1].set(xscale="log", yscale="log", xlabel="length t of the intervals",
                  ylabel="variance of counts / t, relative to t = 1")  # fmt: skip
    return made


def run(work: study.Study) -> None:
    """Make all tables and pictures of the page."""
    found: dict[str, Rows] = {"slopes": [], "variances": []}
    for name in CASES:
        counts, step, predicted = counts_of(work, name)
        found["slopes"] += slopes(name, counts, step, predicted)
        found["variances"] += variances(name, counts, step)
    for name, rows in found.items():
        work.table(name, list(rows[0]), [[_text(one) for one in row.values()] for row in rows])
    work.draw(figure(*found.values()), "fluctuations")


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

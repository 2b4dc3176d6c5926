"""Experiments with other urns: disc, square and hexagons of equal area and openings.

Runs are made in build/shapes/quick, or full (minutes of one core), and not repeated if they are
complete. Writes numbers to shapes.json, tables to CSV files, the picture to shapes.png.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc.figures import style
from studies.common import event_log, geometry, study
from studies.common.event_log import CROSSING2
from studies.common.geometry import DISC, IRRATIONAL, REGULAR, SQUARE
from studies.common.numbers import bars, said, with_errors
from studies.common.theories import told

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Row = dict[str, float]
    Rows = list[Row]
    Found = dict[str, dict[str, Rows]]

NUMBER = 1000
MANY = 10000  # for independent particles: in rational polygons directions are conserved
WIDTH = 0.01  # of channel 2
THRESHOLDS = (1, 2, 3, 5, 7, 9, 11, 13, 15, 17, 20, 24)
PASSAGES = (0.01, 0.05)  # widths of channel 2 at which returns are counted
LAGS = (1, 2, 5, 10, 20, 40, 80)  # visits
# share of urn 1 at the start, and transients in units of the duration
KINDS = {"states": (1.0, 2.0), "shorter": (1.0, 1.0), "equal": (0.5, 2.0)}
LOOKS = {
    DISC: ("o", style.BLUE), SQUARE: ("s", style.VERMILION), REGULAR: ("h", style.ORANGE),
    IRRATIONAL: ("^", style.GREEN),
}  # fmt: skip


class Runs:
    """Runs in a study's folder; all their times are multiples of `duration`."""

    def __init__(self, work: study.Study, replicas: int, duration: float) -> None:
        """Store the study, the number of replicas and the duration."""
        self.work, self.replicas, self.duration = work, replicas, duration

    def run(self, name: str, **groups: dict[str, object]) -> Path:
        """Make a run; return its results."""
        given = {"particles": {"number": NUMBER}, **groups}
        single = "replicas" not in given.get("scan", {})
        return self.work.run(given, name.replace(" ", "_"), alone=single)

    def states(self, shape: str, fraction: float, transients: float) -> Rows:
        """Return chi and current over T, with standard errors over replicas."""
        transient = transients * self.duration
        made = self.run(
            f"{shape} {fraction:g} {transients:g}",
            table={"channel2_width": WIDTH, **geometry.shapes(WIDTH)[shape]},
            run={"duration": transient + self.duration, "transient_duration": transient},
            scan={"threshold": list(THRESHOLDS), "replicas": self.replicas,
                  "urn1_fraction": [fraction]},
        )  # fmt: skip
        data, rows = postproc.open_results(made).squeeze(), []
        for threshold in THRESHOLDS:
            point = data.sel(threshold=threshold) if "threshold" in data.dims else data
            seen = {name: point[name].to_numpy() for name in ("chi", "polarised_current")}
            rows.append({"threshold": float(threshold), **with_errors(**seen)})
        return rows

    def returns(self, shape: str) -> Rows:
        """Return how often a particle leaves through channel 2 after entering through it."""
        rows = []
        for width in PASSAGES:
            made = self.run(
                f"returns {shape} {width:g}",
                table={"channel2_width": width, **geometry.shapes(width)[shape]},
                particles={"number": MANY}, gate={"threshold": MANY},
                run={"duration": 4.0 * self.duration}, output={"event_log": True},
            )  # fmt: skip
            events = event_log.particle_events(event_log.read_log(made))
            seen = dict(zip(("return", "stay"), event_log.after_channel2(events), strict=True))
            found = with_errors(**seen)
            chance = width / (width + 0.3)
            count = int(np.count_nonzero((events.kind == CROSSING2) & (events.after >= 0)))
            rows.append({
                "channel2_width": width, "visits": count, "chance": chance,
                **found, "binomial": math.sqrt(found["return"] * (1.0 - found["return"]) / count),
            })  # fmt: skip
        return rows

    def directions(self, shape: str) -> Rows:
        """Return the autocorrelation of cos(theta) from visit to visit, of one urn without gate."""
        duration = 40.0 * self.duration
        made = self.run(
            f"directions {shape}", table={"shape": "urn", **geometry.shapes(0.0)[shape]},
            gate={"threshold": NUMBER}, run={"duration": duration}, output={"event_log": True},
        )  # fmt: skip
        seen = event_log.entries_of(event_log.particle_events(event_log.read_log(made)))
        values = event_log.autocorrelations(*seen, np.array(LAGS), 0.5 * duration)
        return [{"lag": lag, **with_errors(correlation=column)}
                for lag, column in zip(LAGS, values.T, strict=True)]  # fmt: skip


def measure(work: study.Study, replicas: int, duration: float) -> Found:
    """Make all runs; return rows by kind and shape, and those of well mixed urns."""
    runs = Runs(work, replicas, duration)
    return {
        "well mixed": {"renewal": well_mixed()},
        **{kind: {shape: runs.states(shape, *start) for shape in LOOKS}
           for kind, start in KINDS.items()},
        "returns": {shape: runs.returns(shape) for shape in LOOKS},
        "directions": {shape: runs.directions(shape) for shape in LOOKS},
    }  # fmt: skip


def well_mixed() -> Rows:
    """Return chi and current of well mixed urns of this area behind renewal gates, over T."""
    rows = []
    for threshold in range(THRESHOLDS[0], THRESHOLDS[-1] + 1):
        theory = told(
            "renewal_occupation", number=NUMBER, threshold=threshold, channel2_width=WIDTH
        )
        stable = [root for root in theory["roots"] if root["kind"] == "stable"]
        state = stable[-1] if stable else {"mass_spread": 0.0, "net_current": 0.0}
        rows.append({
            "threshold": threshold, "chi": state["mass_spread"],
            "polarised_current": abs(state["net_current"]),
        })  # fmt: skip
    return rows


def _bars(axes: Axes, by_shape: dict[str, Rows], across: str, up: str, line: str = "none") -> None:
    for shape, (marker, colour) in LOOKS.items():
        bars(axes, by_shape[shape], across, up, marker=marker, mfc="none", color=colour, ls=line,
             lw=0.8, label=shape)  # fmt: skip


def figure(found: Found) -> Figure:
    """Return chi and current over T, memory of directions over visits, and returns over chance."""
    made = style.figure(style.PAGE, 4.8)
    (spread, current), (memory, back) = made.subplots(2, 2)
    mixed = found["well mixed"]["renewal"]
    for axes, name, label in (
        (spread, "chi", r"$\chi$"), (current, "polarised_current", "net current (per unit time)"),
    ):  # fmt: skip
        axes.plot([row["threshold"] for row in mixed], [row[name] for row in mixed],
                  color=style.GREY, lw=0.8, label="well mixed")  # fmt: skip
        _bars(axes, found["states"], "threshold", name)
        axes.set(xlabel="$T$", ylabel=label, ylim=(0, None))
    spread.legend(loc="center", bbox_to_anchor=(0.36, 0.45))
    _bars(memory, found["directions"], "lag", "correlation", "-")
    memory.axhline(0.0, color=style.GREY, lw=0.6)
    memory.set(xscale="log", xlabel="visits", ylabel=r"autocorrelation of $\cos\theta$")
    shares = {shape: [{"width": row["channel2_width"], "share": row["return"] / row["chance"],
                       "share_error": row["return_error"] / row["chance"]} for row in rows]
              for shape, rows in found["returns"].items()}  # fmt: skip
    _bars(back, shares, "width", "share")
    back.axhline(1.0, color=style.GREY, lw=0.8)
    back.set(xlabel="width of channel 2", ylabel="returns over those by chance", ylim=(0, None),
             xlim=(0.0, None))  # fmt: skip
    return made


def write_tables(work: study.Study, found: Found) -> None:
    """Write the tables of the page: names, and those of the transients and starts beside them."""
    mixed = {row["threshold"]: row for row in found["well mixed"]["renewal"]}
    for kind, name in itertools.product(KINDS, ("chi", "polarised_current")):
        title = "chi" if name == "chi" else "net current"
        work.table(f"{kind}_{name}", ["T", f"{title}, {DISC}", *list(LOOKS)[1:], "well mixed"], [
            [f"{rows[0]['threshold']:g}", *(said(row, name, 3) for row in rows),
             f"{mixed[rows[0]['threshold']][name]:.3f}"]
            for rows in zip(*found[kind].values(), strict=True)
        ])  # fmt: skip
    widths = [f"w' = {one:g}" for one in PASSAGES]
    head = ["shape", *itertools.chain(*((f"a, {one}", "over chance") for one in widths)),
            "binomial errors"]  # fmt: skip
    work.table("returns", head, [
        [shape, *itertools.chain(*(
            (said(row, "return", 4), f"{row['return'] / row['chance']:.2f}") for row in rows)),
         ", ".join(f"{row['binomial']:.4f}" for row in rows)]
        for shape, rows in found["returns"].items()
    ])  # fmt: skip
    work.table("directions", ["visits", *LOOKS], [
        [f"{rows[0]['lag']}", *(said(row, "correlation", 3) for row in rows)]
        for rows in zip(*found["directions"].values(), strict=True)
    ])  # fmt: skip


def run(work: study.Study) -> None:
    """Make the runs; store numbers, write tables, draw `shapes`."""
    found = measure(work, int(work.pick(2, 8)), 2000.0)
    work.keep("shapes", found)
    write_tables(work, found)
    work.draw(figure(found), "shapes")


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

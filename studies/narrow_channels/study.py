"""The net current over the paper's, as both channels become narrow at a fixed load.

Runs narrow.nml with other widths, into build/narrow_channels/quick, or full, and writes results.csv
and narrow_channels.png: the net current of runs and of the theory `direction`, with and without
circulation, over that of `window`, the paper's theory. Quick: widths down to 0.1, minutes of a
core. --full: down to 0.05, as shown on the page.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc import study
from postproc.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOAD = 300.0  # N w
RELAXATION = 25.0  # of directions, over w^3
CASES = {
    "A": (0.03, (7, 7)),
    "B": (0.03, (4, 40)),
    "C": (0.3, (4, 40)),
    "D": (1.0, (4, 40)),
}
QUICK, FULL = (0.3, 0.2, 0.1), (0.3, 0.2, 0.1, 0.05)
THEORY = (0.3, 0.2, 0.1, 0.05, 0.02, 0.01, 0.001)  # the last represents the limit
FIELDS = ("circuit", "ratio", "T1", "T2", "w", "N", "current", "current_error", "chi", "chi_error",
          "over_paper", "over_paper_error", "direction", "without_circulation", "F", "F_error",
          "time")  # fmt: skip


def theory_state(
    work: study.Study, model: str, case: str, width: float
) -> tuple[dict[str, float], float]:
    """Return a theory's stable state with the largest current, and an urn's area."""
    ratio, thresholds = CASES[case]
    found = work.theory(
        model, number=round(LOAD / width), threshold=thresholds, channel1_width=width,
        channel2_width=ratio * width,
    )  # fmt: skip
    states = [one for one in found["roots"] if one["kind"] == "stable"]
    best = max(states, key=lambda one: abs(one["net_current"]))
    return best, float(np.ravel(found["urn_area"])[0])


def measured(work: study.Study, case: str, width: float) -> dict[str, float]:
    """Run one circuit at one width; return means over replicas with errors."""
    ratio, thresholds = CASES[case]
    number = round(LOAD / width)
    start = theory_state(work, "direction", case, width)[0]["urn2_number"]
    transient = max(2.0 * RELAXATION / width**3, 1e4)
    changes = {
        "table": {"channel1_width": width, "channel2_width": ratio * width},
        "particles": {"number": number, "urn1_number": round(number - start)},
        "gate": {"threshold": thresholds},
        "run": {"transient_duration": transient,
                "duration": transient + work.pick(5e4, max(2e5, 2.0 * transient))},
    }  # fmt: skip
    file = work.run("narrow", f"{case}_{width:g}", changes)
    data = postproc.open_results(file).squeeze()
    current, chi = np.abs(data.current2.to_numpy()), np.abs(data.chi.to_numpy())
    scale = math.sqrt(current.size)
    return {
        "current": current.mean(), "current_error": current.std(ddof=1) / scale,
        "chi": chi.mean(), "chi_error": chi.std(ddof=1) / scale,
        "time": float(data.time.to_numpy().mean() - transient) * current.size,
    }  # fmt: skip


def rows_of(work: study.Study) -> list[dict[str, object]]:
    """Return a row for each circuit and width, also for theories without a run."""
    rows: list[dict[str, object]] = []
    widths = work.pick(QUICK, FULL)
    for case, (ratio, thresholds) in CASES.items():
        for width in THEORY:
            paper, area = theory_state(work, "window", case, width)
            state, _ = theory_state(work, "direction", case, width)
            row: dict[str, object] = {
                "circuit": case,
                "ratio": ratio,
                "T1": thresholds[0],
                "T2": thresholds[1],
                "w": width,
                "N": round(LOAD / width),
                "direction": state["net_current"] / paper["net_current"],
            }
            around = state["circulating_current"] / paper["net_current"]
            row["without_circulation"] = row["direction"] - around
            if width in widths:
                row |= measured(work, case, width)
                row["over_paper"] = row["current"] / abs(paper["net_current"])
                row["over_paper_error"] = row["current_error"] / abs(paper["net_current"])
                # the error of the difference of the urns' numbers is negligible
                unit = ratio * width * row["chi"] * row["N"] / (math.pi * area)
                row["F"], row["F_error"] = row["current"] / unit, row["current_error"] / unit
            rows.append(row)
    return rows


def limits_of(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """Return for each circuit the limit of runs at w = 0, by a straight line in w, with its error.

    The error of four replicas is itself uncertain by 40 %: the median is the lower bound of all.
    """
    found = []
    for case in CASES:
        own = [row for row in rows if row["circuit"] == case]
        runs = [row for row in own if "current" in row]
        error = np.array([row["over_paper_error"] for row in runs])
        fit, covariance = np.polyfit(
            [row["w"] for row in runs], [row["over_paper"] for row in runs], 1,
            w=1.0 / np.maximum(error, np.median(error)), cov="unscaled",
        )  # fmt: skip
        found.append({
            "circuit": case, "runs": fit[1], "runs_error": math.sqrt(covariance[1, 1]),
            "two_ports": own[-1]["without_circulation"],
        })  # fmt: skip
    return found


def figure(rows: list[dict[str, object]]) -> Figure:
    """Return charts of the net current over the paper's against w."""
    made = style.figure(style.PAGE, 3.4)
    panels = made.subplots(1, 2)
    for at, (case, (ratio, thresholds)) in enumerate(CASES.items()):
        axes, colour = panels[at // 2], f"C{at}"
        own = [row for row in rows if row["circuit"] == case]
        width = [row["w"] for row in own]
        axes.plot(width, [row["direction"] for row in own], "-", color=colour, lw=1.0)
        axes.plot(width, [row["without_circulation"] for row in own], ":", color=colour, lw=1.4)
        runs = [row for row in own if "current" in row]
        axes.errorbar(
            [row["w"] for row in runs], [row["over_paper"] for row in runs],
            [row["over_paper_error"] for row in runs], fmt="os"[at % 2], ms=4.5, color=colour,
            mfc="none", capsize=2, ls="none",
            label=f"{case}: w'/w = {ratio:g}, T = {thresholds[0]}, {thresholds[1]}",
        )  # fmt: skip
    for axes in panels:
        axes.axhline(1.0, color="black", lw=0.8)
        axes.set_xscale("log")
        axes.set_xlabel("w/r, at N w = 300 r")
        axes.legend(loc="upper left", frameon=False, fontsize=8)
    panels[0].set_ylabel("net current over that of window")
    return made


def run(work: study.Study) -> None:
    """Make all tables and pictures of the page."""
    rows = rows_of(work)
    for name, fields, table in (
        ("results", FIELDS, rows),
        ("limits", ("circuit", "runs", "runs_error", "two_ports"), limits_of(rows)),
    ):
        work.table(name, fields, [[_text(row.get(key, "")) for key in fields] for row in table])
    work.draw(figure(rows), "narrow_channels")


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

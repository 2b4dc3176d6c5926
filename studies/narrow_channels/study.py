"""The net current over the paper's, as both channels become narrow at a fixed load.

Parts, of which the command line may choose:

runs        narrow.nml with other widths, w from 0.3 down, into results.csv: circuits A to D
near        circuits nearer to a transition, E and F, from both sides, into near.csv
narrower    A to D at w from 0.01 down, N from 3e4 up, into narrower.csv
visits      visits drawn at random, into visits.csv; limits of narrow channels, into ratios.csv
theories    what theories have for E and F, and walkers for A and D, into theories.csv
comparison  results.csv over theory at the age of the runs, into comparison.csv
limits      the same, extrapolated to w = 0, into limits.csv
picture     of the tables

The last three read tables of this folder, and one of the study of circulation. Quick: w down to
0.1, few time units, five minutes of a core. --full: what the page shows, half an hour.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc.figures import style
from studies.common import study
from studies.common.geometry import urn_area
from studies.common.numbers import bars, read_table, with_errors
from studies.common.theories import THEORIES
from studies.common.theories import told as theories_told
from studies.narrow_channels import visits

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Row = dict[str, object]

HERE = Path(__file__).parent
WIDTHS = HERE.parent / "circulation/widths.csv"  # theory at the age of the runs of results.csv
LOAD = 300.0  # N w
SAMPLES = 40  # of flows and numbers, in what is measured of a run
RELAXATION = 25.0  # of directions, over w^3
CASES = {
    "A": (0.03, (7, 7)),
    "B": (0.03, (4, 40)),
    "C": (0.3, (4, 40)),
    "D": (1.0, (4, 40)),
}
NEAR = {"E": (0.03, (15, 15)), "F": (0.3, (10, 10))}
QUICK, FULL = (0.3, 0.2, 0.1), (0.3, 0.2, 0.1, 0.05)
LIMIT = 0.001  # w that stands for the limit in theories
ASKED = tuple(name for name in THEORIES if name != "renewal")
WALKERS = "one_particle"  # measured at commit 82beb69: kept in theories.csv
VISITS = ((0.01, 2_000_000),)  # w and how many
RATIOS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 1.0)


@dataclass(frozen=True)
class Plan:
    """Runs of one circuit at one width.

    Attributes
    ----------
    case : letter of the circuit, of `CASES` or `NEAR`.
    width : w.
    transient, measured : time units, of one replica.
    replicas : how many.
    """

    case: str
    width: float
    transient: float
    measured: float
    replicas: int = 4

    @property
    def number(self) -> int:
        """N."""
        return round(LOAD / self.width)

    @property
    def age(self) -> float:
        """Age in the middle of what is measured."""
        return self.transient + 0.5 * self.measured


# quick, full
NEARER = (
    (Plan("E", 0.1, 2e4, 2e4), Plan("F", 0.1, 2e4, 2e4)),
    (Plan("E", 0.1, 1e5, 3e5, 12), Plan("F", 0.1, 1e5, 3e5), Plan("E", 0.05, 6e5, 4e5, 8)),
)  # fmt: skip
NARROWER = (
    (Plan("D", 0.01, 2e3, 8e3),),
    (
        *(Plan(one, 0.01, 1e5, 2e5) for one in "AB"),
        *(Plan(one, 0.01, 2e4, 1e5) for one in "CD"),
        Plan("A", 0.001, 1e5, 2e5), *(Plan(one, 0.001, 3e4, 6e4) for one in "CD"),
    ),
)  # fmt: skip


def circuit_of(case: str) -> tuple[float, tuple[int, int]]:
    """Return w'/w and the thresholds of a circuit by its letter."""
    return (CASES | NEAR)[case]


def told(model: str, case: str, width: float, age: float = math.inf) -> dict[str, float]:
    """Return what a theory says of the stable state with the largest current.

    An empty dictionary if the homogeneous state is the only one. With an age the net current is
    that of a run of this age, "at_age" its absolute value.
    """
    ratio, thresholds = circuit_of(case)
    found = theories_told(
        model, age, number=round(LOAD / width), threshold=thresholds, channel1_width=width,
        channel2_width=ratio * width,
    )  # fmt: skip
    states = [one for one in found["roots"] if one["kind"] == "stable"]
    if not states:
        return {}
    best = max(states, key=lambda one: abs(one["net_current"]))
    if age < math.inf:
        best["at_age"] = abs(best["net_current"])
    return best


def halves(samples: Floats) -> Floats:
    """Return the means of the earlier and the later half of samples: shape (replica, 2)."""
    middle = samples.shape[1] // 2
    return np.stack([samples[:, :middle].mean(axis=1), samples[:, middle:].mean(axis=1)], axis=1)


def changes_of_sign(samples: Floats) -> int:
    """Return how often successive samples, along the last axis, are of unlike sign."""
    return int(np.count_nonzero(samples[..., 1:] * samples[..., :-1] < 0.0))


def ran(work: study.Study, plan: Plan, name: str, urn2_number: float) -> dict[str, float]:
    """Run a circuit that starts with so many in urn 2; return means over replicas with errors.

    "current" is the size of each replica's mean net current, "signed" that with its sign,
    "early" and "late" its size in the two halves of what is measured. "changes": how often the
    fuller urn is another one, from sample to sample of all replicas.
    """
    ratio, thresholds = circuit_of(plan.case)
    file = work.run("narrow", name, {
        "table": {"channel1_width": plan.width, "channel2_width": ratio * plan.width},
        "particles": {"number": plan.number, "urn1_number": round(plan.number - urn2_number)},
        "gate": {"threshold": thresholds},
        "run": {"transient_duration": plan.transient, "duration": plan.transient + plan.measured},
        "scan": {"replicas": plan.replicas},
        "output": {"series_interval": plan.measured / SAMPLES},
    })  # fmt: skip
    data = postproc.open_results(file).squeeze()
    series = postproc.open_results(file, group="series").squeeze().transpose("replica", "time", ...)
    net = (series.flow2_12 - series.flow2_21).to_numpy()[:, -SAMPLES:]
    excess = series.urn1_number.to_numpy()[:, -SAMPLES:] - 0.5 * plan.number
    early, late = np.abs(halves(net)).T
    signed = data.current2.to_numpy()
    return {
        "changes": changes_of_sign(excess),
        **with_errors(current=np.abs(signed), signed=signed, chi=np.abs(data.chi.to_numpy()),
                      early=early, late=late),
    }  # fmt: skip


def about(plan: Plan) -> Row:
    """Return the columns that say which circuit was run and for how long."""
    return {"circuit": plan.case, "w": plan.width, "N": plan.number, "replicas": plan.replicas,
            "transient": plan.transient, "measured": plan.measured}  # fmt: skip


def runs(work: study.Study) -> None:
    """Make results.csv."""
    rows: list[Row] = []
    for (case, (ratio, thresholds)), width in product(CASES.items(), work.pick(QUICK, FULL)):
        transient = max(2.0 * RELAXATION / width**3, 1e4)
        plan = Plan(case, width, transient, work.pick(5e4, max(2e5, 2.0 * transient)))
        start = told("direction", case, width)["urn2_number"]
        seen = ran(work, plan, f"first_{case}_{width:g}", start)
        seen |= over("paper", seen, abs(told("window", case, width)["net_current"]))
        rows.append({**about(plan), **seen, "ratio": ratio, "T1": thresholds[0],
                     "T2": thresholds[1], "time": plan.replicas * plan.measured})  # fmt: skip
    fields = ("circuit", "ratio", "T1", "T2", "w", "N", "current", "current_error", "chi",
              "chi_error", "over_paper", "over_paper_error", "time")  # fmt: skip
    work.rows("results", [{key: row[key] for key in fields} for row in rows], 6)


def over(name: str, row: Row, unit: float) -> Row:
    """Return a row's current and its error in units of another one."""
    keys = (("current", f"over_{name}"), ("current_error", f"over_{name}_error"))
    return {key: row[own] / unit for own, key in keys}


def conductance(row: Row) -> Row:
    """Return F, the current over w'/(pi A) and the difference of the halves' numbers, and error."""
    width = float(row["w"])
    ratio, _ = circuit_of(row["circuit"])
    unit = ratio * width * row["chi"] * row["N"] / (math.pi * urn_area(ratio * width, width))
    return {"F": row["current"] / unit, "F_error": row["current_error"] / unit}


def near(work: study.Study) -> None:
    """Make near.csv: E and F from the polarised state of `window`, and from equal halves."""
    rows: list[Row] = []
    for plan in work.pick(*NEARER):
        paper = told("window", plan.case, plan.width)
        for start, number in (("window", paper["urn2_number"]), ("even", 0.5 * plan.number)):
            seen = ran(work, plan, f"{plan.case}_{plan.width:g}_{start}", number)
            seen |= over("paper", seen, abs(paper["net_current"]))
            rows.append({**about(plan), "start": start, **seen})
    work.rows("near", rows, 6)


def narrower(work: study.Study) -> None:
    """Make narrower.csv: A to D in narrower channels, with theory at the age of the runs."""
    rows: list[Row] = []
    for plan in work.pick(*NARROWER):
        state = told("direction", plan.case, plan.width, plan.age)
        paper = abs(told("window", plan.case, plan.width)["net_current"])
        seen = ran(work, plan, f"{plan.case}_{plan.width:g}", state["urn2_number"])
        seen |= over("paper", seen, paper) | over("theory", seen, state["at_age"])
        seen |= {"theory": state["at_age"] / paper, "theory_chi": state["mass_spread"]}
        row = {**about(plan), **seen}
        rows.append(row | conductance(row))
    work.rows("narrower", rows, 6)


def visits_and_limits(work: study.Study) -> None:
    """Make visits.csv and ratios.csv."""
    rows: list[Row] = []
    for width, count in VISITS:
        for ratio in (0.03, 0.3, 1.0):
            back, across, neither = visits.drawn_returns(width, ratio, count // work.pick(20, 1))
            chance = back / (back + across)
            error = math.sqrt(chance * (1.0 - chance) / (back + across))
            rows.append({
                "w": width, "ratio": ratio, "visits": back + across, "given_up": neither,
                "a": chance, "a_error": error, "a_limit": visits.narrow_chance(ratio),
                "R": visits.deep_ratio(ratio, chance),
                "R_error": error * 2.0 * (1.0 + 2.0 * ratio) / (1.0 + chance) ** 2,
                "R_limit": visits.deep_limit(ratio),
            })  # fmt: skip
    work.rows("visits", rows, 6)
    work.rows("ratios", [
        {"ratio": one, "a": visits.narrow_chance(one), "R": visits.deep_limit(one),
         "excess_over_ratio": (visits.deep_limit(one) - 1.0) / one} for one in RATIOS
    ], 6)  # fmt: skip


def theories(work: study.Study) -> None:
    """Make theories.csv: current over that of `window` and chi by each theory, 0 if it has none."""
    places = (*((plan.case, plan.width) for plan in NEARER[1]), ("E", LIMIT), ("F", LIMIT))
    rows: list[Row] = []
    for (case, width), model in product(places, ASKED):
        state = told(model, case, width)
        paper = abs(told("window", case, width)["net_current"])
        rows.append({
            "circuit": case, "w": width, "model": model,
            "over_paper": abs(state.get("net_current", 0.0)) / paper,
            "over_paper_error": state.get("net_current_error", 0.0) / paper,
            "chi": abs(state.get("mass_spread", 0.0)),
            "chi_error": state.get("mass_spread_error", 0.0),
        })  # fmt: skip
    rows += [row for row in read_table(HERE / "theories.csv") if row["model"] == WALKERS]
    work.rows("theories", rows, 6)


def line(width: Floats, value: Floats, error: Floats, degree: int = 1) -> tuple[float, float]:
    """Return what a polynomial in w through values has at w = 0, and its error.

    An error of four replicas is itself uncertain by 40 %: none is taken as less than the median.
    """
    fit, covariance = np.polyfit(
        width, value, degree, w=1.0 / np.maximum(error, np.median(error)), cov="unscaled"
    )
    return float(fit[-1]), math.sqrt(covariance[-1, -1])


def extrapolated(own: Sequence[Row], ends: float) -> Row:
    """Return what runs of one circuit tend to at w = 0 by several fits, `ends` being theory's.

    "runs" is from a straight line through runs over theory at their age, times `ends`. Others:
    straight line and parabola through runs over the paper, the straight line without the widest
    channels, and the narrowest measured, over theory, without a fit. "spread" is by how much they
    move the first, at most.
    """
    width, paper, paper_error, theory, theory_error = (
        np.array([row[key] for row in own]) for key in
        ("w", "over_paper", "over_paper_error", "over_theory", "over_theory_error")
    )  # fmt: skip
    over_theory, error = line(width, theory, theory_error)
    others = {
        "straight": line(width, paper, paper_error)[0],
        "parabola": line(width, paper, paper_error, 2)[0],
        "straight_below": line(width[1:], paper[1:], paper_error[1:])[0],
        "narrowest": theory[-1] * ends,
    }
    spread = max(abs(one - over_theory * ends) for one in others.values())
    found = {"over_theory": over_theory, "over_theory_error": error}
    found |= {"runs": over_theory * ends, "runs_error": error * ends}
    return {**found, **others, "spread": spread}


def comparison(work: study.Study) -> None:
    """Make comparison.csv, from results.csv and from widths.csv of the study of circulation."""
    own = {(row["circuit"], row["w"]): row for row in read_table(table_of(work, "results"))}
    rows: list[Row] = []
    for at in read_table(WIDTHS):
        row = own.get((at["circuit"], at["w"]))
        if row is None:
            continue
        paper = row["current"] / row["over_paper"]
        rows.append({
            "circuit": at["circuit"], "w": at["w"], "age": at["age"],
            "over_paper": row["over_paper"], "over_paper_error": row["over_paper_error"],
            "theory": at["theory"] / paper, "without_circulation": at["without"] / paper,
            **over("theory", row, at["theory"]), **conductance(row),
        })  # fmt: skip
    work.rows("comparison", rows, 6)


def limits(work: study.Study) -> None:
    """Make limits.csv, from comparison.csv."""
    rows, found = read_table(table_of(work, "comparison")), []
    for case, (ratio, _) in CASES.items():
        state = told("direction", case, LIMIT)
        paper = abs(told("window", case, LIMIT)["net_current"])
        ends = abs(state["net_current"] - state["circulating_current"]) / paper
        some = [row for row in rows if row["circuit"] == case]
        found.append({"circuit": case, "closed_form": visits.deep_limit(ratio), "two_ports": ends,
                      **extrapolated(some, ends)})  # fmt: skip
    work.rows("limits", found, 6)


def table_of(work: study.Study, name: str) -> Path:
    """Return a table's path: the one just made, or that beside the page."""
    made = work.folder / f"{name}.csv"
    return made if made.exists() else HERE / f"{name}.csv"


def picture(work: study.Study) -> None:
    """Draw the tables."""
    names = ("comparison", "narrower", "near", "theories")
    rows = {name: read_table(table_of(work, name)) for name in names}
    made = style.figure(style.PAGE, 4.8)
    panels = made.subplots(2, 3)
    for case, axes in zip("ABCD", (*panels[0, :2], *panels[1, :2]), strict=True):
        _towards_limit(axes, case, rows["comparison"], rows["narrower"])
    for case, axes in zip("EF", panels[:, 2], strict=True):
        _near_transition(axes, case, rows["near"], rows["theories"])
    for axes in panels[:, 0]:
        axes.set_ylabel("R, net current over the paper's")
    for axes in panels[1]:
        axes.set_xlabel("w/r, at N w = 300 r")
    work.draw(made, "narrow_channels")


def _towards_limit(axes: Axes, case: str, first: Sequence[Row], more: Sequence[Row]) -> None:
    """Draw runs over the paper against w, theory at their age, and the closed form."""
    ratio, thresholds = CASES[case]
    for rows, mark, colour, label in (
        (first, "o", "C0", "first runs"), (more, "s", "C1", "later runs")
    ):  # fmt: skip
        own = [row for row in rows if row["circuit"] == case]
        bars(axes, own, "w", "over_paper", fmt=mark, ms=4, color=colour, mfc="none", capsize=2,
             ls="none", label=label)  # fmt: skip
    own = sorted((row for row in [*first, *more] if row["circuit"] == case),
                 key=lambda row: (row["w"], row["theory"]))  # fmt: skip
    axes.plot([row["w"] for row in own], [row["theory"] for row in own], "-", color="black",
              lw=0.9, label="direction, at this age")  # fmt: skip
    axes.axhline(visits.deep_limit(ratio), color="black", ls="--", lw=0.8, label="closed form")
    axes.set_xscale("log")
    axes.set_title(f"{case}: w'/w = {ratio:g}, T = {thresholds[0]}, {thresholds[1]}", fontsize=8)
    if case == "A":
        axes.legend(loc="upper left", frameon=False, fontsize=6)


def _near_transition(axes: Axes, case: str, runs: Sequence[Row], theory: Sequence[Row]) -> None:
    """Draw runs from both sides and theories against w: current over the paper's, or chi."""
    ratio, thresholds = NEAR[case]
    key = "over_paper" if case == "E" else "chi"
    for at, model in enumerate((*ASKED, WALKERS)):
        own = sorted((row for row in theory if row["circuit"] == case and row["model"] == model),
                     key=lambda row: row["w"])  # fmt: skip
        axes.plot([row["w"] for row in own], [row[key] for row in own],
                  f"{'-' if model != WALKERS else ''}{'_.*sx'[at]}", color=f"C{at + 2}",
                  lw=1.0, ms=5, label=model)  # fmt: skip
    for start, mark, shift in (("window", "v", 0.8), ("even", "^", 1.25)):
        own = [row for row in runs if row["circuit"] == case and row["start"] == start]
        bars(axes, own, [shift * row["w"] for row in own], key, fmt=mark, ms=4, color="black",
             mfc="none", capsize=2, ls="none", label=f"runs from {start}")  # fmt: skip
    axes.set(xscale="log", xlim=(6e-4, 0.3), ylim=(0.65, 1.03) if case == "E" else (-0.05, 0.65))
    axes.set_ylabel("R" if case == "E" else "chi", labelpad=1)
    axes.set_title(f"{case}: w'/w = {ratio:g}, T = {thresholds[0]}, {thresholds[1]}", fontsize=8)
    if case == "F":
        axes.legend(loc=(0.02, 0.1), frameon=False, fontsize=5.5, labelspacing=0.1)


PARTS = {
    "runs": runs, "near": near, "narrower": narrower, "visits": visits_and_limits,
    "theories": theories, "comparison": comparison, "limits": limits, "picture": picture,
}  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, PARTS))

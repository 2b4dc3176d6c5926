"""Errors of each model on the map of T and w': tables and picture of the page in this folder.

Runs map.nml and the same map by engines that are models, and computes the theories
at each point. Quick: three thresholds, runs of a tenth of the length. --full: about twenty minutes
of a core. `postproc.advise` has a copy of the table, columns and models that it needs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import f90nml
import numpy as np

import postproc
from postproc.figures import style
from postproc.theory.models import MODELS
from studies.accuracy import ladder

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from studies.common.study import Study

POLARISED = 0.3  # chi above which a state is called so
BOUNDS = (0.01, 0.03, 0.1)
COLOURS = ("tab:green", "gold", "tab:orange", "tab:red")
QUICK = (4, 10, 16)  # thresholds of quick runs
# changes of the map for an engine: a fixed step costs a hundred times as much
COARSE = {"threshold": [4, 6, 8, 10, 12, 14, 16], "replicas": 1}
LENGTHS = {
    "reservoir": ({}, {"replicas": 4}),
    "timestep 0.01": ({"duration": 4000.0, "transient_duration": 2000.0}, COARSE),
    "timestep 0.003": ({"duration": 4000.0, "transient_duration": 2000.0}, COARSE),
}

Points = dict[tuple[int, float], tuple[float, float]]


def run_map(work: Study, engine: str | None = None) -> Path:
    """Run the map, by an engine of the ladder if one is named; return its results file."""
    groups = f90nml.read(work.place / "map.nml").todict()
    name, run, scan = "map", {}, {}
    if engine is not None:
        rung = next(one for one in ladder.RUNGS if one.name == engine)
        length, scan = LENGTHS[engine]
        name, run = f"map_{ladder.stem(rung)}", ladder.engine_keys(rung) | length
    if not work.full:
        whole = groups["run"] | run
        run |= {key: 0.1 * whole[key] for key in ("duration", "transient_duration")}
        scan = scan | {"threshold": [*QUICK]}
    return work.run(groups, name, {"run": groups["run"] | run, "scan": groups["scan"] | scan})


def of_runs(file: Path) -> list[Points]:
    """Return chi and current over chi by (T, w'), and the standard errors of both."""
    data = postproc.open_results(file).stack(point=("threshold", "channel2_width"))
    runs = (data[name].transpose("point", "replica").to_numpy()
            for name in ("chi", "polarised_current"))  # fmt: skip
    places = [(int(threshold), float(width)) for threshold, width in data.point.to_numpy()]
    chi, share, *errors = (one.tolist() for one in ladder.shares(*runs))
    return [dict(zip(places, zip(*both, strict=True), strict=True))
            for both in ((chi, share), errors)]  # fmt: skip


def of_theory(model: str, points: list[tuple[int, float]]) -> Points:
    """Return chi and current over chi of the most polarised stable state; chi 0: there is none."""
    found = {}
    for at in points:
        circuit = replace(ladder.BATTERY, threshold=at[0], channel2_width=at[1])
        state = MODELS[model].stable_state(circuit)
        chi, current = (state.mass_spread, state.net_current) if state else (0.0, 0.0)
        found[at] = chi, abs(current) / chi if chi > 0.0 else math.nan
    return found


def transition(means: Points, width: float) -> float:
    """Return the T at which chi falls through 0.3 at a w'; NaN: it does not."""
    thresholds = sorted(at[0] for at in means if at[1] == width)
    return ladder.transition(thresholds, [means[one, width][0] for one in thresholds])


def rows_of(
    truth: Points, errors: Points, answers: dict[str, Points]
) -> list[dict[str, float | str]]:
    """Return a row for each model and point with a result of the model."""
    found = []
    for model, theirs in answers.items():
        for at, (chi, share) in theirs.items():
            spread, conductance = truth[at]
            both = spread > POLARISED and chi > POLARISED
            falls, fall = transition(truth, at[1]), transition(theirs, at[1])
            found.append({
                "T": at[0], "w2": at[1], "model": model, "chi": spread,
                "chi_error": errors[at][0], "current_over_chi": conductance,
                "current_over_chi_error": errors[at][1], "model_chi": chi,
                "off_chi": chi / spread - 1.0 if both else math.nan,
                "off_share": share / conductance - 1.0 if both else math.nan,
                "other_state": int((chi > POLARISED) != (spread > POLARISED)),
                "transition": falls, "off_transition": fall / falls - 1.0,
            })  # fmt: skip
    return found


def colour(off: float) -> str:
    """Return the colour of an error; NaN: the last one, for errors beyond the scale."""
    return COLOURS[int(np.searchsorted(BOUNDS, abs(off)))] if math.isfinite(off) else COLOURS[-1]


def figure(rows: list[dict[str, float | str]]) -> Figure:
    """Return a panel for each model and quantity; a cross: model and runs have different phases."""
    models = list(dict.fromkeys(row["model"] for row in rows))
    made = style.figure(1.55 * len(models), 8.0)
    panels = made.subplots(3, len(models), sharex=True, sharey=True)
    made.get_layout_engine().set(w_pad=0.06)
    widths = sorted({row["w2"] for row in rows})
    for column, model in enumerate(models):
        own = [row for row in rows if row["model"] == model]
        for axes, quantity in zip(panels[:2, column], ("off_chi", "off_share"), strict=True):
            for row in own:
                at, off = (widths.index(row["w2"]), row["T"]), row[quantity]
                if row["other_state"]:
                    axes.plot(*at, "x", color="black", ms=6)
                elif math.isnan(off):
                    axes.plot(*at, ".", color="0.75", ms=4)
                else:
                    axes.plot(*at, "s", color=colour(off), ms=7)
        for row in {row["w2"]: row for row in own}.values():
            at, falls, off = widths.index(row["w2"]), row["transition"], row["off_transition"]
            panels[2, column].plot(at, falls, "o", color=colour(off), ms=8)
            if math.isfinite(off):
                panels[2, column].plot(at, falls * (1.0 + off), "_", color="black", ms=10)
        panels[0, column].set_title(model, fontsize=9)
        panels[2, column].set_xticks(range(len(widths)), [f"{one:g}" for one in widths],
                                     fontsize=7, rotation=90)  # fmt: skip
        panels[2, column].set_xlim(-0.6, len(widths) - 0.4)
        panels[2, column].set_xlabel("w'")
    panels[0, 0].set_yticks(range(4, 20, 2))
    for axes, word in zip(panels[:, 0], ("chi", "current over chi", "transition"), strict=True):
        axes.set_ylabel(f"{word}: T")
    words = ("below 1 %", "1 to 3 %", "3 to 10 %", "above 10 %")
    for one, word in zip(COLOURS, words, strict=True):
        panels[0, 0].plot([], [], "s", color=one, label=word)
    panels[0, 0].plot([], [], "x", color="black", label="polarised in one of both only")
    panels[0, 0].plot([], [], ".", color="0.75", label="not polarised in either")
    panels[0, 0].plot([], [], "o", color="0.5", label="runs' transition")
    panels[0, 0].plot([], [], "_", color="black", label="the model's")
    made.legend(loc="outside upper center", ncols=8, fontsize=7)
    return made


def table(rows: list[dict[str, float | str]]) -> list[str]:
    """Return lines of a table: number of points at which each model is within the bounds."""
    lines = []
    for model in dict.fromkeys(row["model"] for row in rows):
        own = [row for row in rows if row["model"] == model]
        cells = []
        for quantity in ("off_chi", "off_share", "off_transition"):
            rest = {row["w2"]: row for row in own}.values() if "trans" in quantity else own
            sizes = [abs(row[quantity]) for row in rest]
            within = ", ".join(str(sum(one <= bound for one in sizes)) for bound in BOUNDS)
            known = len(sizes) if "trans" in quantity else sum(map(math.isfinite, sizes))
            cells.append(f"{within} of {known}")
        cells.append(str(sum(row["other_state"] for row in own)))
        lines.append(f"| {model} | {' | '.join(cells)} |")
    return lines


def run(work: Study) -> None:
    """Make the table and the picture of the page; print the numbers of points within bounds."""
    truth, errors = of_runs(run_map(work))
    answers = {name: of_theory(name, [*truth]) for name in ladder.THEORIES}
    answers |= {name: of_runs(run_map(work, name))[0] for name in LENGTHS}
    rows = rows_of(truth, errors, answers)
    work.rows("where_models_fail", rows)
    work.draw(figure(rows), "where_models_fail")
    print(*table(rows), sep="\n")

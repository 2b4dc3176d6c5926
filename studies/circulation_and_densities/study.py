"""Whether circulation changes the numbers in the urns: tables and picture of the page.

chi and net current of runs against the theory `direction`, alone and with the change that
circulation makes in the balance of `two_port` (acting_back.py). Points of two other pages, whose
tables are read, and new ones, densities.nml with other circuits. Quick: 5e3 time units each.
--full: 1e5.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc import study
from postproc.figures import style
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS
from studies.circulation_and_densities.acting_back import solved

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    Row = dict[str, float | str]

STUDIES = Path(__file__).parents[1]
LOAD = 300.0  # N w
TRANSIENT = 20000.0


@dataclass(frozen=True)
class Case:
    """A circuit with N w = 300 and r = l = 1."""

    thresholds: tuple[int, int]
    width: float
    channel2_width: float
    channel2_length: float = 1.0

    @property
    def number(self) -> int:
        """N."""
        return round(LOAD / self.width)

    @property
    def circuit(self) -> Circuit:
        """The circuit for theories."""
        one, two = self.thresholds
        return Circuit(self.number, one, self.width, self.channel2_width,
                       channel2_length=self.channel2_length,
                       gate2_threshold=None if one == two else two)  # fmt: skip

    @property
    def label(self) -> str:
        """Its name in tables."""
        one, two = self.thresholds
        gates = f"T = {one}" if one == two else f"T = {one} and {two}"
        widths = f"w = {self.width:g}, w' = {self.channel2_width:g}"
        return f"{gates}, {widths}, l' = {self.channel2_length:g}"


NEW = (
    Case((12, 12), 0.3, 0.05), Case((10, 10), 0.3, 0.08), Case((12, 12), 0.3, 0.0612, 0.25),
    Case((12, 12), 0.3, 0.0612, 4.0), Case((4, 40), 0.2, 0.12), Case((4, 40), 0.15, 0.15),
)  # fmt: skip


def predicted(case: Case, age: float) -> Row:
    """Return chi and net current of `direction`, and their changes by circulation in the balance.

    The current of `direction` includes circulation at the age; its change is the difference to the
    solution with circulation in the balance.
    """
    model = MODELS["direction"]
    circuit = model.of(case.circuit)
    state = max(model.solve_stable(circuit), key=lambda one: one.mass_spread)
    current = abs(model.by_age(circuit, [age])[0]["net_current"])
    ports = MODELS["two_port"]
    added = abs(ports.by_age(ports.of(case.circuit), [age])[0]["net_current"])
    without, acting = solved(case.circuit, age)
    return {
        "number1": case.number - state.urn2_number, "direction_chi": state.mass_spread,
        "chi_change": acting.mass_spread - without.mass_spread, "direction_current": current,
        "current_change": abs(acting.net_current) - added,
    }  # fmt: skip


def measured(work: study.Study, at: int, case: Case, number1: float) -> Row:
    """Run a new circuit; return means over replicas with errors, and whether polarity changed."""
    changes = {
        "table": {"channel1_width": case.width, "channel2_width": case.channel2_width,
                  "channel2_length": case.channel2_length},
        "particles": {"number": case.number, "urn1_number": round(number1)},
        "gate": {"threshold": case.thresholds},
        "run": {"transient_duration": TRANSIENT,
                "duration": TRANSIENT + work.pick(5e3, 1e5)},
    }  # fmt: skip
    data = postproc.open_results(work.run("densities", f"new_{at}", changes)).squeeze()
    currents = abs(data.current2), data.polarised_current
    constant = bool((currents[0] > 0.99 * currents[1]).all())
    found: Row = {"polarity": "kept" if constant else "changed"}
    for name, values in (("chi", data.chi), ("current", data.current2)):
        own = np.abs(values.to_numpy())
        found |= {name: own.mean(), f"{name}_error": own.std(ddof=1) / math.sqrt(own.size)}
    return found


def known() -> list[tuple[Case, float, Row]]:
    """Return circuits of other pages, the age of their runs, and their results."""
    found = []
    with (STUDIES / "age_of_a_run/results.csv").open(encoding="utf-8") as file:
        rows = {row["point"]: row for row in csv.DictReader(file)}.values()  # the last of each
    for row in rows:
        case = Case((int(row["T"]),) * 2, 0.3, float(row["w2"]))
        found.append((case, math.sqrt(float(row["from"]) * float(row["to"])), row))
    with (STUDIES / "narrow_channels/results.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            width = float(row["w"])
            if row["chi"]:
                age = max(50.0 / width**3, 1e4) + float(row["time"]) / 8.0  # of 4 replicas
                case = Case((int(row["T1"]), int(row["T2"])), width, float(row["ratio"]) * width)
                found.append((case, age, row))
    names = ("chi", "chi_error", "current", "current_error")
    return [(case, age, {"polarity": "kept", **{name: float(row[name]) for name in names}})
            for case, age, row in found]  # fmt: skip


def rows_of(work: study.Study) -> list[Row]:
    """Return a row for each circuit: known, then new."""
    rows = [{"circuit": case.label, "runs": "known", **predicted(case, age), **seen}
            for case, age, seen in known()]  # fmt: skip
    for at, case in enumerate(NEW):
        theory = predicted(case, TRANSIENT + 0.5 * work.pick(5e3, 1e5))
        seen = measured(work, at, case, float(theory["number1"]))
        rows.append({"circuit": case.label, "runs": "new", **theory, **seen})
    return rows


def figure(rows: list[Row]) -> Figure:
    """Return differences of runs of constant polarity from `direction`, against the change."""
    made = style.figure(style.PAGE, 3.4)
    panels = (("chi", 1e3, "chi, in 0.001"), ("current", 1e2, "current, in per cent"))
    for axes, (name, unit, title) in zip(made.subplots(1, 2), panels, strict=True):
        for kind, mark in (("known", "o"), ("new", "s")):
            own = [row for row in rows if row["runs"] == kind and row["polarity"] == "kept"]
            whole = [1.0 if name == "chi" else row["direction_current"] for row in own]
            change, error, seen, theory = (
                np.array([unit * row[key] / by for row, by in zip(own, whole, strict=True)])
                for key in (f"{name}_change", f"{name}_error", name, f"direction_{name}")
            )
            axes.errorbar(change, seen - theory, error, fmt=mark, ms=4.0, lw=0.8, mfc="none",
                          label=f"{kind} runs")  # fmt: skip
        axes.axhline(0.0, color="black", lw=0.8, ls=":")
        axes.axline((0.0, 0.0), slope=1.0, color="black", lw=0.8)
        axes.set(xlabel=f"change by circulation: {title}", ylabel="runs less direction")
        axes.locator_params(axis="x", nbins=5)
        axes.legend(fontsize=7, frameon=False)
    return made


def run(work: study.Study) -> None:
    """Make all tables and pictures of the page."""
    rows = rows_of(work)
    work.table("densities", list(rows[0]), [[_text(one) for one in row.values()] for row in rows])
    work.draw(figure(rows), "circulation_and_densities")


def _text(value: float | str) -> str:
    return f"{value:.5g}" if isinstance(value, float) else value


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

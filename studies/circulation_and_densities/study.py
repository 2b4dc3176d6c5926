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
from postproc.theory import circulation, direction, ports, two_port
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS
from studies.circulation_and_densities.acting_back import most_polarised, solved
from studies.common.theories import THEORIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Row = dict[str, float | str]

STUDIES = Path(__file__).parents[1]
LOAD = 300.0  # N w
TRANSIENT = 20000.0
LARGE = 0.0005  # change of chi above which circuits are counted apart: chosen after the runs


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
        """The circuit as theories take it."""
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


def mean_of(values: list[float]) -> tuple[float, float]:
    """Return mean and standard error over draws."""
    return float(np.mean(values)), float(np.std(values, ddof=1) / math.sqrt(len(values)))


def predicted(case: Case, age: float, draws: int) -> Row:
    """Return chi and net current of `direction`, and how much circulation in the balance changes.

    The current of `direction` has circulation, at the age, added; its change is what remains if the
    balance is solved with it. Means over sets of particles that theory follows, with errors.
    """
    circuit = MODELS["direction"].of(case.circuit)
    held = direction.most_polarised(circuit)
    seeds, number = range(circulation.FIRST, circulation.FIRST + draws), float(circuit.number)
    currents = [
        abs(held.net_current + float(direction.around(circuit, held, age, seed=seed)[0]))
        for seed in seeds
    ]
    circuit = THEORIES["two_port"].of(case.circuit)
    state = most_polarised(circuit)
    straight = two_port.straight_at(circuit, state.urn2_number)
    rest, urns = state.net_current - state.circulating_current, [*map(ports.disc, circuit.sides)]
    without, acting = solved(case.circuit, age, draws)
    changes = []
    for seed, one in zip(seeds, acting, strict=True):
        straight.seed = seed
        around = float(circulation.carried(straight, circuit, urns, age)[0])
        changes.append(abs(one.net_current) - abs(rest + around))
    second = float(held.in_half[1])
    row: Row = {"number1": number - second, "direction_chi": abs(2.0 * second - number) / number}
    for name, values in (
        ("chi_change", [one.mass_spread - without.mass_spread for one in acting]),
        ("direction_current", currents), ("current_change", changes),
    ):  # fmt: skip
        row |= dict(zip((name, f"{name}_error"), mean_of(values), strict=True))
    return row


def measured(work: study.Study, at: int, case: Case, number1: float) -> Row:
    """Run a new circuit; return means over replicas with errors, and whether polarity was kept."""
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
    kept = bool((currents[0] > 0.99 * currents[1]).all())
    found: Row = {"polarity": "kept" if kept else "changed"}
    for name, values in (("chi", data.chi), ("current", data.current2)):
        own = np.abs(values.to_numpy())
        found |= {name: own.mean(), f"{name}_error": own.std(ddof=1) / math.sqrt(own.size)}
    return found


def known() -> list[tuple[Case, float, Row]]:
    """Return circuits of other pages, the age of their runs, and what these have."""
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


def told(work: study.Study, name: str, case: Case, age: float) -> Row:
    """Return `predicted`, made now or kept from before."""
    if work.kept(name) is None or work.afresh:
        work.keep(name, predicted(case, age, int(work.pick(3, 8))))
    return work.kept(name)


def rows_of(work: study.Study) -> list[Row]:
    """Return a row for each circuit: known, then new."""
    rows = [{"circuit": case.label, "runs": "known", **told(work, f"known_{at}", case, age), **seen}
            for at, (case, age, seen) in enumerate(known())]  # fmt: skip
    for at, case in enumerate(NEW):
        said = told(work, f"told_{at}", case, TRANSIENT + 0.5 * work.pick(5e3, 1e5))
        seen = measured(work, at, case, float(said["number1"]))
        rows.append({"circuit": case.label, "runs": "new", **said, **seen})
    return rows


def summary(rows: list[Row]) -> list[Row]:
    """Return how far theory is from runs that kept their polarity, in several selections.

    Of chi and of the relative current: root mean square of what `direction` lacks, before and after
    the change; where it is nearer, and has the right sign; the sum of squares in errors of runs.
    """
    kept = [row for row in rows if row["polarity"] == "kept"]
    large = [row for row in kept if abs(row["chi_change"]) > LARGE]
    chosen = {
        "new": [row for row in kept if row["runs"] == "new"],
        f"change above {LARGE}": large,
        f"known, change above {LARGE}": [row for row in large if row["runs"] == "known"],
        f"change below {LARGE}": [row for row in kept if row not in large],
        "all": kept,
    }
    found = []
    for name, own in chosen.items():
        if not own:
            continue
        for what in ("chi", "current"):
            whole = np.array([1.0 if what == "chi" else row["direction_current"] for row in own])
            seen, said, change, error = (
                np.array([row[key] for row in own]) / whole
                for key in (what, f"direction_{what}", f"{what}_change", f"{what}_error")
            )
            before, after = seen - said, seen - said - change
            found.append({
                "circuits": name, "of": what, "number": str(len(own)),
                "rms_before": _rms(before), "rms_after": _rms(after),
                "nearer": str(np.count_nonzero(np.abs(after) < np.abs(before))),
                "sign": str(np.count_nonzero(before * change > 0.0)),
                "squares_before": float(((before / error) ** 2).sum()),
                "squares_after": float(((after / error) ** 2).sum()),
            })  # fmt: skip
    return found


def _rms(values: NDArray[np.float64]) -> float:
    return math.sqrt(float((values**2).mean()))


def figure(rows: list[Row]) -> Figure:
    """Return how far runs that kept their polarity are from `direction`, against the change."""
    made = style.figure(style.PAGE, 3.8)
    panels = (("chi", 1e3, "chi (0.001)"), ("current", 1e2, "current (%)"))
    for axes, (name, unit, title) in zip(made.subplots(1, 2), panels, strict=True):
        ends = []
        for kind, mark in (("known", "o"), ("new", "s")):
            own = [row for row in rows if row["runs"] == kind and row["polarity"] == "kept"]
            whole = [1.0 if name == "chi" else row["direction_current"] for row in own]
            change, off, error, seen, said = (
                np.array([unit * row[key] / by for row, by in zip(own, whole, strict=True)])
                for key in (f"{name}_change", f"{name}_change_error", f"{name}_error", name,
                            f"direction_{name}")
            )  # fmt: skip
            axes.errorbar(change, seen - said, error, off, fmt=mark, ms=4.0, lw=0.8, mfc="none",
                          label=f"{kind} runs")  # fmt: skip
            ends += [*change, *(seen - said - error), *(seen - said + error)]
        least, most = min(ends) - 0.04 * np.ptp(ends), max(ends) + 0.04 * np.ptp(ends)
        axes.axhline(0.0, color="black", lw=0.8, ls=":", label="direction")
        axes.axline((0.0, 0.0), slope=1.0, color="black", lw=0.8, label="changed")
        axes.set(xlabel=f"change by circulation: {title}", ylabel=f"runs less direction: {title}",
                 xlim=(least, most), ylim=(least, most), aspect="equal")  # fmt: skip
        axes.locator_params(nbins=6)
        axes.legend(fontsize=7, frameon=False, loc="upper left")
    return made


def run(work: study.Study) -> None:
    """Make everything of the page."""
    rows = rows_of(work)
    work.table("densities", list(rows[0]), [[_text(one) for one in row.values()] for row in rows])
    found = summary(rows)
    work.table("summary", list(found[0]), [[_text(one) for one in row.values()] for row in found])
    work.draw(figure(rows), "circulation_and_densities")


def _text(value: float | str) -> str:
    return f"{value:.5g}" if isinstance(value, float) else value


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

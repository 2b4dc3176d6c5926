"""Rates at which circulations begin and end, and their current: tables and picture of the page.

Event logs of nine circuits, around T = 7, w' = 0.01, l' = 1, against the theory of circulation
(postproc/theory/circulation.py). Quick: one log of 3e4 time units each, two minutes of a core.
--full: eight of 1e5, fifteen minutes.
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
from postproc.theory import two_port
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS
from studies.circulations import TRANSIENT, circulations
from studies.event_log import circuit_of, particle_events, read_log

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.theory.circulation import Straight
    from postproc.theory.states import State

    Floats = NDArray[np.float64]
    Row = dict[str, float | str]

ROUNDS = 2 ** np.arange(9)  # at which circulations are counted
AGES, WIDTHS = (Path(__file__).parents[1] / f"{one}/results.csv"
                for one in ("age_of_a_run", "narrow_channels"))  # fmt: skip


@dataclass(frozen=True)
class Case:
    """Parameters of a circuit besides N = 1000, w = 0.3, r = l = 1."""

    threshold: int = 7
    channel2_width: float = 0.01
    channel2_length: float = 1.0

    @property
    def circuit(self) -> Circuit:
        """The circuit for `two_port`."""
        return MODELS["two_port"].of(
            Circuit(1000, self.threshold, channel2_width=self.channel2_width,
                    channel2_length=self.channel2_length)
        )  # fmt: skip

    @property
    def label(self) -> str:
        """Its name in tables."""
        return f"T = {self.threshold}, w' = {self.channel2_width:g}, l' = {self.channel2_length:g}"


CASES = (
    Case(), Case(threshold=5), Case(threshold=10), Case(channel2_width=0.003),
    Case(channel2_width=0.03), Case(channel2_length=0.5), Case(channel2_length=2.0),
    Case(channel2_length=0.25), Case(channel2_length=4.0),
)  # fmt: skip


def state_of(circuit: Circuit, model: str = "two_port") -> State:
    """Return the most polarised stable state by a model."""
    return max(MODELS[model].solve_stable(circuit), key=lambda one: one.mass_spread)


def reached(straight: Straight) -> Floats:
    """Return the rate at which passages from urn 2 to 1 are the m-th round, for m of `ROUNDS`.

    A round is a path from the middle of channel 1 through urn 2 and channel 2 without a wall hit in
    an urn, as in event logs: after a reversal by a gate the count begins again.
    """
    rates = np.zeros(ROUNDS[-1] + 1)
    for start in (0, 1):
        draw = np.random.default_rng(1)
        place, slope, _, weights = straight.begun(start, draw)
        for origin, first in ((weights[0] + weights[1], 0), (weights[2], 1)):
            if first == 1 and start == 1:
                rates[1] += origin.sum()
            made = np.full(slope.size, first)
            draw = np.random.default_rng(2)
            for _, _, left, urn, through in straight.rounds(start, place, slope, draw):
                made[left] = np.where(through, made[left] + 1, 0)
                down = left[(urn == 1) & (made[left] < rates.size)]
                rates += np.bincount(made[down], origin[down], rates.size)
    return rates[ROUNDS]


def measured(work: study.Study, at: int, case: Case) -> tuple[Floats, Floats]:
    """Return the rate of passages that are the m-th round in event logs, with errors."""
    logs, end = int(work.pick(1, 8)), work.pick(3e4, 1e5)
    number = round(1000.0 - state_of(case.circuit).urn2_number)
    counts = np.zeros((logs, ROUNDS.size))
    for seed in range(logs):
        changes = {
            "table": {"channel2_width": case.channel2_width,
                      "channel2_length": case.channel2_length},
            "gate": {"threshold": case.threshold},
            "particles": {"seed": 2820 + seed, "urn1_number": number},
            "run": {"duration": end},
        }  # fmt: skip
        path = work.run("circuit", f"case_{at}_{seed}", changes, alone=True)
        events = particle_events(read_log(path))
        found = circulations(events, circuit_of(postproc.open_results(path)))
        rounds = found.rounds[found.sign == 1]
        counts[seed] = [np.count_nonzero(rounds == m) for m in ROUNDS]
        path.unlink()
    total = counts.sum(axis=0)
    duration = logs * (end - TRANSIENT)
    return total / duration, np.sqrt(np.maximum(total, 1.0)) / duration


def rates(work: study.Study) -> list[Row]:
    """Return a row for each circuit and number of rounds."""
    rows: list[Row] = []
    for at, case in enumerate(CASES):
        stored = work.kept(f"rates_{at}")
        if stored is None or work.afresh:
            seen, error = measured(work, at, case)
            stored = {"seen": list(seen), "error": list(error)}
            work.keep(f"rates_{at}", stored)
        expected = reached(two_port.straight_at(case.circuit, state_of(case.circuit).urn2_number))
        rows += [
            {"circuit": case.label, "rounds": str(m), "measured": one, "error": other, "theory": it}
            for m, one, other, it in zip(
                ROUNDS, stored["seen"], stored["error"], expected, strict=True
            )
        ]
    return rows


def theory_by_age(circuit: Circuit, ages: list[float]) -> list[Row]:
    """Return absolute currents of `direction` at each age, and without circulation."""
    state = state_of(circuit, "direction")
    rest = abs(state.net_current - (state.circulating_current or 0.0))
    return [{"theory": abs(one["net_current"]), "without": rest}
            for one in MODELS["direction"].by_age(circuit, ages)]  # fmt: skip


def by_age() -> list[Row]:
    """Return currents of *The age of a run* with those of theory at the age.

    Theory: `direction` without circulation, and with circulation at the age.
    """
    rows: list[Row] = []
    with AGES.open(encoding="utf-8") as file:
        table = [*csv.DictReader(file)]
    for threshold in dict.fromkeys(row["T"] for row in table):
        own = [row for row in table if row["T"] == threshold]
        circuit = Case(int(threshold), float(own[0]["w2"])).circuit
        ages = [math.sqrt(float(row["from"]) * float(row["to"])) for row in own]
        rows += [{
            "T": threshold, "w'": row["w2"], "from": float(row["from"]), "to": float(row["to"]),
            "current": float(row["current"]), "error": float(row["current_error"]), **predicted,
        } for row, predicted in zip(own, theory_by_age(circuit, ages), strict=True)]  # fmt: skip
    return rows


def by_width() -> list[Row]:
    """Return currents of *The limit of narrow channels* with those of theory at their age."""
    rows: list[Row] = []
    with WIDTHS.open(encoding="utf-8") as file:
        table = [row for row in csv.DictReader(file) if row["current"]]
    for row in table:
        width, (one, other) = float(row["w"]), (int(row[key]) for key in ("T1", "T2"))
        circuit = MODELS["direction"].of(
            Circuit(int(row["N"]), one, width, channel2_width=float(row["ratio"]) * width,
                    gate2_threshold=None if one == other else other)
        )  # fmt: skip
        age = max(50.0 / width**3, 1e4) + 0.5 * float(row["time"]) / 4.0  # 4 replicas
        rows.append({
            "circuit": row["circuit"], "w": row["w"], "age": age,
            "current": float(row["current"]), "error": float(row["current_error"]),
            **theory_by_age(circuit, [age])[0],
        })  # fmt: skip
    return rows


def figure(rates: list[Row], ages: list[Row], widths: list[Row]) -> Figure:
    """Return rates of rounds over theory; currents by age; currents by width over theory."""
    made = style.figure(style.PAGE, 3.4)
    reached, aged, wide = made.subplots(1, 3)
    for at, case in enumerate(CASES):
        own = [row for row in rates if row["circuit"] == case.label
               and row["measured"] > 4.0 * row["error"]]  # fmt: skip
        rounds = np.array([float(row["rounds"]) for row in own]) * 1.05 ** (at - 4)
        ratio = [row["measured"] / row["theory"] for row in own]
        error = [row["error"] / row["theory"] for row in own]
        reached.errorbar(rounds, ratio, error, fmt="osD^v<>ph"[at], ms=3.5, lw=0.8, color=f"C{at}",
                         mfc="none", label=case.label)  # fmt: skip
    reached.axhline(1.0, color="black", lw=0.8)
    reached.set(xscale="log", xlabel="round m", ylabel="m-th rounds, measured over theory",
                ylim=(0.0, 2.8))  # fmt: skip
    reached.legend(fontsize=6, frameon=False, loc="upper left")
    for at, threshold in enumerate(dict.fromkeys(row["T"] for row in ages)):
        own = [row for row in ages if row["T"] == threshold]
        age, last = [math.sqrt(row["from"] * row["to"]) for row in own[1:]], own[-1]["theory"]
        aged.errorbar(age, [row["current"] / last for row in own[1:]],
                      [row["error"] / last for row in own[1:]], fmt="osD"[at], ms=3.5, lw=0.8,
                      color=f"C{at}", mfc="none", label=f"T = {threshold}")  # fmt: skip
        aged.plot(age, [row["theory"] / last for row in own[1:]], color=f"C{at}", lw=1.0)
        aged.axhline(own[0]["without"] / last, color=f"C{at}", lw=0.8, ls=":")
    aged.set(xscale="log", xlabel="age of the run", ylabel="current over the theory's last")
    aged.legend(fontsize=6, frameon=False, loc="upper left")
    for at, circuit in enumerate(dict.fromkeys(row["circuit"] for row in widths)):
        own = [row for row in widths if row["circuit"] == circuit]
        width = [float(row["w"]) * 1.03 ** (at - 1.5) for row in own]
        wide.errorbar(width, [row["current"] / row["theory"] for row in own],
                      [row["error"] / row["theory"] for row in own], fmt="osD^"[at], ms=3.5,
                      lw=0.8, color=f"C{at}", mfc="none", label=circuit)  # fmt: skip
        wide.plot(width, [row["without"] / row["theory"] for row in own], ":", color=f"C{at}")
    wide.axhline(1.0, color="black", lw=0.8)
    wide.set(xlabel="w", ylabel="current over theory", xticks=[0.05, 0.1, 0.2, 0.3])
    wide.legend(fontsize=6, frameon=False, ncols=2)
    return made


def run(work: study.Study) -> None:
    """Make all tables and pictures of the page."""
    tables = {"rates": rates(work), "ages": by_age(), "widths": by_width()}
    for name, rows in tables.items():
        work.table(name, list(rows[0]), [[_text(one) for one in row.values()] for row in rows])
    work.draw(figure(**tables), "circulation")


def _text(value: float | str) -> str:
    return f"{value:.4g}" if isinstance(value, float) else value


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

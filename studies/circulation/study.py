"""How circulations begin and end, and the current they carry: tables and picture of the page.

Event logs of nine circuits, around T = 7, w' = 0.01, l' = 1, against particles that theory follows
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
from studies.circulations import TRANSIENT, circulations, steepest, straight_time
from studies.event_log import CROSSING1, CROSSING2, ENTRY, circuit_of, read_log, stories

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.theory.circulation import Straight
    from postproc.theory.states import State
    from studies.event_log import Circuit as Table
    from studies.event_log import Log, Stories

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]
    Logs = dict[str, Floats]
    Row = dict[str, float | str]

ROUNDS = 2 ** np.arange(9)  # at which circulations are counted
LAST = 7  # round up to which fates are told apart
AGES, WIDTHS = (Path(__file__).parents[1] / f"{one}/results.csv"
                for one in ("age_of_a_run", "narrow_channels"))  # fmt: skip


@dataclass(frozen=True)
class Case:
    """What a circuit has besides N = 1000, w = 0.3, r = l = 1."""

    threshold: int = 7
    channel2_width: float = 0.01
    channel2_length: float = 1.0

    @property
    def circuit(self) -> Circuit:
        """The circuit as `two_port` asks for it."""
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


def spread_of(log: Log, at_start: int, end: float) -> tuple[float, float]:
    """Return mean and variance in time of the number in half 1, of which `at_start` began there."""
    crossed = (log.kind == CROSSING1) | (log.kind == CROSSING2)
    time = np.clip(log.time[crossed], TRANSIENT, end)
    number = at_start - np.cumsum(np.where(log.where[crossed] == 12, 1, -1))
    number = np.concatenate([[at_start], number])
    lasting = np.diff(np.concatenate([[TRANSIENT], time, [end]]))
    mean = float(number @ lasting) / lasting.sum()
    return mean, float((number - mean) ** 2 @ lasting) / lasting.sum()


def fates_of(told: Stories, rounds: Integers, circuit: Table) -> Integers:
    """Return the fates of passages from urn 2 to urn 1, round by round, shape (fate, round).

    Rounds: 0 of what has not come straight, 1 ... `LAST`, and all beyond. Fates, of those that are
    known: a wall of urn 1; turned back in gate 1; a wall of urn 2; straight to channel 2 again.
    """
    longest = straight_time(circuit) * math.hypot(1.0, steepest(circuit)) * (1.0 + 1e-9)
    passes = (told.kind == CROSSING2) & (told.where == 21) & (told.time > TRANSIENT)
    passes = np.flatnonzero(passes & (told.after >= 0))
    into = told.after[passes]
    until_entry = longest - 0.5 * circuit.channel1_length
    entered = (told.kind[into] == ENTRY) & (told.where[into] == 1)
    entered &= told.time[into] - told.time[passes] <= until_entry
    turned = entered & np.isfinite(told.turned[into])
    middle = np.where(entered & ~turned, told.after[into], -1)
    last = np.where(middle >= 0, told.after[middle], -1)
    again = (last >= 0) & (told.kind[last] == CROSSING2) & (told.where[last] == 21)
    again &= told.time[last] - told.time[middle] <= longest
    fate = np.select([~entered, turned, ~again], [0, 1, 2], 3)
    known = ~entered | turned | (last >= 0)
    which = np.minimum(rounds[passes], LAST + 1)
    at = np.flatnonzero(known)
    return np.bincount(fate[at] * (LAST + 2) + which[at], minlength=4 * (LAST + 2)).reshape(4, -1)


def measured(work: study.Study, at: int, case: Case) -> Logs:
    """Return what event logs have, by log."""
    logs, end = int(work.pick(1, 8)), work.pick(3e4, 1e5)
    number = round(1000.0 - state_of(case.circuit).urn2_number)
    found = []
    for seed in range(logs):
        changes = {
            "table": {"channel2_width": case.channel2_width,
                      "channel2_length": case.channel2_length},
            "gate": {"threshold": case.threshold},
            "particles": {"seed": 2820 + seed, "urn1_number": number},
            "run": {"duration": end},
        }  # fmt: skip
        path = work.run("circuit", f"case_{at}_{seed}", changes, alone=True)
        log, circuit = read_log(path), circuit_of(postproc.open_results(path))
        told = stories(log)
        one = circulations(told, circuit)
        straight = one.rounds > 0
        fates = fates_of(told, one.all_rounds, circuit)
        found.append({
            "counts": [np.count_nonzero(one.rounds[one.sign == 1] == m) for m in ROUNDS],
            "straight": one.sign[straight].sum() / (end - TRANSIENT),
            "rest": one.sign[~straight].sum() / (end - TRANSIENT),
            "fates": fates.tolist(), "number1": spread_of(log, number, end),
        })  # fmt: skip
        path.unlink()
    return {"duration": end - TRANSIENT,
            **{name: [one[name] for one in found] for name in found[0]}}  # fmt: skip


def logs_of(work: study.Study, at: int) -> Logs:
    """Return what logs of a circuit have, made now or kept from before."""
    kept = work.kept(f"logs_{at}")
    if kept is None or work.afresh:
        work.keep(f"logs_{at}", measured(work, at, CASES[at]))
        kept = work.kept(f"logs_{at}")
    return {name: np.array(one) for name, one in kept.items()}


def rates(work: study.Study) -> list[Row]:
    """Return a row for each circuit and number of rounds."""
    rows: list[Row] = []
    for at, case in enumerate(CASES):
        kept = work.kept(f"rates_{at}")
        if kept is None or work.afresh:
            seen, error = measured(work, at, case)
            kept = {"seen": list(seen), "error": list(error)}
            work.keep(f"rates_{at}", kept)
        expected = reached(two_port.straight_at(case.circuit, state_of(case.circuit).urn2_number))
        rows += [
            {"circuit": case.label, "rounds": str(m), "measured": one, "error": other, "theory": it}
            for m, one, other, it in zip(ROUNDS, kept["seen"], kept["error"], expected, strict=True)
        ]
    return rows


def told(circuit: Circuit, ages: list[float]) -> list[Row]:
    """Return what `direction` has at each age, and without what circulates, by size."""
    state = state_of(circuit, "direction")
    rest = abs(state.net_current - (state.circulating_current or 0.0))
    return [{"theory": abs(one["net_current"]), "without": rest}
            for one in MODELS["direction"].by_age(circuit, ages)]  # fmt: skip


def by_age() -> list[Row]:
    """Return currents of *The age of a run* beside those of theory at the age.

    Theory: `direction` without what circulates, and that at the age.
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
            "current": float(row["current"]), "error": float(row["current_error"]), **said,
        } for row, said in zip(own, told(circuit, ages), strict=True)]  # fmt: skip
    return rows


def by_width() -> list[Row]:
    """Return currents of *The limit of narrow channels* beside those of theory at their age."""
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
            **told(circuit, [age])[0],
        })  # fmt: skip
    return rows


def figure(rates: list[Row], ages: list[Row], widths: list[Row]) -> Figure:
    """Return how often rounds are reached, over theory; currents by age; by width, over theory."""
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
    """Make everything of the page."""
    tables = {"rates": rates(work), "ages": by_age(), "widths": by_width()}
    for name, rows in tables.items():
        work.table(name, list(rows[0]), [[_text(one) for one in row.values()] for row in rows])
    work.draw(figure(**tables), "circulation")


def _text(value: float | str) -> str:
    return f"{value:.4g}" if isinstance(value, float) else value


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

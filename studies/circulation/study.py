"""How circulations begin and end, and the current they carry: tables and picture of the page.

Event logs of nine circuits, around T = 7, w' = 0.01, l' = 1, against particles that theory follows
(postproc/theory/circulation.py), the mean of several sets of them. Quick: one log of 3e4 time units
each, and few sets. --full: eight logs of 1e5, 24 sets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc.figures import style
from postproc.theory import circulation, direction, fate, ports
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS
from studies.common import study, two_port
from studies.common.circulations import (
    TRANSIENT,
    circulations,
    numbers_in_time,
    steepest,
    straight_time,
)
from studies.common.event_log import (
    CROSSING2,
    ENTRY,
    circuit_of,
    particle_events,
    read_log,
)
from studies.common.numbers import bars, mean_of, read_table
from studies.common.theories import THEORIES

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.theory.circulation import Straight
    from postproc.theory.states import State
    from studies.common.event_log import Log, ParticleEvents

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]
    Logs = dict[str, Floats]
    Row = dict[str, float | str]

ROUNDS = 2 ** np.arange(9)  # at which circulations are counted
AGED = ((7, 0.01), (10, 0.0204), (12, 0.0612))  # T, w' of *The age of a run*
EARLY, LATE = (2800.0, 8400.0), (2e4, 1e6)  # ages of runs whose current was to be explained
OPENED = 0.03  # w' of the circuit whose rates are listed apart
NAMES = {"A": "A: 7, 7; 0.03", "B": "B: 4, 40; 0.03", "C": "C: 4, 40; 0.3", "D": "D: 4, 40; 1"}
FEW = 8  # sets of particles that theory draws elsewhere
LAST = 7  # round up to which fates are listed apart
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
        return THEORIES["two_port"].of(
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
    return max(THEORIES[model].solve_stable(circuit), key=lambda one: one.mass_spread)


def spread_of(log: Log, at_start: int, end: float) -> tuple[float, float]:
    """Return mean and variance in time of the number in half 1, of which `at_start` began there."""
    number, lasting = numbers_in_time(log, at_start, end, 21)
    mean = float(number @ lasting) / lasting.sum()
    return mean, float((number - mean) ** 2 @ lasting) / lasting.sum()


def fates_of(events: ParticleEvents, rounds: Integers, circuit: Circuit) -> Integers:
    """Return the fates of passages from urn 2 to urn 1, round by round, shape (fate, round).

    Rounds: 0 of what has not come straight, 1 ... `LAST`, and all beyond. Fates, of those that are
    known: a wall of urn 1; turned back in gate 1; a wall of urn 2; straight to channel 2 again.
    """
    longest = straight_time(circuit) * math.hypot(1.0, steepest(circuit)) * (1.0 + 1e-9)
    passes = (events.kind == CROSSING2) & (events.where == 21) & (events.time > TRANSIENT)
    passes = np.flatnonzero(passes & (events.after >= 0))
    into = events.after[passes]
    until_entry = longest - 0.5 * circuit.channel1_length
    entered = (events.kind[into] == ENTRY) & (events.where[into] == 1)
    entered &= events.time[into] - events.time[passes] <= until_entry
    turned = entered & np.isfinite(events.turned[into])
    middle = np.where(entered & ~turned, events.after[into], -1)
    last = np.where(middle >= 0, events.after[middle], -1)
    again = (last >= 0) & (events.kind[last] == CROSSING2) & (events.where[last] == 21)
    again &= events.time[last] - events.time[middle] <= longest
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
        events = particle_events(log)
        one = circulations(events, circuit)
        straight = one.rounds > 0
        fates = fates_of(events, one.all_rounds, circuit)
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
    return kept(work, f"logs_{at}", lambda: measured(work, at, CASES[at]))


def many(work: study.Study) -> int:
    """Return how many sets of particles theory draws where its error matters."""
    return int(work.pick(FEW, 24))


def kept(work: study.Study, name: str, made: Callable[[], Logs]) -> Logs:
    """Return numbers by name, made now or kept from before."""
    if work.kept(name) is None or work.afresh:
        work.keep(name, {key: np.asarray(one).tolist() for key, one in made().items()})
    return {key: np.array(one) for key, one in work.kept(name).items()}


def reached(straight: Straight) -> Floats:
    """Return how often per unit time a passage is the m-th round, shape (from urn 1 or 2, m).

    A round is a way from the middle of channel 1 through an urn and channel 2, without a bounce, as
    event logs have it: what gates turn back begins anew, at 0, which is not counted.
    """
    size = circulation.ROUNDS + 1
    rates = np.zeros((2, size))
    for start in (0, 1):
        draw = np.random.default_rng(straight.seed)
        place, slope, _, weights = straight.begun(start, draw)
        rates[start, 1] += weights[2].sum()  # that have come through channel 1
        origins = weights[0] + weights[1], weights[2]
        made = np.tile([[0], [1]], slope.size)
        draw = np.random.default_rng([straight.seed, 2])
        for _, _, left, urn, through in straight.rounds(start, place, slope, draw):
            made[:, left] = np.where(through, made[:, left] + 1, 0)
            for origin, rounds in zip(origins, made[:, left], strict=True):
                known = rounds < size
                at = urn[known] * size + rounds[known]
                found = np.bincount(at, origin[left[known]], 2 * size)
                rates += found.reshape(2, size)
    rates[:, 0] = 0.0
    return rates


def by_rounds(rates: Floats, decay: float, rounds: Floats) -> float:
    """Return the mean current by passages of one round and more, of runs of some ages.

    Parameters
    ----------
    rates : as `reached` returns them.
    decay : logarithm by which the sparse gate makes each round less.
    rounds : that have been flown by each age; orbits of more are not filled yet.
    """
    return float(circulation.filled(rates[1] - rates[0], decay, rounds).mean())


def most_polarised(circuit: Circuit) -> direction.Held:
    """Return the circuit held in its most polarised stable state."""
    stable = [held for held, kind in direction.held_states(circuit) if kind == "stable"]
    return max(stable, key=lambda one: abs(one.in_half[1] - one.in_half[0]))


def reversal(circuit: Circuit) -> float:
    """Return the chance to be turned back in gate 1 at the shortest stay, by the cosine law.

    Entries are as many as by `direction`.
    """
    threshold, half = int(circuit.sides[0].threshold), 0.5 * float(circuit.channel1_length)
    entries = float(most_polarised(circuit).entries[0, 0])
    return 1.0 - float(fate.passing(threshold, entries, *fate.cosine_law(half))[0])


def straight_at(circuit: Circuit, number2: float) -> Straight:
    """Return the particles that cross urns without a wall hit at N2 = `number2`."""
    at = two_port.with_number2(circuit, number2)
    return circulation.followed(circuit, at.entries[:, 0], at.across[:, 0])


def predicted_rates(work: study.Study, at: int) -> Logs:
    """Return what theory has of the logs of a circuit, by draw: rates, and current of rounds."""
    case = CASES[at]
    duration = float(logs_of(work, at)["duration"])
    flown = np.linspace(TRANSIENT, TRANSIENT + duration, 200)
    flown = flown / circulation.round_time(case.circuit)
    straight = straight_at(case.circuit, state_of(case.circuit).urn2_number)
    found: dict[str, list[float | Floats]] = {"theory": [], "current": []}
    for draw in range(many(work)):
        straight.seed = circulation.FIRST + draw
        rates = reached(straight)
        found["theory"].append(rates[1, ROUNDS])
        found["current"].append(by_rounds(rates, straight.decay, flown))
    return found | {"reversed": reversal(MODELS["direction"].of(case.circuit))}


def told_currents(circuit: Circuit, ages: Floats, draws: int) -> Logs:
    """Return the net current of `direction` at each age, by draw, and without what circulates."""
    held = most_polarised(circuit)
    flows, urns = (held.entries[:, 0], held.across[:, 0]), [*map(ports.disc, circuit.sides)]
    sign, found = math.copysign(1.0, held.net_current), []
    for draw in range(draws):
        straight = circulation.followed(circuit, *flows, seed=circulation.FIRST + draw)
        around = circulation.carried(straight, circuit, urns, ages)[0]
        found.append(sign * (held.net_current + around))
    return {"current": np.array(found), "without": np.array(abs(held.net_current))}


def rates_of(work: study.Study, at: int) -> Logs:
    """Return `predicted_rates`, made now or kept from before."""
    return kept(work, f"rates_{at}", lambda: predicted_rates(work, at))


def rates(work: study.Study) -> list[Row]:
    """Return a row for each circuit and number of rounds.

    Errors are Poisson's, of the expected counts.
    """
    rows: list[Row] = []
    for at, case in enumerate(CASES):
        logs, theory = logs_of(work, at), rates_of(work, at)
        duration = logs["counts"].shape[0] * float(logs["duration"])
        counts, said = logs["counts"].sum(axis=0), mean_of(theory["theory"])
        rows += [
            {"circuit": case.label, "rounds": str(m), "measured": counts[k] / duration,
             "error": math.sqrt(said[0][k] / duration), "theory": said[0][k],
             "theory_error": said[1][k]}
            for k, m in enumerate(ROUNDS)
        ]  # fmt: skip
    return rows


def pooled(work: study.Study) -> list[Row]:
    """Return counts over theory of all circuits but one, and of that one, by number of rounds.

    Errors of counts are the larger of Poisson's and that over logs, those of theory over draws,
    which all circuits share.
    """
    rows: list[Row] = []
    parts = ("w' = 0.003, 0.01", [k for k, one in enumerate(CASES) if one.channel2_width != OPENED])
    other = (f"w' = {OPENED}", [k for k, one in enumerate(CASES) if one.channel2_width == OPENED])
    for name, chosen in (parts, other):
        logs = [logs_of(work, at) for at in chosen]
        events = [rates_of(work, at) for at in chosen]
        number = logs[0]["counts"].shape[0]
        counts = np.array([one["counts"] for one in logs])
        variance = counts.var(axis=1, ddof=min(1, number - 1)).sum(axis=0) * number
        for k, m in enumerate(ROUNDS):
            row: Row = {"circuits": name, "rounds": str(m), "counts": float(counts[..., k].sum())}
            row["over_poisson"] = variance[k] / max(row["counts"], 1.0)
            expected, error = mean_of(number * float(logs[0]["duration"]) * np.sum(
                [one["theory"][:, k] for one in events], axis=0))  # fmt: skip
            row |= {"theory_counts": expected, "theory_ratio": row["counts"] / expected,
                    "theory_error": math.sqrt(max(variance[k], expected)) / expected,
                    "theory_draws": error / expected}  # fmt: skip
            rows.append(row)
    return rows


def split(work: study.Study) -> list[Row]:
    """Return a row for each circuit: the current by rounds of circulations, and the rest."""
    rows: list[Row] = []
    for at, case in enumerate(CASES):
        logs, events = logs_of(work, at), rates_of(work, at)
        circuit, number = MODELS["direction"].of(case.circuit), many(work) if at == 0 else FEW
        ages = np.linspace(TRANSIENT, TRANSIENT + float(logs["duration"]), 200)
        all_of = kept(work, f"logs_current_{at}", lambda of=circuit, ages=ages, number=number: {
            "mean": told_currents(of, ages, number)["current"].mean(axis=1)})["mean"]  # fmt: skip
        row: Row = {"circuit": case.label}
        seen = {"straight": logs["straight"], "rest": logs["rest"],
                "total": logs["straight"] + logs["rest"]}  # fmt: skip
        straight = events["current"]
        said = {"straight": straight, "rest": all_of - straight[: len(all_of)], "total": all_of}
        for name, values in seen.items():
            row |= dict(zip((name, f"{name}_error"), map(float, mean_of(values)), strict=True))
            names = f"{name}_theory", f"{name}_theory_error"
            row |= dict(zip(names, map(float, mean_of(said[name])), strict=True))
        rows.append(row)
    return rows


def gates(work: study.Study) -> list[Row]:
    """Return a row for each circuit: how often gate 1 reverses what comes straight to it.

    Of all that enter it straight from channel 2; of those that have made rounds; and where these
    end otherwise. The last row is all of T = 7, w' = 0.01.
    """
    rows: list[Row] = []
    usual = CASES[0].threshold, CASES[0].channel2_width
    same = [k for k, one in enumerate(CASES) if (one.threshold, one.channel2_width) == usual]
    for chosen in (*([at] for at in range(len(CASES))), same):
        logs, events = ([of(work, at) for at in chosen] for of in (logs_of, rates_of))
        fates = sum(one["fates"].sum(axis=0) for one in logs)
        entries, rounds = fates[1:].sum(), fates[:, 1:].sum(axis=1)
        weights = [one["fates"][:, 1:].sum() for one in logs]
        first = np.mean([one["number1"].mean(axis=0) for one in logs], axis=0)
        rows.append({
            "circuit": CASES[chosen[0]].label if len(chosen) == 1 else "T = 7, w' = 0.01, all l'",
            "entries": str(entries), "reversed": str(fates[1].sum()),
            "measured": fates[1].sum() / entries,
            "error": math.sqrt(max(fates[1].sum(), 1.0)) / entries,
            "theory": float(np.average([one["reversed"] for one in events], weights=weights)),
            "of_rounds": str(rounds[1:].sum()), "reversed_of_rounds": str(rounds[1]),
            "walls_of_urn_1": str(rounds[0]), "walls_of_urn_2": str(rounds[2]),
            "variance_over_mean_of_number_1": first[1] / first[0],
        })  # fmt: skip
    return rows


def aged(work: study.Study) -> dict[str, Logs]:
    """Return currents by draw at the ages of *The age of a run*, and at others, for each T."""
    found = {}
    for threshold, width in AGED:
        own = [row for row in read_table(AGES) if row["T"] == threshold]
        ages = [math.sqrt(float(row["from"]) * float(row["to"])) for row in own]
        ages += [*np.linspace(*EARLY, 25), *np.linspace(*LATE, 200), math.inf]
        circuit = MODELS["direction"].of(Case(threshold, width).circuit)

        found[str(threshold)] = kept(work, f"aged_{threshold}", lambda of=circuit, ages=ages: (
            told_currents(of, np.array(ages), many(work))))  # fmt: skip
    return found


def by_age(work: study.Study) -> list[Row]:
    """Return currents of *The age of a run* beside those of theory at the age."""
    rows: list[Row] = []
    for threshold, events in aged(work).items():
        own = [row for row in read_table(AGES) if row["T"] == int(threshold)]
        said = mean_of(events["current"])
        rows += [{
            "T": threshold, "w'": row["w2"], "from": float(row["from"]), "to": float(row["to"]),
            "current": float(row["current"]), "error": float(row["current_error"]),
            "theory": said[0][k], "theory_error": said[1][k],
            "without": float(events["without"]),
        } for k, row in enumerate(own)]  # fmt: skip
    return rows


def by_width(work: study.Study) -> list[Row]:
    """Return currents of *The limit of narrow channels* beside those of theory at their age."""
    rows: list[Row] = []
    for at, row in enumerate(one for one in read_table(WIDTHS) if one["current"]):
        width, (one, other) = float(row["w"]), (int(row[key]) for key in ("T1", "T2"))
        circuit = MODELS["direction"].of(
            Circuit(int(row["N"]), one, width, channel2_width=float(row["ratio"]) * width,
                    gate2_threshold=None if one == other else other)
        )  # fmt: skip
        age = max(50.0 / width**3, 1e4) + 0.5 * float(row["time"]) / 4.0  # 4 replicas
        events = kept(work, f"width_{at}", lambda of=circuit, age=age: told_currents(
            of, np.array([age]), int(work.pick(4, 12))))  # fmt: skip
        (theory,), (error,) = mean_of(events["current"])
        seen, off = float(row["current"]), float(row["current_error"])
        around = theory - float(events["without"])
        rows.append({
            "circuit": row["circuit"], "w": row["w"], "age": age, "current": seen, "error": off,
            "theory": theory, "theory_error": error, "without": float(events["without"]),
            "circulating_over_theory": 1.0 + (seen - theory) / around,
            "its_error": math.hypot(off, error * (seen - theory + around) / around) / around,
        })  # fmt: skip
    return rows


def checks(work: study.Study, tables: dict[str, list[Row]]) -> list[Row]:
    """Return what theory was to be checked against, and what else is known of T = 7, w' = 0.01.

    Measured: docs/theory.md#circulation, docs/open_questions.md, studies/experiments, tables here.
    """
    events, rows = aged(work), []
    later = {key: one["current"][:, len(one["current"][0]) - 226 :] for key, one in events.items()}
    eight = next(row for row in tables["rates"]
                 if row["circuit"] == CASES[0].label and row["rounds"] == "8")  # fmt: skip

    def add(name: str, measured: tuple[float, float], theory: tuple[float, float]) -> None:
        off = (theory[0] - measured[0]) / math.hypot(measured[1], theory[1])
        rows.append({"check": name, "measured": measured[0], "error": measured[1],
                     "theory": float(theory[0]), "theory_error": float(theory[1]),
                     "theory_less_measured_in_errors": off})  # fmt: skip

    early, late = (later["7"][:, part].mean(axis=1) for part in (slice(25), slice(25, 225)))
    add("current, age 2800 to 8400, 1200 runs", (1.0043, 0.0012), mean_of(early))
    add("current, age 2800 to 8400, 3000 runs", (1.0048, 0.0008), mean_of(early))
    add("current, runs of 1e6", (1.0168, 0.0013), mean_of(late))
    add("eighth rounds, these logs", (eight["measured"], eight["error"]),
        (eight["theory"], eight["theory_error"]))  # fmt: skip
    add("eighth rounds, other logs", (3.67e-4, 0.24e-4), (eight["theory"], eight["theory_error"]))
    for threshold, width in AGED[:2]:
        own = [row for row in tables["ages"] if row["T"] == str(threshold)]
        first, last = ([row["from"] for row in own].index(one) for one in (1000.0, 10000.0))
        grown = events[str(threshold)]["current"]
        add(f"growth in a decade from 1000 to 1800 on, T = {threshold}, w' = {width}",
            (own[last]["current"] - own[first]["current"],
             math.hypot(own[last]["error"], own[first]["error"])),
            mean_of(grown[:, last] - grown[:, first]))  # fmt: skip
    straight, here = rates_of(work, 0), tables["split"][0]
    for name, words, other in (("straight", "current by rounds", (0.0360, 0.0065)),
                               ("rest", "the rest of the current", (0.9762, 0.0017))):  # fmt: skip
        said = here[f"{name}_theory"], here[f"{name}_theory_error"]
        add(f"{words}, 6 other logs", other, said)
        add(f"{words}, these logs", (here[name], here[f"{name}_error"]), said)
    last = tables["gates"][-1]
    number, rounds = (float(last[name]) for name in ("reversed_of_rounds", "of_rounds"))
    here = number / rounds, math.sqrt(max(number, 1.0)) / rounds
    add("reversed by gate 1 per round, other logs", (1.55e-4, 0.16e-4),
        (float(straight["reversed"]), 0.0))  # fmt: skip
    add("reversed by gate 1 per round, here, all l'", here, (last["theory"], 0.0))
    return rows


def figure(tables: dict[str, list[Row]]) -> Figure:
    """Return rounds over theory; currents by age; parts of currents; circulation by width."""
    made = style.figure(style.PAGE, 6.0)
    (reached, aged), (parts, wide) = made.subplots(2, 2)
    both = dict.fromkeys(row["circuits"] for row in tables["pooled"])
    for at, circuits in enumerate(both):
        own = [row for row in tables["pooled"] if row["circuits"] == circuits
               and row["theory_counts"] > 16.0]  # fmt: skip
        rounds = 1.08 ** (at - 0.5) * np.array([float(row["rounds"]) for row in own])
        bars(reached, own, rounds, "theory_ratio", "theory_error", fmt="os"[at], lw=0.8, mfc="none",
             color=f"C{at}", label=circuits)  # fmt: skip
    reached.axhline(1.0, color="black", lw=0.8)
    reached.set(xscale="log", xlabel="round m", ylabel="m-th rounds, runs over theory",
                ylim=(0.0, 1.5))  # fmt: skip
    reached.legend(fontsize=7, frameon=False, loc="lower left")
    for at, (threshold, width) in enumerate(AGED):
        own = [row for row in tables["ages"] if row["T"] == str(threshold)]
        age = np.array([math.sqrt(max(row["from"], 10.0) * row["to"]) for row in own])
        rest, lines, label = own[0]["without"], {}, f"T = {threshold}, w' = {width}"
        for name in ("current", "error", "theory", "theory_error"):
            values = np.array([row[name] for row in own])
            lines[name] = 100.0 * (values if "error" in name else values - rest) / rest
        aged.errorbar(age, lines["current"], lines["error"], fmt="osD"[at], ms=3.5, lw=0.8,
                      color=f"C{at}", mfc="none", label=label)  # fmt: skip
        ends = (lines["theory"] + sign * lines["theory_error"] for sign in (-1.0, 1.0))
        aged.fill_between(age, *ends, color=f"C{at}", alpha=0.3, lw=0)
        aged.plot(age, lines["theory"], color=f"C{at}", lw=1.0)
    aged.axhline(0.0, color="black", lw=0.8, ls=":")
    aged.set(xscale="log", xlabel="age of the run (r/v)",
             ylabel="current less without, over without (%)")  # fmt: skip
    aged.legend(fontsize=7, frameon=False, loc="lower right")
    names = [row["circuit"] for row in tables["split"]]
    for at, name in enumerate(("straight", "rest", "total")):
        own = [{"off": 100.0 * (row[name] - row[f"{name}_theory"]) / row["total_theory"],
                "error": 100.0 * math.hypot(row[f"{name}_error"], row[f"{name}_theory_error"])
                / row["total_theory"]} for row in tables["split"]]  # fmt: skip
        label = {"straight": "by rounds of circulations"}.get(name, f"the {name}")
        bars(parts, own, np.arange(len(own)) + 0.2 * (at - 1), "off", "error", fmt="os^"[at],
             lw=0.8, mfc="none", color=f"C{at}", label=label)  # fmt: skip
    parts.axhline(0.0, color="black", lw=0.8)
    parts.set_xticks(range(len(names)), [_short(one) for one in names], rotation=35, ha="right",
                     fontsize=7)  # fmt: skip
    parts.set(ylabel="current, runs less theory (% of the total)")
    parts.legend(fontsize=7, frameon=False)
    for at, circuit in enumerate(NAMES):
        own = [row for row in tables["widths"] if row["circuit"] == circuit]
        bars(wide, own, np.array([row["w"] for row in own]) * 1.05 ** (at - 1.5),
             "circulating_over_theory", "its_error", fmt="osD^"[at], lw=0.8, mfc="none",
             color=f"C{at}", label=NAMES[circuit])  # fmt: skip
    wide.axhline(1.0, color="black", lw=0.8)
    wide.set(xscale="log", xlabel="w (r)", ylabel="circulating part, runs over theory",
             ylim=(0.0, 2.2))  # fmt: skip
    wide.set_xticks([0.05, 0.1, 0.2, 0.3], ["0.05", "0.1", "0.2", "0.3"])
    wide.minorticks_off()
    wide.legend(fontsize=7, frameon=False, title="T1, T2; w'/w", title_fontsize=7, ncols=2)
    return made


def _short(label: str) -> str:
    """Return what a circuit has other than the first."""
    usual = CASES[0].label.split(", ")
    return ", ".join(one for one in label.split(", ") if one not in usual) or "reference"


def run(work: study.Study) -> None:
    """Make everything of the page."""
    tables = {"rates": rates(work), "pooled": pooled(work), "split": split(work),
              "gates": gates(work), "ages": by_age(work), "widths": by_width(work)}  # fmt: skip
    tables["checks"] = checks(work, tables)
    for name, rows in tables.items():
        work.rows(name, rows)
    work.draw(figure(tables), "circulation")


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

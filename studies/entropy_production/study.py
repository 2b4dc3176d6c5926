"""Number of pasts of a state: the folding entropy of the gated circuit.

Runs entropy.nml with other N, T and times, into build/entropy_production/quick, or full. Stationary
states and rates are the program's; flights.py continues from its states, and channel.py (channel 1
only, many particles) and pasts.py (the whole state, few particles) compute the pasts. Writes
few.csv, many.csv, deep.csv, checks.csv and entropy_production.png. Quick: some minutes of a core;
--full: as shown on the page. Finished parts are stored; --afresh makes them again.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc import study
from postproc.figures import style
from postproc.study import text
from postproc.theory.renewal import RenewalGate
from studies.entropy_production.channel import Channel
from studies.entropy_production.flights import Start, Table, firings, histories
from studies.entropy_production.pasts import COUNTED, History, Tree, coordinates, turned_start
from studies.event_log import CROSSING1, CROSSING2, ENTRY, REVERSAL, read_log

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from studies.entropy_production.flights import Pass
    from studies.entropy_production.pasts import Backward, Pasts

    Floats = NDArray[np.float64]

TABLE = Table()
FEW = (2, 3, 5, 10, 30)  # N, at T = 1
CHECKED = (2, 3, 5, 10)
MANY = ((100, 1), (200, 2), (300, 2), (300, 3), (1000, 1))  # N, T
DENSE = ((1000, 2), (1000, 4), (1000, 7), (1000, 10))  # too many pasts: only bounds
# N at T = 1, depth, and number of states in full and in quick runs
DEEP = ((3, 8000.0, 60, 20), (10, 800.0, 60, 20), (30, 100.0, 16, 6), (100, 12.0, 20, 10))
DEPTHS = 20  # at which pasts are counted
SHARE_OF_TWO = 0.2732  # of reversals after which a state of two particles has two pasts
TRANSIENT = 2000.0
EDGE = 2.0  # time at both ends of a window, over which logarithms of weights are averaged
LENGTH = 12.0  # of windows
COLLISIONS = 3  # number of states with several pasts that are run forwards again
CHECK_DEPTH = 20.0


def ran(work: study.Study, name: str, number: int, threshold: int, duration: float) -> Path:
    """Run a circuit from near its stationary state by the theory of renewal gates."""
    theory = work.theory("renewal", number=number, threshold=threshold) if number >= 100 else {}
    stable = [one["urn2_number"] for one in theory.get("roots", ()) if one["kind"] == "stable"]
    there = max(stable) if theory.get("homogeneous") == "unstable" else 0.5 * number
    changes = {
        "particles": {"number": number, "urn1_number": number - round(there)},
        "gate": {"threshold": threshold},
        "run": {"duration": duration, "transient_duration": TRANSIENT},
    }
    return work.run("entropy", name, changes, alone=True)


def rates(path: Path, begin: float, end: float) -> dict[str, float]:
    """Return rates between two times from the log: entries, flows through the gates, reversals."""
    log = read_log(path)
    late = (log.time > begin) & (log.time < end)
    kind, where, number = log.kind[late], log.where[late], log.particle[late]
    span = end - begin
    fired = kind == REVERSAL
    found = {"firings": fired.sum() / span, "firings_error": math.sqrt(fired.sum()) / span}
    for gate in (1, 2):
        entered = ((kind == ENTRY) & (where == gate)).sum()
        turned = number[fired & (where == gate)].sum()
        through = ((kind == CROSSING1) & (where == (21 if gate == 1 else 12))).sum()
        found |= {f"entries{gate}": entered / span, f"out{gate}": (turned + through) / span}
    for name, which in (("1", CROSSING1), ("2", CROSSING2)):
        for way in (12, 21):
            found[f"flow{name}_{way}"] = ((kind == which) & (where == way)).sum() / span
    return found


def numbers_in_urns(path: Path) -> tuple[list[Start], int, int]:
    """Return the final state of a run, and the numbers in both urns."""
    end = postproc.open_results(path, group="final").squeeze("replica")
    x, y, ux, uy = (end[name].to_numpy() for name in ("x", "y", "ux", "uy"))
    inside = np.abs(np.abs(x) - 0.5 * TABLE.channel1_length - TABLE.chords[0]) < TABLE.chords[1]
    starts = [TABLE.start(*one) for one in zip(x, y, ux, uy, strict=True)]
    return starts, int((inside & (x < 0.0)).sum()), int((inside & (x > 0.0)).sum())


def folding(
    passes: Sequence[Pass], threshold: int, entries: Sequence[float],
    windows: Sequence[tuple[float, float]], most: int,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the folding entropy per unit time of channel 1 only, its error, and the share lost.

    Each window gives a slope of the logarithm of the weight of all pasts over the true one's,
    between its mean over the first and over the last `EDGE`.
    """
    channel = Channel(passes, threshold, entries)
    slopes, lost = [], 0.0
    for begin, end in windows:
        found = channel.weigh(begin, end, most)
        back = end - found.time
        edge = min(EDGE, 0.1 * (end - begin))
        first, last = (found.log_ratio[part] for part in (
            (back > edge) & (back < 2.0 * edge), back > end - begin - edge))  # fmt: skip
        if end - begin > 100.0:  # long enough that the ends do not matter
            slopes.append(found.log_ratio[-1] / (end - begin))
        else:
            slopes.append((last.mean() - first.mean()) / (end - begin - 2.0 * edge))
        lost = max(lost, found.lost)
    error = np.std(slopes, ddof=1) / math.sqrt(len(slopes))
    return float(np.mean(slopes)), float(error), lost


def few(work: study.Study) -> list[dict[str, float]]:
    """Return reversals and folding entropy of few particles at T = 1, channel 1 only."""
    rows = []
    for number in FEW:
        predicted_rate = 2.0 * number * (number - 1) * (0.25 * math.pi) * (
            TABLE.channel1_width / (math.pi * TABLE.area)) ** 2  # fmt: skip
        duration = round(work.pick(1000.0, 6000.0) / predicted_rate, -2)
        path = ran(work, f"few_{number}", number, 1, duration)
        found = rates(path, 0.0, duration)
        starts, *_ = numbers_in_urns(path)
        span = work.pick(500.0, 3000.0) / predicted_rate
        passes, log = histories(TABLE, 1, starts, span)
        edges = np.linspace(0.02, 1.0, 21) * span
        value, error, lost = folding(
            passes, 1, (1.0, 1.0), list(pairwise(edges)), 10**5
        )
        fired = firings(log) / span
        rows.append({
            "number": number, "foreseen": predicted_rate, **found, "folding": value,
            "folding_error": error, "lost": lost, "a_firing": value / fired,
            "a_firing_error": error / fired, "python_firings": fired,
        })  # fmt: skip
    return rows


def renewal_chain(number: int, threshold: int, urn2: float, area: float) -> float:
    """Return the entropy production of the chain of well mixed urns, at its stationary state."""
    inside = np.array([number - urn2, urn2])
    entries = inside * TABLE.channel1_width / (math.pi * area)
    share = RenewalGate().share(threshold, entries * 0.25 * math.pi * TABLE.channel1_length)
    through, around = entries * share, inside * TABLE.channel2_width / (math.pi * area)
    return float((through[0] - through[1]) * math.log(through[0] / through[1])
                 + (around[1] - around[0]) * math.log(around[1] / around[0]))  # fmt: skip


def many(work: study.Study) -> list[dict[str, float]]:
    """Return the same for many particles, with the entropy production of the net current."""
    rows = []
    for number, threshold in (*MANY, *DENSE):
        end = work.pick(4000.0, 22000.0)
        path = ran(work, f"many_{number}_{threshold}", number, threshold, end)
        row = {"number": number, "threshold": threshold, **rates(path, TRANSIENT, end)}
        chi = float(np.abs(postproc.open_results(path).squeeze().chi))
        starts, *_ = numbers_in_urns(path)
        entries, out = ([row[f"{what}{gate}"] for gate in (1, 2)] for what in ("entries", "out"))
        row["folding"] = row["folding_error"] = row["lost"] = math.nan
        if (number, threshold) in MANY:
            length = LENGTH * (5.0 if number == 100 else 1.0)
            windows = [(2.0 + at * length, 2.0 + (at + 1.0) * length)
                       for at in range(int(work.pick(2, 4)))]  # fmt: skip
            passes, _ = histories(TABLE, threshold, starts, windows[-1][1] + 1.0)
            row["folding"], row["folding_error"], row["lost"] = folding(
                passes, threshold, entries, windows, int(work.pick(150, 300))
            )
        row["current"] = row["flow2_21"] - row["flow2_12"]
        row["bound"] = sum(b * math.log(b) - e * math.log(e)
                           for e, b in zip(entries, out, strict=True))  # fmt: skip
        row["density"] = row["current"] * math.log((1.0 + chi) / (1.0 - chi))
        row["chi"] = chi
        row["flows"] = row["current"] * math.log(row["flow2_21"] / row["flow2_12"])
        theory = work.theory("renewal", number=number, threshold=threshold)
        stable = [one["urn2_number"] for one in theory["roots"] if one["kind"] == "stable"]
        row["chain"] = 0.0
        if theory["homogeneous"] == "unstable":
            row["chain"] = renewal_chain(number, threshold, max(stable), theory["urn_area"])
        rows.append(row)
    return rows


def drawn(random: np.random.Generator, number: int, threshold: int) -> list[Start]:
    """Draw a state from Liouville's measure, of those in which no gate counts more than T."""
    while True:
        starts = TABLE.random_starts(random, number)
        counted = [one.ray.side for one in starts if one.inside and one.time <= 0.0]
        if max(counted.count(1), counted.count(2)) <= threshold:
            return starts


def drawn_present(random: np.random.Generator, number: int, threshold: int) -> list[Backward]:
    """Draw such a state for the start of pasts: reversed velocities are as likely."""
    while True:
        found = [turned_start(TABLE, one) for one in TABLE.random_starts(random, number)]
        counted = [one.ray.side for one in found if one.status == COUNTED]
        if max(counted.count(1), counted.count(2)) <= threshold:
            return found


def pasts_of_a_run(
    random: np.random.Generator, number: int, threshold: int, depth: float
) -> tuple[Pasts, Tree]:
    """Return all pasts of a state that a run reaches, as deep as the beginning of the run."""
    passes, _ = histories(TABLE, threshold, drawn(random, number, threshold), depth)
    history = History(passes, number)
    tree = Tree(TABLE, threshold, history, depth)
    return tree.pasts(history.state(depth), depth), tree


def deep(work: study.Study) -> list[dict[str, float]]:
    """Return the number of pasts against depth: of states reached by runs, and of all states."""
    rows = []
    for number, deepest, most, least in DEEP:
        random = np.random.default_rng(number)
        depth = np.arange(1, DEPTHS + 1) * deepest / DEPTHS
        runs = int(work.pick(least, most))
        logs = np.array([
            np.log(pasts_of_a_run(random, number, 1, deepest)[0].number(depth * (1.0 - 1e-9)))
            for _ in range(runs)
        ])  # fmt: skip
        tree = Tree(TABLE, 1)
        all_states = np.array([
            tree.pasts(drawn_present(random, number, 1), deepest).number(depth * (1.0 - 1e-9))
            for _ in range(2 * runs)
        ])  # fmt: skip
        for at, one in enumerate(depth):
            rows.append({
                "number": number, "depth": one, "log": logs[:, at].mean(),
                "log_error": logs[:, at].std(ddof=1) / math.sqrt(runs),
                "pasts": all_states[:, at].mean(),
                "pasts_error": all_states[:, at].std(ddof=1) / math.sqrt(2 * runs),
            })  # fmt: skip
    return rows


def critical(rate: float, depth: Floats) -> Floats:
    """Return the mean of ln n of a critical branching process, weighted by n.

    n has the distribution n x^(n - 1)/(1 + b s)^2, x = b s/(1 + b s), b = F/(2 ln 2).
    """
    scaled = rate * depth[:, None] / (2.0 * math.log(2.0))
    n = np.arange(1, 4000)
    log_x = np.log(scaled / (1.0 + scaled))
    return np.sum(n * np.exp((n - 1) * log_x) / (1.0 + scaled) ** 2 * np.log(n), axis=1)


def same_present(work: study.Study, name: str, states: Sequence[Floats], depth: float) -> Floats:
    """Return the final states of the program, started from each of some states."""
    ends = []
    for at, one in enumerate(states):
        work.folder.mkdir(parents=True, exist_ok=True)
        file = work.folder / f"{name}_{at}.txt"
        np.savetxt(file, one, fmt="%.17g")
        changes = {
            "particles": {"number": len(one), "urn1_number": None, "initial_file": file.name},
            "gate": {"threshold": 1},
            "run": {"duration": depth},
        }
        path = work.run("entropy", f"{name}_{at}", changes, alone=True)
        end = postproc.open_results(path, group="final").squeeze("replica")
        ends.append(np.column_stack([end[key].to_numpy() for key in ("x", "y", "ux", "uy")]))
    return np.array(ends)


def checks(work: study.Study) -> list[dict[str, float]]:
    """Run the program from all pasts of states that have several: each ends in that state."""
    rows = []
    for number in CHECKED:
        random, found, ran_from, worst, drawn_states = np.random.default_rng(number), 0, 0, 0.0, 0
        while found < work.pick(2, COLLISIONS):
            drawn_states += 1
            pasts, tree = pasts_of_a_run(random, number, 1, CHECK_DEPTH)
            if len(pasts.states) < 2:
                continue
            present = coordinates(TABLE, tree.history.state(CHECK_DEPTH), 0.0)
            states = [coordinates(TABLE, one, CHECK_DEPTH) for one in pasts.states]
            if present is None or any(one is None for one in states):
                continue
            ends = same_present(work, f"past_{number}_{found}", states, CHECK_DEPTH)
            worst = max(worst, float(np.abs(ends - present).max()))
            found += 1
            ran_from += len(states)
        rows.append({"number": number, "presents": found, "pasts": ran_from, "apart": worst})
    return rows


def tables(
    work: study.Study, few_rows: Sequence[dict], many_rows: Sequence[dict],
    deep_rows: Sequence[dict], check_rows: Sequence[dict],
) -> None:  # fmt: skip
    """Write the tables of the page."""
    work.table("few", ["N", "firings a unit time, foreseen", "measured", "F", "F a firing"], [
        [str(one["number"]), text.number(one["foreseen"]),
         text.measured(one["firings"], one["firings_error"]),
         text.measured(one["folding"], one["folding_error"]),
         text.measured(one["a_firing"], one["a_firing_error"])]
        for one in few_rows
    ])  # fmt: skip
    head = ["N", "T", "firings", "J", "J ln(n2/n1)", "J ln(flows)", "chain", "F at least", "F",
            "F a firing"]  # fmt: skip
    work.table("many", head, [
        [str(one["number"]), str(one["threshold"]),
         *(text.number(one[key]) if abs(one[key]) > 0.02 else "0.0" for key in
           ("firings", "current", "density", "flows", "chain", "bound")),
         *(text.measured(one["folding"] / over, one["folding_error"] / over)
           for over in (1.0, one["firings"]))]
        for one in many_rows
    ])  # fmt: skip
    work.table("deep", ["N", "depth s", "mean of ln n", "mean of n, all states"], [
        [str(one["number"]), text.number(one["depth"]), text.measured(one["log"], one["log_error"]),
         text.measured(one["pasts"], one["pasts_error"])]
        for one in deep_rows
    ])  # fmt: skip
    work.table("checks", ["N", "presents", "pasts run forwards", "largest difference"], [
        [str(one["number"]), str(one["presents"]), str(one["pasts"]), f"{one['apart']:.0e}"]
        for one in check_rows
    ])  # fmt: skip


def figure(
    few_rows: Sequence[dict], many_rows: Sequence[dict], deep_rows: Sequence[dict]
) -> Figure:
    """Return F per reversal against N with lower bounds; number of pasts against depth."""
    made = style.figure(style.PAGE, 3.3)
    left, right = made.subplots(1, 2)
    own = [one for one in many_rows if math.isfinite(one["folding"])]
    left.errorbar([one["number"] for one in few_rows], [one["a_firing"] for one in few_rows],
                  [one["a_firing_error"] for one in few_rows], fmt="o", color=style.BLUE, ms=4,
                  capsize=2, label="$T = 1$")  # fmt: skip
    for threshold, colour, mark in zip((1, 2, 3), style.CYCLE, "osD", strict=False):
        rows = [one for one in own if one["threshold"] == threshold]
        left.errorbar([one["number"] for one in rows],
                      [one["folding"] / one["firings"] for one in rows],
                      [one["folding_error"] / one["firings"] for one in rows], fmt=mark,
                      color=colour, ms=4, capsize=2,
                      label=f"$T = {threshold}$" if threshold > 1 else None)  # fmt: skip
        left.plot([one["number"] for one in rows], [one["bound"] / one["firings"] for one in rows],
                  mark, color=colour, ms=4, mfc="none",
                  label="lower bounds" if threshold == 3 else None)  # fmt: skip
    left.axhline(2.0 * SHARE_OF_TWO * math.log(2.0), color=style.BLACK, lw=0.8, ls=":")
    left.set_xscale("log")
    left.set_ylim(bottom=0.0)
    left.set_xlabel("$N$")
    left.set_ylabel("$F$ a firing")
    left.set_title("(a)  what a firing folds")
    left.legend(frameon=False, fontsize=7)
    for (number, *_), colour, mark in zip(DEEP, style.CYCLE, "osD^", strict=False):
        own = [one for one in deep_rows if one["number"] == number]
        rate = next(one["folding"] for one in (*few_rows, *many_rows) if one["number"] == number)
        depth = rate * np.array([one["depth"] for one in own])
        right.errorbar(depth, [one["log"] for one in own], [one["log_error"] for one in own],
                       fmt=mark, color=colour, ms=3, lw=0.8, label=f"$N = {number}$")  # fmt: skip
    most = max(right.get_xlim()[1], 1.0)
    scaled = np.linspace(0.02, most, 100)
    right.plot(scaled, scaled, "-", color=style.BLACK, lw=0.8, label="$F s$")
    right.plot(scaled, critical(1.0, scaled), ":", color=style.BLACK, lw=1.2,
               label="pasts that die")  # fmt: skip
    right.set_xlabel("$F s$")
    right.set_ylabel("mean of $\\ln n_s$")
    right.set_title("(b)  $T = 1$")
    right.legend(frameon=False, fontsize=7)
    return made


def part(work: study.Study, made: Callable[[study.Study], list[dict]]) -> list[dict]:
    """Return the rows of a part of the study, the stored ones unless it is made afresh."""
    stored = None if work.afresh else work.kept(made.__name__)
    if stored is None:
        work.keep(made.__name__, {"rows": made(work)})
        stored = work.kept(made.__name__)
    return [{key: math.nan if value is None else value for key, value in row.items()}
            for row in stored["rows"]]  # fmt: skip


def run(work: study.Study) -> None:
    """Make all tables and pictures of the page."""
    few_rows, many_rows, check_rows, deep_rows = (
        part(work, one) for one in (few, many, checks, deep)
    )
    tables(work, few_rows, many_rows, deep_rows, check_rows)
    work.draw(figure(few_rows, many_rows, deep_rows), "entropy_production")


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

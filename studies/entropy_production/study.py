"""How often a state has several pasts: the folding entropy of the gated circuit.

Runs entropy.nml with other N, T, seeds, times, into build/entropy_production/quick, or full. Runs
of many particles are the program's; from their last states flights.py goes on. Runs of few are all
in flights.py. channel.py (channel 1 alone, given Poisson entries) and pasts.py (the whole state)
follow particles back. Writes few.csv, many.csv, convergence.csv, deep.csv, measure.csv,
checks.csv and entropy_production.png. Quick: some minutes of a core; --full: what is shown on the
page. Results that are kept are not made again; --afresh makes them again.
"""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

import postproc
from postproc import study
from postproc.figures import style
from postproc.study import text
from postproc.theory.renewal import RenewalGate
from studies.entropy_production.channel import Channel, pairs, share_of_two_pasts
from studies.entropy_production.flights import Start, Table, firings, histories
from studies.entropy_production.pasts import COUNTED, History, Tree, coordinates, turned_start
from studies.event_log import CROSSING1, CROSSING2, ENTRY, REVERSAL, mean_of_groups, read_log

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from studies.entropy_production.pasts import Backward

    Floats = NDArray[np.float64]

Made = TypeVar("Made")

TABLE = Table()
FEW = ((2, 500), (3, 400), (5, 400), (10, 400), (30, 400), (100, 1000))  # N, firings a run, T = 1
PRESENTS = {2: 1000, 3: 400, 5: 200, 10: 60, 30: 20, 100: 4}  # of a run
AGES = (2.0, 10.0, 32.0)  # of pasts; 32 is the mean time of a visit, pi A/(w + w')
CHECKED = (2, 3, 5, 10)
MANY = {(200, 2): 4, (300, 2): 2, (300, 3): 2, (1000, 1): 1, (1000, 7): 1}  # windows of a run
# how many pasts are selected, and at the start of windows, where more are needed; the last count
SELECTED = {(200, 2): (300,), (300, 2): (300,), (300, 3): (100, 300),
            (1000, 1): (30, 100, 300), (1000, 7): (60, 125, 250, 500)}  # fmt: skip
STARTS = (250, 1000)
# N at T = 1, greatest age of pasts, states of full runs and of quick ones, pasts selected
DEEP = ((3, 8000.0, 64, 16, (1000,)), (10, 1600.0, 64, 16, (1000,)),
        (30, 120.0, 32, 6, (60, 240)), (100, 36.0, 24, 6, (30, 100, 300)))  # fmt: skip
MEASURE = ((3, 2000.0), (10, 200.0), (30, 10.0), (100, 1.2))  # N, age
TIMES = 200  # at which pasts are counted
ROWS = 20  # of them in the table
TRANSIENT = 2000.0
EDGE = 2.0  # time at both ends of a window, over which logarithms of weights are averaged
LENGTH = 12.0  # of windows
COLLISIONS = 3  # presents with several pasts that are run forwards again
CHECK_DEPTH = 20.0


def foreseen(number: int) -> float:
    """Return the predicted rate of firings at T = 1: pairs of entries into one gate."""
    return 0.5 * math.pi * number * (number - 1) * (
        TABLE.channel1_width / (math.pi * TABLE.area)) ** 2  # fmt: skip


def kept(
    work: study.Study, name: str, made: Callable[..., Made], *arguments: object
) -> Made:
    """Return what a function makes, or made before and was kept in a file of that name."""
    before = None if work.afresh else work.kept(name)
    if before is None:
        work.keep(name, {"rows": made(*arguments)})
        before = work.kept(name)
    return before["rows"]


def ratio_of_groups(over: Floats, under: Floats) -> tuple[float, float]:
    """Return the ratio of the sums of two numbers of independent runs, and its standard error."""
    over, under = np.asarray(over, float), np.asarray(under, float)
    ratio = over.sum() / under.sum()
    rest = (over - ratio * under).std(ddof=1) * math.sqrt(over.size) / under.sum()
    return float(ratio), float(rest)


def told(work: study.Study, number: int, threshold: int) -> dict[str, Any]:
    """Return what the theory of renewal gates says of a circuit."""

    def made() -> dict[str, Any]:
        return work.theory("renewal", number=number, threshold=threshold)

    return kept(work, f"theory_{number}_{threshold}", made)


def ran(work: study.Study, number: int, threshold: int, seed: int, duration: float) -> Path:
    """Run a circuit from near its stationary state, which the theory of renewal gates knows."""
    theory = told(work, number, threshold)
    stable = [one["urn2_number"] for one in theory["roots"] if one["kind"] == "stable"]
    there = max(stable) if theory["homogeneous"] == "unstable" else 0.5 * number
    changes = {
        "particles": {"number": number, "urn1_number": number - round(there), "seed": seed},
        "gate": {"threshold": threshold},
        "run": {"duration": duration, "transient_duration": TRANSIENT},
    }
    return work.run("entropy", f"many_{number}_{threshold}_{seed}", changes, alone=True)


def rates(path: Path, begin: float, end: float) -> dict[str, float]:
    """Return rates between two times, by the log: entries, flows through, firings; and chi."""
    log = read_log(path)
    late = (log.time > begin) & (log.time < end)
    kind, where, number = log.kind[late], log.where[late], log.particle[late]
    span = end - begin
    fired = kind == REVERSAL
    found = {"firings": fired.sum() / span}
    for gate in (1, 2):
        entered = ((kind == ENTRY) & (where == gate)).sum()
        turned = number[fired & (where == gate)].sum()
        through = ((kind == CROSSING1) & (where == (21 if gate == 1 else 12))).sum()
        found |= {f"entries{gate}": entered / span, f"out{gate}": (turned + through) / span}
    for name, which in (("1", CROSSING1), ("2", CROSSING2)):
        for way in (12, 21):
            found[f"flow{name}_{way}"] = ((kind == which) & (where == way)).sum() / span
    found["chi"] = float(np.abs(postproc.open_results(path).squeeze().chi))
    return {key: float(value) for key, value in found.items()}


def last_state(path: Path) -> list[Start]:
    """Return the final state of a run."""
    end = postproc.open_results(path, group="final").squeeze("replica")
    columns = (end[name].to_numpy() for name in ("x", "y", "ux", "uy"))
    return [TABLE.start(*one) for one in zip(*columns, strict=True)]


def folding(
    channel: Channel, log: Sequence[tuple[float, int, int, int]],
    windows: Sequence[tuple[float, float]], most: int, random: np.random.Generator,
) -> dict[str, float]:  # fmt: skip
    """Return what the logarithm of the weight of all pasts over the true one's gains in windows.

    It gains it from its mean over ages of 1 to 2 edges, the start, to its mean over the last edge.
    Times, firings, gains and starts are summed over windows; `several` is the number of windows
    with several pasts already at the age `AGES[0]`.
    """
    fired = np.array([time for time, kind, *_ in log if kind == REVERSAL])
    found = dict.fromkeys(("gain", "start", "time", "firings", "several", "windows"), 0.0)
    for begin, end in windows:
        length = end - begin
        edge = min(EDGE, 0.1 * length)
        weighed = channel.weigh(begin, end, most, random)
        start = weighed.mean(end, edge, 2.0 * edge)
        inside = (fired > begin + 0.5 * edge) & (fired < end - 1.5 * edge)
        found["gain"] += weighed.mean(end, length - edge, length) - start
        found["start"] += start
        found["time"] += length - 2.0 * edge
        found["firings"] += int(inside.sum())
        found["several"] += weighed.mean(end, AGES[0] - 0.01, AGES[0] + 0.01) > 1e-9
        found["windows"] += 1
    return {key: float(value) for key, value in found.items()}


def few_run(number: int, fired: float, presents: int, seed: int) -> dict[str, Any]:
    """Return counts of one run of few particles at T = 1, and of pasts of states in it."""
    random = np.random.default_rng([number, seed])
    span = fired / foreseen(number)
    end = TRANSIENT + span
    passes, log = histories(TABLE, 1, drawn(random, number, 1), end)
    late = [one for one in passes if TRANSIENT < one.left <= end]
    reversed_pairs, through = pairs(late)
    entries = (TABLE.entries(number),) * 2
    length = span / 5.0
    windows = [(TRANSIENT + at * length, TRANSIENT + (at + 1) * length) for at in range(5)]
    found = folding(Channel(passes, 1, entries), log, windows, 300, random)
    history = History(passes, number)
    several = np.zeros(len(AGES))
    ages = np.arange(1.0, AGES[-1] + 0.5)
    wanted = np.searchsorted(ages, AGES)
    for present in random.uniform(TRANSIENT, end, presents):
        tree = Tree(TABLE, 1, history, present)
        several += tree.number(history.state(present), ages, 20, random)[wanted] > 1.5
    return {
        **found, "all_firings": firings(one for one in log if TRANSIENT < one[0] <= end),
        "span": span, "reversed": reversed_pairs, "through": through,
        "shares": (several / presents).tolist(),
    }  # fmt: skip


def few(work: study.Study) -> list[dict[str, float]]:
    """Return firings, states with two pasts, and the folding entropy of channel 1, T = 1."""
    rows = []
    for number, fired in FEW:
        runs = [
            kept(work, f"few_{number}_{seed}", few_run, number, work.pick(fired / 5, fired),
                 int(work.pick(4, PRESENTS[number])), seed)
            for seed in range(int(work.pick(4, 16)))
        ]  # fmt: skip
        of = {key: np.array([one[key] for one in runs], float) for key in runs[0]}
        row = {"number": number, "foreseen": foreseen(number),
               "firings": mean_of_groups(of["all_firings"] / of["span"]),
               "folding": mean_of_groups(of["gain"] / of["time"]),
               "a_firing": ratio_of_groups(of["gain"], of["firings"]),
               "reversed": ratio_of_groups(of["reversed"], of["all_firings"]),
               "through": ratio_of_groups(of["through"], of["all_firings"]),
               "two": ratio_of_groups(of["reversed"] + of["through"], of["span"]),
               "shares": [mean_of_groups(one) for one in of["shares"].T]}  # fmt: skip
        rows.append(row)
    return rows


def renewal_chain(number: int, threshold: int, urn2: float, area: float) -> float:
    """Return the entropy production of the chain of urns that forget, at its stationary state."""
    inside = np.array([number - urn2, urn2])
    entries = inside * TABLE.channel1_width / (math.pi * area)
    share = RenewalGate().share(threshold, entries * 0.25 * math.pi * TABLE.channel1_length)
    through, around = entries * share, inside * TABLE.channel2_width / (math.pi * area)
    return float((through[0] - through[1]) * math.log(through[0] / through[1])
                 + (around[1] - around[0]) * math.log(around[1] / around[0]))  # fmt: skip


def seeds(work: study.Study, threshold: int) -> range:
    """Return the seeds of independent runs of the program; more where they differ most."""
    return range(1, int(work.pick(2, 16 if threshold == 7 else 8)) + 1)


def states(work: study.Study, number: int, threshold: int) -> list[dict[str, float]]:
    """Return rates and costs of each of the independent runs of a circuit of many particles."""
    found = []
    end = work.pick(4000.0, 10000.0)
    for seed in seeds(work, threshold):
        path = ran(work, number, threshold, seed, end)
        row = kept(work, f"rates_{number}_{threshold}_{seed}", rates, path, TRANSIENT, end)
        current = row["flow2_21"] - row["flow2_12"]
        around = row["flow2_21"] / row["flow2_12"]
        through = row["flow1_12"] / max(row["flow1_21"], 1.0 / end)
        row["current"] = current
        row["density"] = current * math.log((1.0 + row["chi"]) / (1.0 - row["chi"]))
        row["flows"] = current * math.log(around)
        row["both"] = current * math.log(around * through)
        row["bound"] = sum(row[f"out{gate}"] * math.log(row[f"out{gate}"])
                           - row[f"entries{gate}"] * math.log(row[f"entries{gate}"])
                           for gate in (1, 2))  # fmt: skip
        found.append({**row, "path": path})
    return found


def weighed_run(
    path: Path, threshold: int, entries: Sequence[float], windows: Sequence[tuple[float, float]],
    most: int, seed: Sequence[int],
) -> dict[str, float]:  # fmt: skip
    """Return the gains of `folding` in a run that goes on from the last state of another."""
    passes, log = histories(TABLE, threshold, last_state(path), windows[-1][1] + 1.0)
    channel = Channel(passes, threshold, entries)
    return folding(channel, log, windows, most, np.random.default_rng(seed))


def start_of_run(
    path: Path, threshold: int, entries: Sequence[float], windows: Sequence[tuple[float, float]],
    most: int, seed: Sequence[int],
) -> float:  # fmt: skip
    """Return the sum of the starts of `folding`, of the same windows, from their ends alone."""
    passes, _ = histories(TABLE, threshold, last_state(path), windows[-1][1] + 1.0)
    channel, random = Channel(passes, threshold, entries), np.random.default_rng(seed)
    total = 0.0
    for begin, end in windows:
        edge = min(EDGE, 0.1 * (end - begin))
        found = channel.weigh(end - 2.5 * edge, end, most, random)
        total += found.mean(end, edge, 2.0 * edge)
    return total


def weighed(
    work: study.Study, number: int, threshold: int, most: int
) -> dict[str, NDArray[np.float64]]:
    """Return sums of `folding` of each run of many particles, so many pasts being selected.

    At the start of windows more pasts are needed than later: `starts` are the sums with more
    pasts selected, as `STARTS`. Gains are from the last of them.
    """
    runs = states(work, number, threshold)
    entries = [float(np.mean([one[f"entries{gate}"] for one in runs])) for gate in (1, 2)]
    windows = [(2.0 + at * LENGTH, 2.0 + (at + 1.0) * LENGTH)
               for at in range(int(work.pick(1, MANY[number, threshold])))]  # fmt: skip
    name = f"{number}_{threshold}"
    found = []
    for seed, one in zip(seeds(work, threshold), runs, strict=True):
        told_of = (one["path"], threshold, entries, windows)
        row = kept(work, f"weighed_{name}_{most}_{seed}", weighed_run, *told_of, most,
                   (number, threshold, seed, most))  # fmt: skip
        row["starts"] = [
            kept(work, f"start_{name}_{more}_{seed}", start_of_run, *told_of, more,
                 (number, threshold, seed, more, 1))
            for more in STARTS
        ]  # fmt: skip
        row["gain"] += row["start"] - row["starts"][-1]
        found.append(row)
    return {key: np.array([one[key] for one in found]) for key in found[0]}


def numbers_selected(work: study.Study, circuit: tuple[int, int]) -> tuple[int, ...]:
    """Return how many pasts are selected, one number after the other; the last counts."""
    return SELECTED[circuit] if work.full else SELECTED[circuit][:2]


def many(work: study.Study) -> list[dict[str, Any]]:
    """Return the entropy of channel 1 with many particles, with what the net current would cost."""
    rows = []
    for circuit in MANY:
        number, threshold = circuit
        runs = states(work, number, threshold)
        row: dict[str, Any] = {"number": number, "threshold": threshold}
        for key in ("firings", "chi", "current", "density", "flows", "both", "bound"):
            row[key] = mean_of_groups([one[key] for one in runs])
        theory = told(work, number, threshold)
        stable = [one["urn2_number"] for one in theory["roots"] if one["kind"] == "stable"]
        row["chain"] = 0.0
        if theory["homogeneous"] == "unstable":
            row["chain"] = renewal_chain(number, threshold, max(stable), theory["urn_area"])
        of = weighed(work, number, threshold, numbers_selected(work, circuit)[-1])
        row["folding"] = mean_of_groups(of["gain"] / of["time"])
        row["a_firing"] = ratio_of_groups(of["gain"], of["firings"])
        row["windows"] = [of["windows"].sum(), of["several"].sum()]
        rows.append(row)
    return rows


def convergence(work: study.Study) -> list[dict[str, Any]]:
    """Return the entropy of channel 1 against the number of pasts that are selected."""
    rows = []
    for circuit, numbers in SELECTED.items():
        if len(numbers) == 1:
            continue
        for most in numbers_selected(work, circuit):
            of = weighed(work, *circuit, most)
            rows.append({
                "number": circuit[0], "threshold": circuit[1], "most": most,
                "windows": int(of["windows"].sum()),
                "starts": [mean_of_groups(one / of["windows"]) for one in of["starts"].T],
                "folding": mean_of_groups(of["gain"] / of["time"]),
            })  # fmt: skip
    return rows


def drawn(random: np.random.Generator, number: int, threshold: int) -> list[Start]:
    """Draw a state from Liouville's measure, of those in which no gate counts more than T."""
    while True:
        starts = TABLE.random_starts(random, number)
        counted = [one.ray.side for one in starts if one.inside and one.time <= 0.0]
        if max(counted.count(1), counted.count(2)) <= threshold:
            return starts


def drawn_present(random: np.random.Generator, number: int, threshold: int) -> list[Backward]:
    """Draw such a state as pasts begin: starts whose velocities are turned are as likely."""
    while True:
        found = [turned_start(TABLE, one) for one in TABLE.random_starts(random, number)]
        counted = [one.ray.side for one in found if one.status == COUNTED]
        if max(counted.count(1), counted.count(2)) <= threshold:
            return found


def pasts_of_a_run(
    random: np.random.Generator, number: int, threshold: int, depth: float
) -> tuple[list[list[Backward]], Tree]:
    """Return all pasts of a state that a run arrives at after some time, as deep as it began."""
    passes, _ = histories(TABLE, threshold, drawn(random, number, threshold), depth)
    history = History(passes, number)
    tree = Tree(TABLE, threshold, history, depth)
    return tree.pasts(history.state(depth), depth), tree


def deep_state(
    number: int, age: float, most: Sequence[int], seed: int
) -> list[list[float]]:
    """Return ln n_s of a state of a run that is older than its oldest pasts, for each selection."""
    random = np.random.default_rng([number, seed, 1])
    time = TRANSIENT + age
    passes, _ = histories(TABLE, 1, drawn(random, number, 1), time)
    history = History(passes, number)
    tree = Tree(TABLE, 1, history, time)
    ages = np.arange(1, TIMES + 1) * age / TIMES
    return [np.log(tree.number(history.state(time), ages, one, random)).tolist() for one in most]


def deep(work: study.Study) -> list[dict[str, Any]]:
    """Return the mean of ln n_s over states of stationary runs, T = 1."""
    rows = []
    for number, age, full, quick, most in DEEP:
        logs = np.array([
            kept(work, f"deep_{number}_{seed}", deep_state, number, age, most, seed)
            for seed in range(int(work.pick(quick, full)))
        ])  # fmt: skip
        for at in range(TIMES // ROWS - 1, TIMES, TIMES // ROWS):
            row = {"number": number, "age": (at + 1) * age / TIMES, "states": len(logs),
                   "most": list(most),
                   "logs": [mean_of_groups(one) for one in logs[:, :, at].T]}  # fmt: skip
            rows.append(row)
    return rows


def measure(work: study.Study) -> list[dict[str, Any]]:
    """Return two means that are equal: 1/n_s over runs of that length, and 1 where n_s > 0.

    The runs begin with Liouville's measure; the second mean, and that of n_s, which is 1, are over
    that measure.
    """
    rows = []
    for number, age in MEASURE:
        random = np.random.default_rng([number, 2])
        size = int(work.pick(50, 200))
        inverse = [1.0 / len(pasts_of_a_run(random, number, 1, age)[0]) for _ in range(size)]
        tree = Tree(TABLE, 1)
        found = np.array([len(tree.pasts(drawn_present(random, number, 1), age))
                          for _ in range(size)])  # fmt: skip
        rows.append({"number": number, "age": age, "states": size,
                     "inverse": mean_of_groups(inverse), "share": mean_of_groups(found > 0),
                     "pasts": mean_of_groups(found)})  # fmt: skip
    return rows


def critical(rate: float, depth: Floats) -> Floats:
    """Return the mean of ln n of a critical branching process, n weighed by itself.

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
    """Run the program from all pasts of presents that have several: each ends in the present."""
    rows = []
    for number in CHECKED:
        random, found, ran_from, worst, drawn_states = np.random.default_rng(number), 0, 0, 0.0, 0
        while found < work.pick(2, COLLISIONS):
            drawn_states += 1
            pasts, tree = pasts_of_a_run(random, number, 1, CHECK_DEPTH)
            if len(pasts) < 2:
                continue
            present = coordinates(TABLE, tree.history.state(CHECK_DEPTH), 0.0)
            states = [coordinates(TABLE, one, CHECK_DEPTH) for one in pasts]
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
    convergence_rows: Sequence[dict], deep_rows: Sequence[dict], measure_rows: Sequence[dict],
    check_rows: Sequence[dict],
) -> None:  # fmt: skip
    """Write the tables of the page."""
    a_firing = 2.0 * share_of_two_pasts() * math.log(2.0)
    head = ["N", "firings, predicted", "firings", "F_ch, predicted", "F_ch", "F_ch per firing",
            "two pasts: after a firing", "other past: per firing", "begin per unit time",
            *(f"share of time, s = {age:g}" for age in AGES)]  # fmt: skip
    work.table("few", head, [
        [str(one["number"]), text.number(one["foreseen"]), text.measured(*one["firings"]),
         text.number(a_firing * one["foreseen"]), text.measured(*one["folding"]),
         text.measured(*one["a_firing"]),
         *(text.measured(*one[key]) if one["number"] <= 10 else "-"
           for key in ("reversed", "through", "two")),
         *(text.measured(*share) for share in one["shares"])]
        for one in few_rows
    ])  # fmt: skip
    keys = ("firings", "chi", "current", "density", "flows", "both", "bound")
    head = ["N", "T", "firings", "chi", "J", "J ln(n2/n1)", "J ln(flows, channel 2)",
            "J ln(flows, both)", "Poisson bound", "chain", "F_ch", "F_ch per firing",
            "windows", f"of these several pasts at s = {AGES[0]:g}"]  # fmt: skip
    work.table("many", head, [
        [str(one["number"]), str(one["threshold"]), *(text.measured(*one[key]) for key in keys),
         text.number(one["chain"]), text.measured(*one["folding"]),
         text.measured(*one["a_firing"]), *(f"{count:.0f}" for count in one["windows"])]
        for one in many_rows
    ])  # fmt: skip
    head = ["N", "T", "pasts selected", "windows", "F_ch",
            *(f"start, {most} pasts selected" for most in STARTS)]  # fmt: skip
    work.table("convergence", head, [
        [*(str(one[key]) for key in ("number", "threshold", "most", "windows")),
         text.measured(*one["folding"]), *(text.measured(*start) for start in one["starts"])]
        for one in convergence_rows
    ])  # fmt: skip
    head = ["N", "age s", "states", "prediction 5", "F_ch s", "pasts selected", "mean of ln n_s",
            "over s and F_ch"]  # fmt: skip
    rates = {one["number"]: one["folding"] for one in few_rows}
    lines = []
    for one in deep_rows:
        scaled = rates[one["number"]][0] * one["age"]
        error = one["age"] * rates[one["number"]][1]
        for most, (value, spread) in zip(one["most"], one["logs"], strict=True):
            bound = math.hypot(spread, value * error / scaled) / scaled
            low, middle, high = critical(1.0, scaled + np.array([-error, 0.0, error]))
            lines.append([str(one["number"]), text.number(one["age"]), str(one["states"]),
                          text.measured(middle, 0.5 * (high - low)), text.measured(scaled, error),
                          str(most), text.measured(value, spread),
                          text.measured(value / scaled, bound)])  # fmt: skip
    work.table("deep", head, lines)
    work.table("measure", ["N", "s", "states", "mean of 1/n_s, runs", "share with a past",
                           "mean of n_s, all states"], [
        [str(one["number"]), text.number(one["age"]), str(one["states"]),
         *(text.measured(*one[key]) for key in ("inverse", "share", "pasts"))]
        for one in measure_rows
    ])  # fmt: skip
    work.table("checks", ["N", "presents", "pasts run forwards", "largest difference"], [
        [str(one["number"]), str(one["presents"]), str(one["pasts"]), f"{one['apart']:.0e}"]
        for one in check_rows
    ])  # fmt: skip


def figure(
    few_rows: Sequence[dict], many_rows: Sequence[dict], deep_rows: Sequence[dict]
) -> Figure:
    """Return F_ch per firing against N with other costs; pasts against age."""
    made = style.figure(style.PAGE, 3.6)
    left, right = made.subplots(1, 2)
    left.axhline(2.0 * share_of_two_pasts() * math.log(2.0), color=style.BLACK, lw=0.8, ls=":",
                 label="prediction, few particles")  # fmt: skip
    points = [(1, one["number"], *one["a_firing"]) for one in few_rows]
    points += [(one["threshold"], one["number"], *one["a_firing"]) for one in many_rows]
    marks = {1: "o", 2: "s", 3: "D", 7: "^"}
    for (threshold, mark), colour in zip(marks.items(), style.CYCLE, strict=False):
        _, number, value, error = np.array([one for one in points if one[0] == threshold]).T
        dense = threshold == 7
        left.errorbar(number, value, error, fmt=mark, color=colour, ms=4, capsize=2,
                      lolims=dense, label=f"$T = {threshold}$" + ", at least" * dense)  # fmt: skip
        costs = [(one["number"], one["bound"][0] / one["firings"][0],
                  one["both"][0] / one["firings"][0])
                 for one in many_rows if one["threshold"] == threshold > 1]  # fmt: skip
        for number, bound, both in costs:
            shift = 0.93 if threshold == 2 else 1.08
            left.plot(number * shift, bound, mark, color=colour, ms=4, mfc="none")
            left.plot(number * shift, both, "x", color=colour, ms=5)
    left.plot([], [], "o", color=style.BLACK, ms=4, mfc="none", label="Poisson bound")
    left.plot([], [], "x", color=style.BLACK, ms=5, label="$J$ ln(flows, both channels)")
    left.set_xscale("log")
    left.set_xlim(1.4, 2000.0)
    left.set_ylim(-0.05, left.get_ylim()[1])
    left.set_xlabel("$N$")
    left.set_ylabel("$F_{ch}$ per firing")
    left.set_title("(a)  Channel 1 alone")
    left.legend(frameon=False, fontsize=7, loc="upper left")
    most = 0.0
    for (number, *_), colour, mark in zip(DEEP, style.CYCLE, "osD^", strict=False):
        rows = [one for one in deep_rows if one["number"] == number]
        rate = next(one["folding"][0] for one in few_rows if one["number"] == number)
        age = rate * np.array([one["age"] for one in rows])
        most = max(most, age[-1])
        right.errorbar(age, [one["logs"][-1][0] for one in rows],
                       [one["logs"][-1][1] for one in rows],
                       fmt=mark, color=colour, ms=3, lw=0.8, label=f"$N = {number}$")  # fmt: skip
    scaled = np.geomspace(0.1, 1.1 * most, 100)
    right.plot(scaled, scaled, "-", color=style.BLACK, lw=0.8, label="$F_{ch} s$")
    right.plot(scaled, critical(1.0, scaled), ":", color=style.BLACK, lw=1.2, label="prediction 5")
    right.set_xscale("log")
    right.set_ylim(0.0, 1.1 * max(one["logs"][-1][0] for one in deep_rows))
    right.set_xlabel("$F_{ch} s$")
    right.set_ylabel("mean of $\\ln n_s$")
    right.set_title("(b)  Whole state, $T = 1$")
    right.legend(frameon=False, fontsize=7, loc="upper left")
    return made


def run(work: study.Study) -> None:
    """Make everything of the page."""
    if work.afresh:
        shutil.rmtree(work.folder, ignore_errors=True)
        work = replace(work, afresh=False)
    few_rows, many_rows, convergence_rows, deep_rows = (
        one(work) for one in (few, many, convergence, deep)
    )
    measure_rows, check_rows = (
        kept(work, one.__name__, one, work) for one in (measure, checks)
    )
    tables(work, few_rows, many_rows, convergence_rows, deep_rows, measure_rows, check_rows)
    work.draw(figure(few_rows, many_rows, deep_rows), "entropy_production")


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

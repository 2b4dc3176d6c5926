"""Five experiments that decide whether urns remember: each predicted by a formula, then measured.

1. Directions: autocorrelation of cos(theta) from entry to entry of the single urn without a gate.
2. Two ports: what particles that came through channel 2 do next, in the free circuit.
3. Urns twice as large with four times as many particles: the loads are the same, the memory is not.
4. Circulation: how often particles go round and round, against w' and l'.
5. The upper transition after a short and after a long transient.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

from postproc.accuracy import ladder, predictions, tail
from postproc.accuracy.events import CROSSING1, CROSSING2, ENTRY, read_log, stories
from postproc.reading.results import Results
from postproc.theory import ports, two_port
from postproc.theory.circuit import Circuit, flow1, held_in_channels
from postproc.theory.direction import diffusion
from postproc.theory.renewal import RENEWAL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.accuracy.events import Stories
    from postproc.study.study import Study

    Floats = NDArray[np.float64]

WIDTHS = (0.3, 0.2, 0.1)  # w of the urns whose directions are followed
LAGS = (1, 5, 10, 20, 40)  # visits, at w = 0.3; as (0.3/w)^2 elsewhere
GROUPS = 10  # of particles, whose scatter gives an error
ROUNDS = 8  # rounds from which on a circulation is counted
SIZES = ((1.0, 1000), (2.0, 4000))  # r, N with equal loads
SIZED_T = (7, 10, 13)
TURNS = ((0.01, 1.0), (0.02, 1.0), (0.01, 0.25), (0.01, 4.0))  # w', l'
TRANSIENTS = (500.0, 5000.0)
SLOW = 3000.0  # time in which chi was supposed to relax near the upper transition; it does not


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes
    ----------
    experiment : its number.
    what : the quantity.
    mixed : what urns without memory would give, NaN if they say nothing.
    predicted : by memory.
    measured, error : by the program, and the standard error.
    """

    experiment: int
    what: str
    mixed: float
    predicted: float
    measured: float
    error: float

    @property
    def off(self) -> float:
        """How far prediction and measurement are apart, in standard errors."""
        return (self.measured - self.predicted) / self.error


def mean_of_groups(values: Floats) -> tuple[float, float]:
    """Return mean and standard error of values of independent groups or runs."""
    known = np.asarray(values, float)
    return float(known.mean()), float(known.std(ddof=1) / math.sqrt(known.size))


def entries_of(told: Stories) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Return (time, particle, cos(theta)) of entries into gate 1 that reach the end wall.

    Without a gate the flight from the chord to the wall takes (l/2)/cos(theta); here l = 1.
    """
    entry = np.flatnonzero((told.kind == ENTRY) & (told.after >= 0))
    entry = entry[told.kind[told.after[entry]] == CROSSING1]
    flight = told.time[told.after[entry]] - told.time[entry]
    return told.time[entry], told.particle[entry], 0.5 / flight


def autocorrelations(
    time: Floats, particle: NDArray[np.int64], cosine: Floats, lags: NDArray[np.int64], last: float
) -> Floats:
    """Return the autocorrelation of cos(theta), shape (group of particles, lag).

    Pairs begin before `last`, so that hardly any is cut off by the end of the run, which would
    favour short visits. The mean is the cosine law's, pi/4; the variance is each group's own.
    """
    away = cosine - 0.25 * math.pi
    group = particle % GROUPS
    variance = np.bincount(group, away**2) / np.bincount(group)
    found = np.empty((GROUPS, lags.size))
    for at, lag in enumerate(lags):
        pair = (particle[lag:] == particle[:-lag]) & (time[:-lag] < last)
        product = (away[lag:] * away[:-lag])[pair]
        sums = np.bincount(group[:-lag][pair], product, minlength=GROUPS)
        found[:, at] = sums / np.bincount(group[:-lag][pair], minlength=GROUPS) / variance
    return found


def fitted_diffusion(lags: NDArray[np.int64], values: Floats) -> float:
    """Return the D a visit whose autocorrelation passes through the values best."""
    start = math.log(2.0) / (6.0 * float(np.interp(-0.5, -values, lags)))

    def apart(log_diffusion: Floats) -> Floats:
        return predictions.autocorrelation(math.exp(log_diffusion[0]), lags) - values

    return math.exp(optimize.least_squares(apart, [math.log(start)]).x[0])


def directions(study: Study) -> tuple[list[Row], list[dict]]:
    """Make experiment 1; return its rows, and the curves for the figure."""
    rows, curves = [], []
    for width in WIDTHS:
        stretch = (WIDTHS[0] / width) ** 2
        lags = np.unique(np.round(np.array(LAGS) * stretch).astype(int))
        duration = study.pick(60.0, 300.0) * predictions.memory_time(Circuit(1, 1, width, 0.0))
        duration = float(f"{duration / math.sqrt(stretch):.1e}")
        changes = {
            "table": {"shape": "urn", "channel1_width": width, "channel2_width": None},
            "particles": {"number": 100, "urn1_number": None},
            "gate": {"threshold": 100},
            "run": {"duration": duration},
        }
        name = f"directions_{width:g}".replace(".", "p")
        path = study.run("accuracy_events", name, changes, alone=True)
        with Results(path) as results:
            seen = entries_of(stories(read_log(results)))
        values = autocorrelations(*seen, lags, 0.5 * duration)
        mean, error = values.mean(axis=0), values.std(axis=0, ddof=1) / math.sqrt(GROUPS)
        scale = diffusion(1.0, width)
        if width == WIDTHS[0]:
            predicted = predictions.autocorrelation(scale, lags)
            rows += [
                Row(1, f"autocorrelation after {lag} visits, w = {width:g}", 0.0, *numbers)
                for lag, *numbers in zip(lags.tolist(), predicted, mean, error, strict=True)
            ]
        fitted = [fitted_diffusion(lags, one) / width**2 for one in values]
        what = f"D r^2/w^2 a visit, w = {width:g}"
        rows.append(Row(1, what, math.inf, scale / width**2, *mean_of_groups(fitted)))
        curves.append({"width": width, "lags": lags, "mean": mean, "error": error})
    return rows, curves


def after_channel2(told: Stories, circuit: Circuit) -> tuple[Floats, Floats]:
    """Return (share whose next event is channel 2 again, mean stay in the urn) by group.

    The way from the line to the urn, and from the urn back to the line, takes pi l'/4 on average.
    """
    crossed = np.flatnonzero((told.kind == CROSSING2) & (told.after >= 0))
    following = told.after[crossed]
    again = told.kind[following] == CROSSING2
    flight = told.time[following] - told.time[crossed]
    group = told.particle[crossed] % GROUPS
    count = np.bincount(group, minlength=GROUPS)
    share = np.bincount(group, again, minlength=GROUPS) / count
    half = 0.25 * math.pi * float(circuit.channel2_length)
    return share, np.bincount(group, flight, minlength=GROUPS) / count - half * (1.0 + share)


def two_ports(study: Study) -> list[Row]:
    """Make experiment 2."""
    changes = {
        "particles": {"urn1_number": 500}, "gate": {"threshold": 1000},
        "run": {"duration": study.pick(2.0e4, 4.0e5)},
    }  # fmt: skip
    with Results(study.run("accuracy_events", "ports", changes, alone=True)) as results:
        circuit, told = results.circuit(0), stories(read_log(results))
    found, ratio = ports.disc(circuit), float(circuit.channel2_width)
    mixed = ratio / (ratio + float(circuit.channel1_width))
    stay = math.pi * float(circuit.urn_area) / (ratio + float(circuit.channel1_width))
    share, time = (mean_of_groups(one) for one in after_channel2(told, circuit))
    return [
        Row(2, "share of crossings of channel 2 that are followed by another", mixed,
            found.return_chance, *share),
        Row(2, "mean stay in the urn after channel 2", stay, found.stay2, *time),
    ]  # fmt: skip


def of_halves(circuit: Circuit, chi: float) -> tuple[Floats, float]:
    """Return (how many are inside urns 1 and 2, chi N) at a measured chi, urn 2 the fuller."""
    halves = 0.5 * float(circuit.number) * np.array([1.0 - chi, 1.0 + chi])
    inside = halves.copy()
    for _ in range(50):
        mine, other = held_in_channels(circuit, inside)
        inside = halves - mine - other[::-1]
    return inside, float(halves[1] - halves[0])


def sizes(study: Study) -> list[Row]:
    """Make experiment 3: conductance, and what the sparse gate lets through, for two sizes."""
    rows = []
    for radius, number in SIZES:
        slow = predictions.memory_time(Circuit(1, 1, urn_radius=radius))
        transient = float(f"{3.0 * slow:.1e}")
        changes = {
            "table": {"urn_radius": radius},
            "particles": {"number": number, "urn1_number": number // 20},
            "gate": {"threshold": None},
            "run": {
                "duration": transient + study.pick(6.0e4, 4.0e5),
                "transient_duration": transient,
            },
            "scan": {"threshold": list(SIZED_T), "replicas": 4},
        }
        with Results(study.run("accuracy_battery", f"size_{radius:g}", changes)) as results:
            for point, threshold in enumerate(SIZED_T):
                circuit = results.circuit(point, RENEWAL)
                chi = results.value("chi")[point]
                current = np.abs(results.value("current2")[point])
                flows = results.value("flow1_12")[point]
                inside, apart = of_halves(circuit, float(chi.mean()))
                scale = predictions.mixed_conductance(circuit)
                share = (inside[1] - inside[0]) / apart
                predicted = share * two_port.conductance(circuit) / scale
                name = f"r = {radius:g}, N = {number}, T = {threshold}"
                rows.append(
                    Row(3, f"conductance over w'/(pi A), {name}", share, predicted,
                        *mean_of_groups(current / (scale * apart)))
                )  # fmt: skip
                expected = float(flow1(circuit, inside[0]))
                rows.append(
                    Row(3, f"flow of the sparse gate over the renewal gate's, {name}", 1.0,
                        math.nan, *mean_of_groups(flows / expected))
                )  # fmt: skip
    return rows


def circulation(study: Study) -> tuple[list[Row], list[dict]]:
    """Make experiment 4; return its rows, and the laws for the figure."""
    rows, laws = [], []
    logs, end = int(study.pick(2, 8)), study.pick(4.0e4, 8.0e4)
    for width, length in TURNS:
        count, dense, reached = [], [], np.zeros(tail.ROUNDS.size)
        for seed in range(1, logs + 1):
            changes = {
                "table": {"channel2_width": width, "channel2_length": length},
                "particles": {"seed": 2000 + seed, "urn1_number": 35 if width < 0.015 else 62},
                "run": {"duration": end},
            }
            name = f"turns_{width:g}_{length:g}_{seed}".replace(".", "p")
            with Results(study.run("accuracy_events", name, changes, alone=True)) as results:
                circuit, log = results.circuit(0), read_log(results)
                start = int(circuit.number) - int(results.value("urn1_number")[0])
            told = stories(log)
            rounds = tail.circulations(told, circuit).rounds
            count.append(np.count_nonzero(rounds == ROUNDS))
            reached += [np.count_nonzero(rounds == one) for one in tail.ROUNDS]
            dense.append(tail.urn_numbers(log, told, circuit, start, end)[1])
        time = end - tail.TRANSIENT
        rate = sum(count) / (logs * time)
        error = max(math.sqrt(max(sum(count), 1)), float(np.std(count) * math.sqrt(logs)))
        held = float(np.mean(dense))
        predicted = predictions.circulation_rate(circuit, held, ROUNDS)
        what = f"begin {ROUNDS} rounds or more, per unit time, w' = {width:g}, l' = {length:g}"
        rows.append(Row(4, what, 0.0, predicted, rate, error / (logs * time)))
        laws.append({"width": width, "length": length, "rounds": tail.ROUNDS, "reached": reached,
                     "time": logs * time,
                     "predicted": predictions.circulation_rate(circuit, held, 1.0)})  # fmt: skip
    return [*rows, ratio_of(rows[1], rows[0])], laws


def ratio_of(wide: Row, narrow: Row) -> Row:
    """Return the line of the ratio of two rates, that of the wider channel 2 over the other."""
    value = wide.measured / narrow.measured
    error = value * math.hypot(wide.error / wide.measured, narrow.error / narrow.measured)
    what = "ratio of these rates, w' = 0.02 over w' = 0.01, l' = 1"
    return Row(4, what, math.nan, wide.predicted / narrow.predicted, value, error)


def transition_after(
    study: Study, transient: float, measured: float, replicas: int
) -> ladder.Answer:
    """Return the upper transition of runs that measure for so long after a transient."""
    changes = {
        "particles": {"seed": 31},
        "run": {"duration": transient + measured, "transient_duration": transient},
        "scan": {"replicas": replicas},
    }
    name = f"transition_{transient:g}_{measured:g}"
    return ladder.transition_answer(study.run("accuracy_transition", name, changes))


def transients(study: Study) -> list[Row]:
    """Make experiment 5: how far a transient that is too short shifts the upper transition.

    Runs begin at chi = 0.4 and end at 0.3 where the transition is read off; an average over [t0, t]
    keeps (0.4 - 0.3) tau (exp(-t0/tau) - exp(-t/tau))/(t - t0) of that, over the slope of chi in T.
    """
    measured, replicas = 5.0e3, int(study.pick(48, 256))
    found = [transition_after(study, one, measured, replicas) for one in TRANSIENTS]
    after = found[-1][1]
    slope = np.interp(
        ladder.HALFWAY, np.array(after["chi"])[::-1],
        np.gradient(np.array(after["chi"]), np.array(after["threshold"]))[::-1],
    )  # fmt: skip
    kept = [
        SLOW / measured * (math.exp(-one / SLOW) - math.exp(-(one + measured) / SLOW))
        for one in TRANSIENTS
    ]
    predicted = (0.4 - ladder.HALFWAY) * (kept[0] - kept[1]) / -float(slope)
    (one, _), (other, _) = found
    error = math.hypot(one.error, other.error)
    what = "T of the upper transition, transient 500, less that with 5000"
    return [Row(5, what, 0.0, predicted, one.value - other.value, error)]


def run(study: Study) -> dict[str, object]:
    """Make all five; keep the numbers in `experiments.json` and return them."""
    rows, curves = directions(study)
    rows += two_ports(study)
    rows += sizes(study)
    turned, laws = circulation(study)
    rows += turned + transients(study)
    numbers = {
        "rows": [asdict(row) for row in rows], "curves": curves, "laws": laws, "full": study.full,
    }  # fmt: skip
    study.keep("experiments", numbers)
    return numbers

"""Five experiments on the memory of urns: each predicted by a formula, then measured.

1. Directions: autocorrelation of cos(theta) from entry to entry of the single urn without a gate.
2. Two ports: next events of particles that came through channel 2, in the free circuit.
3. Urns twice as large with four times as many particles: equal loads, another memory.
4. Circulation: rates of circulations against w' and l'.
5. The upper transition after a short and after a long transient.

Runs are made in build/experiments/quick (about two minutes of one core), or full (ten times as
long); complete runs are not repeated.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

import postproc
from postproc.advice.transients import circulation_rate, memory_time
from postproc.theory import circuit as theory
from postproc.theory import ports
from postproc.theory.renewal import RENEWAL
from studies.common import circulations, study
from studies.common.event_log import (
    GROUPS,
    after_channel2,
    autocorrelations,
    circuit_of,
    entries_of,
    particle_events,
    read_log,
)
from studies.common.numbers import mean_of, transition_of
from studies.common.text import measured, number
from studies.experiments import picture, predictions

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

WIDTHS = (0.3, 0.2, 0.1)  # w of the urns whose directions are followed
LAGS = (1, 5, 10, 20, 40)  # visits, at w = 0.3; as (0.3/w)^2 elsewhere
ROUNDS = 8  # least number of rounds of a circulation
SIZES = ((1.0, 1000), (2.0, 4000))  # r, N with equal loads
SIZED_T = (7, 10, 13)
TURNS = ((0.01, 1.0), (0.02, 1.0), (0.01, 0.25), (0.01, 4.0))  # w', l'
TRANSIENTS = (500.0, 5000.0)
SLOW = 3000.0  # assumed relaxation time of chi near the upper transition, which was refuted
HALFWAY = 0.3  # chi at the transition, between integer T on a straight line


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes
    ----------
    experiment : its number.
    what : the quantity.
    mixed : value for urns without memory, NaN if there is none.
    predicted : value with memory.
    measured, error : value of runs, and the standard error.
    """

    experiment: int
    what: str
    mixed: float
    predicted: float
    measured: float
    error: float

    @property
    def off(self) -> float:
        """Difference of prediction and measurement, in standard errors."""
        return (self.measured - self.predicted) / self.error


def fitted_diffusion(lags: NDArray[np.int64], values: Floats) -> float:
    """Return the D per visit whose autocorrelation fits the values best."""
    start = math.log(2.0) / (6.0 * float(np.interp(-0.5, -values, lags)))

    def apart(log_diffusion: Floats) -> Floats:
        return predictions.autocorrelation(math.exp(log_diffusion[0]), lags) - values

    return math.exp(optimize.least_squares(apart, [math.log(start)]).x[0])


def directions(work: study.Study) -> tuple[list[Row], list[dict]]:
    """Make experiment 1; return its rows, and the curves for the figure."""
    rows, curves = [], []
    for width in WIDTHS:
        stretch = (WIDTHS[0] / width) ** 2
        lags = np.unique(np.round(np.array(LAGS) * stretch).astype(int))
        duration = work.pick(60.0, 300.0) * memory_time(theory.Circuit(1, 1, width, 0.0))
        duration = float(f"{duration / math.sqrt(stretch):.1e}")
        changes = {
            "table": {"shape": "urn", "channel1_width": width, "channel2_width": None},
            "particles": {"number": 100, "urn1_number": None},
            "gate": {"threshold": 100},
            "run": {"duration": duration},
        }
        name = f"directions_{width:g}".replace(".", "p")
        seen = entries_of(particle_events(read_log(work.run("events", name, changes, alone=True))))
        values = autocorrelations(*seen, lags, 0.5 * duration)
        mean, error = values.mean(axis=0), values.std(axis=0, ddof=1) / math.sqrt(GROUPS)
        scale = predictions.diffusion(1.0, width)
        if width == WIDTHS[0]:
            predicted = predictions.autocorrelation(scale, lags)
            rows += [
                Row(1, f"autocorrelation after {lag} visits, w = {width:g}", 0.0, *numbers)
                for lag, *numbers in zip(lags.tolist(), predicted, mean, error, strict=True)
            ]
        fitted = [fitted_diffusion(lags, one) / width**2 for one in values]
        what = f"D r^2/w^2 a visit, w = {width:g}"
        rows.append(Row(1, what, math.inf, scale / width**2, *mean_of(fitted)))
        curves.append({"width": width, "lags": lags, "mean": mean, "error": error})
    return rows, curves


def two_ports(work: study.Study) -> list[Row]:
    """Make experiment 2."""
    changes = {
        "particles": {"urn1_number": 500}, "gate": {"threshold": 1000},
        "run": {"duration": work.pick(2.0e4, 4.0e5)},
    }  # fmt: skip
    events = particle_events(read_log(work.run("events", "ports", changes, alone=True)))
    circuit = theory.Circuit(1000, 1000)
    found, ratio = ports.disc(circuit), float(circuit.channel2_width)
    mixed = ratio / (ratio + float(circuit.channel1_width))
    stay = math.pi * float(circuit.urn_area) / (ratio + float(circuit.channel1_width))
    share, time = (mean_of(one) for one in after_channel2(events))
    return [
        Row(2, "share of crossings of channel 2 that are followed by another", mixed,
            found.return_chance, *share),
        Row(2, "mean stay in the urn after channel 2", stay, found.stay2, *time),
    ]  # fmt: skip


def of_halves(circuit: theory.Circuit, chi: float) -> tuple[Floats, float]:
    """Return (numbers inside urns 1 and 2, chi N) at a measured chi, urn 2 the fuller."""
    halves = 0.5 * float(circuit.number) * np.array([1.0 - chi, 1.0 + chi])
    inside = halves.copy()
    for _ in range(50):
        mine, other = predictions.held_in_channels(circuit, inside)
        inside = halves - mine - other[::-1]
    return inside, float(halves[1] - halves[0])


def sizes(work: study.Study) -> list[Row]:
    """Make experiment 3: conductance, and share through the sparse gate, for two sizes."""
    rows = []
    for radius, many in SIZES:
        slow = memory_time(theory.Circuit(1, 1, urn_radius=radius))
        transient = float(f"{3.0 * slow:.1e}")
        changes = {
            "table": {"urn_radius": radius},
            "particles": {"number": many, "urn1_number": many // 20},
            "gate": {"threshold": None},
            "run": {
                "duration": transient + work.pick(6.0e4, 4.0e5),
                "transient_duration": transient,
            },
            "scan": {"threshold": list(SIZED_T), "replicas": 4},
        }
        data = postproc.open_results(work.run("sizes", f"size_{radius:g}", changes))
        for threshold in SIZED_T:
            point = data.sel(threshold=threshold)
            circuit = theory.Circuit(many, threshold, urn_radius=radius, gate=RENEWAL)
            current = np.abs(point.current2.to_numpy())
            inside, apart = of_halves(circuit, float(point.chi.mean()))
            scale = predictions.mixed_conductance(circuit)
            share = (inside[1] - inside[0]) / apart
            predicted = share * ports.disc(circuit).conductance / scale
            name = f"r = {radius:g}, N = {many}, T = {threshold}"
            rows.append(
                Row(3, f"conductance over w'/(pi A), {name}", share, predicted,
                    *mean_of(current / (scale * apart)))
            )  # fmt: skip
            expected = float(theory.flow1(circuit, inside[0]))
            rows.append(
                Row(3, f"flow of the sparse gate over the renewal gate's, {name}", 1.0,
                    math.nan, *mean_of(point.flow1_12.to_numpy() / expected))
            )  # fmt: skip
    return rows


def circulation(work: study.Study) -> tuple[list[Row], list[dict]]:
    """Make experiment 4; return its rows, and the laws for the figure."""
    rows, laws = [], []
    logs, end = int(work.pick(2, 8)), work.pick(4.0e4, 8.0e4)
    for width, length in TURNS:
        count, dense, reached = [], [], np.zeros(circulations.ROUNDS.size)
        for seed in range(1, logs + 1):
            changes = {
                "table": {"channel2_width": width, "channel2_length": length},
                "particles": {"seed": 2000 + seed, "urn1_number": 35 if width < 0.015 else 62},
                "run": {"duration": end},
            }
            name = f"turns_{width:g}_{length:g}_{seed}".replace(".", "p")
            path = work.run("events", name, changes, alone=True)
            data, log = postproc.open_results(path), read_log(path)
            circuit = circuit_of(data)
            start = int(data.number) - int(data.urn1_number)
            events = particle_events(log)
            rounds = circulations.circulations(events, circuit).rounds
            count.append(np.count_nonzero(rounds == ROUNDS))
            reached += [np.count_nonzero(rounds == one) for one in circulations.ROUNDS]
            dense.append(circulations.urn_numbers(log, events, circuit, start, end)[1])
        time = end - circulations.TRANSIENT
        rate = sum(count) / (logs * time)
        error = max(math.sqrt(max(sum(count), 1)), float(np.std(count) * math.sqrt(logs)))
        held = float(np.mean(dense))
        predicted = circulation_rate(circuit, held, ROUNDS)
        what = f"begin {ROUNDS} rounds or more, per unit time, w' = {width:g}, l' = {length:g}"
        rows.append(Row(4, what, 0.0, predicted, rate, error / (logs * time)))
        laws.append({"width": width, "length": length, "rounds": circulations.ROUNDS,
                     "reached": reached, "time": logs * time,
                     "predicted": circulation_rate(circuit, held, 1.0)})  # fmt: skip
    return [*rows, ratio_of(rows[1], rows[0])], laws


def ratio_of(wide: Row, narrow: Row) -> Row:
    """Return the row of the ratio of two rates, that of the wider channel 2 over the other."""
    value = wide.measured / narrow.measured
    error = value * math.hypot(wide.error / wide.measured, narrow.error / narrow.measured)
    what = "ratio of these rates, w' = 0.02 over w' = 0.01, l' = 1"
    return Row(4, what, math.nan, wide.predicted / narrow.predicted, value, error)


def transition_after(
    work: study.Study, transient: float, lasting: float, replicas: int
) -> xr.DataArray:
    """Return chi, with dimensions threshold and replica, of runs after a transient."""
    changes = {
        "particles": {"seed": 31},
        "run": {"duration": transient + lasting, "transient_duration": transient},
        "scan": {"replicas": replicas},
    }
    name = f"transition_{transient:g}_{lasting:g}"
    return postproc.open_results(work.run("transition", name, changes)).chi


def transients(work: study.Study) -> list[Row]:
    """Make experiment 5: the shift of the upper transition by a transient that is too short.

    Runs begin at chi = 0.4 and end at 0.3 where the transition is defined; in an average over [t0,
    t] the deviation is (0.4 - 0.3) tau (exp(-t0/tau) - exp(-t/tau))/(t - t0), which is divided by
    the slope of chi in T.
    """
    lasting, replicas = 5.0e3, int(work.pick(48, 256))
    found = [transition_after(work, one, lasting, replicas) for one in TRANSIENTS]
    after = found[-1].mean("replica")
    chi, at = after.to_numpy(), after.threshold.to_numpy()
    slope = np.interp(HALFWAY, chi[::-1], np.gradient(chi, at)[::-1])
    share = [
        SLOW / lasting * (math.exp(-one / SLOW) - math.exp(-(one + lasting) / SLOW))
        for one in TRANSIENTS
    ]
    predicted = (0.4 - HALFWAY) * (share[0] - share[1]) / -float(slope)
    (one, its), (other, other_error) = (
        transition_of(one.threshold.to_numpy(), one.transpose("threshold", "replica").to_numpy())
        for one in found
    )
    what = "T of the upper transition, transient 500, less that with 5000"
    return [Row(5, what, 0.0, predicted, one - other, math.hypot(its, other_error))]


def tables(work: study.Study, rows: Sequence[dict]) -> None:
    """Write a table of each experiment."""
    for one in range(1, 6):
        lines = [line(row) for row in rows if row["experiment"] == one]
        head = ["quantity", "urns without memory", "memory", "measured", "off by"]
        work.table(f"experiment{one}", head, lines)


def line(row: dict) -> list[str]:
    """Return a line of a table."""
    known = row["predicted"] is not None and math.isfinite(row["predicted"])
    off = f"{(row['measured'] - row['predicted']) / row['error']:+.1f}" if known else "-"
    return [row["what"], number(row["mixed"], 4), number(row["predicted"], 4),
            value(row["measured"], row["error"]), off]  # fmt: skip


def value(found: float, error: float) -> str:
    """Return a measured value; small ones with a power of ten."""
    if abs(found) >= 1e-3 or found == 0.0:
        return measured(found, error)
    power = math.floor(math.log10(abs(found)))
    scaled = measured(found / 10.0**power, error / 10.0**power)
    return f"({scaled})e{power}"


def run(work: study.Study) -> None:
    """Make all five; store the numbers, write tables, draw `experiments`."""
    rows, curves = directions(work)
    rows += two_ports(work)
    rows += sizes(work)
    turned, laws = circulation(work)
    rows += turned + transients(work)
    numbers = {
        "rows": [asdict(row) for row in rows], "curves": curves, "laws": laws, "full": work.full,
    }  # fmt: skip
    stored = json.loads(work.keep("experiments", numbers).read_text(encoding="utf-8"))
    tables(work, stored["rows"])
    work.draw(picture.figure(stored), "experiments")


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

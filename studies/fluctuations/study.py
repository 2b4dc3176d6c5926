"""Counts of channel 2 with and against the current: tables and picture of the page beside.

Quick: a tenth of the time of the namelists, three minutes of two cores. --full: as the namelists
say, fifteen minutes of two cores, 2 GB of memory and 0.2 GB of disk. Tables that are made are kept;
--afresh makes them again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import f90nml
import numpy as np

import postproc
from postproc import study
from postproc.figures import style
from postproc.theory.circuit import Circuit
from studies.event_log import Circuit as Table
from studies.event_log import read_log
from studies.fluctuations.averages import (
    jackknife,
    moment_totals,
    moments,
    ratio_totals,
    slope_and_difference,
    summed,
)
from studies.fluctuations.counting import frozen_slope, renewal_chain
from studies.fluctuations.logs import passages, round_time
from studies.fluctuations.trains import Trains, begun

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

Rows = list[dict[str, object]]

CASES = {
    "free": "free (T = N)",
    "gated": "T = 7",
    "gated_reservoir": "T = 7, reservoir",
    "wide": "T = 12",
    "wide_reservoir": "T = 12, reservoir",
}
CIRCUITS = {
    "gated": Circuit(1000, 7),
    "wide": Circuit(1000, 12, channel2_width=0.0612),
    "small": Circuit(40, 40, 0.6, channel2_width=0.06, gate2_threshold=1),
}
LONGEST = 2**15  # passages of one train in a log, more than any has
BEGIN = {"gated": 55_000.0}  # age at which circulations are filled, later than the transient
SHORT = (0.5, 1.0, 2.0, 4.0)
LONG = (1.0, 4.0, 16.0, 64.0, 256.0, 1000.0, 4000.0, 10000.0, 25000.0, 50000.0, 100000.0)
FEWEST = 25  # counts of -j for a ratio
FEWEST_INTERVALS = 32  # for a variance, of all runs
COUNTS = (1, 2, 4)
SMALL_TIMES = (1.0, 3.0, 6.0, 9.0, 12.0, 15.0, 18.0, 24.0)
# the chain's counts: times, tilt and size of the Fourier transform
COUNTING = {
    "gated": ((1.0, 4.0, 16.0, 64.0, 128.0), -1.8, 256),
    "wide": ((1.0, 4.0, 16.0, 32.0), -0.35, 256),
    "small": (SMALL_TIMES, -0.7, 128),
}
LOGGED = {"gated": 35, "wide": 224}  # particles of urn 1 at the start of event logs
LOG_TIMES = (16.0, 64.0, 256.0, 1000.0)


@dataclass(frozen=True)
class Series:
    """Net counts of channel 2 by replica and interval.

    Attributes
    ----------
    counts : +1 for each crossing with the current, -1 against it.
    number1 : particles of urn 1 and its halves of the channels, at the end of each interval.
    flows : with the current and against it, shape (replica, 2).
    step : length of the intervals.
    response : by how much both flows of an interval grow for each particle that urn 1 has more at
        its beginning.
    """

    counts: Integers
    number1: Floats
    flows: Floats
    step: float
    response: tuple[float, float] = (0.0, 0.0)


def series_of(work: study.Study, name: str) -> Series:
    """Return the counts of the runs of a namelist."""
    groups = f90nml.read(work.place / f"{name}.nml")
    transient, duration = (groups["run"][key] for key in ("transient_duration", "duration"))
    length = work.pick(0.1, 1.0) * (duration - transient)
    path = work.run(name, name, {"run": {"duration": transient + length}})
    data = postproc.open_results(path, group="series").squeeze()
    time = data.time.to_numpy()
    step = float(time[1] - time[0])
    begin = min(BEGIN.get(name, transient), 0.5 * (transient + length))
    # A run may end just before its last entry.
    kept = (time > begin) & (time < time[-1])
    flows = [data[key].to_numpy()[:, kept] for key in ("flow2_21", "flow2_12")]
    net = (flows[0] - flows[1]) * step
    counts = np.rint(net)
    if not np.allclose(net, counts, atol=1e-6):
        message = f"{name}: flows of an interval are no whole counts"
        raise ValueError(message)
    number1 = data.urn1_number.to_numpy()[:, kept]
    polarised = name in CASES and name != "free"  # by itself: the gates are alike
    if polarised and (number1 >= 0.5 * groups["particles"]["number"]).any():
        message = f"{name}: urn 1 does not stay the sparse one"
        raise ValueError(message)
    means = np.column_stack([one.mean(axis=1) for one in flows])
    more = number1[:, :-1] - number1.mean()
    response = [float((more * one[:, 1:]).mean() / (more**2).mean()) for one in flows]
    return Series(counts.astype(int), number1, means, step, tuple(response))


def slopes(name: str, seen: Series, times: Sequence[float] = SHORT) -> Rows:
    """Return ln[P(j)/P(-j)]/j for each length and each j that has counts enough.

    `frozen` is the slope if crossings were independent, at the rates that go with the number of
    particles that urn 1 has at the beginning.
    """
    rows = []
    with_, against = seen.flows.mean(axis=0)
    number1, many = np.unique(seen.number1, return_counts=True)
    more = number1 - number1 @ many / many.sum()
    rates = [flow + more * slope for flow, slope in zip((with_, against), seen.response,
                                                        strict=True)]  # fmt: skip
    for time in times:
        whole = summed(seen.counts, round(time / seen.step))
        for j in range(1, 9):
            totals = ratio_totals(whole, j, seen.flows)
            if totals[:, :2].sum(axis=0).min() < FEWEST:
                continue
            found, error = jackknife(totals, lambda one, j=j: slope_and_difference(one, j))
            rows.append({
                "case": name, "t": time, "j": j, "with": int(totals[:, 0].sum()),
                "against": int(totals[:, 1].sum()), "slope": found[0], "error": error[0],
                "ln_flows": math.log(with_ / against), "difference": found[1],
                "difference_error": error[1],
                "frozen": frozen_slope(many.astype(float), *rates, time, j),
            })  # fmt: skip
    return rows


def variances(name: str, seen: Series) -> Rows:
    """Return the variance and third cumulant of counts per unit time, by length.

    Also 2 mean/variance, and how much of the variance goes with the mean number of urn 1.
    """
    rows = []
    mean, flow = seen.counts.mean() / seen.step, float(seen.flows.mean(axis=0).sum())
    spread = float(seen.number1.std())
    for time in LONG:
        length = round(time / seen.step)
        whole = summed(seen.counts, length)
        if whole.size < FEWEST_INTERVALS:
            continue
        numbers = summed(seen.number1, length) / length
        found, error = jackknife(moment_totals(whole, numbers, mean * time), moments)
        found, error = found / time, error / time
        twice = 2.0 * mean / found[0]
        rows.append({
            "case": name, "t": time, "intervals": whole.size, "current": mean, "both_flows": flow,
            "number1_spread": spread, "response_with": seen.response[0],
            "response_against": seen.response[1],
            "variance_rate": found[0], "error": error[0], "twice_mean_over_variance": twice,
            "twice_error": twice * error[0] / found[0], "number_part": found[2],
            "number_error": error[2], "third": found[1], "third_error": error[1],
        })  # fmt: skip
    return rows


def chains() -> Rows:
    """Return what the renewal chain has: slopes by time and count, and its limits."""
    rows: Rows = []
    for name, (times, tilt, size) in COUNTING.items():
        chain = renewal_chain(CIRCUITS[name])
        found = chain.slopes(times, COUNTS, tilt=tilt, size=size)
        with_, against = chain.flows2
        limits = {
            "ln_flows": math.log(with_ / against), "current": with_ - against,
            "affinity": chain.affinity, "last_variance": chain.last_variance(),
            "last_slope": chain.last_slope(),
        }  # fmt: skip
        for time, values in zip(times, found, strict=True):
            own = {f"slope_{j}": float(one) for j, one in zip(COUNTS, values, strict=True)}
            rows.append({"case": name, "t": time, **own, **limits})
    return rows


def modelled(spreads: Rows) -> Rows:
    """Return variances, third cumulants and slopes of independent crossings with trains.

    The flows are those of the rows of `variances`.
    """
    rows: Rows = []
    for name in LOGGED:
        rate, period = begun(CIRCUITS[name])
        own = next(row for row in spreads if row["case"] == name)
        with_, against = (0.5 * (own["both_flows"] + sign * own["current"]) for sign in (1, -1))
        flow = Trains(rate, period, 0.0, 0.0).flow
        model = Trains(rate, period, with_ - flow, against)
        for time in LONG:
            variance = model.cumulant(2, time)
            short = name == "gated" and time <= 256.0
            slope = model.slopes(time, COUNTS) if short else np.full(len(COUNTS), math.nan)
            rows.append({
                "case": name, "t": time, "train_flow": flow, "variance_rate": variance,
                "twice_mean_over_variance": 2.0 * model.current / variance,
                "third": model.cumulant(3, time),
                **{f"slope_{j}": float(one) for j, one in zip(COUNTS, slope, strict=True)},
            })  # fmt: skip
    return rows


def table_of(circuit: Circuit) -> Table:
    """Return a circuit as event logs take it."""
    return Table(circuit.number, channel1_width=circuit.channel1_width,
                 channel2_width=circuit.channel2_width)  # fmt: skip


def repeated(work: study.Study) -> Rows:
    """Return variances of counts with and without repeats, from event logs."""
    rows: Rows = []
    logs, begin, span = int(work.pick(2, 4)), 10_000.0, work.pick(4e3, 4e4)
    for name, at_start in LOGGED.items():
        counts = []  # log, with or without, interval
        for seed in range(logs):
            changes = {
                "table": {"channel2_width": CIRCUITS[name].channel2_width},
                "gate": {"threshold": CIRCUITS[name].threshold},
                "particles": {"seed": 840 + seed, "urn1_number": at_start},
                "run": {"duration": begin + span},
            }  # fmt: skip
            path = work.run("events", f"log_{name}", changes, alone=True)
            found = passages(read_log(path), table_of(CIRCUITS[name]))
            path.unlink()
            counts.append([found.counts(begin, begin + span, LOG_TIMES[0], repeats=one)
                           for one in (True, False)])  # fmt: skip
        for time in LOG_TIMES:
            row: dict[str, object] = {"case": name, "t": time}
            for at, label in enumerate(("all", "once")):
                whole = summed(np.array(counts)[:, at], round(time / LOG_TIMES[0]))
                totals = moment_totals(whole, np.zeros(whole.shape), float(whole.mean()))
                value, error = jackknife(totals, moments)
                row[f"current_{label}"] = float(whole.mean()) / time
                row[label], row[f"{label}_error"] = value[0] / time, error[0] / time
            rows.append(row)
    return rows


def small(work: study.Study) -> Rows:
    """Return slopes of the small circuit: all, without repeats, and with mixed urns.

    `model` is the slope of independent crossings with the trains that the logs have.
    """
    groups = f90nml.read(work.place / "small.nml")
    begin, end = (groups["run"][key] for key in ("transient_duration", "duration"))
    end = begin + work.pick(0.1, 1.0) * (end - begin)
    circuit = table_of(CIRCUITS["small"])
    counts, flows, trains = [], [], []
    for seed in range(int(work.pick(4, 20))):
        changes = {"particles": {"seed": 850 + seed}, "run": {"duration": end}}
        path = work.run("small", "log_small", changes, alone=True)
        found = passages(read_log(path), circuit)
        path.unlink()
        starts, sign, many = found.trains
        own = (starts >= begin) & (starts < end) & (sign == 1)
        trains.append(np.bincount(many[own], minlength=LONGEST))
        late = (found.time >= begin) & (found.time < end)
        kinds = ((late, True), (late & ~found.repeat, False))
        counts.append([found.counts(begin, end, 1.0, repeats=one) for _, one in kinds])
        flows.append([[(kept & (found.sign == one)).sum() / (end - begin) for one in (1, -1)]
                      for kept, _ in kinds])  # fmt: skip
    rates = np.mean(trains, axis=0) / (end - begin)
    flow = np.array(flows)  # log, kind, way
    model = Trains(rates[2:], round_time(circuit), rates[1], flow[:, 0, 1].mean())
    everywhere = np.full((1, 1), 6.0)
    rows: Rows = []
    for at, label in enumerate(("small", "small_once")):
        rows += slopes(label, Series(np.array(counts)[:, at], everywhere, flow[:, at], 1.0),
                       SMALL_TIMES)  # fmt: skip
    rows += slopes("small_reservoir", series_of(work, "small_reservoir"), SMALL_TIMES)
    for row in rows:
        del row["frozen"]
        whole, time = row["case"] == "small", float(row["t"])
        row["model"] = float(model.slopes(time, (int(row["j"]),))[0]) if whole else math.nan
        row["ln_single"] = math.log(model.with_ / model.against) if whole else math.nan
        row["current"] = model.current if whole else math.nan
        spread = summed(np.array(counts)[:, 0], round(time)).var() / time
        row["variance_rate"] = float(spread) if whole else math.nan
        row["less_once"], row["less_once_error"] = (
            without_repeats(np.array(counts), round(time), int(row["j"])) if whole
            else (math.nan, math.nan)
        )  # fmt: skip
        row["model_variance"] = model.cumulant(2, time) if whole else math.nan
    return rows


def without_repeats(counts: Integers, length: int, count: int) -> tuple[float, float]:
    """Return by how much the slope of all counts is above that without repeats, and its error.

    Parameters
    ----------
    counts : net counts of intervals, all and without repeats, shape (log, 2, interval).
    length : of the longer intervals, in those.
    count : j.
    """
    no_flows = np.ones((counts.shape[0], 2))
    totals = np.hstack([ratio_totals(summed(counts[:, kind], length), count, no_flows)[:, :2]
                        for kind in (0, 1)])  # fmt: skip
    value, error = jackknife(
        totals, lambda one: math.log(one[0] / one[1] * one[3] / one[2]) / count
    )  # fmt: skip
    return float(value), float(error)


def kept(work: study.Study, name: str, make: Callable[[], Rows]) -> Rows:
    """Return the rows of a table, those of the last time unless all is to be made afresh."""
    known = work.kept(name)
    if known is None or work.afresh:
        work.keep(name, {"rows": make()})
        known = work.kept(name)
    return [{key: math.nan if one is None else one for key, one in row.items()}
            for row in known["rows"]]  # fmt: skip


def run(work: study.Study) -> None:
    """Make everything of the page."""

    @cache
    def seen(name: str) -> Series:
        return series_of(work, name)

    def each(of: Callable[[str, Series], Rows]) -> Rows:
        return [row for name in CASES for row in of(name, seen(name))]

    found = {"slopes": kept(work, "slopes", lambda: each(slopes))}
    found["variances"] = kept(work, "variances", lambda: each(variances))
    found["trains"] = kept(work, "trains", lambda: modelled(found["variances"]))
    found["small"] = kept(work, "small", lambda: small(work))
    found["repeats"] = kept(work, "repeats", lambda: repeated(work))
    found["chain"] = kept(work, "chain", chains)
    for name, rows in found.items():
        work.table(name, list(rows[0]), [[_text(one) for one in row.values()] for row in rows])
    work.draw(figure(found), "fluctuations")


def _text(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.6g}"
    return str(value)


def _ratios(panel: Axes, rows: Rows) -> None:
    """Draw slopes over the logarithm of the ratio of flows against j."""
    marks = {("gated", 1.0): ("s", "C1", -0.12), ("wide", 0.5): ("^", "C3", 0.0),
             ("wide", 1.0): ("v", style.NAVY, 0.06), ("wide", 2.0): ("D", style.BROWN, 0.12)}
    for (name, time), (mark, colour, aside) in marks.items():
        own = [row for row in rows if row["case"] == name and row["t"] == time]
        j = np.array([row["j"] for row in own])
        flows = own[0]["ln_flows"]
        panel.errorbar(j + aside, [row["slope"] / flows for row in own],
                       [row["difference_error"] / flows for row in own], fmt=mark, color=colour,
                       ms=3.5, mfc="white", lw=0.9,
                       label=f"{CASES[name]}, t = {time:g}")  # fmt: skip
        panel.plot(j, [row["frozen"] / flows for row in own], "--", color=colour, lw=0.8)
    panel.axhline(1.0, color="black", lw=0.7)
    panel.set(xlabel="j", ylabel="slope over ln of ratio of flows", ylim=(0.8, 1.03),
              xticks=range(1, 7))  # fmt: skip
    panel.legend(fontsize=6.5, loc="lower left")


def _small(panel: Axes, rows: Rows, chain: Rows) -> None:
    """Draw slopes of j = 1 of the small circuit against the length of the intervals."""
    kinds = {"small": ("o", "C0", "all"), "small_once": ("D", "C2", "without repeats"),
             "small_reservoir": ("^", "C1", "reservoir")}  # fmt: skip
    for name, (mark, colour, label) in kinds.items():
        own = [row for row in rows if row["case"] == name and row["j"] == 1]
        aside = {"small": -0.2, "small_once": 0.2}.get(name, 0.0)
        panel.errorbar([row["t"] + aside for row in own], [row["slope"] for row in own],
                       [row["error"] for row in own], fmt=mark, color=colour, ms=3.5, mfc="white",
                       lw=0.9, label=label)  # fmt: skip
        if name == "small":
            panel.plot([row["t"] for row in own], [row["model"] for row in own], "--",
                       color=colour, lw=0.8, label="trains")  # fmt: skip
    own = [row for row in chain if row["case"] == "small"]
    panel.plot([row["t"] for row in own], [row["slope_1"] for row in own], ":", color="C1", lw=1.0,
               label="renewal chain")  # fmt: skip
    panel.set(xlabel="t (r/v)", ylabel="slope of j = 1, small circuit", ylim=(1.3, 2.2))
    panel.legend(fontsize=6.5, loc="upper right")


def _spreads(panel: Axes, found: dict[str, Rows]) -> None:
    """Draw variances over both flows against the length of the intervals."""
    for at, (name, label) in enumerate(CASES.items()):
        own = [row for row in found["variances"] if row["case"] == name]
        scale, time = own[0]["both_flows"], np.array([row["t"] for row in own])
        panel.errorbar(time * 1.06 ** (at - 2), [row["variance_rate"] / scale for row in own],
                       [row["error"] / scale for row in own], fmt="osD^v"[at], color=f"C{at}",
                       mfc="white", ms=3.5, lw=0.9, label=label)  # fmt: skip
        model = [row["variance_rate"] for row in found["trains"] if row["case"] == name]
        if not model:
            continue
        panel.plot(time, np.array(model[: time.size]) / scale, "--", color=f"C{at}", lw=0.8)
        both = [one + row["number_part"] for one, row in zip(model, own, strict=False)]
        panel.plot(time, np.array(both) / scale, ":", color=f"C{at}", lw=1.0)
    panel.set(xscale="log", yscale="log", xlabel="t (r/v)", ylabel="variance/t over sum of flows")
    panel.legend(fontsize=6.5, loc="upper left")


def figure(found: dict[str, Rows]) -> Figure:
    """Return slopes by j, slopes of the small circuit by t, and variances by t."""
    made = style.figure(style.PAGE, 3.0)
    panels = made.subplots(1, 3)
    _ratios(panels[0], found["slopes"])
    _small(panels[1], found["small"], found["chain"])
    _spreads(panels[2], found)
    return made


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

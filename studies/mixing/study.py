"""Measures the imperfect mixing of the urns, and its effect on the lifetimes of their chain.

Uses series that begin polarised (`lifetimes_*.nml`) as long as they are so. The flows out of either
urn are compared with those of a well mixed one of the same number, with the renewal gate: their
ratio, and the scatter of their counts about that (Fano factor: 1 for independent crossings, more if
they come in bursts, less if they repel each other). Then the polarised state's lifetime by the
chain, unchanged, with the sparse urn's outflow times 0.9, and with its two outflows times the
measured ratios; and the share of the discrepancy's logarithm that each change removes,

    1 - log(changed chain/measured)/log(chain/measured).

Prints a table, or JSON with `--json`. An interval of the series counts if chi has been above 0.2
from the start until the interval begins; chi within the interval does not matter. Particles in the
channels are counted as in the urns, as in the paper, unless `--occupation` is given.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from postproc import cli
from postproc.figures.passages import HIGH, LOW, MIDDLE, measured
from postproc.reading.results import FLOWS, Results, opened
from postproc.theory.chain import passage_times
from postproc.theory.circuit import flow1, flow2, half2_number
from postproc.theory.renewal import RENEWAL
from studies.common import study

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from postproc.figures.passages import Lifetime
    from postproc.reading.results import Series
    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

FACTOR = 0.9  # of the sparse urn's outflow in the changed chain
OUTFLOWS = ("dense1", "sparse1", "dense2", "sparse2")
LEAST = 50.0  # least number of crossings for a ratio and a scatter


@dataclass(frozen=True)
class Counts:
    """Crossings out of the dense and the sparse urn in intervals of series, a row for each outflow.

    Attributes
    ----------
    measured, expected : shape (4, interval), in the order of `OUTFLOWS`; counts, and those of well
        mixed urns, by the means of both ends of an interval.
    """

    measured: Floats
    expected: Floats

    def ratio(self) -> Floats:
        """Return measured over expected crossings of each outflow, NaN where there are few."""
        total, mean = self.measured.sum(axis=1), self.expected.sum(axis=1)
        enough = np.minimum(total, mean) > LEAST
        return np.where(enough, total / np.where(enough, mean, 1.0), math.nan)

    def scatter(self) -> Floats:
        """Return the Fano factors: variance of counts about ratio x expected, over their mean."""
        ratio = self.ratio()
        rest = self.measured - ratio[:, None] * self.expected
        return (rest**2).sum(axis=1) / np.maximum(self.measured.sum(axis=1), 1.0)


@dataclass(frozen=True)
class Mixing:
    """Measurements at a point, and the lifetimes of the chains.

    Attributes
    ----------
    intervals : number of intervals of the series.
    ratio, scatter : of `Counts`, by name of the outflow.
    lifetime : measured lifetime of the polarised state, with its circuit.
    chain : the polarised state's lifetime by the chain.
    chain_less : the same with the sparse urn's outflow times `FACTOR`.
    chain_measured : the same with the measured ratios of the sparse urn's two outflows instead.
    """

    intervals: int
    ratio: dict[str, float]
    scatter: dict[str, float]
    lifetime: Lifetime
    chain: float
    chain_less: float
    chain_measured: float

    def removed(self, changed: float) -> float:
        """Return the share of log(chain/measured) that a change of the chain removes.

        NaN if no run has left the state, or the chain is off by less than a factor of two.
        """
        if not self.lifetime.passages:
            return math.nan
        before = math.log(self.chain / self.lifetime.time)
        if abs(before) < math.log(2.0):
            return math.nan
        return 1.0 - math.log(changed / self.lifetime.time) / before

    def row(self) -> dict[str, object]:
        """Return the values for JSON."""
        circuit = self.lifetime.circuit
        return {
            "threshold": int(circuit.threshold),
            "channel1_length": float(circuit.channel1_length),
            "number": int(circuit.number),
            "intervals": self.intervals,
            **{f"ratio_{name}": value for name, value in self.ratio.items()},
            **{f"scatter_{name}": value for name, value in self.scatter.items()},
            "passages": self.lifetime.passages,
            "lifetime": self.lifetime.time,
            "chain": self.chain,
            "chain_less": self.chain_less,
            "chain_measured": self.chain_measured,
            "removed_less": self.removed(self.chain_less),
            "removed_measured": self.removed(self.chain_measured),
        }


def _shares(circuit: Circuit, halves: Floats) -> Floats:
    """Return the urns' shares of the particles (`Circuit`) from those of the halves."""
    if not circuit.occupation:
        return halves
    numbers = np.arange(int(circuit.number) + 1.0)
    return np.interp(halves, half2_number(circuit, numbers), numbers)


def polarised_counts(circuit: Circuit, series: Series) -> Counts:
    """Return the crossings of one series that begins polarised, until chi falls to `LOW`."""
    number, first = float(np.asarray(circuit.number)), series.urn1_number
    left = np.flatnonzero(np.abs(2.0 * first - number) <= LOW * number)
    last = int(left[0]) if left.size else first.size - 1
    width = np.diff(series.time)[:last]
    ahead1, back1, ahead2, back2 = (series.flows[name][1 : last + 1] * width for name in FLOWS)
    ends = np.array([first[:last], first[1 : last + 1]])
    first_dense = 2.0 * ends[0] > number  # as the interval begins
    dense = np.where(first_dense, ends, number - ends)
    counts = [
        np.where(first_dense, one, other)
        for one, other in ((ahead1, back1), (back1, ahead1), (ahead2, back2), (back2, ahead2))
    ]
    expected = [
        width * flow(circuit, _shares(circuit, half)).mean(axis=0)
        for flow in (flow1, flow2)
        for half in (dense, number - dense)
    ]
    return Counts(np.array(counts), np.array(expected))


def mixing(files: Sequence[Results], changes: dict[str, object]) -> list[Mixing]:
    """Return the measurements at each point that begins polarised, with one theory."""
    found = []
    for results in files:
        lifetimes = {one.circuit: one for one in measured([results]) if one.polarised}
        number, first = results.value("number"), results.value("urn1_number")
        polarised = np.abs(2.0 * first - number) > MIDDLE * number
        for point in np.flatnonzero(polarised & results.done.any(axis=1)):
            given = results.circuit(int(point))
            circuit = replace(given, **changes)
            parts = [
                polarised_counts(circuit, results.series(int(point), int(replica)))
                for replica in np.flatnonzero(results.done[point])
            ]
            counts = Counts(
                np.concatenate([part.measured for part in parts], axis=1),
                np.concatenate([part.expected for part in parts], axis=1),
            )
            ratio = dict(zip(OUTFLOWS, counts.ratio().tolist(), strict=True))
            scatter = dict(zip(OUTFLOWS, counts.scatter().tolist(), strict=True))
            sparse = (ratio["sparse1"], ratio["sparse2"])
            times = [
                passage_times(circuit, LOW, HIGH, factors)[1]
                for factors in ((1.0, 1.0), (FACTOR, FACTOR), sparse)
            ]
            found.append(Mixing(counts.measured.shape[1], ratio, scatter, lifetimes[given], *times))
    if not found:
        raise cli.InputError("mixing: no complete run begins polarised")
    return found


def table(found: Sequence[Mixing]) -> str:
    """Return the measurements as text, a line for each point."""
    lines = [
        f"{'':21s} {'flow over well mixed':>27s} {'Fano factor':>20s} "
        f"{'lifetime of the polarised state':>41s} {'log removed':>15s}",
        f"{'T':>2s} {'l':>4s} {'N':>5s} {'interv.':>7s} {'dense1':>6s} {'sparse1':>7s} "
        f"{'dense2':>6s} {'sparse2':>7s} {'dense1':>6s} {'sparse1':>7s} {'sparse2':>7s} "
        f"{'measured':>9s} {'chain':>9s} {f'x {FACTOR:g}':>9s} {'x ratios':>9s} "
        f"{f'x {FACTOR:g}':>7s} {'x ratios':>8s}",
    ]
    for one in found:
        circuit, ratio, scatter = one.lifetime.circuit, one.ratio, one.scatter
        lines.append(
            f"{circuit.threshold:2d} {circuit.channel1_length:4g} {circuit.number:5d} "
            f"{one.intervals:7d} {ratio['dense1']:6.3f} {ratio['sparse1']:7.3f} "
            f"{ratio['dense2']:6.3f} {ratio['sparse2']:7.3f} {scatter['dense1']:6.2f} "
            f"{scatter['sparse1']:7.2f} {scatter['sparse2']:7.2f} {one.lifetime.time:9.3g} "
            f"{one.chain:9.3g} {one.chain_less:9.3g} {one.chain_measured:9.3g} "
            f"{one.removed(one.chain_less):7.2f} {one.removed(one.chain_measured):8.2f}"
        )
    return "\n".join(lines)



def main(arguments: list[str] | None = None) -> int:
    """Print the mixing of the urns of runs, and its effect on the chain's lifetimes."""
    options = study.parser(__file__, __doc__)
    options.add_argument("files", metavar="FILE.h5", type=Path, nargs="+")
    options.add_argument(
        "--occupation", action="store_true", help="tell those in the channels from those in urns"
    )
    options.add_argument("--json", action="store_true", help="print JSON")
    given = options.parse_args(arguments)
    with opened(given.files) as files:
        for results in files:
            if results.shape != "circuit":
                raise cli.InputError(f"{results.path}: a run of shape '{results.shape}'")
            results.need_tasks()
        found = mixing(files, {"gate": RENEWAL, "occupation": given.occupation})
        for results in files:
            results.say_if_partial()
    if given.json:
        print(json.dumps(cli.finite([one.row() for one in found]), indent=2))
    else:
        print(table(found))
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

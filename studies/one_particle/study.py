"""One-particle theory against Fig. comp01.

Computes the theory at the 46 points with chi above 0.15 (comp01_polarised.json, the paper's
length). Prints a line for each point, and the error with three choices of points left out next to a
transition: none, the first and the last T of each w', or those without a polarised state in runs
and the next T to them. The transient of the runs is about 7e4 time units: by `transients` less than
0.3 % of a current are missing, except at w' = 0.0102 from T = 8 to 13, where it is 0.8 to 2.8 %.
Takes 46 times two seconds of one core.

With FILE.h5 ..., results of comp01_ends.nml, it prints for runs next to the transitions
instead: the density of chi next to 0, over that at its mode. A state is called polarised if this
ratio is below 1/e, for either initial state: if it is larger there is no barrier between the
polarities, and chi is the fluctuation of a homogeneous state.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from postproc import cli
from postproc.reading.grid import open_results
from postproc.reading.groups import series_of
from postproc.reading.points import by_point
from postproc.theory.circuit import Circuit
from studies.common import study
from studies.one_particle.walkers import stationary_states

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from studies.one_particle.walkers import Effort

KEPT = json.loads(Path(__file__).with_name("comp01_polarised.json").read_text(encoding="utf-8"))
HOLLOW = math.exp(-1.0)  # density of chi next to 0 over that at its mode, of polarised states
CELLS = np.arange(0.0, 1.0 + 0.05, 0.05)  # of chi


@dataclass(frozen=True)
class Point:
    """A point of the figure, measured by runs: w', T, chi and net current with their errors."""

    channel2_width: float
    threshold: int
    chi: float
    chi_error: float
    current: float
    current_error: float

    @property
    def circuit(self) -> Circuit:
        """Its circuit."""
        return Circuit(1000, self.threshold, 0.3, self.channel2_width)


POINTS = [Point(*one) for one in KEPT["points"]]
HOMOGENEOUS = {(width, threshold) for width, threshold, hollow in KEPT["hollow"]
               if hollow >= HOLLOW}  # fmt: skip


def but_ends(points: Sequence[Point]) -> list[Point]:
    """Return the points without the first and the last T of each w'."""
    chosen = []
    for point in points:
        own = [one.threshold for one in points if one.channel2_width == point.channel2_width]
        if min(own) < point.threshold < max(own):
            chosen.append(point)
    return chosen


def inner(points: Sequence[Point]) -> list[Point]:
    """Return the points without those that are not polarised in runs, and without the next T."""
    return but_ends([
        one for one in points if (one.channel2_width, one.threshold) not in HOMOGENEOUS
    ])  # fmt: skip


def off(point: Point, effort: Effort | None = None) -> tuple[float, float]:
    """Return theory minus runs for chi, and relative for the current; NaN without such a state."""
    states = stationary_states(point.circuit, effort)
    if not states:
        return math.nan, math.nan
    return states[-1].mass_spread - point.chi, states[-1].net_current / point.current - 1.0


def root_mean_square(found: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """Return the root mean squares of chi and current over the points that have a state."""
    return np.sqrt(np.nanmean(np.square(found), axis=0))


def hollow(spreads: NDArray[np.float64]) -> float:
    """Return the density of chi next to 0 over that at its mode."""
    density, _ = np.histogram(spreads, CELLS)
    return float(density[0] / density.max())


def print_hollow(paths: Sequence[Path]) -> None:
    """Print the density of chi next to 0, over that at its mode, for each point and start."""
    print(f"{'w2':>7} {'T':>3} {'chi(0)':>6} {'chi':>7} {'+-':>7} {'hollow':>7}")
    for path in paths:
        results = by_point(open_results(path))
        for at, circuit in enumerate(results["circuit"].values):
            point = results.isel(point=at, replica=results["complete"].values[at])
            chi, begun = point["chi"].values, point["transient_time"].values
            spreads = [
                np.abs(2.0 * one["urn1_number"].values / float(circuit.number) - 1.0)[
                    one["time"].values > past
                ]
                for one, past in zip(series_of(results, at), begun, strict=True)
            ]
            start = float(point["start"])
            error = float(chi.std(ddof=1)) / math.sqrt(chi.size)
            print(f"{float(circuit.channel2_width):7.4f} {int(circuit.threshold):3d} "
                  f"{start:6.2f} {chi.mean():7.4f} {error:7.4f} "
                  f"{hollow(np.concatenate(spreads)):7.2f}")  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    options = study.parser(__file__, __doc__)
    options.add_argument("files", metavar="FILE.h5", type=Path, nargs="*")
    files = options.parse_args(arguments).files
    if files:
        print_hollow(files)
        return 0
    found = {}
    print(f"{'w2':>7} {'T':>3} {'chi':>7} {'+-':>7} {'off':>8} {'current':>8} {'off':>7}")
    for point in POINTS:
        found[point] = spread, current = off(point)
        print(f"{point.channel2_width:7.4f} {point.threshold:3d} {point.chi:7.4f} "
              f"{point.chi_error:7.4f} {spread:+8.4f} {point.current:8.4f} "
              f"{100.0 * current:+6.1f}%", flush=True)  # fmt: skip
    rules = {"all": POINTS, "but the first and the last T of each w'": but_ends(POINTS),
             "but those without a polarised state and the next": inner(POINTS)}  # fmt: skip
    for rule, points in rules.items():
        differences = [found[one] for one in points]
        spread, current = root_mean_square(differences)
        without = int(np.isnan(differences)[:, 0].sum())
        print(f"{rule}: {len(points)} points, {without} of them without a state in theory, "
              f"chi {spread:.4f}, current {100.0 * current:.1f} %")  # fmt: skip
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

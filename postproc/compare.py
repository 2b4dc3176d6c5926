"""Measures theories against runs: by how much chi and the currents are off, and where the phase is.

Prints a table, or JSON with `--json`, for the paper's theory, for the renewal gate, and for the
renewal gate with the occupation of the channels counted. A point counts as polarised if chi exceeds
0.15. Differences of chi are taken at all points where the measurement is polarised, the same for
every theory (of two stable states the nearer one is taken), and again at those of them on the side
of the upper transition, where T is larger than where chi is largest; those of the net current where
the theory is polarised too. For the single urn only its current is compared, relative to theory,
where that exceeds a hundredth of the free current.

Then, to tell where the rest comes from, the four flows of polarised circuits, summed over points,
relative to those of the theory at the measured spread: out of the dense and of the sparse urn,
through channel 1 (where the gates' formula matters) and 2 (where only the mixing in the urns does).
"""

from __future__ import annotations

import json
import math
import sys
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from postproc import cli, theory
from postproc.gates import WINDOW
from postproc.points import gather
from postproc.renewal import RENEWAL
from postproc.results import FLOWS as RESULT_FLOWS
from postproc.results import Results
from postproc.states import stationary_states

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from postproc.points import Points
    from postproc.theory import Circuit

    Floats = NDArray[np.float64]

POLARISED = 0.15
THEORIES = (
    ("paper", {"gate": WINDOW}),
    ("renewal gate", {"gate": RENEWAL}),
    ("renewal gate, channels counted", {"gate": RENEWAL, "occupation": True}),
)


FLOWS = ("dense1", "sparse1", "dense2", "sparse2")


@dataclass(frozen=True)
class Comparison:
    """How far a theory is from runs.

    Attributes
    ----------
    theory : its name.
    points : how many points were compared.
    right_phase : share of them where homogeneous or polarised is told rightly.
    chi : mean of |measured - expected chi| over polarised points.
    upper_chi : the same over those with T above that of the largest chi of their N, w and w'.
    current : root mean square of (theory - measured)/theory of the net current over them; for the
        single urn, of its current.
    measured_chi : mean of the standard errors of chi there, the least to be hoped for.
    dense1, sparse1, dense2, sparse2 : measured flows over expected ones at the measured spread, of
        the dense and the sparse urn through channels 1 and 2, summed over polarised points.
    """

    theory: str
    points: int
    right_phase: float
    chi: float
    upper_chi: float
    current: float
    measured_chi: float
    dense1: float = math.nan
    sparse1: float = math.nan
    dense2: float = math.nan
    sparse2: float = math.nan


def _expected(circuit: Circuit, chi: float) -> tuple[float, float]:
    """Return chi and net current of the stable state nearest to the measured chi."""
    choices = [
        (state.mass_spread, state.net_current)
        for state in stationary_states(circuit)
        if state.kind == "stable"
    ]
    if theory.homogeneous_kind(circuit) != "unstable":
        choices.append((0.0, 0.0))
    return min(choices, key=lambda choice: abs(choice[0] - chi))


def _root_mean_square(values: Sequence[float]) -> float:
    return math.sqrt(np.mean(np.square(values))) if len(values) else math.nan


def flow_ratios(files: Sequence[Results], changes: dict[str, object]) -> dict[str, float]:
    """Return measured over expected flows (`Comparison`) of the polarised circuits of all files."""
    measured, expected = np.zeros(4), np.zeros(4)
    for results in files:
        chi = results.value("chi")
        flows = {name: results.value(name) for name in RESULT_FLOWS}
        polarised = results.done & (chi > POLARISED)
        for point in np.flatnonzero(polarised.any(axis=1)):
            circuit = replace(results.circuit(int(point)), **changes)
            spread = chi[point][polarised[point]]
            one, other = (0.5 * float(circuit.number) * (1.0 + sign * spread) for sign in (1, -1))
            expected += [
                flow(circuit, number).sum()
                for flow in (theory.flow1, theory.flow2)
                for number in (one, other)
            ]
            there = [flows[name][point][polarised[point]] for name in RESULT_FLOWS]
            first_dense = there[2] > there[3]
            for at, (ahead, back) in enumerate((there[:2], there[2:])):
                measured[2 * at] += np.where(first_dense, ahead, back).sum()
                measured[2 * at + 1] += np.where(first_dense, back, ahead).sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        return dict(zip(FLOWS, (measured / expected).tolist(), strict=True))


def compare_circuit(files: Sequence[Results], name: str, changes: dict[str, object]) -> Comparison:
    """Return how far one theory is from the circuits of all files."""
    points = gather(files)
    known = points.where(np.isfinite(points.chi))
    polarised, upper = known.chi > POLARISED, _upper(known)
    circuits = [
        replace(files[file].circuit(int(point)), **changes)
        for file, point in zip(known.file, known.point, strict=True)
    ]
    expected = [_expected(one, chi) for one, chi in zip(circuits, known.chi, strict=True)]
    chi, current = np.array(expected).T
    apart, both = np.abs(known.chi - chi), polarised & (current > 0.0)
    return Comparison(
        name,
        known.number.size,
        float(np.mean((chi > POLARISED) == polarised)),
        _mean(apart[polarised]),
        _mean(apart[polarised & upper]),
        _root_mean_square((current[both] - known.current[both]) / current[both]),
        _mean(known.chi_error[polarised]),
        **flow_ratios(files, changes),
    )


def _mean(values: Floats) -> float:
    return float(np.mean(values)) if values.size else math.nan


def _upper(points: Points) -> NDArray[np.bool_]:
    """Tell which points have a larger T than the one of their N, w and w' with the largest chi."""
    lines = np.stack([points.number, points.width1, points.width2])
    found = np.zeros(points.number.size, bool)
    for line in np.unique(lines, axis=1).T:
        own = np.flatnonzero((line == lines.T).all(axis=1))
        top = own[np.argmax(points.chi[own])]
        found[own] = points.threshold[own] > points.threshold[top]
    return found


def compare_urn(files: Sequence[Results], name: str, changes: dict[str, object]) -> Comparison:
    """Return how far one theory is from the currents of the single urns of all files."""
    points = gather(files)
    known = points.where(np.isfinite(points.current))
    relative = []
    for at in range(known.number.size):
        circuit = files[known.file[at]].circuit(int(known.point[at]))
        urn = replace(circuit, channel2_width=0.0, **changes)
        expected = float(theory.flow1(urn, urn.number))
        free = float(theory.flow1(replace(urn, threshold=urn.number), urn.number))
        if expected > 0.01 * free:
            relative.append((expected - known.current[at]) / expected)
    rest = (math.nan, math.nan, math.nan, _root_mean_square(relative), math.nan)
    return Comparison(name, len(relative), *rest)


def compare(files: Sequence[Results]) -> list[Comparison]:
    """Return the comparison of each theory with all files, which are of one shape."""
    shapes = {results.shape for results in files}
    if len(shapes) > 1:
        raise cli.InputError("compare needs files of one shape, circuit or urn")
    chosen = compare_circuit if shapes == {"circuit"} else compare_urn
    return [chosen(files, name, changes) for name, changes in THEORIES]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print how far each theory is from the runs."""
    options = cli.parser("compare", __doc__)
    options.add_argument("files", metavar="FILE.h5", type=Path, nargs="+")
    options.add_argument("--json", action="store_true", help="print JSON")
    given = options.parse_args(arguments)
    with ExitStack() as stack:
        files = [stack.enter_context(Results(path)) for path in given.files]
        for results in files:
            results.say_if_partial()
        found = compare(files)
    if given.json:
        rows = [
            {key: None if value != value else value for key, value in vars(one).items()}  # noqa: PLR0124 (NaN)
            for one in found
        ]
        print(json.dumps(rows, indent=2))
        return 0
    print(
        f"{'theory':32s} {'points':>6s} {'phase':>7s} {'chi':>9s} {'upper chi':>9s} "
        f"{'current':>9s} {'(error)':>9s}"
    )
    for one in found:
        print(
            f"{one.theory:32s} {one.points:6d} {one.right_phase:7.3f} {one.chi:9.2e} "
            f"{one.upper_chi:9.2e} {one.current:9.2e} {one.measured_chi:9.1e}"
        )
    if all(math.isnan(one.dense2) for one in found):
        return 0
    print("\nflows over those of the theory at the measured spread, polarised circuits")
    print(f"{'':32s} {'channel 1':>17s} {'channel 2':>17s}")
    print(f"{'theory':32s}" + 2 * f" {'dense':>8s} {'sparse':>8s}")
    for one in found:
        print(f"{one.theory:32s}" + "".join(f" {getattr(one, name):8.3f}" for name in FLOWS))
    return 0


if __name__ == "__main__":
    sys.exit(cli.run(main))

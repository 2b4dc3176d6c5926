"""Measures theories against runs: errors of chi and of the currents, and of the phase.

Prints a table, or JSON with `--json`, for the theories of well mixed urns, by name: the paper's
window and the renewal gate. A point counts as polarised if chi exceeds 0.15. Differences of chi are
taken at all points where the measurement is polarised, the same for every theory (of two stable
states the nearer one is taken), and again at those of them on the side of the upper transition,
where T is larger than at the largest chi; those of the net current where the theory is polarised
too. For the single urn only its current is compared, relative to theory, where that exceeds a
hundredth of the free current.

Then, to find the origin of the rest, the four flows of polarised circuits, summed over points,
relative to those of the theory at the measured spread: out of the dense and of the sparse urn,
through channel 1 (where the gates' formula matters) and 2 (where only the mixing in the urns does).
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from postproc import cli
from postproc.progress import each
from postproc.reading.points import gather
from postproc.reading.results import FLOWS as RESULT_FLOWS
from postproc.reading.results import Results, opened
from postproc.report.data import expected_state
from postproc.theory.circuit import flow1, flow2
from postproc.theory.models import MODELS
from studies.common import study

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from postproc.reading.points import Points
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]

THEORIES = ("window", "renewal")  # of well mixed urns
POLARISED = 0.15
COLUMNS = ("points", "right_phase", "chi", "upper_chi", "current", "measured_chi")
FLOWS = ("dense1", "sparse1", "dense2", "sparse2")


def flow_ratios(files: Sequence[Results], model: Model) -> dict[str, float]:
    """Return measured over expected flows of the polarised circuits of all files, by `FLOWS`."""
    measured, expected = np.zeros(4), np.zeros(4)
    for results in files:
        chi = results.value("chi")
        flows = {name: results.value(name) for name in RESULT_FLOWS}
        polarised = results.done & (chi > POLARISED)
        for point in np.flatnonzero(polarised.any(axis=1)):
            circuit = model.of(results.circuit(int(point)))
            spread = chi[point][polarised[point]]
            one, other = (0.5 * float(circuit.number) * (1.0 + sign * spread) for sign in (1, -1))
            expected += [
                flow(circuit, number).sum() for flow in (flow1, flow2) for number in (one, other)
            ]
            there = [flows[name][point][polarised[point]] for name in RESULT_FLOWS]
            first_dense = there[2] > there[3]
            for at, (ahead, back) in enumerate((there[:2], there[2:])):
                measured[2 * at] += np.where(first_dense, ahead, back).sum()
                measured[2 * at + 1] += np.where(first_dense, back, ahead).sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        return dict(zip(FLOWS, (measured / expected).tolist(), strict=True))


def compare_circuit(files: Sequence[Results], model: Model) -> dict[str, float]:
    """Return the differences of one theory from the circuits of all files."""
    points = gather(files)
    known = points.where(np.isfinite(points.chi))
    if known.number.size == 0:
        raise cli.InputError("no point has a mass spread chi to compare")
    polarised, upper = known.chi > POLARISED, _upper(known)
    circuits = [
        files[file].circuit(int(point)) for file, point in zip(known.file, known.point, strict=True)
    ]
    cases = list(zip(circuits, known.chi, strict=True))
    expected = [expected_state(model, *one) for one in each(cases, f"{model.label}, point")]
    chi, current = np.array(expected).T
    apart, both = np.abs(known.chi - chi), polarised & (current > 0.0)
    off = (current[both] - known.current[both]) / current[both]
    errors = known.chi_error[polarised]
    return {
        "points": known.number.size, "right_phase": np.mean((chi > POLARISED) == polarised),
        "chi": _mean(apart[polarised]), "upper_chi": _mean(apart[polarised & upper]),
        "current": math.sqrt(_mean(off**2)), "measured_chi": _mean(errors[np.isfinite(errors)]),
        **flow_ratios(files, model),
    }  # fmt: skip


def _mean(values: Floats) -> float:
    return float(np.mean(values)) if values.size else math.nan


def _upper(points: Points) -> NDArray[np.bool_]:
    """Tell which points have a larger T than the one of their N, w and w' with the largest chi."""
    lines = np.stack([points.number, points.channel1_width, points.channel2_width])
    found = np.zeros(points.number.size, bool)
    for line in np.unique(lines, axis=1).T:
        own = np.flatnonzero((line == lines.T).all(axis=1))
        top = own[np.argmax(points.chi[own])]
        found[own] = points.threshold[own] > points.threshold[top]
    return found


def compare_urn(files: Sequence[Results], model: Model) -> dict[str, float]:
    """Return the difference of one theory from the currents of single urns of all files."""
    points = gather(files)
    known = points.where(np.isfinite(points.current))
    relative = []
    for at in range(known.number.size):
        urn = files[known.file[at]].circuit(int(known.point[at]))
        expected = float(model.urn_current(urn))
        free = float(model.urn_current(replace(urn, threshold=urn.number)))
        if expected > 0.01 * free:
            relative.append((expected - known.current[at]) / expected)
    off = math.sqrt(_mean(np.square(relative)))
    return dict.fromkeys((*COLUMNS, *FLOWS), math.nan) | {"points": len(relative), "current": off}


def compare(files: Sequence[Results]) -> dict[str, dict[str, float]]:
    """Return by theory of well mixed urns its differences from all files, of one shape.

    `points`: how many; `right_phase`: share of them at which the theory has the right phase; `chi`,
    `upper_chi`: mean of |measured - expected chi| over all polarised points, and over those with T
    above that of the largest chi of their N, w and w'; `current`: root mean square of (theory -
    measured)/theory; `measured_chi`: mean standard error of chi; flows measured over expected.
    """
    shapes = {results.shape for results in files}
    if len(shapes) > 1:
        raise cli.InputError("compare needs files of one shape, circuit or urn")
    chosen = compare_circuit if shapes == {"circuit"} else compare_urn
    return {name: chosen(files, MODELS[name]) for name in THEORIES}


def main(arguments: list[str] | None = None) -> int:
    """Print the differences of each theory from the runs."""
    options = study.parser(__file__, __doc__)
    options.add_argument("files", metavar="FILE.h5", type=Path, nargs="+")
    options.add_argument("--json", action="store_true", help="print JSON")
    given = options.parse_args(arguments)
    with opened(given.files) as files:
        found = compare(files)
        for results in files:
            results.say_if_partial()
    if given.json:
        print(json.dumps(cli.finite(found), indent=2))
        return 0
    chosen = COLUMNS if all(math.isnan(one["dense2"]) for one in found.values()) else (
        *COLUMNS, *FLOWS)  # fmt: skip
    for name in chosen:
        print(
            f"{name:12s}" + "".join(f" {theory} {one[name]:9.3g}" for theory, one in found.items())
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

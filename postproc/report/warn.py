"""What a careful reader would object to in a run: transients, replicas that disagree, rays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from postproc.cli import InputError
from postproc.theory.circuit import flow2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.reading.results import Results, Snapshot
    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

UNLIKELY = 1e-4  # probability below which chance is not believed
DRIFT = 5.0  # standard errors between two quarters of a series
EXCESS = 0.05  # of the net current over what chi accounts for
BLOCKS = 8


def disagreement(values: Floats, errors: Floats) -> float:
    """Return the probability that replicas with these errors scatter as much by chance."""
    good = np.isfinite(values) & np.isfinite(errors) & (errors > 0.0)
    if np.count_nonzero(good) < 2:
        return 1.0
    value, weight = values[good], errors[good] ** -2
    mean = np.average(value, weights=weight)
    return float(stats.chi2.sf(np.sum(weight * (value - mean) ** 2), value.size - 1))


def _mean_of_blocks(values: Floats) -> tuple[float, float]:
    blocks = np.array([block.mean() for block in np.array_split(values, BLOCKS)])
    return float(blocks.mean()), float(blocks.std(ddof=1) / np.sqrt(BLOCKS))


def drifts(chi: Floats) -> bool:
    """Tell whether chi still moves over the second half of a series, where averages are taken."""
    late = chi[chi.size // 2 :]
    if late.size < 4 * BLOCKS:
        return False
    (one, error1), (other, error2) = (_mean_of_blocks(part) for part in np.array_split(late, 2))
    return abs(one - other) > max(DRIFT * np.hypot(error1, error2), 0.02)


def axial(circuit: Circuit, snapshot: Snapshot) -> int:
    """Return how many particles run so straight along the axis that they go round the circuit."""
    if circuit.channel2_width == 0.0:
        return 0
    half = 0.5 * circuit.channel2_width
    slope = snapshot.uy / np.where(snapshot.ux == 0.0, np.inf, snapshot.ux)
    steep = np.abs(snapshot.uy) >= np.abs(snapshot.ux)
    reach = np.abs(slope) * 2.0 * circuit.end
    return int(np.count_nonzero(~steep & (np.abs(snapshot.y) + reach < half)))


def warnings(results: Results) -> list[str]:
    """Return the warnings of a run, one sentence each, as plain text."""
    found = _unfinished(results)
    for point in range(results.points):
        if not results.done[point].any():
            continue
        name = _name(results, point)
        found += [f"{name}: {text}" for text in _of_replicas(results, point)]
        found += [f"{name}: {text}" for text in _of_current(results, point)]
        found += [f"{name}: {text}" for text in _of_series(results, point)]
        found += [f"{name}: {text}" for text in _of_snapshots(results, point)]
    return found


def _name(results: Results, point: int) -> str:
    circuit = results.circuit(point)
    return f"T = {circuit.threshold}, w' = {circuit.channel2_width:.4g}, N = {circuit.number}"


def _unfinished(results: Results) -> list[str]:
    missing = int(np.count_nonzero(~results.done))
    return [f"{missing} of {results.done.size} tasks have no results."] if missing else []


def _of_replicas(results: Results, point: int) -> list[str]:
    found = []
    for name, text in (("chi", "mass spreads"), ("current1", "net currents")):
        if not results.has(f"{name}_error"):
            continue
        values, errors = results.value(name)[point], results.value(f"{name}_error")[point]
        if disagreement(np.abs(values), errors) < UNLIKELY:
            listed = ", ".join(f"{abs(value):.4g}" for value in values if np.isfinite(value))
            found.append(
                f"the {text} of the replicas ({listed}) disagree beyond their block errors."
            )
    return found


def _of_current(results: Results, point: int) -> list[str]:
    """Compare the net current of channel 2 with what chi alone makes flow there."""
    if results.shape != "circuit" or not results.has("current2"):
        return []
    circuit = results.circuit(point)
    chi = results.replica_mean("chi")[0][point]
    mean, error = (part[point] for part in results.replica_mean("current2"))
    expected = float(flow2(circuit, chi * float(circuit.number)))
    if expected > 0.0 and mean - expected > max(EXCESS * expected, DRIFT * error) and chi > 0.1:
        return [
            f"the net current {mean:.3g} is more than the spread accounts for ({expected:.3g}): "
            "particles circulate on the axis."
        ]
    return []


def _of_series(results: Results, point: int) -> list[str]:
    number = float(results.circuit(point).number)
    moving = []
    for replica in np.flatnonzero(results.done[point]):
        try:
            series = results.series(point, int(replica))
        except InputError:
            return []
        if results.shape == "circuit" and drifts(np.abs(number - 2 * series.urn1_number) / number):
            moving.append(str(replica + 1))
    if not moving:
        return []
    return [f"chi still moves in the second half of replica {', '.join(moving)}: short transient."]


def _of_snapshots(results: Results, point: int) -> list[str]:
    try:
        count = axial(results.circuit(point), results.snapshot(point, 0, -1))
    except InputError:
        return []
    return [f"{count} particles of the last snapshot run along the axis."] if count else []

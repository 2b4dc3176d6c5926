"""Warnings about a run, and explanations of surprising points.

Warnings are about errors: tasks without results, transients that are too short, replicas that
disagree, currents that neither memory of the urns nor chance explains. Explanations are about
results that are right but surprising; there is one for all points concerned.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from scipy import stats

from postproc.cli import InputError
from postproc.figures.circuits import CHANGING, TOO_LONG, changes_within
from postproc.figures.style import brief
from postproc.reading.groups import each_series, snapshot_of
from postproc.reading.points import current_name, keys_of, means, second_values, with_first
from postproc.reporting.data import SYMBOLS, rounded_apart
from postproc.theory import ports
from postproc.theory.circuit import flow2
from postproc.theory.circulation import circulating_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.reading.groups import Snapshot
    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

UNLIKELY = 1e-4  # probability below which a difference is not taken for chance
DRIFT = 5.0  # standard errors between two halves of a series
EXCESS = 0.05  # of the net current over the one that chi explains
SPREAD = 0.3  # chi above which the current is compared: below, it scatters too much
BLOCKS = 8
FREEDOM = 3  # number of slowest components from which the error of a run is computed


def disagreement(values: Floats, errors: Floats) -> float:
    """Return the probability that replicas with these errors scatter that much by chance.

    Fisher's F of the variance of the replicas over the mean square of their errors, each of which
    has `FREEDOM` degrees of freedom.
    """
    good = np.isfinite(values) & np.isfinite(errors) & (errors > 0.0)
    size = np.count_nonzero(good)
    if size < 2:
        return 1.0
    ratio = np.var(values[good], ddof=1) / np.mean(errors[good] ** 2)
    return float(stats.f.sf(ratio, size - 1, FREEDOM * size))


def _mean_of_blocks(values: Floats) -> tuple[float, float]:
    blocks = np.array([block.mean() for block in np.array_split(values, BLOCKS)])
    return float(blocks.mean()), float(blocks.std(ddof=1) / np.sqrt(BLOCKS))


def drifts(chi: Floats) -> bool:
    """Tell whether chi still moves over that part of a series where averages are taken.

    The scatter is that of the second half: the first may have most of the way.
    """
    if chi.size < 4 * BLOCKS:
        return False
    (one, _), (other, error) = (_mean_of_blocks(part) for part in np.array_split(chi, 2))
    return abs(one - other) > max(DRIFT * math.sqrt(2.0) * error, 0.02)


def axial(circuit: Circuit, snapshot: Snapshot) -> int:
    """Return how many particles move so nearly along the axis that they circulate."""
    if circuit.channel2_width == 0.0:
        return 0
    half = 0.5 * circuit.channel2_width
    slope = snapshot.uy / np.where(snapshot.ux == 0.0, np.inf, snapshot.ux)
    steep = np.abs(snapshot.uy) >= np.abs(snapshot.ux)
    reach = np.abs(slope) * sum(side.end for side in circuit.sides)
    return int(np.count_nonzero(~steep & (np.abs(snapshot.y) + reach < half)))


def memory_factor(circuit: Circuit, chi: float) -> float:
    """Return the factor by which memory of the urns raises the net current at a chi.

    It is the conductance of two ports over that of well mixed urns, and what circulates along the
    axis at the age of the run.
    """
    if float(circuit.channel2_width) == 0.0:
        return 1.0
    mixed = ports.well_mixed(circuit).conductance
    spread = chi * float(circuit.number)
    circulates = circulating_at(circuit, 0.5 * (float(circuit.number) + spread), circuit.age)
    memory = max(ports.disc(circuit).conductance / mixed, 1.0)
    return memory + float(circulates) / float(flow2(circuit, spread))


def warnings(points: xr.Dataset) -> list[str]:
    """Return the warnings of a run, one sentence each, as plain text."""
    found, excess, (moving, changing) = _unfinished(points), _excess(points), _of_series(points)
    chi = means(points, "chi")[0]
    named = ["threshold", "channel2_width", "number", *keys_of(points), *second_values(points)]
    places = {name: rounded_apart(points[name].values) for name in with_first(named)}
    for at in np.flatnonzero(points["complete"].any("replica")):
        circuit = points["circuit"].values[at]
        told = _of_replicas(points.isel(point=at))
        told += _of_current(circuit, chi[at], *excess[:, at])
        if at in moving:
            told.append("chi still moves while averages are taken, in replica "
                        f"{', '.join(moving[at])}: short transient.")  # fmt: skip
        name = ", ".join(f"{SYMBOLS.get(key, key)} = {brief(values[at], 15)}"
                         for key, values in places.items())  # fmt: skip
        found += [f"{name}: {text}" for text in told]
    if coarse := np.count_nonzero(changing > CHANGING):
        told_of = f"At {coarse} of {changing.size} points {TOO_LONG.format(changing.max())}."
        found.append(told_of)
    return found


def explanations(points: xr.Dataset) -> list[str]:
    """Return explanations of right but surprising results, one sentence each."""
    found, count, two = [], points.sizes["point"], int(points["two_states"].sum())
    if two:
        found.append(
            f"At {two} of {count} points the replicas fall into two "
            "states. A mean of both would be a third, so none is shown."
        )
    excess, bound = _excess(points)
    above = excess[excess > bound]  # none whose error is not known
    if above.size:
        found.append(
            f"At {above.size} of {count} points the net current is more than chi accounts "
            f"for in well mixed urns, by up to {100.0 * above.max():.0f} %. That is no error: an "
            "urn remembers by which opening a particle came, so fewer go back by channel 2 than "
            "chance has it, and some circulate along the axis."
        )
    without_error = _points_without_error(points)
    if without_error:
        found.append(
            f"At {without_error} of {count} points an error is not known: one run "
            "cannot tell its own there. Replicas tell."
        )
    counts = _axial_of(points)
    if any(counts):
        found.append(
            f"{max(counts)} particles of a last snapshot run along the axis. They go round the "
            "circuit for long, so that net currents scatter more than one run shows."
        )
    return found


def _points_without_error(points: xr.Dataset) -> int:
    """Return the number of points at which chi or the current has a mean and no error."""
    names = {current_name(points), *(["chi"] if points.attrs.get("shape") != "urn" else [])}
    pairs = (means(points, name) for name in names)
    without_error = [np.isfinite(mean) & np.isnan(error) for mean, error in pairs]
    return int(np.count_nonzero(np.any(without_error, axis=0)))


def _unfinished(points: xr.Dataset) -> list[str]:
    asked = int(points["asked"].sum())
    missing = asked - int(points["complete"].sum())
    return [f"{missing} of {asked} tasks have no results."] if missing else []


def _of_replicas(point: xr.Dataset) -> list[str]:
    if point["two_states"]:
        return []
    found = []
    for name, text in (("chi", "mass spreads"), (current_name(point), "currents")):
        if f"{name}_error" not in point:
            continue
        values, errors = np.abs(point[name].values), point[f"{name}_error"].values
        if disagreement(values, errors) < UNLIKELY:
            listed = ", ".join(f"{value:.4g}" for value in values if np.isfinite(value))
            found.append(f"the {text} of the replicas ({listed}) disagree beyond their own errors.")
    return found


def _excess(points: xr.Dataset) -> Floats:
    """Return the relative excess of net currents over those that chi explains, and its bound.

    Shape (2, point). The latter are from the conductance of well mixed urns; NaN if not known. An
    excess above its bound is larger than `EXCESS`, and `UNLIKELY` by Student's t.
    """
    chi, (current, error) = means(points, "chi")[0], means(points, "polarised_current")
    explained = [
        float(flow2(circuit, spread * float(circuit.number)))
        if spread > SPREAD and circuit.shape == "circuit" and not circuit.beyond_theory
        else math.nan
        for circuit, spread in zip(points["circuit"].values, chi, strict=True)
    ]
    expected = np.where(np.array(explained) > 0.0, explained, math.nan)
    replicas = points["complete"].sum("replica").values
    limit = stats.t.isf(UNLIKELY, np.where(replicas > 1, replicas - 1, FREEDOM))
    return np.array([current / expected - 1.0, np.maximum(EXCESS, limit * error / expected)])


def _of_current(circuit: Circuit, chi: float, excess: float, bound: float) -> list[str]:
    """Compare the net current with the one that chi and memory of the urns, discs, explain."""
    if not excess > bound or circuit.outline is not None:  # or its error is not known
        return []
    most = memory_factor(circuit, chi) - 1.0  # takes up to half a second
    if not excess - most > bound:
        return []
    return [
        f"the net current is {100.0 * excess:.0f} % more than the spread accounts for, and memory "
        f"of the urns explains about {100.0 * most:.0f} %: a circulation as long as the run, or "
        "flips of the polarity. More replicas tell."
    ]


def _of_series(points: xr.Dataset) -> tuple[dict[int, list[str]], Floats]:
    """Return the replicas of each point in whose series chi still moves.

    And the share of intervals in which the fuller urn changes, a mean over replicas, of each point.
    """
    found: dict[int, list[str]] = {}
    changing = np.full(points["complete"].shape, np.nan)
    transient = points.get("transient_time", xr.zeros_like(points["complete"], float))
    number, start = points["number"].values, points["urn1_number"].values
    if points.attrs.get("shape") != "urn":
        with suppress(InputError):  # none was requested
            for at, one in each_series(points):
                replica = int(one["replica"])
                late = one["time"] > transient[at, replica]
                if drifts(one["chi"].values[late]):
                    found.setdefault(at, []).append(str(replica))
                changing[at, replica] = changes_within(one, number[at], start[at]).mean()
    known = np.isfinite(changing)
    return found, np.where(known, changing, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)


def _axial_of(points: xr.Dataset) -> list[int]:
    """Return how many particles of a last snapshot of each point move along the axis.

    Of its first complete replica; nothing if there are no snapshots.
    """
    done, counts = points["complete"].values, []
    with suppress(InputError):
        for at, circuit in enumerate(points["circuit"].values):
            if done[at].any() and circuit.shape == "circuit" and not circuit.scatterers:
                last = snapshot_of(points, at, int(done[at].argmax()), -1)
                counts.append(axial(circuit, last))
    return counts

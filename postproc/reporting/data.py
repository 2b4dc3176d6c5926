"""Data of the page about a run, as columns: points of the scan, theory, replicas, series."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

import contourpy
import numpy as np

from postproc.cli import InputError
from postproc.figures import style
from postproc.figures.circuits import mass_spread_of, polarised_current_of
from postproc.figures.maps import (
    THRESHOLDS,
    axes_of,
    edges,
    has_lines,
    map_of,
    places,
    transition_lines,
)
from postproc.reading.grid import groups_in
from postproc.reading.groups import each_series
from postproc.reading.points import current_name, groups, keys_of, second_values, with_first
from postproc.reading.table import table

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from numpy.typing import NDArray

    from postproc.theory.model import Model

    Floats = NDArray[np.float64]
    Columns = dict[str, NDArray[np.generic]]

SYMBOLS = {
    "number": "N", "threshold": "T", "threshold_fraction": "T/N", "channel1_width": "w",
    "channel1_length": "l", "channel2_width": "w'", "channel2_length": "l'", "urn_radius": "r",
    "threshold2": "T2", "urn_radius2": "r2",
}  # fmt: skip
MEASURED = {"chi": "mass spread chi", "current": "polarised current"}
OF_URN = {"current": "hits on the end wall, per unit time"}  # of the single urn
SAMPLES = (20, 300)  # least and most samples of a series on the page
ROOM = 250_000  # samples of all series together


@dataclass(frozen=True)
class Scan:
    """The scan of a run: its keys, with the value at each point, and those along axes, or "".

    `unequal` are the values of gates and urns that differ from each other, unless they are keys.
    """

    keys: Columns
    across: str
    up: str
    unequal: Columns

    @property
    def others(self) -> list[str]:
        """The keys that select a map."""
        return [name for name in self.keys if name not in (self.across, self.up)]


def scanned(points: xr.Dataset) -> Scan:
    """Return the scan; T is the horizontal axis of maps and w' the vertical one, if scanned."""
    keys = keys_of(points)
    across, up = axes_of(list(keys))
    shown = {name: rounded_apart(places(points, name)) for name in keys}
    names = with_first([*keys, *second_values(points)])
    unequal = {name: rounded_apart(points[name].values) for name in names if name not in keys}
    return Scan(shown, across or next(iter(keys), ""), up, unequal)  # starts alone


def label(name: str) -> str:
    """Return the label of a key on axes and heads of columns."""
    return f"{name} {SYMBOLS[name]}" if name in SYMBOLS else name


def rounded(values: Floats, digits: int = 5) -> Floats:
    """Return values rounded to some digits, which makes the page smaller."""
    return np.array([float(f"{value:.{digits}g}") for value in np.ravel(values)])


def rounded_apart(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return values rounded to the fewest digits, eight or more, at which they stay different."""
    return values if values.dtype.kind == "i" else rounded(values, style.digits_apart(values, 8))


def _to_error(value: float, error: float) -> float:
    """Return a value to five digits of its error, ten of its own at most; else with six."""
    if not 0.0 < error < math.inf:
        return float(f"{value:.6g}")
    return float(f"{round(value, 4 - math.floor(math.log10(error))) + 0.0:.10g}")  # no -0


def points_of(points: xr.Dataset, scan: Scan, models: dict[str, Model]) -> Columns:
    """Return the columns of the points: keys, measured values and errors, theory, their text."""
    columns = scan.keys | scan.unequal
    columns["start"], found = rounded(points["start"].values), table(points, theory=list(models))
    for name, source in (("chi", "chi"), ("current", current_name(points))):
        pairs = zip(found[source], found[f"{source}_error"], strict=True)
        columns[name] = np.array([_to_error(*pair) for pair in pairs])
        columns[f"{name}_error"] = rounded(found[f"{source}_error"], 2)
        columns |= {f"{model}_{name}": rounded(found[f"{model}_{source}"]) for model in models
                    if f"{model}_{source}" in found}  # fmt: skip
    columns["told"] = np.array(
        [
            _summary(scan, columns, at, apart=apart)
            for at, apart in enumerate(points["two_states"].values)
        ]
    )
    done, asked = (points[name].sum("replica").values for name in ("complete", "asked"))
    columns["tasks"] = np.array([f"{n} of {m}" for n, m in zip(done, asked, strict=True)])
    for low, high, key in (("left", "right", scan.across), ("bottom", "top", scan.up)):
        if key:
            values, at = np.unique(scan.keys[key], return_inverse=True)
            borders = edges(values.astype(float))
            if key not in THRESHOLDS:  # the cell of T = 0 begins below it
                borders = np.maximum(borders, 0.0)
            columns[low], columns[high] = borders[at], borders[at + 1]
    for name in MEASURED:
        columns[f"{name}_low"] = columns[name] - columns[f"{name}_error"]
        columns[f"{name}_high"] = columns[name] + columns[f"{name}_error"]
    return columns


def _summary(scan: Scan, columns: Columns, at: int, *, apart: bool) -> str:
    """Return the line about a point: its keys and measured values, or that replicas are apart."""
    place = [f"{SYMBOLS.get(name, name)} = {style.brief(columns[name][at], 15)}"
             for name in scan.keys | scan.unequal]  # fmt: skip
    known = ((name, columns[name][at], columns[f"{name}_error"][at]) for name in MEASURED)
    found = [f"{name} {with_error(*values, ' (error not known)')}"
             for name, *values in known if math.isfinite(values[0])]  # fmt: skip
    none = "replicas in two states, which have no mean" if apart else "no results yet"
    return ": ".join(part for part in (", ".join(place), ", ".join(found) or none) if part)


def map_lines(points: xr.Dataset, scan: Scan, models: dict[str, Model]) -> Columns:
    """Return lines between a stable and an unstable homogeneous state, one row for each line.

    Over T and w' they are the theory's own lines; over other keys they lie between points of the
    scan.
    """
    rows: list[dict[str, object]] = []
    drawn = scan.up and not any(one.beyond_theory or one.shape != "circuit"
                                for one in points["circuit"].values)  # fmt: skip
    # As at the points, so that a selector finds both.
    shown = {name: dict(zip(points[name].values, scan.keys[name], strict=True))
             for name in scan.others}  # fmt: skip
    find = _transition if has_lines((scan.across, scan.up)) else _between
    for values, part in groups(points, *scan.others) if drawn else ():
        chosen = {name: shown[name][value] for name, value in values.items()}
        for model in models.values():
            for across, up in find(part, scan, model):
                rows.append({"xs": across, "ys": up, "dash": dash(model), **chosen})
    return {name: [row[name] for row in rows] for name in ("xs", "ys", "dash", *scan.others)}


def dash(model: Model) -> str:
    """Return the library's name of a model's dashes."""
    return {"--": "dashed", ":": "dotted", "-.": "dashdot"}.get(model.dashes, "solid")


def _transition(points: xr.Dataset, scan: Scan, model: Model) -> list[tuple[Floats, Floats]]:
    number = float(points["number"][0]) if scan.across == "threshold" else 1.0
    return [(rounded(number * fraction[np.isfinite(widths)]), rounded(widths[np.isfinite(widths)]))
            for fraction, widths, *_ in transition_lines(points, [model])]  # fmt: skip


def _between(points: xr.Dataset, scan: Scan, model: Model) -> list[tuple[Floats, Floats]]:
    kinds = [model.homogeneous_kind(one) == "unstable" for one in points["circuit"].values]
    unstable = map_of(points, (scan.across, scan.up), np.array(kinds, float))
    if min(unstable.shape) < 2:
        return []
    made = contourpy.contour_generator(
        unstable.columns, unstable.index, np.ma.masked_invalid(unstable)
    )
    return [(line[:, 0], line[:, 1]) for line in made.lines(0.5)]


def replicas_of(points: xr.Dataset) -> Columns:
    """Return the columns of the tasks, replica by replica of each point, as texts.

    A value and its error are in one column, so that the table fits on a telephone.
    """
    count, replicas = points["complete"].shape
    tasks = {str(name): one.values.ravel() for name, one in points.items()
             if one.dims == ("point", "replica")}  # fmt: skip
    columns: Columns = {"replica": np.tile(np.arange(replicas), count)}
    for name, source in {"chi": "chi", "current": current_name(points)}.items():
        if source in tasks:
            values = zip(tasks[source], tasks[f"{source}_error"], strict=True)
            columns[name] = np.array([with_error(*one) for one in values])
    columns["collisions"] = np.array([f"{one:.2e}".replace("e+0", "e").replace("e+", "e")
                                      for one in tasks["collisions"]])  # fmt: skip
    columns["seconds"] = np.array([f"{one:.2g}" for one in tasks["cpu_seconds"]])
    for name in list(columns)[1:]:
        columns[name] = np.where(tasks["complete"], columns[name], "-")
    return columns


def with_error(value: float, error: float, unknown: str = "") -> str:
    """Return a value with its error, both to the first digit of that; "-": no value."""
    if not math.isfinite(value):
        return "-"
    if not math.isfinite(error):
        return f"{value:.6g}{unknown}"
    if error <= 0.0:
        return f"{value + 0.0:.10g} ± 0"  # no -0
    places = max(-math.floor(math.log10(error)), 0)
    return f"{round(value, places) + 0.0:.{places}f} ± {error:.{places}f}"  # no -0.0


def thinned_series(points: xr.Dataset) -> tuple[Floats, Columns]:
    """Return times, and chi and polarised current of all tasks one after the other, thinned.

    Of the single urn its net current. Nothing if the run has no series, or is shorter than their
    interval. If there are too many, only those of the first tasks.
    """
    shape = points["complete"].shape
    samples = int(np.clip(ROOM // max(points["complete"].size, 1), *SAMPLES))
    found: dict[tuple[int, int], xr.Dataset] = {}
    with suppress(InputError):  # none was requested
        for at, one in islice(each_series(points), ROOM // samples):
            found[at, int(one["replica"])] = one
    if not found:
        return np.empty(0), {}
    time = max((one["time"].values for one in found.values()), key=len)
    chosen = np.unique(np.linspace(0, time.size - 1, samples).round().astype(int))
    number, start = points["number"].values.astype(float), points["urn1_number"].values
    spread = np.full((*shape, chosen.size), np.nan, np.float32)
    current = spread.copy()
    for task, one in found.items():
        own, at = one["time"].values, task[0]
        chi, flows = (find(one, number[at], start[at])[1]
                      for find in (mass_spread_of, polarised_current_of))  # fmt: skip
        if points.attrs.get("shape") == "urn":
            flows = (one["flow1_12"] - one["flow1_21"]).values
        past = np.searchsorted(own, time[chosen], side="right")  # entries so far; 0: the start
        within = np.minimum(np.searchsorted(own, time[chosen]), own.size - 1)  # of an interval
        reached = time[chosen] <= own[-1]
        spread[task] = np.where(reached, chi[past], np.nan)
        current[task] = np.where(reached, _block_means(flows, within), np.nan)
    return rounded(time[chosen]), {"spread": spread.ravel(), "current": current.ravel()}


def _block_means(values: Floats, ends: Sequence[int]) -> Floats:
    """Return means over the entries after one end up to the next."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    last = np.asarray(ends) + 1
    first = np.minimum(np.concatenate([[0], last[:-1]]), last - 1)
    return (sums[last] - sums[first]) / (last - first)


def namelist_of_point(points: xr.Dataset) -> tuple[str, Columns]:
    """Return the run's namelist with `@KEY@` for each key scanned, and its values at the points.

    Empty for merged results of several namelists.
    """
    text, values = str(points.attrs.get("namelist", "")), {}
    groups = groups_in(text)
    group = groups.get("scan", {})
    for key in list(group):
        name = key.removesuffix("_range")
        # Where urns or gates are alike at all points, those of 2 are those of 1.
        source = name if name in points else name.removesuffix("2")
        if source in points:
            del group[key]
            group[name] = f"@{name}@"
            values[name] = np.broadcast_to(points[source].values, points.sizes["point"])
    return str(groups) if groups else text, values

"""Data of the page about a run, as columns: points of the scan, theory, replicas, series."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import contourpy
import f90nml
import numpy as np

from postproc.cli import InputError
from postproc.figures.maps import THRESHOLDS, WIDTH, axes_of, edges
from postproc.progress import each

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from postproc.reading.points import Points
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]
    Columns = dict[str, NDArray[np.generic]]

SYMBOLS = {
    "number": "N", "threshold": "T", "threshold_fraction": "T/N", "channel1_width": "w",
    "channel1_length": "l", "channel2_width": "w'", "channel2_length": "l'", "urn_radius": "r",
}  # fmt: skip
MEASURED = {"chi": "mass spread chi", "current": "polarised current"}
SAMPLES = (20, 300)  # least and most samples of a series on the page
ROOM = 250_000  # samples of all series together


@dataclass(frozen=True)
class Scan:
    """The scan of a run.

    Attributes
    ----------
    keys : values at each point, by the name of the key, for keys with more than one value.
    across, up : the keys along the axes of the maps, "" for none.
    """

    keys: Columns
    across: str
    up: str

    @property
    def others(self) -> Columns:
        """The keys that select a map."""
        return {name: at for name, at in self.keys.items() if name not in (self.across, self.up)}

    def slices(self) -> Iterator[tuple[dict[str, object], NDArray[np.int_]]]:
        """Iterate over the values of `others`, and the points that have them."""
        others = self.others
        for chosen in product(*(np.unique(values) for values in others.values())):
            there = np.ones(next(iter(self.keys.values())).size, bool)
            for values, one in zip(others.values(), chosen, strict=True):
                there &= values == one
            if there.any():
                yield dict(zip(others, chosen, strict=True)), np.flatnonzero(there)


def scanned(points: Points) -> Scan:
    """Return the scan; T is the horizontal axis of maps and w' the vertical one, if scanned."""
    across, up = axes_of(list(points.keys))
    if not across and points.keys:  # starts alone
        across = next(iter(points.keys))
    return Scan(points.keys, across, up)


def label(name: str) -> str:
    """Return the label of a key on axes and heads of columns."""
    return f"{name} {SYMBOLS[name]}" if name in SYMBOLS else name


def rounded(values: Floats, digits: int = 5) -> Floats:
    """Return values rounded to some digits, which makes the page smaller."""
    return np.array([float(f"{value:.{digits}g}") for value in np.ravel(values)])


def points_of(points: Points, scan: Scan, models: dict[str, Model]) -> Columns:
    """Return the columns of the points: keys, measured values and errors, theory, their text."""
    done, requested = points.done.sum(axis=1), points.asked.sum(axis=1)
    columns = {name: values if values.dtype.kind == "i" else rounded(values)
               for name, values in scan.keys.items()}  # fmt: skip
    columns |= {name: rounded(getattr(points, name), 2 if name.endswith("_error") else 5)
                for name in ("start", "chi", "chi_error", "current", "current_error")}  # fmt: skip
    for name, model in models.items():
        found = [_expected(points, model, at)
                 for at in each(range(points.chi.size), f"{model.label}, point")]  # fmt: skip
        spread, current = np.array(found).T
        columns[f"{name}_chi"], columns[f"{name}_current"] = rounded(spread), rounded(current)
    columns["told"] = np.array([_summary(scan, columns, at) for at in range(points.chi.size)])
    columns["tasks"] = np.array([f"{n} of {m}" for n, m in zip(done, requested, strict=True)])
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


def _expected(points: Points, model: Model, point: int) -> tuple[float, float]:
    """Return chi and current of the stable state that a theory reaches from the runs' start."""
    if points.beyond_theory(point):
        return math.nan, math.nan
    circuit = points.circuit(point)
    if points.shape != "circuit":
        return math.nan, float(model.urn_current(circuit))
    if (
        model.refusal(circuit)
        or (state := model.reached(circuit, points.number2_at_start(point))) is None
    ):
        return math.nan, math.nan
    return state.mass_spread, state.net_current


def _summary(scan: Scan, columns: Columns, at: int) -> str:
    """Return the line about a point: its keys and measured values."""
    place = [f"{SYMBOLS.get(name, name)} = {columns[name][at]:.5g}" for name in scan.keys]
    found = [
        f"{name} {columns[name][at]:.4g} ± {columns[f'{name}_error'][at]:.1g}".replace(
            "± nan", "(error not known)"
        )
        for name in MEASURED
        if math.isfinite(columns[name][at])
    ]
    return ": ".join(
        part for part in (", ".join(place), ", ".join(found) or "no results yet") if part
    )


def map_lines(points: Points, scan: Scan, models: dict[str, Model]) -> Columns:
    """Return lines between a stable and an unstable homogeneous state, one row for each line.

    Over T and w' they are the theory's own lines; over other keys they lie between points of the
    scan.
    """
    rows: list[dict[str, object]] = []
    drawn = points.shape == "circuit" and scan.up
    drawn = drawn and not any(map(points.beyond_theory, range(len(points))))
    for chosen, there in scan.slices() if drawn else ():
        for model in models.values():
            find = _transition if _own_axes(scan) else _between
            for across, up in find(points, scan, model, there):
                rows.append({"xs": across, "ys": up, "dash": dash(model), **chosen})
    names = ("xs", "ys", "dash", *scan.others)
    return {name: [row[name] for row in rows] for name in names}


def dash(model: Model) -> str:
    """Return the library's name of a model's dashes."""
    return {"--": "dashed", ":": "dotted", "-.": "dashdot"}.get(model.dashes, "solid")


def _own_axes(scan: Scan) -> bool:
    return scan.across in THRESHOLDS and scan.up == WIDTH


def _transition(
    points: Points, scan: Scan, model: Model, there: NDArray[np.int_]
) -> list[tuple[Floats, Floats]]:
    circuits = [points.circuit(int(at)) for at in there]
    last = max(int(one.threshold) for one in circuits) + 1
    thresholds, widths = model.transition_line(circuits[0], 1, last)
    if scan.across != "threshold":
        thresholds = thresholds / float(circuits[0].number)
    good = np.isfinite(widths)
    return [(rounded(thresholds[good]), rounded(widths[good]))]


def _between(
    points: Points, scan: Scan, model: Model, there: NDArray[np.int_]
) -> list[tuple[Floats, Floats]]:
    values, at = zip(
        *(np.unique(scan.keys[key][there], return_inverse=True) for key in (scan.across, scan.up)),
        strict=True,
    )
    if min(one.size for one in values) < 2:
        return []
    unstable = np.full((values[1].size, values[0].size), math.nan)
    kinds = [model.homogeneous_kind(points.circuit(int(point))) for point in there]
    unstable[at[1], at[0]] = [kind == "unstable" for kind in kinds]
    made = contourpy.contour_generator(*values, np.ma.masked_invalid(unstable))
    return [(line[:, 0], line[:, 1]) for line in made.lines(0.5)]


def curves(columns: Columns, scan: Scan, models: dict[str, Model], name: str) -> list[dict]:
    """Return theory beside a scan of one key: x, y and dashes of each model."""
    order = np.argsort(columns[scan.across])
    return [
        {
            "x": columns[scan.across][order],
            "y": columns[f"{key}_{name}"][order],
            "line_dash": dash(model),
        }
        for key, model in models.items()
    ]


def replicas_of(points: Points) -> Columns:
    """Return the columns of the tasks, replica by replica of each point, as texts.

    A value and its error are in one column, so that the table fits on a telephone.
    """
    done = points.done.ravel()
    columns: Columns = {"replica": np.tile(np.arange(points.replicas), len(points))}
    for name, source in {"chi": "chi", "current": points.current_name}.items():
        if points.has(source):
            values = zip(points.value(source).ravel(), points.value(f"{source}_error").ravel(),
                         strict=True)  # fmt: skip
            columns[name] = np.array([_with_error(*one) for one in values])
    columns["collisions"] = np.array([f"{one:.2e}".replace("e+0", "e").replace("e+", "e")
                                      for one in points.value("collisions").ravel()])  # fmt: skip
    columns["seconds"] = np.array([f"{one:.2g}" for one in points.value("cpu_seconds").ravel()])
    for name in list(columns)[1:]:
        columns[name] = np.where(done, columns[name], "-")
    return columns


def _with_error(value: float, error: float) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.4g} ± {error:.1g}" if math.isfinite(error) else f"{value:.4g}"


def series_of(points: Points) -> tuple[Floats, Columns]:
    """Return times, and (N1 - N2)/N and net current of all tasks one after the other, thinned.

    Nothing if the run has no series, or is shorter than their interval. If there are too many, only
    those of the first replicas.
    """
    tasks = np.argwhere(points.done)
    found = {}
    samples = int(np.clip(ROOM // max(points.done.size, 1), *SAMPLES))
    for point, replica in tasks[: ROOM // samples].tolist():
        with suppress(InputError):  # none, or shorter than the interval
            found[point, replica] = points.series(point, replica)
    if not found:
        return np.empty(0), {}
    time = max((one.time for one in found.values()), key=len)
    chosen = np.unique(np.linspace(0, time.size - 1, samples).round().astype(int))
    spread = np.full((*points.done.shape, chosen.size), np.nan, np.float32)
    current = spread.copy()
    for (point, replica), one in found.items():
        flows = one.flows["flow1_12"] - one.flows["flow1_21"]
        past = np.searchsorted(one.time, time[chosen], side="left")
        past = np.minimum(past, one.time.size - 1)
        reached = time[chosen] <= one.time[-1]
        chi = 2.0 * one.urn1_number[past] / points.number[point] - 1.0
        spread[point, replica] = np.where(reached, chi, np.nan)
        current[point, replica] = np.where(reached, _block_means(flows, past), np.nan)
    return rounded(time[chosen]), {"spread": spread.ravel(), "current": current.ravel()}


def _block_means(values: Floats, ends: Sequence[int]) -> Floats:
    """Return means over the entries after one end up to the next."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    last = np.asarray(ends) + 1
    first = np.minimum(np.concatenate([[0], last[:-1]]), last - 1)
    return (sums[last] - sums[first]) / (last - first)


def namelist_of_point(points: Points, scan: Scan) -> str:
    """Return the run's namelist with one value for each key scanned, `@KEY@` in its place."""
    text = str(points.attrs.get("namelist", ""))
    try:
        groups = f90nml.reads(text)
    except Exception:  # of any class, where the program accepts more than this reader
        return text
    group = groups.get("scan", {})
    for key in list(group):
        name = key.removesuffix("_range")
        if name in scan.keys:
            del group[key]
            group[name] = f"@{name}@"
    return str(groups)

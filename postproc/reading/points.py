"""The points of a dataset one after the other: means over replicas, circuits, series, snapshots."""

from __future__ import annotations

import math
import sys
from contextlib import ExitStack, contextmanager
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from postproc.cli import InputError
from postproc.reading.results_file import ResultsFile
from postproc.theory.circuit import PAPERS_AGE, Circuit
from postproc.theory.gates import WINDOW
from postproc.theory.outlines import outline_of, regular

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from postproc.theory.gates import Gate
    from postproc.theory.outlines import Outline

    Floats = NDArray[np.float64]

#: What makes a point, scanned or not.
PARAMETERS = (
    "number", "threshold", "threshold2", "urn1_number", "urn_radius", "urn_radius2",
    "channel1_width", "channel1_length", "channel2_width", "channel2_length",
)  # fmt: skip
FLOWS = ("flow1_12", "flow1_21", "flow2_12", "flow2_21")
COMPLETE, NOT_ASKED = 0, 3  # values of `task_status`
TWO_STATES = 2  # value of `point_status`


@dataclass(frozen=True)
class Series:
    """Series of one task.

    Attributes
    ----------
    time : ends of the intervals, shape (time,).
    urn1_number : N1 at that time, shape (time,).
    flows : crossings per unit time since the entry before, by name, each of shape (time,).
    """

    time: Floats
    urn1_number: Floats
    flows: dict[str, Floats]


@dataclass(frozen=True)
class Snapshot:
    """All particles of one task at one time; positions and velocities of shape (particle,)."""

    time: float
    x: Floats
    y: Floats
    ux: Floats
    uy: Floats


def mean_error(values: xr.DataArray, own_error: xr.DataArray | None = None) -> xr.Dataset:
    """Return the mean over replicas and its standard error.

    The error is the scatter of n >= 2 complete replicas over sqrt(n); for one replica it is the
    run's own.

    Parameters
    ----------
    values
        A variable of `open_results` with the dimension `replica`; NaN where a task is not complete.
    own_error
        The same variable with `_error`; without it the error of one replica is NaN.

    Returns
    -------
    xarray.Dataset
        `mean`, `error` and `replicas`, how many are complete.

    Examples
    --------
    >>> import xarray as xr
    >>> found = mean_error(xr.DataArray([0.2, 0.3, float("nan")], dims="replica"))
    >>> round(float(found["mean"]), 3), round(float(found["error"]), 3), int(found["replicas"])
    (0.25, 0.05, 2)
    """
    good = values.notnull() & (abs(values) < math.inf)
    count = good.sum("replica")
    scatter = values.where(count > 1).std("replica", ddof=1) / np.sqrt(count.where(count > 1))
    if own_error is not None:
        scatter = scatter.where(count > 1, own_error.where(good).sum("replica", min_count=1))
    return xr.Dataset({"mean": values.mean("replica"), "error": scatter, "replicas": count})


def flat(data: xr.Dataset) -> xr.Dataset:
    """Return a dataset with one dimension `point` in place of the scan's keys."""
    if not (isinstance(data, xr.Dataset) and {"task", "number"} <= set(data.variables)):
        raise InputError("data: must be a dataset that postproc.open_results or merge returns")
    if "replica" not in data.dims:  # one that was chosen
        by_point = {name for name in data if set(data[name].dims) <= set(data["task"].dims)
                    and name in (*PARAMETERS, "point_status")}  # fmt: skip
        tasks = [name for name in data if not (name in by_point or
                 str(name).startswith("theory_") or str(name).endswith("_spread"))]  # fmt: skip
        data = data.assign({name: data[name].expand_dims("replica", axis=-1) for name in tasks})
    axes = [name for name in data["task"].dims if name != "replica"]
    if axes == ["point"]:
        return data.drop_vars("point", errors="ignore")
    if axes:
        return data.stack(point=axes, create_index=False)
    return data.expand_dims("point")


class Points:
    """The points of a dataset, in the order of its grid.

    Attributes
    ----------
    data : the dataset with the dimension `point` in place of the scan's keys.
    attrs : its attributes.
    keys : the values of each key of the scan that has more than one, shape (point,).
    number, threshold, channel1_width, channel2_width : N, T, w, w', shape (point,), as all below.
    start : chi at the beginning, |N1 - N2|/N.
    chi, chi_error : mean over the replicas and its standard error; NaN where no task is done, or
        replicas are in two states.
    current, current_error : likewise, the net current along the instantaneous polarity, so that
        reversals of the polarity do not cancel it; for a single urn its current.
    """

    def __init__(self, data: xr.Dataset) -> None:
        """Take a dataset of `open_results` or `merge`, or a part of one."""
        self.attrs, self.data = data.attrs, flat(data)
        names = [str(name) for name in data["task"].dims if name not in ("replica", "point")]
        self._set(names or [name for name in PARAMETERS if name in self.data])
        self._open: dict[str, ResultsFile] = {}
        self._held: ExitStack | None = None

    def _set(self, names: Sequence[str]) -> None:
        self._values: dict[str, Floats] = {}
        self.number, self.threshold, self.channel1_width, self.channel2_width = (
            self.value(name) for name in ("number", "threshold", "channel1_width", "channel2_width")
        )
        self.start = np.abs(2.0 * self.value("urn1_number") - self.number) / self.number
        self.chi, self.chi_error = self.mean("chi")
        self.current, self.current_error = self.mean(self.current_name)
        columns = {name: np.broadcast_to(self.data[name].values, self.number.shape)
                   for name in names}  # fmt: skip
        self.keys = {name: one for name, one in columns.items() if np.unique(one).size > 1}

    def where(self, chosen: NDArray[np.bool_] | NDArray[np.int_]) -> Points:
        """Return the chosen points; given as places, in that order."""
        part = copy(self)
        for name in ("done", "asked", "two_states", "circuits"):
            part.__dict__.pop(name, None)
        places = np.flatnonzero(chosen) if np.asarray(chosen).dtype == bool else chosen
        part.data = self.data.isel(point=places)
        part._set(list(self.keys))
        return part

    def sorted_by_threshold(self) -> Points:
        """Return the points by increasing T."""
        return self.where(np.argsort(self.threshold, kind="stable"))

    def column(self, name: str) -> Floats:
        """Return a key of the scan or a parameter at each point, shape (point,)."""
        return np.asarray(self.keys.get(name, self.value(name) if self.has(name) else ()), float)

    def number2_at_start(self, point: int) -> float:
        """Return N2 at the start of a point's runs."""
        return float(self.number[point] - self.value("urn1_number")[point])

    def groups(self, *keys: str) -> Iterator[tuple[dict[str, float], Points]]:
        """Iterate over the values of parameters, and the points that have them."""
        if not keys:
            yield {}, self
            return
        columns = np.stack([self.column(key) for key in keys], axis=-1)
        for values in np.unique(columns, axis=0):
            chosen = (columns == values).all(axis=1)
            yield dict(zip(keys, values.tolist(), strict=True)), self.where(chosen)

    def need_only(self, *shown: str) -> None:
        """Raise `InputError` if points differ in other parameters than a figure can show."""
        free = {"urn1_number" if name == "start" else name for name in shown}
        columns = {name: self.value(name) for name in PARAMETERS if name in self.data}
        columns["urn1_number"] = self.start  # a fraction that is scanned with N
        if free & {"number", "threshold_fraction"}:
            free.add("threshold")
        varying = {name: np.unique(one) for name, one in columns.items()
                   if name not in free and np.unique(one).size > 1}  # fmt: skip
        if varying:
            name = next(iter(varying))
            scanned = FRACTIONS.get(name, name)
            name = scanned if scanned in self.keys else name
            values = np.unique(self.column(name))
            told = ", ".join(f"{one:g}" for one in values[:6])
            raise InputError(
                f"this figure has no place for {' and '.join(varying)} ({name}: {told}): choose, "
                f"--select {name}={values[0]:g} or data.sel({name}={values[0]:g})"
            )

    def __len__(self) -> int:
        """Return how many points there are."""
        return self.data.sizes["point"]

    @property
    def replicas(self) -> int:
        """Number of replicas of each point."""
        return self.data.sizes["replica"]

    @property
    def files(self) -> str:
        """Names of the files, for messages."""
        return ", ".join(self.attrs.get("files", ["the dataset"]))

    def has(self, name: str) -> bool:
        """Tell whether there is a variable."""
        return name in self.data

    def value(self, name: str) -> Floats:
        """Return a variable as floats, shape (point,) or (point, replica)."""
        if name not in self.data:
            raise InputError(f"{self.files}: has no {name}")
        if name not in self._values:
            one = self.data[name]
            if "point" in one.dims:
                self._values[name] = np.asarray(one.transpose("point", ...), float)
            else:
                shape = (self.data.sizes["point"], *one.shape)
                self._values[name] = np.broadcast_to(np.asarray(one, float), shape)
        return self._values[name]

    @cached_property
    def done(self) -> NDArray[np.bool_]:
        """Which tasks have results, shape (point, replica)."""
        return np.isfinite(self.value("current1"))

    @cached_property
    def asked(self) -> NDArray[np.bool_]:
        """Which tasks were requested, shape (point, replica): all, unless to a precision."""
        if not self.has("task_status"):
            return np.ones(self.done.shape, bool)
        return self.value("task_status") != NOT_ASKED

    @cached_property
    def two_states(self) -> NDArray[np.bool_]:
        """Which points have replicas in two states, shape (point,): they have no mean."""
        if not self.has("point_status"):
            return np.zeros(len(self), bool)
        return self.value("point_status") == TWO_STATES

    def mean(self, name: str) -> tuple[Floats, Floats]:
        """Return mean and standard error of a variable over the replicas (`mean_error`).

        NaN if replicas are in two states, or there is no such variable.
        """
        if not self.has(name):
            return (np.full(len(self), math.nan),) * 2
        own = self.data.get(f"{name}_error")
        found = mean_error(self.data[name], own).where(~self.two_states)
        return found["mean"].values, found["error"].values

    @property
    def current_name(self) -> str:
        """The variable that is the current: along the polarity, of a single urn its own."""
        return "polarised_current" if self.shape == "circuit" else "current1"

    @property
    def remark(self) -> str:
        """Remark for pictures of a partial run; empty for a complete one."""
        if self.done[self.asked].all():
            return ""
        return f"partial run: {np.count_nonzero(self.done)} of {self.asked.sum()} tasks"

    def say_if_partial(self) -> None:
        """Print on standard error that the run is partial, if it is."""
        if self.remark and self.done.any():
            print(f"{self.files}: {self.remark}, drawn with what there is", file=sys.stderr)

    def need_tasks(self) -> None:
        """Raise `InputError` if no task is complete."""
        if not self.done.any():
            raise InputError(f"{self.files}: no task is complete yet")

    def task(self, point: int | None, replica: int | None) -> tuple[int, int]:
        """Return point and replica of a task, from 0; the arguments are from 1.

        An argument that is None is the first with a complete task.
        """
        self.need_tasks()
        if point is None:
            point = 1 + int(np.flatnonzero(self.done.any(axis=1))[0])
        self._check_task(point - 1, 0)
        done = np.flatnonzero(self.done[point - 1])
        if replica is None:
            replica = 1 + int(done[0]) if done.size else 1
        self._check_task(point - 1, replica - 1)
        return point - 1, replica - 1

    def _check_task(self, point: int, replica: int) -> None:
        for what, at, count in (
            ("point", point, len(self)), ("replica", replica, self.replicas)
        ):  # fmt: skip
            if not 0 <= at < count:
                raise InputError(f"{self.files}: has {count} {what}(s), there is no {at + 1}")

    @property
    def shape(self) -> str:
        """Shape of the table: "circuit" or "urn"."""
        return str(self.attrs.get("shape", "circuit"))

    @property
    def scatterers(self) -> tuple[tuple[float, float, float], ...]:
        """Discs in channel 2: z, y, radius of each."""
        values = [float(word) for word in str(self.attrs.get("scatterers", "")).split()]
        return tuple(zip(values[0::3], values[1::3], values[2::3], strict=True))

    def any_circuit(self, point: int) -> Circuit:
        """Return the circuit of a point, whose urns and gates may be unequal."""
        self._check_task(point, 0)
        return self.circuits[point]

    @cached_property
    def circuits(self) -> list[Circuit]:
        """The circuits of all points, whose urns and gates may be unequal."""
        columns = {name: self.value(name).tolist() for name in PARAMETERS if self.has(name)}
        rows = (dict(zip(columns, one, strict=True))
                for one in zip(*columns.values(), strict=True))  # fmt: skip
        return [self._circuit(one, age) for one, age in zip(rows, self._ages(), strict=True)]

    def _circuit(self, values: dict[str, float], age: float) -> Circuit:
        """Return a circuit from the parameters of a point."""
        threshold, radius = int(values["threshold"]), values["urn_radius"]
        other, beyond = int(values.get("threshold2", threshold)), values.get("urn_radius2", radius)
        outline, other_outline = self._outlines((radius, beyond))
        return Circuit(
            number=int(values["number"]),
            threshold=threshold,
            urn_radius=radius,
            urn2_radius=beyond if beyond != radius else None,
            gate2_threshold=other if other != threshold else None,
            channel1_width=values["channel1_width"],
            channel2_width=values["channel2_width"],
            channel1_length=values["channel1_length"],
            channel2_length=values["channel2_length"],
            shape=self.shape,
            scatterers=self.scatterers,
            outline=outline,
            urn2_outline=other_outline if other_outline != outline else None,
            age=age,
        )

    def _ages(self) -> list[float]:
        """Return the age of each point's runs in the middle of their averages, to two digits.

        Where no task is complete, that of the paper's runs.
        """
        if not self.has("transient_time"):
            return [PAPERS_AGE] * len(self)
        ends = 0.5 * (self.value("transient_time") + self.value("time"))
        known = self.done & np.isfinite(ends) & (ends >= 0.0)
        sums = np.where(known, ends, 0.0).sum(axis=1)
        return [float(f"{total / count:.2g}") if count else PAPERS_AGE
                for total, count in zip(sums, known.sum(axis=1), strict=True)]  # fmt: skip

    def _outlines(self, radii: tuple[float, float]) -> tuple[Outline | None, Outline | None]:
        """Return the outlines of urns that are polygons, from their radii if they are regular."""
        if self.attrs.get("urn_shape", "disc") == "disc":
            return None, None
        if "urn_sides" in self.attrs:
            sides = int(self.attrs["urn_sides"])
            return regular(sides, radii[0]), regular(sides, radii[1])
        one, two = (outline_of(np.reshape(self.attrs[name], (-1, 2)))
                    for name in ("urn_vertices", "urn2_vertices"))  # fmt: skip
        return one, two

    def beyond_theory(self, point: int) -> bool:
        """Tell whether a table has scatterers or unequal sides: no theory of figures applies."""
        return bool(self.scatterers or self.any_circuit(point).unlike)

    def circuit(self, point: int, gate: Gate = WINDOW) -> Circuit:
        """Return the circuit of a point, with the paper's gate unless another is given.

        Raises `InputError` if its urns or its gates are unequal.
        """
        found = self.any_circuit(point)
        if found.unlike:
            raise InputError(
                f"{self.files}: {found.unlike} at point {point + 1}; "
                "this needs two urns and two gates that are alike"
            )
        return replace(found.sides[0], gate=gate)

    def _read(self, group: str, names: Sequence[str], point: int, replica: int) -> list[Floats]:
        """Return datasets of a group for one task, from its file."""
        self._check_task(point, replica)
        at = {"point": point, "replica": replica}
        path = self.attrs["files"][int(self.data["file"][at]) if self.has("file") else 0]
        with ExitStack() as stack:
            if path not in self._open:
                self._open[path] = (self._held or stack).enter_context(ResultsFile(Path(path)))
                if not self._held:
                    stack.callback(self._open.clear)
            opened = self._open[path]
            stack.enter_context(opened.damage_reported())
            created = opened.attributes.get("created")
            if len(self.attrs["files"]) == 1 and created != self.attrs.get("created"):
                raise InputError(f"{path}: has changed since it was opened")
            if not opened.has(group):
                raise InputError(f"{path}: has no {group}{HINTS.get(group, '')}")
            return opened.task(group, names, int(self.data["task"][at]))

    @contextmanager
    def kept_open(self) -> Iterator[None]:
        """Keep the files open while many tasks are read; may be nested."""
        if self._held is not None:
            yield
            return
        try:
            with ExitStack() as self._held:
                yield
        finally:
            self._held = None
            self._open.clear()

    def series(self, point: int, replica: int) -> Series:
        """Return the series of a task, from the first interval on.

        Raises `InputError` if none was requested, or it is empty.
        """
        time, number, *flows = self._read("series", ("time", "urn1_number", *FLOWS), point, replica)
        there = np.isfinite(number) & np.isfinite(flows[0]) & (number >= 0)
        there &= time > 0.0  # the entry at the start has no interval before it
        if not there.any():
            raise InputError(f"{self.files}: the series of point {point + 1} is empty")
        rates = {name: flow[there] for name, flow in zip(FLOWS, flows, strict=True)}
        return Series(time[there], number[there], rates)

    def all_series(self, point: int) -> list[Series]:
        """Return the series of all complete replicas of a point."""
        with self.kept_open():
            return [self.series(point, int(one)) for one in np.flatnonzero(self.done[point])]

    def has_group(self, group: str) -> bool:
        """Tell whether the files have series, snapshots, ..."""
        try:
            self._read(group, (), 0, 0)
        except InputError:
            return False
        return True

    def snapshot(self, point: int, replica: int, index: int) -> Snapshot:
        """Return one snapshot of a task; `index` counts from 0, or from the end if negative."""
        found = self.snapshots(point, replica)
        if not -len(found) <= index < len(found):
            raise InputError(f"{self.files}: has {len(found)} snapshots, there is no such one")
        return found[index]

    def snapshots(self, point: int, replica: int) -> list[Snapshot]:
        """Return all snapshots of a task that it has reached."""
        time, *states = self._read("snapshots", ("time", "x", "y", "ux", "uy"), point, replica)
        count = int(self.number[point])
        columns = np.array([one[:, :count] for one in states])
        found = [Snapshot(float(one), *columns[:, k]) for k, one in enumerate(time)
                 if np.isfinite(columns[:, k]).all()]  # fmt: skip
        if not found:
            raise InputError(f"{self.files}: no snapshot of point {point + 1} was reached")
        return found

    def events(self) -> dict[str, Floats]:
        """Return the event log (time, kind, where, particle), empty if there is none."""
        names = ("time", "kind", "where", "particle")
        if not self.has_group("events"):
            return {}
        return dict(zip(names, self._read("events", names, 0, 0), strict=True))


#: Keys that may be scanned in place of a parameter.
FRACTIONS = {"threshold": "threshold_fraction", "urn1_number": "urn1_fraction"}
HINTS = {
    "series": " (set series_interval in &output)",
    "snapshots": " (set snapshot_times in &output)",
}

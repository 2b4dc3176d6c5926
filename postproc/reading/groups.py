"""Groups of results files beside the averages: series, snapshots, final states, events."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from postproc.cli import InputError
from postproc.reading.points import COMPLETE, FLOWS, FRACTIONS, PARAMETERS, files_of, of_files
from postproc.reading.results_file import ResultsFile

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

GROUPS = ("series", "snapshots", "final", "events")
TOGETHER = 256  # tasks whose series are read at a time
RUN = ("seed", "collisions", "time")  # together they tell runs apart
HINTS = {
    "series": " (set series_interval in &output)",
    "snapshots": " (set snapshot_times in &output)",
}


@dataclass(frozen=True)
class Snapshot:
    """All particles of one task at one time; positions and velocities of shape (particle,)."""

    time: float
    x: Floats
    y: Floats
    ux: Floats
    uy: Floats


def group_of(data: xr.Dataset, group: str) -> xr.Dataset:
    """Return a group of the files of a dataset, of the same points and replicas.

    Only tasks that are in the dataset are read; of those that are not complete all is NaN.
    """
    files = of_files(data, "files")
    known = files and {"task", "task_status"} <= set(data.variables) and data["task"].size
    if not known or data["task"].dtype.kind != "i":  # such as a mean, or after `where`
        told = "of points of it that sel or isel choose"
        raise InputError(f"{group}: of a dataset of open_results or merge, or {told}")
    task, complete = data["task"], data["task_status"].variable == COMPLETE
    places = task.values.ravel()
    file = np.ravel(data["file"]) if "file" in data else np.zeros(places.size)
    parts = []
    # of a dataset without any task the first file has the names
    for at in np.unique(file[places >= 0]).astype(int) if (places >= 0).any() else (0,):
        path, mine = files[at], np.flatnonzero(file == at)
        with ResultsFile(Path(path), quiet=True) as opened, opened.damage_reported():
            if created(data)[at] not in ("", str(opened.attributes.get("created", ""))):
                raise InputError(f"{path}: has changed since it was opened")
            if not opened.has(group):
                raise InputError(f"{path}: has no {group}{HINTS.get(group, '')}")
            there = mine[complete.values.ravel()[mine]]
            _need_runs_of(data, opened, places[there].astype(int), there)
            parts.append(opened.dataset(group, places[mine].astype(int)).assign_coords(row=mine))
    counted = [name for name in parts[0].dims if name not in parts[0].indexes]
    parts = [one.assign_coords({name: np.arange(one.sizes[name]) for name in counted})
             for one in parts]  # fmt: skip
    found = parts[0] if len(parts) == 1 else xr.concat(parts, "row", "all", join="outer")
    found = found.reindex(row=np.arange(places.size), copy=False).drop_vars(["row", *counted])
    variables = dict(found.variables)
    for name, one in found.variables.items():
        if one.dims[:1] == ("row",):
            values = one.values.reshape(task.shape + one.shape[1:])
            on_grid = xr.Variable((*task.dims, *one.dims[1:]), values, one.attrs)
            whole = values.dtype.kind != "f" or complete.all()
            variables[name] = on_grid if whole else on_grid.where(complete)
    shared = [name for name in (*PARAMETERS, "task") if name in data and name not in found]
    points = data[shared].assign(variables)
    # In series the parameter's name is that of N1 at all times.
    first, start = data.get("urn1_number"), FRACTIONS["urn1_number"]
    if "urn1_number" in found and first is not None and start not in points and "number" in data:
        points = points.assign_coords({start: first.variable / data["number"].variable})
    return points


def _need_runs_of(
    data: xr.Dataset, opened: ResultsFile, tasks: NDArray[np.int_], rows: NDArray[np.int_]
) -> None:
    """Raise `InputError` unless the runs of a dataset are those of the file, by seed and length.

    `xr.concat` keeps the file of the first part only.
    """
    for name in RUN:
        dims, given = data["task"].dims, data.get(name)
        if given is None or not set(dims) <= set(given.dims) or not opened.has(name):
            continue
        same = set(given.dims) == set(dims) and np.array_equal(
            given.transpose(*dims).values.ravel()[rows], opened.of_tasks(name, tasks)
        )
        if not same:
            told = "postproc.merge joins results, xarray.concat does not"
            raise InputError(f"{opened.path}: {name} of some runs is not that of the file; {told}")


def created(data: xr.Dataset) -> list[str]:
    """Return when each of the files of a dataset was made, as far as the dataset says so."""
    return of_files(data, "created") or [""] * len(of_files(data, "files"))


# `data.series` and the others.
for _group in GROUPS:
    xr.register_dataset_accessor(_group)(partial(group_of, group=_group))


def _checked(data: xr.Dataset, group: str, names: tuple[str, ...]) -> xr.Dataset:
    """Return variables of a group; raise `InputError` if one is missing."""
    found = group_of(data, group)
    if missing := [name for name in names if name not in found]:
        raise InputError(f"{files_of(data)}: has no {group}/{missing[0]}")
    return found[list(names)]


def each_series(points: xr.Dataset) -> Iterator[tuple[int, xr.Dataset]]:
    """Iterate over complete tasks: the place of the point, and the series of the task to its end.

    `time` are the ends of the intervals, `middle` their middles; `urn1_number` is N1 at the ends
    and `chi` the mass spread, and `flow...` are crossings per unit time since the entry before.
    Empty series are left out.
    Raises `InputError` if none was requested.
    """
    step = max(1, TOGETHER // points.sizes["replica"])
    for first in range(0, points.sizes["point"], step):
        part = points.isel(point=slice(first, first + step))
        found = _checked(part, "series", ("urn1_number", *FLOWS))
        found = found.assign_coords(replica=np.arange(found.sizes["replica"]))
        number = part["number"].variable
        found["chi"] = abs(number - 2.0 * found["urn1_number"].variable) / number
        # The entry at the start has no interval before it.
        known = found[FLOWS[0]].notnull() & (found["urn1_number"] >= 0) & (found["time"] > 0.0)
        for at, replica in np.argwhere(part["complete"].values & known.any("time").values):
            there = np.flatnonzero(known.values[at, replica])
            one = found.isel(point=at, replica=replica, time=there)
            begin = np.append(0.0, one["time"][:-1])
            yield first + int(at), one.assign_coords(middle=0.5 * (begin + one["time"]))


def _need_complete(points: xr.Dataset, point: int, replica: int) -> None:
    """Raise `InputError` unless a task is complete."""
    done = points["complete"].values[point]
    if not done[replica]:
        others = ", ".join(map(str, np.flatnonzero(done))) or "none"
        told = f"replica {replica} of point {point} is not complete; complete: {others}"
        raise InputError(f"{files_of(points)}: {told}")


def series_of(points: xr.Dataset, point: int, replica: int | None = None) -> list[xr.Dataset]:
    """Return the series of a complete replica of a point, or of all (`each_series`).

    Raises `InputError` if they are empty, or the replica is not complete.
    """
    if replica is not None:
        _need_complete(points, point, replica)
    replicas = slice(None) if replica is None else [replica]
    found = [one for _, one in each_series(points.isel(point=[point], replica=replicas))]
    if not found and points["complete"][point].any():
        raise InputError(f"{files_of(points)}: the series of point {point} is empty")
    return found


def snapshots_of(points: xr.Dataset, point: int, replica: int) -> list[Snapshot]:
    """Return all snapshots of a task that it has reached; it must be complete."""
    _need_complete(points, point, replica)
    one = points.isel(point=point, replica=replica)
    found = _checked(one, "snapshots", ("time", "x", "y", "ux", "uy"))
    found = found.isel(particle=slice(int(one["number"]))).dropna("time")
    if found.sizes["time"] == 0:
        raise InputError(f"{files_of(points)}: no snapshot of point {point} was reached")
    states = (found[name].values for name in ("x", "y", "ux", "uy"))
    return [Snapshot(float(one[0]), *one[1:]) for one in zip(found["time"], *states, strict=True)]


def snapshot_of(points: xr.Dataset, point: int, replica: int, index: int) -> Snapshot:
    """Return one snapshot of a task; `index` counts from 0, or from the end if negative."""
    found = snapshots_of(points, point, replica)
    if index not in range(-len(found), len(found)):
        told = f"has {len(found)} snapshots, {index!r} is none of them"
        raise InputError(f"{files_of(points)}: {told}")
    return found[int(index)]

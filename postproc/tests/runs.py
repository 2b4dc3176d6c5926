"""Files of results for the tests, from short runs of the program itself."""

from __future__ import annotations

import hashlib
from contextlib import contextmanager
from typing import TYPE_CHECKING

import h5py
import numpy as np

from postproc.reading.grid import dataset_of
from postproc.reading.points import by_point
from postproc.reading.seal import seal_of
from postproc.running import run

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import xarray as xr

CASE = {
    "table": {},
    "particles": {"number": 1000},
    "gate": {},
    "run": {"duration": 1000.0},
    "scan": {"threshold": 7, "replicas": 2},
    "output": {"series_interval": 10.0, "snapshot_times": [0.0, 5.0, 10.0]},
}
# urns that forget, for what holds of well mixed urns only
FORGETFUL = {"engine": "reservoir"}
BARE = {"series_interval": 0.0, "snapshot_times": None}


def results_of(path: Path, **groups: dict[str, object]) -> Path:
    """Run `CASE` with some keys changed (None: left out), its results in `path`; return that."""
    given = {name: {**CASE.get(name, {}), **groups.get(name, {})} for name in {**CASE, **groups}}
    given["output"]["file"] = path.name
    return run(given, folder=path.parent, quiet=True)


def points_of(*paths: Path) -> xr.Dataset:
    """Return the points of one results file, or of several."""
    return by_point(dataset_of(paths))


@contextmanager
def edited(path: Path) -> Iterator[h5py.File]:
    """Open a file of results to change it, then put its seal behind it; h5py takes it away."""
    with h5py.File(path, "r+") as file:
        yield file
    content = path.read_bytes()
    path.write_bytes(content + seal_of(len(content), hashlib.sha256(content).hexdigest()))


def leave_out(path: Path, *tasks: tuple[int, int]) -> Path:
    """Make tasks (point, replica), from 0, such as an interrupted run leaves them."""
    with edited(path) as file:
        replica = file["replica"]
        columns = [
            one
            for one in file.values()
            if getattr(one, "ndim", 0) == 2 and replica in one.dims[1].values()
        ]
        for group in ("series", "snapshots"):
            columns += [one for one in file.get(group, {}).values() if one.ndim > 2]
        for column in columns:
            for task in tasks:
                column[task] = np.nan if column.dtype.kind == "f" else -1
        for task in tasks:
            file["task_status"][task] = 2
        file.attrs["status"] = np.bytes_("partial")
    return path

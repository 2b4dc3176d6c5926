"""Results files of the program, which are HDF5: opened, and read as datasets of xarray.

Problems are reported in one line.
"""

from __future__ import annotations

import errno
import math
import os
import re
import resource
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np
import xarray as xr

from postproc.cli import InputError, existing_file
from postproc.reading.seal import check_seal

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

NEEDED = ("number", "threshold", "channel1_width", "channel2_width", "current1")
NUMBERS = ("_FillValue", "flag_values")  # attributes that are no texts
# What a name is in a few words ends here, and its explanation begins.
NAME = re.compile(r"[,:;] | (?=\|)")
ERRORS = {"_replica_error": "standard error over replicas", "_error": "standard error",
          "_spread": "standard error over replicas"}  # fmt: skip
SHORT = {
    "chi_collision": "mass spread at collisions", "polarised_current": "polarised current",
    **{f"current{channel}": f"net current of channel {channel}" for channel in (1, 2)},
    **{f"flow{channel}_{way}": f"flow of channel {channel}, urn {way[0]} to {way[1]}"
       for channel in (1, 2) for way in ("12", "21")},
}  # fmt: skip
READABLE = ("0.1.", "0.2.", "0.3.", "0.4.")  # prefixes of the versions whose files are read


class ResultsFile:
    """An open results file; use it in a `with` statement, or read within `damage_reported`."""

    def __init__(self, path: Path, *, verify: bool = False, quiet: bool = False) -> None:
        """Open `path`; raise `InputError` unless it holds results of this program.

        With `verify` the whole file is read, and its digest must be right. `quiet`: it was opened
        before, so that there is no further warning.
        """
        self.path = path
        with suppress(OSError):  # the name may be too long
            if not path.exists() and path.with_name(f"{path.name}.tasks").is_dir():
                raise InputError(f"{path}: its run goes on or was stopped: battery --partial "
                                 "FILE.nml writes what is finished")  # fmt: skip
        check_seal(existing_file(path), verify=verify, quiet=quiet)
        self._file = _hdf5(path)
        try:
            with self.damage_reported():
                self._check()
        except BaseException:
            self._file.close()
            raise

    def _check(self) -> None:
        """Raise `InputError` unless the file is one of a program whose files are read."""
        missing = [name for name in NEEDED if not self.has(name)]
        if missing or "namelist" not in self._file.attrs:
            lacks = missing[0] if missing else "namelist"
            raise InputError(f"{self.path}: HDF5, but not written by battery (it has no {lacks})")
        version = str(self.attributes.get("version", "unknown"))
        if not version.startswith(READABLE):
            known = f"{READABLE[0]}x to {READABLE[-1]}x"
            raise InputError(
                f"{self.path}: of version {version[:32]} of battery; {known} can be read"
            )

    def __enter__(self) -> ResultsFile:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._file.close()

    @contextmanager
    def damage_reported(self) -> Iterator[None]:
        """Raise `InputError` where the file cannot be read, or an error is due to damage."""
        try:
            yield
        except InputError:
            raise
        except Exception as problem:
            # Errors of the system have a number, those of HDF5 have none, and may be of any class.
            if isinstance(problem, OSError) and problem.errno is not None:
                raise
            reason = "cannot be read"
            if not isinstance(problem, OSError) and "file read failed" not in str(problem):
                # What a whole file leads to is a mistake of this program.
                try:
                    check_seal(self.path, verify=True)
                except InputError as damage:
                    reason = str(damage).removeprefix(f"{self.path}: ")
                else:
                    raise
            told = " ".join(str(problem).split())
            raise InputError(f"{self.path}: {reason} ({told})") from problem

    @cached_property
    def attributes(self) -> dict[str, object]:
        """Attributes of the root: texts, and lists of numbers."""
        return {name: np.ravel(value).tolist() if np.size(value) > 1 else text_of(value)
                for name, value in self._file.attrs.items()}  # fmt: skip

    def dataset(
        self, group: str | None = None, tasks: NDArray[np.int_] | None = None
    ) -> xr.Dataset:
        """Return the datasets of the root or of a group, with the names of their dimensions.

        With `tasks`, places of (point, replica), these dimensions are one, `row`, and only their
        rows are read.
        """
        inside, variables, read = "" if group is None else f"{group}/", {}, []
        for name in self._file if group is None else self._found(group) or ():
            one = self._found(inside + name)
            if not isinstance(one, h5py.Dataset) or name == "event":
                continue
            if (dimensions := _dimensions(one)) is None:
                continue
            rows = None
            if tasks is not None and dimensions[:2] == ("point", "replica"):
                dimensions, rows = ("row", *dimensions[2:]), tasks
            read.append((name, dimensions, one, rows))
        self._need_memory(sum(_bytes(one, rows) for _, _, one, rows in read))
        for name, dimensions, one, rows in read:
            variables[name] = dimensions, _values(one, rows), _meaning(one)
        return xr.decode_cf(xr.Dataset(variables), decode_times=False)

    def of_tasks(self, name: str, tasks: NDArray[np.int_]) -> NDArray[np.generic]:
        """Return the values of a dataset of (point, replica) at these places."""
        return _values(self._dataset(name), tasks)

    def has(self, name: str) -> bool:
        """Tell whether there is a dataset or group of that name."""
        return self._found(name) is not None

    def _found(self, name: str) -> h5py.Dataset | h5py.Group | None:
        """Return a dataset or group, None if there is none; it must lie in the file itself."""
        found, words = self._file, name.split("/")
        for word in words:
            links = found.id.links if isinstance(found, h5py.Group) else None
            if links is None or not links.exists(word.encode()):
                return None
            if links.get_info(word.encode()).type != h5py.h5l.TYPE_HARD:
                raise InputError(f"{self.path}: {name} is a link, which is not followed")
            found = found[word]
        if isinstance(found, h5py.Dataset) and (found.is_virtual or found.external):
            raise InputError(f"{self.path}: {name} does not lie in the file itself")
        return found

    def _dataset(self, name: str) -> h5py.Dataset:
        """Return a dataset; raise `InputError` if there is none."""
        found = self._found(name)
        if not isinstance(found, h5py.Dataset):
            raise InputError(f"{self.path}: has no {name}")
        return found

    def _need_memory(self, needed: int) -> None:
        """Raise `InputError` if bytes that are read together do not fit into memory."""
        if needed > (left := memory_left()):
            here = f"bytes of memory, there are {left:.3g}"
            raise InputError(f"{self.path}: needs {needed:.3g} {here}")

    def axes(self) -> dict[str, tuple[NDArray[np.generic], dict[str, object]]] | None:
        """Return the values of each key that was scanned, the slowest first, and their attributes.

        The points are all combinations. None if the file has no grid.
        """
        if "scan" not in self.attributes:
            return None
        found = {}
        for name in str(self.attributes["scan"]).split():
            axis = self._dataset(f"scan/{name}")
            whole = self.has(name) and self._dataset(name).dtype.kind == "i"
            found[name] = (axis[()].astype(int) if whole else axis[()], _meaning(axis))
        points = self._dataset("number").shape[0]
        if math.prod(len(values) for values, _ in found.values()) != points:
            raise InputError(f"{self.path}: damaged: its points do not fill the grid of its scan")
        return found


def _hdf5(path: Path) -> h5py.File:
    """Return an open file; without HDF5's lock, which some network disks refuse.

    Where this Python has the file open with a lock, HDF5 opens it again only with one of its kind.
    """
    problems = []
    for locking in (False, None, True):  # None: HDF5's default
        try:
            return h5py.File(path, "r", locking=locking)
        except OSError as one:
            problems.append(one)
    problem = problems[1]
    reason = " ".join(str(problem).split())
    if problem.errno == errno.EAGAIN:
        reason = "is open in another program, which may change it; close it there"
    raise InputError(f"{path}: {reason}") from problem


def _bytes(dataset: h5py.Dataset, tasks: NDArray[np.int_] | None) -> int:
    """Return the size of a dataset, or of the rows of tasks, in memory."""
    count = dataset.size if tasks is None else tasks.size * math.prod(dataset.shape[2:])
    return int(count * dataset.dtype.itemsize)


def _values(dataset: h5py.Dataset, tasks: NDArray[np.int_] | None) -> NDArray[np.generic]:
    """Return a dataset, or the rows of tasks, places of (point, replica) in any order."""
    if tasks is None:
        return dataset[()]
    replicas, inner = dataset.shape[1], dataset.shape[2:]
    if np.array_equal(tasks, np.arange(dataset.shape[0] * replicas)):
        return dataset[()].reshape(-1, *inner)
    points, at = np.divmod(tasks, replicas)
    found = np.empty((tasks.size, *inner), dataset.dtype)
    for point in np.unique(points):
        here = np.flatnonzero(points == point)
        first, last = at[here].min(), at[here].max()
        found[here] = dataset[point, first : last + 1][at[here] - first]
    return found


def _dimensions(dataset: h5py.Dataset) -> tuple[str, ...] | None:
    """Return the names of the dimensions of a dataset; None if it is not of this program.

    They are read from its attributes: HDF5's own calls crash at damaged ones (`H5DSis_scale`).
    """
    if dataset.attrs.get("CLASS") == b"DIMENSION_SCALE":
        return (dataset.name.rpartition("/")[2],)
    scales = dataset.attrs.get("DIMENSION_LIST", ())
    if len(scales) == 0 or not all(len(references) for references in scales):
        return None
    try:
        names = [dataset.file[one[0]].name for one in scales]
    except KeyError as problem:
        told = "is not in the file; was that copied in parts?"
        raise InputError(
            f"{dataset.file.filename}: a dimension of {dataset.name} {told}"
        ) from problem
    if None in names:  # h5py's answer where the disk fails
        raise OSError(f"the names of the dimensions of {dataset.name}")
    return tuple(name.rpartition("/")[2] for name in names)


def _meaning(dataset: h5py.Dataset) -> dict[str, object]:
    """Return the attributes of a dataset: a short name, its explanation as `comment`."""
    found = {key: dataset.attrs[key] for key in NUMBERS if key in dataset.attrs}
    for key in ("units", "flag_meanings"):
        if key in dataset.attrs:
            found[key] = text_of(dataset.attrs[key])
    told, own = text_of(dataset.attrs.get("long_name", "")), dataset.name.rpartition("/")[2]
    ending = next((one for one in ERRORS if own.endswith(one)), "")
    name = SHORT.get(own.removesuffix(ending), NAME.split(told, maxsplit=1)[0])
    name += f", {ERRORS[ending]}" if ending else ""
    found |= {"long_name": name, **({"comment": told} if name != told else {})}
    if found.get("units") == "1":
        del found["units"]
    return found


def memory_left() -> float:
    """Return the bytes available for data; half of the memory is left for computations."""
    meminfo = Path("/proc/meminfo")
    lines = meminfo.read_text(encoding="ascii").splitlines() if meminfo.exists() else []
    free = [1024.0 * float(one.split()[1]) for one in lines if one.startswith("MemAvailable:")]
    left = min(free, default=math.inf)
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        left = min(left, limit - pages * os.sysconf("SC_PAGE_SIZE"))
    return 0.5 * left


def text_of(value: object) -> str:
    """Return an attribute as printable text, whatever its bytes are."""
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size else ""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    return str(value).encode("utf-8", "replace").decode("utf-8").rstrip()

"""Results of a run: opens the program's HDF5 file; problems are reported in one line."""

from __future__ import annotations

import errno
import math
import os
import resource
import sys
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np
import xarray as xr

from postproc.cli import InputError, existing_file
from postproc.reading.seal import check_seal
from postproc.theory.circuit import PAPERS_AGE, Circuit
from postproc.theory.gates import WINDOW
from postproc.theory.outlines import outline_of, regular

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from postproc.theory.gates import Gate
    from postproc.theory.outlines import Outline

NEEDED = ("number", "threshold", "channel1_width", "channel2_width", "current1")
#: Arrays up to this size in bytes are read once, and as a whole.
KEPT = 1 << 28
LENGTHS = ("channel1_width", "channel2_width", "channel1_length", "channel2_length")
FLOWS = ("flow1_12", "flow1_21", "flow2_12", "flow2_21")
TEXTS, NUMBERS = ("units", "long_name", "flag_meanings"), ("_FillValue", "flag_values")
COMPLETE, NOT_ASKED = 0, 3  # values of `task_status`
TWO_STATES = 2  # value of `point_status`
POLARISED = 0.15  # chi above which a state is called polarised
READABLE = ("0.1.", "0.2.", "0.3.", "0.4.")  # prefixes of the versions whose files are read


@dataclass(frozen=True)
class Series:
    """Series of one task.

    Attributes
    ----------
    time : ends of the intervals, shape (time,).
    urn1_number : N1 at that time, shape (time,).
    flows : crossings per unit time since the entry before, by name, each of shape (time,).
    """

    time: NDArray[np.float64]
    urn1_number: NDArray[np.float64]
    flows: dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Snapshot:
    """All particles of one task at one time; positions and velocities of shape (particle,)."""

    time: float
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    ux: NDArray[np.float64]
    uy: NDArray[np.float64]


class Results:
    """An open file of results; use it in a `with` statement."""

    def __init__(self, path: Path, *, verify: bool = False) -> None:
        """Open `path`; raise `InputError` unless it holds results of this program.

        With `verify` the whole file is read, and its digest must be right.
        """
        self.path = path
        check_seal(existing_file(path), verify=verify)
        self._file = _hdf5(path)
        self._arrays: dict[str, NDArray[np.generic]] = {}
        try:
            self._check()
        except BaseException as problem:
            self.__exit__(type(problem), problem, None)
            raise

    def _check(self) -> None:
        """Raise `InputError` unless the file is one of a program whose files are read."""
        missing = [name for name in NEEDED if not self.has(name)]
        if missing or "namelist" not in self._file.attrs:
            lacks = missing[0] if missing else "namelist"
            raise InputError(f"{self.path}: HDF5, but not written by battery (it has no {lacks})")
        version = self.attributes.get("version", "unknown")
        if not version.startswith(READABLE):
            known = f"{READABLE[0]}x to {READABLE[-1]}x"
            raise InputError(
                f"{self.path}: of version {version[:32]} of battery; {known} can be read"
            )

    def __enter__(self) -> Results:
        """Return itself."""
        return self

    def __exit__(self, _: object, problem: BaseException | None, __: object) -> None:
        """Close the file; raise `InputError` if it cannot be read, or an error is due to damage."""
        self._file.close()
        if not isinstance(problem, Exception) or isinstance(problem, InputError):
            return
        # Errors of the system have a number, those of HDF5 have none.
        if isinstance(problem, OSError) and problem.errno is not None:
            return
        reason = "cannot be read"
        if not isinstance(problem, OSError):
            # What a whole file leads to is a mistake of this program.
            try:
                check_seal(self.path, verify=True)
            except InputError as damage:
                reason = str(damage).removeprefix(f"{self.path}: ")
            else:
                return
        told = " ".join(str(problem).split())
        raise InputError(f"{self.path}: {reason} ({told})") from problem

    @cached_property
    def attributes(self) -> dict[str, str]:
        """Root attributes as text: program, version, namelist, status ..."""
        return {name: text_of(value) for name, value in self._file.attrs.items()}

    def dataset(self, group: str | None = None) -> xr.Dataset:
        """Return the datasets of the root or of a group, with the names of their dimensions."""
        inside = "" if group is None else f"{group}/"
        read = {}
        for name in self._file if group is None else self._found(group):
            one = self._found(inside + name)
            if isinstance(one, h5py.Dataset) and name != "event" and _dimensions(one) is not None:
                read[name] = one
        self._need_memory(read.values())
        variables = {}
        for name, one in read.items():
            attributes = {key: text_of(one.attrs[key]) for key in TEXTS if key in one.attrs}
            attributes |= {key: one.attrs[key] for key in NUMBERS if key in one.attrs}
            variables[name] = (_dimensions(one), one[()], attributes)
        return xr.decode_cf(xr.Dataset(variables), decode_times=False)

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
                raise InputError(f"{self.path}: {name} is a link out of its place")
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

    def _need_memory(self, datasets: Iterable[h5py.Dataset]) -> None:
        """Raise `InputError` if datasets that are read together do not fit into memory."""
        needed = sum(one.nbytes for one in datasets)
        if needed > (left := memory_left()):
            here = f"bytes of memory, there are {left:.3g}"
            raise InputError(f"{self.path}: needs {needed:.3g} {here}")

    def value(self, name: str) -> NDArray[np.float64]:
        """Return a whole dataset as floats, e.g. chi of shape (point, replica)."""
        found = self._array(name)
        if isinstance(found, h5py.Dataset):
            self._need_memory([found])
        return np.array(found, float)

    def unit(self, name: str) -> str:
        """Return the unit of a dataset."""
        return text_of(self._dataset(name).attrs.get("units", ""))

    @property
    def points(self) -> int:
        """Number of parameter points."""
        return self._array("number").shape[0]

    @property
    def replicas(self) -> int:
        """Number of replicas of each point."""
        return self._array("current1").shape[1]

    def axes(self) -> dict[str, tuple[NDArray[np.generic], dict[str, str]]] | None:
        """Return the values of each key that was scanned, the slowest first, and their attributes.

        The points are all combinations. None if the file has no grid.
        """
        if "scan" not in self.attributes:
            return None
        found = {}
        for name in self.attributes["scan"].split():
            axis = self._dataset(f"scan/{name}")
            whole = self.has(name) and self._dataset(name).dtype.kind == "i"
            values = axis[()].astype(int) if whole else axis[()]
            attributes = {key: text_of(axis.attrs.get(key, "")) for key in ("units", "long_name")}
            found[name] = (values, attributes)
        if math.prod(len(values) for values, _ in found.values()) != self.points:
            raise InputError(f"{self.path}: damaged: its points do not fill the grid of its scan")
        return found

    @cached_property
    def done(self) -> NDArray[np.bool_]:
        """Which tasks have results, shape (point, replica)."""
        known = np.isfinite(self.value("current1"))
        if self.has("task_status"):
            known &= self.value("task_status") == COMPLETE
        return known

    @cached_property
    def asked(self) -> NDArray[np.bool_]:
        """Which tasks were requested, shape (point, replica): all, unless to a precision."""
        if self.has("task_status"):
            return self.value("task_status") != NOT_ASKED
        return np.ones(self.done.shape, bool)

    @cached_property
    def two_states(self) -> NDArray[np.bool_]:
        """Which points have replicas in two states, shape (point,): they have no mean."""
        if self.has("point_status"):
            return self.value("point_status") == TWO_STATES
        return np.zeros(self.points, bool)

    @property
    def remark(self) -> str:
        """Remark for pictures of a partial run; empty for a complete one."""
        if self.done[self.asked].all():
            return ""
        return f"partial run: {np.count_nonzero(self.done)} of {self.asked.sum()} tasks"

    def say_if_partial(self) -> None:
        """Print on standard error that the run is partial, if it is."""
        if self.remark and self.done.any():
            print(f"{self.path}: {self.remark}, drawn with what there is", file=sys.stderr)

    def need_tasks(self) -> None:
        """Raise `InputError` if no task is complete."""
        if not self.done.any():
            raise InputError(f"{self.path}: no task is complete yet")

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

    @property
    def shape(self) -> str:
        """Shape of the table: "circuit" or "urn"."""
        return self.attributes.get("shape", "circuit")

    @cached_property
    def scatterers(self) -> tuple[tuple[float, float, float], ...]:
        """Discs in channel 2: z, y, radius of each."""
        values = [float(word) for word in self.attributes.get("scatterers", "").split()]
        return tuple(zip(values[0::3], values[1::3], values[2::3], strict=True))

    def any_circuit(self, point: int) -> Circuit:
        """Return the circuit of a point, whose urns and gates may be unequal."""
        self._check_task(point, 0)
        (threshold, other), (radius, beyond) = (
            [one.item() for one in np.ravel(self._of_point(name, point))]
            for name in ("gate_threshold", "urn_radius")
        )
        if self.shape != "circuit":
            other, beyond = threshold, radius
        return Circuit(
            number=int(self._of_point("number", point)),
            threshold=threshold,
            urn_radius=radius,
            urn2_radius=beyond if beyond != radius else None,
            gate2_threshold=other if other != threshold else None,
            **{name: float(self._of_point(name, point)) for name in LENGTHS},
            shape=self.shape,
            scatterers=self.scatterers,
            **self._outlines((radius, beyond)),
            age=self._age(point),
        )

    def _age(self, point: int) -> float:
        """Return the age of a point's runs in the middle of their averages, to two digits.

        Where no task is complete, that of the paper's runs.
        """
        if not (self.has("transient_time") and self.done[point].any()):
            return PAPERS_AGE
        ends = [self.value(name)[point][self.done[point]].mean()
                for name in ("transient_time", "time")]  # fmt: skip
        age = float(f"{0.5 * sum(ends):.2g}")
        return age if age >= 0.0 and math.isfinite(age) else PAPERS_AGE

    def _outlines(self, radii: tuple[float, float]) -> dict[str, Outline | None]:
        """Return the outlines of urns that are polygons, from their radii if they are regular."""
        if self.attributes.get("urn_shape", "disc") == "disc":
            return {}
        root = self._file.attrs
        if "urn_sides" in root:
            sides = int(np.ravel(root["urn_sides"])[0])
            one, two = (regular(sides, radius) for radius in radii)
        else:
            one, two = (outline_of(root[name]) for name in ("urn_vertices", "urn2_vertices"))
        return {"outline": one, "urn2_outline": two if two != one else None}

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
                f"{self.path}: {found.unlike} at point {point + 1}; "
                "this needs two urns and two gates that are alike"
            )
        return replace(found.sides[0], gate=gate)

    def _of_point(self, name: str, point: int) -> object:
        """Return the value of a dataset or attribute at a point."""
        return self._array(name)[point]

    def _array(self, name: str) -> h5py.Dataset | NDArray[np.generic]:
        """Return a dataset: read once, and as a whole, unless it is large."""
        if name not in self._arrays:
            dataset = self._dataset(name)
            if dataset.nbytes > KEPT:
                return dataset
            self._need_memory([dataset])
            self._arrays[name] = dataset[()]
        return self._arrays[name]

    def replica_mean(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return mean and standard error over the replicas of each point, shape (point,).

        The error is from the scatter of the replicas; for one replica it is its own
        (`NAME_error`), NaN if that is not known. NaN if replicas are in two states.
        """
        one_state = self.done & ~self.two_states[:, None]
        values = np.where(one_state, self.value(name), math.nan)
        own = self.value(f"{name}_error") if self.has(f"{name}_error") else math.nan * values
        return mean_and_error(values, own)

    def net_current(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return net current and its standard error over the replicas of each point.

        It has a sign, so that homogeneous states scatter about 0. A polarised state may have either
        polarity: its current is counted along it, `polarised_current`.
        """
        current, error = self.replica_mean("current1")
        if self.shape != "circuit":
            return current, error
        along, along_error = self.polarised_current()
        polarised = (self.replica_mean("chi")[0] > POLARISED) & np.isfinite(along)
        return np.where(polarised, along, current), np.where(polarised, along_error, error)

    def polarised_current(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return net current along the instantaneous polarity, and its error, of each point.

        So reversals of the polarity do not cancel it. For a file without it, the absolute current
        of channel 1 in each replica; for a single urn, its current.
        """
        if self.shape != "circuit":
            return self.replica_mean("current1")
        if self.has("polarised_current"):
            return self.replica_mean("polarised_current")
        sizes = np.abs(np.where(self.done, self.value("current1"), math.nan))
        own = self.value("current1_error") if self.has("current1_error") else math.nan * sizes
        return mean_and_error(sizes, own)

    def series(self, point: int, replica: int) -> Series:
        """Return the series of a task, from the first interval on.

        Raises `InputError` if none was requested.
        """
        if not self.has("series/time"):
            raise InputError(f"{self.path}: has no series (set series_interval in &output)")
        self._check_task(point, replica)
        time = np.asarray(self._array("series/time"), float)
        number = self._array("series/urn1_number")[point, replica]
        flows = {
            name: np.asarray(self._array(f"series/{name}")[point, replica], float) for name in FLOWS
        }
        number = np.asarray(number, float)
        there = np.isfinite(number) & np.isfinite(flows["flow1_12"]) & (number >= 0)
        there &= time > 0.0  # the entry at the start has no interval before it
        if not there.any():
            raise InputError(f"{self.path}: the series of point {point + 1} is empty")
        rates = {name: flow[there] for name, flow in flows.items()}
        return Series(time[there], number[there], rates)

    def snapshot_times(self) -> NDArray[np.float64]:
        """Return the times of the snapshots; raise `InputError` if there are none."""
        if not (self.has("snapshots/time") and self.value("snapshots/time").size):
            raise InputError(f"{self.path}: has no snapshots (set snapshot_times in &output)")
        return self.value("snapshots/time")

    def snapshot(self, point: int, replica: int, index: int) -> Snapshot:
        """Return one snapshot of a task; `index` counts from 0, or from the end if negative."""
        times = self.snapshot_times()
        if not -times.size <= index < times.size:
            raise InputError(f"{self.path}: has {times.size} snapshots, there is no such one")
        self._check_task(point, replica)
        index %= times.size
        return self._snapshots(point, replica, slice(index, index + 1))[0]

    def snapshots(self, point: int, replica: int) -> list[Snapshot]:
        """Return all snapshots of a task; for thousands much faster than one by one."""
        self._check_task(point, replica)
        return self._snapshots(point, replica, slice(None))

    def _snapshots(self, point: int, replica: int, part: slice) -> list[Snapshot]:
        names = ("x", "y", "ux", "uy")
        times = self.snapshot_times()[part]
        count = int(self._of_point("number", point))
        columns = [self._dataset(f"snapshots/{name}") for name in names]
        states = np.array([one[point, replica, part, :count] for one in columns], float)
        reached = np.isfinite(states[0]).all(axis=1)
        if not reached.all():
            first = times[~reached][0]
            raise InputError(f"{self.path}: the snapshot at time {first:g} was not reached")
        return [Snapshot(float(time), *states[:, k]) for k, time in enumerate(times)]

    def events(self) -> dict[str, NDArray[np.float64]]:
        """Return the event log (time, kind, where, particle), empty if there is none."""
        if not self.has("events/time"):
            return {}
        return {
            name: self.value(f"events/{name}") for name in ("time", "kind", "where", "particle")
        }

    def _check_task(self, point: int, replica: int) -> None:
        for what, index, count in (
            ("point", point, self.points),
            ("replica", replica, self.replicas),
        ):
            if not 0 <= index < count:
                raise InputError(f"{self.path}: has {count} {what}(s), there is no {index + 1}")


def _hdf5(path: Path) -> h5py.File:
    """Return an open file; without HDF5's lock, which some network disks refuse.

    Where this Python has the file open with a lock, HDF5 opens it again only with one.
    """
    try:
        return h5py.File(path, "r", locking=False)
    except OSError:
        try:
            return h5py.File(path, "r")
        except OSError as problem:
            reason = " ".join(str(problem).split())
            if problem.errno == errno.EAGAIN:
                reason = "is open in another program, which may change it; close it there"
            raise InputError(f"{path}: {reason}") from problem


def _dimensions(dataset: h5py.Dataset) -> tuple[str, ...] | None:
    """Return the names of the dimensions of a dataset; None if it is not of this program.

    They are read from its attributes: HDF5's own calls crash at damaged ones (`H5DSis_scale`).
    """
    if dataset.attrs.get("CLASS") == b"DIMENSION_SCALE":
        return (dataset.name.rpartition("/")[2],)
    scales = dataset.attrs.get("DIMENSION_LIST", ())
    if len(scales) == 0 or not all(len(references) for references in scales):
        return None
    return tuple(dataset.file[one[0]].name.rpartition("/")[2] for one in scales)


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


@contextmanager
def opened(paths: Sequence[Path], *, verify: bool = False) -> Iterator[list[Results]]:
    """Open several files of results for a `with` statement."""
    with ExitStack() as stack:
        yield [stack.enter_context(Results(path, verify=verify)) for path in paths]


def mean_and_error(
    values: NDArray[np.float64], own_errors: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and standard error over the last axis of the finite values (`replica_mean`)."""
    good = np.isfinite(values)
    count = good.sum(axis=-1)
    safe = np.maximum(count, 1)
    mean = np.where(good, values, 0.0).sum(axis=-1) / safe
    squares = np.where(good, (values - mean[..., None]) ** 2, 0.0).sum(axis=-1)
    between = np.sqrt(squares / np.maximum(count - 1, 1) / safe)
    own = np.where(good, own_errors, 0.0).sum(axis=-1)
    error = np.where(count > 1, between, np.where(count == 1, own, math.nan))
    return np.where(count == 0, math.nan, mean), error

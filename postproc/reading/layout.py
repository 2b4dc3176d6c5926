"""Allowed contents of a results file: datasets and attributes, with dimensions and types.

Anyone can make a results file: the digest at its end needs no secret. So it is checked against this
list before its data are used (`check_layout`). Everything else is refused, and so are objects that
are not stored in the file itself: soft and external links, external storage, virtual datasets,
named types, references, filters other than the program's.
"""

from __future__ import annotations

import math
import os
import re
import resource
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np
from h5py import h5d, h5s, h5t, h5z

from postproc.cli import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

# Keys that can be scanned.
SCANNED = (
    "threshold", "threshold_fraction", "number", "channel1_width", "channel2_width",
    "channel1_length", "channel2_length", "urn_radius", "urn1_fraction", "threshold2",
    "urn_radius2",
)  # fmt: skip
LENGTHS = ("channel1_width", "channel2_width", "channel1_length", "channel2_length")
STATE = ("x", "y", "ux", "uy")
FLOWS = ("flow1_12", "flow1_21", "flow2_12", "flow2_21")
AVERAGED = ("chi", "current1", "current2", "polarised_current")  # with errors from blocks
PARTICLES = 200_000_000  # largest number of the program

POINT, TASK = ("point",), ("point", "replica")


@dataclass(frozen=True)
class Declared:
    """A dataset: its dimensions, and the kind of its values, "i" or "f".

    A dimension without a "/" is one of the root; others are named within the group.
    """

    dims: tuple[str, ...]
    kind: str


def _datasets() -> dict[str, Declared]:
    """Return all datasets by their paths."""
    found = {name: Declared((name,), "i") for name in ("point", "replica", "gate", "urn")}
    found |= dict.fromkeys(("number", "threshold", "urn1_number", "point_status"),
                           Declared(POINT, "i"))  # fmt: skip
    found |= dict.fromkeys(LENGTHS, Declared(POINT, "f"))
    found["gate_threshold"] = Declared(("point", "gate"), "i")
    found["urn_radius"] = Declared(("point", "urn"), "f")
    for name in AVERAGED:
        found |= {name: Declared(TASK, "f"), f"{name}_error": Declared(TASK, "f")}
        found[f"{name}_spread"] = Declared(POINT, "f")
    for name in ("chi", "polarised_current"):
        found[f"{name}_replica_error"] = Declared(POINT, "f")
    real = ("chi_collision", *FLOWS, "time", "transient_time", "cpu_seconds",
            "provenance/begun", "provenance/ended")  # fmt: skip
    whole = ("seed", "task_status", "collisions", "bounce_backs", "reversals", "trapped",
             "provenance/host")  # fmt: skip
    found |= dict.fromkeys(real, Declared(TASK, "f"))
    found |= dict.fromkeys(whole, Declared(TASK, "i"))
    found |= {f"scan/{key}": Declared((key,), "f") for key in SCANNED}
    found |= {f"{group}/time": Declared(("time",), "f") for group in ("series", "snapshots")}
    found |= {f"{group}/particle": Declared(("particle",), "i") for group in ("snapshots", "final")}
    found["series/urn1_number"] = Declared((*TASK, "time"), "i")
    found |= {f"series/{name}": Declared((*TASK, "time"), "f") for name in FLOWS}
    found |= {f"snapshots/{name}": Declared((*TASK, "time", "particle"), "f") for name in STATE}
    found |= {f"final/{name}": Declared((*TASK, "particle"), "f") for name in STATE}
    found |= {f"events/{name}": Declared(("event",), "i")
              for name in ("event", "kind", "where", "particle")}  # fmt: skip
    found["events/time"] = Declared(("event",), "f")
    return found


DATASETS = _datasets()
GROUPS = ("series", "snapshots", "final", "events", "scan", "provenance")
# Attributes that are texts, and those that are numbers, with their largest extents.
ROOT_TEXTS = {
    "program", "version", "git_commit", "compiler", "compiler_options", "mpi_library",
    "hdf5_library", "gsl_library", "namelist", "created", "status", "initial_file_fingerprint",
    "shape", "urn_shape", "scatterers", "engine", "scan",
}  # fmt: skip
PROVENANCE_TEXTS = {"command_line", "begun", "ended", "hosts"}
ROOT_NUMBERS = {"mpi_ranks": 1, "start_time": 1, "urn_sides": 1,
                "urn_vertices": 1 << 16, "urn2_vertices": 1 << 16}  # fmt: skip
TEXTS = {"units", "long_name", "flag_meanings"}
NUMBERS = {"_FillValue": 1, "flag_values": 16}
# Attributes of dimension scales; they are not read, since the list has the dimensions.
SCALES = {"CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST"}
# Attributes that determine the model have one of these words.
CHOICES = {"status": ("complete", "partial"), "shape": ("circuit", "urn"),
           "urn_shape": ("disc", "polygon")}  # fmt: skip

FILTERS = {h5z.FILTER_SHUFFLE, h5z.FILTER_DEFLATE}
PIECE = 1 << 20  # bytes of the largest piece of a compressed dataset
SMALLER = 1100  # largest compression ratio
LONGEST = 200  # characters of a unit or of a meaning
VERSION = re.compile(r"[0-9a-z.-]{1,32}")  # pattern of a version


def check_layout(path: Path, file: h5py.File) -> None:
    """Raise `InputError` if an open file holds anything that the program does not write."""
    try:
        found = dict(_walk(path, file))
        _check_shapes(path, found)
        _check_attributes(path, "/", file, ROOT_TEXTS, ROOT_NUMBERS)
    except InputError:
        raise
    # HDF5 raises any of these for a file that it cannot read.
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as problem:
        reason = " ".join(str(problem).split())
        raise InputError(f"{path}: not as battery writes it ({reason})") from problem


def _walk(path: Path, file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Iterate over all datasets, each one checked by itself, and its path."""
    for name in _names(path, file, ""):
        if name in GROUPS:
            group = file[name]
            if not isinstance(group, h5py.Group):
                raise InputError(f"{path}: {name} is no group")
            texts = PROVENANCE_TEXTS if name == "provenance" else set()
            _check_attributes(path, name, group, texts, {})
            for one in _names(path, group, f"{name}/"):
                yield f"{name}/{one}", _dataset(path, group, f"{name}/{one}")
        else:
            yield name, _dataset(path, file, name)


def _names(path: Path, group: h5py.Group, inside: str) -> Iterator[str]:
    """Iterate over the names in a group, each of which must be known and stored in the group."""
    for word in group.id:
        name = word.decode("utf-8", "replace")
        known = inside + name in DATASETS or (not inside and name in GROUPS)
        if not known:
            raise InputError(f"{path}: has {inside}{name}, which battery does not write")
        if group.id.links.get_info(word).type != h5py.h5l.TYPE_HARD:
            raise InputError(f"{path}: {inside}{name} is a link out of its place")
        yield name


def _dataset(path: Path, group: h5py.Group, name: str) -> h5py.Dataset:
    """Return a dataset that is stored in the file itself, with values of the declared kind."""
    # The storage is checked first: reading the shape of a virtual dataset opens other files.
    one = h5py.h5o.open(group.id, name.rpartition("/")[2].encode())
    if not isinstance(one, h5d.DatasetID):
        raise InputError(f"{path}: {name} is no dataset")
    stored, of_type = one.get_create_plist(), one.get_type()
    ways = (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED)
    if stored.get_layout() not in ways or stored.get_external_count() > 0:
        raise InputError(f"{path}: {name} does not lie in the file itself")
    filters = [stored.get_filter(at)[0] for at in range(stored.get_nfilters())]
    if not FILTERS.issuperset(filters) or h5z.FILTER_DEFLATE in filters[:-1]:
        raise InputError(f"{path}: {name} was made with a filter that battery does not use")
    kinds = {"i": h5t.TypeIntegerID, "f": h5t.TypeFloatID}
    if not isinstance(of_type, kinds[DATASETS[name].kind]) or of_type.committed():
        raise InputError(f"{path}: {name} has values of another type than battery writes")
    dataset = h5py.Dataset(one)
    if dataset.dtype.kind != DATASETS[name].kind or dataset.dtype.itemsize > 8:
        raise InputError(f"{path}: {name} has values of another type than battery writes")
    if dataset.chunks:
        _check_pieces(path, name, dataset)
    _check_attributes(path, name, dataset, TEXTS, NUMBERS)
    return dataset


def _check_pieces(path: Path, name: str, dataset: h5py.Dataset) -> None:
    """Check that chunks are not larger than the program's, and have the bytes of their values.

    A chunk that inflates to more bytes would use memory without bound; for one that is shorter HDF5
    would read other memory beyond its end.
    """
    piece = math.prod(dataset.chunks) * dataset.dtype.itemsize
    if piece > PIECE:
        raise InputError(f"{path}: {name} has pieces larger than any that battery writes")
    pieces = math.prod(n // m + 1 for n, m in zip(dataset.shape, dataset.chunks, strict=True))
    if dataset.id.get_storage_size() > pieces * (1.01 * piece + 64):
        raise InputError(f"{path}: {name} takes more of the file than its values do")
    found: list[h5d.StoreInfo] = []
    dataset.id.chunk_iter(found.append)
    last = dataset.id.get_create_plist().get_nfilters() - 1
    for one in found:
        whole = one.size == piece
        if one.size <= 2 * piece + 64 and last >= 0 and not one.filter_mask & 1 << last:
            inflating = zlib.decompressobj()
            _, raw = dataset.id.read_direct_chunk(one.chunk_offset)
            try:
                whole = len(inflating.decompress(raw, piece + 1)) == piece
            except zlib.error:
                whole = False
        if not whole:
            raise InputError(f"{path}: {name} has pieces of another length than its values")


def _check_shapes(path: Path, found: dict[str, h5py.Dataset]) -> None:
    """Check that each dimension has one length, and that all data to be read fit into memory."""
    lengths: dict[str, int] = {"gate": 2, "urn": 2}
    # Datasets of lower rank come first: the length of a dimension is that of its coordinates.
    for name, dataset in sorted(found.items(), key=lambda one: len(DATASETS[one[0]].dims)):
        declared = DATASETS[name].dims
        if dataset.id.get_space().get_simple_extent_type() != h5s.SIMPLE:
            raise InputError(f"{path}: {name} has no dimensions")
        shape = dataset.shape
        if len(shape) != len(declared):
            raise InputError(f"{path}: {name} has {len(shape)} dimensions in place of "
                             f"{' x '.join(declared)}")  # fmt: skip
        group = name.rpartition("/")[0]
        for dimension, length in zip(declared, shape, strict=True):
            own = dimension if dimension in ("gate", "urn", *TASK) else f"{group}/{dimension}"
            empty = length == 0 and dimension != "event"
            if length != lengths.setdefault(own, length) or empty:
                raise InputError(f"{path}: {name} has the shape {shape}, which does not fit the "
                                 f"others: {own} has {lengths[own]}")  # fmt: skip
        # Only if replicas are missing may the file have less data than a shape says.
        if len(shape) == 1 and name != "events/event" and (
            dataset.nbytes > SMALLER * (dataset.id.get_storage_size() + 64)
        ):  # fmt: skip
            raise InputError(f"{path}: {name} says it has more values than there are in the file")
    # The root is read as a whole; for groups, `Results.dataset` checks what it reads at once.
    check_memory(path, [one for name, one in found.items() if "/" not in name])
    for name, one in found.items():
        if "/" in name:
            check_memory(path, [one])


def check_memory(path: Path, datasets: Iterable[h5py.Dataset]) -> None:
    """Raise `InputError` if datasets that are read together do not fit into memory."""
    needed = sum(one.nbytes for one in datasets)
    if needed > (left := memory_left()):
        raise InputError(f"{path}: needs {needed:.3g} bytes of memory, there are {left:.3g}")


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


def _check_attributes(
    path: Path, name: str, thing: h5py.HLObject, texts: set[str], numbers: dict[str, int]
) -> None:
    """Each attribute is one text or so many numbers, as the lists have it."""
    for key in thing.attrs:
        where = f"{path}: attribute {key} of {name}"
        if key in SCALES and isinstance(thing, h5py.Dataset):
            continue
        if key not in texts and key not in numbers:
            continue  # a remark of a reader
        one = thing.attrs.get_id(key)
        of_type, count = one.get_type(), math.prod(one.shape or ())
        kinds = (h5t.TypeIntegerID, h5t.TypeFloatID) if key in numbers else h5t.TypeStringID
        right = isinstance(of_type, kinds) and not of_type.committed()
        right &= one.get_space().get_simple_extent_type() != h5s.NULL
        right &= key in texts or of_type.get_size() <= 8
        if not right or not 0 < count <= numbers.get(key, 1):
            raise InputError(f"{where}: is not as battery writes it")
        text = text_of(thing.attrs[key]) if key in TEXTS else ""
        if len(text) > LONGEST or not text.isprintable():
            raise InputError(f"{where}: is too long, or has control characters")
    if name == "/":
        _check_words(path, thing.attrs)


def _check_words(path: Path, root: h5py.AttributeManager) -> None:
    """Check that attributes of the root that determine the model have allowed values."""
    for key, allowed in CHOICES.items():
        if key in root and text_of(root[key]) not in allowed:
            raise InputError(f"{path}: attribute {key} is none of {', '.join(allowed)}")
    keys = text_of(root["scan"]).split() if "scan" in root else []
    if not set(keys) <= set(SCANNED) or len(set(keys)) < len(keys):
        raise InputError(f"{path}: attribute scan names what is no key of a scan")


def text_of(value: object) -> str:
    """Return an attribute as printable text, whatever its bytes are."""
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size else ""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    return str(value).encode("utf-8", "replace").decode("utf-8").rstrip()

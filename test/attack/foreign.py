"""Results files of strangers: edits are drawn, the digest is made anew, and everything reads them.

A larger namelist goes on with the file; `open_results`, `report` and a figure read it,
in one process of Python. Each must end with exit 0, or with exit 2 and one line; no script gets
into a page, no bytes of another file into anything, and 2 GiB of address space are enough.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import random
import resource
import shutil
import struct
import sys
import traceback
import zlib
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from html.parser import HTMLParser
from multiprocessing import active_children, get_context
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from support.program import namelist, run, start

from postproc import cli, open_results, progress
from postproc.figures.__main__ import main as figures
from postproc.report.__main__ import main as report
from postproc.tests.runs import edited

from .common import PATIENCE, Outcome, command_line, ended
from .scene import workshop

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Edit = Callable[[h5py.File, random.Random, Path], str]

MEMORY = 2 << 30
DAY = 86400.0
ONE_AT_A_TIME = Lock()
# A file beside the results: whoever reads a number of it has this one.
READ = 0.73165029341
SECRET = struct.pack("<d", READ) * 512
HOSTILE = (
    '<img/src="x"onerror="planted()">', "<script>planted()</script>", "</script><script>planted()",
    "</main><svg/onload=planted()>", "\x1b]0;planted\x07", "$\\planted{$", "{{ planted }}",
    "../planted", "planted " * 5000, "\u202eplanted", "", "nan inf -1", "%n%s", "0.2.planted",
)  # fmt: skip
ODD = (0, -1, 1, 5, 2, 3, 1e6, -(2**31), 2**31 - 1, 1e-300, 1e300, float("nan"), float("inf"))
CASES: dict[str, dict[str, dict[str, Any]]] = {
    "map": {
        "scan": {"threshold": "1, 4", "channel2_width": "0.01, 0.1", "replicas": 2},
        "output": {"series_interval": 5, "snapshot_times": "0, 20", "final_state": ".true."},
    },
    "urn": {
        "table": {"shape": "'urn'"},
        "scan": {"threshold": "1, 4", "replicas": 2},
        "output": {"series_interval": 5},
    },
    "polygon": {
        "table": {"urn_shape": "'polygon'", "urn_sides": 6, "channel2_width": 0.2,
                  "scatterers": "0, 0, 0.02"},
        "output": {"event_log": ".true."},
    },
}  # fmt: skip
FIGURES = {"map": ("numris", "comp01", "comp05", "model"), "urn": ("app2", "app3", "app1"),
           "polygon": ("model",)}  # fmt: skip


def write(folder: Path, name: str, replicas: int) -> None:
    """Write the namelist of a case; only scans have replicas to add."""
    case = {"particles": {"number": 60}, "gate": {"threshold": 2}, "run": {"duration": 60},
            **CASES[name]}  # fmt: skip
    if "scan" in case:
        case["scan"] = {**case["scan"], "replicas": replicas}
    case["output"] = {**case["output"], "file": "'out.h5'"}
    (folder / "case.nml").write_text(namelist(**case), encoding="utf-8")


@functools.cache
def ours(name: str) -> Path:
    """Give the results of a case as the program leaves them."""
    folder = workshop() / f"foreign_{name}"
    with ONE_AT_A_TIME:
        if not (folder / "out.h5").exists():
            folder.mkdir()
            write(folder, name, 2)
            found = run("--quiet", "case.nml", folder=folder)
            assert found.returncode == 0, found.stderr
    return folder / "out.h5"


def datasets(file: h5py.File) -> list[str]:
    """List what can be edited."""
    names: list[str] = []
    file.visititems(lambda name, one: names.append(name) if isinstance(one, h5py.Dataset) else None)
    return sorted(names)


def drawn(file: h5py.File, choice: random.Random) -> str:
    """Draw a dataset; those that other things depend on are drawn more often."""
    often = ("number", "seed", "task_status", "provenance/host", "series/time", "threshold",
             "current1", "chi", "scan/threshold")  # fmt: skip
    there = [name for name in often if name in file] or datasets(file)
    return choice.choice(there if choice.random() < 0.4 else datasets(file))


def renamed(file: h5py.File, choice: random.Random, _: Path) -> str:
    """Give a dataset or a group another name."""
    name = choice.choice([drawn(file, choice), "series", "scan", "provenance"])
    if name not in file:
        return "nothing"
    new = choice.choice([*HOSTILE[:5], "chi", "x"]).replace("/", "") + str(choice.randrange(9))
    parent = file[name].parent
    parent.move(name.rpartition("/")[2], new)
    if parent.name == "/scan":
        file.attrs["scan"] = new
    return f"{name} is called {new!r}"


def told(file: h5py.File, choice: random.Random, _: Path) -> str:
    """Give an attribute another text, another type or another shape."""
    name = choice.choice(["/", "/", "/", "provenance", drawn(file, choice)])
    keys = [*file[name].attrs, "planted"]
    key = choice.choice(keys)
    text = choice.choice(HOSTILE)
    value = choice.choice([
        text, text, text, text.encode() + b"\xff", [text] * 3, 5, -1, float("nan"), file["chi"].ref,
        np.zeros((3, 2)), np.zeros(2**12), h5py.Empty("f8"), h5py.Empty(h5py.string_dtype()),
    ])  # fmt: skip
    if isinstance(value, h5py.Reference):
        file[name].attrs.create(key, value, dtype=h5py.ref_dtype)
    else:
        file[name].attrs[key] = value
    return f"{name}@{key} is {str(value)[:40]!r}"


def lacking(file: h5py.File, choice: random.Random, _: Path) -> str:
    """Leave something out."""
    if choice.random() < 0.5:
        name = choice.choice([*datasets(file), "series", "scan", "provenance"])
        if name in file:
            del file[name]
        return f"no {name}"
    key = choice.choice([*file.attrs])
    del file.attrs[key]
    return f"no attribute {key}"


def valued(file: h5py.File, choice: random.Random, _: Path) -> str:
    """Change values: one, a row or all."""
    name, value = drawn(file, choice), choice.choice(ODD)
    one = file[name]
    if one.dtype.kind == "i":
        value = int(np.nan_to_num(value, nan=7, posinf=9, neginf=9)) if abs(value) < 2**62 else 9
    where = choice.choice([..., tuple(choice.randrange(n) for n in one.shape), 0])
    one[where] = value
    return f"{name}[{where}] is {value}"


def shaped(file: h5py.File, choice: random.Random, _: Path) -> str:
    """Change a shape, with or without the values."""
    name = drawn(file, choice)
    old = file[name]
    shape, dtype, values = list(old.shape), old.dtype, old[()]
    at = choice.randrange(len(shape))
    shape[at] = max(shape[at] + choice.choice([-1, 1, 2, 2**10, 2**31, 2**40]), 0)
    shape = choice.choice([shape, shape, [*shape, 2], shape[1:], [2**20] * len(shape)])
    attributes = dict(old.attrs) if choice.random() < 0.2 else {}
    del file[name]
    if np.prod([float(n) for n in shape]) < 2**16 and choice.random() < 0.7:
        new = file.create_dataset(name, data=np.resize(values, shape))
    else:
        chunks = True if choice.random() < 0.3 and 0 not in shape and shape else None
        new = file.create_dataset(name, shape, dtype, chunks=chunks)
    for key in ("units", "long_name"):
        if key in attributes:
            new.attrs[key] = attributes[key]
    return f"{name} has the shape {shape}"


def typed(file: h5py.File, choice: random.Random, _: Path) -> str:
    """Change the type of values."""
    name = drawn(file, choice)
    shape = file[name].shape
    del file[name]
    way = choice.randrange(8)
    types = ("f4", "u8", ">f8", "S8", h5py.string_dtype(), h5py.ref_dtype, h5py.regionref_dtype,
             np.dtype([("a", "f8"), ("b", "i4")]))  # fmt: skip
    if choice.random() < 0.2:
        file["planted"] = np.dtype("f8")
        file.create_dataset(name, shape, file["planted"])
        return f"{name} has a named type"
    file.create_dataset(name, shape, types[way])
    return f"{name} has the type {types[way]}"


def linked(file: h5py.File, choice: random.Random, secret: Path) -> str:
    """Put a link in the place of a dataset or a group."""
    name = choice.choice([drawn(file, choice), "series", "final", "provenance", "scan"])
    other = choice.choice(datasets(file))
    link = choice.choice([
        h5py.SoftLink(f"/{other}"), h5py.SoftLink("/nowhere"), h5py.SoftLink(f"/{name}"),
        h5py.ExternalLink(str(secret), "/chi"), h5py.ExternalLink("out.h5", f"/{other}"),
        h5py.ExternalLink(str(ours("map")), f"/{name}"), file[other], file["/"],
    ])  # fmt: skip
    if name in file:
        del file[name]
    file[name] = link
    return f"{name} is a {type(link).__name__} to {other}"


def stored(file: h5py.File, choice: random.Random, secret: Path) -> str:
    """Store a dataset in another way: outside, virtual, with other filters, in huge pieces."""
    name = drawn(file, choice)
    shape, dtype, values = file[name].shape, file[name].dtype, file[name][()]
    way = choice.choice(["external", "external", "virtual", "lzf", "fletcher", "scale", "piece",
                         "bomb", "short", "plugin"])  # fmt: skip
    del file[name]
    if way == "external":
        place = choice.choice([str(secret), secret.name, "/etc/passwd"])
        file.create_dataset(name, shape, dtype, external=[(place, 0, h5py.h5f.UNLIMITED)])
    elif way == "virtual":
        layout = h5py.VirtualLayout(shape, dtype)
        layout[...] = h5py.VirtualSource(str(ours("map")), name, shape)
        file.create_virtual_dataset(name, layout)
    elif way == "piece":
        file.create_dataset(name, shape, dtype, maxshape=(None,) * len(shape),
                            chunks=tuple(2 ** (24 // len(shape)) for _ in shape))  # fmt: skip
    elif way in ("bomb", "short"):
        piece = bytes(1 << 28)
        if way == "short":
            piece = values.tobytes()[: choice.randrange(values.nbytes)]
        one = file.create_dataset(name, shape, dtype, chunks=shape, compression="gzip")
        one.id.write_direct_chunk((0,) * len(shape), zlib.compress(piece, 9))
    elif way == "plugin":
        made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        made.set_chunk(shape)
        made.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))
        space = h5py.h5s.create_simple(shape)
        with contextlib.suppress(ValueError, RuntimeError):
            h5py.h5d.create(file.id, name.encode(), h5py.h5t.py_create(dtype), space, made)
    else:
        more = {"lzf": {"compression": "lzf"}, "fletcher": {"fletcher32": True},
                "scale": {"scaleoffset": 2}}[way]  # fmt: skip
        file.create_dataset(name, data=values, **more)
    return f"{name} is stored by {way}"


def added(file: h5py.File, choice: random.Random, _: Path) -> str:
    """Add what the program does not write."""
    name = choice.choice(["planted", "series/planted", "scan/planted", "<b>planted</b>", "a/b/c"])
    if choice.random() < 0.5:
        file.create_dataset(name, data=np.zeros(3))
    else:
        file.create_group(name)
    return f"{name} is added"


def said(file: h5py.File, choice: random.Random, _: Path) -> str:
    """Change the namelist that the file says it is from."""
    text = str(file.attrs["namelist"])
    places = [at for at, one in enumerate(text) if one.isdigit()]
    at = choice.choice(places)
    new = choice.choice(["", "9", "1e9", "-", "000000", "\x1b[31m", "<b>"])
    file.attrs["namelist"] = text[:at] + new + text[at + 1:]
    return f"namelist: {text[at - 12:at]}{new!r}"


EDITS: list[Edit] = [renamed, told, told, lacking, valued, valued, valued, shaped, shaped, typed,
                     linked, stored, stored, added, said]  # fmt: skip


class Planted(HTMLParser):
    """Looks for what a browser would run of what was planted."""

    def __init__(self) -> None:
        """Nothing is found yet."""
        super().__init__()
        self.found: list[str] = []
        self.runs = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Look for an attribute that is a script, or has what was planted."""
        self.runs = tag == "script" and ("type", "application/json") not in attrs
        self.found += [f"{tag} {key}={value}" for key, value in attrs
                       if key.startswith("on") or "planted" in f"{key}{value}"]  # fmt: skip

    def handle_endtag(self, tag: str) -> None:
        """Take note that a script is over."""
        self.runs = self.runs and tag != "script"

    def handle_data(self, data: str) -> None:
        """Look for text of the file in a script of the page."""
        if self.runs and "planted" in data:
            self.found.append(f"script: {data[:80]}")


def limit() -> None:
    """Let this process have so much memory."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def only_errors() -> None:
    """Limit the memory of the process that reads; how far it is it tells to nobody."""
    limit()
    progress.SILENT = DAY


def opened_in_python(path: Path) -> Iterator[str]:
    """Iterate over what is wrong with what `open_results` makes of a file."""
    for group in (None, "series", "snapshots", "final", "events"):
        try:
            data = open_results(path, group=group, theory=() if group else "window")
        except (cli.InputError, MemoryError) as problem:
            if len(str(problem).splitlines()) > 1:
                yield f"open_results {group}: {problem}"
        except Exception:  # whatever it is, it is a finding
            yield f"open_results {group}: {traceback.format_exc()[-900:]}"
        else:
            if any(SECRET[:8] in one.values.tobytes() for one in data.variables.values()):
                yield f"open_results {group}: bytes of another file"


def called_in_python(name: str, main: Callable[..., int], arguments: list[str]) -> Iterator[str]:
    """Iterate over what is wrong with how a command ends."""
    output, errors = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            code = cli.run(main, arguments)
    except SystemExit as stop:
        code = int(stop.code or 0)
    except Exception:
        yield f"{name}: {traceback.format_exc()[-900:]}"
        return
    if code not in (0, 2) or (code == 2 and errors.getvalue().count("\n") != 1):
        yield f"{name}: exit {code}: {errors.getvalue()[:600]}"
    words = output.getvalue() + errors.getvalue()
    if "\x1b" in words or str(READ)[:7] in words:
        yield f"{name} says {words[:300]!r}"


def in_python(folder: Path, figure: str) -> list[str]:
    """Tell what is wrong with what Python makes of a file."""
    path, made = folder / "out.h5", folder / "made"
    found = [*opened_in_python(path)]
    out = ["--output", str(made)]
    found += called_in_python("report", report, [str(path), "--model", "window", *out])
    found += called_in_python(f"figures {figure}", figures, [figure, str(path), *out])
    for page in made.glob("*.html") if made.is_dir() else ():
        text = page.read_text(encoding="utf-8")
        planted = Planted()
        planted.feed(text)
        found += [f"page: {one}" for one in planted.found]
        if str(READ)[:7] in text:
            found.append("page: bytes of another file")
    return found


@functools.cache
def reader() -> ProcessPoolExecutor:
    """Give the process of Python that reads all files."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=only_errors)


def attack(folder: Path, choice: random.Random) -> Outcome:
    """Edit one file in one way, or in a few, and let everything read it."""
    outcome = Outcome()
    name = choice.choice(["map", "map", "map", "urn", "polygon"])
    results, secret = folder / "out.h5", folder / "secret"
    shutil.copy(ours(name), results)
    secret.write_bytes(SECRET)
    told_: list[str] = []
    with edited(results) as file:
        for _ in range(choice.choice([1, 1, 1, 2, 3])):
            try:
                told_.append(choice.choice(EDITS)(file, choice, secret))
            # What HDF5 itself does not make is no file of anyone.
            except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError) as error:
                told_.append(f"not made: {str(error)[:60]}")
    what = "; ".join(told_)
    figure = choice.choice(FIGURES[name])
    with ONE_AT_A_TIME:
        try:
            wrong = reader().submit(in_python, folder, figure).result(4 * PATIENCE)
        except (TimeoutError, BrokenProcessPool) as problem:
            wrong = [f"Python hung or died: {type(problem).__name__}"]
            for process in active_children():
                process.kill()
            reader.cache_clear()
    outcome.findings += [f"{what}: {one}" for one in wrong]
    write(folder, name, 3)
    grown = ended(start("--quiet", "case.nml", folder=folder, prepare=limit))
    if wrong := grown.wrong({0, 2}):
        outcome.findings.append(f"{what}: growth: {wrong}")
    if "\x1b" in grown.words or "journal" in grown.words or ".tasks" in grown.words:
        outcome.findings.append(f"{what}: growth says {grown.words[-300:]!r}")
    if SECRET[:8] in results.read_bytes():
        outcome.findings.append(f"{what}: bytes of another file in the results")
    return outcome


if __name__ == "__main__":
    sys.exit(command_line("foreign", attack, __doc__ or ""))

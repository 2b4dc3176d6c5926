"""A results file of a stranger, sealed like our own, does not grow: one line, exit 2, no change."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest
from support.program import listing, namelist, run

from postproc.tests.runs import edited
from postproc.tests.test_foreign import SECRET, bomb, linked, outside, replaced, short, virtual

if TYPE_CHECKING:
    from collections.abc import Callable

CASE: dict[str, dict[str, Any]] = {
    "particles": {"number": 60},
    "gate": {"threshold": 2},
    "run": {"duration": 60},
    "scan": {"channel2_width": "0.01, 0.1", "replicas": 2},
    "output": {"file": "'out.h5'", "series_interval": 10, "snapshot_times": "0, 20",
               "final_state": ".true."},
}  # fmt: skip


def write(folder: Path, replicas: int) -> None:
    """Write the namelist."""
    case = {**CASE, "scan": {**CASE["scan"], "replicas": replicas}}
    (folder / "case.nml").write_text(namelist(**case))


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give results of the smaller namelist."""
    folder = tmp_path_factory.mktemp("ours")
    write(folder, 2)
    ended = run("--quiet", "case.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    return folder / "out.h5"


def given(file: h5py.File, name: str, value: float) -> None:
    """Give all of a dataset one value."""
    file[name][...] = value


EDITS: dict[str, tuple[str, Callable[[h5py.File, Path], None]]] = {
    "a host beyond the list": ("/provenance/host", lambda file, _: given(
        file, "provenance/host", 5)),
    "a host of -2**31": ("/provenance/host", lambda file, _: given(
        file, "provenance/host", -(2**31))),
    "another's seed": ("/seed", lambda file, _: file["seed"].__setitem__(0, file["seed"][1])),
    "a status": ("/task_status", lambda file, _: given(file, "task_status", 7)),
    "huge seeds": ("/seed", lambda file, _: replaced(
        file, "seed", shape=(2**20, 2**30), dtype="i8")),
    "huge snapshots": ("/snapshots/x", lambda file, _: replaced(
        file, "snapshots/x", shape=(2, 2, 2, 2**40), dtype="f8")),
    "huge series": ("/series/urn1_number", lambda file, _: replaced(
        file, "series/urn1_number", shape=(2, 2, 10**9), dtype="i4")),
    "shorter series": ("/series/flow1_12", lambda file, _: replaced(
        file, "series/flow1_12", data=np.zeros((2, 2, 3)))),
    "shorter states": ("/final/x", lambda file, _: replaced(
        file, "final/x", data=np.zeros((2, 2, 30)))),
    "external storage": ("/chi", lambda file, secret: outside(file, "chi", secret)),
    "external storage of states": ("/final/x", lambda file, secret: outside(
        file, "final/x", secret)),
    "virtual dataset": ("/chi", lambda file, secret: virtual(file, "chi", secret)),
    # Whoever followed these links would find what fits.
    "external link": ("/chi is a link", lambda file, secret: linked(
        file, "chi", h5py.ExternalLink(str(secret.with_name("others.h5")), "/chi"))),
    "external link to a group": ("is a link", lambda file, secret: linked(
        file, "final", h5py.ExternalLink(str(secret.with_name("others.h5")), "/final"))),
    "soft link": ("/chi is a link", lambda file, _: linked(
        file, "chi", h5py.SoftLink("/current1"))),
    "another filter": ("/chi", lambda file, _: replaced(
        file, "chi", data=np.zeros((2, 2)), compression="lzf")),
    "huge pieces": ("/chi", lambda file, _: replaced(
        file, "chi", shape=(2, 2), maxshape=(None, None), chunks=(2**10, 2**14), dtype="f8")),
    "a piece that grows": ("/chi", lambda file, _: bomb(file, "chi")),
    "a piece too short": ("/chi has pieces", lambda file, _: short(file, "chi")),
    "a piece too short, as it is": ("/chi has pieces", lambda file, _: short(file, "chi", 1)),
    "one of states too short": ("/final/x has pieces", lambda file, _: short(file, "final/x")),
    "text for numbers": ("/chi", lambda file, _: replaced(
        file, "chi", data=np.full((2, 2), b"nothing."))),
    "many texts": ("version", lambda file, _: file.attrs.__setitem__("version", ["0.2.0"] * 999)),
    "no hosts": ("hosts", lambda file, _: file["provenance"].attrs.__delitem__("hosts")),
    "escape sequence": ("version", lambda file, _: file.attrs.__setitem__(
        "version", "\x1b]0;owned\x07")),
}  # fmt: skip


@pytest.mark.parametrize("edit", EDITS)
def test_what_the_program_does_not_write_does_not_grow(
    ours: Path, tmp_path: Path, edit: str
) -> None:
    """The message names the file and what is wrong in it, and nothing is written."""
    named, change = EDITS[edit]
    (tmp_path / "secret").write_bytes(SECRET)
    shutil.copy(ours, tmp_path)
    shutil.copy(ours, tmp_path / "others.h5")
    with edited(tmp_path / "out.h5") as file:
        change(file, tmp_path / "secret")
    write(tmp_path, 3)
    before = listing(tmp_path)
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert "out.h5" in ended.stderr
    assert named in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert "\x1b" not in ended.stderr
    assert listing(tmp_path) == before


def test_control_characters_are_shown(tmp_path: Path) -> None:
    """Names of files may hold escape sequences too; they reach the terminal as digits."""
    ended = run("none\x1b[31m.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "none\\x1B[31m.nml" in ended.stderr
    assert "\x1b" not in ended.stderr

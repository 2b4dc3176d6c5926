"""`--json FILE` replaces no file but its own, and says when it cannot be written."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING

import pytest
from support.program import PROGRAM, namelist, run

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Give a folder with a short case of one particle, and the results of another case."""
    (tmp_path / "start.txt").write_text("-1.5 0.1 1 0\n")
    for name in ("case", "other"):
        (tmp_path / f"{name}.nml").write_text(
            namelist(
                particles={"number": 1, "initial_file": "'start.txt'"},
                gate={"threshold": 1},
                run={"duration": 5},
                output={"file": f"'{name}.h5'"},
            )
        )
    assert run("--quiet", "other.nml", folder=tmp_path).returncode == 0
    (tmp_path / "empty").touch()
    (tmp_path / "part").mkdir()
    os.link(tmp_path / "other.h5", tmp_path / "hard link")
    (tmp_path / "link").symlink_to("case.h5")
    (tmp_path / "table.json").write_text('{"results": [1, 2]}\n')
    line = run("--quiet", "--json", "/dev/stdout", "other.nml", folder=tmp_path).stdout
    assert line.startswith("{")
    (tmp_path / "lines.json").write_text(2 * line)
    return tmp_path


def contents(folder: Path) -> dict[Path, bytes]:
    """Give the contents of all files of a folder, to see that nothing was written."""
    return {path: path.read_bytes() if path.is_file() else b"" for path in folder.rglob("*")}


@pytest.mark.parametrize(
    "name",
    [
        "case.nml", "start.txt", "other.nml", "other.h5", "hard link",  # they exist
        "table.json", "lines.json",
        "case.h5", "./case.h5", "part/../case.h5", "link",  # these do not yet
        "case.h5.part", "case.h5.owner", "case.h5.tasks", "part", "no folder/new.json",
    ],
)  # fmt: skip
def test_no_other_file_is_replaced(folder: Path, name: str) -> None:
    before = contents(folder)
    for words in (["--check"], []):
        ended = run(*words, "--json", name, "case.nml", folder=folder)
        assert ended.returncode == 2, ended.stdout
        assert ended.stderr.startswith(f"battery: --json {name}: ")
        assert ended.stderr.count("\n") == 1
        assert contents(folder) == before


def test_a_new_file_is_written_and_then_replaced(folder: Path) -> None:
    for name in ("new.json", "empty"):
        for words in (["--check"], [], ["--check"]):
            assert run(*words, "--json", name, "case.nml", folder=folder).returncode == 0
            found = json.loads((folder / name).read_text())
            assert found["written_by"] == "battery --json"
            assert ("tasks" in found) == (words == ["--check"])
    assert run("--json", "/dev/null", "case.nml", folder=folder).returncode == 0


@pytest.mark.parametrize("to", ["| cat", "> out.txt; cat out.txt", ">> case.log; cat case.log"])
def test_standard_output_has_it_behind_the_other_lines(folder: Path, to: str) -> None:
    (folder / "case.log").write_text("kept\n")
    script = f'exec 3>&1; "{PROGRAM}" --json /dev/stdout case.nml {to}'
    lines = os.popen(f"cd {folder} && {script}").read().splitlines()
    assert json.loads(lines[-1])["results"] == str(folder / "case.h5")
    assert lines[0] == "kept" if "log" in to else len(lines) > 3


def test_what_cannot_be_written_is_an_error(folder: Path) -> None:
    for words in (["--check"], []):
        ended = run(*words, "--json", "/dev/full", "case.nml", folder=folder)
        assert ended.returncode == 1
        assert ended.stderr.startswith("battery: --json /dev/full: cannot be written: ")

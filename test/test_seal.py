"""A results file is taken for whole only if its digest is right; whatever is damaged is noticed."""

from __future__ import annotations

import random
import shutil
from typing import TYPE_CHECKING

import h5py
import pytest
from support.program import assert_same, listing, namelist, run

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SEAL = 512  # bytes at the end of a file
CASE = {
    "particles": {"number": "100"},
    "gate": {"threshold": "2"},
    "scan": {"channel2_width": "0.01, 0.02"},
    "output": {"file": "'out.h5'", "series_interval": "50", "final_state": ".true."},
}


def write(folder: Path, collisions: int = 20_000, **limits: str) -> None:
    """Write the input."""
    case = {**CASE, "run": {"collisions": str(collisions)}, "limits": limits}
    (folder / "case.nml").write_text(namelist(**case))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder with an input and its complete results."""
    folder = tmp_path_factory.mktemp("whole")
    write(folder)
    ended = run("--quiet", "case.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    return folder


def flip(path: Path, bit: int) -> None:
    """Flip one bit of a file."""
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


def zero(path: Path, first: int, count: int) -> None:
    """Write zeros over a part of a file."""
    content = bytearray(path.read_bytes())
    content[first : first + count] = bytes(count)
    path.write_bytes(content)


def cut(path: Path, size: int) -> None:
    """Keep the first bytes of a file; below 0: all but the last."""
    path.write_bytes(path.read_bytes()[:size])


def without_chi(path: Path) -> None:
    """Delete a dataset."""
    with h5py.File(path, "r+") as file:
        del file["chi"]


DAMAGES: dict[str, Callable[[Path], None]] = {
    "half": lambda path: cut(path, path.stat().st_size // 2),
    "no seal": lambda path: cut(path, -SEAL - 1),
    "one byte less": lambda path: cut(path, -1),
    "one byte more": lambda path: path.write_bytes(path.read_bytes() + b" "),
    "empty": lambda path: cut(path, 0),
    "first block of zeros": lambda path: zero(path, 0, 4096),
    "block of zeros in the middle": lambda path: zero(path, path.stat().st_size // 8192 * 4096, 64),
    "seal of zeros": lambda path: zero(path, path.stat().st_size - SEAL, SEAL),
    "all of zeros": lambda path: zero(path, 0, path.stat().st_size),
}


def test_whole_file_is_complete(whole: Path) -> None:
    """What was just written is complete."""
    ended = run("case.nml", folder=whole)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "is complete" in ended.stdout


def test_any_flipped_bit_is_noticed(whole: Path, tmp_path: Path) -> None:
    """Whichever bit of a file flips, it is not complete any more, and nothing is written."""
    write(tmp_path)
    size = (whole / "out.h5").stat().st_size
    chosen = random.Random(8)
    bits = [chosen.randrange(8 * size) for _ in range(12)]
    bits += [8 * (size - SEAL) + chosen.randrange(8 * SEAL) for _ in range(12)]
    for bit in bits:
        shutil.copy(whole / "out.h5", tmp_path)
        flip(tmp_path / "out.h5", bit)
        before = listing(tmp_path)
        ended = run("case.nml", folder=tmp_path)
        assert ended.returncode == 1, bit
        assert "complete" not in ended.stdout
        assert "out.h5 is damaged" in ended.stderr
        assert "--overwrite" in ended.stderr
        assert ended.stderr.count("\n") == 1
        assert listing(tmp_path) == before


@pytest.mark.parametrize(("damage", "ranks"), [*((name, 0) for name in DAMAGES), ("half", 2)])
def test_damage_is_noticed(whole: Path, tmp_path: Path, damage: str, ranks: int) -> None:
    """What is missing, cut short or overwritten: one line, exit 1, and --overwrite helps."""
    write(tmp_path)
    shutil.copy(whole / "out.h5", tmp_path)
    DAMAGES[damage](tmp_path / "out.h5")
    before = listing(tmp_path)
    ended = run("case.nml", folder=tmp_path, ranks=ranks)
    assert ended.returncode == 1
    assert "out.h5 is damaged" in ended.stderr
    assert listing(tmp_path) == before
    assert run("--overwrite", "--quiet", "case.nml", folder=tmp_path).returncode == 0
    assert_same(tmp_path / "out.h5", whole / "out.h5")


@pytest.mark.parametrize("change", [lambda path: cut(path, -SEAL), without_chi])
@pytest.mark.parametrize("words", [(), ("--check",)])
def test_a_file_without_a_digest_is_left_alone(
    whole: Path, tmp_path: Path, words: tuple[str, ...], change: Callable[[Path], None]
) -> None:
    """It is of before there were digests, or another program changed it: one line, exit 2."""
    write(tmp_path)
    shutil.copy(whole / "out.h5", tmp_path)
    change(tmp_path / "out.h5")
    before = listing(tmp_path)
    ended = run(*words, "case.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "out.h5 is of a version before 0.2.0, or was changed" in ended.stderr
    assert "--overwrite" in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert listing(tmp_path) == before


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder with partial results and their journal, and what they come to in `calm`."""
    folder = tmp_path_factory.mktemp("stopped")
    (folder / "calm").mkdir()
    write(folder / "calm", 2_000_000)
    assert run("--quiet", "case.nml", folder=folder / "calm").returncode == 0
    # So short that it is over at the first look.
    write(folder, 2_000_000, wall_minutes="1e-6")
    assert run("--quiet", "case.nml", folder=folder).returncode == 3
    write(folder, 2_000_000)
    return folder


@pytest.mark.parametrize("damage", DAMAGES)
def test_journal_makes_damaged_results_anew(stopped: Path, tmp_path: Path, damage: str) -> None:
    """Beside a journal, partial results that are damaged do not stop the run."""
    folder = tmp_path / "run"
    shutil.copytree(stopped, folder)
    DAMAGES[damage](folder / "out.h5")
    ended = run("case.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    assert "out.h5 is damaged, and is written anew from out.h5.tasks" in ended.stdout
    assert_same(folder / "out.h5", folder / "calm/out.h5")
    assert not (folder / "out.h5.tasks").exists()


def test_journal_goes_only_when_the_digest_is_right(stopped: Path, tmp_path: Path) -> None:
    """A journal beside complete results is removed if they are whole, used if they are not."""
    folder = tmp_path / "run"
    shutil.copytree(stopped, folder)
    shutil.copy(folder / "calm/out.h5", folder)
    ended = run("case.nml", folder=folder)
    assert ended.returncode == 0
    assert "is complete" in ended.stdout
    assert not (folder / "out.h5.tasks").exists()
    shutil.copytree(stopped / "out.h5.tasks", folder / "out.h5.tasks")
    flip(folder / "out.h5", 80_000)
    ended = run("case.nml", folder=folder)
    assert ended.returncode == 0
    assert "is complete" not in ended.stdout
    assert "going on" in ended.stdout
    assert_same(folder / "out.h5", folder / "calm/out.h5")


def test_foreign_hdf5_is_kept_beside_a_journal(stopped: Path, tmp_path: Path) -> None:
    """HDF5 of someone else is not taken for damaged results: exit 2, and it stays."""
    folder = tmp_path / "run"
    shutil.copytree(stopped, folder)
    with h5py.File(folder / "out.h5", "w") as file:
        file["temperature"] = [1.0, 2.0]
    before = listing(folder)
    ended = run("case.nml", folder=folder)
    assert ended.returncode == 2
    assert "out.h5 is not a results file" in ended.stderr
    assert "move it away" in ended.stderr
    assert listing(folder) == before

"""A results file is taken for whole only if its digest is right; whatever is damaged is noticed."""

from __future__ import annotations

import fcntl
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


def write(folder: Path, collisions: int = 20_000, replicas: int = 1, **limits: str) -> None:
    """Write the input."""
    case = {**CASE, "run": {"collisions": str(collisions)}, "limits": limits}
    case["scan"] = {**CASE["scan"], "replicas": str(replicas)}
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


def blanked_digit(path: Path) -> None:
    """Write a blank over a digit of the digest."""
    content = bytearray(path.read_bytes())
    content[content.rindex(b"sha256 ", 0, content.rindex(b"Before these")) + 9] = ord(" ")
    path.write_bytes(content)


def whole_length(path: Path) -> None:
    """Let HDF5 take the digest for a part of its data."""
    content = bytearray(path.read_bytes())
    content[40:48] = len(content).to_bytes(8, "little")
    path.write_bytes(content)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "half": lambda path: cut(path, path.stat().st_size // 2),
    "no seal": lambda path: cut(path, -SEAL - 1),
    "a bit, and one byte more": lambda path: (flip(path, 8 * 4001), lengthened(path)),
    "a bit, and one byte less": lambda path: (flip(path, 8 * 4001), shortened(path)),
    "a bit, and a digit of the digest": lambda path: (flip(path, 8 * 4001), blanked_digit(path)),
    "version of HDF5": lambda path: flip(path, 8 * 8),
    "length in HDF5, negative": lambda path: flip(path, 8 * 47 + 7),
    "length in HDF5, that of the file": whole_length,
    "empty": lambda path: cut(path, 0),
    "first block of zeros": lambda path: zero(path, 0, 4096),
    "block of zeros in the middle": lambda path: zero(path, path.stat().st_size // 8192 * 4096, 64),
    "all of zeros": lambda path: zero(path, 0, path.stat().st_size),
}


def test_whole_file_is_complete(whole: Path) -> None:
    """What was just written is complete."""
    ended = run("case.nml", folder=whole)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "is complete" in ended.stdout


def test_any_flipped_bit_is_noticed(whole: Path, tmp_path: Path) -> None:
    """Whichever bit of a file flips, it is not complete any more, and nothing is written.

    Where the digest is left and right, it is not said to be damaged.
    """
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
        damaged = "out.h5 is damaged" in ended.stderr
        assert damaged or bit >= 8 * (size - SEAL), bit
        assert ended.returncode == (1 if damaged else 2)
        assert "complete" not in ended.stdout
        assert ("--overwrite" in ended.stderr) == damaged
        assert ("--accept" in ended.stderr) != damaged
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
    assert run("--accept", "case.nml", folder=tmp_path).returncode in (1, 2)
    assert listing(tmp_path) == before
    assert run("--overwrite", "--quiet", "case.nml", folder=tmp_path).returncode == 0
    assert_same(tmp_path / "out.h5", whole / "out.h5")


def reopened(path: Path) -> None:
    """Open a file for appending, and change nothing."""
    h5py.File(path, "a").close()


def remarked(path: Path) -> None:
    """Add an attribute."""
    with h5py.File(path, "r+") as file:
        file.attrs["remark"] = "of its reader"


def rewritten(path: Path) -> None:
    """Write all anew in HDF5's latest format, with the attributes last, beyond 1 MiB."""
    old = path.rename(path.with_name("old.h5"))
    with h5py.File(old) as file, h5py.File(path, "w", libver="latest") as new:
        new["bytes"] = bytearray(2**21)
        for name in file:
            file.copy(name, new)
        for name, value in file.attrs.items():
            new.attrs[name] = value
    old.unlink()


def shortened(path: Path) -> None:
    """Cut off the last byte."""
    cut(path, -1)


def lengthened(path: Path) -> None:
    """Add a line end, as an editor or a mailer does."""
    path.write_bytes(path.read_bytes() + b"\n")


def blanked(path: Path) -> None:
    """Write zeros over the digest."""
    zero(path, path.stat().st_size - SEAL, SEAL)


@pytest.mark.parametrize("change", [reopened, remarked, rewritten, shortened, lengthened, blanked])
def test_a_file_that_lost_its_digest_is_left_alone_until_it_is_accepted(
    whole: Path, tmp_path: Path, change: Callable[[Path], None]
) -> None:
    """Runs and `--check` end with one line and exit 2; once it is accepted, the file grows."""
    write(tmp_path, replicas=2)
    assert run("--quiet", "case.nml", folder=tmp_path).returncode == 0
    undisturbed = (tmp_path / "out.h5").rename(tmp_path / "undisturbed.h5")
    write(tmp_path)
    shutil.copy(whole / "out.h5", tmp_path)
    change(tmp_path / "out.h5")
    before = listing(tmp_path)
    for words in ((), ("--check",)):
        ended = run(*words, "case.nml", folder=tmp_path)
        assert ended.returncode == 2
        assert "out.h5 was changed by another program" in ended.stderr
        assert "battery --accept FILE.nml" in ended.stderr
        assert "--overwrite" not in ended.stderr
        assert ended.stderr.count("\n") == 1
        assert listing(tmp_path) == before
    (tmp_path / "copy").mkdir()
    for file in tmp_path.glob("*.*"):
        shutil.copy(file, tmp_path / "copy")
    assert run("--overwrite", "--quiet", "case.nml", folder=tmp_path / "copy").returncode == 0
    shutil.rmtree(tmp_path / "copy")
    ended = run("--accept", "case.nml", folder=tmp_path, ranks=2)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "out.h5: accepted as it is" in ended.stdout
    assert "2 complete tasks" in ended.stdout
    assert listing(tmp_path).keys() == before.keys()
    assert "is complete" in run("case.nml", folder=tmp_path).stdout
    write(tmp_path, replicas=2)
    assert "going on: 2 of 4" in run("case.nml", folder=tmp_path).stdout
    assert_same(tmp_path / "out.h5", undisturbed)


def test_a_file_behind_bytes_of_another_program_is_not_called_damaged(
    whole: Path, tmp_path: Path
) -> None:
    """HDF5 may have a user block before it (`h5repack -u`); its data are whole."""
    write(tmp_path)
    (tmp_path / "out.h5").write_bytes(bytes(512) + (whole / "out.h5").read_bytes()[:-SEAL])
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "move it away" in ended.stderr
    assert "--overwrite" not in ended.stderr


def without_chi(path: Path) -> None:
    """Delete a dataset."""
    with h5py.File(path, "r+") as file:
        del file["chi"]


def another_seed(path: Path) -> None:
    """Exchange the seeds of two tasks."""
    with h5py.File(path, "r+") as file:
        file["seed"][...] = file["seed"][()][::-1]


def shorter(path: Path) -> None:
    """Drop the last particle."""
    with h5py.File(path, "r+") as file:
        values = file["final/x"][..., :-1]
        del file["final/x"]
        file["final/x"] = values


def no_numbers(path: Path) -> None:
    """Store compressed values that cannot be inflated."""
    with h5py.File(path, "r+") as file:
        shape = file["final/x"].shape
        del file["final/x"]
        new = file.create_dataset("final/x", shape, "f8", chunks=shape, compression="gzip")
        new.id.write_direct_chunk((0, 0, 0), b"spoilt")


def linked(path: Path) -> None:
    """Put a link to another results file in the place of a dataset that would fit."""
    shutil.copy(path, path.with_name("other.h5"))
    with h5py.File(path, "r+") as file:
        del file["chi"]
        file["chi"] = h5py.ExternalLink("other.h5", "/chi")


def outside(path: Path) -> None:
    """Store a dataset in another file."""
    path.with_name("secret").write_bytes(bytes(64))
    with h5py.File(path, "r+") as file:
        shape = file["chi"].shape
        del file["chi"]
        file.create_dataset("chi", shape, "f8", external=[("secret", 0, h5py.h5f.UNLIMITED)])


def endless(path: Path) -> None:
    """Claim a series of more entries than there is memory for."""
    with h5py.File(path, "r+") as file:
        del file["series/urn1_number"]
        file.create_dataset("series/urn1_number", (2, 1, 10**14), "i4", chunks=(1, 1, 1000))


def undone(path: Path) -> None:
    """Say of one task that it has not been done, in a file that calls itself complete."""
    with h5py.File(path, "r+") as file:
        file["task_status"][0, 0] = 2


def no_status(path: Path) -> None:
    """Give a task a status that no task can have, in a file that calls itself partial."""
    with h5py.File(path, "r+") as file:
        file["task_status"][0, 0] = 77
        file.attrs["status"] = "partial"


def made_again(path: Path) -> None:
    """Replace a dataset by one with the same numbers, but without its dimension scales."""
    with h5py.File(path, "r+") as file:
        values = file["chi"][()]
        del file["chi"]
        file["chi"] = values


def rounded(path: Path) -> None:
    """Replace the numbers of a dataset by those of half the length."""
    with h5py.File(path, "r+") as file:
        values = file["chi"][()]
        del file["chi"]
        file["chi"] = values.astype("f4")


def another_threshold(path: Path) -> None:
    """Change a parameter of a point."""
    with h5py.File(path, "r+") as file:
        file["threshold"][0] += 1


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        (made_again, 2, "/chi has lost its dimension scales"),
        (rounded, 2, "/chi has numbers of another type"),
        (another_threshold, 2, "/threshold has other values than those of the namelist"),
        (undone, 2, "/task_status"),
        (no_status, 2, "/task_status"),
        (linked, 2, "/chi is a link out of its place"),
        (outside, 2, "/chi does not lie in the file itself"),
        (endless, 2, "no memory for /series"),
        (without_chi, 2, "/chi is not there"),
        (another_seed, 2, "/seed has a seed"),
        (shorter, 2, "/final/x has the dimensions"),
        (no_numbers, 2, "/final/x"),
        (lambda path: cut(path, -SEAL - 1), 1, "damaged"),
        (lambda path: flip(path, 80_000), 1, "damaged"),
        (lambda path: path.write_bytes(b"no results"), 2, "not a results file"),
        (lambda path: path.unlink(), 2, "there is no results file to accept"),
    ],
)
def test_what_does_not_fit_is_not_accepted(
    whole: Path, tmp_path: Path, change: Callable[[Path], None], code: int, said: str
) -> None:
    write(tmp_path)
    shutil.copy(whole / "out.h5", tmp_path)
    change(tmp_path / "out.h5")
    before = listing(tmp_path)
    ended = run("--accept", "case.nml", folder=tmp_path)
    assert ended.returncode == code
    assert said in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert listing(tmp_path) == before


def test_results_of_another_input_are_not_accepted(whole: Path, tmp_path: Path) -> None:
    write(tmp_path, collisions=30_000)
    shutil.copy(whole / "out.h5", tmp_path)
    reopened(tmp_path / "out.h5")
    before = listing(tmp_path)
    ended = run("--accept", "case.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "collisions" in ended.stderr
    assert listing(tmp_path) == before


def test_a_file_that_is_open_for_writing_is_left_alone(whole: Path, tmp_path: Path) -> None:
    """Notebooks keep files open, with a lock; what they will write is not known."""
    write(tmp_path)
    shutil.copy(whole / "out.h5", tmp_path)
    for words in ((), ("--check",), ("--accept",)):
        with (tmp_path / "out.h5").open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            ended = run(*words, "case.nml", folder=tmp_path)
        assert ended.returncode == 2
        assert "out.h5 is open in another program" in ended.stderr
        assert "--overwrite" not in ended.stderr
    assert "is complete" in run("case.nml", folder=tmp_path).stdout


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
    damaged = (folder / "out.h5").read_bytes()
    ended = run("case.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    assert "out.h5 is damaged: the run keeps it as out.h5.damaged, and writes it" in ended.stdout
    assert (folder / "out.h5.damaged").read_bytes() == damaged
    assert_same(folder / "out.h5", folder / "calm/out.h5")
    assert not (folder / "out.h5.tasks").exists()


def test_results_that_were_damaged_before_are_not_replaced(stopped: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(stopped, folder)
    flip(folder / "out.h5", 80_000)
    (folder / "out.h5.damaged").write_text("of an earlier run")
    before = (folder / "out.h5").read_bytes()
    for option in ("--quiet", "--check"):
        ended = run(option, "case.nml", folder=folder)
        assert ended.returncode == 2
        assert "out.h5.damaged: is there already; move it away" in ended.stderr
    assert (folder / "out.h5").read_bytes() == before
    assert (folder / "out.h5.damaged").read_text() == "of an earlier run"


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

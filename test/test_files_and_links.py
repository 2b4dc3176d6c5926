"""Files are what they are, not what they are called: links, pipes, devices, folders in the way."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from typing import TYPE_CHECKING, Any

import pytest
from support.program import (
    ALONE,
    PATIENCE,
    assert_same,
    command_of,
    finish,
    listing,
    namelist,
    run,
    send,
    start,
    wait_for,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from subprocess import CompletedProcess

STARTS = "".join(f"-1.{k} 0.{k} 1 0.{k}\n" for k in range(1, 6))


def text_of(file: str = "out.h5", initial_file: str = "", **groups: dict[str, Any]) -> str:
    """Give a small case."""
    particles = {"number": 5, "initial_file": f"'{initial_file}'"}
    case: dict[str, dict[str, Any]] = {
        "particles": particles,
        "gate": {"threshold": 2},
        "run": {"collisions": 200_000},
        "scan": {"replicas": 1 if initial_file else 2},
        "output": {"file": f"'{file}'", "final_state": ".true."},
        **groups,
    }
    return namelist(**case)


def write(folder: Path, file: str = "out.h5", initial_file: str = "", **groups: Any) -> Path:
    """Write a small case and an initial file."""
    (folder / "start.txt").write_text(STARTS)
    path = folder / "case.nml"
    path.write_text(text_of(file, initial_file, **groups))
    return path


def link(folder: Path, name: str, target: str) -> None:
    """Make a symbolic link."""
    (folder / name).symlink_to(target)


def hard(folder: Path, name: str, target: str) -> None:
    """Give a file another name."""
    (folder / name).hardlink_to(folder / target)


# Output, initial file, command's namelist, and what is made before.
SAME: dict[str, tuple[str, str, str, Callable[[Path], None] | None]] = {
    "namelist by another path": ("case.nml", "", "./case.nml", None),
    "output by another path": ("./case.nml", "", "case.nml", None),
    "link to the namelist": ("out.h5", "", "case.nml", lambda f: link(f, "out.h5", "case.nml")),
    "namelist is a link": ("real.nml", "", "a.nml", lambda f: link(f, "a.nml", "real.nml")),
    "hard link": ("out.h5", "", "case.nml", lambda f: hard(f, "out.h5", "case.nml")),
    "initial file by another path": ("start.txt", "./start.txt", "case.nml", None),
    "link to the initial file": (
        "out.h5",
        "start.txt",
        "case.nml",
        lambda f: link(f, "out.h5", "start.txt"),
    ),
    "initial file under the temporary name": (
        "out.h5",
        "out.h5.part",
        "case.nml",
        lambda f: hard(f, "out.h5.part", "start.txt"),
    ),
    "initial file under the owner's name": (
        "out.h5",
        "out.h5.owner",
        "case.nml",
        lambda f: hard(f, "out.h5.owner", "start.txt"),
    ),
    "initial file among the tasks": (
        "out.h5",
        "out.h5.tasks/rank_0",
        "case.nml",
        lambda f: ((f / "out.h5.tasks").mkdir(), hard(f, "out.h5.tasks/rank_0", "start.txt")),
    ),
}


@pytest.mark.parametrize("case", SAME)
def test_an_output_is_no_input(tmp_path: Path, case: str) -> None:
    """By whatever name or link, an input is not overwritten: exit 2 and nothing changes."""
    file, initial_file, argument, prepare = SAME[case]
    source = write(tmp_path, file, initial_file)
    if file == "real.nml":
        source.rename(tmp_path / "real.nml")
    if prepare:
        prepare(tmp_path)
    before = listing(tmp_path)
    ended = run("--overwrite", argument, folder=tmp_path)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert "input file" in ended.stderr
    assert "&output file" in ended.stderr
    assert listing(tmp_path) == before


@pytest.mark.parametrize("what", ["folder", "pipe", "device", "circle"])
def test_an_output_is_a_file(tmp_path: Path, what: str) -> None:
    """Anything else is refused as an output, and stays as it is."""
    write(tmp_path)
    if what == "folder":
        (tmp_path / "out.h5").mkdir()
    elif what == "pipe":
        os.mkfifo(tmp_path / "out.h5")
    elif what == "device":
        link(tmp_path, "out.h5", "/dev/null")
    else:
        link(tmp_path, "out.h5", "other")
        link(tmp_path, "other", "out.h5")
    ended = run("--overwrite", "case.nml", folder=tmp_path)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert "&output file" in ended.stderr
    assert sorted(path.name for path in tmp_path.glob("out.h5*")) == ["out.h5"]


@pytest.mark.parametrize("there", [True, False])
def test_a_linked_output_replaces_what_it_points_to(tmp_path: Path, there: bool) -> None:
    """The link stays a link; its target is the results file, whether it was there or not."""
    write(tmp_path)
    store = tmp_path / "store"
    store.mkdir()
    if there:
        (store / "target.h5").touch()  # an empty file may be discarded
    link(tmp_path, "out.h5", "store/target.h5")
    ended = run("--overwrite", "case.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "out.h5").is_symlink()
    assert [path.name for path in store.iterdir()] == ["target.h5"]
    assert "is complete" in run("case.nml", folder=tmp_path).stdout


TEMPORARY = [
    "out.h5.tasks/plan.new",
    "out.h5.tasks/rank_0",
    f"out.h5.tasks/task_{1:016X}.b",
]


def test_nothing_is_written_through_a_link(tmp_path: Path) -> None:
    """What is temporary is made anew; the target of a link of that name stays as it was."""
    write(tmp_path, run={"collisions": 30_000_000}, limits={"checkpoint_minutes": 0.0001})
    (tmp_path / "out.h5.tasks").mkdir()
    targets = {name: tmp_path / f"precious{at}" for at, name in enumerate(TEMPORARY)}
    for name, target in targets.items():
        target.write_text("precious")
        link(tmp_path, name, str(target))
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 0, (ended.stdout, ended.stderr)
    assert {name for name, target in targets.items() if target.read_text() != "precious"} == set()
    assert sorted(p.name for p in tmp_path.glob("out*")) == ["out.h5"]


@pytest.mark.parametrize("what", ["pipe", "/dev/zero"])
def test_an_initial_file_is_a_file(tmp_path: Path, what: str) -> None:
    """A pipe or a device as initial file is refused at once."""
    name = "pipe" if what == "pipe" else what
    write(tmp_path, initial_file=name)
    if what == "pipe":
        os.mkfifo(tmp_path / name)
    ended = run("case.nml", folder=tmp_path, ranks=2)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert f"initial_file = '{name}': this is a pipe or a device; allowed: a file" in ended.stderr


def piped(folder: Path, *shell: str) -> CompletedProcess[str]:
    """Run a line of bash in which PROGRAM stands for the program."""
    return subprocess.run(
        ["bash", "-c", *shell],
        cwd=folder,
        env=ALONE,
        timeout=PATIENCE,
        check=False,
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize("way", ["<(cat case.nml)", "<(cat case.nml; sleep 0.3; echo '! end')"])
def test_a_namelist_through_a_pipe(tmp_path: Path, way: str) -> None:
    """A namelist that comes through a pipe is read to its end."""
    write(tmp_path)
    ended = piped(tmp_path, f"{' '.join(command_of())} --quiet {way}")
    assert ended.returncode == 0, ended.stderr
    again = run("case.nml", folder=tmp_path)
    assert "out.h5 is complete" in again.stdout, again.stderr


def test_a_namelist_through_a_pipe_on_two_ranks(tmp_path: Path) -> None:
    """One rank reads; the others get it from there."""
    write(tmp_path, initial_file="start.txt")
    os.mkfifo(tmp_path / "pipe.nml")
    process = start("--quiet", "pipe.nml", folder=tmp_path, ranks=2)
    (tmp_path / "pipe.nml").write_text((tmp_path / "case.nml").read_text())
    ended = finish(process)
    assert ended.returncode == 0, ended.stderr
    (tmp_path / "out.h5").rename(tmp_path / "piped.h5")
    assert run("--quiet", "case.nml", folder=tmp_path).returncode == 0
    assert_same(tmp_path / "out.h5", tmp_path / "piped.h5")


def test_a_pipe_that_nobody_fills_hears_a_signal(tmp_path: Path) -> None:
    """Waiting for the namelist, the program hears a signal."""
    os.mkfifo(tmp_path / "pipe.nml")
    process = start("pipe.nml", folder=tmp_path)
    at = tmp_path / "pipe.nml"

    def is_open() -> bool:
        try:
            os.close(os.open(at, os.O_WRONLY | os.O_NONBLOCK))
        except OSError:
            return False
        return True

    # To look for a reader is to be a writer for a moment: the text is empty, and refused.
    if wait_for(is_open, process):
        assert finish(process).returncode == 2
    process = start("pipe.nml", folder=tmp_path)
    descriptor = os.open(at, os.O_WRONLY)
    send([process.pid], signal.SIGTERM)
    ended = finish(process)
    os.close(descriptor)
    assert ended.returncode == 3, (ended.returncode, ended.stderr)


def test_a_namelist_without_end_is_refused(tmp_path: Path) -> None:
    """A device that never ends is no namelist."""
    ended = run("/dev/zero", folder=tmp_path)
    assert ended.returncode == 2, ended.returncode
    assert "/dev/zero: does not end after" in ended.stderr


def test_a_file_in_the_place_of_the_journal_is_named(tmp_path: Path) -> None:
    """The system says why its folder cannot be made."""
    (tmp_path / "case.nml").write_text(text_of())
    (tmp_path / "out.h5.tasks").touch()
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "out.h5.tasks: the folder cannot be made: File exists" in ended.stderr


@pytest.mark.parametrize("file", ["trail.h5 ", "trail.h5"])
def test_blanks_at_the_end_of_a_name_are_no_part_of_it(tmp_path: Path, file: str) -> None:
    """As everywhere in Fortran: what was written with them is found again without, and again."""
    write(tmp_path, "trail.h5  ", "start.txt   ")
    assert run("case.nml", folder=tmp_path).returncode == 0
    assert [path.name for path in tmp_path.glob("trail*")] == ["trail.h5"]
    write(tmp_path, file, "start.txt")
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "trail.h5 is complete" in ended.stdout


@pytest.mark.parametrize("name", [" out.h5", "out\t.h5", "out\x01.h5", "out\x7f.h5"])
@pytest.mark.parametrize("key", ["file", "initial_file"])
def test_names_that_nobody_means_are_refused(tmp_path: Path, key: str, name: str) -> None:
    """A blank before a name, or a control character in it, is a slip."""
    write(tmp_path, **{key: name})
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2, ended.stdout
    assert "begins with a blank" in ended.stderr or "has a control character" in ended.stderr


@pytest.mark.parametrize("name", ["plan", "plan.new", "rank_7", f"task_{1:016X}.a"])
def test_a_folder_in_the_way_is_named(tmp_path: Path, name: str) -> None:
    """One line says what to remove, before anything is computed; then the run begins."""
    write(tmp_path)
    there = tmp_path / "out.h5.tasks" / name
    there.mkdir(parents=True)
    (there / "something").write_text("precious")
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 1, (ended.stdout, ended.stderr)
    assert ended.stderr.splitlines()[0] == (
        f"out.h5.tasks/{name}: is a folder where a file should be; remove it"
    )
    shutil.rmtree(there)
    assert run("case.nml", folder=tmp_path).returncode == 0

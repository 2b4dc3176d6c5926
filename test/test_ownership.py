"""One run owns an output: a second one waits, then says who has it; a dead owner is replaced."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
from typing import TYPE_CHECKING, Any

import h5py
import pytest
from support import program

if TYPE_CHECKING:
    from pathlib import Path
    from subprocess import CompletedProcess

#: So long that it is still at work when it is stopped or killed; or over in milliseconds.
LONG, SHORT = 100_000_000_000, 1_000_000
#: Minutes until a run stops by itself, and makes its results file.
LIMIT = 0.05
OWNER_ELSEWHERE = "elsewhere 4711 2026-11-21 12:00:00.000"


INTERRUPTED_LOCK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <unistd.h>
int fcntl(int file, int command, ...) {
  static int calls;
  va_list more;
  va_start(more, command);
  void *value = va_arg(more, void *);
  va_end(more);
  if (command == F_OFD_SETLK && calls++ == 0) {
    close(open("interrupted", O_CREAT | O_WRONLY, 0600));
    return errno = EINTR, -1;
  }
  return ((int (*)(int, int, void *))dlsym(RTLD_NEXT, "fcntl"))(file, command, value);
}
"""


def write(folder: Path, name: str = "case.nml", collisions: int = SHORT, **keys: Any) -> None:
    """Write a case with two tasks, or with more."""
    (folder / name).write_text(
        program.namelist(
            particles={"number": 50, "seed": keys.get("seed", 1)},
            gate={"threshold": 2},
            run={"collisions": collisions},
            scan={"replicas": keys.get("replicas", 2)},
            output={"file": "'out.h5'"},
            limits={"checkpoint_minutes": 0.001, "wall_minutes": keys.get("wall_minutes", 0)},
        )
    )


def names(folder: Path) -> list[str]:
    """Give the names in a folder."""
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the results of a run that nothing disturbs."""
    folder = tmp_path_factory.mktemp("calm")
    write(folder)
    assert program.run("case.nml", folder=folder).returncode == 0
    return folder / "out.h5"


@pytest.mark.parametrize("ranks", [0, 2])
def test_a_second_run_is_told_who_has_the_output(tmp_path: Path, ranks: int) -> None:
    """The same input, or another with --overwrite, exits with 2; the first goes on undisturbed."""
    write(tmp_path, collisions=LONG)
    write(tmp_path, "other.nml", seed=2)
    process, numbers = program.under_way("--quiet", "case.nml", folder=tmp_path, ranks=ranks)
    # Stopped, so that it takes no processor time while the others wait.
    program.send(numbers, signal.SIGSTOP)
    others = [
        program.start(*words, folder=tmp_path, ranks=ranks)
        for words in (["case.nml"], ["--overwrite", "other.nml"])
    ]
    seconds = [program.finish(other) for other in others]
    at_work = process.poll() is None
    program.send(numbers, signal.SIGCONT)
    program.send(numbers, signal.SIGTERM)
    ended = program.finish(process)
    for second in seconds:
        assert second.returncode == 2, (second.returncode, second.stdout, second.stderr)
        assert "out.h5: another run has locked it, on " in second.stderr
        assert f"on {socket.gethostname()}, process " in second.stderr
        assert any(f"process {number}, since 20" in second.stderr for number in numbers)
    assert at_work
    assert ended.returncode == 3, (ended.stdout, ended.stderr)
    assert names(tmp_path) == ["case.nml", "other.nml", "out.h5.tasks"]


def test_a_run_that_ends_soon_is_waited_for(tmp_path: Path) -> None:
    """Two runs of a short input at once: one computes, the other finds it complete."""
    write(tmp_path, collisions=20 * SHORT)
    first = program.start("case.nml", folder=tmp_path)
    assert program.wait_for((tmp_path / "out.h5.owner").exists, first)
    program.send([first.pid], signal.SIGSTOP)
    second = program.start("case.nml", folder=tmp_path)
    assert program.wait_for(lambda: program.hears(second, signal.SIGTERM), second)
    program.hold([first.pid])
    ended = [program.finish(process) for process in (first, second)]
    assert [one.returncode for one in ended] == [0, 0], [one.stderr for one in ended]
    assert sum("is complete" in one.stdout for one in ended) == 1
    assert names(tmp_path) == ["case.nml", "out.h5"]


@pytest.mark.parametrize("ranks", [0, 2])
def test_a_dead_owner_is_replaced(tmp_path: Path, calm: Path, ranks: int) -> None:
    """After kill -9 of all the same command goes on, and nothing is left of the dead owner."""
    write(tmp_path, collisions=LONG)
    process, _ = program.under_way("--quiet", "case.nml", folder=tmp_path, ranks=ranks)
    program.kill_all(process)
    program.finish(process)
    assert (tmp_path / "out.h5.owner").exists()
    write(tmp_path)
    ended = program.run("--overwrite", "case.nml", folder=tmp_path, ranks=ranks)
    assert ended.returncode == 0, ended.stderr
    assert names(tmp_path) == ["case.nml", "out.h5"]
    program.assert_same(tmp_path / "out.h5", calm)


def test_a_rank_that_outlives_rank_0_does_no_harm(tmp_path: Path, calm: Path) -> None:
    """Another start is over and done with before the left rank wakes up."""
    write(tmp_path, collisions=LONG)
    process, numbers = program.under_way("--quiet", "case.nml", folder=tmp_path, ranks=2)
    program.send(numbers[1:], signal.SIGSTOP)
    program.send([process.pid, numbers[0]], signal.SIGKILL)
    process.wait()
    write(tmp_path)
    ended = program.run("--overwrite", "case.nml", folder=tmp_path)
    program.send(numbers[1:], signal.SIGCONT)
    program.finish(process)
    assert ended.returncode == 0, ended.stderr
    assert names(tmp_path) == ["case.nml", "out.h5"]
    program.assert_same(tmp_path / "out.h5", calm)


def test_a_signal_ends_the_wait(tmp_path: Path) -> None:
    """A run that waits for another hears a signal, and exits with 3."""
    write(tmp_path, collisions=LONG)
    process, numbers = program.under_way("--quiet", "case.nml", folder=tmp_path)
    program.send(numbers, signal.SIGSTOP)
    second = program.start("case.nml", folder=tmp_path)
    assert program.wait_for(lambda: program.hears(second, signal.SIGTERM), second)
    second.send_signal(signal.SIGTERM)
    ended = program.finish(second)
    program.send(numbers, signal.SIGKILL)
    program.finish(process)
    assert ended.returncode == 3, (ended.returncode, ended.stderr)
    # Whether it waited already when the signal came is up to the machine.
    assert "stopped" in ended.stderr


def test_nothing_is_taken_from_another_machine(tmp_path: Path) -> None:
    """It may be cut off, and write again: the host and the file to remove are named."""
    write(tmp_path)
    owner = tmp_path / "out.h5.owner"
    owner.write_text(OWNER_ELSEWHERE)
    ended = program.run("case.nml", folder=tmp_path)
    assert ended.returncode == 2, ended.stdout
    assert "on elsewhere, process 4711, since 2026-11-21 12:00:00" in ended.stderr
    assert "if it has ended for certain, remove out.h5.owner" in ended.stderr
    assert owner.read_text() == OWNER_ELSEWHERE
    assert names(tmp_path) == ["case.nml", "out.h5.owner"]
    owner.unlink()
    assert program.run("case.nml", folder=tmp_path).returncode == 0
    assert names(tmp_path) == ["case.nml", "out.h5"]


@pytest.mark.parametrize("after_another", [False, True])
def test_killed_while_it_writes_the_lock_file(tmp_path: Path, after_another: bool) -> None:
    """Nothing is left that stops the next run: the file has its text before it has its name."""
    source, library = tmp_path / "kill.c", tmp_path / "kill.so"
    source.write_text("#include <signal.h>\nint fsync() { return raise(SIGKILL); }\n")
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source], check=True)
    folder = tmp_path / "case"
    folder.mkdir()
    if after_another:
        write(folder, collisions=LONG)
        process, numbers = program.under_way("--quiet", "case.nml", folder=folder)
        program.send(numbers, signal.SIGKILL)
        program.finish(process)
    write(folder)
    preload = {"LD_PRELOAD": str(library)}
    ended = program.run("--overwrite", "case.nml", folder=folder, environment=preload)
    assert ended.returncode == -signal.SIGKILL, (ended.returncode, ended.stderr)
    ended = program.run("--overwrite", "case.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    assert names(folder) == ["case.nml", "out.h5"]


def test_a_lock_that_is_interrupted_is_had(tmp_path: Path) -> None:
    """Another run that gets locks is told of it."""
    source, library = tmp_path / "interrupted.c", tmp_path / "interrupted.so"
    source.write_text(INTERRUPTED_LOCK)
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    folder = tmp_path / "case"
    folder.mkdir()
    write(folder, collisions=LONG)
    interrupted = {"LD_PRELOAD": str(library)}
    process = program.start("--quiet", "case.nml", folder=folder, environment=interrupted)
    assert program.wait_for((folder / "out.h5.tasks/plan").exists, process)
    second = program.run("case.nml", folder=folder)
    at_work = process.poll() is None
    program.kill_all(process)
    program.finish(process)
    assert at_work
    assert (folder / "interrupted").exists()
    assert second.returncode == 2, second.stdout
    assert f"process {process.pid}, since 20" in second.stderr


def test_without_locks_nothing_is_taken_over(tmp_path: Path) -> None:
    """Nobody can know then whether an owner of this machine lives, either."""
    source, library = tmp_path / "no_locks.c", tmp_path / "no_locks.so"
    source.write_text("#include <errno.h>\nint fcntl64() { errno = ENOLCK; return -1; }\n"
                      "int fcntl() { errno = ENOLCK; return -1; }\n")  # fmt: skip
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source], check=True)
    no_locks = {"LD_PRELOAD": str(library)}
    folder = tmp_path / "case"
    folder.mkdir()
    write(folder, collisions=LONG)
    process = program.start("--quiet", "case.nml", folder=folder, environment=no_locks)
    assert program.wait_for((folder / "out.h5.tasks/plan").exists, process)
    program.kill_all(process)
    program.finish(process)
    write(folder)
    ended = program.run("--overwrite", "case.nml", folder=folder, environment=no_locks)
    assert ended.returncode == 2, ended.stdout
    assert f"on {socket.gethostname()}, process {process.pid}, since 20" in ended.stderr
    assert "remove out.h5.owner" in ended.stderr
    (folder / "out.h5.owner").unlink()
    ended = program.run("--overwrite", "case.nml", folder=folder, environment=no_locks)
    assert ended.returncode == 0, ended.stderr
    assert names(folder) == ["case.nml", "out.h5"]


LAUNCHERS = {
    "SLURM_STEP_NUM_TASKS": "srun has started 4 programs of one rank each, not one run of 4",
    "OMPI_COMM_WORLD_SIZE": "the mpirun of Open MPI has started 4 programs of one rank each",
    "PMI_SIZE": "the mpirun of MPICH has started 4 programs of one rank each",
}


@pytest.fixture(scope="module")
def refused(tmp_path_factory: pytest.TempPathFactory) -> dict[str, CompletedProcess[str]]:
    """Give what runs say of an output that is another's, by the variable of their launcher.

    Each waits five seconds for the other to end: all do so at once.
    """
    folder = tmp_path_factory.mktemp("refused")
    write(folder)
    (folder / "out.h5.owner").write_text(OWNER_ELSEWHERE)
    started = {
        variable: program.start("case.nml", folder=folder, environment={variable: "4"})
        for variable in LAUNCHERS
    }
    started[""] = program.start("case.nml", folder=folder)
    # Two ranks of one mpirun: that fits, whatever a batch system says.
    started["fits"] = program.start(
        "case.nml", folder=folder, environment={"SLURM_STEP_NUM_TASKS": "4"}, ranks=2
    )
    return {variable: program.finish(process) for variable, process in started.items()}


@pytest.mark.parametrize(("variable", "words"), LAUNCHERS.items())
def test_a_launcher_that_does_not_fit_is_named(
    tmp_path: Path, refused: dict[str, CompletedProcess[str]], variable: str, words: str
) -> None:
    """Only where an output is refused."""
    write(tmp_path)
    started = {variable: "4"}
    assert program.run("--check", "case.nml", folder=tmp_path, environment=started).returncode == 0
    assert program.run("case.nml", folder=tmp_path, environment=started).returncode == 0
    alone = refused[variable]
    assert alone.returncode == 2
    assert alone.stderr.count("out.h5: another run has locked it") == 1
    assert words in alone.stderr


@pytest.mark.parametrize("how", ["", "fits"])
def test_a_launcher_that_fits_is_not_named(
    refused: dict[str, CompletedProcess[str]], how: str
) -> None:
    """A mpirun has started one run of two ranks, or nothing has started one rank."""
    ended = refused[how]
    assert ended.returncode == 2
    assert ended.stderr.count("out.h5: another run has locked it") == 1
    assert "programs of one rank" not in ended.stderr


def test_a_check_takes_nothing(tmp_path: Path) -> None:
    """--check neither owns an output nor cares who does."""
    write(tmp_path)
    (tmp_path / "out.h5.owner").write_text(OWNER_ELSEWHERE)
    before = program.listing(tmp_path)
    assert program.run("--check", "case.nml", folder=tmp_path).returncode == 0
    assert program.listing(tmp_path) == before


@pytest.mark.parametrize("what", ["folder", "link", "pipe"])
def test_what_is_no_owner_is_named(tmp_path: Path, what: str) -> None:
    """Anything else under that name is not written to, and said to be in the way."""
    write(tmp_path)
    owner = tmp_path / "out.h5.owner"
    target = tmp_path / "target"
    target.write_text("precious")
    if what == "folder":
        owner.mkdir()
    elif what == "link":
        owner.symlink_to(target)
    else:
        os.mkfifo(owner)
    ended = program.run("case.nml", folder=tmp_path)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert "out.h5.owner: is not a file that a run has left; remove it" in ended.stderr
    assert target.read_text() == "precious"


def test_what_an_owner_says_of_itself_gives_no_orders_to_a_terminal(tmp_path: Path) -> None:
    """Control characters in the file of another owner are shown as numbers, or it is none."""
    write(tmp_path)
    owner = tmp_path / "out.h5.owner"
    owner.write_text("host\x9b 12 2026-11-21")
    ended = program.run("case.nml", folder=tmp_path)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert "on host\\xC2\\x9B, process 12, since 2026-11-21; wait" in ended.stderr
    owner.write_text("\x1b[2Jhost 12 2026-11-21")
    ended = program.run("case.nml", folder=tmp_path)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert "is not a file that a run has left" in ended.stderr


def test_results_that_are_only_touched_are_extended(tmp_path: Path) -> None:
    """Another time, or a copy of the same bytes: the results of before are in the new file."""
    output = tmp_path / "out.h5"
    write(tmp_path)
    assert program.run("case.nml", folder=tmp_path).returncode == 0
    write(tmp_path, collisions=SHORT, replicas=5000, wall_minutes=LIMIT)
    process = program.start("--quiet", "case.nml", folder=tmp_path)
    assert program.wait_for((tmp_path / "out.h5.tasks/rank_0").exists, process)
    program.send([process.pid], signal.SIGSTOP)
    shutil.copy(output, tmp_path / "copy.h5")
    (tmp_path / "copy.h5").replace(output)
    with h5py.File(output) as file:
        before = file["cpu_seconds"][0].tolist()
    program.send([process.pid], signal.SIGCONT)
    ended = program.finish(process)
    assert (ended.returncode, ended.stderr) == (3, "")
    with h5py.File(output) as file:
        assert file["cpu_seconds"][0, :2].tolist() == before


@pytest.mark.parametrize("what", ["file", "link", "other contents"])
def test_what_appears_under_the_name_of_the_output_stays(tmp_path: Path, what: str) -> None:
    """The results are kept beside it, the message says where; when it is gone the run goes on."""
    output = tmp_path / "out.h5"
    if what == "other contents":
        write(tmp_path)
        assert program.run("case.nml", folder=tmp_path).returncode == 0
        write(tmp_path, collisions=SHORT, replicas=5000, wall_minutes=LIMIT)
        process = program.start("--quiet", "case.nml", folder=tmp_path)
        numbers = [process.pid]
        assert program.wait_for((tmp_path / "out.h5.tasks/rank_0").exists, process)
    else:
        write(tmp_path, collisions=LONG, wall_minutes=LIMIT)
        process, numbers = program.under_way("--quiet", "case.nml", folder=tmp_path)
    program.send(numbers, signal.SIGSTOP)
    if what == "link":
        output.symlink_to("nowhere")
    elif what == "file":
        output.write_text("precious")
    else:
        with h5py.File(output, "r+") as file:
            file.attrs["note"] = "precious"
    before = (output.is_symlink() and output.readlink()) or output.read_bytes()
    program.send(numbers, signal.SIGCONT)
    ended = program.finish(process)
    assert ended.returncode == 1, (ended.stdout, ended.stderr)
    assert "out.h5.part: is whole, and is kept under this name, since out.h5 is" in ended.stderr
    assert ((output.is_symlink() and output.readlink()) or output.read_bytes()) == before
    with h5py.File(tmp_path / "out.h5.part") as file:
        assert file.attrs["status"] == "partial"
    output.unlink()
    assert program.run("--quiet", "case.nml", folder=tmp_path).returncode == 3
    assert names(tmp_path) == ["case.nml", "out.h5", "out.h5.tasks"]

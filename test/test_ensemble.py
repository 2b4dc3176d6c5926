"""Ensembles: the same bits on any number of ranks, and whatever happens on the way."""

from __future__ import annotations

import errno
import random
import re
import resource
import shutil
import signal
import socket
import subprocess
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest
from support.program import (
    ALONE,
    MPIRUN,
    PATIENCE,
    PROGRAM,
    Rank,
    assert_same,
    call_failing,
    finish,
    has_been_sent,
    hold,
    is_program,
    kill_all,
    listing,
    processor_seconds,
    rank_processes,
    run,
    send,
    start,
    wait_for,
    write_case,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from subprocess import CompletedProcess, Popen

TASKS = 4
LAST_LINE = "what is finished: battery --partial FILE.nml writes it to out.h5.partial.h5"
COLLISIONS = 5_000_000
CASE: dict[str, dict[str, Any]] = {
    "particles": {"number": 200},
    "gate": {"threshold": 3},
    "run": {"collisions": COLLISIONS},
    "scan": {"channel2_width": "0.01, 0.1", "replicas": TASKS // 2},
    "output": {
        "file": "'out.h5'",
        "series_interval": 83,
        "snapshot_times": "0, 100",
        "final_state": ".true.",
    },
    "limits": {"checkpoint_minutes": 0.0002},
}


write = partial(write_case, CASE)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the results that every other run must reproduce."""
    folder = tmp_path_factory.mktemp("undisturbed")
    write(folder)
    ended = run("--quiet", "case.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    return folder / "out.h5"


@pytest.fixture(scope="module")
def seconds(undisturbed: Path) -> float:
    """Give the processor time of the undisturbed run: an interruption waits for a part of it.

    So it comes while the run goes on, on a fast machine as on a busy one.
    """
    with h5py.File(undisturbed) as file:
        return float(file["cpu_seconds"][()].sum())


def complete(folder: Path, undisturbed: Path, ranks: int = 0) -> str:
    """Run to the end; the results are those of the undisturbed run, and nothing else is left."""
    ended = run("case.nml", folder=folder, ranks=ranks)
    assert ended.returncode == 0, (ended.stdout, ended.stderr)
    assert_same(folder / "out.h5", undisturbed)
    assert sorted(path.name for path in folder.iterdir()) == ["case.nml", "out.h5"]
    return ended.stdout


def under_way(folder: Path, ranks: int = 0, *arguments: str) -> tuple[Popen[str], list[int]]:
    """Start the program; return when it has begun its journal."""
    plan = folder / "out.h5.tasks/plan"
    before = plan.stat().st_mtime_ns if plan.exists() else 0
    process = start(*arguments, "case.nml", folder=folder, ranks=ranks)
    numbers = rank_processes(process, ranks)
    began = wait_for(lambda: plan.exists() and plan.stat().st_mtime_ns != before, process)
    if not (began and numbers):
        kill_all(process)
        output, errors = process.communicate()
        pytest.fail(f"it did not start: {output} {errors}")
    return process, numbers


def compute(process: Popen[str], numbers: list[int], seconds: float) -> None:
    """Wait until ranks have used so much more of the processors, or have ended."""
    least = processor_seconds(numbers) + seconds
    wait_for(
        lambda: processor_seconds(numbers) >= least or not any(map(is_program, numbers)),
        process, pause=0.001,
    )  # fmt: skip


def in_steps(process: Popen[str], number: int, seconds: float, found: Callable[[], bool]) -> bool:
    """Let a rank compute for `seconds` at a time, until something is found; false if it ends.

    It is held between, so that it saves a state each time, however short its tasks are. What is
    looked for is looked for while it stands still, and it stays so.
    """
    end = time.monotonic() + PATIENCE
    while is_program(number) and time.monotonic() < end:
        compute(process, [number], seconds)
        send([number], signal.SIGSTOP)
        if found():
            return True
        hold([number])
    return False


def disturbed(
    folder: Path, ranks: int, seconds: float, disturb: Callable[[Popen[str], list[int]], None]
) -> CompletedProcess[str]:
    """Start a run and disturb it when it has computed for some seconds; give how it ended."""
    # On a busy machine the run may be over before it is disturbed: then there is another.
    for _ in range(5):
        process, numbers = under_way(folder, ranks)
        compute(process, numbers, seconds)
        disturb(process, numbers)
        ended = finish(process)
        if f"{TASKS} of {TASKS} tasks are complete" not in ended.stdout:
            break
        (folder / "out.h5").unlink()
    return ended


def stopped(
    folder: Path, what: signal.Signals, seconds: float, ranks: int = 0, first: int = 0
) -> None:
    """Stop a run by a signal to all ranks, or those from `first` on: exit 3, no results yet."""
    ended = disturbed(folder, ranks, seconds, lambda _, numbers: send(numbers[first:], what))
    assert ended.returncode == 3, (ended.returncode, ended.stdout, ended.stderr)
    assert not (folder / "out.h5").exists()
    named = ended.stdout.splitlines()[-1] == LAST_LINE
    ended = run("--partial", "case.nml", folder=folder)
    assert named == (ended.returncode == 0)  # it is named where there is something to write
    if ended.returncode == 2:
        assert "no task is finished yet" in ended.stderr
        return
    assert ended.returncode == 0, ended.stderr
    with h5py.File(folder / "out.h5.partial.h5") as file:
        assert np.asarray(file.attrs["status"]).item() in ("partial", b"partial")
        assert set(np.unique(file["task_status"])) <= {0, 2}
    (folder / "out.h5.partial.h5").unlink()


def killed(folder: Path, ranks: int, seconds: float, victim: int | None) -> None:
    """Kill one rank, or all with mpirun, when they have run for some seconds, start included."""
    process = start("--quiet", "case.nml", folder=folder, ranks=ranks)
    numbers = rank_processes(process, ranks)
    wait_for(lambda: processor_seconds(numbers) >= seconds, process, 0.001)
    if victim is None or not numbers:
        kill_all(process)
    else:
        send([numbers[victim % len(numbers)]], signal.SIGKILL)
    finish(process)


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_ranks_make_no_difference(tmp_path: Path, undisturbed: Path, ranks: int) -> None:
    """Results are the same bits on any number of ranks and without mpirun."""
    write(tmp_path)
    complete(tmp_path, undisturbed, ranks)
    with h5py.File(tmp_path / "out.h5") as file:
        assert file.attrs["mpi_ranks"] == ranks


def test_ranks_in_other_folders_are_refused(tmp_path: Path, interrupted: Path) -> None:
    """A rank that does not see the folder of rank 0 writes nothing into what is there instead."""
    here, there = tmp_path / "here", copy_of(interrupted, tmp_path)
    write(here)
    before = listing(tmp_path)
    ranks = [Rank(["case.nml"], here), Rank(["case.nml"], there)]
    ended = run(folder=tmp_path, ranks=ranks)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    words = "does not see the folder that rank 0 writes to; start all ranks in one folder"
    assert [
        f"out.h5: rank 1, on {socket.gethostname()}, {words}" in line
        for line in ended.stderr.splitlines()
        if line.startswith("out.h5")
    ] == [True]
    assert listing(tmp_path) == before


def test_ranks_may_have_other_paths_to_one_folder(tmp_path: Path, undisturbed: Path) -> None:
    """What counts is what they see there."""
    here, link = tmp_path / "here", tmp_path / "link"
    write(here)
    link.symlink_to(here)
    ended = run(folder=tmp_path, ranks=[Rank(["case.nml"], here), Rank(["case.nml"], link)])
    assert ended.returncode == 0, ended.stderr
    complete(here, undisturbed)


@pytest.mark.parametrize(("first", "second"), [
    ("case.nml", "--check case.nml"), ("--help", "case.nml"), ("case.nml", "--overwrit case.nml"),
])  # fmt: skip
def test_ranks_with_other_command_lines_are_refused(
    tmp_path: Path, first: str, second: str
) -> None:
    """One message, and nothing is written; no rank waits for another."""
    write(tmp_path)
    before = listing(tmp_path)
    ended = run(folder=tmp_path, ranks=[Rank(first.split()), Rank(second.split())])
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert [line for line in ended.stderr.splitlines() if line.startswith("battery: ")] == [
        f"battery: rank 1 was started with another command line ({second}) than rank 0 ({first}); "
        "allowed: one command line for all ranks"
    ]
    assert listing(tmp_path) == before


def test_more_ranks_than_tasks(tmp_path: Path) -> None:
    """Ranks without a task do no harm."""
    write(tmp_path, scan={"channel2_width": 0.1, "replicas": 2}, run={"collisions": 1_000_000})
    assert run("case.nml", folder=tmp_path, ranks=3).returncode == 0
    with h5py.File(tmp_path / "out.h5") as file:
        assert not file["task_status"][()].any()


@pytest.mark.parametrize(
    ("what", "delay"),
    [(signal.SIGTERM, 0.0), (signal.SIGTERM, 0.4), (signal.SIGINT, 0.2), (signal.SIGUSR1, 0.1)],
)
def test_stopped_by_a_signal(
    tmp_path: Path, undisturbed: Path, seconds: float, what: signal.Signals, delay: float
) -> None:
    """Each signal stops with exit 3; the same command goes on to the same bits."""
    write(tmp_path)
    stopped(tmp_path, what, delay * seconds)
    assert "going on" in complete(tmp_path, undisturbed)


def test_one_rank_of_two_hears_the_signal(tmp_path: Path, undisturbed: Path) -> None:
    """A signal to one rank stops all."""
    write(tmp_path)
    stopped(tmp_path, signal.SIGUSR1, 0.0, ranks=2, first=1)
    complete(tmp_path, undisturbed, 2)


@pytest.mark.parametrize("what", [signal.SIGUSR1, signal.SIGTERM])
def test_signal_to_mpirun(
    tmp_path: Path, undisturbed: Path, seconds: float, what: signal.Signals
) -> None:
    """A signal to mpirun, as from a batch system, loses nothing."""
    write(tmp_path)

    def signal_to_mpirun(process: Popen[str], numbers: list[int]) -> None:
        if what == signal.SIGUSR1:
            send([process.pid], what)
            return
        # mpirun takes its time before it ends its ranks; the run would be over.
        send(numbers, signal.SIGSTOP)
        send([process.pid], what)
        wait_for(lambda: all(has_been_sent(number, what) for number in numbers), process)
        send(numbers, signal.SIGCONT)

    ended = disturbed(tmp_path, 2, 0.1 * seconds, signal_to_mpirun)
    # MPICH's mpirun says 0 now and then, though its ranks said 3.
    assert ended.returncode != 0 or "stopped early" in ended.stdout
    if what == signal.SIGUSR1 and "mpich" not in MPIRUN:
        assert ended.returncode == 3
    complete(tmp_path, undisturbed, 2)


def test_a_second_signal_leaves_at_once(tmp_path: Path, undisturbed: Path) -> None:
    """A rank that cannot end cleanly, since it waits for another, goes at the second signal."""
    write(tmp_path)
    process, numbers = under_way(tmp_path, 2)
    first, second = numbers
    send([second], signal.SIGSTOP)
    send([first], signal.SIGTERM)
    # A signal within half a second of the first counts as the first.
    send([first], signal.SIGTERM)
    time.sleep(0.1)
    # Not to turn in its wait all the time.
    hold([first], 0.6)
    time.sleep(0.1)
    assert process.poll() is None
    send([first], signal.SIGTERM)
    # MPICH's mpiexec may have the code of the other rank, which it kills.
    codes = {128 + signal.SIGTERM} | ({int(signal.SIGKILL)} if "mpich" in MPIRUN else set())
    assert finish(process).returncode in codes
    complete(tmp_path, undisturbed, 2)


@pytest.mark.parametrize("ranks", [0, 2])
def test_wall_minutes(tmp_path: Path, undisturbed: Path, ranks: int) -> None:
    """The time limit stops a run cleanly; without it, the run goes on."""
    write(tmp_path, limits={"checkpoint_minutes": 10, "wall_minutes": 0.0001})
    before = time.monotonic()
    ended = run("case.nml", folder=tmp_path, ranks=ranks)
    assert ended.returncode == 3, (ended.stdout, ended.stderr)
    assert time.monotonic() - before < 20
    write(tmp_path)
    complete(tmp_path, undisturbed, ranks)


KILLS = random.Random(2021)


@pytest.mark.parametrize(
    ("ranks", "first", "second", "victim", "ranks_after"),
    [
        (
            KILLS.choice([0, 2, 3]),
            KILLS.uniform(0.0, 1.0),
            KILLS.uniform(0.25, 0.7),
            KILLS.choice([None, 0, 1]),
            KILLS.choice([0, 1, 2]),
        )
        for _ in range(5)
    ],
)
def test_killed(
    tmp_path: Path,
    undisturbed: Path,
    seconds: float,
    ranks: int,
    first: float,
    second: float,
    victim: int | None,
    ranks_after: int,
) -> None:
    """After kill -9 of one rank or of all, at any moment, the bits are the same."""
    write(tmp_path)
    # A start takes about half as long as the tasks.
    killed(tmp_path, ranks, 1.5 * first * seconds, victim)
    if not ranks:
        killed(tmp_path, 0, 1.5 * second * seconds, None)
    complete(tmp_path, undisturbed, ranks_after)


@pytest.mark.full
def test_killed_in_the_middle_of_a_write(tmp_path: Path) -> None:
    """A run that does little but save a large state survives any number of kills."""
    changes: dict[str, dict[str, Any]] = {
        "particles": {"number": 50_000},
        "run": {"collisions": 600_000_000},
        "scan": {"channel2_width": 0.1, "replicas": 1},
        "output": {"series_interval": 1},
        "limits": {"checkpoint_minutes": 1.0e-6},
    }
    calm = {**changes, "limits": {"checkpoint_minutes": 10}}
    write(tmp_path / "calm", **calm)
    ended = run("case.nml", folder=tmp_path / "calm")
    assert ended.returncode == 0, ended.stderr
    folder = tmp_path / "rough"
    write(folder, **changes)
    for _ in range(10):
        process, _ = under_way(folder)
        # All ten together are shorter than the run, so that it is never over too soon.
        time.sleep(KILLS.uniform(0.02, 0.12))
        kill_all(process)
        finish(process)
    write(folder, **calm)
    assert "going on" in complete(folder, tmp_path / "calm/out.h5")


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory, seconds: float) -> Path:
    """Give a folder with a run killed after some finished tasks, with states of the next."""
    # On a busy machine the run may get by between two looks: then there is another.
    for _ in range(30):
        folder = tmp_path_factory.mktemp("interrupted") / "case"
        write(folder)
        process, _ = under_way(folder, 0, "--quiet")
        if stopped_in_the_third_task(process, folder / "out.h5.tasks", 0.1 * seconds / TASKS):
            send([process.pid], signal.SIGKILL)
            finish(process)
            assert (folder / "out.h5.tasks/rank_0").stat().st_size > 0
            return folder
        finish(process)
    return pytest.fail("no run was seen in its third task")


def stopped_in_the_third_task(process: Popen[str], journal: Path, step: float) -> bool:
    """Stop a run where it has both states of its third task; false if it has ended before."""
    sizes: list[int] = []

    def both_are_there() -> bool:
        # A generation is away for a moment while it is made anew: look while nothing moves.
        states = [path for path in journal.glob("task_*.[ab]") if path.stat().st_size > 0]
        sizes.extend(path.stat().st_size for path in journal.glob("rank_0"))
        # In the third task: the results of all have about the size of the first.
        first = next(filter(None, sizes), 0)
        if not (len(states) == 2 and first > 0 and round(sizes[-1] / first) == 2):
            return False
        # Those of the second task stay until its result is on the disk.
        times = [path.stat().st_mtime_ns for path in (*states, journal / "rank_0")]
        return min(times[:2]) > times[2]

    return in_steps(process, process.pid, step, both_are_there)


def copy_of(interrupted: Path, tmp_path: Path) -> Path:
    """Copy the folder of the killed run."""
    folder = tmp_path / "case"
    shutil.copytree(interrupted, folder)
    return folder


def flip(path: Path, at: int) -> None:
    """Turn one bit of one byte."""
    data = bytearray(path.read_bytes())
    data[at] ^= 16
    path.write_bytes(data)


@pytest.mark.parametrize("share", [0.0, 0.0015, 0.55, 0.9999])
def test_flipped_byte_in_part(
    tmp_path: Path, interrupted: Path, undisturbed: Path, share: float
) -> None:
    """A damaged result in a rank file is found out and computed again."""
    folder = copy_of(interrupted, tmp_path)
    path = folder / "out.h5.tasks/rank_0"
    flip(path, int(share * path.stat().st_size))
    output = complete(folder, undisturbed)
    assert f"{1 if share > 0.0 else 0} of {TASKS} tasks are finished" in output


@pytest.mark.parametrize(
    "name", ["out.h5.tasks/rank_0", "out.h5.tasks/plan", "out.h5.tasks/task_*.a", "out.h5"]
)
def test_what_cannot_be_read_is_neither_computed_again_nor_replaced(
    tmp_path: Path, interrupted: Path, undisturbed: Path, lacking: str, name: str
) -> None:
    """An error of the system is no damage: of a file system that is away for a moment."""
    folder = copy_of(interrupted, tmp_path)
    if name == "out.h5":
        shutil.copy(undisturbed, folder)
    (path,) = folder.glob(name)
    before, state = path.read_bytes(), "*" in name
    away = call_failing(lacking, "read", path.name, errno.ESTALE)
    for option in ("--quiet",) if state else ("--quiet", "--check", "--partial"):
        ended = run(option, "case.nml", folder=folder, environment=away)
        assert ended.returncode in (1, 2)
        assert re.search(f"{path.name}:? cannot be read.*Stale file handle", ended.stderr)
    assert path.read_bytes() == before
    assert not state or path.with_suffix(".b").exists()
    assert sorted(path.name for path in folder.glob("out.h5*")) == sorted(
        {"out.h5.tasks", name.partition("/")[0]}
    )
    (folder / "out.h5").unlink(missing_ok=True)
    if name == "out.h5.tasks/plan":
        ended = run("--overwrite", "--quiet", "case.nml", folder=folder, environment=away)
        assert (ended.returncode, ended.stderr) == (0, "")
        shutil.rmtree(folder)
        folder = copy_of(interrupted, tmp_path)
    complete(folder, undisturbed)


@pytest.mark.parametrize(
    ("generations", "share"),
    [("a", -1.0), ("b", -1.0), ("ab", -1.0), ("a", 0.5), ("b", 0.5), ("ab", 0.0), ("ab", 0.9999)],
)
def test_damaged_state(
    tmp_path: Path, interrupted: Path, undisturbed: Path, generations: str, share: float
) -> None:
    """With a damaged state the other generation is used, or the start; negative: cut in half."""
    folder = copy_of(interrupted, tmp_path)
    for generation in generations:
        (path,) = (folder / "out.h5.tasks").glob(f"task_*.{generation}")
        if share < 0.0:
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        else:
            flip(path, int(share * path.stat().st_size))
    complete(folder, undisturbed)


def test_part_lost_while_running(tmp_path: Path, undisturbed: Path) -> None:
    """Results that do not come back at the end are missed, not called complete."""
    write(tmp_path)
    process, _ = under_way(tmp_path)
    part = tmp_path / "out.h5.tasks/rank_0"
    assert wait_for(lambda: part.exists() and part.stat().st_size > 0, process)
    part.unlink()
    ended = finish(process)
    assert ended.returncode == 1, (ended.returncode, ended.stdout, ended.stderr)
    assert "cannot be read back" in ended.stderr
    with h5py.File(tmp_path / "out.h5") as file:
        assert np.asarray(file.attrs["status"]).item() in ("partial", b"partial")
    complete(tmp_path, undisturbed)


def test_damaged_plan(tmp_path: Path, interrupted: Path, undisturbed: Path) -> None:
    """If the plan of the journal is damaged, all is computed again."""
    folder = copy_of(interrupted, tmp_path)
    flip(folder / "out.h5.tasks/plan", 100)
    complete(folder, undisturbed)


def other_case(folder: Path) -> Path:
    """Run another ensemble with as many tasks and numbers, on its own."""
    write(folder, gate={"threshold": 4})
    assert run("--quiet", "case.nml", folder=folder).returncode == 0
    return folder / "out.h5"


@pytest.mark.parametrize("arguments", [(), ("--overwrite",)])
def test_damaged_plan_and_another_input(
    tmp_path: Path, interrupted: Path, arguments: tuple[str, ...]
) -> None:
    """Parts and states of another input are never used, even if the plan was lost."""
    folder = copy_of(interrupted, tmp_path)
    flip(folder / "out.h5.tasks/plan", 100)
    write(folder, gate={"threshold": 4})
    ended = run(*arguments, "case.nml", folder=folder)
    if ended.returncode == 2 and not arguments:
        return
    assert ended.returncode == 0, ended.stderr
    assert_same(folder / "out.h5", other_case(tmp_path / "other"))


@pytest.mark.parametrize("ranks", [0, 2])
def test_edited_namelist(tmp_path: Path, interrupted: Path, undisturbed: Path, ranks: int) -> None:
    """Another input is refused with the keys that differ; with the old one the run goes on."""
    folder = copy_of(interrupted, tmp_path)
    write(folder, gate={"threshold": 4}, scan={"channel2_width": "0.01, 0.2"})
    # The run is dead; who comes next removes what says that it owns the output.
    (folder / "out.h5.owner").unlink()
    before = listing(folder)
    ended = run("case.nml", folder=folder, ranks=ranks)
    assert ended.returncode == 2
    assert "&gate threshold: was 3, is 4" in ended.stderr
    assert "&scan channel2_width: was" in ended.stderr
    assert "collisions" not in ended.stderr
    assert listing(folder) == before
    write(folder)
    complete(folder, undisturbed, ranks)


def test_edited_initial_file(tmp_path: Path, seconds: float) -> None:
    """Going on with another initial file under the same name is refused too."""
    lines = [f"-1.{k} 0.{k} 1 0.{k}\n" for k in range(1, 6)]
    (tmp_path / "start.txt").write_text("".join(lines))
    write(tmp_path, particles={"number": 5, "initial_file": "'start.txt'"}, scan={"replicas": 1})
    case = (tmp_path / "case.nml").read_text()
    (tmp_path / "case.nml").write_text(case.replace("threshold = 3", "threshold = 1"))
    stopped(tmp_path, signal.SIGTERM, 0.1 * seconds)
    lines[0] = "-1.1 0.2 1 0.9\n"
    (tmp_path / "start.txt").write_text("".join(lines))
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2, ended.stdout
    assert "start.txt" in ended.stderr
    assert ended.stderr.count("initial_file") == 1
    # Also beside a change that is allowed.
    write(tmp_path, particles={"number": 5, "initial_file": "'start.txt'"},
          scan={"replicas": 1, "threshold": "1, 2"})  # fmt: skip
    ended = run("case.nml", folder=tmp_path)
    assert (ended.returncode, "'start.txt' has other contents now" in ended.stderr) == (2, True)


def test_overwrite_with_fewer_tasks(tmp_path: Path, interrupted: Path) -> None:
    """--overwrite discards a journal with states of tasks that there are no more."""
    folder = copy_of(interrupted, tmp_path)
    changes = {"scan": {"channel2_width": 0.1, "replicas": 1}, "run": {"collisions": 1_000_000}}
    write(folder, **changes)
    ended = run("--overwrite", "case.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    assert sorted(path.name for path in folder.iterdir()) == ["case.nml", "out.h5"]


def test_a_run_that_ends_too_early_says_so(tmp_path: Path) -> None:
    """Averages that would be of nothing fail their task; snapshots that are not taken are told."""
    write(
        tmp_path,
        run={"collisions": 150, "engine": "'reservoir'"},
        scan={"channel2_width": 0.1, "replicas": 1, "number": "2, 100"},
        output={"series_interval": 0},
    )
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 1, (ended.returncode, ended.stdout, ended.stderr)
    assert "number = 100, replica 0 failed: nothing is left for the averages" in ended.stdout
    with h5py.File(tmp_path / "out.h5") as file:
        np.testing.assert_array_equal(file["task_status"], [[0], [1]])
        np.testing.assert_array_equal(np.isfinite(file["chi"]), [[True], [False]])
    assert "snapshot" not in ended.stdout
    write(
        tmp_path,
        run={"collisions": 150},
        scan={"channel2_width": 0.1, "replicas": 1, "number": "2, 20"},
        output={"file": "'short.h5'", "series_interval": 0},
    )
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 0, (ended.returncode, ended.stdout, ended.stderr)
    assert "1 of the complete tasks ended before the last of snapshot_times" in ended.stdout
    with h5py.File(tmp_path / "short.h5") as file:
        np.testing.assert_array_equal(
            np.isnan(file["snapshots/x"][:, 0, :, 0]), [[False, False], [False, True]]
        )


def limit_memory() -> None:
    """Leave the program 8 GB of address space."""
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))


def failing(folder: Path, ranks: int = 0, **output: Any) -> None:
    """One task of three has too many particles for the memory."""
    write(
        folder,
        run={"collisions": 300_000, "transient_collisions": 0},
        scan={"channel2_width": 0.1, "replicas": 1, "number": "100, 200000000, 50"},
        output={"snapshot_times": 0, "final_state": ".false.", **output},
    )
    case = (folder / "case.nml").read_text().replace("  snapshot_times = 0\n", "")
    (folder / "case.nml").write_text(case)
    ended = run("case.nml", folder=folder, ranks=ranks, prepare=limit_memory)
    assert ended.returncode == 1, (ended.returncode, ended.stdout, ended.stderr)
    assert "no memory for 200000000 particles" in ended.stdout + ended.stderr
    with h5py.File(folder / "out.h5") as file:
        np.testing.assert_array_equal(file["task_status"], [[0], [1], [0]])
        np.testing.assert_array_equal(np.isfinite(file["chi"]), [[True], [False], [True]])
        assert np.asarray(file.attrs["status"]).item() in ("partial", b"partial")


@pytest.mark.parametrize("ranks", [0, 2])
def test_one_bad_task(tmp_path: Path, ranks: int) -> None:
    """A task that fails is listed and marked, the others are complete, exit 1."""
    failing(tmp_path, ranks)


def test_a_bad_task_with_final_states(tmp_path: Path) -> None:
    """The final states of the others are kept, and need no room for those of the bad task."""
    failing(tmp_path, final_state=".true.")


def test_a_bad_task_stays_bad(tmp_path: Path) -> None:
    """The same command again does not call an ensemble with a failed task complete."""
    failing(tmp_path)
    failing(tmp_path)


def test_memory_short_after_the_start(tmp_path: Path) -> None:
    """A task that has room for its particles, but not for the engine, fails like any other."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))

    write(
        tmp_path,
        run={"collisions": 300_000, "transient_collisions": 0},
        scan={"channel2_width": 0.1, "replicas": 1, "number": "100, 30000000"},
        output={"snapshot_times": 0, "final_state": ".false.", "series_interval": 0},
    )
    ended = run("case.nml", folder=tmp_path, prepare=limit)
    assert ended.returncode == 1, (ended.returncode, ended.stdout, ended.stderr[:2000])
    assert "number = 30000000, replica 0 failed" in ended.stdout
    assert "1 of 2 tasks are complete" in ended.stdout


# Of the journal's plan, of a state, and of results.
@pytest.mark.parametrize(("room", "steps"), [(100, False), (9000, True), (30000, False)])
def test_file_size_limit(
    tmp_path: Path, undisturbed: Path, seconds: float, room: int, *, steps: bool
) -> None:
    """When no file may grow beyond some size: a clear message, exit 1; with room it goes on."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))

    write(tmp_path)
    # Files of MPI itself are in memory and shared; one process alone can do without.
    environment = {"OMPI_MCA_btl": "self", "PMIX_MCA_gds": "hash"}
    process = start("case.nml", folder=tmp_path, prepare=limit, environment=environment)
    if steps and wait_for((tmp_path / "out.h5.tasks/plan").exists, process, 0.001):
        in_steps(process, process.pid, 0.25 * seconds / TASKS, lambda: False)
    ended = finish(process)
    assert ended.returncode == 1, (ended.returncode, ended.stdout, ended.stderr)
    assert "out.h5.tasks/" in ended.stderr
    complete(tmp_path, undisturbed)


FULL_DISK = """
mount -t tmpfs -o size={size} none disk || exit 77
cp case.nml disk && cd disk
{program} case.nml > ../output 2> ../errors
echo $? > ../code
mount -o remount,size=64m .
{program} case.nml > ../output_again 2>&1
echo $? > ../code_again
cp -r . ..
"""


def on_a_small_disk(folder: Path, size: str, step: float = 0.0) -> None:
    """Run it on a disk too small, then with room; with a step, it saves states after each."""
    (folder / "disk").mkdir()
    # A small file system that only these processes see.
    process = subprocess.Popen(
        ["unshare", "-rm", "sh", "-c", FULL_DISK.format(size=size, program=PROGRAM)],
        cwd=folder, env=ALONE, text=True,
    )  # fmt: skip
    numbers = rank_processes(process, 1)
    if step and numbers:
        plan = Path(f"/proc/{numbers[0]}/cwd/out.h5.tasks/plan")
        wait_for(lambda: plan.exists() or not is_program(numbers[0]), process, 0.001)
        in_steps(process, numbers[0], step, lambda: False)
    try:
        process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        kill_all(process)
        raise
    if not (folder / "code").exists():
        pytest.skip("this system does not let us mount a small file system")


# Of the file of the owner, of the first state, and of the second.
@pytest.mark.parametrize("size", ["4k", "28k", "80k"])
def test_full_disk(tmp_path: Path, undisturbed: Path, seconds: float, size: str) -> None:
    """On a full disk: a clear message, exit 1, nothing lost; with room it goes on."""
    write(tmp_path)
    on_a_small_disk(tmp_path, size, 0.25 * seconds / TASKS)
    assert (tmp_path / "code").read_text() == "1\n", (tmp_path / "output").read_text()
    assert "out.h5" in (tmp_path / "errors").read_text()
    assert (tmp_path / "code_again").read_text() == "0\n", (tmp_path / "output_again").read_text()
    assert_same(tmp_path / "out.h5", undisturbed)


def test_full_disk_with_room_for_a_results_file(tmp_path: Path) -> None:
    """Results that do not fit are missed, even if a file without them would fit."""
    changes: dict[str, dict[str, Any]] = {
        "particles": {"number": 2000},
        "run": {"collisions": 6_000_000},
        "output": {"series_interval": 33},
    }
    text = write(tmp_path, **changes).read_text().replace("  snapshot_times = 0, 100\n", "")
    (tmp_path / "case.nml").write_text(text)
    on_a_small_disk(tmp_path, "120k")
    write(tmp_path / "other", **changes).write_text(text)
    assert run("--quiet", "case.nml", folder=tmp_path / "other").returncode == 0
    assert (tmp_path / "code").read_text() == "1\n", (tmp_path / "output").read_text()
    assert (tmp_path / "code_again").read_text() == "0\n", (tmp_path / "output_again").read_text()
    assert_same(tmp_path / "out.h5", tmp_path / "other/out.h5")

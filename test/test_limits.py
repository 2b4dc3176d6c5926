"""What a run needs is planned against what there is; what cannot be printed or had is said."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from support.program import (
    ALONE,
    PATIENCE,
    PROGRAM,
    command_of,
    finish,
    hears,
    run,
    start,
    wait_for,
    write_case,
)

if TYPE_CHECKING:
    from collections.abc import Callable


CASE: dict[str, dict[str, Any]] = {
    "particles": {"number": 100},
    "gate": {"threshold": 2},
    "run": {"collisions": 1000, "transient_collisions": 0},
    "output": {"file": "'out.h5'"},
}


def write(folder: Path, **changes: dict[str, Any]) -> None:
    """Write a small case with changes; a duration takes the place of the collisions."""
    length = dict(changes.get("run", {}))
    if "duration" in length:
        length |= {"collisions": None, "transient_collisions": None}
    write_case(CASE, folder, **{**changes, "run": length})


def room_for(megabytes: int) -> Callable[[], None]:
    """Leave the program so much address space."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20, megabytes << 20))

    return limit


TOO_MUCH: dict[str, dict[str, dict[str, Any]]] = {
    "&output series_interval": {
        "run": {"duration": 1000},
        "output": {"series_interval": "1e-9"},
    },
    "&output series_interval: a series of 100000001 entries": {
        "run": {"duration": 1000},
        "output": {"series_interval": "1e-5"},
    },
    "&output snapshot_times: 40 snapshots": {
        "particles": {"number": 1_000_000},
        "run": {"duration": 1000},
        "output": {"snapshot_times": ", ".join(str(time) for time in range(40))},
    },
    "&output final_state: final states of each of 800 tasks": {
        "particles": {"number": 100_000},
        "scan": {"replicas": 800},
        "output": {"final_state": ".true."},
    },
    "&scan replicas: the results of 9000000 tasks": {"scan": {"replicas": 9_000_000}},
    "&particles number: 200000000 particles": {"particles": {"number": 200_000_000}},
    "&scan number: 100000000 particles": {"scan": {"number": "100000000, 200000000"}},
}


@pytest.mark.parametrize("check", [[], ["--check"]])
@pytest.mark.parametrize("key", TOO_MUCH)
def test_what_does_not_fit(tmp_path: Path, key: str, check: list[str]) -> None:
    """What does not fit into memory is exit 2, with its key, before anything is done."""
    write(tmp_path, **TOO_MUCH[key])
    ended = run(*check, "case.nml", folder=tmp_path, prepare=room_for(2000))
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert key in ended.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["case.nml"]


def test_check_says_what_there_is(tmp_path: Path) -> None:
    """--check says the memory that a rank takes, that there is, and by which limit."""
    write(tmp_path)
    ended = run("--check", "case.nml", folder=tmp_path)
    assert " a rank are available" in ended.stdout
    ended = run("--check", "case.nml", folder=tmp_path, prepare=room_for(2000))
    assert "(address space, ulimit -v)" in ended.stdout


PEAK = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


LEFT_BEHIND: dict[str, tuple[dict[str, dict[str, Any]], int]] = {
    "numbers": ({}, 2000),
    # 72 kB as numbers, less than 2 kB as they are compressed in the file.
    "a series": ({"run": {"duration": 2000}, "output": {"series_interval": 1}}, 10_000),
}


@pytest.mark.parametrize("what", LEFT_BEHIND)
def test_tasks_leave_nothing_behind(tmp_path: Path, what: str) -> None:
    """Of a thousand tasks rank 0 has a few numbers each at the end, never all their series."""
    changes, most = LEFT_BEHIND[what]

    def kilobytes(replicas: int) -> int:
        write(tmp_path, particles={"number": 5}, scan={"replicas": replicas}, **changes)
        # In a small process: the peak of a child begins with that of its parent.
        ended = subprocess.run(
            [sys.executable, "-c", PEAK, *command_of("--quiet", "--overwrite", "case.nml")],
            cwd=tmp_path, env=ALONE, capture_output=True, text=True, check=True,
        )  # fmt: skip
        return int(ended.stdout)

    assert kilobytes(1200) - kilobytes(200) < most


@pytest.mark.parametrize("megabytes", [60, 80, 88, 100, 120, 140, 160, 180, 195, 215, 240])
def test_little_address_space(tmp_path: Path, megabytes: int) -> None:
    """With little address space the run is done, or ends with a message; nothing crashes."""
    write(tmp_path)
    ended = run("--quiet", "case.nml", folder=tmp_path, prepare=room_for(megabytes))
    assert ended.returncode in (0, 1, 2), ended.stderr[:2000]
    assert "Error allocating" not in ended.stderr
    assert "SIGSEGV" not in ended.stderr
    assert ended.returncode == 0 or ended.stderr != ""


@pytest.mark.parametrize("engine", ["excursion", "collision", "reservoir"])
def test_a_state_is_saved_where_the_run_just_fits(tmp_path: Path, engine: str) -> None:
    """What `--check` just lets through can be stopped, gone on with, and stopped again."""
    case = {"particles": {"number": 400_000}, "limits": {"checkpoint_minutes": 1e-4}}
    # The plan of a short run is looked at: how fast a long one is takes its time to find out.
    short = {"engine": f"'{engine}'", "collisions": 1000, "transient_collisions": 0}
    write(tmp_path, run=short, **case)
    least, most = 60, 600
    while most - least > 4:
        middle = (least + most) // 2
        ended = run("case.nml", "--check", folder=tmp_path, prepare=room_for(middle))
        least, most = (middle, most) if ended.returncode else (least, middle)
    write(tmp_path, run=short | {"collisions": 10**12}, **case)
    # Sharing among ranks takes a little that is not there yet when the plan is checked.
    most += 32

    def states() -> list[Path]:
        return list((tmp_path / "out.h5.tasks").glob("task_*.b"))

    for _ in range(2):
        process = start("case.nml", folder=tmp_path, prepare=room_for(most))
        for state in states():
            state.unlink()
        assert wait_for(lambda: bool(states()), process)
        process.send_signal(signal.SIGUSR1)
        ended = finish(process)
        assert ended.returncode == 3, (most, ended)


# With the megabytes that there are.
OUTGROWING: dict[str, tuple[dict[str, dict[str, Any]], int]] = {
    "an event log": (
        {
            "particles": {"number": 10_000},
            "gate": {"threshold": 100},
            "run": {"collisions": 10_000_000_000, "transient_collisions": 0},
            "output": {"event_log": ".true."},
        },
        500,
    ),
    "a series of unknown length": (
        {
            "run": {"collisions": 1_000_000_000, "transient_collisions": 0},
            "output": {"series_interval": "1e-6"},
        },
        700,
    ),
}


@pytest.mark.parametrize("what", OUTGROWING)
def test_what_outgrows_the_memory_makes_its_task_fail(tmp_path: Path, what: str) -> None:
    """With a message; it cannot be brought home."""
    changes, megabytes = OUTGROWING[what]
    write(tmp_path, **changes)
    ended = run("case.nml", folder=tmp_path, prepare=room_for(megabytes))
    assert ended.returncode == 1, (ended.stdout, ended.stderr[:2000])
    assert "replica 0 failed: no memory for the series and the event log" in ended.stdout


def printing(folder: Path, *arguments: str, **streams: Any) -> subprocess.CompletedProcess[str]:
    """Run the program with its output somewhere else."""
    return subprocess.run(
        [str(PROGRAM), *arguments], cwd=folder, env=ALONE, stdin=subprocess.DEVNULL, text=True,
        timeout=PATIENCE, check=False, **streams,
    )  # fmt: skip


@pytest.mark.parametrize("output", ["full", "closed"])
@pytest.mark.parametrize("arguments", ["--help", "--version", "--check case.nml", "case.nml"])
def test_what_cannot_be_printed(tmp_path: Path, arguments: str, output: str) -> None:
    """Standard output that is full or closed is exit 1 and a message; a run is complete."""
    write(tmp_path)

    def close() -> None:
        os.close(1)

    with Path("/dev/full").open("w") as full:
        streams = {"stdout": full, "preexec_fn": close if output == "closed" else None}
        ended = printing(tmp_path, *arguments.split(), stderr=subprocess.PIPE, **streams)
    assert ended.returncode == 1, ended.stderr
    assert "part of the output could not be printed" in ended.stderr
    if arguments == "case.nml":
        again = run("case.nml", folder=tmp_path)
        assert again.returncode == 0
        assert "is complete" in again.stdout


def test_errors_that_cannot_be_printed(tmp_path: Path) -> None:
    """Exit codes stay where standard error is full."""
    write(tmp_path)
    with Path("/dev/full").open("w") as full:
        for arguments, code in ((["--nonsense"], 2), (["--quiet", "case.nml"], 0)):
            ended = printing(tmp_path, *arguments, stdout=subprocess.PIPE, stderr=full)
            assert ended.returncode == code


def test_a_reader_that_has_gone(tmp_path: Path) -> None:
    """A run whose output nobody reads any more is done all the same, and exit 1."""
    write(tmp_path)
    process = start("case.nml", folder=tmp_path)
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    assert process.wait(PATIENCE) == 1
    assert (tmp_path / "out.h5").exists()
    finish(process)


LONG: dict[str, tuple[dict[str, dict[str, Any]], list[str]]] = {
    "start": ({"particles": {"number": 20_000_000}}, []),
    "check": ({"particles": {"number": 20_000_000}}, ["--check"]),
    "fine series": (
        {"run": {"duration": 1000}, "output": {"series_interval": "5e-5"}},
        [],
    ),
    **{
        f"{engine} in a narrow channel": (
            {
                "table": {"channel1_width": "1e-12"},
                "particles": {"number": 1, "initial_file": "'start.txt'"},
                "run": {"engine": f"'{engine}'", "duration": 100},
            },
            [],
        )
        for engine in ("collision", "synchronous")
    },
    "synchronous": (
        {
            "particles": {"number": 200_000},
            "run": {"engine": "'synchronous'", "duration": 1000},
        },
        [],
    ),
}


@pytest.mark.parametrize("case", LONG)
def test_a_signal_is_heard(tmp_path: Path, case: str) -> None:
    """Whatever a run is at, a signal ends it with exit 3 long before it would be done."""
    changes, arguments = LONG[case]
    write(tmp_path, **changes)
    (tmp_path / "start.txt").write_text("0 1e-13 0.1 1\n")
    process = start(*arguments, "case.nml", folder=tmp_path)
    assert wait_for(lambda: hears(process, signal.SIGTERM), process)
    time.sleep(0.3)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    ended = finish(process)
    assert ended.returncode == 3, (ended.stdout, ended.stderr)
    if arguments:
        assert "stopped by SIGTERM; nothing was written" in ended.stderr
        assert not (tmp_path / "out.h5").exists()


def test_wall_minutes_count_from_the_start(tmp_path: Path) -> None:
    """A time limit that passes while particles are drawn ends the run with exit 3."""
    write(tmp_path, particles={"number": 20_000_000}, limits={"wall_minutes": 0.005})
    assert run("case.nml", folder=tmp_path).returncode == 3
    ended = run("--check", "case.nml", folder=tmp_path)
    assert ended.returncode == 3
    assert "stopped by &limits wall_minutes; nothing was written" in ended.stderr


GROUP = """
mount -t tmpfs none /sys/fs/cgroup || exit
touch "$1/mounted"
mkdir /sys/fs/cgroup/memory
for folder in /sys/fs/cgroup /sys/fs/cgroup/memory; do
cd $folder
echo 300000000 | tee memory.max > memory.limit_in_bytes
echo 299000000 | tee memory.current > memory.usage_in_bytes
printf "%sinactive_file 1000000\\n%sactive_file $2\\n" "" "" total_ total_ > memory.stat
case $folder in
*/memory) echo $3 > memory.kmem.usage_in_bytes ;;
*) echo "slab_reclaimable $3" >> memory.stat ;;
esac
done
cd "$1"
exec {program} --check case.nml
"""


@pytest.mark.parametrize(
    ("active", "tables", "code"), [(290000000, 0, 0), (0, 290000000, 0), (1000000, 1000000, 2)]
)
def test_cached_files_and_tables_of_a_control_group_are_free_memory(
    tmp_path: Path, active: int, tables: int, code: int
) -> None:
    write(tmp_path)
    if shutil.which("unshare") is None:
        pytest.skip("there is no unshare")
    words = ["unshare", "-rm", "sh", "-c", GROUP.format(program=PROGRAM), "sh", str(tmp_path)]
    words += [str(active), str(tables)]
    done = subprocess.run(
        words, env=ALONE, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    if not (tmp_path / "mounted").exists():
        pytest.skip("this system does not let us mount a small file system")
    assert done.returncode == code, done.stderr
    assert ("control group" in done.stderr) == (code == 2)

"""Run the built program from tests, and compare what it leaves."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from postproc import launcher

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).resolve().parents[2]
# Another build may be tried with BATTERY_PROGRAM, and another mpirun with BATTERY_MPIRUN.
MPIRUN = os.environ.get("BATTERY_MPIRUN", "mpirun")
PROGRAM = Path(os.environ.get("BATTERY_PROGRAM", ROOT / "build/bin/battery"))
# Open MPI chooses ob1 on a machine by itself; asked for, it does not look for networks first, which
# is half of what a start of the program costs. A rank that waits lets others have the processor.
ENVIRONMENT = {
    "OMPI_MCA_pml": "ob1",
    "OMPI_MCA_mpi_yield_when_idle": "1",
    **os.environ,
    **launcher.LAUNCHER,
    "LC_ALL": "C.UTF-8",
}
# For the program without mpirun.
ALONE = ENVIRONMENT | launcher.ALONE
# Long enough for a busy machine; what hangs is found out all the same.
PATIENCE = 60.0
# What may differ between two runs of the same input.
VARIABLE_DATASETS = {"cpu_seconds", "provenance/begun", "provenance/ended", "provenance/host"}
VARIABLE_ATTRIBUTES = {"created", "mpi_ranks", "command_line", "begun", "ended", "hosts"}


def namelist(**groups: dict[str, Any]) -> str:
    """Write a namelist; values are texts as they stand in it."""
    lines = []
    for group, keys in groups.items():
        lines += [f"&{group}", *(f"  {key} = {value}" for key, value in keys.items()), "/"]
    return "\n".join(lines) + "\n"


def write_case(case: dict[str, dict[str, Any]], folder: Path, **changes: dict[str, Any]) -> Path:
    """Write case.nml into a folder, some keys changed; those that are None are left out."""
    folder.mkdir(exist_ok=True)
    groups = {name: {**case.get(name, {}), **changes.get(name, {})} for name in {**case, **changes}}
    path = folder / "case.nml"
    path.write_text(namelist(**{
        name: {key: value for key, value in keys.items() if value is not None}
        for name, keys in groups.items()
    }))  # fmt: skip
    return path


def command_of(*arguments: str, ranks: int = 0) -> list[str]:
    """Give the command; without ranks there is no mpirun."""
    launcher = [MPIRUN, "-n", str(ranks)] if ranks else []
    return [*launcher, str(PROGRAM), *arguments]


@dataclass
class Rank:
    """How one rank is started where not all are started alike; without a folder, in that of all."""

    arguments: list[str]
    folder: Path | None = None
    environment: dict[str, str] = field(default_factory=dict)

    def start(self) -> str:
        """Give what a shell does to become this rank."""
        settings = [f"{name}={value}" for name, value in self.environment.items()]
        where = f"cd {shlex.quote(str(self.folder))} && " if self.folder else ""
        return f"{where}exec {shlex.join(['env', *settings, str(PROGRAM), *self.arguments])}"


def command_of_ranks(ranks: list[Rank]) -> list[str]:
    """Give the command that starts each rank in its own way.

    A shell asks which rank it is: mpirun of Debian's Open MPI 5.0.7 crashes at a colon.
    """
    cases = " ".join(f"{number}) {rank.start()};;" for number, rank in enumerate(ranks))
    script = f"case ${{OMPI_COMM_WORLD_RANK:-$PMI_RANK}} in {cases} esac"
    return [MPIRUN, "-n", str(len(ranks)), "sh", "-c", script]


def make(*words: str, **more: str) -> None:
    """Run make outside of any other; what it printed is shown if it fails.

    One at a time: tests run side by side, and share what make builds. `more`: environment.
    """
    outside = {key: value for key, value in ENVIRONMENT.items() if not key.startswith("MAKE")}
    ended = subprocess.run(
        ["flock", "build/.tests", "make", *words], cwd=ROOT, env=outside | more,
        stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, (ended.stdout + ended.stderr)[-4000:]


def start(
    *arguments: str,
    folder: Path,
    ranks: int | list[Rank] = 0,
    prepare: Callable[[], None] | None = None,
    environment: dict[str, str] | None = None,
) -> subprocess.Popen[str]:
    """Start the program in a folder, as leader of its own session; ranks alike, or one by one."""
    return subprocess.Popen(
        command_of_ranks(ranks) if isinstance(ranks, list) else command_of(*arguments, ranks=ranks),
        cwd=folder,
        env={**(ENVIRONMENT if ranks else ALONE), **(environment or {})},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
        preexec_fn=prepare,  # noqa: PLW1509 (no threads here)
    )


def finish(process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
    """Wait for the end; a program that hangs is killed, and the test fails."""
    try:
        output, errors = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        kill_all(process)
        process.communicate()
        raise
    assert "Backtrace" not in errors, errors[:2000]
    return subprocess.CompletedProcess(process.args, process.returncode, output, errors)


def run(
    *arguments: str,
    folder: Path,
    ranks: int | list[Rank] = 0,
    prepare: Callable[[], None] | None = None,
    environment: dict[str, str] | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run the program to its end."""
    return finish(
        start(*arguments, folder=folder, ranks=ranks, prepare=prepare, environment=environment)
    )


def call_failing(lacking: str, call: str, name: str, number: int, after: int = 1) -> dict[str, str]:
    """Return the variables with which a system call of paths with a name fails (`lacking.c`)."""
    words = {"": call, "_OF": name, "_WITH": str(number), "_AFTER": str(after)}
    return {"LD_PRELOAD": lacking, **{f"NO_CALL{end}": word for end, word in words.items()}}


def under_way(
    *arguments: str,
    folder: Path,
    ranks: int = 0,
    prepare: Callable[[], None] | None = None,
    environment: dict[str, str] | None = None,
) -> tuple[subprocess.Popen[str], list[int]]:
    """Start a run of `out.h5` and wait until it has saved a state; also give its processes.

    A signal that comes before a task has begun finds nothing to save.
    """
    process = start(
        *arguments, folder=folder, ranks=ranks, prepare=prepare, environment=environment
    )
    numbers = rank_processes(process, ranks)
    assert wait_for(lambda: any((folder / "out.h5.tasks").glob("task_*")), process)
    return process, numbers


def rank_processes(process: subprocess.Popen[str], ranks: int) -> list[int]:
    """Wait until all ranks run, and give their process numbers; without mpirun, that of the one."""
    if ranks == 0:
        return [process.pid]
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and process.poll() is None:
        found = [number for number in descendants(process.pid) if is_program(number)]
        if len(found) == ranks:
            return sorted(found)
        time.sleep(0.005)
    return []


def descendants(number: int) -> list[int]:
    """List the children of a process and theirs; MPICH has a process between mpirun and ranks."""
    try:
        tasks = list(Path(f"/proc/{number}/task").glob("*/children"))
    except OSError:
        return []  # It ended meanwhile.
    children = [int(child) for task in tasks for child in words_of(task)]
    return children + [one for child in children for one in descendants(child)]


def words_of(path: Path) -> list[str]:
    """Read the words of a file of the system; none if it is gone."""
    try:
        return path.read_text(encoding="utf-8").split()
    except OSError:
        return []


def is_program(number: int) -> bool:
    """Tell whether a process is the program, and not mpirun before it becomes the program."""
    try:
        return Path(f"/proc/{number}/exe").readlink().name.startswith(PROGRAM.name)
    except OSError:
        return False


def send(numbers: list[int], what: signal.Signals) -> None:
    """Send a signal to processes of this test; those that are gone are passed over."""
    for number in numbers:
        try:
            os.kill(number, what)
        except ProcessLookupError:
            continue


def hold(numbers: list[int], seconds: float = 0.2) -> None:
    """Hold ranks back for longer than they compute between two looks at what is due.

    When they go on, a state is saved at once, however short the tasks are.
    """
    send(numbers, signal.SIGSTOP)
    time.sleep(seconds)
    send(numbers, signal.SIGCONT)


def processor_seconds(numbers: list[int]) -> float:
    """Sum the processor time that processes have used; those that are gone count for nothing."""
    used = [words_of(Path(f"/proc/{number}/schedstat")) for number in numbers]
    return sum(int(words[0]) for words in used if words) / 1e9


def hears(process: subprocess.Popen[str], what: signal.Signals) -> bool:
    """Tell whether a process that was started without mpirun catches a signal yet."""
    return is_in("SigCgt:", process.pid, what)


def has_been_sent(number: int, what: signal.Signals) -> bool:
    """Tell whether a process that is stopped has been sent a signal, or that it has ended."""
    return is_in("ShdPnd:", number, what) or not is_program(number)


def is_in(name: str, number: int, what: signal.Signals) -> bool:
    """Tell whether a signal is in one of the sets of signals that the system lists."""
    words = words_of(Path(f"/proc/{number}/status"))
    return name in words and bool(int(words[words.index(name) + 1], 16) & 1 << (what - 1))


def kill_all(process: subprocess.Popen[str]) -> None:
    """Kill the program with mpirun and all ranks, at once."""
    send([process.pid, *descendants(process.pid)], signal.SIGKILL)


def wait_for(
    condition: Callable[[], bool], process: subprocess.Popen[str], pause: float = 0.005
) -> bool:
    """Wait until something is so, as long as the program runs; `pause`: between two looks."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if condition():
            return True
        if process.poll() is not None:
            return condition()
        time.sleep(pause)
    return False


def contents(path: Path) -> dict[str, tuple[Any, ...]]:
    """Give all that two runs of the same input must have in common, to the last bit."""
    found: dict[str, tuple[Any, ...]] = {}

    def visit(name: str, thing: h5py.Group | h5py.Dataset) -> None:
        for key, value in thing.attrs.items():
            if key in VARIABLE_ATTRIBUTES or is_reference(value):
                continue
            found[f"{name}@{key}"] = (np.asarray(value).tolist(),)
        if isinstance(thing, h5py.Dataset) and name not in VARIABLE_DATASETS:
            found[name] = (str(thing.dtype), thing.shape, thing[()].tobytes())

    with h5py.File(path) as file:
        visit("/", file)
        file.visititems(visit)
    return found


def is_reference(value: Any) -> bool:  # noqa: ANN401
    """Tell whether an attribute points to datasets, as those of dimension scales do."""
    return getattr(value, "dtype", None) is not None and value.dtype.kind in "OV"


def assert_same(one: Path, other: Path) -> None:
    """Two results files hold the same bits."""
    left, right = contents(one), contents(other)
    assert left.keys() == right.keys()
    differing = [name for name in left if left[name] != right[name]]
    assert not differing, f"these differ: {differing}"


def listing(folder: Path) -> dict[str, tuple[int, int]]:
    """Everything in a folder with its size and time, to see that nothing was written."""
    return {
        str(path.relative_to(folder)): (path.stat().st_size, path.stat().st_mtime_ns)
        for path in sorted(folder.rglob("*"))
        if path.is_file() or not any(path.iterdir())
    }

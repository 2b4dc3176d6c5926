"""Runs started from Python are those of the command line, and what is wrong is one error."""

from __future__ import annotations

import errno
import io
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from support.program import ALONE, ENVIRONMENT, MPIRUN, PATIENCE, PROGRAM, ROOT, assert_same
from support.program import run as run_program

import postproc
from postproc.cli import InputError
from postproc.running import STOPPED, RunError, _reason, find_program

if TYPE_CHECKING:
    from collections.abc import Iterator

CASE = {
    "particles": {"number": 100},
    "gate": {"threshold": 5},
    "run": {"duration": 20.0, "transient_duration": np.float64(1e-1)},
    "scan": {"channel2_width": np.array([0.1, 0.05]), "replicas": np.int64(2)},
    "output": {"file": "it's.h5", "final_state": True, "snapshot_times": None},
}


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {**ALONE, "BATTERY_PROGRAM": str(PROGRAM)}.items():
        monkeypatch.setenv(name, value)


def changed(**groups: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {**CASE, **{name: {**CASE.get(name, {}), **keys} for name, keys in groups.items()}}


STOPPED_AT_ONCE = changed(
    run={"duration": None, "transient_duration": None, "collisions": 10**10},
    limits={"wall_minutes": 0.005},
)


def test_a_run_of_values_is_the_run_of_its_namelist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = postproc.run(CASE, folder=tmp_path / "values", quiet=True)
    assert there == tmp_path / "values/it's.h5"
    text = postproc.write_namelist(tmp_path / "in.nml", CASE)
    first, _, rest = (tmp_path / "in.nml").read_text("utf-8").partition("\n")
    assert first.startswith("! written by battery-postproc, checksum ")
    assert rest == text
    (tmp_path / "in.nml").write_text(text, encoding="utf-8")
    assert "snapshot_times" not in text
    assert run_program("in.nml", folder=tmp_path).returncode == 0
    assert_same(there, tmp_path / "it's.h5")
    for name in ALONE.keys() - ENVIRONMENT.keys():
        monkeypatch.delenv(name)
    shared = postproc.run(tmp_path / "in.nml", ranks=2, folder=tmp_path / "ranks", quiet=True)
    assert_same(there, shared)
    assert postproc.open_results(shared)["chi"].sizes["channel2_width"] == 2


def test_a_rank_of_another_job_starts_runs_of_their_own(tmp_path: Path) -> None:
    """Python under mpirun, as with mpi4py: several runs one after the other, alone and on ranks."""
    case = changed(scan={"channel2_width": 0.1, "replicas": 2}, run={"transient_duration": 0.1})
    case["output"] = {"file": "case.h5"}
    script = """
import postproc

for ranks in (1, 1, 2):
    print(postproc.run({}, ranks=ranks, overwrite=True, quiet=True, launcher={!r}))
"""
    command = [MPIRUN, "-n", "1", sys.executable, "-c", script.format(case, [MPIRUN, "-n"])]
    environment = {**ENVIRONMENT, "BATTERY_PROGRAM": str(PROGRAM), "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
        timeout=PATIENCE,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout == f"{tmp_path / 'case.h5'}\n" * 3


def test_output_that_cannot_show_the_name_of_a_file_ends_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with io.TextIOWrapper(io.BytesIO(), encoding="ascii") as old:
        monkeypatch.setattr(sys, "stdout", old)
        path = postproc.run(changed(output={"file": "r\u00e9sultat.h5"}), folder=tmp_path)
        old.seek(0)
        assert "results: r\\xe9sultat.h5" in old.read()
    assert path == tmp_path / "r\u00e9sultat.h5"


def test_a_complete_run_is_there_at_once(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = postproc.run(CASE, folder=tmp_path)
    assert "4 of 4 tasks are complete" in capfd.readouterr().out
    written = path.stat().st_mtime_ns
    assert postproc.run(CASE, folder=tmp_path, quiet=True) == path
    assert path.stat().st_mtime_ns == written
    with pytest.raises(ValueError, match="threshold"):
        postproc.run(changed(gate={"threshold": 6}), folder=tmp_path, quiet=True)
    assert path.stat().st_mtime_ns == written
    postproc.run(changed(gate={"threshold": 6}), folder=tmp_path, overwrite=True, quiet=True)
    assert postproc.open_results(path)["threshold"] == 6
    assert capfd.readouterr() == ("", "")


WRONG = {
    r"no key colisions in &run \(did you mean collisions\?\)": {"run": {"colisions": 3}},
    r"no group &outputs \(did you mean output\?\)": {"outputs": {"file": "x.h5"}},
    r"no key replicas in &gate; there are threshold, threshold_fraction": {"gate": {"replicas": 2}},
    r"&gate threshold: a namelist cannot hold \{7\}": {"gate": {"threshold": {7}}},
    r"&scan threshold: a namelist cannot hold \[\]": {"scan": {"threshold": []}},
    r"&particles: values by key are wanted, not 100": {"particles": 100},
    r"&output file: a namelist cannot hold 'a.+b.h5'": {"output": {"file": "a\nb.h5"}},
    r"&Particles is given twice": {"Particles": {"number": 100}},
    r"&particles NUMBER is given twice": {"particles": {"number": 100, "NUMBER": 100}},
    r"no group &1": {1: {"number": 100}},
}


def test_which_program_python_finds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the Python side of make install its own, else that of the PATH, by its whole path."""
    for place in ("bin", "home/bin", "path"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "battery").write_text("#!/bin/sh\n")
        (tmp_path / place / "battery").chmod(0o755)
    monkeypatch.delenv("BATTERY_PROGRAM")
    monkeypatch.setattr("postproc.running.BUILT", tmp_path / "none")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", "path")
    for prefix, found in (("lib/battery", "bin"), ("home/proj/venv", "path")):
        monkeypatch.setattr(sys, "prefix", str(tmp_path / prefix))
        assert find_program() == tmp_path / found / "battery"


@pytest.mark.parametrize(("message", "groups"), WRONG.items())
def test_what_no_namelist_has_is_named(tmp_path: Path, message: str, groups: Any) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        postproc.run({**CASE, **groups}, folder=tmp_path)
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=message):
        postproc.write_namelist(tmp_path / "in.nml", {**CASE, **groups})
    assert list(tmp_path.iterdir()) == []


def test_numbers_of_numpy_are_numbers_in_lists_too() -> None:
    """As `list(np.arange(3))`, or values of a dataset that were chosen."""
    given = {"scan": {"threshold": [np.int64(1), 2], "channel2_width": (np.float32(0.5),)}}
    text = postproc.write_namelist(None, given)
    assert "threshold = 1, 2" in text
    assert "channel2_width = 0.5" in text


def test_a_launcher_that_loses_exit_codes_does_not_hide_the_end(tmp_path: Path) -> None:
    """As `setsid`, or a pipe in a script."""
    script = tmp_path / "launch"
    script.touch(0o755)
    for end in ("true", "exit 1"):
        script.write_text(f'#!/bin/sh\nshift\n"$@" 2>&1 || {end}\n')
        with pytest.raises(RunError, match="stopped early") as ended:
            postproc.run(STOPPED_AT_ONCE, folder=tmp_path, ranks=2, quiet=True,
                         launcher=[str(script)])  # fmt: skip
        assert ended.value.code == STOPPED
    for line in ('"$@" 2>&1 || true', 'echo loaded >&2; exec "$@" 2>&1', '"$@" || true'):
        script.write_text(f"#!/bin/sh\nshift\n{line}\n")
        with pytest.raises(ValueError, match=r"the namelist, line \d+: .*number = -5: is too"):
            postproc.run(changed(particles={"number": -5}), folder=tmp_path, ranks=2, quiet=True,
                         launcher=[str(script)])  # fmt: skip


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_task_that_fails_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ranks: int
) -> None:
    """Whatever a launcher prints then: all collisions of 100 particles are in one window."""
    for name in ALONE.keys() - ENVIRONMENT.keys():
        monkeypatch.delenv(name)
    case = {
        "particles": {"number": 100},
        "gate": {"threshold": 2},
        "run": {"collisions": 150, "engine": "reservoir"},
        "scan": {"number": [2, 100], "replicas": 1},
        "output": {"file": "a.h5"},
    }
    with pytest.raises(RunError, match=r"^.*number = 100, replica 0 failed: ") as ended:
        postproc.run(case, folder=tmp_path, ranks=ranks, quiet=True)
    assert ended.value.code == 1


def test_all_that_is_wrong_is_told_at_once() -> None:
    with pytest.raises(ValueError, match=r"seeed.*oyster"):
        postproc.write_namelist(None, {"particles": {"seeed": 1}, "oyster": {}})


@pytest.mark.parametrize("value", ["seven", -1, 1.5, float("nan")])
def test_what_the_program_refuses_is_a_value_error(tmp_path: Path, value: object) -> None:
    with pytest.raises(ValueError, match="threshold") as caught:
        postproc.run(changed(gate={"threshold": value}), folder=tmp_path, quiet=True)
    assert str(caught.value).startswith("the namelist, line ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ranks", [0, 1.5, "2", None])
def test_ranks_are_a_whole_number(tmp_path: Path, ranks: Any) -> None:
    with pytest.raises(ValueError, match=r"ranks = .*: must be a whole number, at least 1"):
        postproc.run(CASE, folder=tmp_path, ranks=ranks)


def test_ranks_that_nothing_waits_for_are_refused(tmp_path: Path) -> None:
    """Before the launcher is asked for a million; one for each task is taken."""
    unasked = ["false"]
    with pytest.raises(ValueError, match=r"^ranks = 1000000: at most one for each task \(4\)"):
        postproc.run(CASE, folder=tmp_path, ranks=1_000_000, launcher=unasked, overwrite=True)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(RunError):
        postproc.run(CASE, folder=tmp_path, ranks=4, launcher=unasked)
    with pytest.raises(ValueError, match="replicas"):
        postproc.run(
            {**CASE, "scan": {"replicas": 0}}, folder=tmp_path, ranks=1_000_000, launcher=unasked
        )


def test_where_others_wait_for_the_program_its_end_is_what_it_has_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with a handler of SIGCHLD: the exit code is lost, and `subprocess` says 0."""
    asked = os.waitid

    def reaped(kind: int, process: int, options: int) -> Any:
        os.waitpid(process, 0)
        return asked(kind, process, options)

    monkeypatch.setattr(os, "waitid", reaped)
    with pytest.raises(RunError, match="stopped early") as ended:
        postproc.run(STOPPED_AT_ONCE, folder=tmp_path, quiet=True)
    assert ended.value.code == STOPPED
    with pytest.raises(ValueError, match=r"number = -5: is too small.*: how the program has ended"):
        postproc.run(changed(particles={"number": -5}), folder=tmp_path, quiet=True)
    assert postproc.plan(CASE, folder=tmp_path / "new").pending == 4
    assert postproc.run(CASE, folder=tmp_path / "new", quiet=True).exists()


def test_a_folder_that_another_refused_run_removes_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of runs in a pool, all in one new folder, the first of which is refused."""
    made, removed = tempfile.mkdtemp, []

    def after_removal(prefix: str, **given: Any) -> str:
        if given["dir"] and not removed:
            removed.append(given["dir"])
            given["dir"].rmdir()
        return made(prefix=prefix, **given)

    monkeypatch.setattr(tempfile, "mkdtemp", after_removal)
    place = tmp_path / "new/one"
    assert postproc.run(CASE, folder=place, quiet=True).exists()
    assert removed == [place]


def test_a_folder_that_cannot_be_removed_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where another program still reads a file in it, on NFS or sshfs."""

    def refused(path: Any, **_: object) -> None:
        raise OSError(errno.ENOTEMPTY, os.strerror(errno.ENOTEMPTY), path)

    monkeypatch.setattr(os, "rmdir", refused)
    assert postproc.run(CASE, folder=tmp_path, quiet=True).exists()
    with pytest.raises(ValueError, match="is too small"):
        postproc.run(changed(particles={"number": -5}), folder=tmp_path, quiet=True)


def test_a_namelist_replaces_one_that_was_written_but_no_other_file(tmp_path: Path) -> None:
    mine = tmp_path / "mine.nml"
    mine.write_text("! why I chose this\n&particles number = 3 /\n", encoding="utf-8")
    for path in (postproc.run(CASE, folder=tmp_path, quiet=True), mine):
        before = path.read_bytes()
        with pytest.raises(ValueError, match="since, and is not replaced"):
            postproc.write_namelist(path, CASE)
        assert path.read_bytes() == before
    for _ in range(2):
        postproc.write_namelist(tmp_path / "case.nml", CASE)
    with (tmp_path / "case.nml").open("a", encoding="utf-8") as file:
        file.write("! and what I changed\n")
    with pytest.raises(ValueError, match="or was changed since, and is not replaced"):
        postproc.write_namelist(tmp_path / "case.nml", CASE)


def test_what_a_refused_run_made_is_removed(tmp_path: Path) -> None:
    """Its folder and those above it, but nothing that was there."""
    (tmp_path / "mine").mkdir()
    for folder in ("new", "mine/deep/new"):
        for wrong in ({"particles": {"number": 0}}, {"oyster": {}}, {"scan": {"replicas": 0}}):
            with pytest.raises(ValueError, match=r"number|oyster|replicas"):
                postproc.run({**CASE, **wrong}, folder=tmp_path / folder, quiet=True)
    assert list(tmp_path.rglob("*")) == [tmp_path / "mine"]


STRANGE = [None, 3, [1], b"x", ""]


@pytest.mark.parametrize(
    ("call", "strange"),
    [
        (lambda one: postproc.write_namelist(None, one), STRANGE),
        (lambda one: postproc.write_namelist(one, CASE), STRANGE[1:]),
        (lambda one: postproc.write_namelist(None, CASE, program=one), STRANGE[1:]),
        (postproc.run, [*STRANGE, "a\0b", "a" * 5000]),
        (lambda one: postproc.run(CASE, folder=one), STRANGE[1:]),
        (lambda one: postproc.run(CASE, launcher=one), [*STRANGE, "mpirun -n"]),
        (postproc.open_results, [*STRANGE, "a\0b", "a" * 5000]),
        (lambda one: postproc.open_results("x.h5", theory=one), [None, 3, [[1]], [None], b"x"]),
    ],
)
def test_arguments_of_another_kind_are_input_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Any, strange: list[Any]
) -> None:
    monkeypatch.chdir(tmp_path)
    for one in strange:
        with pytest.raises(InputError) as caught:
            call(one)
        assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_launcher_of_no_words_is_named(tmp_path: Path) -> None:
    """The number of ranks is not taken for a program."""
    with pytest.raises(InputError, match=r"launcher = \(\): must be a list of words"):
        postproc.run(CASE, folder=tmp_path / "new", ranks=2, launcher=())


def test_a_place_that_cannot_be_written_to_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"cannot make folder .*file: File exists"):
        postproc.run(CASE, folder=tmp_path / "file")
    with pytest.raises(ValueError, match="is a folder, not a file"):
        postproc.write_namelist(tmp_path, CASE)


def test_a_program_that_is_not_there_is_named(tmp_path: Path) -> None:
    other = tmp_path / "other"
    with pytest.raises(ValueError, match=f"{other}: no such file"):
        postproc.run(CASE, program=other)
    other.write_text("#!/bin/sh\necho hello\n", encoding="utf-8")
    other.chmod(0o755)
    with pytest.raises(ValueError, match=f"{other}: --schema prints no schema"):
        postproc.write_namelist(None, CASE, program=other)
    with pytest.raises(ValueError, match="no-launcher: No such file"):
        postproc.run(CASE, ranks=2, launcher=["no-launcher"], folder=tmp_path)
    with pytest.raises(ValueError, match="must be a whole number, at least 1"):
        postproc.run(CASE, ranks=0)


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Let Ctrl-C interrupt: what a shell runs in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_run_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    long = changed(run={"duration": 20000.0}, scan={"replicas": 8})
    whole = postproc.run(long, folder=tmp_path / "whole", quiet=True)
    # On a busy machine a run may be over before its interrupt comes.
    tried = (tmp_path / f"{number}" for number in range(5))
    folder = next(folder for folder in tried if is_interrupted(long, folder))
    assert not (folder / "it's.h5").exists()
    path = postproc.run(long, folder=folder, quiet=True)
    assert_same(path, whole)
    assert not (folder / "it's.h5.tasks").exists()


def is_interrupted(case: dict[str, dict[str, Any]], folder: Path) -> bool:
    journal = folder / "it's.h5.tasks"
    alarm = threading.Thread(target=interrupt_when_there_is, args=[journal])
    alarm.start()
    try:
        try:
            postproc.run(case, folder=folder, quiet=True)
        finally:
            alarm.join()
    except KeyboardInterrupt as interrupt:
        return journal.exists() and "the state is saved" in str(interrupt)
    return False


def interrupt_when_there_is(path: Path) -> None:
    end = time.monotonic() + 60.0
    while not path.exists() and time.monotonic() < end:
        time.sleep(0.002)
    os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.usefixtures("interruptible")
def test_a_run_is_interrupted_where_python_blocks_the_signal(tmp_path: Path) -> None:
    """Python may wait for SIGUSR1 itself, as for that of a batch system; all inherit it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGUSR1])
    long = changed(run={"duration": 20000.0}, scan={"replicas": 8})
    try:  # on a busy machine a run may be over before its interrupt comes
        assert any(is_interrupted(long, tmp_path / f"{number}") for number in range(5))
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def test_a_refusal_is_told_where_the_ends_of_children_are_ignored(tmp_path: Path) -> None:
    """A shell may have ignored SIGCHLD: then the system keeps no exit codes."""
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        with pytest.raises(ValueError, match="duration = -1"):
            postproc.run(changed(run={"duration": -1.0}), folder=tmp_path, quiet=True)
        assert signal.getsignal(signal.SIGCHLD) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGCHLD, before)


def test_a_run_that_stops_early_says_so(tmp_path: Path) -> None:
    long = changed(run={"duration": 1e5}, limits={"wall_minutes": 1e-3})
    with pytest.raises(RunError, match="stopped early") as caught:
        postproc.run(long, folder=tmp_path, quiet=True)
    assert caught.value.code == 3
    again = pickle.loads(pickle.dumps(caught.value))  # as pools of processes do
    assert (str(again), again.code) == (str(caught.value), 3)
    assert postproc.open_results(tmp_path / "it's.h5").attrs["status"] == "partial"


def test_a_refusal_is_told_where_a_launcher_empties_standard_error(tmp_path: Path) -> None:
    """As of a file, which it opens again; it also prints more than a pipe holds."""
    script = tmp_path / "launcher"
    much = "head -c 200000 /dev/zero | tr '\\0' ' ' >&2"
    script.write_text(
        f'#!/bin/sh\nshift\n{much}\n"$@"\ncode=$?\necho ended > /dev/stderr\nexit $code\n'
    )
    script.chmod(0o755)
    groups = changed(particles={"number": -5})
    with pytest.raises(InputError, match="number = -5"):
        postproc.run(groups, folder=tmp_path, ranks=2, launcher=[str(script)], quiet=True)


@pytest.mark.parametrize(
    ("code", "output", "reason"),
    [
        (-9, "going on\n", "the program ended with -9"),
        (9, "going on\n", "the program ended with 9"),
        (137, "going on\n", "the program ended with 137"),
        (255, "connection refused\n", "connection refused"),
        (1, "-" * 40 + "\nno slots\n" + "-" * 41 + "\n", "no slots"),
    ],
)
def test_the_last_line_is_a_reason_unless_a_signal_is(code: int, output: str, reason: str) -> None:
    assert _reason(code, "", output) == reason


def programs_in(folder: Path) -> Iterator[int]:
    """Yield the numbers of the processes of the program in a folder."""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if (process / "exe").samefile(PROGRAM) and (process / "cwd").samefile(folder):
                yield int(process.name)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_run_that_is_killed_has_no_reason_that_it_has_printed_before(tmp_path: Path) -> None:
    groups = changed(run={"duration": 1e9}, gate={"threshold": 200}, output={"file": "out.h5"},
                     limits={"wall_minutes": 2.0})  # fmt: skip
    killed: list[int] = []

    def kill() -> None:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and not killed:
            time.sleep(0.05)
            if (tmp_path / "out.h5.tasks/plan").exists():
                killed.extend(one for one in programs_in(tmp_path))
        for number in killed:
            os.kill(number, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    with pytest.raises(RunError) as problem:
        postproc.run(groups, folder=tmp_path, quiet=True)
    killer.join()
    assert problem.value.code == -signal.SIGKILL
    assert str(problem.value) == "the program ended with -9"


class Closed(io.StringIO):
    """Standard output whose reader has gone."""

    def write(self, _: str) -> int:
        """Fail as a pipe without a reader does."""
        raise BrokenPipeError


def test_output_that_nobody_reads_ends_a_run_that_prints_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    groups = changed(
        run={"duration": None, "transient_duration": None, "collisions": 150},
        scan={"channel2_width": None, "channel2_width_range": [0.001, 0.2, 1500], "replicas": 1},
        output={"file": "out.h5"},
    )
    monkeypatch.setattr(sys, "stdout", Closed())
    with pytest.raises(BrokenPipeError):
        postproc.run(groups, folder=tmp_path)

"""Stopping a run so that nothing is lost: the ways that do are named, and do."""

from __future__ import annotations

import os
import signal
import subprocess
import termios
import time
from typing import TYPE_CHECKING

import pytest
from support.program import (
    ALONE,
    PROGRAM,
    finish,
    hears,
    run,
    send,
    under_way,
    wait_for,
    write_case,
)

if TYPE_CHECKING:
    from pathlib import Path

# A long case whose state takes some time to save.
CASE = {
    "particles": {"number": 200_000},
    "gate": {"threshold": 500},
    "run": {"collisions": 100_000_000_000},
    "output": {"file": "'out.h5'"},
    "limits": {"checkpoint_minutes": 0.01},
}


def test_the_help_names_the_ways_that_lose_nothing(tmp_path: Path) -> None:
    """--help says how to stop a run under mpirun, and what mpirun does to its ranks."""
    text = run("--help", folder=tmp_path).stdout
    assert all(way in text for way in ("USR1", "wall_minutes"))
    assert "mpirun itself exits with 1" in text


def test_the_signal_that_mpirun_passes_on_loses_nothing(tmp_path: Path) -> None:
    """SIGUSR1 to mpirun: the state is saved, and mpirun has the program's exit code."""
    write_case(CASE, tmp_path)
    process, _ = under_way("case.nml", folder=tmp_path, ranks=2)
    send([process.pid], signal.SIGUSR1)
    ended = finish(process)
    assert ended.returncode == 3, (ended.stdout, ended.stderr)
    states = list((tmp_path / "out.h5.tasks").glob("task_*"))
    assert max(path.stat().st_size for path in states) > 40 * 200_000
    assert "stopped early, the state is saved" in ended.stdout
    begun = len({path.stem for path in states})
    told = run("--check", "case.nml", folder=tmp_path).stdout
    assert f", {begun} begun and saved\n" in told
    assert "--partial" not in ended.stdout  # nothing is finished
    assert not (tmp_path / "out.h5").exists()


@pytest.mark.parametrize(
    ("what", "ranks"),
    [(signal.SIGUSR2, 2), (signal.SIGUSR2, 0), (signal.SIGXCPU, 0), (signal.SIGHUP, 0)],
)
def test_the_signals_of_batch_systems_and_terminals_lose_nothing(
    tmp_path: Path, what: signal.Signals, ranks: int
) -> None:
    """A warning, an exhausted processor time, a closed terminal: the state is saved, exit 3."""
    write_case(CASE, tmp_path)
    process, _ = under_way("case.nml", folder=tmp_path, ranks=ranks)
    send([process.pid], what)
    ended = finish(process)
    assert ended.returncode == 3, (ended.stdout, ended.stderr)
    assert "stopped early, the state is saved" in ended.stdout


@pytest.mark.parametrize("handler", [{}, {"HANGUP_HANDLER": "1"}], ids=["plain", "library"])
def test_nohup_keeps_a_run_from_the_signal_of_its_terminal(
    tmp_path: Path, lacking: str, handler: dict[str, str]
) -> None:
    """What is ignored at the start stays ignored, though a library has set a handler since."""

    def ignore() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    write_case(CASE, tmp_path)
    environment = {"LD_PRELOAD": lacking, **handler}
    process, _ = under_way("case.nml", folder=tmp_path, prepare=ignore, environment=environment)
    assert not hears(process, signal.SIGHUP)
    send([process.pid], signal.SIGHUP)
    send([process.pid], signal.SIGUSR1)
    assert finish(process).returncode == 3


@pytest.mark.parametrize("what", [signal.SIGUSR1, signal.SIGTERM])
def test_a_signal_that_the_parent_has_blocked_is_heard(
    tmp_path: Path, what: signal.Signals
) -> None:
    """Programs block a signal to wait for it, and what they start inherits that."""

    def block() -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, [what])

    write_case(CASE, tmp_path)
    process, _ = under_way("case.nml", folder=tmp_path, prepare=block)
    send([process.pid], what)
    assert finish(process).returncode == 3


def test_a_run_does_not_wait_for_a_terminal_that_takes_no_text(tmp_path: Path) -> None:
    """Ctrl-S, a lost connection: states are saved, and a request to stop is heard."""
    write_case(CASE, tmp_path)
    _, terminal = os.openpty()
    termios.tcflow(terminal, termios.TCOOFF)
    command = [PROGRAM, "case.nml"]

    def saved() -> list[Path]:
        return list((tmp_path / "out.h5.tasks").glob("task_*"))

    with subprocess.Popen(command, cwd=tmp_path, env=ALONE, stdout=terminal) as process:
        assert wait_for(saved, process)
        send([process.pid], signal.SIGUSR1)
        time.sleep(1.0)  # until it says that it has stopped
        before = {path: path.read_bytes() for path in saved()}
        termios.tcflow(terminal, termios.TCOON)
        assert process.wait(60) == 3
    assert {path: path.read_bytes() for path in saved()} == before


@pytest.mark.full
def test_a_longer_grace_of_mpirun_loses_nothing(tmp_path: Path) -> None:
    """SIGTERM to an mpirun that waits for its ranks: the state is saved, though it says 1."""
    if "Open MPI v4" not in run("--version", folder=tmp_path).stdout:
        pytest.skip("only Open MPI 4 has that setting")
    write_case(CASE, tmp_path)
    grace = {"OMPI_MCA_odls_base_sigkill_timeout": "8"}
    process, _ = under_way("case.nml", folder=tmp_path, ranks=2, environment=grace)
    send([process.pid], signal.SIGTERM)
    finish(process)
    states = list((tmp_path / "out.h5.tasks").glob("task_*"))
    assert max(path.stat().st_size for path in states) > 40 * 200_000

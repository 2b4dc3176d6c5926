"""Runs of the program from Python: namelists with valid keys, and the outcome of a run."""

from __future__ import annotations

import difflib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any

import f90nml

from postproc.cli import (
    EXIT_BAD_INPUT,
    InputError,
    ended_with_python,
    existing_file,
    file_to_write,
    marked_namelist,
    path_of,
    plain_value,
    replaced,
)
from postproc.launcher import own_environment, program_words

if TYPE_CHECKING:
    from collections.abc import Iterator

    Groups = Mapping[str, Mapping[str, object]]

STOPPED = 3  # exit code of a run that was stopped early
REAPED = (
    "how the program has ended cannot be known, since another part of this Python waits for all "
    "its processes (a handler of SIGCHLD, waitpid(-1))"
)
BUILT = Path(__file__).resolve().parents[1] / "build/bin/battery"  # of a checkout


class RunError(RuntimeError):
    """A run that did not complete.

    Attributes
    ----------
    code
        Exit code of the program: 1, some tasks failed; 3, stopped early, the state is saved and the
        same call goes on.
    """

    def __init__(self, code: int, message: str) -> None:
        """Store the exit code and the message of the program."""
        super().__init__(code, message)  # both, with which another process makes it again
        self.code = code

    def __str__(self) -> str:
        """Return the message."""
        return str(self.args[1])


def find_program(program: str | Path | None = None) -> Path:
    """Return the program: the one given, that of BATTERY_PROGRAM, make's own, that on the PATH.

    Raises `InputError` if it does not exist.
    """
    given = os.environ.get("BATTERY_PROGRAM") or None if program is None else program
    if given is not None:
        return existing_file(path_of(given, "program")).resolve()
    places, on_path, prefix = [BUILT], shutil.which("battery"), Path(sys.prefix)
    if prefix.parts[-2:] == ("lib", "battery"):  # where make install puts the Python side
        places.append(prefix.parents[1] / "bin/battery")
    places += [Path(on_path).absolute()] if on_path else []
    for place in places:
        if place.is_file():
            return place
    raise InputError(
        "the program battery is not there: make build makes it, make install installs it; "
        "BATTERY_PROGRAM may name it, too"
    )


def write_namelist(
    file: str | Path | None, groups: Groups, *, program: str | Path | None = None
) -> str:
    """Write a namelist; return its text.

    Parameters
    ----------
    file
        Path; None: nothing is written.
    groups
        Values by group and key: numbers, texts, truth values, paths, or lists or arrays of numbers.
        None leaves a key out.
    program
        The program that will run it and that lists its keys (see `find_program`).

    Returns
    -------
    str
        The namelist.

    Raises
    ------
    ValueError
        A group or key does not exist, or a value cannot be written in a namelist. All problems are
        in the message. Types and bounds are checked by the program.

    Examples
    --------
    >>> write_namelist(None, {"particles": {"number": 100}, "gate": {"threshold": 5}}).split()
    ['&gate', 'threshold', '=', '5', '/', '&particles', 'number', '=', '100', '/']
    """
    if not isinstance(groups, Mapping):
        raise InputError(f"groups = {groups!r}: must be values by group and key")
    place = None if file is None else file_to_write(path_of(file, "file"), "nml")
    checked: dict[str, dict[str, object]] = {}
    problems: list[str] = []
    known = _keys(find_program(program))
    for group, keys in groups.items():
        name = str(group).lower()
        if not isinstance(keys, Mapping):
            problems.append(f"&{group}: values by key are wanted, not {keys!r}")
        elif name not in known:
            problems.append(f"there is no group &{group}{_choice(name, known)}")
        elif name in checked:
            problems.append(f"&{group} is given twice")
        else:
            checked[name] = _values(group, keys, known[name], problems)
    if problems:
        raise InputError("; ".join(problems))
    namelist = f90nml.Namelist(checked)
    namelist.column_width = 100
    text = f"{namelist}\n"
    if place is not None:
        with replaced(place) as half:
            half.write_text(marked_namelist(text), encoding="utf-8")
    return text


def run(
    namelist: str | Path | Groups,
    *,
    ranks: int = 1,
    folder: str | Path | None = None,
    overwrite: bool = False,
    quiet: bool = False,
    program: str | Path | None = None,
    launcher: Sequence[str] = ("mpirun", "-n"),
) -> Path:
    """Run the program, or resume a run; return the absolute path of its results file.

    An interruption of Python (Ctrl-C) stops the run such that the same call resumes it; so does the
    end of Python, for any reason (on Linux), unless the system then kills all its processes.

    Parameters
    ----------
    namelist
        A file, or values by group and key (as in `write_namelist`).
    ranks
        MPI ranks; 1: without a launcher. More than there are tasks, and processors here, are
        refused.
    folder
        Working folder, made if necessary; names of files in the namelist are relative to it. None:
        the current folder. A folder made for a run that is refused is removed.
    overwrite
        Discard existing results.
    quiet
        Do not print the output of the program.
    program
        See `find_program`.
    launcher
        Command that starts several ranks; their number follows it.

    Returns
    -------
    pathlib.Path
        The results file.

    Raises
    ------
    ValueError
        The input is invalid, or results of another input exist: the message of the program.
    RunError
        The run failed in part, or was stopped early.

    Examples
    --------
    >>> groups = {"particles": {"number": 100}, "gate": {"threshold": 5},
    ...           "run": {"duration": 100.0}, "output": {"file": "short.h5"}}
    >>> run(groups, quiet=True).name
    'short.h5'
    """
    if not isinstance(ranks, Integral) or ranks < 1:
        raise InputError(f"ranks = {ranks!r}: must be a whole number, at least 1")
    strange = isinstance(launcher, str) or not isinstance(launcher, Sequence)
    lacking = ranks > 1 and not launcher
    if strange or lacking or not all(isinstance(word, str) and word for word in launcher):
        raise InputError(f"launcher = {launcher!r}: must be a list of words")
    start = list(launcher) if ranks > 1 else []
    if ranks > (processors := os.cpu_count() or 1):  # launchers hang with a million ranks
        tasks = plan(namelist, folder=folder, overwrite=overwrite, program=program).tasks
        if ranks > tasks:
            raise InputError(
                f"ranks = {ranks}: at most one for each task ({tasks}), or for each processor of "
                f"this machine ({processors})"
            )
    start += [str(ranks)] if ranks > 1 else []
    words = ["--overwrite"] if overwrite else []
    answer = _answer(namelist, words, folder=folder, quiet=quiet, program=program, start=start)
    return Path(answer["results"])


@dataclass(frozen=True)
class Plan:
    """Output of `battery --check` for a run.

    Attributes
    ----------
    tasks, pending : numbers of all tasks, and of unfinished ones.
    seconds : processor time of the unfinished tasks, in s.
    memory : bytes for each rank.
    """

    tasks: int
    pending: int
    seconds: float
    memory: float


def plan(
    namelist: str | Path | Groups,
    *,
    folder: str | Path | None = None,
    overwrite: bool = False,
    program: str | Path | None = None,
) -> Plan:
    """Return tasks and cost of a run; only a calibration of some seconds is run.

    Arguments and errors are those of `run`.

    Returns
    -------
    Plan
        `tasks`, how many of them are `pending`, the `seconds` of a processor that these take, and
        `memory` of each rank in bytes.

    Examples
    --------
    >>> groups = {"particles": {"number": 100}, "gate": {"threshold": 5},
    ...           "run": {"duration": 100.0}, "scan": {"replicas": 3}}
    >>> plan(groups).pending
    3
    """
    words = ["--check", *(["--overwrite"] if overwrite else [])]
    answer = _answer(namelist, words, folder=folder, quiet=True, program=program, start=[])
    seconds = answer["seconds_a_task"] * answer["pending"]
    return Plan(answer["tasks"], answer["pending"], seconds, answer["memory_a_rank"])


def _answer(
    namelist: str | Path | Groups, words: list[str], *, folder: str | Path | None, quiet: bool,
    program: str | Path | None, start: list[str],
) -> dict[str, Any]:  # fmt: skip
    """Return the JSON output of the program; `start` is before it on the command line."""
    battery = find_program(program)
    place = path_of("." if folder is None else folder, "folder")
    with _work_folder(place) as work:
        path, json_file = _namelist_file(namelist, battery, work), work / "answer.json"
        words = [*words, "--json", str(json_file), "--", str(path)]
        with _exit_codes_known():
            code, output, errors = _launch([*start, str(battery), *words], place, quiet)
        if isinstance(namelist, Mapping):
            errors, output = (one.replace(str(path), "the namelist") for one in (errors, output))
        errors = program_words(errors)
        answer: dict[str, Any] = {}
        with suppress(OSError, ValueError):  # none, or not all of it
            answer = json.loads(json_file.read_text(encoding="utf-8", errors="surrogateescape"))
        # The program refuses before it prints; a launcher may join both, and print, too.
        said = "\n".join(filter(None, [program_words(output), errors]))
        if not (code or answer):
            lost = f"{' '.join(start)} has exit code 0, but no battery has ended well"
            raise InputError(": ".join(filter(None, [said, REAPED if code is None else lost])))
        code = answer.get("exit_code", 0) or code  # launchers have codes of their own
        if code == EXIT_BAD_INPUT:
            raise InputError(said)
        if code:
            raise RunError(code, _reason(code, errors, output))
        return answer


@contextmanager
def _work_folder(place: Path) -> Iterator[Path]:
    """Yield a folder for a run's own files, in the working folder, which other nodes may share.

    The working folder is made, and removed again if the run is refused. What another program still
    reads at the end stays: some servers do not remove open files.
    """
    made: list[Path] = []
    folder = None
    tries = 100  # another run that is refused may remove the working folder meanwhile
    while folder is None:
        tries -= 1
        try:
            made = [one for one in (place, *place.parents) if not one.exists()]
            place.mkdir(parents=True, exist_ok=True)
            here = place if os.access(place, os.W_OK | os.X_OK) else None
            folder = Path(tempfile.mkdtemp(prefix=".battery-", dir=here)).resolve()
        except OSError as problem:
            if not isinstance(problem, FileNotFoundError) or tries == 0:
                where = problem.filename or place
                raise InputError(f"cannot make folder {where}: {problem.strerror}") from problem
    refused = False
    try:
        yield folder
    except InputError:
        refused = True
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        with suppress(OSError):  # another process has written into it
            for one in made if refused else ():
                one.rmdir()


def _reason(code: int, errors: str, output: str) -> str:
    """Return why a run did not complete."""
    if code == STOPPED:
        return "stopped early, the state is saved: the same call, without overwrite, goes on"
    failures = [line for line in output.splitlines() if " failed: " in line]
    lines = [line for line in program_words(output).splitlines() if re.search(r"\w", line)]
    by_signal = code < 0 or 3 < code <= 64 or 128 < code <= 192  # launchers say 9, or 137
    last = "" if by_signal or not lines else lines[-1]
    return "\n".join(failures) or errors or last or f"the program ended with {code}"


@lru_cache
def _keys(program: Path) -> dict[str, tuple[str, ...]]:
    """Return the names of all groups, and of the keys of each, as the program lists them."""
    try:
        done = subprocess.run(
            [str(program), "--schema"],
            check=False,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env=own_environment(),
        )
        groups = json.loads(done.stdout)["properties"]
        return {group: tuple(keys["properties"]) for group, keys in groups.items()}
    except OSError as problem:
        raise InputError(f"{program}: {problem.strerror}") from problem
    except (ValueError, LookupError, TypeError) as problem:
        why = program_words(done.stderr.decode(errors="replace")) or "is it battery?"
        raise InputError(f"{program}: --schema prints no schema: {why}") from problem


def _values(
    group: str, keys: Mapping[str, object], known: Sequence[str], problems: list[str]
) -> dict[str, object]:
    """Return the values of a group for a namelist; append errors to `problems`."""
    values = {}
    for key, value in keys.items():
        plain = plain_value(value)
        plain = str(plain) if isinstance(plain, Path) else plain
        if isinstance(plain, (list, tuple, range)):
            plain = [plain_value(one) for one in plain]
        name = str(key).lower()
        if name not in known:
            problems.append(f"there is no key {key} in &{group}{_choice(name, known)}")
        elif name in values:
            problems.append(f"&{group} {key} is given twice")
        elif plain is not None and not _can_be_written(plain):
            told = " ".join(repr(value).split())
            problems.append(f"&{group} {key}: a namelist cannot hold {told}; allowed: a number, "
                            "a text, a list of them")  # fmt: skip
        elif plain is not None:
            values[name] = plain
    return values


def _can_be_written(value: object) -> bool:
    if isinstance(value, list):
        return bool(value) and all(
            _can_be_written(one) and not isinstance(one, list) for one in value
        )
    if isinstance(value, str):
        return value.isprintable()  # f90nml writes other characters as Python escapes
    return isinstance(value, (bool, int, float))


def _choice(word: str, known: Sequence[str] | Mapping[str, object]) -> str:
    close = difflib.get_close_matches(word.lower(), known, n=1)
    return f" (did you mean {close[0]}?)" if close else f"; there are {', '.join(known)}"


def _namelist_file(namelist: str | Path | Groups, program: Path, folder: Path) -> Path:
    """Return the file of a namelist; values are written to a file in `folder`."""
    if not isinstance(namelist, Mapping):
        return existing_file(path_of(namelist, "namelist")).resolve()
    path = folder / "namelist.nml"
    path.write_text(write_namelist(None, namelist, program=program), encoding="utf-8")
    return path


def _for_stdout(line: str) -> str:
    """Return a line with escapes for what the standard output of Python cannot show."""
    known = getattr(sys.stdout, "encoding", None) or "utf-8"
    return line.encode(known, "backslashreplace").decode(known)


@contextmanager
def _exit_codes_known() -> Iterator[None]:
    """Let the exit codes of children be known where Python was started with SIGCHLD ignored."""
    before = signal.getsignal(signal.SIGCHLD)
    if before is not signal.SIG_IGN:
        yield
        return
    if threading.current_thread() is not threading.main_thread():
        raise InputError(
            "SIGCHLD is ignored, so that it cannot be known how a run has ended: in the main "
            "thread, signal.signal(signal.SIGCHLD, signal.SIG_DFL)"
        )
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGCHLD, before)


def _launch(command: list[str], folder: Path, quiet: bool) -> tuple[int | None, str, str]:
    """Return exit code, output and errors of a command; output is printed as it arrives."""
    output: list[str] = []
    errors: list[str] = []
    # no file: a disk may be full, and a launcher's `>` would empty it
    read_end, write_end = os.pipe()
    try:
        started = subprocess.Popen(
            ended_with_python(command), cwd=folder, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=write_end, encoding="utf-8", errors="replace",
            start_new_session=True, env=own_environment(),
        )  # fmt: skip
    except BaseException:
        os.close(read_end)
        raise
    finally:
        os.close(write_end)
    with started as process:
        reader = threading.Thread(target=_read_lines, args=(read_end, errors), daemon=True)
        reader.start()
        try:
            for line in process.stdout or ():
                output.append(line)
                if not quiet:
                    print(_for_stdout(line), end="", flush=True)
        except BaseException as problem:
            process.send_signal(signal.SIGUSR1)  # saves the state; mpirun passes it on
            deque(process.stdout or (), maxlen=0)  # or a full pipe would hold it
            if _exit_code(process) == STOPPED and isinstance(problem, KeyboardInterrupt):
                raise KeyboardInterrupt(_reason(STOPPED, "", "")) from None
            raise
        code = _exit_code(process)
    reader.join(5.0)  # what a launcher has left behind may keep the pipe open
    return code, "".join(output), "".join(errors)


def _read_lines(read_end: int, lines: list[str]) -> None:
    """Append what arrives in a pipe, until its end."""
    with open(read_end, encoding="utf-8", errors="replace") as pipe:
        for line in pipe:
            lines.append(line)


def _exit_code(process: subprocess.Popen[str]) -> int | None:
    """Return how a process ended; None if something else has waited for it: `wait` would say 0."""
    if process.returncode is None and hasattr(os, "waitid"):
        try:
            ended = os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        except ChildProcessError:
            return None
        if ended is not None:
            return ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status
    return process.wait()

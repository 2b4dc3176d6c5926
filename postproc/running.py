"""Runs of the program from Python: namelists whose keys exist, and what came of a run."""

from __future__ import annotations

import difflib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import contextmanager
from functools import lru_cache
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING

import f90nml

from postproc.cli import EXIT_BAD_INPUT, InputError, existing_file, output_folder
from postproc.launcher import program_words

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    Groups = Mapping[str, Mapping[str, object]]

STOPPED = 3  # exit code of a run that was stopped early
# Where make leaves the program: in a checkout, or beside the Python side that it installed.
BUILT = Path(__file__).resolve().parents[1] / "build/bin/battery"
INSTALLED = Path(sys.prefix, "../../bin/battery").resolve()
# How the program says which file has the results: after a run, or where they are there already.
RESULTS = re.compile(r"^(?:results: (?P<made>.+)|(?P<there>.+) is complete; --overwrite .*)$", re.M)


class RunError(RuntimeError):
    """A run that did not complete.

    Attributes
    ----------
    code : exit code of the program: 1, some tasks failed; 3, stopped early, the state is saved and
        the same call goes on.
    """

    def __init__(self, code: int, message: str) -> None:
        """Keep the exit code, and what the program said."""
        super().__init__(message)
        self.code = code


def find_program(program: str | Path | None = None) -> Path:
    """Return the program: the one given, that of BATTERY_PROGRAM, make's own, that on PATH.

    Raises `InputError` if it is not there.
    """
    given = program or os.environ.get("BATTERY_PROGRAM")
    if given:
        return existing_file(Path(given)).resolve()
    on_path = shutil.which("battery")
    for place in (BUILT, INSTALLED, *([Path(on_path)] if on_path else [])):
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
    file : where to; None: nowhere.
    groups : values by group and key: numbers, texts, truth values, paths, or lists or arrays of
        numbers. None leaves a key out.
    program : the program that will run it, which is asked for its keys (see `find_program`).

    Raises
    ------
    ValueError
        A group or key does not exist, or a value is nothing that a namelist can hold. All
        problems are in the message. Types and bounds are left to the program.
    """
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
    if file is not None:
        try:
            Path(file).write_text(text, encoding="utf-8")
        except OSError as problem:
            raise InputError(f"{file}: {problem.strerror}") from problem
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
    """Run the program, or go on with a run; return the path of its results file.

    An interruption of Python (Ctrl-C) stops the run such that the same call goes on.

    Parameters
    ----------
    namelist : a file, or values by group and key (as in `write_namelist`).
    ranks : MPI ranks; 1: without a launcher. More than there are tasks, and processors here, are
        refused.
    folder : where it is called, made if need be; names of files in the namelist are relative to
        it. None: here.
    overwrite : discard results that are there.
    quiet : print nothing of what the program says.
    program : see `find_program`.
    launcher : what starts several ranks, their number comes behind it.

    Raises
    ------
    ValueError
        The input is bad, or results of another input are there: what the program says.
    RunError
        The run failed in part, or was stopped early.
    """
    if not isinstance(ranks, Integral) or ranks < 1:
        raise InputError(f"ranks = {ranks!r}: must be a whole number, at least 1")
    battery, place = find_program(program), Path(folder or ".")
    with _namelist_file(namelist, battery) as path:
        output_folder(place)
        words = [*(["--overwrite"] if overwrite else []), "--", str(path)]
        command = [*([*launcher, str(ranks)] if ranks > 1 else []), str(battery), *words]
        code, said, complaints = _check_ranks(
            ranks, [str(battery), "--check", *words], place
        ) or _launch(command, place, quiet)
    if isinstance(namelist, Mapping):
        complaints = complaints.replace(str(path), "the namelist")
    complaints = program_words(complaints)
    if code == EXIT_BAD_INPUT:
        raise InputError(complaints)
    if code:
        raise RunError(code, _reason(code, complaints, said))
    found = list(RESULTS.finditer(said))[-1]
    return place / (found["made"] or found["there"])


def _check_ranks(ranks: int, check: list[str], folder: Path) -> tuple[int, str, str] | None:
    """Refuse ranks that neither a task nor a processor waits for: launchers hang at a million.

    `check` is the command that prints the plan. If it fails so will the run: what it ended with.
    """
    processors = os.cpu_count() or 1
    if ranks <= processors:
        return None
    code, said, complaints = _launch(check, folder, quiet=True)
    if code:
        return code, said, complaints
    tasks = re.search(r"^tasks: +(\d+)", said, re.M)
    if tasks and ranks > int(tasks[1]):
        raise InputError(
            f"ranks = {ranks}: at most one for each task ({tasks[1]}), or for each processor of "
            f"this machine ({processors})"
        )
    return None


def _reason(code: int, complaints: str, said: str) -> str:
    """Return why a run did not complete."""
    if code == STOPPED:
        return "stopped early, the state is saved: the same call goes on"
    failures = [line for line in said.splitlines() if " failed: " in line]
    return complaints or "\n".join(failures) or f"the program ended with {code}"


@lru_cache
def _keys(program: Path) -> dict[str, tuple[str, ...]]:
    """Return the names of all groups, and of the keys of each, as the program lists them."""
    try:
        done = subprocess.run(
            [str(program), "--help"], check=False, text=True, errors="replace",
            stdin=subprocess.DEVNULL, capture_output=True,
        )  # fmt: skip
    except OSError as problem:
        raise InputError(f"{program}: {problem.strerror}") from problem
    groups = re.findall(r"^&(\w+)\n((?:  .*\n)*)/$", done.stdout, re.M)
    if done.returncode or not groups:
        raise InputError(f"{program}: --help lists no groups of a namelist: is it battery?")
    return {group: tuple(re.findall(r"^  (\w+)", keys, re.M)) for group, keys in groups}


def _values(
    group: str, keys: Mapping[str, object], known: Sequence[str], problems: list[str]
) -> dict[str, object]:
    """Return the values of a group as a namelist holds them; what is wrong joins `problems`."""
    values = {}
    for key, value in keys.items():
        plain = value.tolist() if hasattr(value, "tolist") else value
        plain = str(plain) if isinstance(plain, Path) else plain
        plain = list(plain) if isinstance(plain, (tuple, range)) else plain
        name = str(key).lower()
        if name not in known:
            problems.append(f"there is no key {key} in &{group}{_choice(name, known)}")
        elif name in values:
            problems.append(f"&{group} {key} is given twice")
        elif plain is not None and not _can_be_written(plain):
            problems.append(f"&{group} {key}: a namelist cannot hold {value!r}")
        elif plain is not None:
            values[name] = plain
    return values


def _can_be_written(value: object) -> bool:
    if isinstance(value, list):
        return bool(value) and all(
            _can_be_written(one) and not isinstance(one, list) for one in value
        )
    if isinstance(value, str):
        return value.isprintable()  # f90nml writes other signs as Python does
    return isinstance(value, (bool, int, float))


def _choice(word: str, known: Sequence[str] | Mapping[str, object]) -> str:
    close = difflib.get_close_matches(word.lower(), known, n=1)
    return f" (did you mean {close[0]}?)" if close else f"; there are {', '.join(known)}"


@contextmanager
def _namelist_file(namelist: str | Path | Groups, program: Path) -> Iterator[Path]:
    """Give the file of a namelist; one that is made of values is there for the run only."""
    if not isinstance(namelist, Mapping):
        yield existing_file(Path(namelist)).resolve()
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "namelist.nml"
        write_namelist(path, namelist, program=program)
        yield path


def _launch(command: list[str], folder: Path, quiet: bool) -> tuple[int, str, str]:
    """Return exit code, output and complaints of a command; output is shown as it comes."""
    said = []
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as complaints:
        try:
            process = subprocess.Popen(
                command, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=complaints, text=True, errors="replace", start_new_session=True,
            )  # fmt: skip
        except OSError as problem:
            raise InputError(f"{command[0]}: {problem.strerror}") from problem
        with process:
            try:
                for line in process.stdout or ():
                    said.append(line)
                    if not quiet:
                        print(line, end="", flush=True)
            except BaseException:
                process.send_signal(signal.SIGUSR1)  # saves the state; mpirun passes it on
                process.wait()
                raise
        complaints.seek(0)
        return process.returncode, "".join(said), complaints.read()

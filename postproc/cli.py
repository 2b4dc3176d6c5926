"""Shared by all command lines of the package: one-line errors, exit 2, output folders."""

from __future__ import annotations

import argparse
import errno
import importlib
import math
import os
import sys
import threading
import warnings
import zlib
from collections import deque
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from postproc import progress

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import ModuleType

EXIT_BAD_INPUT = 2
# The reader of a pipe, such as `head`, has enough: the exit of a program that SIGPIPE ended.
EXIT_CLOSED_PIPE = 141
EXIT_INTERRUPTED = 130
COMMAND = "battery-postproc"  # all commands as one, where the package is installed
MARK = "written by battery-postproc"  # in each file that is written, by which it is known again
# What is before the mark, by the kind of a file, with its first bytes; of MP4 its second four.
BEFORE_MARK = {
    "png": (b"\x89PNG", b"Software\0"), "pdf": (b"%PDF", b"/Creator ("),
    "html": (b"<!", b'name="generator" content="'),
    "gif": (b"GIF8", b"!\xfe%c" % len(MARK)), "mp4": (b"ftyp", b"data\0\0\0\1\0\0\0\0"),
}  # fmt: skip
OTHER_DASHES = tuple("\u2010\u2011\u2013\u2014\u2212")  # of word processors, in place of -
MOST_READ = 2**20  # bytes at each end of a file, where the mark is


# Asks the system for a signal when the parent, Python, ends, blocks none of them, and then replaces
# itself by the given program. A process of its own does this, since no Python code is safe between
# fork and exec.
ENDED_WITH = """
import ctypes, os, signal, sys
parent, *command = sys.argv[1:]
prctl = getattr(ctypes.CDLL(None), "prctl", None)
if prctl is not None:
    prctl(1, int(signal.SIGUSR1), 0, 0, 0)  # PR_SET_PDEATHSIG, which exec keeps
signal.pthread_sigmask(signal.SIG_SETMASK, ())  # which a parent may have blocked to wait for them
if os.getppid() != int(parent):
    sys.exit(1)
try:
    os.execvp(command[0], command)
except OSError as problem:
    print(f"{command[0]}: {problem.strerror}", file=sys.stderr)
    sys.exit(2)
"""


class InputError(ValueError):
    """Input of the user cannot be used; the message is one line with the reason."""


class Parser(argparse.ArgumentParser):
    """Argument parser that ends with one line and exit 2 at an invalid command line.

    Options may stand before, between and after files. The values of an option that takes several
    may be joined by commas, and end at the first word that is none of them.
    """

    def parse_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None
    ) -> argparse.Namespace:
        """Parse words, after each of several values has become an option of its own."""
        rest, words = deque(sys.argv[1:] if args is None else args), []
        while rest:
            word = rest.popleft()
            if word == "--":  # the rest are files; argparse would lose it
                words += [f"./{one}" if one.startswith("-") else one for one in rest]
                break
            if word.startswith(OTHER_DASHES):
                self.error(f"{word}: begins with another dash, U+{ord(word[0]):04X}, than -")
            name, given, value = word.partition("=")
            action = self._option_string_actions.get(name)
            if not isinstance(action, argparse._ExtendAction):
                words.append(word)
                continue
            values = value.split(",") if given else []
            while rest and not (given or rest[0].startswith("-")):
                if values and not self._is_value(action, rest[0]):
                    break
                values += rest.popleft().split(",")
            words += [f"{name}={one}" for one in values] or [word]
        return self.parse_intermixed_args(words)

    def _is_value(self, action: argparse.Action, word: str) -> bool:
        """Tell whether each part of a word, between commas, is a value of an option."""
        try:
            for one in word.split(","):
                self._check_value(action, self._get_value(action, one))
        except argparse.ArgumentError:
            return False
        return True

    def error(self, message: str) -> NoReturn:
        """Print one line and end with exit 2."""
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: error: {message} (--help explains)\n")

    def _print_message(self, message: str, file: Any = None) -> None:  # noqa: ANN401
        """Print help; argparse ignores a full device, which `run` reports as an error."""
        (file or sys.stderr).write(message)
        (file or sys.stderr).flush()


def parser(name: str, description: str | None) -> Parser:
    """Return a parser for the command NAME, described by the module's docstring."""
    installed = Path(sys.argv[0]).name == COMMAND
    return Parser(
        prog=f"{COMMAND} {name}" if installed else f"python -m postproc {name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_output(options: argparse.ArgumentParser) -> None:
    """Add `--output DIR`, by default the current folder."""
    options.add_argument(
        "--output", metavar="DIR", type=_folder, default=Path(),
        help="folder to write to (default: .)",
    )  # fmt: skip


def _folder(word: str) -> Path:
    try:
        return path_of(word, "folder")
    except InputError as problem:
        raise argparse.ArgumentTypeError(str(problem)) from problem


def add_verify(options: argparse.ArgumentParser) -> None:
    """Add `--verify`."""
    text = "read every file as a whole, and check the digest at its end"
    options.add_argument("--verify", action="store_true", help=text)


def add_task(options: argparse.ArgumentParser) -> None:
    """Add `--verify`, and `--point` and `--replica` that choose a task."""
    add_verify(options)
    for key, meaning in (("point", "parameter point"), ("replica", "replica")):
        help_text = f"{meaning}, from 0 (default: the first done, or all of a mean)"
        options.add_argument(f"--{key}", type=allowed(int, 0), help=help_text)


def extra(name: str, module: str) -> ModuleType:
    """Import a module that needs packages of the extra `name`; raise `InputError` without them."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as problem:
        package = str(problem.name).partition(".")[0]
        raise InputError(
            f"{package} is missing: pip install 'battery-postproc[{name}]'"
        ) from problem


def existing_file(path: Path) -> Path:
    """Return `path`, which must be a regular file, since a pipe or a device may have no end."""
    try:
        there = path.exists()
    except OSError as problem:
        raise InputError(f"{path}: {problem.strerror}") from problem
    if not there:
        raise InputError(f"{path}: no such file")
    if path.is_dir():
        raise InputError(f"{path}: is a folder, not a file")
    if not path.is_file():
        raise InputError(f"{path}: is a pipe or a device, not a file")
    return path


def file_to_write(path: Path, kind: str) -> Path:
    """Return `path`, at which a file of a kind is to be written: one of `BEFORE_MARK`, or "nml".

    A file that is there must be empty, or of this kind with the `MARK` of those that this package
    writes, and not protected; a namelist also unchanged since then.
    """
    told = "and is not replaced; name another file, or remove it"
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder, not a file")
        if path.is_file() and not os.access(path, os.W_OK):
            raise InputError(f"{path}: is write-protected, {told}")
        if path.is_file() and path.stat().st_size > 0 and not _has_mark(path, kind):
            since = ", or was changed since" if kind == "nml" else ""
            raise InputError(f"{path}: is no {kind} file {MARK}{since}, {told}")
    except OSError as problem:
        raise InputError(f"cannot write {path}: {problem.strerror}") from problem
    return path


def marked_namelist(text: str) -> str:
    """Return the text of a namelist with a first line that tells who wrote it, and its checksum."""
    return f"! {MARK}, checksum {zlib.crc32(text.encode()):08x}\n{text}"


def _has_mark(path: Path, kind: str) -> bool:
    """Return whether a file has the mark where this package writes it in files of this kind."""
    with path.open("rb") as file:
        content = file.read(MOST_READ)
        if kind == "nml":
            first, found, rest = content.decode(errors="replace").partition("\n")
            if not (found and first.startswith(f"! {MARK}")):
                return False
            rest += file.read().decode(errors="replace")
            # of a version before 0.4.0 without a checksum
            return first == f"! {MARK}" or first + found + rest == marked_namelist(rest)
        file.seek(-min(path.stat().st_size, MOST_READ), os.SEEK_END)
        content += file.read()
    first_bytes, before = BEFORE_MARK[kind]
    is_kind = content.startswith(first_bytes) or content[4:8] == first_bytes
    return is_kind and before + MARK.encode() in content


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield the path of a new file, which takes the place of `path` when it is whole.

    A failure leaves what was there, and is an `InputError`. A pipe or device is written to.
    """
    try:
        final = path.resolve()
    except RuntimeError as problem:  # OSError from Python 3.13 on
        raise InputError(f"cannot write {path}: its links lead in a circle") from problem
    own = f"{os.getpid()}.{threading.get_ident()}"
    half = final.with_name(f".{final.stem[:40]}.{own}{path.suffix}")
    try:
        if path.is_file() or not path.exists():
            yield half
            try:
                half.replace(final)
            except OSError as problem:
                # some file servers replace no file: what was there goes aside
                if problem.errno not in (errno.EEXIST, errno.EPERM):
                    raise
                aside = half.with_name(f"{half.name}.old")
                final.replace(aside)
                try:
                    half.replace(final)
                except OSError:
                    aside.replace(final)
                    raise
                aside.unlink()
        else:  # `final` is no place of a pipe
            yield path
    except OSError as problem:
        raise InputError(f"cannot write {path}: {problem.strerror or problem}") from problem
    finally:
        with suppress(OSError):
            half.unlink()


def plain_value(value: Any) -> Any:  # noqa: ANN401 (of any type)
    """Return values of numpy, pandas or xarray as numbers or lists; others as they are."""
    found = value.to_numpy() if hasattr(value, "to_numpy") else value  # xarray has no `tolist`
    return found.tolist() if hasattr(found, "tolist") else found


def path_of(value: object, name: str) -> Path:
    """Return the argument `name` as a path, `~/` as the home folder; else raise `InputError`."""
    if not isinstance(value, (str, os.PathLike)) or not str(value) or "\0" in str(value):
        raise InputError(f"{name} = {value!r}: must be a path")
    return Path(value).expanduser() if str(value).startswith("~/") else Path(value)


def ended_with_python(command: Sequence[str | Path]) -> list[str]:
    """Return a command that is stopped when the Python thread that starts it ends.

    On Linux, by SIGUSR1, at which the program saves its state, and which launchers pass on.
    """
    words = [str(word) for word in command]
    return [sys.executable, "-I", "-S", "-c", ENDED_WITH, str(os.getpid()), *words]


def allowed(
    kind: type[int] | type[float], low: float, high: float = 2**31 - 1
) -> Callable[[str], float]:
    """Return a function that converts an argument to a number from `low` to `high`."""

    def read(text: str) -> float:
        value = kind(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} must be at least {low} and at most {high}")
        return value

    read.__name__ = kind.__name__
    return read


def finite(value: object) -> object:
    """Return a value for JSON: numpy's numbers as Python's, NaN and infinity as None."""
    if isinstance(value, dict):
        return {str(key): finite(one) for key, one in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [finite(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def output_folder(path: Path) -> Path:
    """Return the folder `path`; it is made if it does not exist."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError(f"cannot make folder {path}: {problem.strerror}") from problem
    return path


def run(main: Callable[[list[str] | None], int], arguments: list[str] | None = None) -> int:
    """Call `main`; report errors of input and of the system in one line, with exit 2.

    These are `InputError`, and errors of the system: a file or folder, memory, a full output
    device. A reader of the output that has enough is no error: nothing is said, and the exit is
    141. What goes to a stream that is closed is lost.
    """
    _open_streams()
    try:
        try:
            with progress.told(), warnings.catch_warnings():
                warnings.showwarning = _show_warning
                return main(arguments)
        finally:
            sys.stdout.flush()
    except InputError as problem:
        message = str(problem)
    except BrokenPipeError:
        _forget_output()
        return EXIT_CLOSED_PIPE
    except OSError as problem:
        message = _system_message(problem)
    except KeyboardInterrupt:
        _forget_output()
        return EXIT_INTERRUPTED
    except MemoryError as problem:
        message = f"not enough memory: {problem}" if str(problem) else "not enough memory"
    _forget_output()
    print(f"error: {printable(' '.join(message.splitlines()))}", file=sys.stderr)
    return EXIT_BAD_INPUT


def _open_streams() -> None:
    """Open the null device in place of closed streams, under whose numbers files would be opened.

    The system gives the lowest number that is free.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115
        elif mode == "w" and hasattr(getattr(sys, name), "reconfigure"):
            # Names of files may have any bytes.
            getattr(sys, name).reconfigure(errors="backslashreplace")


def printable(text: str) -> str:
    """Return text that is safe on a terminal: control characters are shown as escapes."""
    shown = (one if one.isprintable() else ascii(one)[1:-1] for one in text)
    return "".join(shown)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning in one line, without the place in the code that it is from."""
    print(f"warning: {printable(' '.join(str(message).split()))}", file=sys.stderr)


def _system_message(problem: OSError) -> str:
    """Return the message of the system, with the file."""
    reason = problem.strerror or str(problem)
    return f"{problem.filename}: {reason}" if problem.filename else reason


def _forget_output() -> None:
    """Drop output that could not be printed, or Python tries again at its end, with a traceback."""
    try:
        sys.stdout.flush()
    except OSError:
        with Path(os.devnull).open("w", encoding="utf-8") as nothing:
            os.dup2(nothing.fileno(), sys.stdout.fileno())

"""Fenced blocks of the pages, found and evaluated by sybil.

The words after three back quotes decide what is done:

- `fortran`: a namelist, or a part of one, must pass `battery --check`. `file=NAME`: it is a copy of
  that file of the checkout, and its first line has the name.
- `sh run`, `python run`: executed, in a folder of the page; output and figures are shown.
- `sh check`: executed, without showing anything.
- `sh`: shown only; each command must exist, with its target, options and files.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import f90nml
import matplotlib.pyplot as plt
from sybil import Document
from sybil.evaluators.python import PythonEvaluator
from sybil.example import SybilFailure
from sybil.parsers.markdown.lexers import RawFencedCodeBlockLexer

from postproc import launcher

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sybil import Example, Region

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "build/manual/work"
BLOCK = re.compile(r"(?P<kind>fortran|python run|sh(?: run| check)?)(?: file=(?P<file>\S+))?$\n",
                   re.MULTILINE)  # fmt: skip
# Commands that this machine need not have, and words that stand for something of the reader's.
ELSEWHERE = ("module", "mpifort", "podman", "sbatch", "spack", "srun")
PLACEHOLDER = re.compile(r"[A-Z][A-Z_]*\b|/some/|\$|@")
ENVIRONMENT = {
    **os.environ, **launcher.LAUNCHER, "MPLBACKEND": "agg", "COLUMNS": "100",
    "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT),
}  # fmt: skip
# A page shows an initial file of two particles.
START = "-2 0.5 1 0\n2 -0.5 0 1\n"
LENGTHS = {"collisions", "transient_collisions", "duration", "transient_duration"}


def evaluated(name: str, text: str, work: Path = WORK) -> tuple[str, list[tuple[int, str]]]:
    """Evaluate the blocks of a page, in a folder of its name below `work`.

    Return its text with what blocks printed and drew below them, and the problems by lines.
    """
    document, problems, shown, end = Document(text, name), [], [], 0
    plt.close("all")  # figures of others would be shown as those of this page
    for region in _regions(document):
        document.add(region)
    with contextlib.chdir(_new_folder(work / name)):
        for example in document:
            try:
                example.evaluate()
            except SybilFailure as problem:
                problems.append((example.line, problem.result))
            except Exception as problem:
                problems.append((example.line, f"{type(problem).__name__}: {problem}"))
            shown += [text[end : example.end], example.region.lexemes.get("shown", "")]
            end = example.end
    return "".join([*shown, text[end:]]), problems


def _regions(document: Document) -> Iterator[Region]:
    for region in RawFencedCodeBlockLexer(BLOCK)(document):
        region.parsed, kind = region.lexemes["source"], region.lexemes["kind"]
        region.evaluator = EVALUATORS[kind]
        yield region


def _new_folder(folder: Path) -> Path:
    """Return an empty folder in which the paths of the checkout that pages name work."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in ("build", "namelists"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "start.txt").write_text(START)
    return folder


def _namelist(example: Example) -> str:
    if name := example.region.lexemes["file"]:
        same = (ROOT / name).is_file() and (ROOT / name).read_text() == example.parsed
        if not (same and example.parsed.startswith(f"! {name}: ")):
            return f"the block is not {name}, or its first line does not name it"
    Path("checked.nml").write_text(_completed(example.parsed))
    return _failure(ROOT / "build/bin/battery", "--check", "checked.nml", **launcher.ALONE)


def _completed(text: str) -> str:
    """Return a namelist completed by the keys that it needs for a valid, short run."""
    groups = f90nml.Parser().reads(text).todict()
    fraction = "threshold_fraction" in text
    needed = {
        "particles": {"number": 1000},
        "gate": {"threshold_fraction": 0.007} if fraction else {"threshold": 7},
        "run": {"collisions": 100000, "transient_collisions": 0},
    }
    if LENGTHS & groups.get("run", {}).keys():
        needed["run"] = {}
    for group, keys in needed.items():
        groups[group] = keys | groups.get(group, {})
    return f"{f90nml.Namelist(groups)}\n"


def _done(*command: str | Path, **more: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, check=False, env=ENVIRONMENT | more, text=True, timeout=300,
        stdin=subprocess.DEVNULL, capture_output=True,
    )  # fmt: skip


def _failure(*command: str | Path, **more: str) -> str:
    """Run a command; return what it says if it fails."""
    done = _done(*command, **more)
    said = (done.stderr or done.stdout).strip()
    return f"exit code {done.returncode}: {said}" if done.returncode else ""


def _shell(example: Example) -> str:
    done = _done("bash", "-euo", "pipefail", "-c", example.parsed)
    if done.returncode:
        return f"exit code {done.returncode}: {(done.stderr or done.stdout).strip()}"
    if example.region.lexemes["kind"] == "sh run":
        _show(example, done.stdout.replace(f"{ROOT}/", ""))
    return ""


def _python(example: Example) -> None:
    """Execute a block; blocks of a page share their names."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        PythonEvaluator()(example)
    _show(example, printed.getvalue())


def _show(example: Example, printed: str) -> None:
    """Keep what was printed, and pictures that are open or were just written, for the page."""
    text = f"\n\n```text\n{printed.rstrip()}\n```" if printed.strip() else ""
    for number in plt.get_fignums():
        plt.figure(number).savefig(f"{number}.png", dpi=110)
    plt.close("all")
    drawn = Path("drawn")
    drawn.mkdir(exist_ok=True)
    for path in sorted(Path().glob("*.png")):
        place = path.rename(drawn / f"{len(list(drawn.iterdir())) + 1}.png").resolve()
        text += f"\n\n![What it drew](/{os.path.relpath(place, ROOT)})"
    example.region.lexemes["shown"] = text


def _commands(example: Example) -> str:
    """Return the problems of commands that are shown only; `cd` holds for the lines below it."""
    problems, folder = [], ROOT
    for line in example.parsed.replace("\\\n", " ").splitlines():
        words = [one for one in shlex.split(line, comments=True) if not re.match(r"\w+=", one)]
        if words[:1] == ["mpirun"]:
            words = words[3:]
        if words[:1] == ["cd"]:
            folder = folder / words[1]
        elif words and (problem := _problem(words, folder)):
            problems.append(f"{line.strip()}: {problem}")
    return "\n".join(problems)


def _problem(words: list[str], folder: Path) -> str:
    """Return why a command that is called in a folder cannot be one."""
    if words[0] == "make":
        unknown = [one for one in words[1:] if one not in _targets()]
        return f"make has no {', '.join(unknown)}" if unknown else ""
    if Path(words[0]).name == "battery-postproc":
        words = ["python", "-m", "postproc", *words[1:]]
    if "python" in words[0] and words[1] == "-m":
        name = words[2 : 4 if re.fullmatch(r"[a-z]\w*", words[3] if words[3:] else "") else 3]
        told = _help(folder, *name)
        options = {one.split("=")[0] for one in words if re.match(r"--\w", one)}
        if unknown := [one for one in options if one not in told] or not told:
            return f"{' '.join(name)} has no {unknown}" if told else f"no {' '.join(name)}"
    elif not ("/" in words[0] or words[0] in ELSEWHERE or _is_command(words[0])):
        return f"there is no {words[0]}"
    paths = [one for one in words if "/" in one and not re.match(r"-|/", one)
             and not PLACEHOLDER.search(one)]  # fmt: skip
    missing = [
        one for one in paths if one not in _targets()
        and not any((place / one.split(":")[0]).exists() for place in (folder, ROOT))
    ]  # fmt: skip
    return f"there is no {', '.join(missing)}" if missing else ""


def _is_command(name: str) -> bool:
    return shutil.which(name, path=ENVIRONMENT["PATH"]) is not None


@cache
def _targets() -> set[str]:
    """Return the targets of make, with those of studies; nothing is made."""
    told = _done("make", "--directory", ROOT, "--print-data-base", "--question", "help").stdout
    return set(re.findall(r"^([\w./-]+):", told, re.MULTILINE))


@cache
def _help(folder: Path, *words: str) -> str:
    with contextlib.chdir(folder):
        done = _done(sys.executable, "-m", *words, "--help")
    return done.stdout if done.returncode == 0 else ""


EVALUATORS = {
    "fortran": _namelist, "python run": _python, "sh run": _shell, "sh check": _shell,
    "sh": _commands,
}  # fmt: skip

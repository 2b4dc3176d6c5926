"""Fenced blocks of the pages: namelists and commands are checked, tutorials are executed.

The words after three back quotes decide what is done:

- `fortran`: a namelist, or a part of one, must pass `battery --check`. `file=NAME`: it is a copy of
  that file of the checkout, and its first line has the name.
- `sh run`, `python run`: executed where the site is built; output and figures are shown.
- `sh check`: executed, without showing anything.
- `sh`, or none: each command must exist, with its target, options and files.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
import traceback
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib.pyplot as plt

from manual import reference
from postproc import launcher

FENCE = re.compile(r"^( *)```([^\n`]*)\n(.*?)^\1``` *$", re.MULTILINE | re.DOTALL)
KNOWN = ("cd", "pip", "tail", "head", "grep", "git", "sbatch", "perf")
FIRST = re.compile(
    r"(?:\w+=\S+ )*(make|mpirun|fpm|python3?|battery-\w+|build/\S+|\.\./\S+|cd|pip|tail|grep)\b"
)
PLACEHOLDER = re.compile(r"[A-Z][A-Z_]*\b|/some/|\.\.\.|\.h5$|\.nml$|\*")
PATIENCE = 300.0
ENVIRONMENT = {
    **os.environ,
    **launcher.LAUNCHER,
    "MPLBACKEND": "agg",
    "COLUMNS": "100",
    "PYTHONPATH": str(Path(__file__).resolve().parents[2]),
}


# Settings for the program without mpirun: without a daemon of Open MPI it starts in half the time.
ALONE = ENVIRONMENT | launcher.ALONE


@dataclass
class Fences:
    """Checks the blocks of one page, and collects the problems.

    Attributes
    ----------
    root : the checkout.
    folder : where namelists are written and commands of tutorials run.
    pictures : where pictures of this page are put, in the source of the site.
    dry : whether no block is executed, to see how pages look.
    """

    root: Path
    folder: Path
    pictures: Path
    dry: bool = False
    problems: list[str] = field(default_factory=list)
    names: dict[str, object] = field(default_factory=dict)
    helps: dict[str, str] = field(default_factory=dict)

    def shown(self, page: str, text: str) -> str:
        """Return the text of a page with the output of its blocks; collect the problems."""
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "start.txt").write_text(reference.START)

        def one(match: re.Match[str]) -> str:
            words, body = match[2].split(), match[3]
            word = words[0] if words else ""
            wrong, output = ([], "") if self.dry else self._tried(word, words[1:], body)
            line = text.count("\n", 0, match.start()) + 1
            self.problems.extend(f"{page}:{line}: {one}" for one in wrong)
            return f"{match[1]}```{word or 'text'}\n{body}{match[1]}```{output}"

        return FENCE.sub(one, text)

    def _tried(self, word: str, words: list[str], body: str) -> tuple[list[str], str]:
        for name in (one.removeprefix("file=") for one in words if one.startswith("file=")):
            if wrong := self._other_file(name, body):
                return [wrong], ""
        if word == "fortran" and re.search(r"^\s*&\w+", body, re.MULTILINE):
            return self._namelist(body), ""
        if word == "python":
            return self._python(body) if "run" in words else ([], "")
        if word in ("", "sh"):
            if "run" in words or "check" in words:
                wrong, output = self._shell(body)
                return wrong, output if "run" in words else ""
            if word == "sh" or FIRST.match(body):
                return self._commands(body), ""
        return [], ""

    def _other_file(self, name: str, body: str) -> str:
        """Return how a block differs from the file that it shows; empty: it does not."""
        if not body.startswith(f"! {name}"):
            return f"the first line does not name {name}"
        path = self.root / name
        same = path.is_file() and path.read_text(encoding="utf-8") == body
        return "" if same else f"{name} is not what is shown"

    def _namelist(self, body: str) -> list[str]:
        (self.folder / "checked.nml").write_text(reference.completed(body))
        program = str(self.root / "build/bin/battery")
        done = self._done([program, "--check", "checked.nml"], ALONE)
        return [] if done.returncode == 0 else [f"battery --check: {done.stderr.strip()}"]

    def _done(
        self, command: list[str], environment: dict[str, str] = ENVIRONMENT
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command,
            check=False,
            cwd=self.folder,
            env=environment,
            text=True,
            timeout=PATIENCE,
            stdin=subprocess.DEVNULL,
            capture_output=True,
        )

    def _shell(self, body: str) -> tuple[list[str], str]:
        """Run a block; `build/` and `namelists/` are those of the checkout."""
        text = re.sub(r"(?<![\w/])(build|namelists)/", rf"{self.root}/\1/", body)
        done = self._done(["bash", "-euo", "pipefail", "-c", text])
        if done.returncode:
            return [f"exit code {done.returncode}: {(done.stderr or done.stdout).strip()}"], ""
        return [], self._output(done.stdout.replace(f"{self.root}/", ""))

    def _python(self, body: str) -> tuple[list[str], str]:
        """Execute a block; blocks of a page share their names."""
        before, printed = Path.cwd(), io.StringIO()
        os.chdir(self.folder)
        try:
            with contextlib.redirect_stdout(printed):
                exec(compile(body, "page", "exec"), self.names)
        except Exception:
            return [traceback.format_exc(limit=-1).strip()], ""
        finally:
            os.chdir(before)
        return [], self._output(printed.getvalue())

    def _output(self, printed: str) -> str:
        """Return the printed output, and pictures that are open or were just written."""
        text = f"\n\n```text\n{printed.rstrip()}\n```" if printed.strip() else ""
        self.pictures.mkdir(parents=True, exist_ok=True)
        for number in plt.get_fignums():
            plt.figure(number).savefig(self.folder / f"{len(self.names)}_{number}.png", dpi=110)
        plt.close("all")
        for path in sorted(self.folder.glob("*.png")):
            name = f"{len(list(self.pictures.glob('*.png'))) + 1}.png"
            path.rename(self.pictures / name)
            text += f"\n\n![What it drew]({self.pictures.name}/{name})"
        return text

    def _commands(self, body: str) -> list[str]:
        wrong, folder = [], self.root
        for line in body.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            while words and re.fullmatch(r"\w+=\S*", words[0]):
                words.pop(0)
            if words[:1] == ["cd"]:
                folder = folder / words[1]
            elif words:
                wrong += [f"{line.strip()}: {one}" for one in self._command(words, folder)]
        return wrong

    def _command(self, words: list[str], folder: Path) -> list[str]:
        """Return the problems of a command that is called in a folder."""
        if words[0] == "mpirun":
            at = next((at for at, one in enumerate(words) if "battery" in one), len(words))
            words = words[at:]
        if not words:
            return ["mpirun of nothing"]
        name = words[0]
        if name == "make":
            return self._make(words[1:])
        if name == "fpm":
            sections = (self.root / "fpm.rsp").read_text().split()
            return [f"no {one}" for one in words if one.startswith("@") and one not in sections]
        if Path(name).name == "battery-postproc":
            name, words = "python", ["python", "-m", "postproc", *words[1:]]
        if "python" in name and words[1:2] == ["-m"]:
            return self._module(words[2:], folder)
        if name in KNOWN or name == "python3":
            paths = [one for one in words[1:] if "/" in one]
        elif (folder / name).exists() or not self._make([name]):
            paths = words[1:]
        else:
            return [f"there is no {name}"]
        return self._missing(paths, folder)

    def _missing(self, words: list[str], folder: Path) -> list[str]:
        return [
            f"there is no {one}"
            for one in words
            if "/" in one
            and not one.startswith("-")
            and not PLACEHOLDER.search(one)
            and not (folder / one.split(":")[0]).exists()
            and self._make([one])
        ]

    def _make(self, words: list[str]) -> list[str]:
        text = (self.root / "Makefile").read_text()
        for name in re.findall(r"^-include (\S+\.mk)$", text, re.MULTILINE):
            text += (self.root / name).read_text() if (self.root / name).is_file() else ""
        return [
            f"make has no {one}"
            for one in words
            if "=" not in one
            and not re.search(rf"^(?:\S+ )*{re.escape(one)}[ :]", text, re.MULTILINE)
        ]

    def _module(self, words: list[str], folder: Path) -> list[str]:
        """Check options against the help of a module or of its subcommand."""
        at = 2 if words[1:2] and re.fullmatch(r"[a-z]\w*", words[1]) else 1
        help_text = self._help(words[:at], folder) or self._help(words[:1], folder)
        if not help_text:
            return [f"{words[0]} cannot be called"]
        if words[0] == "pytest":
            return self._missing(words[1:], folder)
        options = [one.split("=")[0] for one in words[1:] if re.match(r"--\w", one)]
        name = " ".join(words[:at])
        return [f"{name} has no {one}" for one in options if one not in help_text]

    def _help(self, words: list[str], folder: Path) -> str:
        """Return the output of a module for --help; nothing if it cannot be called."""
        name = " ".join(words)
        if name not in self.helps:
            done = subprocess.run(
                [sys.executable, "-m", *words, "--help"],
                check=False,
                cwd=folder,
                text=True,
                env=ENVIRONMENT,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=PATIENCE,
            )
            self.helps[name] = done.stdout if done.returncode == 0 else ""
        return self.helps[name]

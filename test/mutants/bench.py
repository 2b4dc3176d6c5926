"""Where mutants are built and tried: one object of the tests' package compiled anew and linked.

Nothing but the object of the changed file differs: the debug build compiles no procedure of one
file into another, and no mutation touches a declaration. So a mutant costs seconds, not minutes.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

from support.program import ROOT

from .mutation import Mutation

FOLDER = ROOT / "build/mutants"
#: No mutant may take longer than so many times what the sound program takes, and some seconds.
PATIENCE, SECONDS = 5.0, 20.0
USE = re.compile(r"^\s*use\s*(?:,\s*non_intrinsic\s*)?(?:::)?\s*(\w+)", re.MULTILINE | re.I)
#: A module's name, or that of the module that a submodule belongs to.
MODULE = re.compile(r"^\s*(?:module\s+|submodule\s*\()(\w+)(?:\s*$|[:\w]*\))", re.MULTILINE | re.I)


class UnsoundError(Exception):
    """The program is not sound before anything is changed."""


def load_runner() -> ModuleType:
    """Load `test/run`, which builds suites and reads their reports."""
    loader = importlib.machinery.SourceFileLoader("test_run", str(ROOT / "test/run"))
    spec = importlib.util.spec_from_loader("test_run", loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["test_run"] = module
    loader.exec_module(module)
    return module


@dataclass
class Trial:
    """What came of one mutant."""

    mutation: Mutation
    #: killed, survived, does not build, equivalent
    verdict: str
    #: Tests that turned red, as `suite: test`.
    red: list[str] = field(default_factory=list)


class Bench:
    """The sound tests, built once, and what is needed to try mutants on them.

    Parameters
    ----------
    names : list of str
        Suites that are run, by the names of their files without `.pf`.
    """

    def __init__(self, names: list[str]) -> None:
        self.runner = load_runner()
        self.flags = (
            self.runner.FLAGS["debug"] + " " + self.runner.package_config("--cflags-only-I")
        )
        self.libraries = self.runner.package_config("--libs-only-L")
        package = FOLDER / "package"
        files = [ROOT / f"test/{name}.pf" for name in names]
        suites = self.runner.write_package(package, files, None)
        program = self.runner.build(
            package, self.flags, self.libraries, self.runner.COMPILER, verbose=False
        )
        self.objects = newest(package.glob("build/*/battery_tests/suites_*.o"))
        self.archives = newest(package.glob("build/*/*/lib*.a"))
        self.modules = newest(package.glob("build/*/battery_table.mod"))[0].parent
        self.seconds = {}
        for suite in suites:
            sound = self.runner.run_suite(suite, program, 600.0)
            if sound.failed:
                raise UnsoundError(f"{suite.module}: {sound.failures[0]}")
            self.seconds[suite.module] = sound.seconds
        self.suites = sorted(suites, key=lambda suite: self.seconds[suite.module])
        self.reach = {suite.module: reached_from(f"test/{suite.module}.pf") for suite in suites}

    def suites_for(self, file: str) -> list:
        """Return the suites that come to a file, its own first, then the quickest."""
        own = f"test_{Path(file).stem}"
        some = [suite for suite in self.suites if file in self.reach[suite.module]]
        return sorted(some, key=lambda suite: suite.module != own)

    def build(self, mutation: Mutation, folder: Path) -> bool:
        """Put the program with a mutant into a folder; tell whether it could be built."""
        folder.mkdir(parents=True, exist_ok=True)
        lines = (ROOT / mutation.file).read_text(encoding="utf-8").splitlines()
        lines[mutation.number - 1] = mutation.changed
        source = folder / Path(mutation.file).name
        source.write_text("\n".join(lines) + "\n", encoding="utf-8")
        compiled = folder / "mutant.o"
        # A mutant may well leave a variable unused.
        common = ["mpifort", *shlex.split(self.flags.replace("-Werror", ""))]
        compile_it = [
            *common,
            "-fimplicit-none",
            "-ffree-form",
            f"-I{self.modules}",
            f"-J{folder}",
            "-c",
            str(source),
            "-o",
            str(compiled),
        ]
        # What the object defines is not looked for in the archives.
        link_it = [
            *common,
            *map(str, self.objects),
            str(compiled),
            *map(str, self.archives),
            *shlex.split(self.libraries),
            "-lhdf5_hl",
            "-lhdf5_fortran",
            "-lhdf5",
            "-lcrypto",
            "-lgsl",
            "-lgslcblas",
            "-o",
            str(folder / self.runner.PROGRAM),
        ]
        return all(
            subprocess.run(command, capture_output=True, check=False).returncode == 0
            for command in (compile_it, link_it)
        )

    def attempt(self, mutation: Mutation, only: str = "", *, every: bool = False) -> Trial:
        """Try one mutant, until a suite turns red.

        Parameters
        ----------
        mutation : Mutation
            What is changed.
        only : str
            The one suite that is run; else all that come to the file.
        every : bool
            Whether to go on after the first suite that turns red.

        Returns
        -------
        Trial
            Its end.
        """
        folder = FOLDER / f"mutant_{os.getpid()}"
        if not self.build(mutation, folder):
            return Trial(mutation, "does not build")
        red: list[str] = []
        for suite in self.suites_for(mutation.file):
            if only not in ("", suite.module):
                continue
            patience = SECONDS + PATIENCE * self.seconds[suite.module]
            found = self.runner.run_suite(suite, folder / self.runner.PROGRAM, patience)
            red += [f"{suite.module}: {name}" for name in names_of(found.failures)]
            if red and not every:
                break
        return Trial(mutation, "killed" if red else "survived", red)


def names_of(failures: list[str]) -> list[str]:
    """Return the names of tests that failed, from what the runner says of them."""
    found = [re.match(r"(?:test/\S+: )?([a-z]\w*)", text) for text in failures]
    return [match[1] if match else "(the program ended)" for match in found]


def newest(paths: object) -> list[Path]:
    """Of files of one name in several folders keep the newest."""
    kept: dict[str, Path] = {}
    for path in sorted(paths, key=lambda path: path.stat().st_mtime):  # type: ignore[call-overload]
        kept[path.name] = path
    return list(kept.values())


def reached_from(file: str) -> set[str]:
    """Return the files of src that a file comes to, over whatever it uses."""
    homes: dict[str, set[Path]] = {}
    for path in (ROOT / "src").rglob("*.[fF]90"):
        for name in MODULE.findall(path.read_text(encoding="utf-8")):
            homes.setdefault(name.lower(), set()).add(path)
    for path in (ROOT / "test/support").glob("*.f90"):
        for name in MODULE.findall(path.read_text(encoding="utf-8")):
            homes.setdefault(name.lower(), set()).add(path)
    seen: set[Path] = set()
    waiting = [ROOT / file]
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        for name in USE.findall(path.read_text(encoding="utf-8")):
            waiting += homes.get(name.lower(), set())
    return {str(path.relative_to(ROOT)) for path in seen}

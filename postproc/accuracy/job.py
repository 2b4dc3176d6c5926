"""What the parts of the package share: the folder, quick or full, the program, kept numbers."""

from __future__ import annotations

import json
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import f90nml

from postproc.cli import InputError, ended_with_python, finite, output_folder
from postproc.launcher import LAUNCHER, program_words

if TYPE_CHECKING:
    from collections.abc import Mapping

    Changes = Mapping[str, Mapping[str, object]]  # values by group and key

ROOT = Path(__file__).resolve().parents[2]
NAMELISTS = ROOT / "namelists"
DIFFERENT = 2  # exit code of the program for results of another input


@dataclass(frozen=True)
class Job:
    """Where and how the parts run.

    Attributes
    ----------
    folder : everything made lands here: namelists, results, figures, numbers.
    full : long runs in place of quick ones.
    program : the built program.
    ranks : MPI ranks of an ensemble.
    afresh : discard results that are there.
    publish : copy the page and its figures into docs/.
    """

    folder: Path
    full: bool = False
    program: Path = ROOT / "build/bin/battery"
    ranks: int = 2
    afresh: bool = False
    publish: bool = False

    def pick(self, quick: float, full: float) -> float:
        """Return the one or the other, as the job is quick or full."""
        return full if self.full else quick

    def battery(
        self, case: str, name: str, changes: Changes | None = None, *, alone: bool = False
    ) -> Path:
        """Run `namelists/accuracy_CASE.nml` with some keys changed; return its results file.

        The namelist is written to `folder/NAME.nml`, the results are `folder/NAME.h5`. A run that
        is complete is not repeated, one that was interrupted goes on; other results of that name
        are discarded. `changes` are values by group and key; None removes a key. `alone`: without
        mpirun, for the short run of a single task.
        """
        source = NAMELISTS / f"accuracy_{case}.nml"
        try:
            text = namelist_text(source, {**(changes or {}), "output": _output(changes, name)})
        except OSError as problem:
            raise InputError(f"{source}: {problem.strerror}") from problem
        return self.run_text(text, name, alone=alone)

    def run_text(self, text: str, name: str, *, alone: bool = False) -> Path:
        """Run a namelist whose results file is NAME.h5, as `battery` does."""
        path = output_folder(self.folder) / f"{name}.nml"
        path.write_text(text, encoding="utf-8")
        done = self._launch(path.name, alone, *(["--overwrite"] if self.afresh else []))
        if done.returncode == DIFFERENT:  # of another input, or of another version
            done = self._launch(path.name, alone, "--overwrite")
        if done.returncode:
            said = (program_words(done.stderr) or done.stdout.strip()).splitlines()
            said = said or ["nothing was said"]
            raise InputError(f"{path}: exit {done.returncode}: {said[0]}")
        return path.with_suffix(".h5")

    def _launch(self, name: str, alone: bool, *options: str) -> subprocess.CompletedProcess[str]:
        launcher = [] if alone else ["mpirun", "-n", str(self.ranks)]
        command = [*launcher, str(self.program.resolve()), "--quiet", *options, name]
        return subprocess.run(
            ended_with_python(command), cwd=self.folder, env={**os.environ, **LAUNCHER},
            check=False, text=True, stdin=subprocess.DEVNULL, capture_output=True,
        )  # fmt: skip

    def keep(self, part: str, numbers: Mapping[str, object]) -> Path:
        """Write the numbers of a part to `folder/PART.json` (NaN and infinity as null)."""
        path = output_folder(self.folder) / f"{part}.json"
        path.write_text(json.dumps(finite(numbers), indent=1) + "\n", encoding="utf-8")
        print(path)
        return path

    def kept(self, part: str) -> dict[str, object] | None:
        """Return the numbers of a part, None if it has not been made."""
        path = self.folder / f"{part}.json"
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def _output(changes: Changes | None, name: str) -> dict[str, object]:
    return {**dict((changes or {}).get("output", {})), "file": f"{name}.h5"}


def namelist_text(source: Path, changes: Changes) -> str:
    """Return a namelist file's text with values changed, groups added, and None removed."""
    groups = f90nml.Parser().reads(source.read_text(encoding="utf-8"))
    for group, values in changes.items():
        if group not in groups:
            groups[group] = f90nml.Namelist()
        for key, value in values.items():
            if value is None:
                groups[group].pop(key, None)
            else:
                groups[group][key] = list(value) if isinstance(value, tuple) else value
    groups.column_width = 100
    return f"{groups}\n"

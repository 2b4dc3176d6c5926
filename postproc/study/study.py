"""The folder of a study: runs are resumed or replaced, numbers, tables and pictures stored."""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import f90nml

from postproc import cli, running
from postproc.figures import style
from postproc.launcher import LAUNCHER

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from matplotlib.figure import Figure

    Groups = Mapping[str, Mapping[str, object]]  # values by group and key
    Parts = Mapping[str, Callable[["Study"], None]]

ROOT = Path(__file__).resolve().parents[2]
NAMELISTS = ROOT / "namelists"
MPIRUN = ("env", *(f"{key}={value}" for key, value in LAUNCHER.items()), "mpirun", "-n")


@dataclass(frozen=True)
class Study:
    """Folders and settings of a study.

    Attributes
    ----------
    folder : folder of all output: namelists, results, numbers, tables, pictures.
    place : folder of the namelists.
    full : long runs instead of quick ones.
    ranks : MPI ranks of an ensemble.
    afresh : discard existing results.
    program : the program; None: that of `postproc.run`.
    page : folder of the page to which tables and pictures are copied, and the prefix of their names
        there; None: they are not copied.
    """

    folder: Path
    place: Path = NAMELISTS
    full: bool = False
    ranks: int = 2
    afresh: bool = False
    program: Path | None = None
    page: tuple[Path, str] | None = None

    def pick(self, quick: float, full: float) -> float:
        """Return `full` if the study is full, else `quick`."""
        return full if self.full else quick

    def run(
        self, namelist: str | Groups, name: str, changes: Groups | None = None, *,
        alone: bool = False,
    ) -> Path:  # fmt: skip
        """Run a namelist with some keys changed; return its results file, `folder/NAME.h5`.

        The namelist is written to `folder/NAME.nml`. A complete run is not repeated, an interrupted
        one is resumed; results of another input under that name are discarded.

        Parameters
        ----------
        namelist : the name of a file of `place`, without its suffix; or values by group and key.
        name : name of the run.
        changes : values by group and key; None removes a key.
        alone : without mpirun, for the short run of a single task.
        """
        path = cli.output_folder(self.folder) / f"{name}.nml"
        own = {**(changes or {})}
        own["output"] = {**own.get("output", {}), "file": f"{name}.h5"}
        path.write_text(namelist_text(self._groups(namelist), own), encoding="utf-8")
        try:
            return self._launched(path, alone, overwrite=self.afresh)
        except cli.InputError:  # perhaps results of another input, or of another version
            return self._launched(path, alone, overwrite=True)

    def _groups(self, namelist: str | Groups) -> Groups:
        if isinstance(namelist, Mapping):
            return namelist
        path = cli.existing_file(self.place / f"{namelist}.nml")
        return f90nml.Parser().reads(path.read_text(encoding="utf-8"))

    def _launched(self, path: Path, alone: bool, *, overwrite: bool) -> Path:
        try:
            return running.run(
                path, folder=self.folder, ranks=1 if alone else self.ranks, overwrite=overwrite,
                quiet=True, program=self.program, launcher=MPIRUN,
            )  # fmt: skip
        except running.RunError as problem:
            raise cli.InputError(f"{path}: exit {problem.code}: {problem}") from problem

    def theory(self, model: str, **keys: object) -> dict[str, object]:
        """Return the output of `python -m postproc.theory` for a circuit, given by its options."""
        words = ["--model", model]
        for key, value in keys.items():
            values = value if isinstance(value, (list, tuple)) else [value]
            words += [f"--{key.replace('_', '-')}", *([] if value is True else map(str, values))]
        command = [sys.executable, "-m", "postproc.theory", *words]
        done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=ROOT)
        if done.returncode:
            raise cli.InputError(f"{' '.join(command[1:])}: {done.stderr.strip()}")
        return json.loads(done.stdout)

    def keep(self, name: str, numbers: Mapping[str, object]) -> Path:
        """Write numbers to `folder/NAME.json` (NaN and infinity as null)."""
        path = cli.output_folder(self.folder) / f"{name}.json"
        path.write_text(json.dumps(cli.finite(numbers), indent=1) + "\n", encoding="utf-8")
        print(path)
        return path

    def kept(self, name: str) -> dict[str, object] | None:
        """Return stored numbers, None if there are none."""
        path = self.folder / f"{name}.json"
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None

    def table(self, name: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> Path:
        """Write a table of a page to `folder/NAME.csv`."""
        path = cli.output_folder(self.folder) / f"{name}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([head, *rows])
        print(path)
        self._publish(path)
        return path

    def draw(self, made: Figure, name: str) -> Path:
        """Write a picture of a page to `folder/NAME.png` and `NAME.pdf`."""
        path = style.save(made, self.folder, name)[0]
        self._publish(path)
        return path

    def _publish(self, path: Path) -> None:
        if self.page is not None:
            folder, prefix = self.page
            shutil.copyfile(path, folder / f"{prefix}{path.name}")


def namelist_text(groups: Groups, changes: Groups) -> str:
    """Return a namelist's text with values changed, groups added, and None removed."""
    merged = f90nml.Namelist()
    for group in {**groups, **changes}:
        values = {**groups.get(group, {}), **changes.get(group, {})}
        merged[group] = f90nml.Namelist({
            key: list(value) if isinstance(value, tuple) else value
            for key, value in values.items() if value is not None
        })  # fmt: skip
    merged.column_width = 100
    return f"{merged}\n"


def add_options(
    options: argparse.ArgumentParser, output: Path, parts: Sequence[str] = ()
) -> None:
    """Add the options that every study has; results go to a folder in `output` by default."""
    if parts:
        options.add_argument(
            "parts", metavar="PART", nargs="*",
            help=f"parts to make, by default all: {' '.join(parts)}",
        )  # fmt: skip
    options.add_argument("--full", action="store_true", help="long runs, as on the page")
    options.add_argument("--afresh", action="store_true", help="discard the runs that are there")
    options.add_argument(
        "--publish", action="store_true", help="copy tables and pictures beside the page"
    )
    options.add_argument(
        "--ranks", type=cli.integer(1), default=2, help="MPI ranks of an ensemble (default: 2)"
    )
    options.add_argument("--program", type=Path, help="default: build/bin/battery")
    shown = output.relative_to(ROOT) if output.is_relative_to(ROOT) else output
    options.add_argument(
        "--output", metavar="DIR", type=Path, help=f"default: {shown}/quick, or full"
    )
    options.set_defaults(default_output=output)


def chosen_parts(given: argparse.Namespace, parts: Sequence[str]) -> Sequence[str]:
    """Return the parts named on a command line, all if none; an error lists the parts."""
    wrong = [part for part in given.parts if part not in parts]
    if wrong:
        raise cli.InputError(f"there is no part {wrong[0]}; allowed: {' '.join(parts)}")
    return given.parts or parts


def study_of(given: argparse.Namespace, place: Path, page: tuple[Path, str]) -> Study:
    """Return the study of a command line with the options of `add_options`."""
    folder = given.output or given.default_output / ("full" if given.full else "quick")
    program = running.find_program(given.program)
    shown = page if given.publish else None
    return Study(folder, place, given.full, given.ranks, given.afresh, program, shown)


def main(
    file: str, description: str | None, run: Callable[[Study], None] | Parts,
    arguments: list[str] | None = None,
) -> int:  # fmt: skip
    """Run the command line of a study, a script in its own folder; return the exit code.

    Parameters
    ----------
    file : the script, beside which are its namelists and its page.
    description : description for `--help`.
    run : makes the study; or its parts by name, which the command line may select.
    arguments : words of the command line; None: those of the process.
    """
    place = Path(file).resolve().parent
    options = cli.Parser(
        prog=f"python -m studies.{place.name}.study", description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add_options(options, ROOT / "build" / place.name, [*run] if isinstance(run, Mapping) else ())

    @style.settings()
    def call(words: list[str] | None) -> int:
        given = options.parse_args(words)
        study = study_of(given, place, (place, ""))
        if not isinstance(run, Mapping):
            run(study)
            return 0
        for name in chosen_parts(given, [*run]):
            print(f"{name}:", flush=True)
            run[name](study)
        return 0

    return cli.run(call, arguments)

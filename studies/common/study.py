"""The folder of a study: runs are resumed or replaced, numbers, tables and pictures stored."""

from __future__ import annotations

import argparse
import csv
import json
import shutil
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
    page : folder of the page to which tables and pictures are copied; None: they are not copied.
    """

    folder: Path
    place: Path = NAMELISTS
    full: bool = False
    ranks: int = 2
    afresh: bool = False
    program: Path | None = None
    page: Path | None = None

    def pick(self, quick: float, full: float) -> float:
        """Return `full` if the study is full, else `quick`."""
        return full if self.full else quick

    def run(
        self, namelist: str | Groups, name: str, changes: Groups | None = None, *,
        alone: bool = False,
    ) -> Path:  # fmt: skip
        """Run a namelist with some keys changed; return its results file, `folder/NAME.h5`.

        The namelist is written to `folder/NAME.nml`. A complete run is not repeated, an interrupted
        one is resumed. Results of another input under that name stop the study (InputError).

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
            return running.run(
                path, folder=self.folder, ranks=1 if alone else self.ranks, overwrite=self.afresh,
                quiet=True, program=self.program, launcher=MPIRUN,
            )  # fmt: skip
        except running.RunError as problem:
            raise cli.InputError(f"{path}: exit {problem.code}: {problem}") from problem
        except cli.InputError as problem:
            if not path.with_suffix(".h5").exists():
                raise
            message = f"{problem} (of a study: --output DIR, --afresh)"
            raise cli.InputError(message) from problem

    def _groups(self, namelist: str | Groups) -> Groups:
        if isinstance(namelist, Mapping):
            return namelist
        path = cli.existing_file(self.place / f"{namelist}.nml")
        return f90nml.Parser().reads(path.read_text(encoding="utf-8"))

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

    def rows(self, name: str, rows: Sequence[Mapping[str, object]], digits: int = 5) -> Path:
        """Write rows of equal keys as a table, fractions with so many significant digits."""
        return self.table(name, list(rows[0]), [
            [f"{one:.{digits}g}" if isinstance(one, float) else str(one) for one in row.values()]
            for row in rows
        ])  # fmt: skip

    def draw(self, made: Figure, name: str) -> Path:
        """Write a picture of a page to `folder/NAME.png` and `NAME.pdf`."""
        path = style.save(made, self.folder, name)[0]
        self._publish(path)
        return path

    def _publish(self, path: Path) -> None:
        if self.page is not None:
            shutil.copyfile(path, self.page / path.name)


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


def parser(file: str, description: str | None) -> cli.Parser:
    """Return a parser for the script of a study, described by its docstring."""
    path = Path(file).resolve()
    return cli.Parser(
        prog=f"python -m studies.{path.parent.name}.{path.stem}", description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip


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
    parts = run if isinstance(run, Mapping) else {}
    options = parser(file, description)
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
        "--ranks", type=cli.allowed(int, 1), default=2, help="MPI ranks of an ensemble (default: 2)"
    )
    options.add_argument("--program", type=Path, help="default: build/bin/battery")
    options.add_argument(
        "--output", metavar="DIR", type=Path, help=f"default: build/{place.name}/quick, or full"
    )

    @style.settings()
    def call(words: list[str] | None) -> int:
        given = options.parse_args(words)
        named = given.parts if parts else []
        if wrong := [name for name in named if name not in parts]:
            raise cli.InputError(f"there is no part {wrong[0]}; allowed: {' '.join(parts)}")
        folder = given.output or ROOT / "build" / place.name / ("full" if given.full else "quick")
        study = Study(
            folder, place, given.full, given.ranks, given.afresh,
            running.find_program(given.program), place if given.publish else None,
        )  # fmt: skip
        if not parts:
            run(study)
        for name in named or parts:
            print(f"{name}:", flush=True)
            parts[name](study)
        return 0

    return cli.run(call, arguments)

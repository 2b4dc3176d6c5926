"""Writes one self-contained HTML page about a run: warnings, maps, replicas, series, table.

The page needs no network. Maps and curves show the values at the point under the mouse, in all of
them at once; a click shows the replicas of that point, their series and its namelist; the table can
be sorted.
"""

from __future__ import annotations

from pathlib import Path

from postproc import cli
from postproc.figures.models import add_models, default, named
from postproc.reading.results import Results


def main(arguments: list[str] | None = None) -> int:
    """Write FILE.html."""
    options = cli.parser("report", __doc__)
    options.add_argument("file", metavar="FILE.h5", type=Path)
    cli.add_verify(options)
    add_models(options)
    cli.add_output(options)
    given = options.parse_args(arguments)
    path = cli.file_to_write(given.output / f"{given.file.stem}.html")
    with Results(given.file, verify=given.verify) as results:
        models = named(given.model or ()) or default([results])
        page = cli.extra("report", "postproc.report.page").page
        text = page(results, {one.name: one for one in models})
        results.say_if_partial()
    cli.output_folder(given.output)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as problem:
        raise cli.InputError(f"cannot write {path}: {problem.strerror}") from problem
    print(path)
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

"""Writes one self-contained HTML page about a run: what, where, how fast, pictures, map, warnings.

The page needs no network. Its map shows the values of a cell under the mouse.
"""

from __future__ import annotations

from pathlib import Path

from postproc import cli
from postproc.figures import style
from postproc.reading.results import Results
from postproc.report.page import page


def main(arguments: list[str] | None = None) -> int:
    """Write FILE.html."""
    options = cli.parser("report", __doc__)
    options.add_argument("file", metavar="FILE.h5", type=Path)
    cli.add_output(options)
    given = options.parse_args(arguments)
    style.figure()  # sets the look
    with Results(given.file) as results:
        results.say_if_partial()
        text = page(results)
    path = cli.output_folder(given.output) / f"{given.file.stem}.html"
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as problem:
        raise cli.InputError(f"cannot write {path}: {problem.strerror}") from problem
    print(path)
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

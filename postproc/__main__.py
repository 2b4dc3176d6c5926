"""All commands as one: `battery-postproc NAME ...`, or `python -m postproc NAME ...`."""

from __future__ import annotations

import argparse
import ast
import importlib
import sys
from pathlib import Path

from postproc import __version__, cli

STARTING = ("advise",)  # commands that start the program, as postproc.run does
COMMANDS = ("advise", "film", "lifetimes", "plot", "report", "table", "theory")
PLACE = Path(__file__).resolve().parent


def main(arguments: list[str] | None = None) -> int:
    """Run the named command with the arguments that follow it."""
    options = cli.Parser(
        prog=cli.COMMAND, description=description(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    options.add_argument("--version", action="version", version=f"{cli.COMMAND} {__version__}")
    options.add_argument("name", metavar="NAME", choices=COMMANDS, help="one of these")
    words = sys.argv[1:] if arguments is None else arguments
    given = options.parse_args(words[:1])
    return importlib.import_module(f"postproc.commands.{given.name}").main(words[1:])


def description() -> str:
    """Return a line for each command: the first line of its docstring."""
    lines: dict[bool, list[str]] = {True: [], False: []}
    for name in COMMANDS:
        path = PLACE / "commands" / f"{name}.py"
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        summary = text.split("\n", 1)[0]
        lines[name in STARTING].append(f"  {name:12s} {summary}")
    return "\n".join([
        "Results, theory, figures, film and report of the program battery.",
        "", "Without the program, from results files or none:", *lines[False],
        "", "With the program, which they start (BATTERY_PROGRAM, or on the PATH):", *lines[True],
        "", "NAME --help explains one. In Python, postproc.open_results reads a results file;",
        "postproc.run starts the program.",
    ])  # fmt: skip


def run() -> int:
    """Call `main` as a command line; an error is one line and exit 2."""
    return cli.run(main)


if __name__ == "__main__":
    raise SystemExit(run())

"""Write the man page of the program from what `battery --help` says."""

from __future__ import annotations

import re
import subprocess
import sys


def main() -> int:
    """Print the page of the program that is named."""
    program = sys.argv[1]
    said = {
        option: subprocess.run(
            [program, option], check=True, text=True, stdin=subprocess.DEVNULL, capture_output=True
        ).stdout
        for option in ("--help", "--version")
    }
    sys.stdout.write(page(said["--help"], said["--version"].split()[1]))
    return 0


def page(told: str, version: str) -> str:
    """Return the page: the usage is the synopsis, the help's blocks are shown as they stand."""
    usage, purpose, rest = told.split("\n\n", 2)
    commands = usage.removeprefix("usage: ").split(", ")
    options, rest = rest.split("\n\nExit codes:\n", 1)
    codes, keys = rest.split("\n\nGroups and keys of the namelist, with their defaults:\n\n", 1)
    parts = [
        f'.TH BATTERY 1 "" "battery {version}" "User Commands"',
        ".SH NAME\nbattery \\- event-driven simulation of gated billiard urns",
        ".SH SYNOPSIS\n" + "\n.br\n".join(escaped(one) for one in commands),
        ".SH DESCRIPTION\n" + escaped(purpose),
        ".SH OPTIONS\n" + as_it_stands(options),
        ".SH EXIT STATUS\n" + as_it_stands(codes),
        ".SH NAMELIST\nGroups and keys, with their defaults.\n" + as_it_stands(keys),
        ".SH SEE ALSO\n" + escaped("battery-postproc --help lists the commands that draw results."),
    ]
    return "\n".join(parts) + "\n"


def as_it_stands(text: str) -> str:
    """Return text whose lines are kept."""
    return f".nf\n{escaped(text.rstrip())}\n.fi"


def escaped(text: str) -> str:
    """Return text without what troff would take for its own."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"^([.'])", r"\\&\1", text, flags=re.MULTILINE)


if __name__ == "__main__":
    sys.exit(main())

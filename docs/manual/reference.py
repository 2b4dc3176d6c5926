"""Generated parts of pages: the program's keys and help, datasets, and CSV files as tables.

`python reference.py` writes them into the pages, so that they can be read there.
"""

from __future__ import annotations

import csv
import json
import re
import subprocess
import tempfile
from pathlib import Path

import h5py

import postproc
from postproc.theory.models import MODELS

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "build/bin/battery"
# Between these lines of a page is a part from the program, or from a CSV file beside the page.
PART = re.compile(
    r"(<!-- ([\w.]+): written by make docs -->\n\n).*?(<!-- end of \2 -->)", re.DOTALL
)
# A run of a few particles whose results file has all datasets.
EVERYTHING = {
    "particles": {"number": 100},
    "run": {"duration": 30.0, "transient_duration": 10.0},
    "scan": {"threshold": [3]},
    "output": {
        "series_interval": 10.0, "snapshot_times": [0.0, 10.0], "event_log": True,
        "final_state": True,
    },
}  # fmt: skip
# Attributes of a results file that depend on machine, build or run.
VARYING = {"compiler", "compiler_options", "created", "git_commit", "gsl_library", "hdf5_library",
           "initial_file_fingerprint", "mpi_library", "version"}  # fmt: skip
# The allowed values begin with one of these words; before them is the meaning of the key.
TOLD = re.compile(
    r"(.*?); ((?:one (?:whole number|number|text)|whole numbers|numbers|first, last|'|\.true).*)"
)


def pages() -> list[Path]:
    """Return the pages of the site; studies may be deleted."""
    names = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/*.md", "studies/**/README.md")
    return [path for name in names for path in sorted(ROOT.glob(name))]


def filled(path: Path) -> str:
    """Return the text of a page with its generated parts as they should be."""
    text = path.read_text(encoding="utf-8")

    def part(match: re.Match[str]) -> str:
        csv_file = match[2].endswith(".csv")
        made = table(path.parent / match[2]) if csv_file else MADE[match[2]](match[0])
        return f"{match[1]}{made.strip()}\n\n{match[3]}"

    return PART.sub(part, text)


def table(path: Path) -> str:
    """Return a CSV file as a table."""
    with path.open(newline="", encoding="utf-8") as lines:
        return markdown(*csv.reader(lines))


def markdown(head: list[str], *rows: list[str]) -> str:
    """Return a table of Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))


def said(option: str) -> str:
    """Return the output of the program for an option."""
    return subprocess.run(
        [PROGRAM, option], check=True, text=True, stdin=subprocess.DEVNULL, capture_output=True
    ).stdout


def help_text(_: str) -> str:
    """Return what `--help` says, without the keys."""
    text = said("--help").split("\nGroups and keys")[0].rstrip()
    return f"```text\n{text}\n```"


def keys(before: str) -> str:
    """Return the reference of all keys, from `--schema`; the examples are those there before.

    The example of a new key is its default, until the page has a better one.
    """
    examples = {
        (group.split("\n", 1)[0], name): example
        for group in before.split("\n### &")[1:]
        for name, example in re.findall(r"#### (\w+)\n.*?(```.*?```)", group, re.DOTALL)
    }
    lines = []
    for group, entry in json.loads(said("--schema"))["properties"].items():
        lines += [f"### &{group}", ""]
        for name, key in entry["properties"].items():
            told, *more = re.split("; (unit|in the paper|default): ", key["description"])
            of = dict(zip(more[::2], more[1::2], strict=True))
            meaning, allowed = TOLD.fullmatch(told).groups()
            default = of.get("default", "")
            example = f"```fortran\n&{group}\n  {name} = {default}\n/\n```"
            lines += [f"#### {name}", "", f"{meaning[:1].upper()}{meaning[1:]}.", ""]
            row = [f"`{default}`" if default else "none", allowed, of.get("unit", "-")]
            head = ["default", "allowed", "unit", "in the paper"]
            lines += [markdown(head, [*row, of.get("in the paper", "-")]), ""]
            lines += [examples.get((group, name), example), ""]
    return "\n".join(lines)


def datasets(_: str) -> str:
    """Return the reference of all datasets and attributes of a results file."""
    parts = []
    with tempfile.TemporaryDirectory() as folder:
        output = EVERYTHING["output"] | {"file": f"{folder}/everything.h5"}
        path = postproc.run(EVERYTHING | {"output": output}, quiet=True)
        with h5py.File(path, "r") as file:
            groups: dict[str, list[list[str]]] = {}

            def keep(_: str, item: object) -> None:
                if isinstance(item, h5py.Dataset) and not _is_axis(item):
                    groups.setdefault(item.parent.name.strip("/"), []).append(_row(item))

            file.visititems(keep)
            for group, rows in groups.items():
                parts += [f"### {f'Group {group}' if group else 'Datasets'}"]
                parts += [markdown(["name", "unit", "of each", "what"], *rows)]
            rows = [
                [f"`{name}`", "" if name in VARYING else f"`{_first_line(value)}`"]
                for name, value in file.attrs.items()
                if not name.startswith("_NC")
            ]
    parts += ["### Attributes of the file", markdown(["name", "for example"], *rows)]
    return "\n\n".join(parts)


def _is_axis(item: h5py.Dataset) -> bool:
    return "without corresponding variable" in _text(item.attrs.get("NAME", ""))


def _row(item: h5py.Dataset) -> list[str]:
    axes = [axis[0].name.rsplit("/", 1)[-1] if len(axis) else axis.label for axis in item.dims]
    unit, meaning = (_text(item.attrs[one]) for one in ("units", "long_name"))
    name = item.name.rsplit("/", 1)[-1]
    return [f"`{name}`", unit, ", ".join(axes) or "-", meaning.replace("|", "\\|")]


def _text(value: object) -> str:
    if hasattr(value, "ravel"):
        value = value.ravel()[0] if value.size else ""
    return value.decode().strip() if isinstance(value, bytes) else str(value).strip()


def _first_line(value: object) -> str:
    return next(iter(_text(value).splitlines()), "")


def theories(_: str) -> str:
    """Return the table of all theories and their use."""
    head = ["`--theory`", "label", "what it is", "time per state", "also computes", "use it for"]
    return markdown(head, *(
        [f"`{one.name}`", one.label, one.meaning,
         f"{1e3 * one.seconds:g} ms" if one.seconds < 1.0 else f"{one.seconds:g} s",
         ", ".join(one.answers), one.use]
        for one in MODELS.values()
    ))  # fmt: skip


MADE = {"keys": keys, "help": help_text, "datasets": datasets, "theories": theories}


def main() -> None:
    """Write the generated parts of all pages anew where they differ."""
    for path in pages():
        text = filled(path)
        if text != path.read_text(encoding="utf-8"):
            path.write_text(text, encoding="utf-8")
            print(f"{path.relative_to(ROOT)}: its generated part was written anew")


if __name__ == "__main__":
    main()

"""The pages of the site, and the targets of their links."""

from __future__ import annotations

import csv
import os
import re
import shutil
from pathlib import Path, PurePosixPath

STUDIES = "Studies"
# Captions of the side bar, and their pages: the name in the site, and the source file.
PAGES = {
    "Start": {
        "install": "docs/install.md",
        "tutorial": "docs/tutorial.md",
        "gallery": "docs/gallery.md",
        "cookbook": "docs/cookbook.md",
        "troubleshooting": "docs/troubleshooting.md",
    },
    "Runs": {
        "runs": "docs/runs.md",
        "geometries": "docs/geometries.md",
    },
    "Reference": {
        "input": "docs/input.md",
        "output": "docs/output.md",
        "command_line": "docs/command_line.md",
        "python": "docs/python.md",
    },
    "Background": {
        "theory": "docs/theory.md",
        "accuracy": "docs/accuracy.md",
        "paper": "docs/paper.md",
        "validation": "docs/validation.md",
        "open_questions": "docs/open_questions.md",
    },
    STUDIES: {"studies": "studies/README.md"},  # and one for each folder of studies
    "Developers": {
        "contributing": "CONTRIBUTING.md",
        "development": "docs/development.md",
        "internals": "docs/internals.md",
        "questions": "docs/questions.md",
        "changes": "CHANGELOG.md",
    },
}
LINK = re.compile(r"(!?\[[^\]]*\]\()([^)\s]+)(\))")
CODE = re.compile(r"```.*?^ *``` *$|`[^`\n]+`", re.MULTILINE | re.DOTALL)
# Between these lines of a page is a generated part, from lists of the program or from a CSV file
# beside the page: as Markdown, so that it can be read in the page itself.
MADE = re.compile(
    r"(<!-- ([\w.]+): written by make docs -->\n\n).*?(<!-- end of \2 -->)", re.DOTALL
)
PATH = re.compile(r"`((?:src|app|postproc|test|docs|namelists|studies)/[\w./-]+\w)(?::\d+)?`")


def pages(root: Path) -> dict[str, str]:
    """Return the name of each page that exists, and its source file."""
    found = {"index": "README.md"}
    for part in parts(root).values():
        found |= {name: file for name, file in part.items() if (root / file).exists()}
    return found


def parts(root: Path) -> dict[str, dict[str, str]]:
    """Return `PAGES` with the pages of the existing studies."""
    studies = sorted((root / "studies").glob("*/README.md"))
    found = {f"study_{path.parent.name}": str(path.relative_to(root)) for path in studies}
    return PAGES | {STUDIES: PAGES[STUDIES] | found}


def tables(root: Path, file: str, text: str) -> dict[str, str]:
    """Return the tables of a page as Markdown, by the names of the CSV files beside it."""
    made = {}
    for name in (match[2] for match in MADE.finditer(text) if match[2].endswith(".csv")):
        with ((root / file).parent / name).open(newline="", encoding="utf-8") as lines:
            head, *rows = csv.reader(lines)
        shown = [head, ["---"] * len(head), *rows]
        made[name] = "\n".join(f"| {' | '.join(row)} |" for row in shown)
    return made


def filled(text: str, made: dict[str, str]) -> str:
    """Return the text of a page with its generated parts, those of `made`, as they should be."""

    def part(match: re.Match[str]) -> str:
        if match[2] not in made:
            return match[0]
        return f"{match[1]}{made[match[2]].rstrip()}\n\n{match[3]}"

    return MADE.sub(part, text)


def contents(root: Path, api: dict[str, list[str]], there: dict[str, str]) -> str:
    """Return the lists of the side bar."""
    found = {caption: [name for name in part if name in there]
             for caption, part in parts(root).items()}  # fmt: skip
    lines = []
    for caption, names in (found | api).items():
        if not names:
            continue  # studies may be deleted
        lines += ["", "```{toctree}", ":hidden:", f":caption: {caption}", "", *names, "```"]
    return "\n".join(lines) + "\n"


def linked(root: Path, source: Path, file: str, text: str) -> tuple[str, list[str]]:
    """Return a page with its links changed to the site's, and the links that are broken.

    A link to a file of the checkout that is not a page is changed to a copy of the file. Where the
    folder of studies is deleted, links to it become their text.
    """
    gone = () if (root / "studies").is_dir() else ("studies/",)
    names = {place: name for name, place in pages(root).items()}
    problems = []

    def moved(match: re.Match[str]) -> str:
        target, _, anchor = match[2].partition("#")
        if not target or re.match(r"https?:|mailto:", target):
            return match[0]
        place = os.path.normpath(PurePosixPath(file).parent / target)
        if place in names:
            return f"{match[1]}{names[place]}.md{'#' + anchor if anchor else ''}{match[3]}"
        if place.startswith(gone):
            return match[1].removeprefix("!")[1:-2]
        if not (root / place).is_file():
            problems.append(f"{file}: the link to {match[2]} leads nowhere")
            return match[0]
        name = PurePosixPath("files" if not match[1].startswith("!") else "pictures") / place
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / place, source / name)
        return f"{match[1]}{name}{match[3]}"

    problems += [
        f"{file}: there is no {match[1]}"
        for match in PATH.finditer(_prose(text))
        if not ((root / match[1]).exists() or match[1].startswith(gone))
    ]
    return _outside_code(text, lambda part: LINK.sub(moved, part)), problems


def _prose(text: str) -> str:
    return re.sub(r"^ *```.*?^ *``` *$", "", text, flags=re.MULTILINE | re.DOTALL)


def _outside_code(text: str, change: object) -> str:
    """Change what is not code."""
    found, end = [], 0
    for match in CODE.finditer(text):
        found += [change(text[end : match.start()]), match[0]]
        end = match.end()
    return "".join([*found, change(text[end:])])

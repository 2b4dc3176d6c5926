"""Measured numbers of the pages: each section with such numbers must name their source.

A measured number has a decimal point, an exponent, a per cent sign, a unit of time or memory, or an
error. Numbers in code or in formulas, and values of a name (`w = 0.3`), are not counted. The source
of the numbers in a section is a command, a file, or a link to a page or file. The source of a
section is also that of its parts, and the introduction of a page is the source for the whole page
if it contains the words "numbers below".
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from manual.fences import FENCE, FIRST

if TYPE_CHECKING:
    from pathlib import Path

HEADING = re.compile(r"^(#+) (.*)$", re.MULTILINE)
UNITS = r"(?:%|s|ms|µs|ns|min|minutes?|seconds?|hours?|[KMG]i?B|bytes)(?!\w)"
NUMBER = re.compile(
    r"(?<![\w.=/^-])(?<!= )(?<!= -)\d[\d,]*"
    rf"(?:\.\d+(?!\.?\d)(?:e-?\d+)?|e-?\d+| ?{UNITS}| (?:±|\+-) ?\d)"
)
SPAN = re.compile(r"`+([^`]+)`+")
LINK = re.compile(r"(?<!!)\[[^\]]*\]\((?!https?:)[^)\s]+\)")
FORMULA = re.compile(r"\$[^$\n]+\$")
# Prefixes of a span of code, and the folder of the file that it names.
COMMANDS = (
    (re.compile(r"make (\w+)"), "Makefile", r"^{}:"),
    (re.compile(r"(?:build/bin/)?(battery) [-\w]"), "app/{}.f90", ""),
    (re.compile(r"(?:python -m )?postproc\.(\w+)"), "postproc/{}.py", ""),
    (re.compile(r"(?:python -m )?studies\.(\w+)"), "studies/{}/study.py", ""),
    (re.compile(r"(?:python -m )?attack\.(\w+)"), "test/attack/{}.py", ""),
    (re.compile(r"(?:build/bin/)?bench (\w+)"), "app/bench_tables.f90", "'{}'"),
)
FILE = re.compile(r"[\w./-]+\.(?:py|pf|nml|json|h5|f90|c|txt)\b")
PLACES = ("", "docs/", "test/", "src/", "postproc/")


@dataclass
class Section:
    """A section of a page, without its subsections."""

    level: int
    title: str
    line: int
    text: str


def unsourced(root: Path, page: str, text: str) -> list[str]:
    """Return the sections of a page that have measured numbers without a source.

    Parameters
    ----------
    root : the checkout.
    page : the file of the page, as messages name it.
    text : all of it.
    """
    found, sourced = [], {}
    sections = list(_sections(text))
    first = sections[0].text if sections else ""
    whole = re.search(r"numbers?\s+below", first, re.IGNORECASE) and _has_source(root, first)
    for one in sections:
        sourced = {level: has for level, has in sourced.items() if level < one.level}
        # The text under the title of a page is no source of its sections.
        above = any(has for level, has in sourced.items() if level > 1)
        sourced[one.level] = _has_source(root, one.text)
        numbers = measured(one.text)
        if numbers and not (whole or above or sourced[one.level]):
            found.append(f"{page}:{one.line}: '{one.title}' has numbers ({', '.join(numbers[:3])}) "
                         "and names no command or file that they come from")  # fmt: skip
    return found


def measured(text: str) -> list[str]:
    """Return the measured numbers of a text, as they are written."""
    plain = FORMULA.sub(" ", SPAN.sub(" ", FENCE.sub("", text)))
    plain = re.sub(r"\]\([^)]*\)", "]", plain)
    return [match[0] for match in NUMBER.finditer(plain)]


def _sections(text: str) -> list[Section]:
    """Return the sections of a page in their order; a number sign in code is no heading."""
    blank = FENCE.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    marks = list(HEADING.finditer(blank))
    ends = [*(mark.start() for mark in marks[1:]), len(text)]
    return [
        Section(len(mark[1]), mark[2], text.count("\n", 0, mark.start()) + 1,
                text[mark.end() : end])
        for mark, end in zip(marks, ends, strict=True)
    ]  # fmt: skip


def _has_source(root: Path, text: str) -> bool:
    """Tell whether a text contains a command, an existing file, or a link."""
    for match in FENCE.finditer(text):
        words = match[2].split()
        if FIRST.match(match[3]) or {"run", "check"} & set(words):
            return True
    prose = FENCE.sub("", text)
    return bool(LINK.search(prose)) or any(_names(root, span) for span in SPAN.findall(prose))


def _names(root: Path, span: str) -> bool:
    """Tell whether a span names a command or a file of the checkout."""
    for pattern, place, inside in COMMANDS:
        if match := pattern.search(span):
            path = root / place.format(match[1])
            there = path.is_file()
            return there and (not inside or bool(
                re.search(inside.format(match[1]), path.read_text(), re.MULTILINE)))  # fmt: skip
    match = FILE.search(span)
    return bool(match) and any((root / place / match[0]).is_file() for place in PLACES)

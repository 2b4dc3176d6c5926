"""Small faults in single lines of Fortran: a sign, a comparison, an index, a constant changed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from support.program import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

#: The layers whose lines are changed.
LAYERS = ("table", "gate", "events", "engine", "observe")

#: What may stand in place of what; words are whole words of code, outside of texts and comments.
SWAPS = [
    (r"(?<= )\+(?= )", "-"),
    (r"(?<= )-(?= )", "+"),
    (r"(?<=[(=,] )-(?=\w)|(?<=\()-(?=\w)", ""),
    (r"(?<= )<(?= )", "<="),
    (r"(?<= )<=(?= )", "<"),
    (r"(?<= )>(?= )", ">="),
    (r"(?<= )>=(?= )", ">"),
    (r"(?<= )==(?= )", "/="),
    (r"(?<= )/=(?= )", "=="),
    (r"\.and\.", ".or."),
    (r"\.or\.", ".and."),
    (r"\.not\. ", ""),
    (r"\.true\.", ".false."),
    (r"\.false\.", ".true."),
    (r"\bmin(?=\()", "max"),
    (r"\bmax(?=\()", "min"),
    (r"\bchannel1\b", "channel2"),
    (r"\bchannel2\b", "channel1"),
    (r"\bin_gate\b", "in_channel2"),
    (r"\bin_channel2\b", "in_gate"),
    (r"(?<![\w.])1(?![\w.])", "2"),
    (r"(?<![\w.])2(?![\w.])", "1"),
    (r"(?<![\w.])0\.5(?=_wp)", "0.25"),
    (r"(?<![\w.])0\.25(?=_wp)", "0.5"),
    (r"(?<![\w.])2\.0(?=_wp)", "1.0"),
    # The kind alone counts in huge(1.0_wp) and its like.
    (r"(?<![\w.])(?<!huge\()(?<!tiny\()(?<!epsilon\()1\.0(?=_wp)", "0.5"),
]


@dataclass(frozen=True)
class Mutation:
    """A line of a file, and what is to stand in its place."""

    file: str
    #: Counted from 1.
    number: int
    line: str
    changed: str

    @property
    def place(self) -> str:
        """File and line, as compilers write it."""
        return f"{self.file}:{self.number}"

    @property
    def change(self) -> str:
        """Both lines, one after the other."""
        return f"{self.line.strip()}  ->  {self.changed.strip()}"


def sources() -> list[Path]:
    """List the files whose lines are changed."""
    return [path for layer in LAYERS for path in sorted((ROOT / "src" / layer).rglob("*.f90"))]


def code_of(line: str) -> str:
    """Blank out texts and comments, and leave every other character in its place."""
    line = re.sub(r"'[^']*'", lambda text: " " * len(text[0]), line)
    return re.sub(r"!.*", lambda text: " " * len(text[0]), line)


def statements(path: Path) -> Iterator[tuple[int, str]]:
    """Give number and text of each line that is executed: no declarations, no headers."""
    declared = True
    within = False
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        code = code_of(line).strip()
        if not within and (
            re.match(r"(pure |elemental |recursive )*(subroutine|function)\b", code)
            or "::" in code
            or code.startswith(("use ", "end ", "type("))
        ):
            skipped = True
        elif not within:
            skipped = False
        within = code.endswith("&")
        declared = declared and code != "contains"
        if code and not declared and not skipped:
            yield number, line


def mutations_of(line: str) -> Iterator[str]:
    """Give every line that differs by one swap."""
    code = code_of(line)
    for pattern, other in SWAPS:
        for found in re.finditer(pattern, code):
            yield line[: found.start()] + other + line[found.end() :]


def mutations(path: Path, only: int | None = None) -> list[Mutation]:
    """List all mutations of a file, or of one of its lines."""
    file = str(path.relative_to(ROOT))
    return [
        Mutation(file, number, line, changed)
        for number, line in statements(path)
        if only in (None, number)
        for changed in mutations_of(line)
    ]

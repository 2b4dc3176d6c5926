"""Numbers in words, for tables of pages."""

from __future__ import annotations

import math
import re
import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with so many significant digits, large and small ones as 1.2e6."""
    if value is None or not math.isfinite(value):
        return "-"
    if value == 0.0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        places = digits - 1 - math.floor(math.log10(abs(value)))
        return f"{round(value, places):.{max(0, places)}f}"
    base, exponent = f"{value:.{max(0, digits - 1)}e}".split("e")
    return f"{base}e{int(exponent)}"


def measured(value: float | None, error: float | None) -> str:
    """Return value +- error, to two digits of the error."""
    if value is None or error is None or not error > 0.0:
        return number(value, 5)
    places = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{places}f} +- {error:.{places}f}"


def percent(value: float | None, digits: int = 2) -> str:
    """Return a ratio in per cent."""
    return "-" if value is None else f"{number(100.0 * value, digits)} %"


def seconds(value: float | None) -> str:
    """Return a time in the unit that fits: us, ms, s."""
    if value is None:
        return "-"
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if value >= size:
            return f"{number(value / size, 2)} {unit}"
    return f"{number(value / 1e-6, 2)} us"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def wrapped(page: str, width: int = 118) -> str:
    """Return Markdown with its prose in lines of at most `width`; tables and code as they are.

    A paragraph may be written in lines of any length. No line is made to begin like an item.
    """
    made: list[str] = []
    for block in re.split(r"(\n\s*\n|^```.*?^```$)", page, flags=re.MULTILINE | re.DOTALL):
        if block.startswith("```") or not block.strip():
            made.append(block)
            continue
        items = re.split(r"\n(?=[-*] |\d+\. |[|#!<]|\$\$)", block)
        made.append("\n".join(_wrapped(item, width) for item in items))
    return "".join(made)


def _wrapped(item: str, width: int) -> str:
    if item.lstrip("\n").startswith(("|", "#", "!", "<", "$$")):
        return item
    before = item[: len(item) - len(item.lstrip("\n"))]
    after = item[len(item.rstrip("\n")) :]
    words = " ".join(item.split())
    mark = re.match(r"[-*] |\d+\. ", words)
    # What would begin an item, were it first in a line, stays with the word before it.
    words = re.sub(r"(?<=\S) (?=(?:[-+*]|\d+[.)]|#+) )", "\0", words[len(mark[0]) if mark else 0 :])
    lines = textwrap.fill(
        words, width, initial_indent=mark[0] if mark else "",
        subsequent_indent=" " * len(mark[0]) if mark else "",
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
    return before + lines.replace("\0", " ") + after

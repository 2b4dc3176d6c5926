"""Public names of the modules of src: the `!>` lines and the declarations in their sources."""

from __future__ import annotations

import re
import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

MODULE = re.compile(r"((?:^!>.*\n)*)^module (\w+)\n", re.MULTILINE)
# A type or generic name, to its end; a procedure, to its first empty line; a constant.
DECLARATIONS = (
    r"  (?:type\b(?!\()[^:\n]*:: |interface ){name}\n(?:.*\n)*?  end (?:type|interface).*",
    r" {{2,4}}(?:\w[\w()=, ]* )?(?:subroutine|function) {name}\(.*(?:\n.+)*",
    r"  (?!public|use)\w[^!\n]*:: (?:.*\W)?{name}\b.*",
)


class UnexplainedError(ValueError):
    """A module or a public name has no `!>` lines."""


def page(layer: str, meaning: str, folder: Path) -> str:
    """Return the page of a layer; `folder` has its modules."""
    modules = [module(path) for path in sorted((folder / layer).rglob("*.[fF]90"))]
    return "\n\n".join([f"# Fortran: {layer}", f"{meaning.capitalize()}.", *filter(None, modules)])


def module(path: Path) -> str:
    """Return the section of a file's module: its explanation, and each public name with its own.

    Raises `UnexplainedError` if a module, procedure or type has none.
    """
    text = re.sub(r" *&\n *&? *", " ", path.read_text(encoding="utf-8"))
    if not (head := MODULE.search(text)):
        return ""
    names = re.findall(r"\w+", " ".join(re.findall(r"^  public :: (.*)", text, re.MULTILINE)))
    if not head[1]:
        raise UnexplainedError(f"{path}: {head[2]}")
    together: dict[str, list[str]] = {}
    for name in names:
        together.setdefault(_told(path, text, name), []).append(name)
    parts = [f"### {', '.join(those)}\n\n{told}" for told, those in together.items()]
    place = f"`src/{path.as_posix().rpartition('/src/')[2]}`"
    return "\n\n".join([f"## {head[2]}", place, plain(head[1]), *parts])


def plain(notes: str) -> str:
    """Return the text of `!>` lines."""
    return re.sub(r"^ *!> ?", "", notes, flags=re.MULTILINE).strip()


def _told(path: Path, text: str, name: str) -> str:
    """Return what a public name is, and its declaration with its arguments."""
    for kind in DECLARATIONS:
        pattern = rf"((?:^ *!>.*\n)*)^({kind.format(name=name)})$"
        if found := re.search(pattern, text, re.MULTILINE):
            break
    else:
        used = rf"^  use(?:, intrinsic ::)? (\w+), only: .*\b{name}\b"
        return f"From `{re.search(used, text, re.MULTILINE)[1]}`."
    note, (first, *lines) = found[1], found[2].splitlines()
    if not note and kind != DECLARATIONS[-1]:
        raise UnexplainedError(f"{path}: {name}")
    if kind == DECLARATIONS[1]:
        result = re.search(r"result\((\w+)\)", first)
        argument = rf"!>|intent\(|^ *procedure\(|:: {result[1] if result else name}\b"
        lines = [line for line in lines if re.search(argument, line)]
    shown = textwrap.dedent("\n".join([first, *lines]))
    return f"{plain(note)}\n\n```fortran\n{shown}\n```"

"""Public names of the modules of src, read from their sources and the `!>` lines in them."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

START = re.compile(r"^ {2,4}((?:\w[\w()=]* )*?)(subroutine|function) (\w+)\((.*?)\)(.*)$")
TYPE = re.compile(r"^  type\b(?!\()(.*?):: (\w+)")
DECLARED = re.compile(r"^ +(\w.*?) :: (.*)$")


@dataclass
class Name:
    """One public name: its kind, declaration, explanation, and its parts.

    Attributes
    ----------
    parts : arguments or components, each as declaration, names and explanation.
    """

    name: str
    kind: str
    declared: str
    note: str
    parts: list[tuple[str, str, str]] = field(default_factory=list)


@dataclass
class Module:
    """A module: its file, its explanation, and its public names in their order."""

    name: str
    path: Path
    note: str
    names: list[Name]


def statements(text: str) -> list[tuple[str, str]]:
    """Return each statement, its lines joined, with the `!>` lines right before it."""
    found, notes = [], []
    for line in re.sub(r" *&\n *&? *", " ", text).splitlines():
        if line.lstrip().startswith("!>"):
            notes.append(line.split("!>", 1)[1].removeprefix(" "))
        else:
            found.append((line, "\n".join(notes)))
            notes = []
    return found


def names_of(declared: str) -> list[str]:
    """Return the names of a list of declared things, without shapes and values."""
    bare = declared
    while re.search(r"\([^()]*\)|\[[^\[\]]*\]", bare):
        bare = re.sub(r"\([^()]*\)|\[[^\[\]]*\]", "", bare)
    bare = re.sub(r"'[^']*'", "", bare)
    words = (re.match(r" *(\w+)", one) for one in bare.split(","))
    return [word[1] for word in words if word]


def read_module(path: Path) -> Module | None:
    """Return the module of a file; None if it has none."""
    lines = statements(path.read_text(encoding="utf-8"))
    at = next((at for at, (line, _) in enumerate(lines) if re.match(r"module \w+$", line)), None)
    if at is None:
        return None
    public = [
        name
        for line, _ in lines[at:]
        if re.match(r"  public ::", line)
        for name in re.findall(r"\w+", line.split("::")[1])
    ]
    found: dict[str, Name] = {}
    for name in _all_names(lines[at + 1 :]):
        found.setdefault(name.name, name)
    for name, source in _used(lines[at + 1 :]):
        found.setdefault(name, Name(name, "constant", f"use {source}, only: {name}", ""))
    shown = [found.get(name, Name(name, "name", name, "")) for name in public]
    return Module(lines[at][0].split()[1], path, lines[at][1], shown)


def _used(lines: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the names that come from other modules, each with its module."""
    found = []
    for line, _ in lines:
        if match := re.match(r"  use(?:, intrinsic ::)? (\w+), only: (.*)", line):
            found += [(name, match[1]) for name in re.findall(r"\w+(?! *=>)", match[2])]
    return found


def _all_names(lines: list[tuple[str, str]]) -> list[Name]:
    found: list[Name] = []
    here: Name | None = None
    wanted: list[str] = []
    for line, note in lines:
        if re.match(r" +end (type|subroutine|function|interface)", line):
            here = None
        elif match := TYPE.match(line):
            here = Name(match[2], "type", line.strip(), note)
            found.append(here)
        elif match := START.match(line):
            here = Name(match[3], match[2], line.strip(), note)
            wanted = re.findall(r"\w+", match[4]) + re.findall(r"result\((\w+)\)", match[5])
            found.append(here)
        elif match := re.match(r"  interface (\w+)", line):
            here = Name(match[1], "generic", line.strip(), note)
            found.append(here)
        elif here is None:
            found += _constants(line, note)
        else:
            _add_part(here, line, note, wanted)
    return found


def _constants(line: str, note: str) -> list[Name]:
    match = DECLARED.match(line)
    if not match or not re.match(r"  \w", line) or line.startswith("  public"):
        return []
    return [Name(name, "constant", line.strip(), note) for name in names_of(match[2])]


def _add_part(here: Name, line: str, note: str, wanted: list[str]) -> None:
    match = DECLARED.match(line)
    if not match or not re.match(r" {4,6}\w", line):
        return
    kind, declared = match[1], re.sub(r" +!.*$", "", match[2])
    if here.kind in ("subroutine", "function"):
        names = [name for name in names_of(declared) if name in wanted]
        if names:
            here.parts.append((kind, ", ".join(names), note))
    else:
        here.parts.append((kind, declared, note))


def unexplained(module: Module) -> list[str]:
    """Return the public names of a module that have no explanation."""
    missing = [] if module.note else [f"{module.path}: {module.name}"]
    missing += [
        f"{module.path}: {one.name}"
        for one in module.names
        if not one.note and one.kind != "constant"
    ]
    return missing


def page(layer: str, meaning: str, modules: list[Module]) -> str:
    """Return the page of a layer."""
    lines = [f"# Fortran: {layer}", "", f"{meaning.capitalize()}.", ""]
    for module in modules:
        lines += [f"## {module.name}", "", f"`{module.path.as_posix()}`", "", module.note, ""]
        shown: set[str] = set()
        for name in module.names:
            if name.declared in shown:
                continue
            shown.add(name.declared)
            together = [one.name for one in module.names if one.declared == name.declared]
            lines += [f"### {', '.join(together)}", "", "```fortran", name.declared, "```", ""]
            lines += [name.note, ""]
            lines += [_part(*part) for part in name.parts] + [""]
    return "\n".join(lines)


def _part(kind: str, declared: str, note: str) -> str:
    explanation = f": {' '.join(note.split())}" if note else ""
    return f"- `{declared}` ({_code(kind)}){explanation}"


def _code(text: str) -> str:
    return f"`{text}`"

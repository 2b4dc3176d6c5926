"""Public procedures of src are explained, each of their arguments, too."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[1]
LAYERS = [f"src/{path.name}" for path in sorted((SOURCES / "src").iterdir()) if path.is_dir()]
START = re.compile(r"^  (?:\w[\w()=]* )*?(?:subroutine|function) (\w+)\((.*?)\)", re.MULTILINE)


def statements(text: str) -> list[tuple[str, str]]:
    """Return each statement, its lines joined, with the `!>` lines right before it."""
    found, note = [], ""
    for line in re.sub(r" *&\n *", " ", text).splitlines():
        if line.lstrip().startswith("!>"):
            note += line.split("!>", 1)[1]
        else:
            found.append((line, note))
            note = ""
    return found


def generic_notes(lines: list[tuple[str, str]]) -> dict[str, str]:
    """Return, for each procedure behind a generic name, the `!>` lines of that name."""
    found, above = {}, ""
    for line, note in lines:
        above = note if re.match(r"  interface \w", line) else above
        match = re.match(r"    module procedure :: (.*)", line)
        match = match or re.match(r"    generic :: \w+ => (.*)", line)
        for name in re.findall(r"\w+", match[1]) if match else []:
            found[name] = above if "module" in line else note
    return found


def unexplained(path: Path) -> list[str]:
    """Return what of a file is public and not explained.

    A dummy is explained by `!>` lines before its declaration, by its `name` in those of the
    procedure or of the generic name it goes by, or by its type: the object of a procedure bound
    to it, or one that is named for it (`plan` of `plan_type`).
    """
    lines = statements(path.read_text(encoding="utf-8"))
    public = {name for line, _ in lines if re.match(r"  public ::|    procedure ::", line)
              for name in re.findall(r"\w+", line.split("::")[1])}
    notes = generic_notes(lines)
    missing, name, dummies, head = [], "", [], ""
    for line, note in lines:
        if match := START.match(line):
            name, head = match[1], note + notes.get(match[1], "")
            is_public = name in public or name in notes
            dummies = re.findall(r"\w+", match[2]) if is_public else []
            missing += [name] if is_public and not head else []
        elif dummies and re.match(r"    \w.* :: ", line):
            kind, declared = line.split(" :: ", 1)
            for one in re.findall(r"\w+", re.sub(r"\(.*?\)", "", declared)):
                known = note or f"`{one}`" in head or re.search(rf"class\(|\({one}_type\)", kind)
                if one in dummies and not known:
                    missing.append(f"{name}: {one}")
    return [f"{path.relative_to(SOURCES)}: {one}" for one in missing]


@pytest.mark.parametrize("layer", LAYERS)
def test_public_procedures_and_their_arguments_are_explained(layer: str) -> None:
    files = sorted((SOURCES / layer).rglob("*.f90"))
    assert files
    assert [one for path in files for one in unexplained(path)] == []


@pytest.mark.parametrize("layer", LAYERS)
def test_public_types_are_explained(layer: str) -> None:
    for path in sorted((SOURCES / layer).rglob("*.f90")):
        bare = [line for line, note in statements(path.read_text(encoding="utf-8"))
                if re.match(r"  type\b.*::", line) and not note]
        assert bare == [], path

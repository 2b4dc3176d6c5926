"""docs/paper.md: each row names a command that the page explains."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs/paper.md").read_text(encoding="utf-8")
STUDY = (Path(__file__).parent / "study.py").read_text(encoding="utf-8")


def test_every_statement_has_a_command_that_the_page_has() -> None:
    """A named part of the study must exist."""
    heads = "| statement | found | verdict | command |"
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in TEXT.splitlines()
            if line.startswith("| ") and line != heads and "| ---" not in line]  # fmt: skip
    assert len(rows) >= 20
    commands = TEXT[TEXT.index("## Commands") : TEXT.index("## The model")]
    for _, found, verdict, command in rows:
        assert verdict.strip(), found
        for name in re.findall(r"`([^`]+)`", command) or ["see left"]:
            if name.startswith("study "):
                assert f"def {name.split()[1]}(" in STUDY, name
            elif name == "see left":
                assert "build/bin/" in found
            else:
                assert f"`{name}`" in commands, name
    for part in re.findall(r"`study ([a-z_]+)`", TEXT):
        assert f"def {part}(" in STUDY, part

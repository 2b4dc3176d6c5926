"""Modules of the product that a study may use: few, so that the others may change."""

from __future__ import annotations

import ast
import re
from pathlib import Path

HERE = Path(__file__).parent
# `import postproc` is for public names
DOORS = ("postproc.circuits", "postproc.figures.style")
# theories that these compare with runs, and rungs of the ladder
WHOLE = (
    "postproc.cli",
    "postproc.launcher",
    "postproc.reading",
    "postproc.running",
    "postproc.theory",
)
MORE = {
    "accuracy": ("postproc.advice", *WHOLE),
    "common": ("postproc.advice", *WHOLE),
    "one_particle": ("postproc.progress", *WHOLE),
    "renewal_gate": WHOLE,
    "speed": WHOLE,
    "circulation": ("postproc.theory",),
    "experiments": ("postproc.advice.transients", "postproc.theory"),
    "narrow_channels": ("postproc.theory",),
    "one_channel": ("postproc.theory",),
    "paper_statements": ("postproc.theory",),
}


def used(path: Path) -> set[str]:
    """Return the names of `postproc` that a file imports, those from packages in full."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {one.name for one in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{one.name}" for one in node.names}
    return {name for name in found if name.startswith("postproc.")}


def test_studies_use_the_doors_of_the_product() -> None:
    for path in HERE.rglob("*.py"):
        if path.name.startswith("test_") or path.name in ("conftest.py", "probing.py"):
            continue
        doors = (*DOORS, *MORE.get(path.relative_to(HERE).parts[0], ()))
        ways = tuple(f"{one}." for one in doors)
        assert [name for name in used(path) if not f"{name}.".startswith(ways)] == [], path


def test_every_study_has_a_script_and_a_page() -> None:
    for path in HERE.glob("*/"):
        if path.name != "common" and any(path.glob("*.py")):
            assert (path / "study.py").is_file(), path
            assert (path / "README.md").is_file(), path


def test_no_study_knows_another() -> None:
    """What two of them need is in studies/common."""
    for path in HERE.rglob("*.py"):
        own = path.relative_to(HERE).parts[0]
        known = re.findall(r"^\s*(?:from|import) studies\.(\w+)", path.read_text(), re.MULTILINE)
        assert set(known) <= {own, "common"}, path
        assert not re.search(r"^\s*from studies import", path.read_text(), re.MULTILINE), path

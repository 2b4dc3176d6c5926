"""Modules of the product that a study may use: few, so that the others may change."""

from __future__ import annotations

import ast
from pathlib import Path

HERE = Path(__file__).parent
# `import postproc` is for open_results; `from postproc import study` for Study
DOORS = ("postproc.study", "postproc.figures.style")
# theories that these compare with runs, and rungs of the ladder
MORE = {
    "circulation": ("postproc.theory",),
    "common": ("postproc.theory",),
    "circulation_and_densities": ("postproc.theory",),
    "entropy_production": ("postproc.theory",),
    "experiments": ("postproc.accuracy.predictions", "postproc.theory"),
    "fluctuations": ("postproc.theory",),
    "narrow_channels": ("postproc.theory",),
    "one_particle": (
        "postproc.cli", "postproc.progress", "postproc.reading", "postproc.theory",
    ),
    "order_of_transition": ("postproc.theory",),
    "paper_statements": ("postproc.theory",),
    "where_models_fail": ("postproc.accuracy", "postproc.theory"),
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
        if path.name.startswith("test_") or path.name == "conftest.py":
            continue
        doors = (*DOORS, *MORE.get(path.relative_to(HERE).parts[0], ()))
        ways = tuple(f"{one}." for one in doors)
        assert [name for name in used(path) if not f"{name}.".startswith(ways)] == [], path


def test_every_study_has_a_script_and_a_page() -> None:
    for path in HERE.glob("*/"):
        if path.name != "common" and any(path.glob("*.py")):
            assert (path / "study.py").is_file(), path
            assert (path / "README.md").is_file(), path

"""No layer uses one below it in docs/layers.txt, and no two modules use each other."""

from __future__ import annotations

import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
USE = re.compile(r"^\s*use\s*(?:,\s*non_intrinsic\s*)?(?:::)?\s*(\w+)", re.MULTILINE)
UNIT = re.compile(r"^\s*(module|submodule)\s*(?:\((.*)\))?\s*(\w+)\s*$", re.MULTILINE)


def order_of(tree: str) -> list[str]:
    """Return the layers of `src` or `postproc`, as docs/layers.txt lists them."""
    text = (ROOT / "docs/layers.txt").read_text(encoding="utf-8")
    found = re.search(rf"^{tree}\n((?:  .*\n)+)", text, re.MULTILINE)
    return [line.split()[0] for line in found[1].splitlines()]


def fortran() -> tuple[dict[str, str], dict[str, set[str]]]:
    """Return the layer of each module of src, and the modules that it uses."""
    layers, uses = {}, {}
    for path in sorted((ROOT / "src").rglob("*.[fF]90")):
        text = path.read_text(encoding="utf-8").lower()
        for kind, parent, name in UNIT.findall(text):
            layers[name] = path.relative_to(ROOT / "src").parts[0]
            uses[name] = set(USE.findall(text)) | ({parent.split(":")[0]} if parent else set())
            assert kind == "submodule" or not parent
    return layers, {name: {one for one in used if one in layers} for name, used in uses.items()}


def python() -> tuple[dict[str, str], dict[str, set[str]]]:
    """Return the layer of each module of postproc, its tests left out, and what it imports."""
    files = [path.relative_to(ROOT) for path in sorted((ROOT / "postproc").rglob("*.py"))]
    files = [path for path in files if path.parts[1] not in ("tests", "__init__.py")]
    names = {".".join(path.with_suffix("").parts).removesuffix(".__init__"): path for path in files}
    layers, uses = {}, {}
    for name, path in names.items():
        inner = path.parts[1] if len(path.parts) > 2 and path.stem != "__main__" else path.stem
        layers[name] = inner if inner in order_of("postproc") else "commands"
        uses[name] = {one for one in imported(path) if one in names}
    return layers, uses


def imported(path: Path) -> set[str]:
    """Return every module that a file may import, names imported from packages among them."""
    found = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {one.name for one in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {node.module, *(f"{node.module}.{one.name}" for one in node.names)}
    return found


TREES = {"src": fortran, "postproc": python}


@pytest.mark.parametrize("tree", TREES)
def test_no_arrow_points_upwards(tree: str) -> None:
    layers, uses = TREES[tree]()
    order = order_of(tree)
    assert set(layers.values()) <= set(order)
    arrows = [(name, one) for name, used in uses.items() for one in used]
    places = {name: order.index(layer) for name, layer in layers.items()}
    assert [f"{one} -> {other}" for one, other in arrows if places[other] > places[one]] == []


def test_mpi_and_hdf5_have_one_layer_each() -> None:
    for path in (ROOT / "src").rglob("*.[fF]90"):
        used = set(USE.findall(path.read_text(encoding="utf-8").lower()))
        assert path.stem == "communicator" or not used & {"mpi", "mpi_f08"}, path
        assert path.parent.name == "store" or not used & {"hdf5", "h5ds"}, path


def test_nothing_knows_a_study() -> None:
    """A folder of studies may be deleted without a trace in the product."""
    names = "|".join(path.name for path in (ROOT / "studies").glob("*/"))
    named = rf"\bstudies[./]({names or 'x'})\b"
    known = re.compile(rf"{named}|^\s*(from|import) studies\b", re.MULTILINE)
    kinds = {".f90", ".F90", ".pf", ".c", ".py", ".txt", ".nml", ".csv", ".json"}
    folders = ("src", "app", "test", "namelists", "postproc", "packaging")
    paths = [path for name in folders for path in (ROOT / name).rglob("*") if path.suffix in kinds]
    for path in [*paths, *(ROOT / name for name in ("test/run", "Makefile", "fpm.toml"))]:
        assert not known.search(path.read_text(encoding="utf-8")), path


@pytest.mark.parametrize("tree", TREES)
def test_no_modules_know_each_other(tree: str) -> None:
    _, uses = TREES[tree]()
    assert len(uses) > 30
    try:
        TopologicalSorter(uses).prepare()
    except CycleError as error:
        pytest.fail(f"a circle: {' -> '.join(reversed(error.args[1]))}")

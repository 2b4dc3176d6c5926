"""Public names of the modules of postproc, read from their sources and docstrings."""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

Named = ast.FunctionDef | ast.ClassDef


def public(body: list[ast.stmt]) -> Iterator[Named]:
    """Yield the public functions and classes of a body."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node


def unexplained(path: Path) -> list[str]:
    """Return the public names of a file that have no docstring."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    missing = [] if ast.get_docstring(tree) else [str(path)]
    for node in public(tree.body):
        inner = [node, *(public(node.body) if isinstance(node, ast.ClassDef) else [])]
        missing += [f"{path}: {one.name}" for one in inner if not ast.get_docstring(one)]
    return missing


def page(layer: str, meaning: str, files: list[Path], root: Path) -> str:
    """Return the page of a layer."""
    lines = [f"# Python: {layer}", "", f"{meaning.capitalize()}.", ""]
    for path in files:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        parts = path.relative_to(root).with_suffix("").parts
        name = ".".join(part for part in parts if part != "__init__")
        lines += [f"## {name}", "", _docstring_of(tree), ""]
        for node in public(tree.body):
            lines += _entry(node, 3)
    return "\n".join(lines)


def _entry(node: Named, level: int) -> list[str]:
    if isinstance(node, ast.FunctionDef):
        returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
        head = f"def {node.name}({ast.unparse(node.args)}){returns}"
    else:
        bases = ", ".join(ast.unparse(base) for base in node.bases)
        head = f"class {node.name}" + (f"({bases})" if bases else "")
    decorators = [ast.unparse(one) for one in node.decorator_list]
    head = "".join(f"@{one}\n" for one in decorators) + head
    code = ["```python", head, "```"]
    lines = ["#" * level + f" {node.name}", "", *code, "", _docstring_of(node), ""]
    if isinstance(node, ast.ClassDef):
        fields = [ast.unparse(one) for one in node.body if isinstance(one, ast.AnnAssign)]
        if fields:
            lines += ["```python", *fields, "```", ""]
        for inner in public(node.body):
            lines += _entry(inner, level + 1)
    return lines


def _docstring_of(node: Named | ast.Module) -> str:
    """Return a docstring as Markdown: headings of sections in bold, their entries as lists."""
    text = ast.get_docstring(node) or ""
    parts = re.split(r"^(\w+)\n-+$", text, flags=re.MULTILINE)
    found = [parts[0]]
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        listed = re.sub(r"^(\S.*?) : ", r"- `\1`: ", body, flags=re.MULTILINE)
        found += [f"**{title}**", "", listed.strip("\n"), ""]
    return "\n".join(found).replace("![", "!\\[")

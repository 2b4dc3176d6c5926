"""How Sphinx makes the site of the checkout: from disk, without a network, formulas as MathML.

`-D executed=0` executes no block: to see how pages look.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import blocks
import fortran
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

project = "battery"
root_doc = "README"
include_patterns = ["*.md", "docs/*.md", "docs/manual/python_names.md",
                    "docs/manual/generated/*.md", "studies/**README.md"]  # fmt: skip
exclude_patterns = ["build", ".*"]
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
autodoc_typehints = "description"
default_role = "code"  # of docstrings
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
myst_fence_as_directive = ["math"]
html_theme = "furo"
html_title = "battery"
html_static_path = ["manual.css"]
html_css_files = ["manual.css"]
html_copy_source = False
html_show_copyright = False
html_show_sphinx = False
# A browser does not fetch the summaries of search results for pages from disk.
html_show_search_summary = False
html_math_renderer = "mathml"
smartquotes = False  # w' is a width, 'urn' is a value
pygments_style = "friendly"
suppress_warnings = ["misc.highlighting_failure"]
STUDIES = (ROOT / "studies").is_dir()
LINK_TO_STUDY = re.compile(r"!?\[([^\]]*)\]\([./]*studies/[^)]*\)")


def _inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def _block(translator: HTML5Translator, node: nodes.math_block) -> None:
    formula = tex2mathml(node.astext(), as_block=True)
    translator.body.append(f'<div class="formula">{formula}</div>')
    raise nodes.SkipNode


def _write_fortran_pages(_: Sphinx) -> None:
    """Write a page for each layer of src, in their order (docs/layers.txt)."""
    shutil.rmtree(HERE / "generated", ignore_errors=True)
    (HERE / "generated").mkdir()
    src = (ROOT / "docs/layers.txt").read_text().split("\nsrc\n")[1].split("\n\n")[0]
    for at, (layer, meaning) in enumerate(re.findall(r"^  (\w+) +(.*)", src, re.MULTILINE)):
        text = fortran.page(layer, meaning, ROOT / "src")
        (HERE / f"generated/{at:02}_{layer}.md").write_text(text, encoding="utf-8")


def _evaluate(app: Sphinx, name: str, source: list[str]) -> None:
    """Evaluate the blocks of a page; without studies, links to them are text."""
    text, problems = source[0], []
    if app.config.executed and not name.startswith("docs/manual"):
        text, problems = blocks.evaluated(name, text)
    for line, problem in problems:
        logging.getLogger(__name__).warning(problem, location=(name, line))
    if name == root_doc:
        text += "\n" + (HERE / "contents.md").read_text()
    if not STUDIES:
        text = re.sub(r"```{toctree}[^`]*studies/[^`]*```", "", LINK_TO_STUDY.sub(r"\1", text))
    source[0] = text


def _finish(app: Sphinx, problem: Exception | None) -> None:
    """Begin the site at index.html, as a reader expects."""
    if not problem:
        shutil.copyfile(app.outdir / "README.html", app.outdir / "index.html")


def setup(app: Sphinx) -> dict[str, bool]:
    """Tell Sphinx how formulas are drawn and what is executed."""
    app.add_config_value("executed", default=True, rebuild="env", types=[bool])
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.connect("builder-inited", _write_fortran_pages)
    app.connect("source-read", _evaluate)
    app.connect("build-finished", _finish)
    return {"parallel_read_safe": False, "parallel_write_safe": True}

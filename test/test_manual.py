"""The manual: what is wrong with a page, or not explained, is found."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from support.program import ROOT, make

if TYPE_CHECKING:
    from pathlib import Path

sys.path.insert(0, str(ROOT / "docs/manual"))

import blocks
import fortran
import reference

BROWSER = shutil.which("chromium")
PATH = re.compile(r"`((?:src|app|postproc|test|docs|namelists|studies)/[\w./-]+\w)(?::\d+)?`")
PAGES = {str(path.relative_to(ROOT)): path for path in reference.pages()}
# Blocks of the other pages are evaluated when the site is made.
QUICK = ("tutorial", "cookbook", "command_line", "geometries", "python", "runs", "theory")

GOOD = [
    "```fortran\n&run\n  collisions = 100000\n/\n```",
    "```fortran\n&scan\n  threshold_fraction = 0.005, 0.007\n/\n```",
    "```sh\nmake test FULL=1\n```",
    "```sh\nbuild/bin/battery FILE.nml\n```",
    "```sh\ncd test\n../build/venv/bin/python -m mutants --seed 1 --count 60\n```",
    "```sh\nbattery-postproc theory --number 10 --threshold 1\n```",
    "```text\nprinted, not typed\n```",
]
BAD = [
    ("```fortran\n&run\n  colisions = 1000\n/\n```", "colisions"),
    ("```fortran\n&gate\n  threshold = -1\n/\n```", "threshold"),
    ("```sh\nmake coffee\n```", "make has no coffee"),
    ("```sh\nbuild/bin/no_such FILE.nml\n```", "there is no build/bin/no_such"),
    ("```sh\nbattery-postproc theory --numbr 10\n```", "postproc theory has no ['--numbr']"),
    ("```sh\npython -m postproc.alchemy\n```", "no postproc.alchemy"),
    ("```sh\npython3 test/no_such.py\n```", "there is no test/no_such.py"),
    ("```sh\nbuild/bin/battery namelists/no_such.nml\n```", "there is no namelists/no_such.nml"),
    ("```sh\nbatery FILE.nml\n```", "there is no batery"),
    ("```sh run\nbuild/bin/battery no_such.nml\n```", "exit code 2"),
    ("```python run\nunknown\n```", "NameError"),
    ("```fortran file=namelists/map.nml\n! other\n```", "the block is not namelists/map.nml"),
]


@pytest.mark.parametrize("name", QUICK)
def test_the_blocks_of_a_page_work(tmp_path: Path, name: str) -> None:
    """As someone would type them, one after the other."""
    text, problems = blocks.evaluated(name, PAGES[f"docs/{name}.md"].read_text(), tmp_path)
    assert problems == []
    if name == "tutorial":
        assert text.count("![What it drew]") > 5
        assert len((tmp_path / name / "map.csv").read_text().splitlines()) == 1 + 6 * 4


def test_the_notebook_of_a_first_day_works(tmp_path: Path) -> None:
    cells = json.loads((ROOT / "docs/first_day.ipynb").read_text())["cells"]
    code = ["".join(one["source"]) for one in cells if one["cell_type"] == "code"]
    text = "\n\n".join(f"```python run\n{one}\n```" for one in code)
    assert blocks.evaluated("first_day", text, tmp_path)[1] == []


@pytest.mark.parametrize("text", GOOD)
def test_a_block_that_works_is_no_problem(tmp_path: Path, text: str) -> None:
    assert blocks.evaluated("page", text, tmp_path)[1] == []


@pytest.mark.parametrize(("text", "said"), BAD)
def test_a_block_that_does_not_work_is_a_problem(tmp_path: Path, text: str, said: str) -> None:
    """It is named with its line."""
    ((line, problem),) = blocks.evaluated("page", "one line\n\n" + text, tmp_path)[1]
    assert line == 3
    assert said in problem


def test_what_a_block_prints_and_draws_is_shown_below_it(tmp_path: Path) -> None:
    text = "```python run\nimport matplotlib.pyplot as plt\nprint(6 * 7)\nplt.figure()\n```"
    shown = f"{text}\nbelow\n```sh check\necho unseen\n```\n"
    shown, _ = blocks.evaluated("page", shown, tmp_path)
    assert shown.startswith(f"{text}\n\n```text\n42\n```\n\n![What it drew](/")
    assert shown.endswith("drawn/1.png)\nbelow\n```sh check\necho unseen\n```\n")
    assert (tmp_path / "page/drawn/1.png").is_file()


@pytest.mark.parametrize("page", PAGES)
def test_pages_hold_what_the_program_and_the_tables_say(page: str) -> None:
    """They can be read where they lie; `make docs` writes those parts anew."""
    text = PAGES[page].read_text(encoding="utf-8")
    assert reference.filled(PAGES[page]) == text
    kinds = set(re.findall(r"^ *```([^`\n]+)$", text, re.MULTILINE)) - {"diff", "math", "text"}
    assert [kind for kind in kinds if not blocks.BLOCK.match(f"{kind}\n")] == []
    prose = re.sub(r"^ *```.*?^ *```", "", text, flags=re.MULTILINE | re.DOTALL)
    gone = () if (ROOT / "studies").is_dir() else ("studies/",)
    named = {name for name in PATH.findall(prose) if not name.startswith(gone)}
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_a_table_of_a_page_changes_with_its_file(tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text('T,chi\n7,"0.9, or so"\n')
    page = tmp_path / "page.md"
    page.write_text("<!-- one.csv: written by make docs -->\n\nold\n\n<!-- end of one.csv -->\n")
    assert "\n\n| T | chi |\n| --- | --- |\n| 7 | 0.9, or so |\n\n" in reference.filled(page)
    assert "old" not in reference.filled(page)


def test_examples_of_keys_are_those_of_the_page() -> None:
    """A key that the page lacks has its default."""
    page = PAGES["docs/input.md"].read_text()
    seed = "#### seed\n\nBetter words.\n\n```fortran\n&particles\n  seed = 11\n/\n```\n"
    assert "  seed = 11\n" in reference.keys(f"\n### &particles\n\n{seed}")
    assert "#### seed" in page
    assert "  engine = 'excursion'\n" in reference.keys("")


def test_every_page_is_in_the_site() -> None:
    """A page that no list has would be found by nobody; `README.md` has the lists."""
    listed = (ROOT / "docs/manual/contents.md").read_text().split()
    own = {name for name in PAGES if not name.startswith("studies/") and name != "README.md"}
    assert {name.removesuffix(".md") for name in own} - set(listed) == set()


def test_public_names_are_explained(tmp_path: Path) -> None:
    """Of all modules of Fortran; of Python lint demands it. One without a word is found."""
    assert all(fortran.module(path) for path in (ROOT / "src/gate").rglob("*.f90"))
    assert list(map(fortran.module, (ROOT / "src").rglob("*.[fF]90")))
    bare = "!> M.\nmodule m\n  public :: f\ncontains\n  subroutine f(x)\n{}  end subroutine f\n"
    path = tmp_path / "src/m.f90"
    path.parent.mkdir()
    path.write_text(bare.format("    real, intent(in) :: x\n    real :: y\n\n"))
    with pytest.raises(fortran.UnexplainedError, match=r"f$"):
        fortran.module(path)
    path.write_text(path.read_text().replace("  subroutine", "  !> Does.\n  subroutine", 1))
    section = "### f\n\nDoes.\n\n```fortran\nsubroutine f(x)\n  real, intent(in) :: x\n```"
    assert fortran.module(path) == f"## m\n\n`src/m.f90`\n\nM.\n\n{section}"


@pytest.mark.full
@pytest.mark.skipif(BROWSER is None, reason="no chromium here")
def test_the_site_is_made_and_the_browser_has_nothing_to_say(tmp_path: Path) -> None:
    """No message on the console; nothing comes from a network; a search finds a key."""
    make("docs")
    site = ROOT / "build/site"
    loaded = re.compile(r"<(?:script|link|img)[^>]*(?:src|href)=\"(?:https?:)?//")
    assert [path.name for path in site.rglob("*.html") if loaded.search(path.read_text())] == []
    for name in ("index.html", "docs/theory.html", "search.html?q=channel2_width"):
        done = subprocess.run(
            [
                BROWSER,
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--enable-logging=stderr",
                "--virtual-time-budget=8000",
                f"--user-data-dir={tmp_path / 'profile'}",
                "--dump-dom",
                f"{site.as_uri()}/{name}",
            ],
            check=True,
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert "CONSOLE" not in done.stderr, name
    assert 'href="docs/input.html#' in done.stdout
    assert "<math" in (site / "docs/theory.html").read_text()

"""The manual: what is wrong with a page, or not explained, is found."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import h5py
import pytest
from support.program import ROOT, make

if TYPE_CHECKING:
    from pathlib import Path

sys.path.insert(0, str(ROOT / "docs"))

from manual import fortran, pages, reference
from manual.fences import Fences

BROWSER = shutil.which("chromium")


def tried(folder: Path, text: str) -> list[str]:
    fences = Fences(ROOT, folder / "work", folder / "drawn")
    fences.shown("page.md", text)
    return fences.problems


GOOD = [
    "```fortran\n&run\n  collisions = 100000\n/\n```",
    "```fortran\n&scan\n  threshold = 1, 2\n/\n```",
    "```\nmake test FULL=1\n```",
    "```sh\nbuild/bin/battery FILE.nml\n```",
    "```sh\nbattery-postproc theory --number 10 --threshold 1\n```",
    "```python run\nx = 1\n```\n\n```python run\nprint(x)\n```",
    "```\nprinted, not typed\n```",
]
BAD = [
    ("```fortran\n&run\n  colisions = 1000\n/\n```", "colisions"),
    ("```fortran\n&gate\n  threshold = -1\n/\n```", "threshold"),
    *(
        [
            ("```\nmake coffee\n```", "make has no coffee"),
            ("```sh\nbuild/bin/no_such FILE.nml\n```", "there is no build/bin/no_such"),
        ]
        if (ROOT / "studies").is_dir()
        else []
    ),  # else all targets may be theirs
    ("```sh\nbattery-postproc theory --numbr 10\n```", "postproc theory has no --numbr"),
    ("```sh\npython -m postproc.alchemy\n```", "postproc.alchemy cannot be called"),
    ("```sh\npython3 test/no_such.py\n```", "there is no test/no_such.py"),
    ("```sh run\nbuild/bin/battery no_such.nml\n```", "exit code 2"),
    ("```python run\nunknown\n```", "NameError"),
    ("```fortran file=namelists/map.nml\n&run\n/\n```", "first line does not name namelists/map"),
    ("```fortran file=namelists/map.nml\n! namelists/map.nml\n```", "is not what is shown"),
]


def test_the_notebook_runs(tmp_path: Path) -> None:
    """As someone would type it, block by block; it draws five pictures."""
    fences = Fences(ROOT, tmp_path / "work", tmp_path / "drawn")
    text = (ROOT / "docs/tutorial.md").read_text(encoding="utf-8")
    fences.shown("page.md", text.replace("```sh run", "```sh"))
    assert fences.problems == []
    assert len(list((tmp_path / "drawn").glob("*.png"))) == 5
    table = (tmp_path / "work/map.csv").read_text(encoding="utf-8")
    assert len(table.splitlines()) == 1 + 6 * 4


@pytest.mark.parametrize("text", GOOD)
def test_a_block_that_works_is_no_problem(tmp_path: Path, text: str) -> None:
    assert tried(tmp_path, text) == []


@pytest.mark.parametrize(("text", "said"), BAD)
def test_a_block_that_does_not_work_is_a_problem(tmp_path: Path, text: str, said: str) -> None:
    """It is named with its page and line."""
    (problem,) = tried(tmp_path, "one line\n\n" + text)
    assert problem.startswith("page.md:3: ")
    assert said in problem


@pytest.mark.parametrize(
    "text", ["[x](no_such.md)", "[x](../no_such.txt)", "![x](none.png)", "`src/gate/none.f90`"]
)
def test_a_link_that_leads_nowhere_is_a_problem(tmp_path: Path, text: str) -> None:
    _, (problem,) = pages.linked(ROOT, tmp_path, "docs/theory.md", f"See {text}.")
    assert "docs/theory.md" in problem


def test_links_lead_within_the_site(tmp_path: Path) -> None:
    """Pages to pages, files to copies of them; code stays as it is."""
    text = "[a](accuracy.md#b) [c](../CITATION.cff) `[d](e.md)` [f](https://example.org)"
    changed, problems = pages.linked(ROOT, tmp_path, "docs/theory.md", text)
    assert problems == []
    expected = "[a](accuracy.md#b) [c](files/CITATION.cff) `[d](e.md)` [f](https://example.org)"
    assert changed == expected
    assert (tmp_path / "files/CITATION.cff").is_file()


def test_pages_can_do_without_studies(tmp_path: Path) -> None:
    """Where they are deleted, links to them are text, and no caption of the side bar is empty."""
    (tmp_path / "docs").mkdir()
    gone = "studies"  # the name alone: nothing else here knows a study
    text = f"[a](../{gone}/no/README.md#b), ![c](../{gone}/no.png), `{gone}/no/x.csv`"
    changed, problems = pages.linked(tmp_path, tmp_path, "docs/validation.md", text)
    assert (changed, problems) == (f"a, c, `{gone}/no/x.csv`", [])
    assert pages.contents(tmp_path, {}, {}) == "\n"
    (tmp_path / gone).mkdir()
    _, problems = pages.linked(tmp_path, tmp_path, "docs/validation.md", text)
    assert len(problems) == 3


def test_reference_pages_hold_what_the_program_says(tmp_path: Path) -> None:
    """They can be read where they lie; `make docs` writes those parts anew."""
    made, problems = reference.generated(ROOT, tmp_path)
    assert problems == []
    texts = {name: (ROOT / f"docs/{name}.md").read_text()
             for name in ("input", "output", "command_line")}  # fmt: skip
    assert {name: pages.filled(text, made) for name, text in texts.items()} == texts
    assert all(any(part in text for text in texts.values()) for part in made.values())


def test_tables_of_pages_are_their_files(tmp_path: Path) -> None:
    """Each is the CSV file that a study wrote beside the page, and changes with it."""
    (tmp_path / "one.csv").write_text('T,chi\n7,"0.9, or so"\n')
    page = "A\n\n<!-- one.csv: written by make docs -->\n\nold\n\n<!-- end of one.csv -->\n"
    text = pages.filled(page, pages.tables(tmp_path, "page.md", page))
    assert "\n\n| T | chi |\n| --- | --- |\n| 7 | 0.9, or so |\n\n" in text
    assert "old" not in text
    for file in pages.pages(ROOT).values():
        text = (ROOT / file).read_text()
        assert pages.filled(text, pages.tables(ROOT, file, text)) == text, file


def test_a_namelist_that_a_page_names_is_that_file() -> None:
    """Its first line says the name, where a reader sees it; commands name files that are there."""
    shown = set()
    for file in pages.pages(ROOT).values():
        for words, body in re.findall(r"^```fortran ([^\n]+)\n(.*?)^```", (ROOT / file).read_text(),
                                      re.MULTILINE | re.DOTALL):  # fmt: skip
            name = re.fullmatch(r"file=(namelists/\w+\.nml)", words)[1]
            assert body.startswith(f"! {name}: "), file
            assert body == (ROOT / name).read_text(), file
            shown.add(name)
    assert len(shown) >= 5


def test_every_page_is_in_the_site() -> None:
    """A page in docs that no list has would be found by nobody."""
    listed = set(pages.pages(ROOT).values())
    assert {f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")} - listed == set()


def test_public_names_are_explained() -> None:
    """Of all modules of Fortran; of Python lint demands it."""
    modules = [fortran.read_module(path) for path in sorted((ROOT / "src").rglob("*.[fF]90"))]
    assert [one for module in modules if module for one in fortran.unexplained(module)] == []


def test_a_public_name_without_a_word_is_found(tmp_path: Path) -> None:
    bare = "!> M.\nmodule m\n  public :: f\ncontains\n  subroutine f()\n  end subroutine f\n"
    (tmp_path / "m.f90").write_text(bare)
    assert fortran.unexplained(fortran.read_module(tmp_path / "m.f90"))
    (tmp_path / "m.f90").write_text(bare.replace("  subroutine", "  !> Does.\n  subroutine"))
    assert fortran.unexplained(fortran.read_module(tmp_path / "m.f90")) == []


@pytest.mark.full
def test_every_key_has_a_snippet_that_the_program_takes(tmp_path: Path) -> None:
    keys = reference.all_keys(ROOT / "build/bin/battery")
    assert len(keys) > 40
    text = reference.input_table(keys)
    assert text.count("```fortran") == len(keys)
    assert all(f"#### {key.name}\n" in text and key.meaning and key.allowed for key in keys)
    width = next(key for key in keys if key.name == "channel2_width")
    assert (width.unit, width.symbol) == ("length", "w'")
    assert tried(tmp_path, text) == []


def test_a_dataset_that_says_nothing_is_found(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "bare.h5", "w") as file:
        file["chi"] = 1.0
        file["chi"].attrs["units"] = "1"
    assert reference.unexplained(tmp_path / "bare.h5") == ["results file: chi has no long_name"]


@pytest.mark.full
@pytest.mark.skipif(BROWSER is None, reason="no chromium here")
def test_the_site_is_made_and_the_browser_has_nothing_to_say(tmp_path: Path) -> None:
    """No message on the console; nothing comes from a network; a search finds a key."""
    make("docs")
    site = ROOT / "build/site"
    loaded = re.compile(r"<(?:script|link|img)[^>]*(?:src|href)=\"(?:https?:)?//")
    assert [path.name for path in site.rglob("*.html") if loaded.search(path.read_text())] == []
    for name in ("index.html", "theory.html", "input.html", "search.html?q=channel2_width"):
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
    assert 'href="input.html#' in done.stdout
    assert "<math" in (site / "theory.html").read_text()

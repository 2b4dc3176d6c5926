"""The page on accuracy: every field of its template is filled, from what the parts have kept."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from postproc import cli
from postproc.accuracy import page, sections
from postproc.study.study import ROOT, Study

KEPT = Path(__file__).with_name("accuracy_numbers.json")  # of a quick run, long lists left out


@pytest.fixture
def study(tmp_path: Path) -> Study:
    for part, numbers in json.loads(KEPT.read_text()).items():
        (tmp_path / f"{part}.json").write_text(json.dumps(numbers))
    return Study(tmp_path)


def test_every_field_is_filled_and_every_number_used(study: Study) -> None:
    names = page.names_of(page.TEMPLATE.read_text())
    filled = {name for part, make in page.FIELDS.items() for name in make(study.kept(part))}
    assert names - filled == {"kind", *page.SECTIONS}
    assert filled - names == set()
    text = page.page(study)
    assert not re.search(r"[{}]", text)
    assert not re.search(r"\bNone\b|\bnan\b", text)


def test_numbers_on_the_page_are_those_kept(study: Study) -> None:
    many = study.kept("tail")["ensemble"]
    text = page.page(study)
    assert page.measured(many["mean"], many["error"]) in text
    assert "timestep 0.003" in text
    assert page.NOT_RUN not in text


def test_other_parts_may_be_missing(study: Study) -> None:
    for part in page.SECTIONS:
        assert page.NOT_RUN not in page.page(study)
        (study.folder / f"{part}.json").rename(study.folder / "away.json")
        assert page.page(study).count(page.NOT_RUN) == 1
        (study.folder / "away.json").rename(study.folder / f"{part}.json")


def test_part_that_has_not_been_made_is_named(study: Study) -> None:
    (study.folder / "tail.json").unlink()
    with pytest.raises(cli.InputError, match="tail"):
        page.page(study)


def test_figures_are_copied_beside_the_page(study: Study, tmp_path: Path) -> None:
    text = "![one](accuracy_one.png)"
    with pytest.raises(cli.InputError, match=r"one\.png"):
        page.publish(text, study.folder, tmp_path / "docs")
    (study.folder / "one.png").write_bytes(b"picture")
    path = page.publish(text, study.folder, tmp_path / "docs")
    assert path.read_text() == text
    assert (path.parent / "accuracy_one.png").read_bytes() == b"picture"


def test_page_of_the_docs_is_whole() -> None:
    text = (ROOT / "docs/accuracy.md").read_text()
    assert not re.search(r"[{}]", text)
    for name in page.figures_of(text):
        assert (ROOT / f"docs/accuracy_{name}.png").exists()
    heads = re.findall(r"^## .*", page.TEMPLATE.read_text(), re.MULTILINE)
    assert heads == re.findall(r"^## .*", text, re.MULTILINE)


@pytest.mark.parametrize(
    ("value", "digits", "expected"),
    [(0.0604567, 3, "0.0605"), (1.23e6, 2, "1.2e6"), (12.3456, 3, "12.3"), (7e-5, 2, "7.0e-5"),
     (0.0, 3, "0"), (15414.0, 2, "15000"),
     (None, 3, "-"), (float("nan"), 3, "-"), (-0.5, 2, "-0.50")],
)  # fmt: skip
def test_numbers_in_words(value: float | None, digits: int, expected: str) -> None:
    assert page.number(value, digits) == expected


def test_measurements_in_words() -> None:
    assert page.measured(1.01964, 0.00301) == "1.0196 +- 0.0030"
    assert page.measured(0.5, 0.0) == "0.50000"
    assert page.percent(0.0789) == "7.9 %"
    assert [page.seconds(value) for value in (2.34, 0.0049, 8.4e-5, None)] == [
        "2.3 s", "4.9 ms", "84 us", "-",
    ]  # fmt: skip


def test_stability_table_begins_with_its_verdict(study: Study) -> None:
    numbers = study.kept("stability")
    text = sections.stability(numbers)
    told = text[text.index("**Verdict**") : text.index("| case |")]
    assert re.findall(r"^(\d)\. ", told, re.MULTILINE) == ["1", "2", "3", "4", "5"]
    table = (ROOT / "docs/accuracy.md").read_text()
    cell = sections._cell(table[table.index("| case |") :], "whispering", "collision", "real64")
    assert cell.startswith("3.1e-12 down to")
    assert sections._cell(table[table.index("| case |") :], "long run", "none", "real64") == "-"


def test_papers_average_stands_beside_that_over_time(study: Study) -> None:
    averages = study.kept("observables")["averages"]
    text = page.page(study)
    assert "**The paper's average.**" in text
    for one in averages:
        assert page.measured(one["less"], one["less_error"]) in text


def test_prose_is_wrapped_and_nothing_else() -> None:
    """Words, tables and code stay; a second time changes nothing; no line becomes an item."""
    words = "many words of prose, at 5. of them a minus - like this + that " * 6
    row = "| " + "a cell " * 30 + "|"
    items = f"- {words}\n  {words}\n2. {words}"
    text = f"# {words}\n\n{items}\n\n{row}\n\n```\n{words}\n```\n\n{words}\n"
    told = page.wrapped(text)
    assert told.split() == text.split()
    assert page.wrapped(told) == told
    assert row in told
    assert f"```\n{words}\n```" in told
    prose = [line for line in told.splitlines() if not line.startswith(("|", "#", "many words"))]
    assert max(map(len, prose[:-1])) <= 118
    marks = re.findall(r"^ *(?:[-+*]|\d+\.) ", told, re.MULTILINE)
    assert marks == ["- ", "2. "]

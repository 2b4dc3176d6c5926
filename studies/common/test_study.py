"""Studies: runs are resumed or replaced, numbers, tables and pictures are kept."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from postproc import cli
from postproc.figures import style
from postproc.reading.grid import open_results
from studies.common import text
from studies.common.numbers import transition_of
from studies.common.study import Study, main, namelist_text

if TYPE_CHECKING:
    from pathlib import Path

CASE = {
    "particles": {"number": 20}, "gate": {"threshold": 7},
    "run": {"duration": 20.0, "transient_duration": 1.0}, "scan": {"replicas": 2},
}  # fmt: skip


def test_run_is_kept_and_another_input_stops_the_study(tmp_path: Path) -> None:
    study = Study(tmp_path)
    path = study.run(CASE, "one")
    written = path.read_bytes()
    assert study.run(CASE, "one") == path
    with pytest.raises(cli.InputError, match=r"threshold: was 7, is 9\n.*--afresh"):
        study.run(CASE, "one", {"gate": {"threshold": 9}})
    assert path.read_bytes() == written
    replace(study, afresh=True).run(CASE, "one", {"gate": {"threshold": 9}})
    assert open_results(path)["threshold"] == 9


def test_bad_input_is_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(cli.InputError, match="threshold"):
        Study(tmp_path).run(CASE, "bad", {"gate": {"threshold": -1}})
    with pytest.raises(cli.InputError, match="nothing"):
        Study(tmp_path).run("nothing", "bad")


def test_changes_add_replace_and_remove_keys() -> None:
    changes = {"particles": {"urn1_number": None, "number": 10}, "limits": {"wall_minutes": 1}}
    told = namelist_text({"particles": {"urn1_number": 3, "seed": 1}}, changes)
    assert "urn1_number" not in told
    for line in ("seed = 1", "number = 10", "wall_minutes = 1"):
        assert line in told


def test_kept_numbers_are_plain_json(tmp_path: Path) -> None:
    study = Study(tmp_path)
    assert study.kept("part") is None
    numbers = {"a": np.array([1.5, math.nan]), "b": {1: np.int64(3)}, "c": (math.inf, "x")}
    study.keep("part", numbers)
    assert study.kept("part") == {"a": [1.5, None], "b": {"1": 3}, "c": [None, "x"]}
    json.loads((tmp_path / "part.json").read_text())


def test_tables_and_pictures_are_published_beside_the_page(tmp_path: Path) -> None:
    page = tmp_path / "docs"
    page.mkdir()
    rows = [["7", "0.93 +- 0.01"], ["8", "a, b"]]
    for shown, names in ((None, []), (page, ["one.csv", "two.png"])):
        study = Study(tmp_path, page=shown)
        assert study.table("one", ["T", "chi"], rows).read_text() == (
            'T,chi\n7,0.93 +- 0.01\n8,"a, b"\n'
        )
        study.draw(style.figure(1.0, 1.0), "two")
        assert sorted(path.name for path in page.iterdir()) == names


def test_unknown_part_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    parts = {"something": lambda _: None}
    assert main(__file__, __doc__, parts, ["nothing"]) == cli.EXIT_BAD_INPUT
    assert "allowed: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("value", "digits", "expected"),
    [(0.0604567, 3, "0.0605"), (1.23e6, 2, "1.2e6"), (12.3456, 3, "12.3"), (7e-5, 2, "7.0e-5"),
     (0.0, 3, "0"), (15414.0, 2, "15000"),
     (None, 3, "-"), (float("nan"), 3, "-"), (-0.5, 2, "-0.50")],
)  # fmt: skip
def test_numbers_in_words(value: float | None, digits: int, expected: str) -> None:
    assert text.number(value, digits) == expected


def test_measurements_in_words() -> None:
    assert text.measured(1.01964, 0.00301) == "1.0196 +- 0.0030"
    assert text.measured(0.5, 0.0) == "0.50000"
    assert text.percent(0.0789) == "7.9 %"
    assert [text.seconds(value) for value in (2.34, 0.0049, 8.4e-5, None)] == [
        "2.3 s", "4.9 ms", "84 us", "-",
    ]  # fmt: skip


def test_transition_is_where_chi_falls_through_last() -> None:
    """Replicas that are apart by 0.1 in chi, at a slope of 0.4: each moves it by 0.125."""
    falling = np.array([[0.1, 0.9, 0.5, 0.1]]).T + np.array([[-0.05, 0.05]])
    value, error = transition_of(np.arange(1.0, 5.0), falling)
    assert value == pytest.approx(3.5)
    assert error == pytest.approx(0.125)
    assert math.isnan(transition_of(np.arange(2.0), np.full((2, 2), 0.1))[0])

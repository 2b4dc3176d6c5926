"""Legends and tables of the charts."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

from postproc.tests.looks import assert_looks_apart
from studies.accuracy import charts, ladder_map, observables
from studies.common.study import Study

HERE = Path(__file__).parent
KEPT = json.loads((HERE / "accuracy_numbers.json").read_text())


def test_no_two_entries_of_a_legend_look_alike() -> None:
    assert_looks_apart(charts.figure_observables(KEPT["observables"]["rows"]))
    assert_looks_apart(charts.figure_map(KEPT["ladder_map"]["rows"]))


def test_tables_say_what_a_rung_lacks(tmp_path: Path) -> None:
    for line in KEPT["observables"]["rows"]:
        line["transition"]["value"] = line["transition"]["value"] or math.nan
    observables.tables(
        Study(tmp_path), KEPT["observables"]["rows"], KEPT["observables"]["averages"]
    )
    ladder_map.tables(Study(tmp_path), KEPT["ladder_map"])
    text = "".join(path.read_text() for path in tmp_path.glob("*.csv"))
    assert "none from 14 to 18" in text
    assert "none in reach" in text
    assert not re.search("nan|None", text)

"""Legends of the charts; what the product has of the map."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path

from postproc.advice.model_errors import TABLE
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


def test_table_of_the_product_is_a_part_of_the_measured_one() -> None:
    """Its models at all points, with the same errors."""
    with TABLE.open(encoding="utf-8") as file:
        known = list(csv.DictReader(file))
    models = {row["model"] for row in known}
    with (HERE / "where_models_fail.csv").open(encoding="utf-8") as file:
        measured = [row for row in csv.DictReader(file) if row["model"] in models]
    assert known == [{name: row[name] for name in known[0]} for row in measured]

"""The age of a run: bins of age, a short run with the theory beside it."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import postproc
from studies.age_of_a_run import study as ages
from studies.common.study import Study

HERE = Path(ages.__file__).parent


def test_bins_are_whole_intervals_from_the_start_to_the_end() -> None:
    edges = ages.bins_of(1e4, 100.0)
    assert edges[0] == 0.0
    assert edges[-1] == 1e4
    assert np.all(np.diff(edges) > 0.0)
    assert np.allclose(edges % 100.0, 0.0)


def test_rows_have_runs_and_theory_of_each_age(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = {"scan": {"replicas": 2}, "run": {"duration": 300.0}}
    monkeypatch.setattr(ages, "QUICK", short)
    rows = ages.rows_of(Study(tmp_path, HERE, ranks=1), "reference")
    assert (rows[0]["from"], rows[0]["to"], rows[-1]["to"]) == (0.0, 100.0, 300.0)
    assert all(row["replicas"] == 2 and 0.9 < row["chi"] < 1.0 for row in rows)
    series = postproc.open_results(tmp_path / "reference.h5", group="series").squeeze()
    in_urn1 = series.urn1_number.sel(time=100.0).to_numpy()
    assert rows[0]["chi"] == pytest.approx(np.mean(np.abs(500 - in_urn1)) / 500)
    published = csv.DictReader((HERE / "results.csv").open())
    here = next(row for row in published if row["point"] == "reference" and row["to"] == "100")
    assert rows[0]["theory"] == pytest.approx(float(here["theory"]), rel=1e-4)

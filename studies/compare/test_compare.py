"""Comparison of theories with runs."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

import pytest

from postproc import cli
from postproc.reading.results import Results
from postproc.tests.runs import BARE, FORGETFUL, results_of
from studies.compare import study as compare

if TYPE_CHECKING:
    from pathlib import Path


def test_runs_without_memory_agree_with_the_renewal_gate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = {"threshold": [5, 7, 9, 25]}
    path = results_of(
        tmp_path / "run.h5",
        particles={"urn1_number": 1000},
        run={"duration": 10000.0, **FORGETFUL},
        scan=scan,
        output=BARE,
    )
    assert cli.run(compare.main, [str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    window, renewal = (found[name] for name in ("window", "renewal"))
    assert renewal["points"] == 4
    assert renewal["right_phase"] == 1.0
    assert renewal["chi"] < 0.01
    for name in compare.FLOWS:
        assert renewal[name] == pytest.approx(1.0, abs=0.1)
    assert renewal["dense2"] == window["dense2"]
    assert window["dense1"] > 3.0


def test_single_urns_are_compared_by_their_current(tmp_path: Path) -> None:
    path = results_of(
        tmp_path / "urn.h5",
        table={"shape": "urn"},
        particles={"number": 500},
        run={"duration": 20000.0, **FORGETFUL},
        scan={"threshold": [4, 6, 9]},
        output=BARE,
    )
    with Results(path) as results:
        paper, exact = compare.compare([results]).values()
    assert exact["current"] < 0.05 < paper["current"]
    assert math.isnan(paper["chi"])


def test_circuits_and_urns_do_not_mix(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = results_of(tmp_path / "one.h5", output=BARE)
    urn = results_of(tmp_path / "urn.h5", table={"shape": "urn"}, output=BARE)
    assert cli.run(compare.main, [str(one), str(urn)]) == 2
    assert capsys.readouterr().err.count("\n") == 1

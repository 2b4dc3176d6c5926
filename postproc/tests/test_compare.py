"""Comparison of theories with runs, and measured lifetimes."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from postproc import cli, compare, figures, passages
from postproc.gates import WINDOW
from postproc.renewal import RENEWAL
from postproc.results import Results
from postproc.tests.fabricate import fabricate

if TYPE_CHECKING:
    from pathlib import Path


def test_runs_made_by_the_papers_theory_agree_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grid = [{"threshold": threshold} for threshold in (7, 10, 14, 18)]
    path = fabricate(tmp_path / "run.h5", grid, duration=4000.0, snapshots=0)
    assert cli.run(compare.main, [str(path), "--json"]) == 0
    paper, renewal, counted = json.loads(capsys.readouterr().out)
    assert paper["right_phase"] == 1.0
    assert paper["chi"] < 0.01
    assert renewal["chi"] > 3 * paper["chi"]
    assert counted["points"] == 4
    for name in compare.FLOWS:
        assert paper[name] == pytest.approx(1.0, abs=0.1)
    assert renewal["dense2"] == paper["dense2"]
    assert renewal["dense1"] < 0.3
    assert renewal["sparse1"] == pytest.approx(1.0, abs=0.1)


def test_single_urns_are_compared_by_their_current(tmp_path: Path) -> None:
    urns = [{"number": 500, "threshold": t, "channel2_width": 0.0} for t in (3, 6, 9)]
    path = fabricate(tmp_path / "urn.h5", urns, duration=2000.0, snapshots=0, shape="urn")
    with Results(path) as results:
        paper, renewal, _ = compare.compare([results])
    assert paper.current < 0.05 < renewal.current
    assert math.isnan(paper.chi)


def test_circuits_and_urns_do_not_mix(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = fabricate(tmp_path / "one.h5", [{}], duration=300.0, snapshots=0)
    urn = fabricate(tmp_path / "urn.h5", [{}], duration=300.0, snapshots=0, shape="urn")
    assert cli.run(compare.main, [str(one), str(urn)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_lifetimes_are_measured_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = []
    for name, part in (("polarised", 1.0), ("homogeneous", 0.5)):
        grid = [{"number": n, "threshold": 18, "urn1_number": int(part * n)} for n in (500, 1000)]
        files.append(fabricate(tmp_path / f"{name}.h5", grid, duration=1000.0, snapshots=0))
    with Results(files[0]) as one, Results(files[1]) as other:
        found = passages.measured([one, other])
    assert [life.polarised for life in found] == [True, True, False, False]
    assert [(life.passages, life.replicas) for life in found] == [(2, 2)] * 2 + [(0, 2)] * 2
    assert all(0.0 < life.low <= life.time <= life.high < 500.0 for life in found[:2])
    assert all(life.time == pytest.approx(2000.0 / passages.BOUND) for life in found[2:])
    assert all(math.isnan(life.low) for life in found[2:])
    arguments = ["lifetimes", *map(str, files), "--output", str(tmp_path)]
    assert cli.run(figures.main, arguments) == 0
    assert capsys.readouterr().out.count("at least") == 2


def test_lifetimes_of_runs_that_end_too_early_are_not_too_short() -> None:
    random = np.random.default_rng(4)
    covered = 0
    for _ in range(400):
        times = random.exponential(1000.0, 32)
        mean, low, high = passages.estimate(np.minimum(times, 700.0), times <= 700.0)
        covered += low <= 1000.0 <= high
    assert 0.58 < covered / 400 < 0.82  # 68 % within five errors, a little more for small numbers
    mean, low, high = passages.estimate(times := random.exponential(1000.0, 9000), [True] * 9000)
    assert mean == pytest.approx(times.mean())
    assert high - low == pytest.approx(2.0 * mean / math.sqrt(9000), rel=0.1)


def test_measured_passages_are_those_of_the_chain(tmp_path: Path) -> None:
    # the fabricated circuits jump at the rates of the paper's theory, as the chain does
    grid = [{"number": 320, "threshold": 1, "urn1_number": 160}]
    path = fabricate(tmp_path / "run.h5", grid, 30, 6000.0, interval=3.0, snapshots=0)
    with Results(path) as results:
        (found,) = passages.measured([results])
    error = 0.5 * (found.high - found.low)
    assert found.passages > 20
    assert found.time == pytest.approx(found.of_chain({"gate": WINDOW}), abs=4.0 * error)
    assert 5.0 * error < abs(found.time - found.of_chain({"gate": RENEWAL}))

"""Measured lifetimes of states, and their figure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from postproc.figures import passages, style
from postproc.figures.theories import named
from postproc.tests.runs import FORGETFUL, points_of, results_of
from postproc.theory.models import MODELS

if TYPE_CHECKING:
    from pathlib import Path


def test_lifetimes_are_measured_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = {"number": [500, 1000], "urn1_fraction": [1.0, 0.5], "threshold": 18}
    path = results_of(tmp_path / "run.h5", particles={"number": None}, scan=scan)
    results = points_of(path)
    found = passages.measured(results)
    made = passages.figure_lifetimes(results, named(["window", "renewal"]))
    assert [life.polarised for life in found] == [True, False] * 2
    assert [(life.passages, life.replicas) for life in found] == [(2, 2), (0, 2)] * 2
    assert all(0.0 < life.low <= life.time <= life.high < 500.0 for life in found[::2])
    assert all(life.time == pytest.approx(2000.0 / passages.BOUND) for life in found[1::2])
    assert all(math.isnan(life.low) for life in found[1::2])
    assert capsys.readouterr().out.count("at least") == 2
    (axes,) = made.axes
    assert axes.get_title("left") == "$T = 18$, $\\ell = 1$"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("$N$", "lifetime  (length / $v$)")
    assert axes.get_yscale() == "log"
    assert axes.get_ylim()[0] < min(life.time for life in found)
    drawn = {(line.get_marker(), *map(tuple, line.get_data())) for line in axes.lines}
    for life in found:
        times = [one.time for one in found if one.polarised == life.polarised]
        assert ("o" if life.polarised else "^", (500.0, 1000.0), tuple(times)) in drawn
    assert len(made.legends[0].get_texts()) == 5


def test_at_one_number_of_particles_theories_are_seen_or_said_to_be_above(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = {"threshold": 18, "urn1_fraction": 1.0, "replicas": 2}
    path = results_of(tmp_path / "run.h5", particles={"number": 500}, scan=scan)
    models = named(["window"])
    (axes,) = passages.figure_lifetimes(points_of(path), models).axes
    (life,) = passages.measured(points_of(path))
    line = next(one for one in axes.lines if one.get_linestyle() == "--"
                and one.get_color() == style.VERMILION)  # fmt: skip
    assert line.get_xdata() == [0, 1]  # from edge to edge
    assert line.get_ydata() == pytest.approx([life.of_chain(models[0])] * 2)
    (text,) = axes.texts
    assert text.get_text() == "homogeneous: no runs, chains above $10^{10}$"
    assert axes.get_xticks().tolist() == [500]
    low, high = (passages._short(one) for one in (life.low, life.high))
    assert f" {low} to {high} " in capsys.readouterr().out
    assert [passages._short(one) for one in (1474.0, 93.26, 1.284e15)] == [
        "1470", "93.3", "1.28e+15",
    ]  # fmt: skip


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


def test_measured_passages_of_free_particles_are_those_of_the_chain(tmp_path: Path) -> None:
    path = results_of(
        tmp_path / "run.h5",
        table={"channel1_length": 0.1, "channel2_length": 0.1},
        particles={"number": 12},
        run={"duration": 1500.0, **FORGETFUL},
        scan={"threshold": 12, "urn1_fraction": [0.5, 1.0], "replicas": 100},
        output={"series_interval": 1.0, "snapshot_times": None},
    )
    results = points_of(path)
    found = passages.measured(results)
    for one in found:
        error = 0.5 * (one.high - one.low)
        expected = one.of_chain(MODELS["renewal"])
        assert one.time == pytest.approx(expected, abs=4.0 * error + 1.0)

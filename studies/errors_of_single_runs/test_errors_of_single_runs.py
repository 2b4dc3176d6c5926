"""The study with synthetic numbers, and with runs of the program."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from studies.common.study import Study
from studies.errors_of_single_runs import scatter
from studies.errors_of_single_runs import study as own_errors


def test_right_errors_are_called_right() -> None:
    random = np.random.default_rng(7)
    values = random.normal(0.3, 0.1, 20_000)
    errors = np.where(np.arange(values.size) % 4 == 0, np.nan, 0.1)
    found = own_errors.held(values, errors)
    assert found["told"] == 0.75
    assert found["true"] == pytest.approx(0.1, rel=0.03)
    assert found["ratio"] == pytest.approx(1.0, rel=0.03)
    assert found["one"] == pytest.approx(0.683, abs=0.02)
    assert found["two"] == pytest.approx(0.954, abs=0.01)
    none = own_errors.held(values, np.full(values.size, np.nan))
    assert none["told"] == 0.0
    assert np.isnan(none["one"])


def test_decay_time_is_that_of_the_slowest_part() -> None:
    """A process that decays in 20 intervals of 0.5, with noise and a drift common to all runs."""
    random = np.random.default_rng(7)
    values = np.zeros((200, 2000))
    values[:, 0] = random.normal(size=200)
    correlation = np.exp(-1.0 / 20.0)
    for k in range(1, 2000):
        new = random.normal(size=200)
        values[:, k] = correlation * values[:, k - 1] + np.sqrt(1.0 - correlation**2) * new
    values += random.normal(size=values.shape) + np.linspace(0.0, 3.0, 2000)
    assert own_errors.decay_time(values, 0.5, (5, 40)) == pytest.approx(10.0, rel=0.1)


def test_errors_of_a_scatter_are_those_of_whole_runs() -> None:
    random = np.random.default_rng(8)
    runs = random.normal(1.0, 0.1, (30, 1)) + np.zeros((30, 40))  # equal windows
    found = scatter.scatter_with_error(runs)
    assert found["deviation"] == pytest.approx(runs[:, 0].std(), rel=0.02)
    assert found["deviation_error"] == pytest.approx(found["deviation"] / math.sqrt(58.0), rel=0.4)
    apart = scatter.scatter_with_error(random.normal(1.0, 0.1, (30, 40)))
    assert apart["deviation_error"] < 0.4 * found["deviation_error"]
    assert apart["half_width_error"] > 0.0


def test_scatter_of_independent_values_falls_as_the_root_of_the_length() -> None:
    values = np.random.default_rng(3).normal(1.0, 0.1, (40, 700))
    rows = scatter.by_length(values, 0.5)
    assert [row["time"] for row in rows] == [*(0.5 * 2.0 ** np.arange(10)), 350.0]
    for row in rows:
        expected = 0.1 / math.sqrt(2.0 * row["time"])
        assert row["deviation"] == pytest.approx(expected, abs=4.0 * row["deviation_error"])


def test_length_for_the_goal() -> None:
    times = np.array([100.0, 400.0, 1600.0])
    assert scatter.length_for_goal(times, 0.2 / np.sqrt(times), 1.0) == pytest.approx(400.0)
    assert scatter.length_for_goal(times, 0.3 / np.sqrt(times), 1.0) == pytest.approx(900.0)
    assert scatter.length_for_goal(times, 1.0 / np.sqrt(times), 1.0) == pytest.approx(10000.0)
    assert scatter.length_for_goal(times, 0.01 / np.sqrt(times), 1.0) == 100.0


@pytest.mark.full
def test_errors_of_runs_of_the_program_are_right(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Wide openings, where directions relax in 32 time units: 200 runs of thirty times that."""
    monkeypatch.setattr(own_errors, "TRANSIENT", 300.0)
    work = Study(tmp_path, full=True)
    widths = {"channel1_width": 0.9, "channel2_width": 0.3}
    found = own_errors.measure(work, "wide", 20, widths, 1000.0)
    for name in ("chi", "polarised_current"):
        assert found[name]["told"] > 0.9, name
        assert 0.53 < found[name]["one"] < 0.86, name  # five standard deviations of 200 runs

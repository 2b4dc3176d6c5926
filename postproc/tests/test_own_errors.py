"""Errors of single runs: what the study says of made numbers, and of the program."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.accuracy import own_errors


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


@pytest.mark.full
def test_errors_of_runs_of_the_program_are_right(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wide openings, where directions relax in 32 time units: 200 runs of thirty times that."""
    monkeypatch.setattr(own_errors, "TRANSIENT", 300.0)
    found = own_errors.measure(20, {"channel1_width": 0.9, "channel2_width": 0.3}, 1000.0)
    for name in ("chi", "polarised_current"):
        assert found[name]["told"] > 0.9, name
        assert 0.53 < found[name]["one"] < 0.86, name  # five standard deviations of 200 runs

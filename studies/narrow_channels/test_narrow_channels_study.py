"""Limits and drawn visits with known answers; fits of exact lines."""

from __future__ import annotations

import math

import numpy as np
import pytest

from studies.common.geometry import urn_area
from studies.narrow_channels import study, visits


def test_return_chance_of_narrow_channels() -> None:
    assert visits.narrow_chance(1.0) == pytest.approx(1.0 / 3.0, abs=1e-12)
    assert visits.narrow_chance(1e-5) / 1e-5 == pytest.approx(4.0 / math.pi**2, rel=1e-4)
    assert visits.narrow_chance(0.1) == pytest.approx(0.0392626, abs=1e-7)  # w' = 0.003, w = 0.03


def test_deep_limit() -> None:
    assert visits.deep_limit(1.0) == pytest.approx(1.5, abs=1e-12)
    slope = 2.0 * (1.0 - 4.0 / math.pi**2)
    assert (visits.deep_limit(1e-5) - 1.0) / 1e-5 == pytest.approx(slope, rel=1e-4)
    assert visits.deep_ratio(0.3, 0.3 / 1.3) == pytest.approx(1.0)  # well mixed urns


def test_deep_limit_is_the_balance_of_two_ports_with_perfect_valves() -> None:
    """Dense gate shut, sparse gate open: e, f of both urns from linear equations."""
    ratio, stay1, stay2 = 0.3, 3.0, 2.0  # any stays do
    chance = visits.narrow_chance(ratio)
    across = ratio * (1.0 - chance)
    # unknown: what reaches the dense urn by channel 1, and f of the dense, of the sparse urn
    matrix = np.array([
        [across, -1.0, chance],  # f = P12 b + a f'
        [0.0, chance, -1.0],  # f' = a f, nothing comes into the sparse urn by channel 1
        [stay1, stay2, stay2],  # particles
    ])  # fmt: skip
    _, dense, sparse = np.linalg.solve(matrix, [0.0, 0.0, 1.0])
    well_mixed = ratio / (stay1 + ratio * stay2) / (1.0 + 2.0 * ratio)  # area by w t1 + w' t2
    assert (dense - sparse) / well_mixed == pytest.approx(visits.deep_limit(ratio), rel=1e-12)


def test_drawn_visits_return_as_often_as_theory_has() -> None:
    back, across, neither = visits.drawn_returns(0.3, 0.05 / 0.3, 100_000, longest=3000)
    total = back + across
    assert neither < 100
    assert 0.99 * 100_000 < total <= 100_000
    chance = 0.0624  # of w = 0.3, w' = 0.05
    assert abs(back / total - chance) < 4.0 * math.sqrt(chance / total)


def test_conductance_of_well_mixed_urns_is_one() -> None:
    assert urn_area(0.003, 0.1) == pytest.approx(3.1415092554226174, rel=1e-14)
    row = {"circuit": "D", "w": 0.1, "N": 3000.0, "chi": 0.25, "current_error": 0.0}
    row["current"] = 0.1 * 750.0 / (math.pi * urn_area(0.1, 0.1))
    assert study.conductance(row)["F"] == pytest.approx(1.0)


def test_halves_and_changes_of_sign() -> None:
    samples = np.array([[1.0, 3.0, -2.0, -4.0], [1.0, 1.0, 1.0, 1.0]])
    assert study.halves(samples).tolist() == [[2.0, -3.0], [1.0, 1.0]]
    assert study.changes_of_sign(samples) == 1


def test_extrapolation_of_exact_lines() -> None:
    width, error = np.array([0.3, 0.2, 0.1, 0.05]), np.full(4, 0.01)
    assert study.line(width, 1.2 + 0.5 * width, error)[0] == pytest.approx(1.2)
    rows = [{"w": one, "over_paper": 1.2 + one, "over_paper_error": 0.01,
             "over_theory": 1.0, "over_theory_error": 0.01} for one in width]  # fmt: skip
    found = study.extrapolated(rows, 1.2)
    assert found["runs"] == pytest.approx(1.2)
    assert found["parabola"] == pytest.approx(1.2)
    assert found["spread"] == pytest.approx(0.0, abs=1e-12)

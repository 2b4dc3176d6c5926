"""The renewal gate: its equations and its simulation agree with the fit that the product reads."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.theory.renewal import RENEWAL
from studies.renewal_gate import fit
from studies.renewal_gate.equations import share_of_one

pytestmark = pytest.mark.full  # a minute
ACCURACY = 2e-5


@pytest.fixture(scope="module")
def solved() -> dict[tuple[int, float, int, int], float]:
    keys = [(1, 1.0, 2, 16), (2, 2.0, 2, 16), (2, 2.0, 2, 8), (4, 3.0, 2, 8), (7, 12.0, 2, 8)]
    keys += [(3, 2.5, 3, 4), (3, 2.5, 2, 4), (30, 40.0, 2, 8)]
    return dict(zip(keys, fit.solve(np.array(keys, float)).tolist(), strict=True))


def test_equations_closed_at_pairs_are_exact_up_to_two_inside(
    solved: dict[tuple[int, float, int, int], float],
) -> None:
    exact = float(share_of_one(np.array([1.0]))[0])
    assert solved[1, 1.0, 2, 16] == pytest.approx(exact, abs=1e-4)
    one, other = solved[2, 2.0, 2, 8], solved[2, 2.0, 2, 16]
    assert other + (other - one) / (2.0**1.5 - 1.0) == pytest.approx(0.30931, abs=ACCURACY)


def test_fit_agrees_with_the_equations(
    solved: dict[tuple[int, float, int, int], float],
) -> None:
    # of these, what the cells' width and triples change is up to 1e-4
    for (threshold, load, _, _), share in solved.items():
        if threshold != 3:
            assert float(RENEWAL.share(threshold, load)) == pytest.approx(share, abs=1.2e-4)
    assert 0.0 < abs(solved[3, 2.5, 3, 4] - solved[3, 2.5, 2, 4]) < 1e-4


def test_simulation_agrees_with_the_fit() -> None:
    points = np.array([[2, 2.0], [7, 5.0], [1, 1.0]])
    shares, errors = fit.simulate(points, 400_000, processes=2)
    assert np.all(errors < 0.005)
    assert np.all(np.abs(RENEWAL.share(*points.T) - shares) < 4 * errors)

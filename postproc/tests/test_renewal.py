"""Renewal gate: exact cases, limits, and a simulation of its own."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from postproc.theory import fate
from postproc.theory.circuit import Circuit, eta, homogeneous_kind
from postproc.theory.renewal import RENEWAL, exponential_logit
from postproc.theory.states import stationary_states

ACCURACY = 2e-5


def simulated_share(load: float, threshold: int, gates: int, entries: int) -> tuple[float, float]:
    """Return the share and its error from `gates` gates side by side; l/2 = 1."""
    random = np.random.default_rng(11)
    leaves = np.zeros((gates, threshold))
    clock, emptied = np.zeros(gates), np.zeros((gates, 2))
    for entry in range(entries):
        clock += random.exponential(0.5 * np.pi / load, gates)
        oldest = leaves.argmin(axis=1)
        full = leaves[np.arange(gates), oldest] > clock
        sine = random.uniform(size=gates)
        leaves[np.arange(gates), oldest] = clock + 1.0 / np.sqrt(1.0 - sine**2)
        leaves[full] = 0.0
        emptied[:, int(entry >= entries // 4)] += full
    lost = (threshold + 1.0) * emptied[:, 1] / (entries - entries // 4)
    return 1.0 - lost.mean(), lost.std(ddof=1) / math.sqrt(gates)


def test_one_at_a_time_is_known_exactly() -> None:
    loads = np.linspace(0.01, 10.0, 300)
    stays, shares = fate.cosine_law(2.0 / math.pi, 200)  # 1 on average
    exact = [shares @ fate.passing(1, load, stays, shares) for load in loads]
    assert RENEWAL.share(1, loads) == pytest.approx(exact, abs=ACCURACY)


def test_two_at_a_time_from_the_first_passage_equations() -> None:
    # first-passage equations for the remaining times of up to two inside, solved by collocation
    assert float(RENEWAL.share(2, 2.0)) == pytest.approx(0.30931, abs=ACCURACY)


@pytest.mark.parametrize(
    ("load", "threshold"), [(2.0, 2), (12.0, 7), (5.0, 7), (20.0, 18), (33.0, 30)]
)
def test_share_agrees_with_a_simulation(load: float, threshold: int) -> None:
    share, error = simulated_share(load, threshold, gates=4000, entries=600)
    assert float(RENEWAL.share(threshold, load)) == pytest.approx(share, abs=4 * error + ACCURACY)


def test_fit_agrees_with_the_simulations_kept_with_it() -> None:
    checks = RENEWAL.fit["checks"]
    apart = [
        (float(RENEWAL.share(one["threshold"], one["load"])) - one["share"]) / one["error"]
        for one in checks
    ]
    assert max(map(abs, apart)) < 4.0
    assert np.mean(np.square(apart)) < 2.5
    assert RENEWAL.fit["largest_misfit"] < 1e-5


# Share in the limit of large T at loads rho T: 1 - filled/t, where filled = (pi/2)/rho is equal to
# t - sqrt(t^2 - 1) + arccos(1/t).
FLUID = {1.1: 0.5949488968, 1.25: 0.2370028107, 1.4: 0.0643695751}


@pytest.mark.parametrize("threshold", [10_000, 10**6, 10**9])
def test_gate_with_room_for_twice_as_many_lets_all_pass(threshold: int) -> None:
    assert float(RENEWAL.share(threshold, 0.5 * threshold)) == pytest.approx(1.0, abs=1e-15)


def test_many_particles_fill_a_gate_as_a_fluid() -> None:
    for ratio, expected in FLUID.items():
        apart = [abs(float(RENEWAL.share(t, ratio * t)) - expected) for t in (400, 10_000, 10**6)]
        assert apart[0] > apart[1] > apart[2]
        assert apart[2] < 2e-3
    # solutions of the equations closed at pairs, 8 cells
    for load, share in ((228.0, 0.42113), (271.5, 0.11750), (319.0, 0.00896)):
        assert float(RENEWAL.share(200, load)) == pytest.approx(share, abs=1e-3)


@pytest.mark.parametrize("load", [60.0, 90.0, 120.0, 150.0])
def test_no_jump_where_the_fit_ends(load: float) -> None:
    below, at, above = (float(RENEWAL.share(t, load)) for t in (99, 100, 101))
    assert above - at == pytest.approx(at - below, abs=1e-3)


def test_values_of_the_exact_description() -> None:
    assert float(RENEWAL.share(7, 12.0)) == pytest.approx(0.078, abs=1e-3)
    assert float(RENEWAL.share(2, 2.0)) == pytest.approx(0.307, abs=3e-3)


def test_limits() -> None:
    assert float(RENEWAL.share(0, 3.0)) == 0.0
    assert float(RENEWAL.share(5, 0.0)) == 1.0
    assert float(RENEWAL.share(25, 1.0)) == pytest.approx(1.0, abs=1e-12)
    assert float(RENEWAL.share(5, 200.0)) < 1e-6
    assert float(RENEWAL.log_share(0, 3.0)) == -math.inf


@pytest.mark.parametrize("threshold", [1, 2, 5, 10, 25, 60, 100])
def test_share_falls_with_the_load(threshold: int) -> None:
    loads = np.geomspace(1e-3, 4.0 * threshold + 20.0, 600)
    share = RENEWAL.share(threshold, loads)
    assert np.all(np.diff(share) < 1e-9)
    assert share.min() >= 0.0
    assert share.max() <= 1.0


@pytest.mark.parametrize("load", [0.5, 3.0, 12.0, 30.0])
def test_share_grows_with_the_threshold(load: float) -> None:
    shares = RENEWAL.share(np.arange(1, 101), load)
    assert all(one <= other + 1e-9 for one, other in itertools.pairwise(shares))


def test_exponential_times_by_linear_equations() -> None:
    threshold, load = 4, 2.7
    matrix = np.zeros((threshold + 1, threshold + 1))
    for inside in range(threshold + 1):
        matrix[inside, inside] = load + inside
        if inside:
            matrix[inside, inside - 1] = -inside
        if inside < threshold:
            matrix[inside, inside + 1] = -load
    entries = load * np.linalg.solve(matrix, np.ones(threshold + 1))[0]
    out = (threshold + 1) / entries
    assert float(exponential_logit(threshold, load)) == pytest.approx(math.log((1.0 - out) / out))


def test_slope_is_the_derivative() -> None:
    loads = np.linspace(0.5, 30.0, 40)
    step = 1e-3
    flows = [(loads + sign * step) * RENEWAL.share(9, loads + sign * step) for sign in (1, -1)]
    assert RENEWAL.slope(9, loads) == pytest.approx((flows[0] - flows[1]) / (2 * step), abs=1e-5)


def test_it_moves_the_diagram() -> None:
    near = Circuit(1000, 15, gate=RENEWAL)
    assert stationary_states(near)[-1].mass_spread == pytest.approx(0.623, abs=0.005)
    assert stationary_states(Circuit(1000, 15))[-1].mass_spread == pytest.approx(0.862, abs=0.001)
    four = Circuit(1000, 4, gate=RENEWAL)
    assert homogeneous_kind(four) == "unstable"
    assert homogeneous_kind(Circuit(1000, 4)) == "stable"


@pytest.mark.parametrize("threshold", [1, 3, 7, 15])
def test_roots_are_zeros(threshold: int) -> None:
    circuit = Circuit(1000, threshold, gate=RENEWAL)
    for state in stationary_states(circuit):
        assert float(eta(circuit, state.urn2_number)) == pytest.approx(0.0, abs=1e-8)

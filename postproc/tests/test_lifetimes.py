"""Lifetimes: the chain against direct solutions and known distributions."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from postproc.figures.passages import first_passage
from postproc.tests.commands import call
from postproc.theory import chain
from postproc.theory.circuit import Circuit
from postproc.theory.renewal import RENEWAL
from postproc.theory.states import WELL_MIXED


def _generator(circuit: Circuit) -> np.ndarray:
    up, down = (np.exp(rates) for rates in chain.log_rates(circuit))
    return np.diag(up[:-1], 1) + np.diag(down[1:], -1) - np.diag(up + down)


def _distribution(circuit: Circuit) -> np.ndarray:
    return np.exp(chain.log_weights(*chain.log_rates(circuit)))


def test_free_circuit_is_binomial() -> None:
    circuit = Circuit(60, 60)
    expected = stats.binom.pmf(np.arange(61), 60, 0.5)
    assert _distribution(circuit) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("threshold", [1, 3])
def test_distribution_is_stationary_and_symmetric(threshold: int) -> None:
    circuit = Circuit(51, threshold, channel1_length=8.0)
    weights = _distribution(circuit)
    assert weights @ _generator(circuit) == pytest.approx(0.0, abs=1e-12)
    assert weights == pytest.approx(weights[::-1], rel=1e-9)


def test_peaks_between_places_are_kept() -> None:
    """Two equal neighbours next to a peak: what is sent goes on rising between them."""
    places = np.linspace(0.0, 1.1, 12)
    values = np.stack([-(((places - 0.55) / 0.3) ** 2), places**3])
    found = chain.between(places[::-1], values[:, ::-1], [0.55, 0.2, -3.0, 7.0])
    assert found[0] == pytest.approx([0.0, -1.3611, values[0, 0], values[0, -1]], abs=1e-3)
    assert found[1] == pytest.approx([0.55**3, 0.008, 0.0, 1.1**3], abs=1e-9)


def test_mean_passage_time_solves_the_linear_equations() -> None:
    circuit = Circuit(40, 2, channel1_length=8.0)
    stop = 30
    inside = _generator(circuit)[:stop, :stop]
    expected = np.linalg.solve(inside, -np.ones(stop))
    rates = chain.log_rates(circuit)
    for start in (0, 11, 29):
        assert chain.time_up(*rates, start, stop) == pytest.approx(expected[start], rel=1e-9)


@pytest.mark.parametrize("number", [40, 41])
def test_folding_keeps_the_time_to_leave_the_middle(number: int) -> None:
    circuit = Circuit(number, 2, channel1_length=8.0)
    middle, reach = (number + 1) // 2, 8
    low, high = number - middle - reach, middle + reach
    inside = _generator(circuit)[low + 1 : high, low + 1 : high]
    expected = np.linalg.solve(inside, -np.ones(inside.shape[0]))[middle - low - 1]
    rates = chain.folded(*chain.log_rates(circuit))
    assert chain.time_up(*rates, 0, reach) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("number", [40, 41])
def test_passage_times_solve_the_linear_equations(number: int) -> None:
    circuit = Circuit(number, 2, channel1_length=8.0)
    second = np.arange(number + 1)
    spread = np.abs(2.0 * second - number) / number
    right = (spread > 0.2) & (2 * second > number)
    for inside, start, at in ((spread < 0.7, number // 2, 0), (right, number, 1)):
        equations = _generator(circuit)[np.ix_(inside, inside)]
        times = np.linalg.solve(equations, -np.ones(inside.sum()))
        expected = times[np.flatnonzero(inside).tolist().index(start)]
        found = chain.passage_times(circuit, 0.2, 0.7)[at]
        assert found == pytest.approx(expected, rel=1e-9)


def test_states_that_are_not_there_or_never_left() -> None:
    free = chain.lifetimes(Circuit(1000, 18))
    assert math.isinf(free.homogeneous)
    assert free.polarised == 0.0
    battery = chain.lifetimes(Circuit(1000, 7))
    assert battery.homogeneous == 0.0
    assert math.isinf(battery.polarised)
    few = chain.lifetimes(Circuit(4, 1, 1.9, 0.001, channel1_length=60.0))
    assert few.polarised > 0.0  # though its barrier is nearest to N


def test_of_two_polarised_states_the_outer_one_is_left_for_the_unstable_one_between() -> None:
    """Above T = 47 the renewal gate has two polarised states beside an unstable homogeneous one."""
    circuit = Circuit(4017, 60, channel2_width=0.01687, gate=RENEWAL)
    *_, unstable, outer = WELL_MIXED.states(circuit)
    found = chain.lifetimes(circuit)
    assert (found.homogeneous, unstable.kind, outer.kind) == (0.0, "unstable", "stable")
    assert found.barrier == pytest.approx(2.0 * unstable.urn2_number / 4017 - 1.0)
    assert found.polarised == pytest.approx(1935.94, rel=1e-4)  # by a chain of one's own
    assert found.polarised_share == pytest.approx(3.65e-4, rel=1e-2)


def test_a_state_that_nothing_leaves_lasts_for_ever() -> None:
    closed = Circuit(20, 0, channel2_width=0.0)
    with np.errstate(all="raise"):
        assert chain.passage_times(closed, 0.2, 0.7) == (math.inf, math.inf)


def test_lifetimes_grow_with_the_number_of_particles() -> None:
    found = [
        chain.lifetimes(Circuit(number, 2, channel1_length=1000 / number))
        for number in (250, 500, 1000)
    ]
    for one, other in itertools.pairwise(found):
        assert 1.0 < one.polarised < other.polarised
        assert 1.0 < one.homogeneous < other.homogeneous


def test_first_passage_in_a_series() -> None:
    time = np.arange(1.0, 6.0)
    series = xr.Dataset({"chi": ("time", [1.0, 0.8, 0.4, 0.0, 0.0])}, {"time": time})
    assert first_passage(series, 0.5, below=True) == (3.0, True)
    assert first_passage(series, 0.4, below=True) == (3.0, True)  # as the chain counts
    assert first_passage(series[{"time": slice(None, None, -1)}], 0.8, below=False) == (2.0, True)
    assert first_passage(series, -1.0, below=True) == (5.0, False)


def test_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("lifetimes", ["--number", "1000", "--threshold", "2"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["barrier"] == pytest.approx(0.7484, abs=1e-4)
    assert printed["homogeneous"] > printed["polarised"] > 0.0

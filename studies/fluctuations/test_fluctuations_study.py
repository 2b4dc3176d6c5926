"""Known answers for the functions of the study of fluctuations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import skellam

from postproc.theory.circuit import Circuit
from studies.event_log import CROSSING2, Log
from studies.event_log import Circuit as Table
from studies.fluctuations.averages import (
    jackknife,
    moment_totals,
    moments,
    ratio_totals,
    slope_and_difference,
    summed,
)
from studies.fluctuations.counting import Chain, frozen_slope, renewal_chain
from studies.fluctuations.logs import passages, round_time
from studies.fluctuations.study import without_repeats
from studies.fluctuations.trains import Trains, begun, powers_in_window


def two_states() -> Chain:
    """Return a chain of two states, whose two channels close one cycle."""
    return Chain(np.array([1.0, 2.0]), np.array([0.7, 0.0]), np.array([0.1, 0.0]),
                 np.array([0.0, 0.2]), np.array([0.0, 0.9]))  # fmt: skip


def test_a_chain_with_one_cycle_obeys_the_relation_of_its_affinity() -> None:
    chain = two_states()
    cycle = math.log(0.7 * 0.9 / (0.1 * 0.2))
    assert chain.affinity == pytest.approx(cycle)
    assert chain.last_slope() == pytest.approx(cycle, rel=1e-4)
    assert chain.growth(-0.3) == pytest.approx(chain.growth(0.3 - cycle))
    late = chain.slopes((60.0, 120.0), (1, 2), tilt=-0.5 * cycle, size=256)
    assert np.abs(late[1] - cycle).max() < np.abs(late[0] - cycle).max() < 0.1


def test_growth_has_the_mean_and_the_bound_of_the_variance() -> None:
    chain = two_states()
    with_, against = chain.flows2
    mean = (chain.growth(1e-4) - chain.growth(-1e-4)) / 2e-4
    assert mean == pytest.approx(with_ - against, rel=1e-6)
    assert 2.0 * mean / chain.last_variance() <= chain.affinity


def test_fixed_rates_obey_the_relation() -> None:
    slope = frozen_slope(np.ones(3), np.full(3, 0.9), np.full(3, 0.3), 2.0, 3)
    assert slope == pytest.approx(math.log(3.0))


def test_frozen_rates_lower_the_slope() -> None:
    rates = np.array([0.5, 1.5])
    mixed = frozen_slope(np.ones(2), rates[::-1] * 4.0, rates, 1.0, 2)
    weight = [skellam.pmf(2, 4.0 * a, b) for a, b in zip(rates[::-1], rates, strict=True)]
    back = [skellam.pmf(-2, 4.0 * a, b) for a, b in zip(rates[::-1], rates, strict=True)]
    assert mixed == pytest.approx(math.log(sum(weight) / sum(back)) / 2.0)
    assert mixed < math.log(4.0)


def test_renewal_chain_has_the_theory_s_current() -> None:
    chain = renewal_chain(Circuit(1000, 7))
    with_, against = chain.flows2
    assert with_ - against == pytest.approx(0.9393, abs=2e-4)
    assert chain.last_variance() == pytest.approx(0.8825, abs=5e-4)
    assert chain.affinity == pytest.approx(7.05, abs=0.01)


def test_a_chain_of_unlike_gates_has_all_states() -> None:
    chain = renewal_chain(Circuit(40, 40, 0.6, channel2_width=0.06, gate2_threshold=1))
    assert chain.number2.tolist() == list(range(41))
    assert chain.up1[-1] == chain.down1[0] == 0.0
    assert chain.stationary @ chain.number2 == pytest.approx(31.4, abs=1.0)


@pytest.mark.parametrize("time", [0.7, 2.0, 5.0, 11.3, 400.0])
def test_crossings_in_a_window_are_counted_once(time: float) -> None:
    crossings, period = np.array([2.0, 3.0, 7.0, 50.0]), 2.0
    mean = powers_in_window(crossings, period, time, 1)
    assert mean == pytest.approx(crossings * time)
    begin = np.linspace(-time, 50.0 * period, 200_001)
    for many in crossings:
        first = np.clip(np.ceil(begin / period), 0.0, many)
        inside = np.clip(np.ceil((begin + time) / period), 0.0, many) - first
        integral = (inside**2).mean() * (begin[-1] - begin[0])
        exact = powers_in_window(np.array([many]), period, time, 2)[0]
        assert integral == pytest.approx(exact, rel=2e-3)


def test_probabilities_with_trains_have_their_moments() -> None:
    model = Trains(np.array([0.01, 0.0, 0.02]), 1.5, 0.5, 0.1)
    assert model.current == pytest.approx(0.5 - 0.1 + 0.02 + 0.08)
    several = model.in_window(4.0)
    k = np.arange(several.size)
    for order in (1, 2, 3):
        others = 0.5 + (-1) ** order * 0.1
        assert model.cumulant(order, 4.0) == pytest.approx(others + several @ k**order / 4.0)
    alone = Trains(np.zeros(1), 1.5, 0.5, 0.1)
    assert alone.slopes(4.0, (1, 3)) == pytest.approx(math.log(5.0))


def test_below_a_round_trains_are_independent_crossings() -> None:
    model = Trains(np.array([0.01, 0.0, 0.02]), 1.5, 0.5, 0.1)
    assert model.slopes(1.4, (1, 2)) == pytest.approx(math.log(6.0))
    # at long times P(j) falls as exp(-s j), with s where the generating function is least
    x = brentq(lambda x: 0.5 * x + 0.02 * x**2 + 0.08 * x**4 - 0.1 / x, 0.1, 1.0)
    assert model.slopes(60.0, (1,))[0] == pytest.approx(-2.0 * math.log(x), abs=0.003)


def test_trains_begin_as_often_as_the_page_of_circulation_has_it() -> None:
    rate, period = begun(Circuit(1000, 7))
    assert period == pytest.approx(5.98, abs=0.01)
    assert (rate >= 0.0).all()
    assert rate[7:].sum() == pytest.approx(3.42e-4, rel=0.03)  # nine crossings and more


def test_repeats_are_passages_one_round_later() -> None:
    circuit = Table()
    period = round_time(circuit)
    time = np.array([1.0, 2.0, 1.0 + period, 9.0, 1.001 + 2.0 * period])
    where, particle = np.array([21, 12, 21, 12, 21]), np.array([4, 5, 4, 5, 4])
    log = Log(time, np.full(5, CROSSING2), where, particle)
    found = passages(log, circuit)
    assert found.repeat.tolist() == [False, True, True, False, False]
    start, sign, many = found.trains
    assert start.tolist() == [1.0, 2.0, 9.0]
    assert sign.tolist() == [1, -1, -1]
    assert many.tolist() == [3, 1, 1]
    assert found.counts(0.0, 20.0, 10.0, repeats=True).tolist() == [0, 1]
    assert found.counts(0.0, 20.0, 10.0, repeats=False).tolist() == [-1, 0]


def test_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.array([1.0, 4.0, 2.0, 7.0])
    mean, error = jackknife(np.column_stack([values, np.ones(4)]), lambda one: one[0] / one[1])
    assert mean == pytest.approx(3.5)
    assert error == pytest.approx(values.std(ddof=1) / 2.0)


def test_moments_and_ratios_of_known_counts() -> None:
    counts = np.array([[0, 2, 0, 2], [2, 0, -2, 4]])
    numbers = counts * 0.5
    found = moments(moment_totals(counts, numbers, 1.0).sum(axis=0))
    assert found[0] == pytest.approx(counts.var())
    assert found[2] == pytest.approx(counts.var())
    assert summed(counts, 2).tolist() == [[2, 2], [2, 2]]
    totals = ratio_totals(counts, 2, np.array([[3.0, 1.0], [3.0, 1.0]])).sum(axis=0)
    assert totals.tolist() == [3.0, 1.0, 6.0, 2.0]
    slope, difference = slope_and_difference(totals, 2)
    assert slope == pytest.approx(math.log(3.0) / 2.0)
    assert difference == pytest.approx(-math.log(3.0) / 2.0)


def test_effect_of_repeats_is_a_difference_of_slopes() -> None:
    every, once = [2, 2, 2, 2, -2], [2, 2, -2, 0, 0]
    value, error = without_repeats(np.array([[every, once]] * 3), 1, 2)
    assert value == pytest.approx((math.log(4.0) - math.log(2.0)) / 2.0)
    assert error == pytest.approx(0.0, abs=1e-12)

"""The order of the transition: what the gate's rule says, against other ways to the same.

And statistics of runs against samples with known answers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from postproc.study import Study
from studies.common.theories import told
from studies.order_of_transition import channels, later, prediction, samples
from studies.order_of_transition import study as order

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(("threshold", "ratio"), [(7, 1.681), (28, 1.472)])
def test_jump_begins_at_the_tricritical_load(threshold: int, ratio: float) -> None:
    # as `postproc.theory --tricritical` has it, from derivatives at equal halves
    assert prediction.transition(threshold, 0.99 * ratio * threshold).jump == 0.0
    assert prediction.transition(threshold, 1.01 * ratio * threshold).jump > 0.1


def test_small_loads_have_a_jump_from_some_threshold_up() -> None:
    assert len(prediction.ranges(40, order.RATIOS)) == 1
    small = order.RATIOS[order.RATIOS < 1.2]  # below the range that all thresholds have
    ((low, high, *_),) = prediction.ranges(64, small)
    assert (low, high) == pytest.approx((0.78, 0.80), abs=0.011)


@pytest.mark.usefixtures("theory_in_process")
def test_two_ports_have_the_states_of_the_curve() -> None:
    case = order.CASES["A"]
    found = prediction.transition(case.threshold, case.load)
    ends = [prediction.width_of(k) for k in (found.homogeneous, found.polarised)]
    number = 10**6  # no particle to speak of is in the channels
    for place, (homogeneous, stable) in {
        -0.2: ("unstable", 1), 0.1: ("stable", 1), 0.9: ("stable", 1), 1.1: ("stable", 0),
    }.items():  # fmt: skip
        found_states = told(
            "two_port", number=number, threshold=case.threshold,
            channel1_length=case.reach / number,
            channel2_width=ends[0] + place * (ends[1] - ends[0]),
        )  # fmt: skip
        assert found_states["homogeneous"] == homogeneous
        assert [one["kind"] for one in found_states["roots"]].count("stable") == stable


def test_barrier_of_a_large_circuit_is_that_of_the_chain() -> None:
    case = order.CASES["A"]
    found = prediction.transition(case.threshold, case.load)
    deepest, lowest = prediction.chain(case.threshold, case.load, 4000, found)
    assert deepest == pytest.approx(found.barrier * 4000, rel=0.02)
    assert lowest < -10.0


def test_barrier_is_of_the_lower_mode() -> None:
    counts = np.array([8.0, 4.0, 1.0, 2.0, 16.0, 3.0])
    assert samples.barrier(counts) == pytest.approx(np.log(8.0))
    assert samples.barrier(np.array([1.0, 3.0, 7.0, 5.0])) == 0.0


def test_cumulant_of_two_signs_and_of_a_gaussian() -> None:
    assert samples.cumulant(np.array([1.0, -1.0, 1.0])) == pytest.approx(2.0 / 3.0)
    gaussian = np.random.default_rng(1).normal(size=200000)
    assert samples.cumulant(gaussian) == pytest.approx(0.0, abs=0.02)


def test_loads_with_channels_are_those_of_two_ports() -> None:
    whole = channels.load(channels.circuit(5, 1000, 1000, channels.NARROWEST))
    assert channels.load_beside(5, 1000, 1000, 0.0) == pytest.approx(whole, rel=1e-3)
    assert whole / 5 == pytest.approx(2.363, abs=1e-3)
    # a channel 2 of 0.2 holds 3 % of the particles
    assert channels.load_with_discs(7, 1000, 4000, 0.016) / 7 == pytest.approx(1.650, abs=1e-3)


def test_a_large_circuit_has_particles_in_channel_2_alone() -> None:
    case, number = order.CASES["A"], 10**6
    found = channels.finite(case.threshold, case.reach, number)
    known = prediction.transition(case.threshold, found.load)
    assert found.load == pytest.approx(case.load * (1.0 - 0.031 / (2.0 * np.pi)), rel=2e-3)
    assert found.homogeneous == pytest.approx(prediction.width_of(known.homogeneous), rel=0.01)
    assert found.polarised == pytest.approx(prediction.width_of(known.polarised), rel=0.01)
    assert found.equal == pytest.approx(prediction.width_of(known.equal), rel=0.02)
    # `prediction` has k times the load for the flow through channel 2, `two_port` less: w'/w
    more = 1.0 + found.equal / prediction.WIDTH  # to the first order
    assert found.barrier / number == pytest.approx(more * known.barrier, rel=0.05)
    assert found.jump == pytest.approx(known.jump, abs=0.03)


def test_circuit_b_of_few_particles_is_below_the_tricritical_load() -> None:
    found = channels.finite(7, 1000, 1000)
    assert found.load / 7 < 1.681
    assert found.jump == found.barrier == 0.0


def test_passages_need_both_states() -> None:
    chi = np.array([0.1, 0.3, 0.5, 0.3, 0.5, 0.1, 0.2, 0.1])
    times = np.arange(8.0)
    assert samples.passages(chi) == 2
    assert samples.left_at(chi, times, 0.0) == 2.0
    assert samples.left_at(chi, times, 0.9) == 0.0
    assert np.isnan(samples.left_at(chi[:2], times[:2], 0.0))


def test_values_at_the_edge_of_bins_are_of_the_upper_one() -> None:
    number = 250
    spread = np.abs(2.0 * np.arange(number + 1) / number - 1.0)
    counts = samples.histogram(spread)
    assert counts[0] == 9.0  # 0 has one sign
    assert set(counts[1:-1]) == {10.0}


def test_correlation_time_of_an_autoregression() -> None:
    kept, draw = 0.8, np.random.default_rng(2)
    noise = draw.normal(size=(20, 20000))
    runs = np.zeros_like(noise)
    for at in range(1, runs.shape[1]):
        runs[:, at] = kept * runs[:, at - 1] + noise[:, at]
    known = 20.0 * 0.5 * (1.0 + kept) / (1.0 - kept)
    assert samples.correlation_time(runs, 20.0) == pytest.approx(known, rel=0.05)


def test_bootstrap_of_a_mean_has_its_standard_error() -> None:
    runs = np.random.default_rng(3).normal(size=(50, 1))
    found = samples.bootstrap(lambda sums: sums[:, 0] / 50, runs)
    assert found.value == pytest.approx(runs.mean())
    assert found.error == pytest.approx(runs.std() / np.sqrt(50), rel=0.1)


def test_equal_weight_is_where_both_states_weigh_the_same() -> None:
    shape = np.array([4.0, 1.0, 0.0, 0.0, 0.0, 1.0, 4.0])
    beyond = np.arange(7) > 3
    rows = np.array([np.where(beyond, shape * ratio, shape) for ratio in (4.0, 1.0, 0.25)])
    assert samples.equal_weight(np.array([1.0, 2.0, 3.0]), rows) == pytest.approx(2.0)
    assert np.isnan(samples.equal_weight(np.array([1.0]), rows[:1]))


def test_line_through_points_on_a_line() -> None:
    found = samples.line([1.0, 2.0, 3.0], [3.0, 5.0, 7.0], [1.0, 1.0, 1.0])
    assert (found.slope, found.height, found.misfit) == pytest.approx((2.0, 1.0, 0.0), abs=1e-9)
    assert found.slope_error == pytest.approx(np.sqrt(0.5))


def test_cumulants_of_mean_field_models() -> None:
    assert samples.mean_field_cumulant(2) == pytest.approx(0.0, abs=1e-12)
    assert samples.mean_field_cumulant(4) == pytest.approx(0.2705, abs=1e-4)
    assert samples.mean_field_cumulant(6) == pytest.approx(1.0 / 3.0)


def test_crossing_of_two_straight_lines() -> None:
    width = np.array([1.0, 2.0])
    values = np.array([[0.4, 0.2], [0.5, 0.1]])
    chi = np.array([[0.4, 0.4], [0.2, 0.2]])
    exact = (np.stack([one, np.zeros_like(one)], axis=-1) for one in (values, chi))
    found = samples.crossing(width, (1000.0, 4000.0), *exact)
    assert (found.width[0], found.cumulant[0]) == pytest.approx((1.5, 0.3))
    assert found.exponent[0] == pytest.approx(0.5)


def test_tables_of_the_page_follow_from_its_runs(tmp_path: Path) -> None:
    work = Study(tmp_path)
    made = later.widths_of(later.read(work, "runs"))
    for row, kept in zip(made, later.read(work, "later"), strict=True):
        for key in ("barrier", "barrier_error", "cumulant", "cumulant_error"):
            assert later.text(float(row[key])) == later.text(float(kept[key]))
        assert row["passages"] == kept["passages"]

"""The order of the transition: predictions against independent methods."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from postproc.study import Study
from studies.order_of_transition import prediction
from studies.order_of_transition import study as order

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(("threshold", "ratio"), [(7, 1.681), (28, 1.472)])
def test_jump_begins_at_the_tricritical_load(threshold: int, ratio: float) -> None:
    # from `postproc.theory --tricritical`, by derivatives at equal halves
    assert prediction.transition(threshold, 0.99 * ratio * threshold).jump == 0.0
    assert prediction.transition(threshold, 1.01 * ratio * threshold).jump > 0.1


def test_small_loads_have_a_jump_from_some_threshold_up() -> None:
    assert len(prediction.ranges(40, order.RATIOS)) == 1
    low, high = prediction.ranges(64, order.RATIOS)[0][:2]
    assert (low, high) == pytest.approx((0.78, 0.80), abs=0.011)


def test_two_ports_have_the_states_of_the_curve(tmp_path: Path) -> None:
    case = order.CASES["A"]
    found = prediction.transition(case.threshold, case.load)
    ends = [prediction.width_of(k) for k in (found.homogeneous, found.polarised)]
    number = 10**6  # the number in the channels is negligible
    for place, (homogeneous, stable) in {
        -0.2: ("unstable", 1), 0.1: ("stable", 1), 0.9: ("stable", 1), 1.1: ("stable", 0),
    }.items():  # fmt: skip
        theory = Study(tmp_path).theory(
            "two_port", number=number, threshold=case.threshold,
            channel1_length=case.reach / number,
            channel2_width=ends[0] + place * (ends[1] - ends[0]),
        )  # fmt: skip
        assert theory["homogeneous"] == homogeneous
        assert [one["kind"] for one in theory["roots"]].count("stable") == stable


def test_barrier_of_a_large_circuit_is_that_of_the_chain() -> None:
    case = order.CASES["A"]
    found = prediction.transition(case.threshold, case.load)
    deepest, lowest = prediction.chain(case.threshold, case.load, 4000, found)
    assert deepest == pytest.approx(found.barrier * 4000, rel=0.02)
    assert lowest < -10.0


def test_barrier_is_of_the_lower_mode() -> None:
    counts = np.array([8.0, 4.0, 1.0, 2.0, 16.0, 3.0])
    assert order.barrier(counts) == pytest.approx(np.log(8.0))
    assert order.barrier(np.array([1.0, 3.0, 7.0, 5.0])) == 0.0


def test_cumulant_of_two_signs_and_of_a_gaussian() -> None:
    assert order.cumulant(np.array([1.0, -1.0, 1.0])) == pytest.approx(2.0 / 3.0)
    gaussian = np.random.default_rng(1).normal(size=200000)
    assert order.cumulant(gaussian) == pytest.approx(0.0, abs=0.02)

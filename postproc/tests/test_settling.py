"""Directions that lag behind N2: the chain in two variables, where it is known what comes out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from postproc.theory import chain, direction
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS
from postproc.theory.settling import Settling, settling
from postproc.theory.states import Theory

THEORY = MODELS["direction"].theory
ONE = MODELS["direction"].of(Circuit(100, 1, channel1_length=3.8))


@pytest.fixture(scope="module")
def slow() -> Settling:
    return settling(ONE)


@pytest.mark.parametrize("number", [40, 41])
@pytest.mark.parametrize("time", [0.1, 30.0, 1e4])
def test_what_does_not_depend_on_directions_is_the_chain(number: int, time: float) -> None:
    """Whatever they do, N2 is then a birth-death chain, whose times are known."""
    places = np.linspace(0.0, number, 12)
    sent = np.stack([-1.0 + 2.0 * places / number, 1.0 - 2.0 * places / number])
    sent += 0.5 * np.cos(6.0 * (places / number - 0.5))
    known = Theory(outflows=lambda _: (places, sent))
    settled = np.linspace(0.0, number, 7)
    two = np.repeat(sent.T[:, None], settled.size, axis=1)
    found = Settling(number, places, settled, two, time).passage
    up, down = chain.folded(*chain.log_rates(Circuit(number, 2), known))
    last = up.size - 1
    for start, stop in ((0, 1), (0, 12), (3, 9)):
        assert found(start, stop) == pytest.approx(chain.time_up(up, down, start, stop), rel=1e-3)
    for start, stop in ((last, 3), (9, 8)):
        expected = chain.time_up(down[::-1], up[::-1], last - start, last - stop)
        assert found(start, stop) == pytest.approx(expected, rel=1e-3)


def test_lifetimes_scale_with_the_unit_of_time(slow: Settling) -> None:
    unit = 1e10
    other = replace(slow, sent=slow.sent - math.log(unit), time=unit * slow.time)
    stop = int(0.35 * slow.number)
    assert other.passage(0, stop) == pytest.approx(unit * slow.passage(0, stop), rel=1e-6)


def test_settled_directions_send_what_is_sent(slow: Settling) -> None:
    second, sent = direction.outflows(ONE)
    for at, (one, other) in enumerate(sent.T):
        up, down = slow.rates(second[at : at + 1], second[at : at + 1])
        assert np.log(up).item() == pytest.approx(one, abs=0.01)
        assert np.log(down).item() == pytest.approx(other, abs=0.01)


def test_directions_that_settle_at_once_are_the_settled_chain(slow: Settling) -> None:
    settled = replace(THEORY, passages=None)
    quick = replace(THEORY, passages=lambda _: replace(slow, time=0.01).passage)
    for one, other in zip(
        chain.passage_times(ONE, 0.2, 0.7, theory=quick),
        chain.passage_times(ONE, 0.2, 0.7, theory=settled),
        strict=True,
    ):
        assert one == pytest.approx(other, rel=0.03)


def test_free_particles_do_not_know_of_the_lag() -> None:
    """No gate asks for directions then, so the chain is that of the settled circuit."""
    circuit = MODELS["direction"].of(Circuit(12, 12, channel2_width=0.05))
    late = settling(circuit)
    assert np.ptp(late.sent, axis=1) == pytest.approx(0.0, abs=1e-9)
    settled, _ = chain.passages(circuit, replace(THEORY, passages=None))
    for time in (1.0, 1e4):
        found = replace(late, time=time).passage
        for start, stop in ((0, 3), (6, 1)):
            assert found(start, stop) == pytest.approx(settled(start, stop), rel=0.01)


def test_lag_shortens_what_fluctuations_must_bring_about(slow: Settling) -> None:
    """An urn that fills by chance is not yet crowded by oblique particles, and is held less."""
    assert 100.0 < slow.time < 900.0
    late = chain.passage_times(ONE, 0.2, 0.7, theory=THEORY)
    settled = chain.passage_times(ONE, 0.2, 0.7, theory=replace(THEORY, passages=None))
    assert late[0] < 0.95 * settled[0]
    assert late[1] < 0.95 * settled[1]


def test_lifetimes_beyond_rounding_are_endless(slow: Settling) -> None:
    bound = replace(slow, sent=slow.sent + 40.0 * np.stack(
        [0.5 - slow.places2 / 100.0, slow.places2 / 100.0 - 0.5], axis=1
    )[:, None])  # fmt: skip
    assert math.isinf(bound.passage(0, 35))
    assert math.isfinite(bound.passage(49, 10))

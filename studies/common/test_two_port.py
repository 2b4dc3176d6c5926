"""Urns that remember the opening of entry: limits, identities, the conductance measured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from postproc.theory import circulation, ports, states
from postproc.theory.circuit import Circuit, transition_width
from postproc.theory.gates import WINDOW
from postproc.theory.models import MODELS
from postproc.theory.renewal import RENEWAL
from studies.common import two_port
from studies.common.theories import THEORIES

PAPER = Circuit(1000, 7, gate=RENEWAL)
# w', I/(G0 chi N) over both maps of Fig. numris (chi > 0.5, T >= 6), about +- 0.01
CONDUCTANCES = ((0.004, 1.043), (0.010, 1.080), (0.020, 1.127), (0.032, 1.164),
                (0.046, 1.181), (0.062, 1.188), (0.073, 1.189))  # fmt: skip


@pytest.mark.parametrize("gate", [WINDOW, RENEWAL])
@pytest.mark.parametrize("threshold", [2, 7, 15, 18])
@pytest.mark.parametrize("unlike", [{}, {"gate2_threshold": 9, "urn2_radius": 1.3}])
def test_well_mixed_urns_are_in_the_states_of_as_many_particles_as_they_hold(
    gate: object, threshold: int, unlike: dict[str, float]
) -> None:
    """The theories of the package have all particles in the urns."""
    circuit = Circuit(900, threshold, 0.4, 0.02, 1.2, 0.8, 1.3, gate=gate, **unlike)
    for state in two_port.stationary_states(circuit, ports.well_mixed):
        inside = two_port.with_number2(circuit, state.urn2_number, ports.well_mixed).in_urn[:, 0]
        found = states.stationary_states(replace(circuit, number=inside.sum()))
        one = min(found, key=lambda one: abs(one.urn2_number - inside[1]))
        assert one.kind == state.kind
        assert one.urn2_number == pytest.approx(inside[1], rel=1e-6)
        assert one.net_current == pytest.approx(state.net_current, rel=1e-5)


@pytest.mark.parametrize("threshold", [3, 7, 14])
def test_well_mixed_urns_turn_stable_where_as_many_as_they_hold_do(threshold: int) -> None:
    circuit = replace(PAPER, threshold=threshold)
    width = THEORIES["renewal_occupation"].theory.transition_width(circuit)
    at = two_port.balance(replace(circuit, channel2_width=width), 500.0, ports.well_mixed)
    fewer = replace(circuit, number=float(at.in_urn.sum()))
    assert transition_width(fewer) == pytest.approx(width, rel=1e-4)


def test_particles_in_channels_move_the_battery_to_smaller_thresholds() -> None:
    for threshold, moved in ((3, 1), (5, 1), (14, -1), (15, -1), (16, -1)):
        circuit = replace(PAPER, threshold=threshold)
        counted = THEORIES["renewal_occupation"].theory.transition_width(circuit)
        assert moved * (counted - transition_width(circuit)) > 0.0


def test_a_free_circuit_is_filled_uniformly() -> None:
    circuit = replace(PAPER, threshold=1000, channel2_width=0.2)
    area = float(circuit.urn_area)
    inside = two_port.balance(circuit, 500.0, ports.well_mixed).in_urn[:, 0]
    assert inside == pytest.approx(2 * [500.0 * area / (area + 0.15 + 0.1)], rel=1e-9)


def test_flows_of_urns_held_apart_are_balanced() -> None:
    circuit = replace(
        PAPER, urn2_radius=1.3, gate2_threshold=9, channel1_length=0.7, channel2_length=2.0
    )
    at = two_port.balance(circuit, np.array([30.0, 400.0, 900.0]))
    sign = np.array([[1.0], [-1.0]])
    arriving, back = at.across[::-1], at.entries - sign * at.net_current
    for urn, side in enumerate(circuit.sides):
        port = ports.disc(side)
        out1 = (1.0 - port.across) * back[urn] + (1.0 - port.return_chance) * arriving[urn]
        out2 = port.across * back[urn] + port.return_chance * arriving[urn]
        assert at.entries[urn] == pytest.approx(out1, rel=1e-12)
        assert at.across[urn] == pytest.approx(out2, rel=1e-9)
        inside = port.stay1 * back[urn] + port.stay2 * arriving[urn]
        assert at.in_urn[urn] == pytest.approx(inside, rel=1e-12)
    assert at.in_half.sum(axis=0) == pytest.approx(1000.0, rel=1e-12)


def test_in_a_state_the_gates_send_what_channel_2_returns() -> None:
    for circuit in (PAPER, replace(PAPER, threshold=15, urn_radius=2.0, number=4000)):
        (first, _), *_ = two_port._roots(circuit, ports.disc)
        at = two_port.balance(circuit, first)
        net = float(at.through[0, 0] - at.through[1, 0])
        assert net == pytest.approx(float(at.net_current[0]), rel=1e-8)
        apart = float(at.in_urn[1, 0] - at.in_urn[0, 0])
        assert net == pytest.approx(ports.disc(circuit).conductance * apart, rel=1e-8)


def test_exchange_of_unlike_urns_mirrors_the_states() -> None:
    one = replace(PAPER, urn2_radius=1.2, gate2_threshold=9)
    other = replace(PAPER, urn_radius=1.2, urn2_radius=1.0, threshold=9, gate2_threshold=7)
    found, mirrored = two_port.stationary_states(one), two_port.stationary_states(other)[::-1]
    assert len(found) == len(mirrored) > 1
    for state, image in zip(found, mirrored, strict=True):
        assert state.kind == image.kind
        assert state.urn2_number == pytest.approx(1000.0 - image.urn2_number, rel=1e-6)
        assert state.net_current == pytest.approx(-image.net_current, rel=1e-5)


def test_equal_urns_given_twice_are_those_given_once() -> None:
    twice = replace(PAPER, urn2_radius=1.0, gate2_threshold=7)
    assert twice.alike
    assert two_port.stationary_states(twice) == two_port.stationary_states(PAPER)


def test_battery_at_seven() -> None:
    # measured: 0.92909, current 0.9751 +- 0.0016 without circulation, 1.0191 +- 0.0028 with it
    (state,) = two_port.stationary_states(PAPER)
    assert state.mass_spread == pytest.approx(0.92909, abs=0.0015)
    assert state.net_current - state.circulating_current == pytest.approx(0.9751, abs=0.003)
    assert state.net_current == pytest.approx(1.0191, rel=0.01)


@pytest.mark.parametrize(("width", "measured"), CONDUCTANCES)
def test_two_ports_and_circulation_have_the_conductance_that_is_measured(
    width: float, measured: float
) -> None:
    found = []
    for threshold in range(6, 18, 4 if width < 0.05 else 2):
        circuit = replace(PAPER, threshold=threshold, channel2_width=width)
        ohm = width * 1000.0 / (math.pi * float(circuit.urn_area))
        found += [
            state.net_current / (ohm * state.mass_spread)
            for state in two_port.stationary_states(circuit)[-1:]
            if state.kind == "stable" and state.mass_spread > 0.5
        ]
    assert np.mean(found) == pytest.approx(measured, rel=0.03)


def test_next_to_equal_widths_unlike_gates_have_one_stable_state() -> None:
    # 1 + a - 2 P12 changes its sign there, and with it what urns send apart
    for width in (0.28, 0.3, 0.31):
        circuit = replace(PAPER, threshold=4, gate2_threshold=40, channel2_width=width)
        kinds = [kind for _, kind in two_port._roots(circuit, ports.disc)]
        assert kinds == ["stable"], width
        assert two_port.growth(replace(PAPER, channel2_width=width)) < 0.0


@pytest.mark.parametrize(
    "circuit",
    [
        Circuit(1000, 7), Circuit(1000, 15), replace(PAPER, urn2_radius=0.5, gate2_threshold=9),
        Circuit(1000, 7, channel2_width=0.1), Circuit(1000, 4, 0.5, 0.4, channel1_length=2.0),
    ],
    ids=str,
)  # fmt: skip
@pytest.mark.parametrize("share", [0.03, 0.3, 0.6])
def test_what_circulates_at_a_number_is_that_of_the_pair_of_urns(
    circuit: Circuit, share: float
) -> None:
    """The package searches for the inflows of both urns at once."""
    own, ages = MODELS["direction"].of(circuit), [0.0, 3000.0, np.inf]
    at = two_port.balance(own, share * float(circuit.number))
    expected, _ = two_port._around(own, at, ages)
    found = circulation.circulating_at(own, float(at.in_half[1, 0]), ages)
    assert np.abs(expected).max() > 0.0
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("threshold", "width"), [(7, 0.0), (5, 1e-4)])
def test_nearly_all_particles_in_one_urn_are_as_many_by_directions(
    threshold: int, width: float
) -> None:
    own = MODELS["direction"].of(Circuit(1000, threshold, channel2_width=width))
    found = two_port.stationary_states(own)[-1].mass_spread
    by_direction = MODELS["direction"].solve_stable(own)[-1].mass_spread
    assert found == pytest.approx(by_direction, abs=1e-3)
    assert found > 0.99

"""Circulation in the balance: nothing without it, particles conserved, chi nearer to runs."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from postproc.theory import two_port
from studies.circulation_and_densities import acting_back
from studies.circulation_and_densities.study import Case, summary
from studies.common.theories import THEORIES
from studies.event_log import Circuit as Table

NEAR = Case((12, 12), 0.3, 0.0612)


@pytest.mark.parametrize("case", [NEAR, Case((4, 40), 0.3, 0.09)])
def test_without_straight_passages_states_are_those_of_two_ports(case: Case) -> None:
    circuit = THEORIES["two_port"].of(case.circuit)
    state = acting_back.most_polarised(circuit)
    balance = acting_back.Balance(circuit, acting_back.NOTHING)
    first = balance.nearest(acting_back.polarised(circuit))
    _, across, _, halves = balance.state(first)
    assert halves[1] == pytest.approx(state.urn2_number, rel=1e-8)
    assert across[1] - across[0] == pytest.approx(
        state.net_current - state.circulating_current, rel=1e-8
    )


def test_urns_send_as_much_as_they_receive() -> None:
    circuit = THEORIES["two_port"].of(NEAR.circuit)
    known = acting_back.Passing(np.array([0.1, 0.7]), np.array([0.5, -0.2]), np.array([0.9, 0.2]))
    arriving = np.array([8.0, 20.0])
    entries, across, _, _ = acting_back.Balance(circuit, known).flows(arriving)
    assert entries + across == pytest.approx(arriving + across[::-1], rel=1e-12)


def test_passages_of_both_urns_are_filled_to_the_age(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten times as many of those that begin in urn 2, 8 rounds; no particle is followed."""
    straight = SimpleNamespace(
        decay=0.0, share=np.ones(2),
        passages=lambda start: 10.0**start * np.array([[[1.0], [2.0]], [[3.0], [4.0]]]),
    )  # fmt: skip
    monkeypatch.setattr(acting_back.circulation, "followed", lambda *_, **__: straight)
    monkeypatch.setattr(
        acting_back.circulation, "filled", lambda terms, _, rounds: float(terms[0] * rounds)
    )
    table = Table(channel2_width=0.0612)
    age = 8.0 * (2.0 * sum(table.chords) + 2.0)
    found = acting_back.passing(NEAR.circuit, np.ones(2), np.ones(2), age)
    assert found.down == pytest.approx([88.0, 176.0])
    assert found.up == pytest.approx([264.0, 352.0])


def test_nothing_changes_in_a_circuit_with_open_gates() -> None:
    """All is filled evenly: straight passages are those of two ports; 0.5 % of them is noise."""
    circuit = THEORIES["two_port"].of(Case((1000, 1000), 0.3, 0.0612).circuit)
    at = two_port.balance(circuit, 500.0)
    entries, across = at.entries[:, 0], at.across[:, 0]
    found = acting_back.passing(circuit, entries, across, 1e9)
    assert np.all(np.abs([found.down, found.up]) < 0.005 * across)


@pytest.fixture(scope="module")
def changes() -> list[float]:
    """Return how much circulation changes chi, with three sets of particles.

    Iterations go back and forth by 1e-4 of chi from the first on, so that four are as good as 12.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(acting_back, "ITERATIONS", 4)
        without, acting = acting_back.solved(NEAR.circuit, 7e4, 3)
    return [one.mass_spread - without.mass_spread for one in acting]


def test_chi_next_to_the_transition_is_nearer_to_that_of_runs(changes: list[float]) -> None:
    """0.5527 +- 0.0002 in studies/age_of_a_run; `direction` alone has 0.5567."""
    change = changes[0]
    assert change == pytest.approx(-0.0042, abs=0.0008)
    assert 0.55672 + change == pytest.approx(0.5527, abs=0.001)


def test_other_particles_change_chi_by_as_much(changes: list[float]) -> None:
    assert len(set(changes)) == 3
    assert changes == pytest.approx([np.mean(changes)] * 3, rel=0.2)


def test_summary_counts_what_kept_its_polarity() -> None:
    row = {"runs": "new", "polarity": "kept", "chi": 0.5, "chi_error": 0.001, "current": 2.0,
           "current_error": 0.01, "direction_chi": 0.502, "direction_current": 2.0,
           "chi_change": -0.001, "current_change": 0.02}  # fmt: skip
    [chi, current, *_] = summary([row, row | {"polarity": "changed", "chi": 0.1}])
    assert (chi["number"], chi["nearer"], chi["sign"]) == ("1", "1", "1")
    assert chi["rms_before"] == pytest.approx(0.002)
    assert chi["squares_after"] == pytest.approx(1.0)
    assert current["rms_after"] == pytest.approx(0.01)

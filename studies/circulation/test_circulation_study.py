"""Theory has the rates of rounds that runs have, for each length of channel 2."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS
from studies.circulation import study as circulation
from studies.circulation.study import Case
from studies.common.circulations import circulations
from studies.common.event_log import CROSSING1, CROSSING2, ENTRY, REVERSAL, Log, particle_events


@pytest.mark.parametrize(
    ("case", "measured", "error"),
    [
        (Case(), 3.67e-4, 0.24e-4),
        (Case(channel2_width=0.02), 1.234e-3, 0.044e-3),
        (Case(channel2_length=0.25), 5.08e-4, 0.28e-4),
        (Case(channel2_length=4.0), 4.07e-4, 0.25e-4),
    ],
)
def test_eighth_rounds_are_as_frequent_as_in_runs(
    case: Case, measured: float, error: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Measured by other runs, of `studies/experiments`; theory has a statistical error of 3 %."""
    with monkeypatch.context() as patch:
        patch.setattr(circulation.circulation, "SAMPLES", 2**8)  # its current is not asked for
        state = circulation.state_of(case.circuit)
    straight = circulation.straight_at(case.circuit, state.urn2_number)
    monkeypatch.setattr(circulation.circulation, "ROUNDS", 64)  # what is turned back begins anew
    found = circulation.reached(straight)
    assert abs(found[1, 8] - measured) < 4.0 * np.hypot(error, 0.03 * measured)


def test_rounds_are_reached_one_after_the_other() -> None:
    """With open gates none begins anew: later rounds are less frequent than earlier ones."""
    circuit = Case(threshold=1000).circuit
    found = circulation.reached(circulation.straight_at(circuit, 500.0))
    assert np.all(np.diff(found[:, 1:]) <= 1e-12)


def test_what_is_turned_back_begins_anew() -> None:
    """Through, turned back, through; one weighs 1 from an urn, 10 from channel 1."""
    one = np.zeros(1, int)
    straight = SimpleNamespace(
        seed=1,
        begun=lambda *_: (one, one, one, np.array([[1.0], [0.0], [10.0]])),
        rounds=lambda *_: ((one, one, one, one, np.array([way])) for way in (True, False, True)),
    )
    found = circulation.reached(straight)
    assert found[:, :4].tolist() == [[0.0, 34.0, 20.0, 0.0], [0.0, 10.0, 0.0, 0.0]]


def test_each_passage_has_its_fate() -> None:
    """One particle: two rounds and a wall of urn 2; another is turned back in gate 1."""
    table, start = Circuit(1000, 7), 2000.0
    across = sum(table.chords)
    first = [(0.0, CROSSING1, 12)]
    for at in range(2):  # through urn 2, channel 2, urn 1 and channel 1
        begun = at * (2.0 * across + 2.0)
        first += [(begun + across + 1.0, CROSSING2, 21), (begun + 2.0 * across + 1.5, ENTRY, 1),
                  (begun + 2.0 * across + 2.0, CROSSING1, 12)]  # fmt: skip
    first.append((first[-1][0] + 50.0, ENTRY, 2))
    second = [(100.0, CROSSING2, 21), (100.5 + across, ENTRY, 1), (200.0, CROSSING2, 12)]
    events = [(*one, 1) for one in first] + [(*one, 2) for one in second]
    events.append((100.7 + across, REVERSAL, 1, 0))
    time, kind, where, particle = map(np.array, zip(*sorted(events), strict=True))
    log = Log(start + time, kind, where, particle)
    followed = particle_events(log)
    fates = circulation.fates_of(followed, circulations(followed, table).all_rounds, table)
    assert fates[:, :4].tolist() == [[0, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0]]
    mean, variance = circulation.spread_of(log, 10, start + 1000.0)
    assert mean == pytest.approx(10.0, abs=2.0)
    assert variance < 2.0


def test_current_by_rounds_fills_up_with_what_has_been_flown() -> None:
    """Passages of m rounds as 1/m, from urn 2: 1 + 1/2 + ... as far as was flown."""
    rates = np.zeros((2, circulation.circulation.ROUNDS + 1))
    rates[1, 1:] = 1.0 / np.arange(1, rates.shape[1])
    for flown in (1.0, 4.0, 2000.0):
        harmonic = (1.0 / np.arange(1, flown + 1)).sum()
        found = circulation.by_rounds(rates, 1e-9, np.array([flown]))
        assert found == pytest.approx(harmonic, rel=1e-3)


def test_reversals_of_gate_1_are_rare() -> None:
    """At T = 7, w' = 0.01: 8.5e-5 a round by the cosine law."""
    found = circulation.reversal(MODELS["direction"].of(Case().circuit))
    assert found == pytest.approx(8.5e-5, rel=0.02)

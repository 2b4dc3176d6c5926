"""Rates of rounds of theory agree with runs, for each length of channel 2."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.theory import two_port
from studies.circulation import study as circulation
from studies.circulation.study import ROUNDS, Case

EIGHT = list(ROUNDS).index(8)


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
    case: Case, measured: float, error: float
) -> None:
    """Measured rates are from `studies/experiments`; theory has a statistical error of 3 %."""
    state = circulation.state_of(case.circuit)
    found = circulation.reached(two_port.straight_at(case.circuit, state.urn2_number))
    assert abs(found[EIGHT] - measured) < 4.0 * np.hypot(error, 0.03 * measured)


def test_rounds_are_reached_one_after_the_other() -> None:
    """With open gates no count restarts: later rounds are less frequent than earlier ones."""
    circuit = Case(threshold=1000).circuit
    found = circulation.reached(two_port.straight_at(circuit, 500.0))
    assert np.all(np.diff(found) <= 0.0)

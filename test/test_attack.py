"""A few trials of each attack; `python -m attack.NAME` makes as many as one likes."""

from __future__ import annotations

import pytest
from attack import damage, extremes, kills, together
from attack.common import trials

ATTACKS = {
    "kills": kills.campaign,
    "damage": damage.attack,
    "extremes": extremes.attack,
    "together": together.attack,
}
# How many trials are made always, and how many if there are minutes.
FEW = {"kills": 1, "extremes": 4}
MANY = {"kills": 4, "damage": 16, "extremes": 16, "together": 4}


@pytest.mark.parametrize(("name", "numbers"), [
    *((name, range(few)) for name, few in FEW.items()),
    *(pytest.param(name, range(FEW.get(name, 0), many), marks=pytest.mark.full)
      for name, many in MANY.items()),
])  # fmt: skip
def test_attack(name: str, numbers: range) -> None:
    """Nothing is found; what is tried is the same each time."""
    outcome = trials(name, ATTACKS[name], 20261121, numbers)
    assert outcome.tried >= len(numbers)
    assert not outcome.findings, "\n".join(outcome.findings)

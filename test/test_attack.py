"""A few trials of each attack; `python -m attack.NAME` makes as many as one likes."""

from __future__ import annotations

import pytest
from attack import damage, extremes, kills, together
from attack.common import trials

ATTACKS = {"kills": (kills.campaign, 2), "damage": (damage.attack, 8),
           "extremes": (extremes.attack, 8), "together": (together.attack, 2)}


@pytest.mark.parametrize("name", ATTACKS)
def test_attack(name: str) -> None:
    """Nothing is found; what is tried is the same each time."""
    attack, count = ATTACKS[name]
    outcome = trials(name, attack, 20261121, range(count))
    assert outcome.tried >= count
    assert not outcome.findings, "\n".join(outcome.findings)

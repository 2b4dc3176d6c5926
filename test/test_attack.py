"""A few trials of each attack; `python -m attack.NAME` makes as many as one likes."""

from __future__ import annotations

import pytest
from attack import damage, extremes, kills, together
from attack.common import trials

# What attacks, how many trials are made always, and how many if there are minutes.
ATTACKS = {"kills": (kills.campaign, 1, 4), "damage": (damage.attack, 4, 16),
           "extremes": (extremes.attack, 4, 16), "together": (together.attack, 1, 4)}


@pytest.mark.parametrize("name", ATTACKS)
@pytest.mark.parametrize("more", [False, pytest.param(True, marks=pytest.mark.full)])
def test_attack(name: str, *, more: bool) -> None:
    """Nothing is found; what is tried is the same each time."""
    attack, few, many = ATTACKS[name]
    numbers = range(few, many) if more else range(few)
    outcome = trials(name, attack, 20261121, numbers)
    assert outcome.tried >= len(numbers)
    assert not outcome.findings, "\n".join(outcome.findings)

"""Pasts are those that a brute force finds; each ends in the present, in the program too."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from postproc.study import Study
from studies.entropy_production import study as entropy
from studies.entropy_production.channel import Channel, pairs, share_of_two_pasts
from studies.entropy_production.flights import Pass, Ray, Start, Table, firings, histories
from studies.entropy_production.pasts import History, Tree, coordinates, turned_start
from studies.entropy_production.selection import selected
from studies.gated_reversal.pasts import PAST_TIME, PASTS

HERE = Path(entropy.__file__).parent
TABLE = Table()
LONG_AGO = -100.0


def _gates(
    threshold: int, entries: list[tuple[float, int, float]]
) -> list[tuple[float, int, float]]:
    """Return what the rule makes of entries (time, gate, half): (left, gate, turned) of each."""
    counted: list[list[tuple[float, float, int]]] = [[], [], []]  # until, since, which
    ends: list[tuple[float, int, float]] = [(0.0, 0, 0.0)] * len(entries)
    for (time, gate, half), at in sorted(zip(entries, range(len(entries)), strict=True)):
        inside = [one for one in counted[gate] if one[0] > time]
        counted[gate] = [*inside, (time + half, time, at)]
        ends[at] = (time + 2.0 * half, 3 - gate, math.inf)
        if len(inside) == threshold:
            for _, since, one in counted[gate]:
                ends[one] = (2.0 * time - since, gate, time)
            counted[gate] = []
    return ends


def _drawn(random: np.random.Generator, number: int, threshold: int) -> list[Pass]:
    """Return passes of particles that enter at random, and of one that did so long ago."""
    entries = [(LONG_AGO, 1, 0.5)] + [
        (random.uniform(0.0, 0.35 * number / threshold), int(random.integers(1, 3)),
         0.5 / math.sqrt(1.0 - random.uniform(-1.0, 1.0) ** 2))
        for _ in range(number)
    ]  # fmt: skip
    passes = [
        Pass(at, time, Ray(gate, 0.0, 0.5 / half, 0.0), left, Ray(side, 0.0, 0.5 / half, 0.0),
             half, turned)
        for at, ((time, gate, half), (left, side, turned)) in enumerate(
            zip(entries, _gates(threshold, entries), strict=True))
    ]  # fmt: skip
    return sorted(passes, key=lambda one: one.left)


def _weight_of_all(threshold: int, passes: list[Pass], rates: tuple[float, float]) -> float:
    """Return the weight of all pasts over the true one's: tries each end as through or turned."""
    ways = []
    for one in passes:
        side = one.exit.side
        own = [(one.left - 2.0 * one.half, 3 - side)]
        own += [(2.0 * other.left - one.left, side) for other in passes
                if other.exit.side == side and 0.0 <= one.left - other.left < one.half]  # fmt: skip
        ways.append(own)
    total, seen = 0.0, [(one.left, one.exit.side) for one in passes]
    halves = [one.half for one in passes]
    for chosen in product(*ways):
        entries = [(*one, half) for one, half in zip(chosen, halves, strict=True)]
        ends = _gates(threshold, entries)
        if all(gate == side and math.isclose(end, left, abs_tol=1e-9)
               for (end, gate, _), (left, side) in zip(ends, seen, strict=True)):  # fmt: skip
            total += math.prod(rates[gate - 1] for _, gate in chosen)
    return total / math.prod(rates[one.entry.side - 1] for one in passes)


# the time of a brute force is that of all its ways, of which there are more at larger thresholds
@pytest.mark.parametrize(("threshold", "draws"), [(1, 100), (2, 60), (3, 40)])
def test_weight_of_all_pasts_is_that_of_a_brute_force(threshold: int, draws: int) -> None:
    random, several = np.random.default_rng(threshold), 0
    for _ in range(draws):
        passes = _drawn(random, 3 + threshold, threshold)
        rates = (1.0, 3.0)
        channel = Channel(passes, threshold, rates)
        found = channel.weigh(LONG_AGO - 1.0, max(one.left for one in passes) + 1.0, 10**6, random)
        want = _weight_of_all(threshold, passes, rates)
        assert math.exp(found.log_ratio[-1]) == pytest.approx(want, rel=1e-9)
        several += want > 1.0
    assert several > 10


def test_a_selection_keeps_sums_unbiased() -> None:
    random = np.random.default_rng(1)
    scores, values = np.array([5.0, 1.0, 1.0, 0.5, 0.4, 0.1]), np.arange(1.0, 7.0)
    sums = []
    for _ in range(4000):
        taken, chance = selected(scores, 3, random)
        assert taken.size == 3
        assert 0 in taken
        sums.append(np.sum(values[taken] / chance))
    assert np.mean(sums) == pytest.approx(21.0, abs=5.0 * np.std(sums) / math.sqrt(len(sums)))
    assert np.array_equal(selected(scores, 6, random)[0], np.arange(6))


def test_weight_of_selected_pasts_has_the_mean_of_the_weight_of_all() -> None:
    random = np.random.default_rng(7)
    while True:
        passes = _drawn(random, 12, 1)
        channel = Channel(passes, 1, (1.0, 3.0))
        window = (LONG_AGO - 1.0, max(one.left for one in passes) + 1.0)
        exact = channel.weigh(*window, 10**6, random)
        if exact.pasts.max() > 12 and exact.log_ratio[-1] > 1.0:
            break
    found = np.exp([channel.weigh(*window, 4, random).log_ratio[-1] for _ in range(400)])
    want = math.exp(exact.log_ratio[-1])
    assert found.std() > 0.0
    assert found.mean() == pytest.approx(want, abs=5.0 * found.std() / math.sqrt(found.size))


def test_number_of_selected_pasts_has_the_mean_of_the_number_of_all() -> None:
    number, depth = 30, 12.0
    for seed in range(100):
        random = np.random.default_rng(seed)
        pasts, tree = entropy.pasts_of_a_run(random, number, 1, depth)
        if len(pasts) > 12:
            break
    present, ages = tree.history.state(depth), np.linspace(0.5, depth, 24)
    assert tree.number(present, ages, 10**6, random)[-1] == len(pasts)
    found = np.array([tree.number(present, ages, 5, random)[-1] for _ in range(250)])
    assert found.std() > 0.0
    assert found.mean() == pytest.approx(len(pasts), abs=5.0 * found.std() / math.sqrt(found.size))


def test_share_of_two_pasts_is_that_of_random_pairs() -> None:
    random, size = np.random.default_rng(2), 200_000
    first, second = 0.5 / np.sqrt(1.0 - random.uniform(-1.0, 1.0, (2, size)) ** 2)
    tau = first * random.uniform(0.0, 1.0, size)
    two = (second > 2.0 * first - tau) | (first > 2.0 * second + tau)
    assert share_of_two_pasts() == pytest.approx(np.sum(first * two) / np.sum(first), abs=0.005)


def test_pairs_are_those_of_the_two_known_pasts() -> None:
    """A slow one is turned by a fast one; or both came through, the fast one after the slow."""
    sine = math.sqrt(1.0 - 0.4**2)
    starts = [Start(False, 1.0, Ray(2, 0.0, 0.4, sine)), Start(False, 1.1, Ray(2, 0.05, 1.0, 0.0))]
    passes, _ = histories(TABLE, 1, starts, 3.5)
    assert pairs(passes[:2]) == (1, 0)
    both = [one._replace(turned=math.inf) for one in passes[:2]]
    assert pairs(both) == (0, 1)


def test_the_ratio_of_groups_ignores_what_numerator_and_denominator_share() -> None:
    fired = np.array([80.0, 120.0, 100.0])
    assert entropy.ratio_of_groups(0.3 * fired, fired) == pytest.approx((0.3, 0.0))


def _pasts(
    starts: list[Start], threshold: int, depth: float
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the coordinates of all pasts of what starts arrive at, and those of the present."""
    passes, _ = histories(TABLE, threshold, starts, depth)
    history = History(passes, len(starts))
    found = Tree(TABLE, threshold, history, depth).pasts(history.state(depth), depth)
    states = [coordinates(TABLE, one, depth) for one in found]
    return states, coordinates(TABLE, history.state(depth), 0.0)


def test_from_either_of_two_known_pasts_both_are_found() -> None:
    both = np.array(PASTS)
    both[:, 2, 1] = 0.02  # off the axis, so that it does not come from channel 2
    for start in both:
        states, _ = _pasts([TABLE.start(*one) for one in start], 1, PAST_TIME)
        for known in both:
            assert min(np.abs(one - known).max() for one in states) < 1e-12


def test_two_particles_at_threshold_1_have_two_pasts_that_the_program_brings_together(
    tmp_path: Path,
) -> None:
    """A slow one is turned by a fast one; or both came through, the fast one after the slow."""
    sine = math.sqrt(1.0 - 0.4**2)
    slow = Start(False, 1.0, Ray(2, 0.0, 0.4, sine))
    fast = Start(False, 1.1, Ray(2, 0.05, 1.0, 0.0))
    states, present = _pasts([slow, fast], 1, 3.5)
    assert len(states) == 2
    assert np.abs(states[0] - states[1]).max() > 1.0
    ends = entropy.same_present(Study(tmp_path, HERE, ranks=1), "two", states, 3.5)
    assert np.abs(ends - present).max() < 1e-9


@pytest.mark.parametrize(("number", "threshold", "depth"), [(10, 1, 40.0), (40, 2, 2.0)])
def test_mean_number_of_pasts_over_all_states_is_1(
    number: int, threshold: int, depth: float
) -> None:
    random, tree = np.random.default_rng(3), Tree(TABLE, threshold)
    found = np.array([
        len(tree.pasts(entropy.drawn_present(random, number, threshold), depth))
        for _ in range(500)
    ])  # fmt: skip
    assert found.max() > 2
    assert abs(found.mean() - 1.0) < 5.0 * found.std() / math.sqrt(found.size)


def test_without_reversals_a_state_has_one_past() -> None:
    found, _ = entropy.pasts_of_a_run(np.random.default_rng(1), 20, 20, 100.0)
    assert len(found) == 1


def test_flights_are_those_of_the_program(tmp_path: Path) -> None:
    random, number = np.random.default_rng(2), 20
    starts = TABLE.random_starts(random, number)
    states = []
    for one in starts:  # in channel 1 or an urn; far from there they begin in urn 2
        row = coordinates(TABLE, [turned_start(TABLE, one)], 0.0)
        states.append(row[0] if row is not None else [1.2, 0.1, -0.8, 0.6])
    begin = [TABLE.start(*one) for one in np.array(states)]
    passes, log = histories(TABLE, 1, begin, 20.0)
    assert firings(log) > 0
    history = History(passes, number)
    work = Study(tmp_path, HERE, ranks=1)
    (end,) = entropy.same_present(work, "program", [np.array(states)], 20.0)
    for at, one in enumerate(history.state(20.0)):
        want = coordinates(TABLE, [one], 0.0)
        if want is not None:
            assert end[at] == pytest.approx(want[0], abs=1e-8)

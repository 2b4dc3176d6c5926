"""Scheduler: known schedules, bounds that every list schedule keeps, queues with known waits."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from postproc.speed import scheduler
from postproc.speed.scheduler import Network, simulate, simulate_static, task_lengths
from postproc.tests.commands import call

SOURCES = Path(__file__).resolve().parents[2] / "src/ensemble"
IDEAL = Network(0.0, 1e-12)


@pytest.mark.parametrize(
    "name", ["poll_interval", "polls_a_second", "poll_share", "longest_poll_interval"]
)
def test_polls_are_those_of_the_program(name: str) -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in SOURCES.glob("*.f90"))
    (value,) = re.findall(rf"\b{name} = ([\d.e]+)_dp", text)
    assert getattr(scheduler, name.upper()) == float(value)


def test_equal_tasks_keep_all_ranks_busy() -> None:
    found = simulate(np.full(40, 2.0), 8, IDEAL)
    assert found.seconds == pytest.approx(10.0)
    assert found.idle_share == pytest.approx(0.0, abs=1e-9)
    assert found.busy_least == pytest.approx(1.0)
    assert found.list_bytes == 320


def test_one_task_more_than_ranks_takes_two_rounds() -> None:
    found = simulate(np.full(9, 1.0), 8, IDEAL)
    assert found.seconds == pytest.approx(2.0)
    assert found.idle_share == pytest.approx(7 / 16)
    assert found.end_share == pytest.approx(7 / 16)


def test_fewer_tasks_than_ranks() -> None:
    found = simulate(np.array([1.0, 3.0]), 5, IDEAL)
    assert found.seconds == pytest.approx(3.0)
    assert found.busy_least == 0.0
    assert found.idle_share == pytest.approx(11 / 15)


def test_longest_first_keeps_grahams_bounds() -> None:
    """Graham (1969): a list ends within 2 - 1/P of the best, longest first within 4/3 - 1/(3P)."""
    lengths = task_lengths(300, 1.0, 1.5, 3)
    ranks = 16
    best = max(lengths.sum() / ranks, lengths.max())
    at_random = simulate(lengths, ranks, IDEAL).seconds
    longest = simulate(np.sort(lengths)[::-1], ranks, IDEAL).seconds
    assert best <= longest <= (4 / 3 - 1 / (3 * ranks)) * best
    assert longest <= at_random <= (2 - 1 / ranks) * best


def test_grahams_worst_case_of_longest_first() -> None:
    """2P + 1 tasks of 2P-1, 2P-1, ..., P+1, P+1, P, P, P end at 4P - 1, the best at 3P."""
    ranks = 5
    lengths = [float(n) for n in range(2 * ranks - 1, ranks, -1) for _ in range(2)] + [ranks] * 3
    found = simulate(np.array(lengths, dtype=float), ranks, IDEAL)
    assert found.seconds == pytest.approx(4 * ranks - 1)


def test_first_tasks_queue_at_the_task_queue() -> None:
    """The last of P ranks waits until all the others have been served."""
    network = Network(1e-3, 1e-4)
    found = simulate(np.full(50, 0.05), 50, network)
    waited = scheduler.OPERATIONS_A_TASK * (50 * network.service + network.latency)
    assert found.longest_wait == pytest.approx(waited)
    assert found.seconds == pytest.approx(0.05 + waited)


def test_polls_take_their_share_and_no_more() -> None:
    """A slow network makes looks rare: they cost half a percent at most, of tasks below 5 s."""
    for latency in (1e-6, 1e-4, 1e-2):
        found = simulate(np.full(10, 4.9), 1, Network(latency, 1e-9))
        taking = scheduler.OPERATIONS_A_TASK * latency / 4.9
        assert found.idle_share <= 1.05 * (scheduler.POLL_SHARE + taking)
        assert found.idle_share >= taking


def test_board_that_is_asked_too_often_sets_the_pace() -> None:
    """Tasks shorter than P services: the board, not the ranks, says how long it takes."""
    network = Network(0.0, 1e-3)
    found = simulate(np.full(2000, 1e-3), 100, network)
    assert found.seconds == pytest.approx(2000 * scheduler.OPERATIONS_A_TASK * 1e-3, rel=0.01)
    assert found.queue_load == pytest.approx(1.0, rel=0.01)


def test_shares_add_up_and_the_list_beats_dealing_out() -> None:
    lengths = task_lengths(5000, 0.1, 0.5, 1)
    by_list = simulate(lengths, 50, Network())
    dealt = simulate_static(lengths, 50)
    assert by_list.idle_share == pytest.approx(by_list.queue_share + by_list.end_share)
    assert 0.0 < by_list.idle_share < dealt.idle_share
    assert dealt.seconds == pytest.approx(lengths.reshape(100, 50).sum(axis=0).max())


def test_lengths_have_mean_and_spread() -> None:
    lengths = task_lengths(100_000, 2.0, 0.5, 1)
    assert lengths.mean() == pytest.approx(2.0, abs=5 * 1.0 / np.sqrt(1e5))
    assert lengths.std() == pytest.approx(1.0, rel=0.05)
    assert (task_lengths(10, 3.0, 0.0, 1) == 3.0).all()


def test_perfect_foresight_sorts_and_none_shuffles() -> None:
    lengths = task_lengths(1000, 1.0, 0.3, 5)
    assert (np.diff(scheduler.put_in_order(lengths, "longest", 0.0, 0)) <= 0.0).all()
    poor = scheduler.put_in_order(lengths, "longest", 100.0, 0)
    assert sorted(poor) == sorted(lengths)
    assert abs(np.corrcoef(poor, np.arange(1000))[0, 1]) < 0.5


def test_program_prints_and_draws(tmp_path: object, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["--ranks", "40", "--tasks", "400", "--figure", "--output", str(tmp_path)]
    assert call("scheduler", command) == 0
    text = capsys.readouterr().out
    found = json.loads(text[: text.index("}") + 1])
    assert found["ranks"] == 40
    assert 0.0 < found["idle_share"] < 0.2
    assert "scheduler.png" in text


@pytest.mark.parametrize("wrong", [["--ranks", "0"], ["--seconds", "0"], ["--latency", "-1"]])
def test_bad_numbers_are_refused(wrong: list[str]) -> None:
    assert call("scheduler", wrong) == 2

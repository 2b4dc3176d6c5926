"""Reversal with gates: logs computed by hand, and the program run backwards."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from studies.common.event_log import Log, outward_stays, particle_events
from studies.common.study import Study
from studies.gated_reversal import examples, pasts
from studies.gated_reversal import study as gated

HERE = Path(gated.__file__).parent


def _log(*events: tuple[float, int, int, int]) -> Log:
    time, kind, where, particle = np.array(sorted(events), float).T
    return Log(time, *(column.astype(int) for column in (kind, where, particle)))


# particle 1 enters gate 2 at 0.2, 2 at 0.3, and both are reversed; 3 comes through at 0.1
PAIR = ((0.2, 1, 2, 1), (0.3, 1, 2, 2), (0.3, 2, 2, 2))
PASSER = ((-0.4, 1, 1, 3), (0.1, 3, 12, 3))


def test_stories_tell_who_was_turned_and_who_got_through() -> None:
    events = particle_events(_log(*PAIR, *PASSER))
    assert events.particle.tolist() == [1, 2, 3, 3]
    assert events.turned[:2] == pytest.approx([0.3, 0.3], abs=1e-6)
    assert np.isnan(events.turned[2:]).all()
    assert events.after.tolist() == [-1, -1, 3, -1]
    assert events.before.tolist() == [-1, -1, -1, 2]


def test_who_heads_out_of_a_gate_and_how_long() -> None:
    gate, start, stop = outward_stays(particle_events(_log(*PAIR, *PASSER)))
    assert gate.tolist() == [2, 2, 2]
    assert start == pytest.approx([0.3, 0.3, 0.1], abs=1e-6)
    assert stop == pytest.approx([0.4, 0.3, 0.6], abs=1e-6)


def test_reversal_is_undone_only_if_nobody_else_heads_out() -> None:
    with_nobody = gated.reversals_of(_log(*PAIR), 1, end=0.8)
    assert with_nobody.alone.tolist() == [True]
    assert with_nobody.parting == -math.inf
    with_passer = gated.reversals_of(_log(*PAIR, *PASSER), 1, end=0.8)
    assert with_passer.alone.tolist() == [False]
    assert with_passer.parting == pytest.approx(0.4, abs=1e-6)
    turned_inside = gated.reversals_of(_log(*PAIR, *PASSER), 1, end=0.35)
    assert turned_inside.parting == pytest.approx(0.3, abs=1e-6)


def test_mirror_images_need_gate_number_and_time() -> None:
    def one(time: float, gate: int, size: int) -> gated.Reversals:
        columns = (np.array([value]) for value in (time, gate, size, True))
        return gated.Reversals(*columns, -math.inf)

    forward = one(0.3, 2, 2)
    assert gated.mirrored(forward, one(0.5, 2, 2), 0.8).all()
    for other in (one(0.5, 1, 2), one(0.5, 2, 3), one(0.6, 2, 2)):
        assert not gated.mirrored(forward, other, 0.8).any()


def test_example_that_is_undone_and_one_that_is_not(tmp_path: Path) -> None:
    work = Study(tmp_path, HERE)
    aslant = [(x, y, -math.sqrt(0.99), 0.1) for x, y, *_ in examples.FROM_URN2]
    good = examples.example(work, "good", aslant)
    assert good["returns_within"] < 1e-14
    assert [words for _, words in good["back"]] == [words for _, words in good["forth"]]
    bad = examples.example(work, "bad", (*examples.FROM_URN2, examples.PASSER))
    assert bad["returns_within"] > 0.5
    assert [words for _, words in bad["back"]] == [
        "particle 3 enters gate 2",
        "particle 1 enters gate 2",
        "gate 2 reverses 2 particles",
        "particle 2 enters gate 2",
    ]
    assert [time for time, _ in bad["back"]] == pytest.approx([0.2, 0.4, 0.4, 0.5])


def test_two_pasts_have_one_present(tmp_path: Path) -> None:
    work = Study(tmp_path, HERE)
    histories = [
        examples.example(work, f"past{at}", past, pasts.PAST_TIME, ["forth"])
        for at, past in enumerate(pasts.PASTS)
    ]
    ends = [np.array(one["forth_end"]) for one in histories]
    assert ends[0] == pytest.approx(ends[1], abs=1e-14)
    fired = [[time for time, text in one["forth"] if "reverses 2" in text] for one in histories]
    assert fired == [pytest.approx([1.3]), pytest.approx([1.1])]
    starts = np.array(pasts.PASTS)[:, :, 0]
    assert (np.abs(starts) > 0.5).all()  # all begin in the urns
    for at, end in enumerate(ends):
        assert pasts.present(np.array(pasts.PASTS[at]), at) == pytest.approx(end, abs=1e-14)


def test_pasts_nearby_meet_too(tmp_path: Path) -> None:
    worked_out = pasts.other_past(np.array([[0.6, 0.05, 1, 0], [0.8, -0.05, 1, 0], [1, 0, 1, 0]]))
    assert worked_out == pytest.approx(np.array(pasts.PASTS[1]))
    found = pasts.nearby(Study(tmp_path, HERE), 2)
    assert found["differ_by"] < 1e-12
    assert found["by_hand_differ_by"] < 1e-12


def test_each_way_to_the_present_keeps_volume_and_both_end_there() -> None:
    assert [pasts.volume_ratio(past) for past in (0, 1)] == pytest.approx([1.0, 1.0], abs=1e-8)
    random = np.random.default_rng(3)
    for _ in range(20):
        start = np.array(pasts.PASTS[0]) + random.uniform(-0.01, 0.01, (3, 4))
        end = pasts.present(start, 0)
        other = pasts.other_past(end)
        assert np.abs(other - start).max() > 1.0
        assert pasts.present(other, 1) == pytest.approx(end, abs=1e-12)


def test_reversals_of_one_run_count_as_one_in_the_error() -> None:
    random = np.random.default_rng(4)
    chance = random.uniform(0.2, 0.8, 400)  # of a run, whose reversals share it
    hits = random.binomial(50, chance)
    share, error = gated.share_of(hits, np.full(400, 50))
    assert share == pytest.approx(0.5, abs=0.03)
    assert error == pytest.approx(np.std(hits / 50.0) / 20.0, rel=0.01)
    assert error > 2.0 * math.sqrt(0.25 / 20000)  # error of independent ones
    assert math.isnan(gated.share_of([0, 0], [0, 0])[0])
    assert math.isnan(gated.share_of([1, 0], [3, 0])[1])


def test_run_backwards_parts_where_the_log_says(tmp_path: Path) -> None:
    found = gated._backwards(Study(tmp_path, HERE), 100, 1, 12.0, turns=3)
    assert found["parting_as_told"] == found["turns"] == 3
    assert found["parting_median"] < 12.0
    assert 0.0 < found["undone"] < 1.0

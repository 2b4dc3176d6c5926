"""The tail of currents: recognition of circulations, and the required length of a run."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import postproc
from postproc.study import Study
from studies import circulations
from studies.event_log import Circuit, Log, circuit_of, particle_events, read_log
from studies.tail import scatter
from studies.tail import study as tail

CIRCUIT = Circuit()
HERE = Path(tail.__file__).parent
LATE = circulations.TRANSIENT + 1.0


def _round(start: float, flight: float) -> list[tuple[float, int, int, int]]:
    """Crossing of channel 1, of channel 2, and entry into gate 1, all straight."""
    return [
        (start, 3, 12, 1),
        (start + flight, 4, 21, 1),
        (start + 2.0 * flight - 0.5, 1, 1, 1),
    ]


def _found(events: list[tuple[float, int, int, int]]) -> circulations.Circulations:
    time, kind, where, particle = np.array(events, float).T
    log = Log(time, *(column.astype(int) for column in (kind, where, particle)))
    return circulations.circulations(particle_events(log), CIRCUIT)


def test_rounds_are_counted_until_a_bounce_in_an_urn() -> None:
    flight = circulations.straight_time(CIRCUIT)
    events = [one for k in range(3) for one in _round(LATE + 2.0 * k * flight, flight)]
    found = _found(events)
    assert found.rounds.tolist() == [1, 2, 3]
    assert found.sign.tolist() == [1, 1, 1]
    assert found.slope == pytest.approx(0.0, abs=1e-5)
    late = _round(LATE + 6.0 * flight + 1.0, flight)  # a longer path to channel 1
    assert _found(events + late).rounds.tolist() == [1, 2, 3, 1]


def test_passage_after_a_detour_is_no_circulation() -> None:
    flight = circulations.straight_time(CIRCUIT)
    detour = [(LATE, 3, 12, 1), (LATE + flight + 1.0, 4, 21, 1)]
    assert _found(detour).rounds.tolist() == [0]
    turned = [(LATE, 3, 21, 1), (LATE + flight, 4, 21, 1)]
    assert _found(turned).rounds.tolist() == [0]


@pytest.mark.parametrize("slope", [0.0, None])
def test_program_keeps_a_particle_on_a_closed_orbit(tmp_path: Path, slope: float | None) -> None:
    slope = tail._zigzag(CIRCUIT) if slope is None else slope
    # from the middle of channel 1 to the right, at the wall if the orbit hits it there
    height = 0.149999999 if slope else 0.0
    (tmp_path / "one.txt").write_text(f"1e-12 {height} 1 {-slope!r}\n")
    changes = {
        "particles": {"number": 1, "urn1_number": None, "initial_file": "one.txt"},
        "gate": {"threshold": 1},
        "run": {"duration": circulations.TRANSIENT + 100.0},
    }
    path = Study(tmp_path, HERE).run("events", "one", changes, alone=True)
    circuit = circuit_of(postproc.open_results(path))
    found = circulations.circulations(particle_events(read_log(path)), circuit)
    assert found.rounds.size > 10
    assert (np.diff(found.rounds) == 1).all()
    assert found.rounds[-1] > 150
    assert found.slope == pytest.approx(slope, abs=1e-4)


def test_number_inside_an_urn_is_its_share_of_a_free_circuit(tmp_path: Path) -> None:
    number, end = 200, 21000.0
    changes = {
        "particles": {"number": number, "urn1_number": 100},
        "gate": {"threshold": number},
        "run": {"duration": end},
    }
    path = Study(tmp_path, HERE).run("events", "free", changes, alone=True)
    log, circuit = read_log(path), circuit_of(postproc.open_results(path))
    both = circulations.urn_numbers(log, particle_events(log), circuit, 100, end)
    area = circuit.urn_area
    expected = number * area / (2.0 * area + 0.3 + 0.01)
    # variance N/4, with the correlation time pi A/(w + w') / 2
    memory = math.pi * area / 0.31
    for inside in both:
        assert inside == pytest.approx(expected, abs=5.0 * math.sqrt(0.25 * number * memory / 2e4))


def test_numbers_inside_follow_the_crossings() -> None:
    begin = circulations.TRANSIENT
    events = [(begin + 25.0, 4, 12, 1), (begin + 50.0, 1, 2, 1), (begin + 50.2, 2, 2, 1)]
    time, kind, where, particle = np.array(events).T
    log = Log(time, *(column.astype(int) for column in (kind, where, particle)))
    one = Circuit(1)
    first, second = circulations.urn_numbers(log, particle_events(log), one, 0, begin + 100.0)
    in_channel2 = 0.25 * math.pi / 100.0
    assert first == pytest.approx(0.25 - in_channel2)
    assert second == pytest.approx(0.75 - in_channel2 - 0.4 / 100.0)  # 0.2 in, and 0.2 out


def test_split_into_windows_keeps_the_sum() -> None:
    time = circulations.TRANSIENT + np.array([10.0, 700.0, 999.0, 1400.0])
    counts = tail.in_windows(time, [1, 1, -1, 1], 500.0, circulations.TRANSIENT + 1500.0)
    assert counts * 500.0 == pytest.approx([1.0, 0.0, 1.0])


def test_length_for_the_goal() -> None:
    times = np.array([100.0, 400.0, 1600.0])
    assert scatter.length_for_goal(times, 0.2 / np.sqrt(times), 1.0) == pytest.approx(400.0)
    assert scatter.length_for_goal(times, 0.3 / np.sqrt(times), 1.0) == pytest.approx(900.0)
    assert scatter.length_for_goal(times, 1.0 / np.sqrt(times), 1.0) == pytest.approx(10000.0)
    assert scatter.length_for_goal(times, 0.01 / np.sqrt(times), 1.0) == 100.0


def test_law_of_circulations_is_recovered() -> None:
    law = tail._law(1e6 * tail.ROUNDS**-1.0, 1e8)
    assert law["exponent"] == pytest.approx(1.0)
    assert law["scale"] == pytest.approx(0.01)


def test_circulation_that_began_with_a_reversal_is_found() -> None:
    flight = circulations.straight_time(CIRCUIT)
    rounds = [one for k in range(1, 9) for one in _round(LATE + 2.0 * k * flight, flight)]
    passage = (LATE + flight, 4, 21, 1)  # the one before the first round
    begin = LATE + flight - 3.0
    reversal = (begin + 0.1, 2, 2, 1)
    entry1 = (LATE + 2.0 * flight - 0.5, 1, 1, 1)
    for before, expected in (
        ([(begin, 1, 2, 1), reversal], (1, 1)),
        ([(begin, 3, 12, 1)], (0, 1)),  # a longer path
    ):
        events = np.array([*before, passage, entry1, *rounds], float).T
        log = Log(events[0], *(column.astype(int) for column in events[1:]))
        by_particle = particle_events(log)
        found = circulations.circulations(by_particle, CIRCUIT)
        assert found.rounds.max() == 8
        assert tail.fed_by_gate(by_particle, found.all_rounds) == expected


def test_errors_of_a_scatter_are_those_of_whole_runs() -> None:
    random = np.random.default_rng(8)
    runs = random.normal(1.0, 0.1, (30, 1)) + np.zeros((30, 40))  # equal windows
    found = scatter.scatter_with_error(runs)
    assert found["deviation"] == pytest.approx(runs[:, 0].std(), rel=0.02)
    assert found["deviation_error"] == pytest.approx(found["deviation"] / math.sqrt(58.0), rel=0.4)
    apart = scatter.scatter_with_error(random.normal(1.0, 0.1, (30, 40)))
    assert apart["deviation_error"] < 0.4 * found["deviation_error"]
    assert apart["half_width_error"] > 0.0


def test_area_of_an_urn_is_that_of_the_theory() -> None:
    theory = Study(Path()).theory("window", number=10, threshold=1, channel2_width=0.2)
    assert Circuit(channel2_width=0.2).urn_area == pytest.approx(theory["urn_area"], rel=1e-12)

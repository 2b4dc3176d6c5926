"""Circulations are recognised in event logs; numbers in the urns follow from the crossings."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import postproc
from postproc.theory.circuit import Circuit
from studies.common import circulations
from studies.common.event_log import Log, circuit_of, particle_events, read_log
from studies.common.study import Study

CIRCUIT = Circuit(1000, 7)
NAMELIST = Path(__file__).parents[1] / "circulation"  # has circuit.nml, one event log
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
    late = _round(LATE + 6.0 * flight + 1.0, flight)  # a longer path to channel 1
    assert _found(events + late).rounds.tolist() == [1, 2, 3, 1]


def test_passage_after_a_detour_is_no_circulation() -> None:
    flight = circulations.straight_time(CIRCUIT)
    detour = [(LATE, 3, 12, 1), (LATE + flight + 1.0, 4, 21, 1)]
    assert _found(detour).rounds.tolist() == [0]
    turned = [(LATE, 3, 21, 1), (LATE + flight, 4, 21, 1)]
    assert _found(turned).rounds.tolist() == [0]


ACROSS = 2.0 * circulations.straight_time(CIRCUIT) - CIRCUIT.channel2_length


@pytest.mark.parametrize(
    ("slope", "height"), [(0.0, 0.0), (CIRCUIT.channel1_width / ACROSS, 0.149999999)]
)
def test_program_keeps_a_particle_on_a_closed_orbit(
    tmp_path: Path, slope: float, height: float
) -> None:
    """On the axis, or on the zigzag that meets the wall of channel 1 at its middle."""
    (tmp_path / "one.txt").write_text(f"1e-12 {height} 1 {-slope!r}\n")
    changes = {
        "particles": {"number": 1, "urn1_number": None, "initial_file": "one.txt"},
        "gate": {"threshold": 1},
        "run": {"duration": circulations.TRANSIENT + 100.0},
    }
    path = Study(tmp_path, NAMELIST).run("circuit", "one", changes, alone=True)
    circuit = circuit_of(postproc.open_results(path))
    found = circulations.circulations(particle_events(read_log(path)), circuit)
    assert found.rounds.size > 10
    assert (np.diff(found.rounds) == 1).all()
    assert found.rounds[-1] > 150


def test_number_inside_an_urn_is_its_share_of_a_free_circuit(tmp_path: Path) -> None:
    number, end = 200, 21000.0
    changes = {
        "particles": {"number": number, "urn1_number": 100},
        "gate": {"threshold": number},
        "run": {"duration": end},
    }
    path = Study(tmp_path, NAMELIST).run("circuit", "free", changes, alone=True)
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
    one = Circuit(1, 1)
    first, second = circulations.urn_numbers(log, particle_events(log), one, 0, begin + 100.0)
    in_channel2 = 0.25 * math.pi / 100.0
    assert first == pytest.approx(0.25 - in_channel2)
    assert second == pytest.approx(0.75 - in_channel2 - 0.4 / 100.0)  # 0.2 in, and 0.2 out

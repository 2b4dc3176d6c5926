"""The ladder of models: what its rungs say, and where each stands between theory and billiard."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from postproc.theory.models import MODELS
from studies.accuracy import ladder
from studies.accuracy.observables import by_time, lacking
from studies.common.study import Study

if TYPE_CHECKING:
    from studies.accuracy.ladder import Answer

HERE = Path(__file__).parent
SPREAD, CURRENT = 0.9291, 1.0168  # of the billiard at T = 7, by 88 runs of 1e6 time units


def _battery(folder: Path, engine: str, duration: float) -> dict[str, Answer]:
    changes = {"run": {"engine": engine, "duration": duration}}
    return ladder.battery_answers(Study(folder, HERE).run("battery", engine, changes))


def _sigmas(one: Answer, other: Answer) -> float:
    return (one.value - other.value) / math.hypot(one.error, other.error)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Answer]]:
    folder = tmp_path_factory.mktemp("ladder")
    return {
        "excursion": _battery(folder, "excursion", 32000.0),
        "reservoir": _battery(folder, "reservoir", 8000.0),
    }


def test_reservoir_lies_between_the_papers_theory_and_the_billiard(runs: dict) -> None:
    paper, _ = ladder.ask(MODELS["window"], ladder.BATTERY)
    reservoir, billiard = runs["reservoir"]["chi"], runs["excursion"]["chi"]
    assert reservoir.value + 5.0 * reservoir.error < paper
    assert _sigmas(reservoir, billiard) > 5.0
    assert _sigmas(runs["excursion"]["current"], runs["reservoir"]["current"]) > 4.0


def test_memory_of_the_urns_moves_the_transition(tmp_path: Path) -> None:
    found = {}
    for engine in ("excursion", "reservoir"):
        changes = {
            "run": {"engine": engine, "duration": 4000.0},
            "scan": {"threshold": [15, 16, 17], "replicas": 6},
        }
        path = Study(tmp_path, HERE).run("transition", engine, changes)
        found[engine] = ladder.transition_answer(path)
    assert _sigmas(found["excursion"], found["reservoir"]) > 5.0
    assert abs(found["excursion"].value - 16.26) < 5.0 * found["excursion"].error
    assert abs(found["reservoir"].value - 15.59) < 5.0 * found["reservoir"].error


def test_theory_with_memory_finds_the_billiard() -> None:
    spread, flow = ladder.ask(MODELS["direction"], ladder.BATTERY)
    assert spread == pytest.approx(SPREAD, abs=0.002)
    assert flow == pytest.approx(CURRENT, rel=0.01)
    assert ladder.ask(MODELS["direction"], replace(ladder.BATTERY, threshold=40)) == (0.0, 0.0)


def test_sets_of_runs_are_weighted_by_their_time() -> None:
    value, error = by_time([(1.0, 0.3, 1.0), (2.0, 0.1, 3.0)])
    assert value == pytest.approx(1.75)
    assert error == pytest.approx(0.075 * math.sqrt(2.0))


def test_short_runs_lack_what_the_theory_has_in_later_rounds() -> None:
    """A rung's eight runs of 19,000 time units: 1.1 % at the reference point."""
    short = lacking(8 * 19000 * 1e-4, 1e-4, SPREAD)
    assert short == pytest.approx(0.011, abs=0.001)
    assert lacking(8 * 480000 * 1e-4, 1e-4, SPREAD) < 0.1 * short

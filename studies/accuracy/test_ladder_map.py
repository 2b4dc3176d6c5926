"""The ladder over the map: what is charged, what is an error, whose errors cancel."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postproc.advice.advice import HALFWAY
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS
from postproc.theory.states import State, Theory
from studies.accuracy import ladder, ladder_errors, ladder_map
from studies.accuracy.ladder_map import Told
from studies.common.study import ROOT, Study

HERE = Path(__file__).parent
SIZE = len(ladder_map.points())
EXCURSION = next(rung for rung in ladder.RUNGS if rung.name == "excursion")


def told(chi: float, current: float, error: float = 0.0, seconds: float = 1e-3) -> Told:
    """Return a rung that says the same everywhere but across transitions, where chi falls."""
    near = np.array([zone for *_, zone in ladder_map.points()])
    falling = np.tile(np.concatenate([np.full(3, chi), chi * np.linspace(0.9, 0.1, 5)]), 3)
    return Told(
        np.where(near, falling, chi), np.full(SIZE, current), np.full(SIZE, error),
        np.full(SIZE, error), np.full(SIZE, seconds), np.zeros(SIZE), np.zeros(SIZE),
    )  # fmt: skip


def line(name: str, kind: str = "theory", bias: float = 0.1, **more: float) -> dict:
    one = {"bias": bias, "bias_error": 0.001, "seen": True, "missing": 0, "chance": 0.0,
           "seconds": 1.0, "approach": 0.0, "cancels": False, **more}  # fmt: skip
    return {"name": name, "kind": kind, **dict.fromkeys(ladder.QUANTITIES, one)}


def test_chance_is_taken_off_the_error() -> None:
    """Off by 0.02 everywhere, and by chance as much: the one is found, the other is not it."""
    truth, random = told(0.8, 5.0), np.random.default_rng(2)
    noise = random.normal(0.0, 0.01, SIZE)
    found = ladder_map.compare(
        replace(truth, chi=truth.chi + 0.02 + noise, chi_error=np.full(SIZE, 0.01)), truth, "chi"
    )
    assert found["seen"]
    assert found["bias"] == pytest.approx(0.02, abs=3.0 * found["bias_error"])
    assert found["chance"] == pytest.approx(0.01)
    only = replace(truth, chi=truth.chi + noise, chi_error=np.full(SIZE, 0.01))
    assert not ladder_map.compare(only, truth, "chi")["seen"]


def test_chi_and_current_over_chi_are_told_apart() -> None:
    truth = told(0.8, 5.0)
    assert ladder_map.compare(told(0.7, 5.0), truth, "current")["bias"] == 0.0
    assert ladder_map.compare(told(0.8, 4.0), truth, "chi")["bias"] == 0.0
    assert ladder_map.compare(told(0.8, 4.0), truth, "current")["bias"] == pytest.approx(0.2)


def test_a_rung_without_the_state_is_off_and_has_no_current() -> None:
    truth = told(0.8, 5.0)
    none = replace(truth, chi=np.zeros(SIZE), current=np.full(SIZE, math.nan))
    polarised = truth.chi > HALFWAY
    found = ladder_map.compare(none, truth, "chi")
    assert found["bias"] == pytest.approx(np.sqrt(np.mean(truth.chi[polarised] ** 2)))
    assert ladder_map.compare(none, truth, "current")["missing"] == polarised.sum()
    assert ladder_map.compare(none, truth, "transition")["missing"] == len(ladder_map.SLICES)


def test_transition_and_its_error() -> None:
    """An error of chi moves it by that over the slope; two points of five share the slope."""
    values, errors = ladder_map.transitions(told(0.8, 5.0, 0.004))
    slope = 0.8 * 0.2
    assert values[0] == pytest.approx(14.0 + (0.72 - 0.3) / slope)
    assert 0.5 * 0.004 / slope < errors[0] < 0.004 / slope


def test_every_run_is_charged_its_transient() -> None:
    truth = told(0.8, 5.0)
    run = replace(truth, measured=np.full(SIZE, 8000.0), transient=np.full(SIZE, 2000.0))
    found = ladder_map.price(run, truth, "chi")
    assert found == pytest.approx({"seconds": 10.0, "approach": 2.0})
    many = ladder_map.price(run, truth, "transition")
    assert many == pytest.approx({"seconds": 50.0, "approach": 10.0})
    assert ladder_map.price(truth, truth, "chi")["approach"] == 0.0
    one = line("excursion", "exact", bias=0.0, chance=0.01, seconds=10.0, approach=2.0)
    assert ladder_errors.expected(one, "chi", 3.9) == math.inf
    assert ladder_errors.expected(one, "chi", 10.0) == pytest.approx(0.01)
    assert ladder_errors.expected(one, "chi", 34.0) == pytest.approx(0.005)


def test_transients_follow_the_slowest_relaxation() -> None:
    away, near = ladder_map.transients()
    assert away == pytest.approx(3.0 * 25.0 / 0.3**3, rel=0.1)
    assert near == 3.0 * 3000.0


def test_pareto_line_goes_down_from_rung_to_rung() -> None:
    rows = [
        line("cheap", bias=0.1, seconds=1e-2), line("dear", bias=0.2, seconds=1.0),
        line("lacking", bias=0.0, seconds=1e-3, missing=2),
        line("runs", "exact", bias=0.05, chance=0.01, seconds=10.0, approach=1.0),
    ]  # fmt: skip
    errors = ladder_errors.pareto(rows, "chi")
    assert all(one >= other for one, other in itertools.pairwise(errors))
    assert errors[0] == math.inf
    assert errors[-1] < 1e-3
    assert ladder_errors.cheapest(rows, "chi", 0.15) == ("cheap", pytest.approx(1e-2, rel=0.1))
    assert ladder_errors.cheapest(rows, "chi", 0.05) == ("runs", pytest.approx(2.0, rel=0.1))
    assert ladder_errors.cheapest(rows[:2], "chi", 0.05) == ("none", math.inf)


def test_errors_cancel_where_a_finer_rung_is_farther_off() -> None:
    rows = [line("window", bias=0.01), line("renewal", bias=0.03),
            line("direction", bias=0.005), line("timestep 0.01", bias=0.5)]  # fmt: skip
    assert ladder_errors.cancelling(rows, "chi") == ["window"]
    within = [line("window", bias=0.0299), *rows[1:]]
    assert ladder_errors.cancelling(within, "chi") == []


def test_theories_are_asked_at_every_point() -> None:
    asked = []

    def states(circuit: Circuit) -> list[State]:
        asked.append((circuit.channel2_width, circuit.threshold, circuit.age))
        return [State(750.0, "stable", 0.5, -2.0)] if circuit.threshold < 15 else []

    ages = np.arange(1.0, SIZE + 1.0)
    found = ladder_map.ask(replace(MODELS["window"], theory=Theory(states)), ages)
    places = [place[:2] for place in ladder_map.points()]
    assert asked[1:] == [(*place, age) for place, age in zip(places, ages, strict=True)]
    assert found.current[0] == 4.0
    assert np.isnan(found.current[found.chi == 0.0]).all()
    assert (found.seconds >= 0.0).all()


def test_runs_wait_as_long_as_it_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Time measured and transient of each zone, doubled where that is asked for."""
    monkeypatch.setattr(ladder_map, "SLICES", {0.03: ((7,), (14, 15))})
    monkeypatch.setattr(ladder_map, "transients", lambda: (100.0, 300.0))
    found = ladder_map.run_points(Study(tmp_path, HERE), EXCURSION, 50.0, 3, doubled=True)
    assert found.transient == pytest.approx([200.0, 600.0, 600.0])
    assert found.measured == pytest.approx(150.0)
    assert found.chi[0] > 0.5
    assert (found.chi_error > 0.0).all()
    assert (found.seconds > 0.0).all()
    single = ladder_map.run_points(Study(tmp_path, HERE), EXCURSION, 50.0, 1)
    assert np.isnan(single.chi_error).all()
    known = ladder_map.with_errors(single, ladder_map.scatter(found))
    assert known.chi_error == pytest.approx(found.chi_error * math.sqrt(3.0))


def test_the_chart_of_the_page_is_that_of_this_study() -> None:
    """The page of the product has a copy, which must be copied again when the chart is."""
    chart = Path(__file__).with_name("ladder_map.png")
    assert (ROOT / "docs/accuracy.png").read_bytes() == chart.read_bytes()

"""Advice: what is cheap and good enough, for how long runs go, and that it is right."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy import stats

from postproc.accuracy import advice
from postproc.accuracy.advice import Pilot
from postproc.tests.commands import call
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS

if TYPE_CHECKING:
    from pathlib import Path

CASE = """
&table urn_radius = 1.1 0.9, channel1_width = 0.4, channel2_width = 0.02 /
&particles number = 300 /
&gate threshold = 3 4 /
&scan replicas = 4 /
"""
FOUND = Pilot(0.9, 0.009, 0.0, 1000.0, 2000.0, 1e-6, 0.05)


def told(capsys: pytest.CaptureFixture[str]) -> tuple[dict, str]:
    said = capsys.readouterr()
    return json.loads(said.out), said.err


def test_a_namelist_and_the_same_circuit_by_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "case.nml"
    file.write_text(CASE)
    assert call("advise", [str(file), "--tolerance", "0.01"]) == 0
    one, sentence = told(capsys)
    names = ["rung", "replicas", "duration", "cpu_seconds", "confidence", "reason"]
    assert set(names) < set(one)
    assert one["rung"] == "excursion"
    assert f"{one['replicas']} replicas of {one['duration']:g} time units" in sentence
    words = ["--number", "300", "--threshold", "3", "4", "--urn-radius", "1.1", "0.9"]
    words += ["--channel1-width", "0.4", "--channel2-width", "0.02", "--tolerance", "0.01"]
    assert call("advise", words) == 0
    other, _ = told(capsys)
    same = ["rung", "replicas", "duration", "expected", "confidence"]
    assert {name: one[name] for name in same} == {name: other[name] for name in same}


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        (CASE.replace("&table", "&table urn_sides = 8,"), "&table urn_sides"),
        (CASE.replace("replicas = 4", "threshold = 3, 4, 5"), "one point only"),
        (CASE.replace("number = 300", ""), "number is wanted"),
    ],
)
def test_what_there_is_no_advice_on(
    text: str, wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "case.nml"
    file.write_text(text)
    assert call("advise", [str(file)]) == 2
    assert wrong in capsys.readouterr().err


def test_a_run_has_the_error_that_was_wanted() -> None:
    """Half the tolerance takes four times as long; the factor is Student's, of the pilot."""
    replicas, measured = advice.length_of_runs(FOUND, 0.002)
    error = FOUND.scatter * np.sqrt(FOUND.measured / (replicas * measured))
    assert error * stats.t.ppf(0.975, advice.REPLICAS - 1) == pytest.approx(0.002 * 0.9)
    finer = advice.length_of_runs(FOUND, 0.001)
    assert finer[0] * finer[1] == pytest.approx(4.0 * replicas * measured)


def test_rounds_ask_for_replicas_not_for_length() -> None:
    rounds = replace(FOUND, circulating=1e-4)
    replicas, measured = advice.length_of_runs(rounds, 0.001)
    assert measured == FOUND.measured
    alone = FOUND.scatter**2 / (0.0009 / stats.t.ppf(0.975, 15)) ** 2
    assert replicas == pytest.approx(alone * (1.0 + 1e-4 / FOUND.scatter**2), rel=0.01)


def test_circulation_adds_what_is_measured() -> None:
    """At T = 7, w' = 0.01 replicas of 7e4 scatter by 0.013 to 0.07; wide channels feel none."""
    battery = Circuit(1000, 7)
    assert 0.01 < np.sqrt(advice.circulating(battery, 7e4)) < 0.03
    wide = replace(battery, threshold=9, channel2_width=0.0612)
    assert np.sqrt(advice.circulating(wide, 7e4)) < 0.02


def test_theories_are_believed_as_far_as_the_pilot_tells() -> None:
    error = FOUND.scatter / 4.0
    assert advice.chance_of_theory(FOUND, 0.9, 0.02) > 0.999
    edge = 0.9 * 1.01
    assert advice.chance_of_theory(FOUND, edge, 0.01) == pytest.approx(0.5, abs=0.01)
    assert advice.chance_of_theory(FOUND, edge + 5.0 * error, 0.01) < 1e-3


def test_a_theory_is_advised_where_it_is_good_enough() -> None:
    circuit = Circuit(300, 3, 0.4, 0.02)
    groups = advice.table_of(circuit)
    rough = advice.advise(groups, circuit, "chi", 0.1)
    fine = advice.advise(groups, circuit, "chi", 0.003)
    assert rough.replicas == 0
    assert fine.rung == "excursion"
    assert rough.cpu_seconds < fine.cpu_seconds


def test_transition_of_the_battery() -> None:
    circuit = Circuit(1000, 7)
    assert advice.thresholds_of(circuit) == [14, 15, 16, 17, 18]
    assert advice.transition_of(circuit, MODELS["two_port"]) == pytest.approx(15.4, abs=0.1)

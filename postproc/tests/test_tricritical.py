"""Order of the transition: closed forms, the exact gate at T = 1, and the states themselves."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import Chebyshev
from scipy import optimize

from postproc.tests.commands import call
from postproc.theory import fate
from postproc.theory.circuit import Circuit, transition_width
from postproc.theory.gates import WINDOW
from postproc.theory.renewal import RENEWAL
from postproc.theory.states import stationary_states
from postproc.theory.tricritical import order, tricritical


@pytest.mark.parametrize("threshold", [1, 2, 7, 28])
def test_papers_gate_has_its_tricritical_load_in_closed_form(threshold: int) -> None:
    # J''' = g (T + 1 + (T - x)(x - T - 1))/x^2 with g = x^T exp(-x)/(T - 1)!, and J' = Q - g
    load = 0.5 * (2 * threshold + 1 + math.sqrt(4 * threshold + 5))
    found = tricritical(Circuit(1, threshold, gate=WINDOW, urn_radius=1.3))
    assert found.load_per_threshold == pytest.approx(load / threshold, rel=1e-6)
    slope = float(WINDOW.slope(threshold, load))
    assert found.channel2_width == pytest.approx(-0.3 * slope, rel=1e-6)


def test_exact_gate_of_one_has_the_same_tricritical_load() -> None:
    stays, shares = fate.cosine_law(2.0 / math.pi, 200)  # 1 on average

    def through(loads: np.ndarray) -> np.ndarray:
        return np.array([one * (shares @ fate.passing(1, one, stays, shares)) for one in loads])

    def third(load: float) -> float:
        ends = [0.9 * load, 1.1 * load]
        return Chebyshev.interpolate(through, 14, ends).deriv(3)(load)

    expected = optimize.brentq(third, 2.5, 5.0)
    assert tricritical(Circuit(1, 1, gate=RENEWAL)).load_per_threshold == pytest.approx(
        expected, rel=5e-3
    )


@pytest.mark.parametrize(("threshold", "load"), [(7, 1.681), (28, 1.472)])
def test_tricritical_loads_of_the_renewal_gate(threshold: int, load: float) -> None:
    found = tricritical(Circuit(1, threshold, gate=RENEWAL))
    assert found.load_per_threshold == pytest.approx(load, abs=1e-3)
    # an Ohmic channel 2 drops out: a wider channel 1 asks for another w' at the same load
    wide = tricritical(Circuit(1, threshold, channel1_width=0.4, gate=RENEWAL))
    assert wide.load_per_threshold == pytest.approx(found.load_per_threshold, rel=1e-6)
    ratio = wide.channel2_width / found.channel2_width
    assert ratio == pytest.approx(4.0 / 3.0, rel=1e-5)


@pytest.mark.parametrize(("part", "expected"), [(0.9, "continuous"), (1.1, "jump")])
def test_order_is_that_of_the_states_next_to_the_transition(part: float, expected: str) -> None:
    circuit = Circuit(1, 7, gate=RENEWAL)
    circuit = replace(circuit, number=part * tricritical(circuit).number)
    assert order(circuit) == expected
    width = transition_width(circuit)
    below, above = (
        stationary_states(replace(circuit, channel2_width=width * factor))
        for factor in (1.0 - 2e-5, 1.0 + 2e-5)
    )
    # a jump: polarised states beside the homogeneous one that is stable still, and far from it
    assert [one.kind for one in above] == (["unstable", "stable"] if expected == "jump" else [])
    (state,) = below
    assert (state.mass_spread > 0.1) == (expected == "jump")


def test_command_line_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--number", "1000", "--threshold", "7", "--tricritical"]
    assert call("theory", [*words, "--model", "renewal"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["transition"] == "jump"
    assert set(printed["tricritical"]) == {"number", "channel2_width", "load_per_threshold"}
    assert np.isclose(printed["tricritical"]["number"], 984.8, atol=0.1)
    assert call("theory", [*words, "--number", "2", "--model", "renewal"]) == 0
    assert json.loads(capsys.readouterr().out)["tricritical"] == printed["tricritical"]
    assert call("theory", [*words, "--model", "direction"]) == 2
    assert "--tricritical is of" in capsys.readouterr().err
    assert call("theory", [*words, "--threshold", "7", "8", "--model", "renewal"]) == 2

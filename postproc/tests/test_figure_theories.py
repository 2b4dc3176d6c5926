"""Theories as figures draw them: lines of transition, eta, what the channels carry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postproc.figures import theories
from postproc.theory.circuit import Circuit, homogeneous_kind, transition_width


def test_no_theory_is_drawn_solid_as_what_is_measured() -> None:
    dashes = [model.dashes for model in theories.MODELS.values()]
    assert "-" not in dashes
    assert len({*dashes}) == len(dashes)


@pytest.mark.parametrize("name", ["window", "renewal"])
def test_drawn_transition_line_is_where_stability_changes(name: str) -> None:
    model = theories.MODELS[name]
    thresholds, widths = model.transition_line(Circuit(1000, 7), 6, 8)
    width = float(widths[thresholds == 7.0][0])
    below, above = (Circuit(1000, 7, channel2_width=width * factor) for factor in (0.999, 1.001))
    assert homogeneous_kind(model.of(below)) == "unstable"
    assert homogeneous_kind(model.of(above)) == "stable"


@pytest.mark.parametrize("name", ["window", "renewal"])
def test_transition_line_goes_through_whole_thresholds_and_ends_on_the_axis(name: str) -> None:
    model, circuit = theories.MODELS[name], Circuit(1000, 7)
    thresholds, widths = model.transition_line(circuit, 1, 25)
    for one in (4.0, 9.0, 15.0):
        exact = transition_width(replace(model.of(circuit), threshold=int(one)))
        assert widths[thresholds == one] == pytest.approx([exact], rel=1e-5)
    there = np.flatnonzero(np.isfinite(widths))
    assert np.all(np.diff(there) == 1)  # no gap
    assert widths[there[-1]] == 0.0
    assert 16.0 < thresholds[there[-1]] < 17.0
    assert widths[0] < 1e-3
    assert np.abs(np.diff(widths[there])).max() < 0.006  # a smooth line, not one of whole T


@pytest.mark.full
def test_the_line_of_urns_that_remember_is_where_stability_changes() -> None:
    """It is interpolated between a dozen w'; memory moves it down."""
    model, circuit = theories.MODELS["direction"], Circuit(1000, 7)
    _, (width,) = model.transition_line(circuit, 7, 7)
    assert 0.054 < width < 0.066  # runs: between 0.055 and 0.066; the renewal gate: 0.084
    for factor, kind in ((0.97, "unstable"), (1.03, "stable")):
        assert model.homogeneous_kind(replace(circuit, channel2_width=width * factor)) == kind


@pytest.mark.full
def test_a_line_that_remembers_comes_down_to_small_thresholds() -> None:
    """It asks more often where w' is small: the homogeneous state lasts from 0.0016 and 0.0126."""
    line = dict(
        zip(*theories.MODELS["direction"].transition_line(Circuit(1000, 7), 2, 4), strict=True)
    )
    assert line[2.0] < 0.002
    assert 0.010 < line[4.0] < 0.014


def test_memory_says_what_the_channels_carry() -> None:
    """Flows of T = 7 as the program measures them; of equal urns the same both ways."""
    model = theories.MODELS["direction"]
    circuit, even = Circuit(1000, 7), Circuit(1000, 18)
    found = model.levels(circuit, model.reached(circuit, 960.0))
    assert found["current1"] == -found["current2"] == pytest.approx(1.0191, rel=0.01)
    assert found["flow1_12"] - found["flow1_21"] == pytest.approx(found["current1"], rel=0.02)
    assert found["flow2_12"] == pytest.approx(0.0133, abs=0.002)
    alike = model.levels(even, model.reached(even, 480.0))
    assert alike["current2"] == pytest.approx(0.0, abs=1e-6)
    assert alike["flow1_12"] == pytest.approx(12.7, rel=0.03)

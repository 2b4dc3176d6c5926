"""The public circuit: the paper's states, what is refused, and a picture in axes of one's own."""

from __future__ import annotations

import doctest
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from postproc import Circuit, InputError, circuits
from postproc.reading import points, residences


@pytest.mark.parametrize("module", [circuits, points, residences])
def test_examples_print_what_they_say(module: Any) -> None:
    found = doctest.testmod(module)
    assert found.attempted > 0
    assert found.failed == 0


@pytest.mark.parametrize(
    ("threshold", "kinds"),
    [(2, ["stable", "unstable", "stable"]), (7, ["unstable", "stable"]), (18, ["stable"])],
)
def test_states_are_those_of_the_papers_insets(threshold: int, kinds: list[str]) -> None:
    circuit = Circuit(number=1000, threshold=threshold)
    states = circuit.states()
    assert [one.kind for one in states] == kinds
    assert circuit.eta([one.urn2_number for one in states]) == pytest.approx(0.0, abs=1e-9)


def test_lines_of_transition_go_through_the_widths() -> None:
    thresholds = [0, 2, 7, 12, 20, 40]
    for theory in ("window", "renewal"):
        asked, line = Circuit(number=1000, threshold=1).transition_line(thresholds, theory)
        alone = [Circuit(number=1000, threshold=one).transition_width(theory) for one in thresholds]
        assert asked.tolist() == thresholds
        assert line == pytest.approx(np.array(alone), rel=1e-5, nan_ok=True)
        assert np.isfinite(line).tolist() == [True, True, True, True, False, False]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"threshold": -3}, "threshold = -3; allowed: one whole number from 0 up, or two"),
        ({"channel2_width": 2.5}, "channel2_width = 2.5; allowed: one number from 0 up and below"),
        ({"urn_radius": (1.0, 0.1)}, "channel1_width = 0.3; allowed: one number above 0 and below"),
        ({"number": 1.5, "urn_sides": 5}, "urn_sides = 5; allowed: even numbers from 4 up"),
    ],
)
def test_what_is_not_allowed_is_named_with_what_is(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match="allowed: ") as refused:
        Circuit(**{"number": 1000, "threshold": 7, **given})
    assert message in str(refused.value)


def test_eta_is_drawn_into_given_axes() -> None:
    axes = Figure().subplots()
    window, renewal = Circuit(number=1000, threshold=2).plot_eta(["window", "renewal"], ax=axes)
    assert {window.axes, renewal.axes} == {axes}
    places, values = window.get_data()
    assert values == pytest.approx(Circuit(number=1000, threshold=2).eta(1000 * places))

"""The public circuit: the paper's states, what is refused, and a picture in axes of one's own."""

from __future__ import annotations

import doctest
import math
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import xarray as xr
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

import postproc
from postproc import Circuit, InputError
from postproc.tests.runs import results_of
from postproc.theory.models import MODELS
from postproc.theory.states import State

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("examples")
    results_of(made / "map.h5", particles={"number": 200}, run={"duration": 200.0},
               scan={"threshold": [2, 7], "channel2_width": [0.01, 0.05]})  # fmt: skip
    return made


@pytest.mark.parametrize("name", [one for one in postproc._PLACES if not one.endswith("Error")])
def test_every_public_name_has_an_example_that_prints_what_it_says(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Functions and methods, in a folder with results."""
    monkeypatch.chdir(folder)
    given = getattr(postproc, name)
    module = sys.modules[postproc._PLACES[name]]
    parts = [vars(given)[one] for one in getattr(given, "__all__", ())] or [given]
    parts += [one for key, one in vars(given).items() if key[0] != "_" and isinstance(given, type)
              and callable(one) and key != "model"]  # fmt: skip
    for part in parts:
        with plt.rc_context():
            plt.figure()
            (example,) = doctest.DocTestFinder(recurse=False).find(part, name, globs=vars(module))
            found = doctest.DocTestRunner().run(example)
            plt.close("all")
        assert found.attempted > 0, part
        assert found.failed == 0, part


@pytest.mark.parametrize(
    ("threshold", "kinds"),
    [(2, ["stable", "unstable", "stable"]), (7, ["unstable", "stable"]), (18, ["stable"])],
)
def test_states_are_those_of_the_papers_insets(threshold: int, kinds: list[str]) -> None:
    circuit = Circuit(number=1000, threshold=threshold)
    states = circuit.states()
    assert [one.kind for one in states] == kinds
    assert circuit.eta([one.urn2_number for one in states]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("theory", ["window", "renewal"])
def test_eta_and_its_picture_have_both_gates_and_both_urns(theory: str) -> None:
    alike = Circuit(number=1000, threshold=3)
    for one, other in (({"threshold": (3, 18)}, {"threshold": (18, 3)}),
                       ({"urn_radius": (1.0, 2.0)}, {"urn_radius": (2.0, 1.0)})):  # fmt: skip
        unequal = Circuit(**{"number": 1000, "threshold": 3, **one})
        mirrored = Circuit(**{"number": 1000, "threshold": 3, **other})
        places = np.array([100.0, 500.0, 900.0])
        assert np.all(unequal.eta(places, theory) != alike.eta(places, theory))
        assert unequal.eta(places, theory) == pytest.approx(-mirrored.eta(1000 - places, theory))
        axes = Figure().subplots()
        unequal.plot_eta(theory, axes)
        discs = sorted(line.get_xdata()[0] for line in axes.lines if line.get_marker() == "o")
        assert discs == [state.urn2_number / 1000 for state in unequal.states(theory)]


@pytest.mark.parametrize("theory", ["window", "renewal"])
def test_two_gates_that_never_reverse_are_alike(theory: str) -> None:
    (state,) = Circuit(number=24, threshold=(31, 63)).states(theory)
    assert (state.urn2_number, state.kind) == (12.0, "stable")


@pytest.mark.parametrize("theory", ["window", "renewal", "direction"])
@pytest.mark.parametrize("radii", [1.0, (1.0, 2.0)])
def test_where_nothing_passes_each_number_is_kept(radii: object, theory: str) -> None:
    circuit = Circuit(number=100, threshold=0, urn_radius=radii, channel2_width=0.0)
    assert all(one.kind == "neutral" for one in circuit.states(theory))
    assert circuit.eta([10.0, 50.0, 90.0], theory).tolist() == [0.0, 0.0, 0.0]
    reached = MODELS[theory].reached(circuit.model(), 80.0)
    assert reached == State(80.0, "neutral", 0.6, 0.0)


def test_lines_of_transition_go_through_the_widths() -> None:
    thresholds = [0, 2, 7, 12, 20, 40]
    for theory in ("window", "renewal"):
        asked, line = Circuit(number=1000, threshold=1).transition_line(thresholds, theory)
        alone = [Circuit(number=1000, threshold=one).transition_width(theory) for one in thresholds]
        assert asked.tolist() == thresholds
        assert line == pytest.approx(np.array(alone), rel=1e-5, nan_ok=True)
        assert np.isfinite(line).tolist() == [True, True, True, True, False, False]


def test_the_line_of_direction_does_not_depend_on_which_thresholds_are_asked() -> None:
    """Each width is where a small difference between the urns neither grows nor shrinks."""
    _, line = Circuit(number=1000, threshold=2).transition_line([1, 2], "direction")
    _, last = Circuit(number=1000, threshold=2).transition_line(2, "direction")
    assert last[0] == pytest.approx(line[1], rel=1e-3)
    assert line == pytest.approx([2.130e-4, 1.3725e-3], rel=2e-3)
    alone = Circuit(number=1000, threshold=2).transition_width("direction")
    assert alone == pytest.approx(line[1], rel=2e-4)
    assert Circuit(number=1000, threshold=0).transition_width("direction") == 0.0


def test_a_narrow_channel_2_that_ends_the_battery_is_found_by_direction_too() -> None:
    """Far below the narrowest width that it computes first; and w' = 0 is closed."""
    circuit = Circuit(number=2000, threshold=2)
    width = circuit.transition_width("direction")
    assert width == pytest.approx(circuit.transition_width("renewal"), rel=0.05)
    for factor, kind in ((0.0, "unstable"), (0.98, "unstable"), (1.02, "stable")):
        state, *_ = replace(circuit, channel2_width=factor * width).states("direction")
        assert state.kind == kind
    closed = Circuit(number=2000, threshold=1, channel2_width=0.0)
    assert [state.kind for state in closed.states("direction")] == ["unstable", "stable"]
    with pytest.raises(InputError, match="finds no flows"):  # the gates carry less than it knows
        replace(closed, number=1000, channel1_length=3.0).states("direction")


def test_eta_of_memory_is_zero_in_its_states() -> None:
    """Flows are interpolated; without the states among the places this was 0.07."""
    circuit = Circuit(number=1000, threshold=[2, 0], urn_radius=[1.0, 0.5], channel2_width=0.3)
    (state,) = circuit.states("direction")
    assert circuit.eta(state.urn2_number, "direction") == pytest.approx(0.0, abs=5e-3)


def test_a_circuit_has_one_theory_and_no_more_particles_than_the_program() -> None:
    with pytest.raises(InputError, match=r"theory = \['window', 'renewal'\]: must be one name"):
        Circuit(number=1000, threshold=7).states(["window", "renewal"])
    with pytest.raises(InputError, match="a whole number from 1 to 200000000"):
        Circuit(number=200_000_001, threshold=7)


def test_values_of_xarray_are_numbers() -> None:
    """As a loop over a coordinate gives them."""
    thresholds = xr.DataArray([3, 7], dims="threshold")
    assert [Circuit(100, one) for one in thresholds] == [Circuit(100, 3), Circuit(100, 7)]
    assert Circuit(100, thresholds) == Circuit(100, (3, 7))


def test_a_gate_that_never_reverses_has_no_line_of_transition() -> None:
    """It is stable without channel 2: T = N and beyond, of all theories."""
    for theory in ("window", "renewal", "direction"):
        circuit = Circuit(number=10, threshold=10, channel1_length=3.0)
        assert math.isnan(circuit.transition_width(theory))
        assert np.isnan(circuit.transition_line([10, 27], theory)[1]).all()


@pytest.mark.parametrize("theory", ["window", "renewal"])
@pytest.mark.parametrize("threshold", [100, 300])
def test_from_all_particles_on_a_gate_lets_all_through(theory: str, threshold: int) -> None:
    """However many its channel would hold: equal urns, which send out n (w + w')/(pi A)."""
    circuit = Circuit(number=100, threshold=threshold, channel1_width=1.2, channel1_length=20.0,
                      channel2_width=0.1)  # fmt: skip
    assert [state.kind for state in circuit.states(theory)] == ["stable"]
    free = 100.0 * 1.3 / (math.pi * float(circuit.model().urn_area))
    assert circuit.eta(0.0, theory) == pytest.approx(free)


BOW = (1.0, -1.0, -1.0, 1.0, 1.0, 1.0, -1.0, -1.0)
HOOK = (1.0, -1.0, 1.0, 0.5, 3.0, 0.5, 3.0, 2.0, -1.0, 1.0, -1.0, -1.0)
SQUARE = (1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, -1.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"threshold": -3}, "threshold = -3; allowed: one whole number from 0 to 2147483647"),
        ({"channel2_width": 2.5}, "channel2_width = 2.5; allowed: 0, or one number from 9.1e-13"),
        ({"urn_radius": (1.0, 0.1)}, "channel1_width = 0.3; allowed: one number from 9.1e-13"),
        ({"channel1_length": 1e-20}, "channel1_length = 1e-20; allowed: from 9.1e-13 to 1.1e+12"),
        ({"channel1_width": 1e-320}, "channel1_width = 1e-320; allowed: one number from 9.1"),
        (
            {"urn_vertices": (math.nan, -1, 1, 1, -1, 1)},
            "urn_vertices = (nan, -1, 1, 1, -1",
        ),
        ({"urn_vertices": BOW}, "allowed: sides that do not cross or touch each other"),
        ({"urn_vertices": (*SQUARE[:2], *SQUARE)}, "allowed: sides that do not cross or touch"),
        ({"urn_vertices": HOOK, "channel1_length": 0.2}, "allowed: corners beside a channel"),
        ({"number": 10**400}, "allowed: a whole number from 1 to 200000000"),
        ({"urn_vertices": [[1, -1], [1, 1, 2]]}, "allowed: two numbers for each"),
        ({"urn_vertices": (1, -60, 1 + 6e-11, 60, -1, 60, -1, -60)}, "below 0, an upright side"),
        ({"number": xr.Dataset({"a": 1})}, "allowed: a whole number from 1"),
        ({"urn_vertices": 5}, "urn_vertices = 5; allowed: two numbers for each"),
        ({"urn_vertices": SQUARE, "urn_radius": 2.0}, "urn_radius = 2.0; allowed: only without"),
        ({"number": 1.5, "urn_sides": 5}, "urn_sides = 5; allowed: even numbers from 4 to 1000"),
    ],
)
def test_what_is_not_allowed_is_named_with_what_is(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match="allowed: ") as refused:
        Circuit(**{"number": 1000, "threshold": 7, **given})
    assert message in str(refused.value)
    with pytest.raises(InputError, match=r"\Aurn_radius[^;]*;[^;]*; channel1_length[^;]*;[^;]*\Z"):
        Circuit(number=100, threshold=2, channel1_length=1e13, channel2_width=0)
    with pytest.raises(InputError, match="age = -1; allowed: one number from 0 up"):
        Circuit(number=1000, threshold=7).states(age=-1)
    with pytest.raises(InputError, match=r"thresholds = \[2, 1.5\]; allowed: whole numbers"):
        Circuit(number=1000, threshold=7).transition_line([2, 1.5])
    with pytest.raises(InputError, match="thresholds = "):
        Circuit(number=1000, threshold=7).transition_line([True])


def test_eta_is_drawn_into_given_axes() -> None:
    axes = Figure().subplots()
    window, renewal = Circuit(number=1000, threshold=2).plot_eta(["window", "renewal"], ax=axes)
    assert {window.axes, renewal.axes} == {axes}
    places, values = window.get_data()
    assert values == pytest.approx(Circuit(number=1000, threshold=2).eta(1000 * places))


@pytest.mark.parametrize(("number", "threshold", "length", "theory"), [
    (200, 1, 1.0, "renewal"), (1000, 7, 1.0, "renewal"), (1000, 10, 1.0, "renewal"),
    (1000, 10, 1.0, "window"), (500, 2, 0.5, "window"), (300, 2, 2.0, "window"),
])  # fmt: skip
def test_states_alternate_on_the_line_of_transition(
    number: int, threshold: int, length: float, theory: str
) -> None:
    """Where they are nearer to each other than the digits tell."""
    circuit = Circuit(number, threshold, channel1_length=length)
    circuit = replace(circuit, channel2_width=circuit.transition_width(theory))
    kinds = [one.kind for one in circuit.states(theory)]
    assert kinds == (["unstable", "stable"] * 3)[-len(kinds) :]
    found = circuit.lifetimes(theory)
    assert max(found.homogeneous, found.polarised) > 0.0

"""Theory: limits, symmetries and the values of the model's exact description."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, optimize

from postproc.tests.commands import call
from postproc.theory.circuit import (
    Circuit,
    eta,
    flow1,
    flow2,
    homogeneous_kind,
    log_outflow,
    single_urn_current,
    transition_width,
)
from postproc.theory.gates import WINDOW
from postproc.theory.models import MODELS, describe
from postproc.theory.states import crossings, stationary_states

PAPER = Circuit(number=1000, threshold=7)
THRESHOLDS = (1, 2, 4, 7, 12, 15, 18, 25)


@pytest.mark.parametrize(
    ("threshold", "homogeneous", "roots"),
    [
        (2, "stable", [(874.175, "unstable", 0.7484, 0.7588), (958.721, "stable", 0.9174, 0.9302)]),
        (7, "unstable", [(968.727, "stable", 0.9375, 0.9505)]),
        (18, "stable", []),
    ],
)
def test_states_of_the_papers_three_panels(
    threshold: int, homogeneous: str, roots: list[tuple[float, str, float, float]]
) -> None:
    circuit = replace(PAPER, threshold=threshold)
    states = stationary_states(circuit)
    assert homogeneous_kind(circuit) == homogeneous
    assert [state.kind for state in states] == [root[1] for root in roots]
    for state, (number, _, spread, current) in zip(states, roots, strict=True):
        assert state.urn2_number == pytest.approx(number, abs=5e-4)
        assert state.mass_spread == pytest.approx(spread, abs=5e-5)
        assert state.net_current == pytest.approx(current, abs=5e-5)


@pytest.mark.parametrize("theory", ["window", "renewal"])
def test_a_gate_that_passes_nothing_beside_one_that_passes_all(theory: str) -> None:
    """By hand N1 w' = N2 (w + w')."""
    circuit = Circuit(1000, 18, 1.0, 0.3, gate2_threshold=1000)
    for length in (1.0, 10.0):
        one = replace(circuit, channel1_length=length)
        (state,), homogeneous = MODELS[theory].states(one), MODELS[theory].homogeneous_kind(one)
        assert (state.kind, homogeneous) == ("stable", "")
        assert state.urn2_number == pytest.approx(187.5, abs=1e-3)
        area = float(circuit.urn_area)
        assert state.net_current == pytest.approx((187.5 - 812.5) * 0.3 / (math.pi * area))
    closed = replace(circuit, threshold=0, channel2_width=0.0)
    assert [one.urn2_number for one in MODELS[theory].states(closed)] == [0.0]
    closed = replace(circuit, channel2_width=0.0, channel1_length=10.0)
    assert [one.urn2_number for one in MODELS[theory].states(closed)] == [0.0]


def test_unequal_circuits_have_stable_states_with_unstable_ones_between() -> None:
    """What flows from urn 1 to 2 less what flows back changes its sign from N2 = 0 to N2 = N."""
    random = np.random.default_rng(4)
    for at in range(200):
        number, *thresholds = (int(10.0**one) for one in random.uniform([1, 0, 0], [4, 3, 3]))
        width1, radius = (float(one) for one in random.uniform([0.05, 0.8], [1.5, 1.6]))
        width2, length = (float(10.0**one) for one in random.uniform([-3.0, -1.0], [0.2, 1.0]))
        circuit = Circuit(
            number, thresholds[0], width1, width2 if at % 5 else 0.0, channel1_length=length,
            gate2_threshold=thresholds[1], urn2_radius=radius if at % 2 else 1.0,
        )  # fmt: skip
        for theory in ("window", "renewal"):
            model = MODELS[theory]
            kinds = [kind for _, kind in sorted(model.zeros(circuit))]
            assert kinds[::2] == ["stable"] * (len(kinds) // 2 + 1), circuit
            assert kinds[1::2] == ["unstable"] * (len(kinds) // 2), circuit


@pytest.mark.parametrize("theory", ["window", "renewal", "direction"])
@pytest.mark.parametrize("unequal", [{}, {"gate2_threshold": 9, "urn2_radius": 1.2}])
def test_nothing_flows_through_a_closed_channel_2(theory: str, unequal: dict[str, float]) -> None:
    circuit, model = Circuit(400, 4, channel2_width=0.0, **unequal), MODELS[theory]
    for state in (found := model.states(circuit)):
        assert str(state.net_current) == "0.0"
        assert state.net_current_infinite_age in (None, 0.0)
    levels = model.levels(circuit, found[-1])
    assert [str(levels[f"current{one}"]) for one in (1, 2)] == ["0.0", "0.0"]
    assert levels["flow2_12"] == levels["flow2_21"] == 0.0


def test_urn_area_is_the_disc_between_its_chords() -> None:
    radius, width1, width2 = 1.3, 0.9, 0.4
    chord1, chord2 = (math.sqrt(radius**2 - width**2 / 4) for width in (width1, width2))
    area, _ = integrate.quad(lambda x: 2 * math.sqrt(radius**2 - x**2), -chord2, chord1)
    circuit = Circuit(1, 1, width1, width2, radius)
    assert float(circuit.urn_area) == pytest.approx(area, rel=1e-10)
    assert np.array(circuit.chords) == pytest.approx([chord1, chord2], rel=1e-12)


def test_window_counts_poisson_entries() -> None:
    load, threshold = 3.7, 5
    terms = [load**count * math.exp(-load) / math.factorial(count) for count in range(threshold)]
    assert WINDOW.share(threshold, load) == pytest.approx(sum(terms), rel=1e-13)


def test_slope_of_the_window_is_its_derivative() -> None:
    loads, step = np.linspace(0.5, 30.0, 60), 1e-5
    for threshold in THRESHOLDS:
        higher, lower = (
            (loads + sign * step) * WINDOW.share(threshold, loads + sign * step) for sign in (1, -1)
        )
        slope = WINDOW.slope(threshold, loads)
        assert slope == pytest.approx((higher - lower) / (2 * step), abs=1e-8)


def test_logarithm_of_the_share_goes_on_below_the_smallest_number() -> None:
    assert WINDOW.log_share(7, 20.0) == pytest.approx(np.log(WINDOW.share(7, 20.0)))
    loads = np.linspace(600.0, 760.0, 400)  # the share leaves the range of a double in between
    steps = np.diff(WINDOW.log_share(7, loads))
    assert np.all(np.isfinite(steps))
    assert np.diff(steps) == pytest.approx(0.0, abs=1e-4)


def test_eta_is_antisymmetric_under_the_mirror() -> None:
    second = np.linspace(0.0, 1000.0, 201)
    flow = eta(PAPER, second)
    assert flow == pytest.approx(-flow[::-1], abs=1e-12)


def test_arrays_broadcast() -> None:
    circuits = Circuit(1000, np.array(THRESHOLDS)[:, None], channel2_width=np.array([0.01, 0.02]))
    assert eta(circuits, 700.0).shape == (len(THRESHOLDS), 2)
    one = eta(Circuit(1000, 4, channel2_width=0.02), 700.0)
    assert eta(circuits, 700.0)[2, 1] == pytest.approx(float(one))


@pytest.mark.parametrize("threshold", THRESHOLDS)
@pytest.mark.parametrize("width", [0.0, 0.001, 0.01, 0.05])
def test_roots_are_zeros_and_the_slope_tells_their_kind(threshold: int, width: float) -> None:
    circuit = replace(PAPER, threshold=threshold, channel2_width=width)
    flow = float(flow1(circuit, 500.0) + flow2(circuit, 500.0))
    kinds = [homogeneous_kind(circuit)]
    for state in stationary_states(circuit):
        assert eta(circuit, state.urn2_number) == pytest.approx(0.0, abs=1e-9 * (1 + flow))
        first = (circuit.number - state.urn2_number) * np.array([1.0 + 1e-6, 1.0 - 1e-6])
        sent = log_outflow(circuit, first), log_outflow(circuit, circuit.number - first)
        gains = np.diff(sent[0] - sent[1])
        assert state.kind == ("stable" if gains < 0 else "unstable")
        kinds.append(state.kind)
    assert all(one != other for one, other in itertools.pairwise(kinds))
    assert kinds[-1] == "stable"


@pytest.mark.parametrize("threshold", THRESHOLDS)
@pytest.mark.parametrize("width", [0.003, 0.01, 0.05])
def test_no_root_is_missed(threshold: int, width: float) -> None:
    circuit = replace(PAPER, threshold=threshold, channel2_width=width)
    second = np.linspace(500.05, 999.999, 200_000)
    changes = np.count_nonzero(np.diff(np.sign(eta(circuit, second))))
    assert changes == len(stationary_states(circuit))


@pytest.mark.parametrize("threshold", [2, 4, 7, 10, 13])
def test_homogeneous_state_changes_stability_at_the_transition_line(threshold: int) -> None:
    circuit = replace(PAPER, threshold=threshold)
    width = transition_width(circuit)
    kinds = [
        homogeneous_kind(replace(circuit, channel2_width=width * factor))
        for factor in (1 - 1e-6, 1 + 1e-6)
    ]
    assert kinds == ["unstable", "stable"]


def test_transition_line_obeys_its_formula() -> None:
    circuit = replace(PAPER, channel2_width=transition_width(PAPER))
    x = 1000 * 0.3 / (8 * float(circuit.urn_area))
    formula = x**7 * math.exp(-x) / math.factorial(6) - float(WINDOW.share(7, x))
    assert circuit.channel2_width / 0.3 == pytest.approx(formula, rel=1e-9)


def test_threshold_zero_lets_nothing_through() -> None:
    circuit = replace(PAPER, threshold=0)
    assert flow1(circuit, np.array([0.0, 10.0, 1000.0])) == pytest.approx(0.0)
    assert homogeneous_kind(circuit) == "stable"
    assert stationary_states(circuit) == []


def test_a_constant_balance_is_not_searched_for_minima(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gate that lets nobody pass makes it constant over half of the places."""

    def search(*_: object, **__: object) -> None:
        raise AssertionError("searched")

    monkeypatch.setattr(optimize, "minimize_scalar", search)
    places = np.linspace(1.0, 0.0, 50)
    assert crossings(lambda at: np.full(np.shape(at), 2.0), places, np.full(50, 2.0)) == []


@pytest.mark.parametrize("name", MODELS)
def test_no_gate_reverses_from_all_particles_on(name: str) -> None:
    model = MODELS[name]
    one, far = (describe(Circuit(40, threshold), model) for threshold in (40, 10**9))
    assert one == far
    line = model.transition_line(Circuit(4, 10**9), 1, 10**9) if model.mixed else ([3.0], [])
    assert line[0][-1] == 3.0
    # Nor where no integer of numpy is as large as a load.
    long = replace(PAPER, number=2 * 10**8, threshold=2 * 10**8 + 1, channel1_width=1.0,
                   channel1_length=1e12, channel2_width=0.0)  # fmt: skip
    assert not model.mixed or describe(long, model)["homogeneous"] == "stable"


def test_no_gate_is_felt_at_a_threshold_of_all_particles() -> None:
    circuit = replace(PAPER, threshold=1000)
    free = 600 * 0.3 / (math.pi * float(circuit.urn_area))
    assert flow1(circuit, 600.0) == pytest.approx(free, rel=1e-14)
    assert stationary_states(circuit) == []


def test_one_channel_model_carries_no_current() -> None:
    circuit = replace(PAPER, channel2_width=0.0)
    (state,) = stationary_states(circuit)
    assert state.kind == "stable"
    assert state.net_current == 0.0
    assert state.mass_spread > 0.999


@pytest.mark.parametrize("width", [0.0, 0.01])
@pytest.mark.parametrize("threshold", [0, 1, 100, 60_000, 100_000, 119_437, 200_000])
def test_ten_million_particles(threshold: int, width: float) -> None:
    circuit = Circuit(10_000_000, threshold, channel2_width=width)
    for state in stationary_states(circuit):
        assert np.isfinite(state.net_current)
        assert 0.5 < state.urn2_number / circuit.number <= 1.0


def test_single_urn_is_the_gates_flow() -> None:
    current = single_urn_current(Circuit([500, 1000], [[2], [9]], 0.2, 0.0, shape="urn"))
    urn = Circuit(1000, 9, 0.2, 0.0)
    assert current.shape == (2, 2)
    assert current[1, 1] == pytest.approx(float(flow1(urn, 1000)))


def test_command_line_prints_the_contract(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("theory", ["--number", "1000", "--threshold", "7"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed) == {"homogeneous", "roots", "transition_width", "urn_area", "direction"}
    assert set(printed["roots"][0]) == {"urn2_number", "kind", "mass_spread", "net_current"}


@pytest.mark.parametrize(
    "change",
    [
        ("--number", "0"),
        ("--threshold", "-1"),
        ("--channel1-width", "2"),
        ("--channel1-width", "nan"),
        ("--channel2-width", "-0.1"),
        ("--channel1-length", "0"),
        ("--number", "many"),
    ],
)
def test_bad_values_give_one_line_and_exit_2(
    change: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--number", "1000", "--threshold", "7", *change]
    try:
        code = call("theory", arguments)
    except SystemExit as stop:
        code = stop.code
    error = capsys.readouterr().err
    assert code == 2
    assert error.count("\n") == 1
    assert change[0] in error

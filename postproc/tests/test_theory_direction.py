"""Directions: transfer by drawn visits, fates by a simulated gate, and the lifetimes measured."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from postproc.cli import InputError
from postproc.tests.commands import call
from postproc.theory import direction, fate, ports
from postproc.theory.chain import passage_times
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS
from postproc.theory.renewal import RENEWAL

LOW, HIGH = 0.2, 0.7  # chi of the passages, as `figures.passages` has them
# T = 1, 32 runs of 40000 time units a point (namelists/lifetimes_one.nml), and where few of them
# had any 32 of 400000 as well (lifetimes_rare_one.nml): first passages from chi = 0 to 0.7 and from
# 1 to 0.2; T = 2 likewise
MEASURED = (
    (1, 340, 5.5e3, math.nan), (1, 360, 7.65e3, 2.58e5), (1, 380, 1.61e4, 2.69e4),
    (1, 400, 1.59e5, 9.58e3), (1, 420, math.nan, 5.15e3), (1, 480, math.nan, 2.12e3),
    (2, 860, math.nan, 2.63e3),
)  # fmt: skip
# T = 2, l = 4 likewise (lifetimes_long_gate.nml, lifetimes_rare_long_gate.nml)
LONG_GATE = (
    (160, 5.81e3, 4.86e5), (180, 7.27e4, 1.76e4), (190, 4.68e5, 8.39e3),
)  # fmt: skip
CROSSING = 383.1  # N at which both lifetimes are equal, T = 1, by these runs


def near(circuit: Circuit, *measured: float) -> None:
    """Hold the chain's passages from chi = 0 and from 1 against what is measured, if it is."""
    asked, theory = MODELS["direction"].of(circuit), MODELS["direction"].theory
    for one, seen in zip(passage_times(asked, LOW, HIGH, theory=theory), measured, strict=True):
        assert math.isnan(seen) or seen / 3.0 < one < 3.0 * seen


def simulated(
    threshold: int, rate: float, stays: np.ndarray, shares: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares of each stay that get through a gate, and their errors."""
    random, gates, entries = np.random.default_rng(1), 1500, 500
    leaves, who = np.full((threshold, gates), -1.0), np.full((threshold, gates), -1)
    clock, came, out = np.zeros(gates), np.zeros(stays.size), np.zeros(stays.size)
    at = np.arange(gates)
    kinds = random.choice(stays.size, p=shares, size=(entries, gates))
    for entry, kind in enumerate(kinds):
        clock += random.exponential(1.0 / rate, gates)
        oldest = leaves.argmin(axis=0)
        full = np.flatnonzero(leaves[oldest, at] > clock)
        if entry >= entries // 4:
            came += np.bincount(kind, minlength=stays.size)
            out += np.bincount(kind[full], minlength=stays.size)
            out += np.bincount(who[:, full].ravel(), minlength=stays.size)
        leaves[oldest, at], who[oldest, at] = clock + stays[kind], kind
        leaves[:, full], who[:, full] = -1.0, 0
    return 1.0 - out / came, np.sqrt(np.maximum(out, 1.0)) / came


def test_fate_at_one_is_known_exactly() -> None:
    stays, shares = fate.cosine_law(0.5, 200)
    load = 1.3
    found = fate.passing(1, load / (0.25 * math.pi), stays, shares)
    assert shares @ found == pytest.approx(RENEWAL.share(1, load), rel=1e-3)
    ratio = found[:50] / found[0]
    assert ratio == pytest.approx(np.exp(-load / (0.25 * math.pi) * (stays[:50] - stays[0])))


@pytest.mark.parametrize(("threshold", "load"), [(2, 1.0), (4, 3.0), (7, 5.0), (15, 12.0)])
@pytest.mark.parametrize("tilt", [-0.8, 0.0, 0.8])
def test_fates_are_those_of_a_simulated_gate(threshold: int, load: float, tilt: float) -> None:
    sine, weights = fate.directions(12)
    shares = weights * (1.0 + tilt * (sine - 0.5))
    shares = shares / shares.sum()
    stays = 0.5 / np.sqrt(1.0 - sine**2)
    rate = load / float(shares @ stays)
    found = fate.passing(threshold, rate, stays, shares)
    seen, error = simulated(threshold, rate, stays, shares)
    assert shares @ found == pytest.approx(float(shares @ seen), abs=0.006)
    assert np.all(np.abs(found - seen) < 0.02 + 5.0 * error)
    assert np.all(np.diff(found) <= 0.0)


@pytest.mark.parametrize(("threshold", "load"), [(1, 1.0), (2, 2.0), (7, 8.0), (15, 12.0)])
def test_fates_of_the_cosine_law_add_up_to_the_renewal_gate(threshold: int, load: float) -> None:
    stays, shares = fate.cosine_law(0.35)
    rate = load / (0.35 * 0.5 * math.pi)
    found = shares @ fate.passing(threshold, rate, stays, shares)
    assert found == pytest.approx(float(RENEWAL.share(threshold, load)), abs=6e-3)


def test_fates_at_any_load_are_chances() -> None:
    stays, shares = fate.cosine_law(0.5)
    for threshold in (1, 2, 7, 25):
        before = 1.0
        for load in (1e-3, 0.1, 1.0, 5.0, 12.0, 30.0, 200.0):
            found = fate.passing(threshold, load / float(shares @ stays), stays, shares)
            assert np.all((found >= 0.0) & (found <= 1.0))
            assert shares @ found <= before + 1e-9
            before = float(shares @ found)


@pytest.mark.parametrize("threshold", [2, 5, 15])
def test_share_that_passes_has_no_jump(threshold: int) -> None:
    """Though first passages do not know it where next to no particle passes."""
    sine, weights = fate.directions(12)
    shares = weights * (1.0 + 0.2 * (sine - 0.5))
    shares = shares / shares.sum()
    stays = 0.5 / np.sqrt(1.0 - sine**2)
    loads = np.geomspace(1.5, 6.0, 241) * threshold
    found = [fate.overall_share(threshold, one / float(shares @ stays), stays, shares)
             for one in loads]  # fmt: skip
    assert found[0] > 3.0 * fate.CLOSED > fate.CLOSED > 10.0 * found[-1]
    slope = np.diff(np.log(found))
    assert np.all(slope < 0.0)
    assert np.abs(np.diff(slope)).max() < 0.05


@pytest.mark.parametrize("widths", [(0.3, 0.01), (0.3, 0.4)])
def test_transfer_reads_backwards_and_loses_nobody(widths: tuple[float, float]) -> None:
    found = direction.transfer(1.0, *widths)
    kernel = found.kernel
    assert kernel[:, :, 0, 0].sum(axis=1) == pytest.approx([1.0, 1.0], rel=1e-12)
    for own in (0, 1):
        assert kernel[own, own] == pytest.approx(kernel[own, own].T, abs=2e-4)
    assert widths[0] * kernel[0, 1] == pytest.approx(widths[1] * kernel[1, 0].T, abs=1e-3)
    port = ports.disc(Circuit(1, 1, *widths))
    assert kernel[1, 1, 0, 0] == pytest.approx(port.return_chance, abs=1e-4)
    assert found.stay[:, 0] == pytest.approx([port.stay1, port.stay2], rel=1e-3)


def test_cosine_of_entries_is_remembered_over_visits() -> None:
    # autocorrelation of cos(theta) after 1, 5, 10, 20, 40 visits, w = 0.3: by drawn visits
    sine, weights = fate.directions()
    basis = direction.polynomials(sine)
    start = basis @ (weights * np.sqrt(1.0 - sine**2))
    kernel = direction.transfer(1.0, 0.3, 0.001).kernel[0, 0]
    kernel = kernel / kernel[0, 0]
    one = start.copy()
    found, mean = [], start[0] ** 2
    for _ in range(40):
        one = kernel.T @ one
        found.append((start @ one - mean) / (start @ start - mean))
    expected = [0.96, 0.82, 0.67, 0.47, 0.23]
    assert [found[k - 1] for k in (1, 5, 10, 20, 40)] == pytest.approx(expected, abs=0.035)


# w and w', then K11, K12, K21 and K22 of the second Legendre polynomial by 4e6 drawn visits, and
# their errors, by the study of accuracy
DRAWN = (
    ((0.1, 0.05), (0.583808, 0.411443, 0.823611, 0.173733), (5.8e-4, 5.2e-4, 9.1e-4, 5.0e-4)),
    ((0.03, 0.003), (0.902923, 0.0959015, 0.961474, 0.0395338), (5.6e-4, 2.3e-4, 1.8e-3, 4.8e-4)),
    ((0.01, 0.01), (0.332694, 0.666719, 0.665974, 0.333312), (5.5e-4, 7.0e-4, 7.0e-4, 5.5e-4)),
    ((0.001, 0.0005), (0.588433, 0.410987, 0.822184, 0.177146), (5.9e-4, 5.2e-4, 9.0e-4, 5.1e-4)),
    ((0.003, 0.03), (0.0392779, 0.960114, 0.0955358, 0.903455), (4.8e-4, 1.8e-3, 2.3e-4, 5.6e-4)),
)


@pytest.mark.parametrize(("widths", "means", "errors"), DRAWN)
def test_transfer_by_narrow_openings_is_that_of_drawn_visits(
    widths: tuple[float, ...], means: tuple[float, ...], errors: tuple[float, ...]
) -> None:
    kernel = direction.transfer(1.0, *widths).kernel[:, :, 1, 1].ravel()
    assert np.all(np.abs(kernel - means) < 5.0 * np.array(errors))


def test_diffusion_of_directions_is_derived() -> None:
    """It is half the mean square of y + y', with the density of returns; see the module's head."""

    def density(mu: float, e: float, power: int) -> float:
        return mu**power * math.log((1.0 + mu + e) / (1.0 + mu - e)) / e

    norm, square = (
        integrate.dblquad(density, 0.0, 1.0, 0.0, lambda e: 1.0 - e, args=(power,))[0]
        for power in (0, 2)
    )
    assert norm == pytest.approx(math.pi**2 / 12.0, rel=1e-9)
    assert 0.5 * square / norm == pytest.approx(direction.DIFFUSION, rel=1e-9)
    assert pytest.approx(1.0 / 12.0, rel=0.2) != direction.DIFFUSION


def test_where_fates_ask_for_no_direction_the_cosine_law_comes_out() -> None:
    # nearly free gates: everyone passes
    circuit = Circuit(200, 60, 0.3, 0.05, gate=RENEWAL)
    held = direction.Directions(circuit).held(0.3)
    assert held.in_half.sum() == pytest.approx(200.0, rel=1e-4)
    # with the gates open directions stay as they come in: by the cosine law
    law = held.entries @ direction.polynomials(fate.directions()[0])
    assert law / held.entries[:, :1] == pytest.approx(1.0, abs=0.2)
    assert held.entries[0, 0] < held.entries[1, 0]


def test_sparse_urn_sends_less_than_well_mixed() -> None:
    # measured 0.85 to 0.92; T = 1, N = 400, sparse urn with 14, 23, 31, 46 particles
    circuit = Circuit(400, 1, gate=RENEWAL)
    equations, stays = direction.Directions(circuit), fate.cosine_law(0.5)
    found = []
    for number in (14, 23, 31, 46):
        held = equations.held(number / 400.0)
        rate = held.in_urn[0] * 0.3 / (math.pi * float(circuit.urn_area))
        found.append(held.through[0] / (rate * stays[1] @ fate.passing(1, rate, *stays)))
    assert found == pytest.approx([0.93, 0.93, 0.89, 0.85], abs=0.04)
    assert all(one > other for one, other in itertools.pairwise(found))


def test_drift_vanishes_at_380() -> None:
    for number, sign in ((360, 1.0), (380, 0.0), (400, -1.0)):
        equations = direction.Directions(Circuit(number, 1, gate=RENEWAL))
        for chi in (0.25, 0.4, 0.57):
            held = equations.held(0.5 * (1.0 - chi))
            drift = math.log(held.sent[0] / held.sent[1])
            assert drift == pytest.approx(0.0, abs=0.02) if sign == 0.0 else drift * sign > 0.02


def test_polarised_state_is_lost_between_380_and_400() -> None:
    for number, states in ((380, 1), (400, 0)):
        circuit = Circuit(number, 1, gate=RENEWAL)
        found = [one for one in direction.stationary_states(circuit) if one.kind == "stable"]
        assert len(found) == states


@pytest.mark.parametrize(("threshold", "number", "homogeneous", "polarised"), MEASURED)
def test_lifetimes_are_within_a_factor_of_three(
    threshold: int, number: int, homogeneous: float, polarised: float
) -> None:
    near(Circuit(number, threshold), homogeneous, polarised)


@pytest.mark.parametrize(("number", "homogeneous", "polarised"), LONG_GATE)
def test_lifetimes_of_a_long_gate_are_within_a_factor_of_three(
    number: int, homogeneous: float, polarised: float
) -> None:
    near(Circuit(number, 2, channel1_length=4.0), homogeneous, polarised)


def test_both_states_live_equally_long_where_they_are_measured_to() -> None:
    numbers, logs = np.arange(370, 396, 12), []
    for number in numbers:
        circuit = MODELS["direction"].of(Circuit(int(number), 1))
        one, other = passage_times(circuit, LOW, HIGH, theory=MODELS["direction"].theory)
        logs.append(math.log(one / other))
    assert np.all(np.diff(logs) > 0.0)
    assert float(np.interp(0.0, logs, numbers)) == pytest.approx(CROSSING, rel=0.05)


def test_state_does_not_depend_on_where_it_is_looked_for_from() -> None:
    circuit = Circuit(1000, 7, gate=RENEWAL)
    equations = direction.Directions(circuit)
    fresh = equations.held(0.1)
    led = equations.held(0.1, equations.held(0.2))
    assert led.entries[:, 0] == pytest.approx(fresh.entries[:, 0], rel=1e-4)
    assert led.through == pytest.approx(fresh.through, rel=1e-3)


@pytest.mark.parametrize(
    "circuit",
    [
        Circuit(1000, 7, channel2_width=0.0), Circuit(1000, 5, channel2_width=1e-4),
        Circuit(10000, 100, 0.5, 0.0, channel1_length=0.4),
        Circuit(10000, 100, 0.5, 0.0, channel1_length=0.6),
    ],
    ids=str,
)  # fmt: skip
def test_nearly_all_particles_in_one_urn_are_found(circuit: Circuit) -> None:
    """Where the homogeneous state is unstable another one is not."""
    stable = MODELS["direction"].solve_stable(circuit)
    assert stable
    assert stable[-1].mass_spread > 0.9


@pytest.mark.parametrize(("number", "width", "length"), [(1e5, 1e-6, 3.0), (3e5, 1e-6, 1.0)])
def test_a_state_with_nearly_all_particles_in_one_urn_is_found_beside_a_stable_homogeneous_one(
    number: float, width: float, length: float
) -> None:
    circuit = Circuit(number, 1, channel2_width=width, channel1_length=length)
    assert direction.homogeneous_kind(circuit) == "stable"
    found = direction.stationary_states(circuit)
    assert [one.kind for one in found] == ["unstable", "stable"]
    spreads = [one.mass_spread for one in found]
    assert spreads == pytest.approx(
        [one.mass_spread for one in MODELS["renewal"].solve(circuit)], abs=1e-3
    )
    assert spreads[0] > 0.998


def test_states_between_two_points_of_the_scan_are_found() -> None:
    """Next to where they begin to exist, at w' = 0.0300."""
    circuit = Circuit(1000, 5, channel2_width=0.03)
    found = [(one.kind, round(one.mass_spread, 2)) for one in direction.stationary_states(circuit)]
    assert found == [("unstable", 0.67), ("stable", 0.70)]
    emptied = Circuit(1e5, 1, channel2_width=1e-6, channel1_length=28.0)
    kinds = [one.kind for one in direction.stationary_states(emptied)]
    assert kinds == ["unstable", "stable"]


def test_the_current_is_proportional_to_a_very_narrow_channel_2() -> None:
    narrow = [Circuit(1000, 7, channel2_width=width) for width in (1e-12, 1e-6)]
    small, large = (direction.stationary_states(one)[-1].net_current for one in narrow)
    assert large / small == pytest.approx(1e6, rel=1e-3)
    small, large = (direction.flows(one, 950.0)[1].sum() for one in narrow)
    assert large / small == pytest.approx(1e6, rel=1e-3)
    unequal = [Circuit(1000, 7, channel2_width=width, urn2_radius=5.0) for width in (1e-10, 1e-7)]
    small, large = (direction.stationary_states(one)[0].net_current for one in unequal)
    assert large / small == pytest.approx(1e3, rel=0.01)


@pytest.mark.parametrize(("width", "length", "modes"), [(0.3, 0.46579, 1), (0.03, 4.6579, 2)])
def test_a_narrow_channel_1_does_not_hide_that_equal_urns_are_left(
    width: float, length: float, modes: int
) -> None:
    """At one load of the gates; two runs at w = 0.03 left them for chi = 0.97 by t = 1e5."""
    circuit = Circuit(1000, 4, width, 0.0, channel1_length=length)
    equations = direction.Directions(circuit)
    assert direction._growing_modes(equations, equations.held(0.49)) == modes
    assert direction.homogeneous_kind(circuit) == "unstable"
    (state,) = direction.stationary_states(circuit)
    assert (state.kind, state.mass_spread) == ("stable", pytest.approx(0.969, abs=1e-3))


def test_thresholds_above_the_number_of_particles_have_one_state() -> None:
    circuit = Circuit(number=10**6, threshold=10**6 + 5, channel1_width=1e-3, channel2_width=0.0281)
    assert MODELS["direction"].homogeneous_kind(circuit) == "stable"
    assert 10**6 < fate._closed_load(10**6) < 0.5 * math.pi * 10**6


def test_a_gate_with_room_for_many_has_chances() -> None:
    stays, shares = fate.cosine_law(0.5)
    with np.errstate(all="raise", under="ignore"):
        assert fate.passing(150, 1e-3 * 150, stays, shares) == pytest.approx(1.0)
        found = fate.passing(150, 150 / (0.25 * math.pi) * 1.1, stays, shares)
    assert np.all((found > 0.0) & (found < 1.0))


def test_command_line_and_exchange_of_unlike_halves(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--number", "400", "--channel1-length", "1.2", "--model", "direction"]
    said = []
    for pair, radii in ((("1", "2"), ("1", "1.1")), (("2", "1"), ("1.1", "1"))):
        assert call("theory", [*words, "--threshold", *pair, "--urn-radius", *radii]) == 0
        said.append(json.loads(capsys.readouterr().out))
    here, there = (sorted(one["urn2_number"] for one in printed["roots"]) for printed in said)
    assert here == pytest.approx(sorted(400.0 - one for one in there), abs=0.05)
    assert said[0]["homogeneous"] == said[1]["homogeneous"]


def test_lifetimes_command_takes_every_theory(capsys: pytest.CaptureFixture[str]) -> None:
    found = {}
    for model in ("renewal", "direction"):
        words = ["--number", "380", "--threshold", "1", "--model", model]
        assert call("lifetimes", words) == 0
        found[model] = json.loads(capsys.readouterr().out)
    assert found["renewal"]["polarised_share"] > found["direction"]["polarised_share"]
    assert call("lifetimes", ["--number", "380", "--threshold", "1", "2"]) == 2
    replaced = replace(Circuit(380, 1), gate2_threshold=1)
    assert replaced.alike


@pytest.mark.parametrize(
    ("number", "thresholds", "width", "length"),
    [(1000, (0, 7), 1e-4, 1.0), (1000, (7, 5), 1e-5, 1.0), (100_000, (1, 2), 1e-6, 3.0)],
)
def test_mirror_images_have_the_same_states(
    number: int, thresholds: tuple[int, int], width: float, length: float
) -> None:
    """Down to the emptiest urn, whichever of the two it is."""
    both = [
        Circuit(number, one, 0.3, width, channel1_length=length, gate2_threshold=two)
        for one, two in (thresholds, thresholds[::-1])
    ]
    here, there = (direction.stationary_states(one) for one in both)
    assert [one.kind for one in here] == [one.kind for one in reversed(there)]
    assert here[0].kind == here[-1].kind == "stable"
    mirrored = [number - one.urn2_number for one in reversed(there)]
    found = [one.urn2_number for one in here]
    assert found == pytest.approx(mirrored, abs=2e-5 * number)
    assert (found[0], number - found[-1]) == pytest.approx(
        (mirrored[0], number - mirrored[-1]), abs=0.02
    )


@pytest.mark.parametrize(
    ("width1", "width2", "measured"), [(0.3, 0.8, 1.5863), (1.0, 1.0, 0.0), (0.1, 0.2, 2.8470)]
)
def test_unequal_gates_drive_the_measured_current_through_a_wide_channel_2(
    width1: float, width2: float, measured: float
) -> None:
    """Four runs of 60000 time units each, with errors of 0.004 at most."""
    circuit = Circuit(1000, 7, width1, width2, gate2_threshold=3)
    (state,) = direction.stationary_states(circuit)
    assert state.net_current == pytest.approx(measured, rel=0.015, abs=0.01)


@pytest.mark.parametrize(
    ("circuit", "chi"),
    [
        (Circuit(1031, 16, 0.1, 1e-4, channel1_length=5.0, channel2_length=5.0), 0.995),
        (Circuit(7500, 65), 0.930),
        (Circuit(10000, 95, channel2_length=0.3), 0.932),
    ],
)
def test_large_gates_have_the_states_of_runs(circuit: Circuit, chi: float) -> None:
    """Of two runs each, from equal urns too, though the iteration overshoots."""
    (state,) = direction.stationary_states(circuit)
    assert state.kind == "stable"
    assert state.mass_spread == pytest.approx(chi, abs=0.002)
    assert direction.homogeneous_kind(circuit) == "unstable"


@pytest.mark.parametrize(
    ("circuit", "message"),
    [
        (Circuit(1000, 7, channel2_width=1.7), "it knows widths of channel 2 up to 1, the radius"),
        (Circuit(100, 3, 1.0, 1.0, channel2_length=7.0), "it finds no flows between the urns"),
        (Circuit(3, 2, 1.99, 1.55e-4, channel1_length=90.0), "need 4 particles or more"),
    ],
)
def test_where_it_does_not_hold_it_says_so(circuit: Circuit, message: str) -> None:
    """Beyond the radius channel 2 empties the urns, and N2 no longer gives the flows."""
    with pytest.raises(InputError, match=message):
        MODELS["direction"].lifetimes(circuit)


def test_an_unequal_circuit_of_which_not_all_states_are_found_has_none() -> None:
    """Runs have a current of 0.88; there was no state at all, without a word."""
    with pytest.raises(InputError, match="it does not find all states"):
        direction.stationary_states(Circuit(50, 3, 1.0, 0.8, gate2_threshold=6))

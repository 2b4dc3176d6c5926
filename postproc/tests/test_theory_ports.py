"""Ports and circulation: drawn visits, identities, limits."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from postproc.tests.commands import call
from postproc.theory import circulation, direction, ports
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS, describe
from postproc.theory.renewal import RENEWAL
from postproc.theory.returns import return_chance
from postproc.theory.visits import first_multiple, visits

PAPER = Circuit(1000, 7, gate=RENEWAL)
# w and w', then a, t1 and t2 of 4e6 drawn visits and their errors: the study of accuracy
Pair = tuple[float, float]
DRAWN = (
    ((0.3, 0.01), (0.0128768, 3.1e-4), (31.7244, 0.022), (34.4281, 0.39)),
    ((0.1, 0.05), (0.177261, 3.3e-4), (70.5066, 0.066), (56.0933, 0.073)),
    ((0.03, 0.003), (0.039419, 3.2e-4), (300.133, 0.2), (286.02, 1.0)),
    ((0.01, 0.01), (0.333672, 3.3e-4), (494.843, 0.75), (492.886, 0.56)),
    ((0.001, 0.0005), (0.177302, 3.3e-4), (7042.97, 8.0), (5639.53, 6.4)),
    ((0.003, 0.03), (0.904291, 1.5e-4), (286.808, 1.0), (301.398, 0.95)),
)


def drawn(circuit: Circuit, opening: int, count: int) -> tuple[float, float]:
    """Return, from drawn visits flown bounce by bounce, the share that comes back, and its error.

    The disc is about the origin, channel 1 at angle 0; entries by the cosine law.
    """
    random = np.random.default_rng(5)
    radius = float(circuit.urn_radius)
    widths = np.array([float(circuit.channel1_width), float(circuit.channel2_width)])
    chord = math.sqrt(radius**2 - widths[opening] ** 2 / 4)
    side = 1.0 if opening == 0 else -1.0
    x = np.full(count, side * chord)
    y = widths[opening] * (random.uniform(size=count) - 0.5)
    uy = random.uniform(-1.0, 1.0, count)
    ux = -side * np.sqrt(1.0 - uy**2)
    inside, back = np.arange(count), np.zeros(count, bool)
    for _ in range(4000):
        along = x * ux + y * uy
        far = np.sqrt(np.maximum(along**2 - x**2 - y**2 + radius**2, 0.0)) - along
        x, y = x + far * ux, y + far * uy
        size, speed = np.hypot(x, y) / radius, np.hypot(ux, uy)
        x, y, ux, uy = x / size, y / size, ux / speed, uy / speed
        # the arc of an opening is where |y| < w/2 on its side
        out = [(x > 0) & (np.abs(y) < widths[0] / 2), (x < 0) & (np.abs(y) < widths[1] / 2)]
        back[inside[out[opening]]] = True
        on = ~(out[0] | out[1])
        inside, x, y, ux, uy = (one[on] for one in (inside, x, y, ux, uy))
        normal = 2.0 * (ux * x + uy * y) / radius**2
        ux, uy = ux - normal * x, uy - normal * y
    share = float(back.mean())
    return share, math.sqrt(share * (1.0 - share) / count)


@pytest.mark.parametrize(
    ("widths", "radius"),
    [((0.3, 0.05), 1.0), ((0.3, 0.1), 1.0), ((0.5, 0.9), 1.0), ((0.4, 0.3), 0.7)],
)
def test_return_chance_is_that_of_drawn_visits(widths: tuple[float, float], radius: float) -> None:
    circuit = Circuit(1, 1, *widths, radius)
    found = ports.disc(circuit)
    for opening, expected in ((0, 1.0 - found.across), (1, found.return_chance)):
        share, error = drawn(circuit, opening, 30_000)
        assert expected == pytest.approx(share, abs=4.0 * error)


@pytest.mark.parametrize(("width", "chance", "stay2", "stay1"), [
    (0.01, 0.0128, 33.7, 31.7), (0.05, 0.0624, 24.1, 28.8), (0.10, 0.1184, 20.3, 26.0)
])  # fmt: skip
def test_table_of_4e5_drawn_visits(width: float, chance: float, stay2: float, stay1: float) -> None:
    found = ports.disc(replace(PAPER, channel2_width=width))
    assert found.return_chance == pytest.approx(chance, rel=0.02)
    assert found.stay2 == pytest.approx(stay2, rel=0.01)
    assert found.stay1 == pytest.approx(stay1, rel=0.006)


@pytest.mark.parametrize(("widths", "chance", "stay1", "stay2"), DRAWN)
def test_ports_of_narrow_openings_are_those_of_drawn_visits(
    widths: Pair, chance: Pair, stay1: Pair, stay2: Pair
) -> None:
    for radius in (1.0, 1.7):
        found = ports.disc(Circuit(1, 1, *(radius * one for one in widths), radius))
        assert found.return_chance == pytest.approx(chance[0], abs=5.0 * chance[1])
        assert found.stay1 / radius == pytest.approx(stay1[0], abs=5.0 * stay1[1])
        assert found.stay2 / radius == pytest.approx(stay2[0], abs=5.0 * stay2[1])


@pytest.mark.parametrize("wide", [0.5, 0.1, 0.03, 1e-3, 1e-4])
def test_twice_as_many_corners_change_no_return_chance(wide: float) -> None:
    for ratio in (1.0, 0.97, 0.5, 1e-2):
        one, two = (return_chance(1.0, ratio * wide, wide, order) for order in (500, 1000))
        assert one == pytest.approx(two, rel=1e-4)


@pytest.mark.parametrize("widths", [(0.5, 0.9), (0.9, 0.5), (0.12, 0.12), (0.2, 0.19), (1.5, 1.6)])
def test_polygons_and_visits_piece_by_piece_agree(widths: tuple[float, float]) -> None:
    found = visits(0.9, *widths)
    assert return_chance(0.9, *widths) == pytest.approx(found.share[found.same].sum(), rel=3e-4)


def limit(ratio: float) -> float:
    """Return the probability for narrow openings; for ratios above 1 by w P12 = w' P21."""
    if ratio > 1.0:
        return 1.0 - (1.0 - limit(1.0 / ratio)) / ratio
    one, other, both = (
        special.spence(1.0 - x) for x in (-ratio, ratio, 2.0 * ratio / (1.0 + ratio))
    )
    return 4.0 / (math.pi**2 * ratio) * float((1.0 + ratio) * both + one - other)


def test_narrow_openings_have_a_return_chance_of_their_ratio_alone() -> None:
    assert limit(1.0) == pytest.approx(1.0 / 3.0, rel=1e-12)
    assert limit(1e-4) == pytest.approx(4e-4 / math.pi**2, rel=1e-3)
    for ratio in (0.03, 0.2, 0.5, 0.9, 1.0, 1.3, 5.0):
        found = return_chance(1.0, 1e-4 * ratio, 1e-4)
        assert found == pytest.approx(limit(ratio), rel=1e-4)
    # the wider, the farther from it
    assert return_chance(1.0, 0.01, 0.3) < 0.97 * limit(1.0 / 30.0)


def test_polygons_of_a_small_opening_are_those_whose_corners_pass_by_the_other() -> None:
    largest = math.ceil(math.pi / math.asin(0.15)) - 1
    total = 0.0
    for n in range(3, largest + 1, 2):
        k = np.arange(1, n)
        total += float(np.sin(math.pi * k[np.gcd(k, n) == 1] / n).sum()) / n
    assert return_chance(1.0, 1e-5, 0.3) == pytest.approx(0.25e-5 * total, rel=1e-4)


@pytest.mark.parametrize("widths", [(0.3, 0.01), (0.3, 0.3), (0.2, 0.7), (1.0, 1.2)])
def test_visits_through_either_opening_agree(widths: tuple[float, float]) -> None:
    # each summed by itself: read backwards, one's are the other's, and together they fill the urn
    circuit = Circuit(1, 1, *widths)
    both = visits(1.0, *widths), visits(1.0, *widths[::-1])
    back1, back2 = (found.share[found.same].sum() for found in both)
    stay1, stay2 = ports.mean_stay(1.0, *widths), ports.mean_stay(1.0, *widths[::-1])
    assert widths[0] * (1.0 - back1) == pytest.approx(widths[1] * (1.0 - back2), rel=2e-4)
    filled = widths[0] * stay1 + widths[1] * stay2
    assert filled == pytest.approx(math.pi * float(circuit.urn_area), rel=1e-4)
    found = ports.disc(circuit)
    filled = widths[0] * found.stay1 + widths[1] * found.stay2
    assert filled == pytest.approx(math.pi * float(circuit.urn_area), rel=1e-12)


def test_every_entry_leaves_once() -> None:
    for widths in ((0.3, 0.01), (0.01, 0.3), (0.8, 0.5)):
        found = visits(1.0, *widths)
        assert found.share.sum() == pytest.approx(1.0, rel=1e-12)
        assert np.all(found.high > found.low)
        assert np.all(np.abs(found.low + found.shift) < math.pi)


def test_first_multiple_is_the_first() -> None:
    random = np.random.default_rng(3)
    step, low = random.uniform(0.1, 6.0, 200), random.uniform(0.0, 6.0, 200)
    high = low + random.uniform(0.001, 0.2, 200)
    found = first_multiple(step, np.full(200, 2.0 * math.pi), low, high)
    n = np.arange(20_000)
    for one in zip(step, low, high, found, strict=True):
        place = np.mod(n * one[0], 2.0 * math.pi)
        within = np.flatnonzero((place >= one[1]) & (place <= one[2]))
        assert one[3] == within[0]


def test_well_mixed_conductance_is_the_papers() -> None:
    found = ports.well_mixed(PAPER).conductance
    assert found == pytest.approx(0.01 / (math.pi * float(PAPER.urn_area)), rel=1e-12)


def walked(circuit: Circuit, rounds: int, count: int) -> np.ndarray:
    """Return V_m by flying particles from channel 2 round the table, wall by wall."""
    random = np.random.default_rng(7)
    width1, width2 = float(circuit.channel1_width), float(circuit.channel2_width)
    across = float(sum(circuit.chords))
    lengths = float(circuit.channel1_length), float(circuit.channel2_length)
    steepest = 0.5 * (width1 + width2) / across
    y = width2 * (random.uniform(size=count) - 0.5)
    slope = random.uniform(-steepest, steepest, count)
    weight = 2.0 * steepest * width2 / count * (1.0 + slope**2) ** -1.5

    def along(width: float, length: float) -> None:
        nonlocal y, slope
        place = np.mod(y + slope * length + 0.5 * width, 2.0 * width)
        back = place > width
        y = np.where(back, 2.0 * width - place, place) - 0.5 * width
        slope = np.where(back, -slope, slope)

    found = []
    for _ in range(rounds):
        for width, length in ((width1, lengths[0]), (width2, lengths[1])):
            y = y + slope * across
            on = np.abs(y) < 0.5 * width
            y, slope, weight = y[on], slope[on], weight[on]
            if width == width2:
                found.append(weight.sum())
            along(width, length)
    return np.array(found)


@pytest.mark.parametrize("circuit", [
    PAPER,
    replace(PAPER, channel2_width=0.073),
    replace(PAPER, channel2_width=0.05, channel1_length=0.6, channel2_length=1.7, urn_radius=0.8),
])  # fmt: skip
def test_straight_passages_are_those_of_flown_particles(circuit: Circuit) -> None:
    """Gates open, walls of density 1: what has made m rounds and no more was m rounds ago there."""
    flown = walked(circuit, 8, 2_000_000)
    widths = np.array([float(circuit.channel1_width), float(circuit.channel2_width)])
    sent = np.array([2.0, 0.0]) * widths[0], np.array([0.0, 2.0]) * widths[1]
    down, _ = circulation.Straight(circuit, *sent, np.ones(2)).by_group(1)
    down = down.sum(axis=0)
    assert np.all(down[0] == 0.0)
    for m in (1, 2, 4):
        assert down[1, m:8].sum() == pytest.approx(flown[m - 1] - flown[7], rel=0.05)


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
def test_nothing_circulates_where_all_is_filled_evenly(share: float) -> None:
    """Straight passages are then those that ports have, whatever share both gates let pass."""
    circuit = replace(PAPER, channel1_length=0.5, channel2_width=0.2, channel2_length=0.7)
    sent = np.full(2, 2.0 * 0.3), np.full(2, 2.0 * 0.2)
    straight = circulation.Straight(circuit, *sent, np.full(2, share))
    found = sum(np.array(straight.by_group(start)).sum(axis=(1, 3)) for start in (0, 1))
    _, _, _, weights = straight.begun(1, np.random.default_rng(2))
    assert np.all(np.abs(found) < 0.02 * weights.sum())


def test_shifts_that_are_listed_change_only_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    long, found = replace(PAPER, channel1_length=20.0, channel2_width=0.1), []
    held, urns = direction.Directions(long).held(0.1), [ports.disc(long)] * 2
    for most in (300, 3):
        monkeypatch.setattr(circulation, "MOST_TURNS", most)
        flows = held.entries[:, 0], held.across[:, 0]
        found.append([float(one) for one in circulation.circulating(long, urns, *flows)])
    currents, errors = np.array(found).T
    assert currents[0] != currents[1]
    assert abs(currents[1] - currents[0]) < 4.0 * np.hypot(*errors)


def test_nothing_goes_round_between_equal_urns() -> None:
    around = circulation.circulating_at(replace(PAPER, threshold=18), 500.0, np.inf)
    assert around == pytest.approx(0.0, abs=1e-12)


def test_what_circulates_where_no_such_number_is_possible_is_that_of_the_nearest() -> None:
    """The sparse half has 35 at least, those in the channels and those that channel 2 brings."""
    found = [float(circulation.circulating_at(PAPER, one, np.inf)) for one in (965.0, 983.0, 999.5)]
    assert found == pytest.approx(3 * [0.039], rel=0.05)


def test_error_of_what_circulates_is_the_scatter_of_other_particles() -> None:
    """Of six sets; the scatter is known to a third, the mean error to a tenth."""
    root, urns, found = direction.stationary_states(PAPER)[-1], [ports.disc(PAPER)] * 2, []
    held, _ = direction.held_states(PAPER)[-1]
    straight = circulation.followed(PAPER, held.entries[:, 0], held.across[:, 0])
    for seed in range(1, 7):
        straight.seed = seed
        found.append([float(one) for one in circulation.carried(straight, PAPER, urns, PAPER.age)])
    currents, errors = np.array(found).T
    assert 0.4 < currents.std(ddof=1) / errors.mean() < 1.8
    assert (root.circulating_current, root.net_current_error) == pytest.approx(found[0], rel=1e-6)


def test_circulations_fill_up_with_the_age_of_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    """Decade for decade about as much, to the current of an infinite age; chi stays as it is."""
    words = ["--number", "1000", "--threshold", "7", "--model"]
    roots = []
    for age in ([], ["1.4e5"], ["0"], ["100"], ["1000"], ["10000"], ["1e9"]):
        assert call("theory", [*words, "direction", *(["--age", *age] if age else [])]) == 0
        roots.append(json.loads(capsys.readouterr().out)["roots"][0])
    assert roots[0] == roots[1]
    assert len({(one["mass_spread"], one["net_current_infinite_age"]) for one in roots}) == 1
    currents = [one["net_current"] for one in roots[2:]]
    steps = np.diff(currents)
    assert np.all(steps > 0.0)
    assert steps[1:3] == pytest.approx([0.0115, 0.0115], abs=0.002)
    assert currents[-1] == pytest.approx(roots[0]["net_current_infinite_age"], rel=1e-6)
    assert currents[-1] > roots[0]["net_current"] > currents[-2]
    assert call("theory", [*words, "window", "--age", "100"]) == 2


def test_command_line_tells_what_the_urns_remember(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--number", "1000", "--threshold", "7"]
    assert call("theory", [*words, "--model", "direction"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["return_chance"] == pytest.approx(0.012846, abs=1e-6)
    filled = 0.3 * printed["stay1"] + 0.01 * printed["stay2"]
    assert filled == pytest.approx(math.pi * printed["urn_area"], rel=1e-12)
    assert printed["homogeneous"] == "unstable"
    assert len(printed["roots"]) == 1


@pytest.mark.parametrize("model", MODELS)
def test_unlike_urns_and_gates(model: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--number", "1000", "--model", model, "--threshold", "7", "9"]
    assert call("theory", [*words, "--urn-radius", "1", "1.3"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert len(printed["urn_area"]) == 2
    fuller = [state["urn2_number"] > 500.0 for state in printed["roots"]]
    assert any(fuller)
    assert not all(fuller)


def test_three_thresholds_are_too_many(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("theory", ["--number", "10", "--threshold", "1", "2", "3"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_gates_that_let_nobody_or_everybody_pass_have_no_battery() -> None:
    for threshold in (0, 1000):
        printed = describe(Circuit(1000, threshold), MODELS["direction"])
        assert (printed["homogeneous"], printed["roots"]) == ("stable", [])

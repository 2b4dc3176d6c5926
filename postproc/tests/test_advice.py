"""Advice: what is cheap and good enough, for how long runs go, and that it is right."""

from __future__ import annotations

import functools
import json
import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from postproc.advice import advice, transients
from postproc.advice.advice import Outcome, Pilot
from postproc.advice.question import advise, circuit_of
from postproc.cli import InputError
from postproc.reading import grid
from postproc.tests.commands import call
from postproc.tests.runs import BARE, edited, results_of
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

CASE = """
&table urn_radius = 1.1 0.9, channel1_width = 0.4, channel2_width = 0.02 /
&particles number = 100 /
&gate threshold = 2 3 /
&scan replicas = 4 /
"""
FOUND = Pilot(0.9, 0.009, 0.0, 1000.0, 2000.0, 1e-6, 0.05)


def _namelist(*given: object) -> str:
    return json.dumps(advice.namelist_of(*given), sort_keys=True)


def _remembered(
    function: Callable[..., object], key_of: Callable[..., str] = lambda *given: repr(given)
) -> Callable[..., object]:
    """Return the function with its results kept, by the text of what it is asked."""
    known: dict[str, object] = {}

    @functools.wraps(function)
    def asked(*given: object) -> object:
        key = key_of(*given)
        if key not in known:
            known[key] = function(*given)
        return known[key]

    return asked


@pytest.fixture(autouse=True, scope="module")
def _one_answer_each() -> Iterator[None]:
    """Theories and runs (of one seed) say the same each time: they are asked once."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("cost_of", "runs"):
            patch.setattr(advice, name, _remembered(getattr(advice, name), _namelist))
        for name in ("theory_says", "transition_of"):
            patch.setattr(advice, name, _remembered(getattr(advice, name)))
        yield


def told(capsys: pytest.CaptureFixture[str]) -> tuple[dict, str]:
    said = capsys.readouterr()
    return json.loads(said.out), said.err


def test_a_namelist_and_the_same_circuit_by_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "case.nml"
    case = CASE.replace("\n", " ").replace("number =", "number(1:1) =")
    file.write_text(case + "&run duration = 5 /")
    assert call("advise", [str(file), "--tolerance", "0.002"]) == 0
    one, sentence = told(capsys)
    names = ["rung", "replicas", "duration", "cpu_seconds", "confidence", "reason"]
    assert set(names) < set(one)
    assert one["rung"] == "excursion"
    assert f"{one['replicas']} replicas of {one['duration']:g} time units" in sentence
    padded = tmp_path / "padded.nml"  # as Fortran writes texts
    padded.write_text(CASE.replace("&table", "&table shape = 'circuit     ',"))
    assert call("advise", [str(padded), "--tolerance", "0.002"]) == 0
    assert told(capsys)[0]["rung"] == "excursion"
    words = ["--number", "100", "--threshold", "2", "3", "--urn-radius", "1.1", "0.9"]
    words += ["--channel1-width", "0.4", "--channel2-width", "0.02", "--tolerance", "0.002"]
    assert call("advise", words) == 0
    other, _ = told(capsys)
    same = ["rung", "replicas", "duration", "expected", "confidence"]
    assert {name: one[name] for name in same} == {name: other[name] for name in same}


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        (CASE.replace("&table", "&table urn_sides = 8,"), "&table urn_sides"),
        (CASE.replace("replicas = 4", "threshold = 3, 4, 5"), "one point only"),
        (CASE.replace("replicas = 4", "urn_radius2 = 0.8"), "no advice on &scan urn_radius2"),
        (CASE.replace("number = 100", ""), "number is missing"),
        (CASE.replace("replicas = 4", "channel2_width = 1,5"), "below 2 urn_radius"),
        (CASE.replace("&table", "&table channel1_length = 1,5,"), "has 2 values"),
        (CASE + "&particles number = 3 /", "is given again"),
        (CASE + "&output file = 'a /", "line"),
        (CASE.replace("number = 100", "number = 100, initial_file = 'a'"), "initial_file"),
    ],
)
def test_what_there_is_no_advice_on(
    text: str, wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "case.nml"
    file.write_text(text)
    assert call("advise", [str(file)]) == 2
    assert wrong in capsys.readouterr().err


def test_there_is_no_advice_on_polygons_by_options(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--number", "100", "--threshold", "2", "--urn-sides", "4"]
    assert call("advise", words) == 2
    assert "there is no advice on polygons" in capsys.readouterr().err


def test_there_is_no_advice_on_a_transition_of_unequal_gates(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["--number", "100", "--threshold", "2", "9", "--quantity", "transition"]
    assert call("advise", words) == 2
    assert "transition where threshold is 2 and 9" in capsys.readouterr().err


def test_fractions_are_rounded_as_in_the_program() -> None:
    particles = {"number": 100, "urn1_fraction": 0.105}
    groups, circuit = circuit_of({"particles": particles,
                                  "gate": {"threshold_fraction": [0.025, 0.05]}})  # fmt: skip
    assert (groups["particles"]["urn1_number"], circuit.thresholds) == (11, "3, 5")


def test_a_list_from_one_index_on_is_that_list(tmp_path: Path) -> None:
    """The program and Fortran read both gates; texts and comments are no indices."""
    path = tmp_path / "a.nml"
    path.write_text(
        "&particles number = 200 / ! threshold(1) = 5\n"
        "&gate threshold( 1 ) = 3, 9 /\n&output file = 'f(1) = .h5' /\n",
        encoding="utf-8",
    )
    groups, circuit = circuit_of(path)
    assert circuit.thresholds == "3, 9"
    assert groups["gate"]["threshold"] == [3, 9]
    assert grid.groups_in(path.read_text())["output"]["file"] == "f(1) = .h5"


@pytest.mark.parametrize(("name", "value"), [("tolerance", 0), ("tolerance", "a"),
                                             ("pilot_seconds", math.nan)])  # fmt: skip
def test_a_tolerance_or_time_that_is_not_allowed(name: str, value: object) -> None:
    groups = {"particles": {"number": 100}, "gate": {"threshold": 2}}
    with pytest.raises(InputError, match=f"{name} = .*: must be a number from "):
        advise(groups, "chi", **{name: value})


def test_advised_runs_start_as_the_namelist_says() -> None:
    for key, value in (("urn1_number", 30), ("urn1_fraction", 0.3)):
        particles = {"number": 100, key: value, "seed": 5}
        groups, _ = circuit_of({"particles": particles, "gate": {"threshold": 2}})
        assert advice.start_of(groups, "chi") == 30
        runs = advice.namelist_of(groups, "chi", None, {"replicas": 2})
        assert runs["particles"] == {"number": 100, "urn1_number": 30, "seed": 5}


def test_runs_have_the_error_that_was_wanted() -> None:
    """As few as have it; half the tolerance takes four times as many."""
    replicas = advice.replicas_for(FOUND, 0.001)
    assert advice.chance_of_runs(FOUND, replicas, 0.001) >= advice.SURE
    assert advice.chance_of_runs(FOUND, replicas - 1, 0.001) < advice.SURE
    assert advice.replicas_for(FOUND, 0.0005) == pytest.approx(4 * replicas, abs=4)


def test_tolerances_are_met_as_often_as_it_is_said() -> None:
    """Normal replicas: pilots of 16, then what these advise; two sigma of 4000 tries."""
    random = np.random.default_rng(8)
    met, promised = [], []
    for _ in range(4000):
        first = random.normal(1.0, 0.1, advice.REPLICAS)
        found = replace(FOUND, value=float(first.mean()), scatter=float(first.std(ddof=1)))
        replicas = advice.replicas_for(found, 0.03)
        met.append(abs(random.normal(0.0, 0.1 / math.sqrt(replicas))) <= 0.03 * found.value)
        promised.append(advice.chance_of_runs(found, replicas, 0.03))
    chance = np.array(promised)
    assert abs(sum(met) - chance.sum()) < 2.0 * math.sqrt((chance * (1.0 - chance)).sum())


def test_rounds_ask_for_more_replicas() -> None:
    rounds = replace(FOUND, circulating=3.0 * FOUND.scatter**2)
    alone = advice.replicas_for(FOUND, 0.0005)
    assert advice.replicas_for(rounds, 0.0005) == pytest.approx(4 * alone, abs=4)


def test_scatter_of_a_transition_is_that_of_replicas() -> None:
    """Drawn again and again, the transition of 16 replicas scatters by what one draw tells."""
    random = np.random.default_rng(3)
    mean = np.array([0.7, 0.55, 0.35, 0.18, 0.08])[:, None]
    drawn = [
        advice.transition_of_runs(np.arange(14.0, 19.0), mean + random.normal(0.0, 0.08, (5, 16)))
        for _ in range(400)
    ]
    values, scatters = np.array(drawn).T
    assert values.mean() == pytest.approx(16.0 + 5.0 / 17.0, abs=0.01)
    assert values.std() * 4.0 == pytest.approx(np.sqrt(np.mean(scatters**2)), rel=0.1)


def test_thresholds_follow_chi_until_it_falls_through() -> None:
    assert advice.moved([14, 15, 16, 17, 18], np.full(5, 0.8)) == [18, 19, 20, 21, 22]
    assert advice.moved([14, 15, 16, 17, 18], np.full(5, 0.1)) == [10, 11, 12, 13, 14]
    assert advice.moved([2, 3, 4, 5, 6], np.full(5, 0.1))[0] == 1


def test_the_current_still_lacks_what_was_measured() -> None:
    """N = 1000, T = 7, w' = 0.01, age 2800 to 8400: 1.0048 of 1.0168, +- 0.0015 (chi 0.929)."""
    lacking = transients.missing(Circuit(1000, 7), 0.929, 2800.0, 5600.0)
    assert lacking == pytest.approx(0.0120, abs=0.003)
    old = transients.missing(Circuit(1000, 7), 0.929, 1e5, 2e5)
    assert 0.0 < old < 0.0015


def test_transients_are_as_long_as_numbers_take_from_equal_ones() -> None:
    """They decay in pi A/(2 w'), 4900 at w' = 0.001, if both gates reverse all.

    At N = 500, T = 1 they grow: runs of 2800 to 8400 had chi = 0.833, later ones 0.990.
    """
    shut = Circuit(300, 0, channel2_width=0.001)
    decay = math.pi * float(shut.urn_area) / (2.0 * 0.001)
    assert transients.number_time(shut) == pytest.approx(3.0 * decay)
    assert transients.of_chi(Circuit(500, 1, channel2_width=0.001), critical=False) > 6000.0
    usual = transients.of_chi(Circuit(1000, 7), critical=False)
    discs = Circuit(1000, 7, scatterers=((0.0, 0.0, 0.001),))
    urn = Circuit(100, 7, channel2_width=0.0, shape="urn")
    for number, threshold, width in ((1036, 7, 0.01), (300, 3, 0.03), (20000, 200, 0.01)):
        circuits = [Circuit(number, threshold, 0.3, (1 + 1e-4 * k) * width) for k in range(5)]
        near = [transients.number_time(one) for one in circuits]
        assert near == pytest.approx([near[0]] * 5, rel=0.05)
    for one in (discs, urn, Circuit(1000, 0, channel2_width=0.0)):
        assert transients.of_chi(one, critical=False) == usual


def test_transients_do_not_depend_on_the_unit_of_length() -> None:
    found = []
    for unit in (1e-3, 1.0, 1e4):
        lengths = dict.fromkeys(("urn_radius", "channel1_length", "channel2_length"), unit)
        circuit = Circuit(1000, 7, 0.3 * unit, 0.01 * unit, **lengths)
        begun = transients.of_chi(circuit, critical=False)
        allowed = 0.0025 / unit
        times = [begun, transients.of_chi(circuit, critical=True)]
        times += [transients.of_current(circuit, 0.93, allowed, shortest=begun, times=2.0)]
        lacking = transients.missing(circuit, 0.93, begun, 2.0 * begun)
        found.append([*(one / unit for one in times), float(lacking) * unit])
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    assert found[2] == pytest.approx(found[1], rel=1e-6)
    assert found[1][3] > 0.01


def test_a_pilot_waits_as_long_as_the_tolerance_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a current; chi has settled after three relaxations of directions."""
    waited = []

    def made_up(_: object, __: object, ___: object, length: dict) -> Outcome:
        waited.append(length["transient_duration"])
        return Outcome(1.0, 0.03, np.array([0.929]), 0.1)

    monkeypatch.setattr(advice, "runs", made_up)
    battery, found = Circuit(1000, 7), {}
    groups = advice.table_of(battery)
    for quantity, tolerance in [("chi", 0.003), ("polarised_current", 0.003),
                                ("polarised_current", 0.02)]:  # fmt: skip
        found[quantity, tolerance] = advice.pilot(groups, battery, quantity, tolerance)
    assert found["chi", 0.003].lacking == 0.0
    chi, sharp, rough = (one.transient for one in found.values())
    assert chi == transients.of_chi(battery, critical=False)
    assert waited == [chi, chi, sharp, chi, rough]
    assert chi < rough < sharp
    for tolerance in (0.003, 0.02):
        lacking = found["polarised_current", tolerance].lacking
        assert 0.5 * tolerance < lacking / advice.LACKING <= tolerance


def test_what_is_lacking_makes_advice_less_sure() -> None:
    late = replace(FOUND, lacking=0.001 * FOUND.value)
    replicas = advice.replicas_for(FOUND, 0.002)
    assert advice.chance_of_runs(late, replicas, 0.002) < advice.SURE
    more = advice.replicas_for(late, 0.002)
    assert more > replicas
    assert advice.chance_of_runs(late, more, 0.002) >= advice.SURE
    assert advice.chance_of_runs(late, 10**9, 0.0009) < 1e-3


def test_a_pilot_that_meets_the_tolerance_is_the_answer(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(advice, "theory_says", lambda *_: (math.nan, 0.0))
    monkeypatch.setattr(advice, "pilot", lambda *_, **__: FOUND)
    words = ["--number", "300", "--threshold", "3", "--tolerance"]
    assert call("advise", [*words, "0.01"]) == 0
    one, sentence = told(capsys)
    assert (one["rung"], one["replicas"], one["cpu_seconds"]) == ("excursion", 16, 0.0)
    assert "The pilot is enough: 0.9 is chi within 1 %" in sentence
    assert call("advise", [*words, "0.005"]) == 0
    one, sentence = told(capsys)
    assert one["cpu_seconds"] > 0.0
    assert "enough" not in sentence


def test_errors_that_cancel_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    said = dict.fromkeys(MODELS, 0.9) | {"renewal": 0.8}
    monkeypatch.setattr(advice, "theory_says", lambda _, model, *__: (said[model.name], 0.0))
    circuit = Circuit(300, 3, 0.4, 0.02)
    given = advice.advise(advice.table_of(circuit), circuit, "chi", 0.02, FOUND)
    assert given.rung == "window"
    assert "errors cancel: renewal" in given.reason
    said["renewal"] = 0.9
    given = advice.advise(advice.table_of(circuit), circuit, "chi", 0.02, FOUND)
    assert "cancel" not in given.reason


def test_what_cannot_be_had_soon_has_its_price_all_the_same() -> None:
    """No run of it is made; a hundred times finer takes ten thousand times as long."""
    circuit = Circuit(300, 3, 0.4, 0.02)
    groups = advice.table_of(circuit)
    fine, finer = (advice.advise(groups, circuit, "chi", one, FOUND) for one in (1e-4, 1e-6))
    assert fine.rung == finer.rung == "excursion"
    assert finer.cpu_seconds == pytest.approx(1e4 * fine.cpu_seconds, rel=0.01)
    assert min(fine.confidence, finer.confidence) >= advice.SURE


def test_a_theory_that_finds_no_state_is_no_error() -> None:
    """As `direction` with nearly all particles in one urn."""
    circuit = Circuit(1000, 4, channel2_width=0.0, channel1_length=5.0)
    value, seconds = advice._theory_within(circuit, MODELS["direction"], FOUND, "chi", 60.0)
    assert math.isnan(value)
    assert seconds == math.inf


def test_what_is_not_there_is_said() -> None:
    circuit = Circuit(300, 3, 0.4, 0.02)
    nothing = replace(FOUND, value=math.nan, thresholds=[3, 4, 5, 6, 7])
    given = advice.advise(advice.table_of(circuit), circuit, "transition", 0.02, nothing)
    assert given.rung == "none"
    assert given.confidence == 0.0
    assert "does not fall through 0.3 at T = [3, 4, 5, 6, 7]" in given.reason


@pytest.mark.parametrize(
    ("value", "scatter", "rung"), [(1.0, 0.0, "excursion"), (5.0, math.nan, "none")]
)
def test_replicas_that_do_not_scatter_have_an_answer(
    value: float, scatter: float, rung: str
) -> None:
    """Of one particle chi is 1 in each; next to T = 1 no replica tells by what it scatters."""
    circuit = Circuit(1, 1, 0.4, 0.02)
    found = replace(FOUND, value=value, scatter=scatter)
    assert advice.advise(advice.table_of(circuit), circuit, "chi", 0.02, found).rung == rung


@pytest.mark.parametrize(("scatter", "differs"), [(1.0, True), (2.0, False)])
def test_no_tolerance_of_a_mean_that_may_be_zero(scatter: float, differs: bool) -> None:
    """Its error is the scatter over 4, and three errors are not told from 0."""
    circuit = Circuit(300, 40, 0.6, 0.01)
    found = replace(FOUND, value=1.0, scatter=scatter)
    given = advice.advise(advice.table_of(circuit), circuit, "polarised_current", 0.05, found)
    assert (given.rung != "none") is differs


def test_a_pilot_that_takes_long_is_not_begun(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(advice, "run", lambda *_, **__: pytest.fail("a pilot was begun"))
    assert call("advise", ["--number", "100000000", "--threshold", "700000"]) == 2
    assert "--pilot-seconds" in capsys.readouterr().err


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
    assert advice.transition_of(circuit, MODELS["renewal"]) == pytest.approx(16.2, abs=0.1)


def test_a_current_is_that_of_the_state_with_this_chi_and_has_its_sign() -> None:
    """Unequal urns have other states, farther out; and gates may drive a current back."""
    unlike = Circuit(1000, 7, urn2_radius=0.6)
    found, _ = advice.theory_says(unlike, MODELS["window"], "polarised_current", 0.82)
    assert found == pytest.approx(2.506, abs=0.001)
    back = Circuit(60, 1, 1.0, 0.5, urn_radius=0.6, urn2_radius=1.0, gate2_threshold=2)
    found, _ = advice.theory_says(back, MODELS["renewal"], "polarised_current", math.nan)
    assert found == pytest.approx(-0.411, abs=0.001)
    assert transients.missing(Circuit(500, 5, channel2_width=1.5), 0.1, 10.0, 10.0) == 0.0


@pytest.mark.parametrize(
    ("chi", "has_mean"),
    [([0.86, 0.87, 0.86, 0.85, 0.87, 0.86, 0.85, 0.88], True),
     ([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.9], True),  # a sole particle has gone
     ([0.86, 0.87, 0.86, 0.85, 0.87, 0.86, 0.85, 0.28], False),
     ([0.86, 0.87, 0.05, 0.06, 0.87, 0.06, 0.05, 0.86], False)],
)  # fmt: skip
def test_runs_that_leave_their_state_have_no_mean(
    tmp_path: Path, chi: list[float], *, has_mean: bool
) -> None:
    path = results_of(tmp_path / "run.h5", particles={"number": 20}, run={"duration": 10.0},
                      scan={"threshold": 2, "replicas": 8}, output=BARE)  # fmt: skip
    with edited(path) as file:
        file["chi"][0] = chi
    if has_mean:
        assert advice.read(path, "chi").value == pytest.approx(np.mean(chi))
    else:
        with pytest.raises(InputError, match="some leave the state in which they begin"):
            advice.read(path, "chi")

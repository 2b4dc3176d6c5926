"""One-particle theory: its limits, its symmetries, and what the program itself measures."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import xarray as xr

from postproc.cli import InputError
from postproc.tests.runs import BARE, results_of
from postproc.theory.circuit import Circuit, gate_load
from postproc.theory.renewal import RENEWAL
from studies.common.study import ROOT
from studies.common.theories import THEORIES
from studies.one_particle import study as comp01
from studies.one_particle import walkers
from studies.one_particle.study import HOLLOW, hollow, root_mean_square
from studies.one_particle.walkers import (
    MOST_VISITS,
    Effort,
    effort_for,
    stationary_states,
    walk,
)

if TYPE_CHECKING:
    from pathlib import Path

PAPER = Circuit(number=1000, threshold=7, channel2_width=0.0102)
QUICK = Effort(copies=8, batches=4, transient=1000.0, duration=1500.0)
FORGETFUL = replace(QUICK, transient=300.0, duration=700.0)
UNLIKE = {"urn_radius": 0.9, "channel1_length": 1.3, "channel2_length": 0.6}


@pytest.fixture(scope="module", autouse=True)
def _program() -> None:
    command = ["make", "build/bin/one_particle"]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_well_mixed_gates_are_renewal_gates() -> None:
    """Both gates, the crowded one and the other, wherever lengths and thresholds are."""
    for circuit in (PAPER, replace(PAPER, **UNLIKE, threshold=4, gate2_threshold=9)):
        walked = walk(circuit, 0.9, replace(FORGETFUL, copies=16), well_mixed=True)
        share = 1.0 - walked.turned / walked.entries
        error = share.std(axis=0, ddof=1) / np.sqrt(len(share))
        for urn, side in enumerate(circuit.sides):
            load = walked.entries[:, urn] * np.pi * side.channel1_length / 4.0
            expected = RENEWAL.share(side.threshold, load).mean()
            assert share[:, urn].mean() == pytest.approx(expected, abs=4.0 * error[urn] + 1e-3)


def test_well_mixed_urns_are_in_the_renewal_gates_state() -> None:
    """Its numbers come out, those in the channels counted."""
    for circuit in (PAPER, replace(PAPER, **UNLIKE, channel2_width=0.03)):
        expected = THEORIES["renewal_occupation"].stable_state(circuit)
        share = expected.urn2_number / circuit.number
        walked = walk(circuit, share, FORGETFUL, well_mixed=True)
        spread = 2.0 * walked.half2_number / circuit.number - 1.0
        assert spread.mean() == pytest.approx(expected.mass_spread, abs=0.004)
        assert walked.net_current.mean() == pytest.approx(expected.net_current, rel=0.02)


def test_entrants_of_a_well_mixed_urn_are_those_of_its_load() -> None:
    """Those inside tell the rate at which the gate is entered: n w/(pi A)."""
    circuit = replace(PAPER, threshold=1000)
    walked = walk(circuit, 0.5, FORGETFUL, well_mixed=True)
    area = 2.0 * circuit.urn_area + 0.3 + 0.0102
    inside = circuit.number * circuit.urn_area / area
    load = walked.entries.mean() * np.pi / 4.0
    assert load == pytest.approx(gate_load(circuit, inside), rel=0.01)


@pytest.mark.parametrize(
    ("threshold", "width", "spread", "current"),
    [(7, 0.0102, 0.9285, 1.028), (10, 0.0204, 0.8532, 1.971), (10, 0.0612, 0.6411, 4.729)],
)
def test_it_meets_the_points_of_the_paper(
    threshold: int, width: float, spread: float, current: float
) -> None:
    """Of Fig. comp01, as the program measures them; the renewal gate is off by up to a fifth."""
    (state,) = stationary_states(replace(PAPER, threshold=threshold, channel2_width=width), QUICK)
    assert state.kind == "stable"
    assert state.mass_spread == pytest.approx(spread, abs=0.005)
    assert state.net_current == pytest.approx(current, rel=0.03, abs=3.0 * state.net_current_error)
    assert 0.0 < state.mass_spread_error < 0.002
    assert 0.0 < state.net_current_error < 0.03 * current


FEW = [(0.0102, 5), (0.0306, 13)]


def test_it_meets_some_polarised_points_of_comp01() -> None:
    """At the paper's length; `test_it_meets_all_polarised_points_of_comp01` has the others."""
    effort = replace(QUICK, transient=3000.0, duration=2500.0)
    few = [one for one in comp01.POINTS if (one.channel2_width, one.threshold) in FEW]
    spread, current = root_mean_square([comp01.off(one, effort) for one in few])
    assert len(few) == len(FEW)
    assert spread < 0.005
    assert current < 0.03


def test_points_next_to_a_transition_are_told_by_the_distribution_of_chi() -> None:
    """Those that have no polarised state, and the next T; an even state has its mode at 0."""
    points = comp01.POINTS
    assert len(points) == 46
    assert len(comp01.but_ends(points)) == 38
    kept = comp01.inner(points)
    assert len(kept) == 34
    assert {one.threshold for one in kept if one.channel2_width == 0.0612} == set(range(9, 14))
    random = np.random.default_rng(1)
    even = np.abs(random.normal(0.0, 0.1, 20_000))
    assert hollow(even) == 1.0
    assert hollow(np.abs(random.normal(0.3, 0.08, 20_000))) < 0.05 < HOLLOW
    assert hollow(np.abs(random.normal(0.1, 0.09, 20_000))) > HOLLOW


@pytest.mark.full
def test_it_meets_all_polarised_points_of_comp01() -> None:
    """The 34 that have a polarised state in runs, but the last ones before either transition."""
    found = {one: comp01.off(one) for one in comp01.but_ends(comp01.POINTS)}
    inner = comp01.inner(comp01.POINTS)
    assert np.isfinite(list(found.values())).all()
    spread, current = root_mean_square([found[one] for one in inner])
    assert spread < 0.005
    assert current < 0.03
    spread, current = root_mean_square(list(found.values()))
    assert spread < 0.007
    assert current < 0.03


@pytest.mark.parametrize(
    "case",
    [
        Circuit(400, 5, 0.25, 0.02, 0.8, 1.5, 0.6),
        Circuit(700, 5, 0.4, 0.015, 1.3, 0.8, 2.0),
        Circuit(600, 6, 0.3, 0.02, 1.0, urn2_radius=0.9, gate2_threshold=5),
    ],
)
def test_it_meets_the_program_at_other_lengths(tmp_path: Path, case: Circuit) -> None:
    """Radius, lengths, and urns and gates that are not alike, urn 2 crowded: chi and current."""
    one, two = case.sides
    file = results_of(
        tmp_path / "out.h5",
        table={
            "urn_radius": [one.urn_radius, two.urn_radius],
            **{key: getattr(case, key) for key in ("channel1_width", "channel1_length")},
            **{key: getattr(case, key) for key in ("channel2_width", "channel2_length")},
        },
        particles={"number": case.number, "urn1_number": case.number // 20},
        gate={"threshold": [one.threshold, two.threshold]},
        run={"duration": 6000.0, "transient_duration": 2000.0},
        scan={"threshold": None, "replicas": 4},
        output=BARE,
    )
    with xr.open_dataset(file) as found:
        spread, current = found["chi"].mean().item(), found["polarised_current"].mean().item()
        noise = found["polarised_current"].std().item() / np.sqrt(3.0)
    state = stationary_states(case, replace(QUICK, transient=2000.0))[-1]
    assert spread > 0.5
    assert state.mass_spread == pytest.approx(spread, abs=0.006)
    off = np.hypot(noise, state.net_current_error)
    assert state.net_current == pytest.approx(current, abs=0.02 * current + 3.0 * off)


def test_images_of_unequal_circuits() -> None:
    """Urns exchanged, states are mirrored; a state is reached from either urn."""
    case = replace(PAPER, number=600, threshold=6, urn2_radius=0.9, gate2_threshold=5)
    image = replace(case, urn_radius=0.9, threshold=5, urn2_radius=1.0, gate2_threshold=6)
    short = replace(QUICK, copies=4, duration=500.0)
    states = stationary_states(case, short)
    images = stationary_states(image, short)[::-1]
    assert len(states) == len(images) == 2
    # Errors are known from a few batches only: eight of them are five sigma.
    for one, other in zip(states, images, strict=True):
        off = 8.0 * np.hypot(one.mass_spread_error, other.mass_spread_error)
        assert one.urn2_number == pytest.approx(600.0 - other.urn2_number, abs=300.0 * off)
        off = 8.0 * np.hypot(one.net_current_error, other.net_current_error)
        assert one.net_current == pytest.approx(-other.net_current, abs=off)


def test_batches_are_drawn_by_their_seeds() -> None:
    """The same seeds give the same numbers, others differ by about the error given."""
    short = replace(QUICK, copies=2, transient=200.0, duration=200.0)
    one, again = (walk(PAPER, 0.96, short) for _ in range(2))
    other = walk(PAPER, 0.96, replace(short, seed=101))
    assert np.array_equal(one.half2_number, again.half2_number)
    off = np.hypot(*(found.half2_number.std(ddof=1) / 2.0 for found in (one, other)))
    assert 0.0 < abs(one.half2_number.mean() - other.half2_number.mean()) < 5.0 * off


@pytest.mark.parametrize("number", [20, 1000, 10_000])
@pytest.mark.parametrize("width", [0.1, 0.3, 0.5])
def test_effort_is_bounded(number: int, width: float) -> None:
    """Visits of all batches; a run is never shorter than its transient by more than a half."""
    circuit = replace(PAPER, number=number, channel1_width=width)
    effort = effort_for(circuit)
    mean_visit = np.pi * circuit.urn_area / (width + 0.0102)
    time = effort.transient + effort.duration
    assert effort.batches * effort.copies * number * time / mean_visit < 1.01 * MOST_VISITS
    assert effort.copies == 2
    assert effort.transient <= effort.duration <= 20.0 * effort.transient


def test_numbers_of_any_kind_are_understood() -> None:
    """Those of numpy, too, which call themselves by their kind."""
    short = Effort(1, 2, np.float64(5.0), np.float64(5.0))
    walked = walk(replace(PAPER, number=20), np.float64(0.5), short)
    assert walked.half2_number.shape == (2,)


def test_a_program_that_is_not_there_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line says what is missing and what builds it."""
    monkeypatch.setattr(walkers, "ROOT", tmp_path)
    with pytest.raises(InputError, match=r"one_particle: no such .*make build/bin/one_particle"):
        stationary_states(PAPER, QUICK)

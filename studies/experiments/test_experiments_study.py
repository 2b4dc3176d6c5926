"""The experiments: formulas in known limits, measurements on synthetic logs, the page."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from postproc.advice.transients import circulation_rate
from postproc.tests.looks import assert_looks_apart
from postproc.theory import ports
from postproc.theory.circuit import Circuit
from postproc.theory.renewal import RENEWAL
from studies.common import event_log
from studies.common.event_log import Log, particle_events
from studies.common.study import Study
from studies.experiments import picture, predictions
from studies.experiments import study as experiments

CIRCUIT = Circuit(1000, 7)
HERE = Path(experiments.__file__).parent


class Short(Study):
    """A study whose runs are a fifth of the quick ones."""

    def pick(self, quick: float, full: float) -> float:
        """Return the quick one, shorter."""
        return quick / 5.0 if quick > 1e3 else super().pick(quick, full)


def events_of(*events: tuple[float, int, int, int]) -> event_log.ParticleEvents:
    time, kind, where, particle = np.array(sorted(events), float).T
    return particle_events(Log(time, *(one.astype(int) for one in (kind, where, particle))))


def test_directions_forget_as_legendre_modes_do() -> None:
    assert predictions.autocorrelation(0.1, 0.0) == pytest.approx(1.0)
    values = predictions.autocorrelation(0.065 * 0.09, [1, 5, 10, 20, 40])
    assert values == pytest.approx([0.962, 0.828, 0.690, 0.482, 0.238], abs=1e-3)
    late = predictions.autocorrelation(0.01, [100, 110])
    assert late[1] / late[0] == pytest.approx(math.exp(-0.6), rel=1e-3)
    lags = np.array([1, 5, 10, 20, 40])
    for diffusion in (0.003, 0.01):
        curve = predictions.autocorrelation(diffusion, lags)
        assert experiments.fitted_diffusion(lags, curve) == pytest.approx(diffusion, rel=1e-6)


def test_circulation_is_that_of_the_formula() -> None:
    assert circulation_rate(CIRCUIT, 955.7, 1) == pytest.approx(2.27e-3, rel=2e-3)
    wide = Circuit(1000, 7, channel2_width=0.02)
    ratio = circulation_rate(wide, 955.7, 4) / circulation_rate(CIRCUIT, 955.7, 1)
    assert ratio == pytest.approx(1.0, rel=1e-3)


def test_angle_is_told_from_the_flight_to_the_end_wall() -> None:
    seen = events_of((10.0, 1, 1, 1), (10.5, 3, 12, 1), (30.0, 1, 1, 1), (31.0, 3, 12, 1))
    time, particle, cosine = event_log.entries_of(seen)
    assert time.tolist() == [10.0, 30.0]
    assert particle.tolist() == [1, 1]
    assert cosine == pytest.approx([1.0, 0.5])


def test_autocorrelation_of_directions_that_are_kept_is_one() -> None:
    random = np.random.default_rng(2)
    cosine = np.repeat(np.sqrt(1.0 - random.uniform(-1.0, 1.0, 400) ** 2), 30)
    particle, time = np.repeat(np.arange(400), 30), np.tile(np.arange(30.0), 400)
    lags = np.array([1, 3])
    found = event_log.autocorrelations(time, particle, cosine, lags, 20.0)
    assert found == pytest.approx(np.ones((event_log.GROUPS, 2)), rel=1e-9)
    mixed = event_log.autocorrelations(time, particle, random.permutation(cosine), lags, 20.0)
    assert np.abs(mixed.mean(axis=0)) == pytest.approx(0.0, abs=0.05)


def test_what_follows_channel2_is_counted_by_groups() -> None:
    events = []
    for particle in range(10):
        start = 0.1 * particle
        events += [(start, 4, 21, particle), (start + 11.0, 4, 12, particle)]
        events += [(start + 22.0, 1, 1, particle)]
    share, stay = event_log.after_channel2(events_of(*events))
    assert share == pytest.approx(0.5)
    assert stay == pytest.approx(11.0 - 0.25 * math.pi * 1.5)


def test_those_in_the_channels_are_taken_from_the_halves() -> None:
    circuit = Circuit(1000, 7, gate=RENEWAL)
    inside, apart = experiments.of_halves(circuit, 0.0)
    assert apart == 0.0
    here, beyond = predictions.held_in_channels(circuit, inside)
    assert inside + here + beyond == pytest.approx(2 * [500.0], rel=1e-9)
    inside, apart = experiments.of_halves(circuit, 0.93)
    assert apart == pytest.approx(930.0)
    assert inside[1] < 965.0
    assert inside[0] < 35.0


@pytest.mark.parametrize(("width", "expected"), [(0.3, 0.06642), (0.1, 0.06546), (1e-3, 0.06535)])
def test_directions_diffuse_slower_through_narrower_openings(width: float, expected: float) -> None:
    assert predictions.diffusion(1.4, 1.4 * width) / width**2 == pytest.approx(expected, rel=2e-3)


def test_program_returns_less_than_chance_has_it(tmp_path: Path) -> None:
    share, stay = experiments.two_ports(Short(tmp_path, HERE, ranks=1))
    assert share.measured + 4.0 * share.error < share.mixed
    assert abs(share.off) < 4.0
    assert abs(stay.off) < 5.0


def test_predictions_on_the_page_are_those_of_the_present_theory() -> None:
    """They need no run: return probability, and conductance at the measured chi."""
    rows = json.loads((HERE / "experiments.json").read_text())["rows"]
    found = ports.disc(Circuit(1000, 1000))
    predicted = [one["predicted"] for one in rows if one["experiment"] == 2]
    assert predicted == pytest.approx([found.return_chance, found.stay2], rel=1e-6)
    sizes = [one for one in rows if one["what"].startswith("conductance")]
    for row, threshold in zip(sizes[:3], (7, 10, 13), strict=True):
        circuit = Circuit(1000, threshold, gate=RENEWAL)
        ratio = ports.disc(circuit).conductance / predictions.mixed_conductance(circuit)
        assert row["predicted"] == pytest.approx(ratio * row["mixed"], rel=1e-6)


def test_lines_of_the_picture_can_be_told_apart() -> None:
    assert_looks_apart(picture.figure(json.loads((HERE / "experiments.json").read_text())))

"""The physics in three precisions, each rung of the ladder held to its place by the probes."""

from __future__ import annotations

import math
import shutil
import subprocess
from decimal import Decimal

import numpy as np
import pytest

from postproc.accuracy import polygons, reversal, stability, trajectories
from postproc.study.probes import PRECISIONS, Question, ask
from postproc.study.study import ROOT, Study

# Builds the physics in three precisions.
pytestmark = pytest.mark.full
NUMBER = 100
EXACT = ("excursion", "collision", "synchronous")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """Return a study whose probes are built, with an initial file."""
    if shutil.which("make") is None:
        pytest.skip("there is no make")
    programs = [f"build/bin/accuracy-{precision}" for precision in PRECISIONS]
    command = ["make", *programs]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    folder = tmp_path_factory.mktemp("probes")
    (folder / "start.txt").write_text(trajectories.start_file(NUMBER), encoding="utf-8")
    return Study(folder)


def run_probe(study: Study, precision: str, *words: object) -> list[dict]:
    name = "-".join(map(str, (precision, *words))).replace("/", "_")
    return ask(study, [Question(name[:100], precision, tuple(map(str, words)))])[0]


def places(
    study: Study, precision: str, engine: str, step: float = 0.0, threshold: int = 100
) -> list:
    words = ("trajectory", engine, step, "start.txt", NUMBER, threshold, 5)
    answer = run_probe(study, precision, *words)
    return trajectories.places(answer)[5.0]


@pytest.mark.parametrize(("width1", "width2"), [(0.3, 0.01), (1e-6, 1e-6)])
def test_visits_agree_with_quadruple_precision(study: Study, width1: float, width2: float) -> None:
    words = ("visits", "disc", width1, width2, 20000, 52)
    run_probe(study, "real64", *words, "double.bin")
    (found,) = run_probe(study, "real128", *words, "quadruple.bin", "double.bin")
    assert found["wrong"] == 0
    assert found["same"] + found["corner"] == 20000
    assert found["corner"] < 100
    assert found["worst"] < 1e-15  # required is 1e-12


@pytest.mark.parametrize("urn", polygons.POLYGONS)
def test_visits_to_polygons_agree_with_quadruple_precision(study: Study, urn: str) -> None:
    corners = ",".join(str(float(one)) for corner in polygons.POLYGONS[urn] for one in corner)
    words = ("visits", corners, 0.3, 0.01, 5000, 52)
    run_probe(study, "real64", *words, "double.bin")
    (found,) = run_probe(study, "real128", *words, "quadruple.bin", "double.bin")
    assert found["same"] + found["corner"] == 5000
    assert found["corner"] < 5
    assert found["greatest_condition"] > 1e4
    assert 1e-17 < found["worst"] < 1e-15


@pytest.mark.parametrize("engine", EXACT)
def test_the_photon_of_the_hundred_digits(engine: str) -> None:
    # Of 16 digits and of 34 the 14 hits leave 5 at least and 23.
    answer = Decimal("0.99526291944335416089031180942672")
    for precision, close in (("real64", Decimal("1e-5")), ("real128", Decimal("1e-23"))):
        command = [ROOT / f"build/bin/accuracy-{precision}", "photon", engine]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        _, hits, distance, _ = done.stdout.split()
        assert hits == "14"
        assert abs(Decimal(distance) - answer) < close


def test_visits_in_single_precision_are_as_good_as_it_is(study: Study) -> None:
    words = ("visits", "disc", 0.3, 0.01, 20000, 23)
    run_probe(study, "real32", *words, "single.bin")
    (found,) = run_probe(study, "real128", *words, "quadruple.bin", "single.bin")
    assert found["wrong"] == 0
    assert found["corner"] < 20
    assert 1e-9 < found["worst"] < 1e-6


@pytest.mark.parametrize("engine", EXACT)
def test_exact_engines_agree_to_their_precision(study: Study, engine: str) -> None:
    truth = places(study, "real128", "collision", threshold=2)
    # gates share errors out among those they turn back, so it is the median that is held
    for precision, least, most in (("real32", 1e-9, 1e-4), ("real64", 1e-18, 1e-13)):
        errors = trajectories.distances(places(study, precision, engine, threshold=2), truth)
        assert least < np.median(errors) < most
    if engine != "collision":
        errors = trajectories.distances(places(study, "real128", engine, threshold=2), truth)
        assert np.median(errors) < 1e-31


def test_fixed_step_is_of_first_order_in_each_precision(study: Study) -> None:
    truth = places(study, "real128", "collision")
    for precision in ("real32", "real64"):
        found = [places(study, precision, "timestep", step)
                 for step in (0.016, 0.008, 0.004, 0.002)]  # fmt: skip
        error = [np.median(trajectories.distances(one, truth)) for one in found]
        order = -np.polyfit(range(4), np.log2(error), 1)[0]
        assert 0.8 < order < 1.2


@pytest.mark.parametrize("engine", stability.ENGINES)
@pytest.mark.parametrize("precision", ["real32", "real64"])
def test_nobody_is_lost_where_methods_fail(study: Study, engine: str, precision: str) -> None:
    answer = run_probe(study, precision, "stability", engine, 20000, 0.02)
    known = {"openings of 1e-9"} if (engine, precision) == ("excursion", "real32") else set()
    for line in answer:
        if line["case"] not in known:
            assert line["lost"] == 0, line["case"]
        assert line["not_a_number"] == 0, line["case"]
        assert line["speed_error"] < (1e-6 if precision == "real32" else 1e-14)
    assert stability.ties(answer, answer) in ("0", "-")
    assert stability.late_clock(answer, answer) == "0"
    if engine in EXACT and precision == "real64":
        far = stability.number(stability.pick(answer, "corner farthest wrong shot")[0]["value"])
        assert far < 1e-15


def test_tangent_map_grows_as_two_neighbours_part(study: Study) -> None:
    apart, time = Decimal("1e-25"), 100
    lines, shifted = trajectories.start_file(NUMBER).split("\n")[:40], []
    for line in lines:
        x, y, ux, uy = map(Decimal, line.split())
        shifted.append(f"{x - apart * uy} {y + apart * ux} {ux} {uy}")
    found = []
    for name, content in (("here.txt", lines), ("there.txt", shifted)):
        (study.folder / name).write_text("\n".join(content) + "\n", encoding="utf-8")
        answer = run_probe(study, "real128", "trajectory", "collision", 0, name, 40, 40, time)
        found.append(trajectories.places(answer)[float(time)])
    grown = np.log(trajectories.distances(*found) / float(apart)).mean() / time
    (tangent,) = run_probe(study, "real128", "lyapunov", 0.3, 0.01, 40, time, "here.txt")
    assert 0.08 < grown < 0.25
    assert grown == pytest.approx(float(tangent["lyapunov"]), abs=0.02)


def test_free_circuit_returns_until_rounding_has_grown(study: Study) -> None:
    answer = run_probe(study, "real64", "reversal", "collision", 0, "start.txt", NUMBER, 5, 50, 600)
    row = reversal.measure(answer)
    assert row["median"][0] < 1e-13
    assert row["median"][0] < row["median"][1] < 1e-8
    assert row["median"][2] > 0.1


def log_of(*events: tuple[float, int, int, int]) -> list[dict]:
    names = ("event_time", "kind", "where", "particle")
    return [dict(zip(names, (list(column) for column in zip(*events, strict=True)), strict=True))]


def test_event_times_are_compared_until_a_particle_goes_another_way() -> None:
    truth = log_of((1, 1, 1, 1), (2, 1, 2, 2), (2, 2, 1, 5), (3, 3, 12, 1), (4, 1, 2, 1))
    mine = log_of((1.5, 1, 1, 1), (2.25, 1, 2, 2), (3.5, 3, 21, 1), (4, 1, 2, 1))
    errors, share = trajectories.event_errors(mine, truth, 10.0)
    assert sorted(errors) == [0.25, 0.5]
    assert share == 0.5


def test_distances_go_round_the_circuit() -> None:
    half = Decimal(trajectories.AROUND / 2)
    found = trajectories.distances([[half], [Decimal(0)]], [[-half + Decimal("0.1")], [Decimal(0)]])
    assert found[0] == pytest.approx(0.1)


def test_growth_and_horizon_are_read_off_a_known_exponential() -> None:
    time = np.array([1, 10, 30, 50, 80, 100, 150, 200, 250, 300], float)
    error = np.minimum(1e-16 * np.exp(0.14 * time), 2.0)
    row = {"time": time, "median": error, "mean_log": np.log(error), "astray": error > 1.0}
    assert trajectories.fit_growth(row) == pytest.approx(0.14)
    assert trajectories.horizon(row) == pytest.approx(math.log(1e15) / 0.14, rel=0.01)

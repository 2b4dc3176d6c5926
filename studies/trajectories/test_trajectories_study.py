"""Errors of trajectories: exact engines to their precision, growth, horizons, time reversal."""

from __future__ import annotations

import math
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from studies.common.probing import make_probes, run_probe
from studies.common.study import Study
from studies.trajectories import growth, reversal

NUMBER = 100
EXACT = ("excursion", "collision", "synchronous")


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """Return a study whose probes are built, with an initial file."""
    make_probes()
    folder = tmp_path_factory.mktemp("trajectories")
    (folder / "start.txt").write_text(growth.start_file(NUMBER), encoding="utf-8")
    return Study(folder)


def places(
    work: Study, precision: str, engine: str, step: float = 0.0, threshold: int = 100
) -> list:
    words = ("trajectory", engine, step, "start.txt", NUMBER, threshold, 5)
    answer = run_probe(work, precision, *words)
    return growth.places(answer)[5.0]


@pytest.mark.parametrize("engine", EXACT)
@pytest.mark.full
def test_exact_engines_agree_to_their_precision(work: Study, engine: str) -> None:
    truth = places(work, "real128", "collision", threshold=2)
    # gates pass errors on to all particles that they reverse, so the median is compared
    for precision, least, most in (("real32", 1e-9, 1e-4), ("real64", 1e-18, 1e-13)):
        errors = growth.distances(places(work, precision, engine, threshold=2), truth)
        assert least < np.median(errors) < most
    if engine != "collision":
        errors = growth.distances(places(work, "real128", engine, threshold=2), truth)
        assert np.median(errors) < 1e-31


@pytest.mark.full
def test_fixed_step_is_of_first_order_in_each_precision(work: Study) -> None:
    truth = places(work, "real128", "collision")
    for precision in ("real32", "real64"):
        found = [places(work, precision, "timestep", step)
                 for step in (0.016, 0.008, 0.004, 0.002)]  # fmt: skip
        error = [np.median(growth.distances(one, truth)) for one in found]
        order = -np.polyfit(range(4), np.log2(error), 1)[0]
        assert 0.8 < order < 1.2


@pytest.mark.full
def test_tangent_map_grows_as_two_neighbours_part(work: Study) -> None:
    apart, time = Decimal("1e-25"), 100
    lines, shifted = growth.start_file(NUMBER).split("\n")[:40], []
    for line in lines:
        x, y, ux, uy = map(Decimal, line.split())
        shifted.append(f"{x - apart * uy} {y + apart * ux} {ux} {uy}")
    found = []
    for name, content in (("here.txt", lines), ("there.txt", shifted)):
        (work.folder / name).write_text("\n".join(content) + "\n", encoding="utf-8")
        answer = run_probe(work, "real128", "trajectory", "collision", 0, name, 40, 40, time)
        found.append(growth.places(answer)[float(time)])
    grown = np.log(growth.distances(*found) / float(apart)).mean() / time
    (tangent,) = run_probe(work, "real128", "lyapunov", 0.3, 0.01, 40, time, "here.txt")
    assert 0.08 < grown < 0.25
    assert grown == pytest.approx(float(tangent["lyapunov"]), abs=0.02)


@pytest.mark.full
def test_free_circuit_returns_until_rounding_has_grown(work: Study) -> None:
    answer = run_probe(work, "real64", "reversal", "collision", 0, "start.txt", NUMBER, 5, 50, 600)
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
    errors, share = growth.event_errors(mine, truth, 10.0)
    assert sorted(errors) == [0.25, 0.5]
    assert share == 0.5


def test_distances_go_round_the_circuit() -> None:
    half = Decimal(growth.AROUND / 2)
    found = growth.distances([[half], [Decimal(0)]], [[-half + Decimal("0.1")], [Decimal(0)]])
    assert found[0] == pytest.approx(0.1)


def test_growth_and_horizon_are_read_off_a_known_exponential() -> None:
    time = np.array([1, 10, 30, 50, 80, 100, 150, 200, 250, 300], float)
    error = np.minimum(1e-16 * np.exp(0.14 * time), 2.0)
    row = {"time": time, "median": error, "mean_log": np.log(error), "astray": error > 1.0}
    assert growth.fit_growth(row) == pytest.approx(0.14)
    assert growth.horizon(row) == pytest.approx(math.log(1e15) / 0.14, rel=0.01)


def test_tables_have_a_row_for_each_engine(tmp_path: Path) -> None:
    found = {"horizon": {"collision real64": 247.3, "timestep real64": 61.0},
             "predicted_horizon": {"real64": 248.0}}  # fmt: skip
    reversal.table(Study(tmp_path), found)
    assert (tmp_path / "reversal.csv").read_text().splitlines()[1:] == [
        "`collision`,real64,248,247", "`timestep`,real64,-,61.0",
    ]  # fmt: skip

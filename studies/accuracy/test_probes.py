"""The physics in three precisions, each rung of the ladder held to its place by the probes."""

from __future__ import annotations

import pytest

from studies.accuracy import polygons, stability
from studies.common.probing import make_probes, run_probe
from studies.common.study import Study
from studies.common.visits import compared_visits

# Builds the physics in three precisions.
pytestmark = pytest.mark.full
NUMBER = 100
EXACT = ("excursion", "collision", "synchronous")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """Return a study whose probes are built."""
    make_probes()
    return Study(tmp_path_factory.mktemp("probes"))


@pytest.mark.parametrize(("width1", "width2"), [(0.3, 0.01), (1e-6, 1e-6)])
def test_visits_agree_with_quadruple_precision(study: Study, width1: float, width2: float) -> None:
    words = {"": ("disc", str(width1), str(width2))}
    single, double = compared_visits(study, f"visits-{width1:g}", words, 20000)
    assert double["wrong"] == 0
    assert double["same"] + double["corner"] == 20000
    assert double["corner"] < 100
    assert double["worst"] < 1e-15  # required is 1e-12
    if width1 == 0.3:  # single precision is as good as it is
        assert single["wrong"] == 0
        assert single["corner"] < 20
        assert 1e-9 < single["worst"] < 1e-6


@pytest.mark.parametrize("urn", polygons.POLYGONS)
def test_visits_to_polygons_agree_with_quadruple_precision(study: Study, urn: str) -> None:
    corners = ",".join(str(float(one)) for corner in polygons.POLYGONS[urn] for one in corner)
    name = urn.split(maxsplit=1)[0]
    _, found = compared_visits(study, name, {urn: (corners, "0.3", "0.01")}, 5000)
    assert found["same"] + found["corner"] == 5000
    assert found["corner"] < 5
    assert found["greatest_condition"] > 1e4
    assert 1e-17 < found["worst"] < 1e-15


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

"""Figures of the paper: what each shows of short runs, complete and partial."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from postproc.figures import appendix, maps
from postproc.reading import points
from postproc.reading.results import Results
from postproc.tests.commands import call
from postproc.tests.runs import BARE, leave_out, results_of
from postproc.theory.circuit import Circuit, homogeneous_kind

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("runs")
    results_of(made / "time.h5", scan={"threshold": [2, 7, 18]}, particles={"urn1_number": 1000})
    results_of(
        made / "slices.h5", scan={"channel2_width": [0.0102, 0.0306], "threshold": [4, 8, 12, 18]}
    )
    grid = {"channel2_width": [0.01, 0.05, 0.09], "threshold": [2, 7, 12, 18], "replicas": 1}
    for name, first in (("homogeneous", 500), ("polarised", 1000)):
        path = made / f"{name}.h5"
        results_of(path, scan=grid, particles={"urn1_number": first}, output=BARE)
    leave_out(made / "polarised.h5", (2, 0), (11, 0))
    urns = {"number": [500, 1000], "channel1_width": [0.1, 0.3], "threshold": [3, 9, 15]}
    results_of(
        made / "urn.h5", table={"shape": "urn"}, particles={"number": None}, scan=urns, output=BARE
    )
    return made


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("model", ()),
        ("model", ("time.h5",)),
        ("comp05", ("time.h5",)),
        ("comp06", ("time.h5",)),
        ("comp01", ("slices.h5",)),
        ("numris", ("homogeneous.h5",)),
        ("numris", ("homogeneous.h5", "polarised.h5")),
        ("app2", ("urn.h5",)),
        ("app3", ("urn.h5",)),
        ("app4", ("urn.h5",)),
    ],
)
def test_every_figure_is_drawn(
    name: str, files: tuple[str, ...], folder: Path, tmp_path: Path
) -> None:
    arguments = [name, *(str(folder / file) for file in files), "--output", str(tmp_path)]
    assert call("figures", arguments) == 0
    assert (tmp_path / f"{name}.png").stat().st_size > 5000
    assert (tmp_path / f"{name}.pdf").stat().st_size > 5000


def test_a_figure_without_its_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("figures", ["comp01"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(("name", "file"), [("app2", "slices.h5"), ("comp01", "urn.h5")])
def test_a_run_of_the_other_shape(
    name: str, file: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("figures", [name, str(folder / file), "--output", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_points_of_several_files_stand_side_by_side(folder: Path) -> None:
    with Results(folder / "homogeneous.h5") as one, Results(folder / "polarised.h5") as other:
        gathered = points.gather([one, other])
    assert gathered.number.size == 24
    assert [part.number.size for _, part in maps.by_start(gathered)] == [12, 12]
    assert np.count_nonzero(np.isnan(gathered.chi)) == 2


def test_map_has_each_value_in_its_cell(folder: Path) -> None:
    with Results(folder / "homogeneous.h5") as results:
        gathered = points.gather([results])
    thresholds, widths, filled = maps.grid(gathered, gathered.threshold + gathered.width2)
    assert filled == pytest.approx(thresholds[None, :] + widths[:, None])
    assert maps.edges(np.array([1.0, 2.0, 4.0])) == pytest.approx([0.5, 1.5, 3.0, 5.0])


def test_drawn_transition_line_is_where_stability_changes() -> None:
    (width,) = maps.transition_line(Circuit(1000, 7), np.array([7.0]))
    below, above = (Circuit(1000, 7, channel2_width=width * factor) for factor in (0.999, 1.001))
    assert homogeneous_kind(below) == "unstable"
    assert homogeneous_kind(above) == "stable"


def test_relative_difference_leaves_out_vanishing_theory() -> None:
    difference, error = appendix.relative_difference(
        np.array([1.1, 0.0]), np.array([0.1, 0.1]), np.array([1.0, 1e-9])
    )
    assert difference[0] == pytest.approx(-0.1)
    assert error[0] == pytest.approx(0.1)
    assert np.isnan(difference[1])

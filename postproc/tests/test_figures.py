"""Figures of the paper: what each shows of short runs, complete and partial."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from postproc.figures import appendix, circuits, currents, maps, model
from postproc.reading import points
from postproc.reading.results import Results, opened
from postproc.tests.commands import call
from postproc.tests.runs import BARE, leave_out, results_of
from postproc.theory.circuit import Circuit, homogeneous_kind, single_urn_current
from postproc.theory.renewal import THEORIES
from postproc.theory.states import stable_state

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


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


def labels_of(made: Figure) -> list[str]:
    return [text.get_text() for legend in made.legends for text in legend.get_texts()]


def marks_of(axes: Axes) -> list[Floats]:
    """Return x and y of the points with error bars, shape (2, point), for each set of them."""
    return [np.array(container.lines[0].get_data()) for container in axes.containers]


def lines_of(axes: Axes, dashes: str) -> list[Floats]:
    """Return x and y of the lines with these dashes, those for the legend alone left out."""
    lines = [line.get_data() for line in axes.lines if line.get_linestyle() == dashes]
    return [np.array(line) for line in lines if len(line[0])]


@pytest.mark.parametrize(("name", "file"), [("model", None), ("comp05", "time.h5")])
def test_a_figure_is_written(
    name: str, file: str | None, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [name, *([str(folder / file)] if file else []), "--output", str(tmp_path)]
    assert call("figures", arguments) == 0
    written = [tmp_path / f"{name}.png", tmp_path / f"{name}.pdf"]
    assert capsys.readouterr().out.split() == [str(path) for path in written]
    assert [path.read_bytes()[:5] for path in written] == [b"\x89PNG\r", b"%PDF-"]


def test_model_names_the_lengths_and_shows_particles_of_a_run(folder: Path) -> None:
    for names, table in (((), model.EXAMPLE), (("time.h5",), Circuit(1000, 2))):
        with opened([folder / name for name in names]) as files:
            made = model.figure_model(files)
        (axes,) = made.axes
        texts = [text.get_text() for text in axes.texts if text.get_text()]
        once = ["$r$", "$w$", "$w'$", "gate 1", "gate 2", "urn 1", "urn 2"]
        assert sorted(texts) == sorted([*once, *2 * [r"$\ell/2$"], *2 * [r"$\ell'/2$"]])
        assert axes.collections[0].get_offsets().shape == (model.SHOWN, 2)
        walls = np.concatenate([line.get_xdata() for line in axes.lines])
        assert np.abs(walls).max() == pytest.approx(float(table.end))


def test_comp05_has_a_panel_a_threshold(folder: Path) -> None:
    with opened([folder / "time.h5"]) as files:
        made = circuits.figure_comp05(files)
        middles = [files[0].series(at, 0).flows["flow1_12"].mean() for at in range(3)]
    assert [axes.get_title("left") for axes in made.axes] == [
        f"({letter})  $T = {threshold}$" for letter, threshold in (("a", 2), ("b", 7), ("c", 18))
    ]
    assert len(labels_of(made)) == 7
    for axes, mean in zip(made.axes, middles, strict=True):
        assert axes.get_xlim() == (0.0, 1000.0)
        x, y = marks_of(axes)[0]  # runs of 3 or 4 entries of the series each
        assert np.diff(x) == pytest.approx(1000.0 / currents.MARKS, abs=6.0)
        assert y.mean() == pytest.approx(mean, rel=0.05)


def test_comp06_shows_chi_from_one_and_the_stable_states(folder: Path) -> None:
    with opened([folder / "time.h5"]) as files:
        made = circuits.figure_comp06(files)
        states = [stable_state(files[0].circuit(at)) for at in range(3)]
        numbers = files[0].series(1, 0).urn1_number
    spread, current = made.axes
    assert spread.get_ylabel() == r"mass spread $\chi$"
    assert current.get_xlabel() == "time $t$  (length / $v$)"
    assert current.get_xlim() == (0.0, 1000.0)
    assert labels_of(made)[:3] == ["$T = 2$", "$T = 7$", "$T = 18$"]
    drawn = {line.get_label(): line.get_ydata() for line in spread.lines}
    assert drawn["$T = 7$"] == pytest.approx(np.abs(1000.0 - 2.0 * numbers) / 1000.0)
    expected = {state.mass_spread for state in states if state is not None}
    levels = {float(y[0]) for dashes in (":", "--") for _, y in lines_of(spread, dashes)}
    assert levels == expected
    assert len(levels) >= 2


def test_comp01_has_the_measured_currents_against_threshold_and_chi(folder: Path) -> None:
    with opened([folder / "slices.h5"]) as files:
        made = circuits.figure_comp01(files)
        gathered = points.gather(files)
    left, right = made.axes
    assert left.get_xlabel() == "$T/N$"
    assert left.get_ylabel() == "net current (per unit time)"
    assert right.get_xlabel() == r"mass spread $\chi$"
    assert right.get_xlim() == (0.0, 1.0)
    theories = [f"theory, {name}" for name in THEORIES]
    assert labels_of(made) == ["$w' = 0.0102$", "$w' = 0.0306$", *theories]
    for at, width in enumerate((0.0102, 0.0306)):
        group = gathered.where(gathered.channel2_width == width)
        assert marks_of(left)[at] == pytest.approx(
            np.array([group.threshold / 1000.0, group.current])
        )
        assert marks_of(right)[at] == pytest.approx(np.array([group.chi, group.current]))


def test_numris_shows_each_point_and_the_transition_lines(folder: Path) -> None:
    with opened([folder / "homogeneous.h5", folder / "polarised.h5"]) as files:
        made = maps.figure_numris(files)
        parts = [part for _, part in maps.by_start(points.gather(files))]
        lines = maps.transition_lines(parts[0], files[0].circuit(0))
    panels, bars = made.axes[:6], made.axes[6:]
    values = [part.chi for part in parts], [part.current for part in parts]
    for column, (start, final) in enumerate(values):
        for row, drawn in enumerate((start, final, final - start)):
            axes = panels[2 * row + column]
            shown = axes.collections[0].get_array().filled(np.nan)
            assert shown == pytest.approx(maps.grid(parts[0], drawn)[2], nan_ok=True)
            for line, (fraction, widths, _, label) in zip(axes.lines, lines, strict=True):
                assert line.get_label() == f"transition, {label}"
                assert line.get_ydata() == pytest.approx(widths, nan_ok=True)
                assert line.get_xdata() == pytest.approx(fraction)
            assert axes.get_ylim() == pytest.approx((0.0, 0.11))
            assert axes.get_xlim() == pytest.approx((-0.0005, 0.0210))
    assert {bar.get_ylabel() for bar in bars} == {
        f"{before}{label}"
        for before in ("", "difference of\n")
        for label in (r"mass spread $\chi$", "net current (per unit time)")
    }
    assert [axes.get_xlabel() for axes in panels[4:]] == ["$T/N$"] * 2
    assert labels_of(made) == [f"transition, {name}" for name in THEORIES]


def test_appendix_shows_measured_currents_beside_theory(folder: Path) -> None:
    drawings = (appendix.figure_app2, appendix.figure_app3, appendix.figure_app4)
    with opened([folder / "urn.h5"]) as files:
        by_number, relative, together = (draw(files) for draw in drawings)
        gathered = points.gather(files)
        circuits_ = [files[0].circuit(point) for point in gathered.point]
    expected = np.array([float(single_urn_current(one)) for one in circuits_])
    groups = [
        (gathered.number == number) & (gathered.channel1_width == width)
        for number in (500, 1000)
        for width in (0.1, 0.3)
    ]
    assert [axes.get_title("left") for axes in by_number.axes] == ["$N = 500$", "$N = 1000$"]
    marks = [one for axes in by_number.axes for one in marks_of(axes)]
    scaled = marks_of(together.axes[0])
    paper = [one for axes in by_number.axes for one in lines_of(axes, "--")]
    differences = [one for axes in relative.axes[:2] for one in marks_of(axes)[::2]]
    for at, group in enumerate(groups):
        fraction, current = (gathered.threshold / gathered.number)[group], gathered.current[group]
        assert marks[at] == pytest.approx(np.array([fraction, current]))
        assert scaled[at] == pytest.approx(np.array([fraction, current / gathered.number[group]]))
        line = np.interp(fraction, *paper[at])
        assert line == pytest.approx(expected[group], rel=1e-9)
        apart = np.where(line > appendix.LEAST, (line - current) / line, np.nan)
        assert differences[at] == pytest.approx(np.array([fraction, apart]), nan_ok=True)
    assert by_number.axes[0].get_ylabel() == "current (per unit time)"
    assert together.axes[0].get_ylabel() == "current / $N$ (per unit time)"
    assert {axes.get_xlabel() for axes in by_number.axes} == {"$T/N$"}


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
    thresholds, widths, filled = maps.grid(gathered, gathered.threshold + gathered.channel2_width)
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

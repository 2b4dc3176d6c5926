"""Figures of the paper: what each shows of short runs, complete and partial."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.path import Path as Polyline

from postproc.figures import (
    appendix,
    circuits,
    currents,
    lengths,
    maps,
    passages,
    scene,
    style,
    theories,
)
from postproc.reading.groups import Snapshot, series_of
from postproc.reading.points import means
from postproc.reporting import warn
from postproc.tests.commands import call
from postproc.tests.runs import BARE, edited, leave_out, points_of, results_of
from postproc.theory.circuit import Circuit, single_urn_current
from postproc.theory.models import MODELS
from postproc.theory.states import Theory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

QUICK = theories.named(["window", "renewal"])
KEYS = ("threshold", "channel2_width")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("runs")
    results_of(made / "time.h5", scan={"threshold": [2, 7, 18]}, particles={"urn1_number": 1000})
    # as the maps of the paper: as many collisions at each point, so different ages
    run = {"duration": None, "collisions": 800_000}
    slices = {"channel2_width": [0.0102, 0.0306], "threshold": [4, 8, 12, 18]}
    results_of(made / "slices.h5", scan=slices, run=run)
    grid = {"channel2_width": [0.01, 0.05, 0.09], "threshold": [2, 7, 12, 18], "replicas": 1}
    for name, first in (("homogeneous", 500), ("polarised", 1000)):
        path = made / f"{name}.h5"
        results_of(path, scan=grid, run=run, particles={"urn1_number": first}, output=BARE)
    leave_out(made / "polarised.h5", (2, 0), (11, 0))
    results_of(made / "point.h5", scan={"threshold": 2, "replicas": 1})
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


@pytest.mark.parametrize(("name", "file"), [("model", None), ("comp05", "point.h5")])
def test_a_figure_is_written(
    name: str, file: str | None, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(style, "RESOLUTION", 50)
    # Letters as outlines: a font is cut to its letters where files are written in test_pictures.
    monkeypatch.setitem(style.SETTINGS, "pdf.fonttype", 3)
    arguments = [name, *([str(folder / file)] if file else []), "--output", str(tmp_path)]
    assert call("plot", arguments) == 0
    stem = f"{Path(file).stem}_{name}" if file else name
    written = [tmp_path / f"{stem}.png", tmp_path / f"{stem}.pdf"]
    assert capsys.readouterr().out.split() == [str(path) for path in written]
    assert [path.read_bytes()[:5] for path in written] == [b"\x89PNG\r", b"%PDF-"]


def test_model_names_the_lengths_and_shows_particles_of_a_run(folder: Path) -> None:
    for given, table, said in (
        (None, lengths.EXAMPLE, ""),
        (points_of(folder / "time.h5"), Circuit(1000, 2), "40 of 1000 particles, $t = 0$"),
    ):
        made = lengths.figure_circuit(given)
        (axes,) = made.axes
        texts = [text.get_text() for text in axes.texts if text.get_text()]
        once = ["$r$", "$w$", "$w'$", "gate 1", "gate 2", "urn 1", "urn 2"]
        assert [text.get_text() for text in made.texts] == [said]
        assert sorted(texts) == sorted([*once, *2 * [r"$\ell/2$"], *2 * [r"$\ell'/2$"]])
        assert axes.collections[0].get_offsets().shape == (lengths.SHOWN, 2)
        walls = np.concatenate([line.get_xdata() for line in axes.lines])
        assert np.abs(walls).max() == pytest.approx(float(table.end))


@pytest.mark.parametrize(
    "given",
    [
        {"channel1_length": 1.0, "channel2_length": 3.0},
        {"channel1_length": 0.3, "channel2_length": 6.0},
        {"channel1_length": 0.05, "channel2_length": 0.1, "channel1_width": 0.1},
        {"urn_radius": 3.0, "urn2_radius": 0.2, "channel2_width": 0.05},
        {"urn_radius": 0.2, "urn2_radius": 3.0, "channel1_length": 0.3},
        {"channel2_length": 60.0},
        {"channel1_width": 1.9, "channel1_length": 0.2},
        {"shape": "urn", "channel2_width": 0.0, "channel1_length": 30.0},
    ],
)
def test_names_of_lengths_of_any_table_are_read(given: dict[str, float]) -> None:
    circuit = Circuit(20, 1, **{"channel2_width": 0.1} | given)
    made = lengths.picture_of(circuit, Snapshot(0.0, *np.zeros((4, 1))))
    made.set_dpi(style.RESOLUTION)
    made.draw_without_rendering()
    texts = [one for one in made.axes[0].texts if one.get_text()]
    boxes = [one.get_window_extent() for one in texts]
    said = " ".join(one.get_text() for one in texts)
    alone = circuit.shape == "urn"
    names = ["gate", "urn 1", "$w$", *(["end wall"] if alone else ["urn 2", r"\ell'/2", "$w'$"])]
    assert all(name in said for name in names)
    assert "$r$" in said or ("$r_1$" in said and "$r_2$" in said)
    assert r"$\ell/2$" in said or r"$\ell$" in said
    walls = [made.axes[0].transData.transform(one) for one in scene.walls(circuit)]
    for at, (text, box) in enumerate(zip(texts, boxes, strict=True)):
        assert made.bbox.x0 <= box.x0 < box.x1 <= made.bbox.x1
        assert made.bbox.y0 <= box.y0 < box.y1 <= made.bbox.y1
        hit = [one.get_text() for one, other in zip(texts[:at], boxes, strict=False)
               if box.overlaps(other)]  # fmt: skip
        assert not hit, text.get_text()
        # w is beside its arrow, which may be nearly as wide as the channel; others are on white.
        if text.get_text() not in ("$w$", "end wall") and text.get_bbox_patch() is None:
            assert not any(Polyline(one).intersects_bbox(box, filled=False) for one in walls)


def test_comp05_has_a_panel_a_threshold(folder: Path) -> None:
    files = points_of(folder / "time.h5")
    made = circuits.figure_flows(files, QUICK[:1])
    averages = [series_of(files, at, 0)[0].mean() for at in range(3)]
    titles = [axes.get_title("left") for axes in made.axes]
    assert [title for title in titles if title] == [
        f"({letter})  $T = {threshold}$, replica 0"
        for letter, threshold in zip("abc", (2, 7, 18), strict=True)
    ]
    assert labels_of(made)[-4:] == [label for _, _, label in currents.FLOW_LOOK.values()]
    timed = [axes for axes in made.axes if axes.get_xlabel() != "$N_2/N$"]
    starts = [at for at, axes in enumerate(timed) if axes.get_title("left")]
    for start, end, mean in zip(starts, [*starts[1:], None], averages, strict=True):
        for axes in timed[start:end]:
            assert axes.get_xlim() == (0.0, 1000.0)
            for (x, y), name in zip(marks_of(axes), currents.FLOW_LOOK, strict=True):
                assert np.diff(x) == pytest.approx(1000.0 / currents.MARKS, abs=6.0)
                assert y.mean() == pytest.approx(float(mean[name]), rel=0.05, abs=1e-2)
    assert len(made.axes) - len(timed) == 3


def test_an_axis_is_broken_where_nothing_lies_and_all_is_shown() -> None:
    (low, high), (other, top) = currents._ranges(np.array([0.0, 0.01, 0.02, 1.0, 1.1]))
    assert low < 0.0
    assert 0.02 < high < 0.1
    assert 0.9 < other < 1.0
    assert top > 1.1
    ((low, top),) = currents._ranges(np.linspace(-0.2, 1.0, 20))
    assert low < -0.2
    assert top > 1.0


def test_comp06_shows_chi_from_one_and_the_stable_states(folder: Path) -> None:
    files = points_of(folder / "time.h5")
    made = circuits.figure_relaxation(files, QUICK)
    pairs = [(at, one) for at in range(3) for one in QUICK]
    states = [one.reached(files["circuit"].values[at], 0.0) for at, one in pairs]
    series = series_of(files, 1)
    spread, current = made.axes
    assert spread.get_ylabel() == r"mass spread $\chi$"
    assert current.get_xlabel() == "time $t$  (length / $v$)"
    assert current.get_xlim() == (0.0, 1000.0)
    assert labels_of(made)[:3] == ["$T = 2$", "$T = 7$", "$T = 18$"]
    drawn = {line.get_label(): line.get_ydata() for line in spread.lines}
    chi, flow = ({line.get_label(): line.get_xdata() for line in one.lines}
                 for one in (spread, current))  # fmt: skip
    numbers = [np.append(1000.0, one["urn1_number"].values) for one in series]
    both = [np.abs(1000.0 - 2.0 * one) / 1000.0 for one in numbers]
    # N1 is known at the ends of intervals, and at the start; flows are those of intervals.
    assert chi["$T = 7$"] == pytest.approx(np.arange(0.0, 1001.0, 10.0))
    assert flow["$T = 7$"][[0, -1]] == pytest.approx([10.0, 990.0])
    assert drawn["$T = 7$"] == pytest.approx(np.mean(both, axis=0))
    band = spread.collections[1].get_paths()[0].vertices[1:102]
    assert band[:, 1] == pytest.approx(np.mean(both, axis=0) - np.std(both, axis=0, ddof=1))
    expected = {state.mass_spread for state in states if state is not None}
    levels = {
        float(y[0])
        for dashes in (one.dashes for one in QUICK)
        for x, y in lines_of(spread, dashes)
        if list(x) == [0, 1]
    }
    assert levels == expected
    assert len(levels) >= 2


def test_against_time_the_polarised_current_is_that_of_the_file(tmp_path: Path) -> None:
    """From equal urns, where replicas have either polarity, and where it reverses all the time."""
    path = results_of(tmp_path / "equal.h5", scan={"threshold": [7, 18], "replicas": 4})
    files = points_of(path)
    axes = Figure().add_subplot()
    lines = circuits.draw_relaxation(axes, files, QUICK[:1], "polarised_current")
    found = [line.get_ydata().mean() for line in lines]
    assert found == pytest.approx(means(files, "polarised_current")[0], abs=0.03)
    assert found[0] > 0.5


def test_curves_show_points_without_channel_2(tmp_path: Path) -> None:
    """At no current, as the characteristic."""
    scan = {"channel2_width": [0.0, 0.05], "threshold": 7}
    files = points_of(results_of(tmp_path / "run.h5", scan=scan, output=BARE))
    for against in ("", "chi"):
        axes = Figure().add_subplot()
        (drawn,) = circuits.draw_curves(axes, files, (), "polarised_current", against)
        assert np.isfinite(drawn.lines[0].get_xydata()).all()
        assert drawn.lines[0].get_ydata()[0] == 0.0
    files["chi"][0] = math.nan  # not run
    (drawn,) = circuits.draw_curves(Figure().add_subplot(), files, (), "polarised_current")
    assert np.isnan(drawn.lines[0].get_ydata()).tolist() == [True, False]


def test_a_series_too_coarse_for_the_polarity_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same runs with intervals in which the fuller urn changes."""
    path = results_of(
        tmp_path / "coarse.h5", scan={"threshold": [7, 18], "replicas": 4},
        output={"series_interval": 200.0},
    )  # fmt: skip
    files = points_of(path)
    with pytest.warns(UserWarning, match="coarse.h5: the polarised current against time is too sm"):
        circuits.draw_relaxation(Figure().add_subplot(), files, (), "polarised_current")
    circuits.draw_relaxation(Figure().add_subplot(), files, (), "chi")
    (told,) = [one for one in warn.warnings(files) if "against time is too small" in one]
    assert told.startswith("At 1 of 2 points ")
    # Only what is drawn counts.
    monkeypatch.setattr(circuits, "changes_within", lambda one, *_: one["time"].values > 600.0)
    shares = [circuits._binned_series(files, 1, "polarised_current", 500.0, end)[1]
              for end in (500.0, math.inf)]  # fmt: skip
    assert shares == pytest.approx([0.0, 0.4])


def test_panels_with_one_axis_show_all_points(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of lifetimes and of maps, whatever the last panel shows."""
    files = points_of(folder / "homogeneous.h5", folder / "polarised.h5")
    (name, first), (other, second) = maps.by_start(files)
    few = second.isel(point=second["threshold"].values < second["threshold"].values.max())
    three = [(name, first), (other, second), ("few", few)]
    monkeypatch.setattr(maps, "by_start", lambda _: three)
    panels = maps.figure_phase_diagram(files, theories.named(["window"])).axes[:6]
    for one in panels:
        assert one.get_xlim() == pytest.approx((-0.0005, 0.0210))
    circuit = Circuit(100, 1)
    lives = [
        passages.Lifetime(replace(circuit, channel1_length=length), True, 8, 8, time, time, time)
        for length, time in ((0.1, 5.0), (1.0, 5e3))
    ]
    monkeypatch.setattr(passages, "measured", lambda _: lives)
    made = passages.figure_lifetimes(files, theories.named(["window"]))
    assert made.axes[0].get_ylim()[0] < 5.0


def test_a_band_of_chi_stays_where_chi_can_be_and_a_line_at_its_end_is_seen(folder: Path) -> None:
    files = points_of(folder / "time.h5")
    spread, _ = circuits.figure_relaxation(files, QUICK).axes
    band = np.concatenate([one.get_paths()[0].vertices[:, 1] for one in spread.collections])
    assert 0.0 <= band.min() <= band.max() <= 1.0
    low, high = spread.get_ylim()
    assert low < 0.0
    assert high > 1.0


def test_comp01_has_the_measured_currents_against_threshold_and_chi(folder: Path) -> None:
    mixed = theories.named(["window", "renewal"])
    files = points_of(folder / "slices.h5")
    made = circuits.figure_curves(files, mixed)
    left, right = made.axes
    assert left.get_xlabel() == "$T/N$"
    assert left.get_ylabel() == "polarised current (per unit time)"
    assert right.get_xlabel() == r"mass spread $\chi$"
    low, high = right.get_xlim()  # marks on its ends are seen
    assert -0.05 < low < 0.0
    assert 1.0 < high < 1.05
    told = [f"theory, {one.label}, in the same colours" for one in mixed]
    assert labels_of(made) == ["$w' = 0.0102$", "$w' = 0.0306$", *told]
    for at, width in enumerate((0.0102, 0.0306)):
        group = files.isel(point=files["channel2_width"].values == width)
        chi, current = (means(group, name)[0] for name in ("chi", "polarised_current"))
        assert marks_of(left)[at] == pytest.approx(np.array([group["threshold"] / 1000.0, current]))
        assert marks_of(right)[at] == pytest.approx(np.array([chi, current]))
        for one, mark in zip(mixed, circuits.THEORY_MARKS, strict=False):
            states = [one.reached(Circuit(1000, threshold, channel2_width=width), 500.0)
                      for threshold in range(4, 19)]  # fmt: skip
            spread, current = np.array([(one.mass_spread, one.net_current) for one in states]).T
            assert np.count_nonzero(current) > 5
            assert current[-1] == 0.0  # homogeneous, and drawn
            drawn = [[np.array(line.get_data()) for line in axes.lines
                      if line.get_marker() == mark and len(line.get_xdata())][at]
                     for axes in (left, right)]  # fmt: skip
            expected = (np.arange(4, 19) / 1000.0, current), (spread, current)
            assert np.array(drawn) == pytest.approx(np.array(expected))


def test_numris_shows_each_point_and_the_transition_lines(folder: Path) -> None:
    mixed = theories.named(["window", "renewal"])
    files = points_of(folder / "homogeneous.h5", folder / "polarised.h5")
    made = maps.figure_phase_diagram(files, mixed)
    parts = [part for _, part in maps.by_start(files)]
    lines = maps.transition_lines(parts[0], mixed)
    panels, bars = made.axes[:6], made.axes[6:]
    values = [[means(part, name)[0] for part in parts] for name in ("chi", "polarised_current")]
    for column, (start, final) in enumerate(values):
        for row, drawn in enumerate((start, final, final - start)):
            axes = panels[2 * row + column]
            shown = axes.collections[0].get_array().filled(np.nan)
            assert shown == pytest.approx(maps.map_of(parts[0], KEYS, drawn).values, nan_ok=True)
            for line, (fraction, widths, _, label) in zip(axes.lines, lines, strict=True):
                assert line.get_label() == f"transition, {label}"
                assert line.get_ydata() == pytest.approx(widths, nan_ok=True)
                assert line.get_xdata() == pytest.approx(fraction)
            assert axes.get_ylim() == pytest.approx((0.0, 0.11))
            assert axes.get_xlim() == pytest.approx((-0.0005, 0.0210))
    assert {bar.get_ylabel() for bar in bars} == {""}  # it would be read as of the next panel
    start, final = rf"$\chi(0) = {0}$", rf"$\chi(0) = {1}$"
    assert [axes.get_title("left") for axes in panels] == [
        f"{label}\n{part}" for part in (start, final, f"{final} less {start}")
        for label in (r"mass spread $\chi$", "polarised current (per unit time)")
    ]  # fmt: skip
    assert [axes.get_xlabel() for axes in panels[4:]] == ["$T/N$"] * 2
    *transitions, mark = labels_of(made)
    assert transitions == [f"transition, {one.label}" for one in mixed]
    assert mark.startswith("tricritical")
    # at N = 1000, w = 0.3 the renewal gate turns at T = 7.1, the window at 8.4 above the frame
    places = np.asarray(panels[0].collections[1].get_offsets())
    assert places[:, 0] == pytest.approx([0.0071], abs=2e-4)


def test_unless_told_otherwise_memory_is_drawn_beside_the_papers_theory(folder: Path) -> None:
    files = points_of(folder / "point.h5")
    slices = circuits.figure_curves(files)
    labels = [f"theory, {MODELS[name].label}" for name in ("window", "direction")]
    assert labels_of(slices)[1:] == labels


def test_appendix_shows_measured_currents_beside_theory(folder: Path) -> None:
    drawings = (
        appendix.figure_urn_current,
        appendix.figure_urn_difference,
        appendix.figure_urn_scaled,
    )
    files = points_of(folder / "urn.h5")
    by_number, relative, together = (draw(files) for draw in drawings)
    number, width, thresholds = (files[key].values for key in
                                 ("number", "channel1_width", "threshold"))  # fmt: skip
    currents_of_runs = means(files, "current1")[0]
    expected = np.array([float(single_urn_current(one)) for one in files["circuit"].values])
    groups = [(number == one) & (width == other) for one in (500, 1000) for other in (0.1, 0.3)]
    assert [axes.get_title("left") for axes in by_number.axes] == ["$N = 500$", "$N = 1000$"]
    marks = [one for axes in by_number.axes for one in marks_of(axes)]
    scaled = marks_of(together.axes[0])
    paper = [one for axes in by_number.axes for one in lines_of(axes, "--")]
    differences = [one for axes in relative.axes[:2] for one in marks_of(axes)[::2]]
    lowest = min(float(np.nanmin(y)) for _, y in differences)
    edges = [
        line for axes in relative.axes[:2] for line in axes.lines
        if line.get_marker() == "v" and len(line.get_xdata())
    ]  # fmt: skip
    assert len(edges) == sum(int((y < appendix.LOWEST).sum()) for _, y in differences) > 0
    notes = [text.get_text() for axes in relative.axes[:2] for text in axes.texts]
    assert f"{lowest:.2g}" in notes or any(note.startswith("$-10^") for note in notes)
    for at, group in enumerate(groups):
        fraction, current = (thresholds / number)[group], currents_of_runs[group]
        assert marks[at] == pytest.approx(np.array([fraction, current]))
        assert scaled[at] == pytest.approx(np.array([fraction, current / number[group]]))
        line = np.interp(fraction, *paper[at])
        assert line == pytest.approx(expected[group], rel=1e-9)
        apart = np.where(line > appendix.LEAST, (line - current) / line, np.nan)
        assert differences[at] == pytest.approx(np.array([fraction, apart]), nan_ok=True)
    assert by_number.axes[0].get_ylabel() == "current (per unit time)"
    assert together.axes[0].get_ylabel() == "current / $N$ (per unit time)"
    assert {axes.get_xlabel() for axes in by_number.axes} == {"$T/N$"}


def test_a_figure_without_its_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("plot", ["comp01"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(("name", "file"), [("app2", "slices.h5"), ("comp01", "urn.h5")])
def test_a_run_of_the_other_shape(
    name: str, file: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("plot", [name, str(folder / file), "--output", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_points_of_several_files_stand_side_by_side(folder: Path) -> None:
    gathered = points_of(folder / "homogeneous.h5", folder / "polarised.h5")
    assert gathered.sizes["point"] == 24
    assert [part.sizes["point"] for _, part in maps.by_start(gathered)] == [12, 12]
    assert np.count_nonzero(np.isnan(means(gathered, "chi")[0])) == 2


def test_where_the_polarity_reverses_currents_do_not_cancel(folder: Path) -> None:
    with edited(folder / "homogeneous.h5") as file:
        file["current1"][0], file["polarised_current"][0], file["chi"][0] = 0.0, 0.7, 0.1
    assert means(points_of(folder / "homogeneous.h5"), "polarised_current")[0][0] == 0.7


def test_a_theory_without_a_transition_has_no_line(folder: Path) -> None:
    files = points_of(folder / "point.h5")
    without = replace(MODELS["direction"], theory=Theory())
    (line,) = maps.transition_lines(files, [without, MODELS["window"]])
    assert line[3] == MODELS["window"].label


@pytest.mark.usefixtures("unwritten")
def test_points_that_differ_in_more_than_a_figure_shows_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = {"threshold": [2, 7], "channel2_width": [0.01, 0.02], "replicas": 1}
    scan["channel1_length"] = [1.0, 2.0]
    long = str(results_of(tmp_path / "long.h5", scan=scan, run={"duration": 20.0}, output=BARE))
    both = [str(folder / f"{name}.h5") for name in ("homogeneous", "polarised")]
    words = ["--theory", "window", "--output", str(tmp_path)]
    for name, *given in (("numris", long), ("comp01", long), ("comp01", *both)):
        assert call("plot", [name, *given, *words]) == 2, (name, given)
        assert capsys.readouterr().err.count("\n") == 1
    for name in ("numris", "comp01"):
        assert call("plot", [name, long, *words, "--select", "channel1_length=2"]) == 0
    assert call("plot", ["numris", long, *words, "--select", "channel1_length=3"]) == 2
    assert "there are 1, 2" in capsys.readouterr().err


def test_each_start_has_its_maps_and_title(tmp_path: Path) -> None:
    scan = {"threshold": [2, 7], "channel2_width": [0.01, 0.02], "replicas": 1}
    scan["urn1_fraction"] = [0.5, 0.6, 1.0]
    path = results_of(tmp_path / "starts.h5", scan=scan, run={"duration": 20.0}, output=BARE)
    files = points_of(path)
    made = maps.figure_phase_diagram(files, theories.named(["window"]))
    titles = [axes.get_title("left") for axes in made.axes]
    label = r"mass spread $\chi$"
    assert titles[:6:2] == [f"{label}\n$\\chi(0) = {chi}$" for chi in ("0", "0.2", "1")]


def test_map_has_each_value_in_its_cell(folder: Path) -> None:
    points = points_of(folder / "homogeneous.h5")
    filled = maps.map_of(points, KEYS, (points["threshold"] + points["channel2_width"]).values)
    assert filled.values == pytest.approx(np.add.outer(filled.index, filled.columns))
    assert maps.edges(np.array([1.0, 2.0, 4.0])) == pytest.approx([0.5, 1.5, 3.0, 5.0])


@pytest.mark.usefixtures("unwritten")
def test_theories_are_drawn_by_name(folder: Path, tmp_path: Path) -> None:
    files = points_of(folder / "point.h5")
    made = circuits.figure_curves(files, theories.named(["renewal"]))
    assert labels_of(made)[-1:] == ["theory, renewal gate"]
    arguments = [str(folder / "point.h5"), "--output", str(tmp_path)]
    assert call("plot", ["comp01", *arguments, "--theory", "window", "renewal"]) == 0
    assert call("plot", ["comp01", *arguments, "--theory", "guess"]) == 2


@pytest.mark.usefixtures("unwritten")
def test_single_urn_is_drawn_with_its_end_wall(tmp_path: Path) -> None:
    (axes,) = lengths.figure_urn().axes
    texts = [text.get_text() for text in axes.texts if text.get_text()]
    assert sorted(texts) == ["$\\ell/2$", "$r$", "$w$", "end wall", "gate 1", "urn 1"]
    assert (axes.collections[0].get_offsets()[:, 0] < 0.0).all()
    assert call("plot", ["app1", "--output", str(tmp_path)]) == 0


def test_relative_difference_leaves_out_vanishing_theory() -> None:
    difference, error = appendix.relative_difference(
        np.array([1.1, 0.0]), np.array([0.1, 0.1]), np.array([1.0, 1e-9])
    )
    assert difference[0] == pytest.approx(-0.1)
    assert error[0] == pytest.approx(0.1)
    assert np.isnan(difference[1])

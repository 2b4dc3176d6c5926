"""Figures as functions, merged results, and one number for one thing wherever it is shown."""

from __future__ import annotations

import inspect
import math
import pydoc
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from bokeh.models import LinearColorMapper
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.colors import to_rgb
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

import postproc
from postproc import InputError, plot
from postproc.commands import plot as commands
from postproc.figures import circuits, maps, passages, style
from postproc.reading import results_file
from postproc.reading.grid import selected
from postproc.reading.points import by_point, exactly
from postproc.reporting import data as columns_of
from postproc.reporting.page import Page
from postproc.tests.commands import call
from postproc.tests.runs import BARE, edited, leave_out, points_of, results_of
from postproc.theory.models import MODELS

SHORT = {"duration": 100.0, "transient_duration": 50.0}
SMALL = {"particles": {"number": 200}, "run": SHORT}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("plot")
    scan = {"threshold": [2, 4, 40], "channel2_width": [0.01, 0.05]}
    results_of(made / "map.h5", scan=scan, **SMALL)
    for seed in (1, 2):
        particles = {"number": 200, "seed": seed, "urn1_number": 200}
        results_of(made / f"seed{seed}.h5", scan={"threshold": [2, 4], "replicas": 2}, run=SHORT,
                   particles=particles, output=BARE)  # fmt: skip
    return made


@pytest.mark.parametrize(
    ("draw", "part", "kind"),
    [
        (plot.phase_diagram, {}, QuadMesh),
        (plot.curves, {}, ErrorbarContainer),
        (plot.relaxation, {"channel2_width": 0.01}, Line2D),
        (plot.flows, {"channel2_width": 0.01, "threshold": 2}, ErrorbarContainer),
        (plot.scene, {"channel2_width": 0.01, "threshold": 2}, PathCollection),
        (plot.lifetimes, {"channel2_width": 0.01, "threshold": 2}, ErrorbarContainer),
        (plot.characteristic, {"threshold": 2}, Line2D),
    ],
)
def test_a_figure_is_drawn_into_axes_of_ones_own(
    folder: Path, draw: object, part: dict[str, float], kind: type
) -> None:
    """It gives what matplotlib's own functions give, and sets nothing else; also in an inset."""
    data = postproc.open_results(folder / "map.h5").sel(part)
    axes = Figure().add_subplot().inset_axes((0.5, 0.5, 0.4, 0.4))
    with mpl.rc_context({"pcolor.shading": "nearest"}):
        before = dict(mpl.rcParams)
        drawn = draw(data, ax=axes, **({} if draw is plot.scene else {"theory": "window"}))
        assert dict(mpl.rcParams) == before
    assert all(isinstance(one, kind) for one in (drawn if isinstance(drawn, list) else [drawn]))
    assert not any(one.patch.get_visible() for one in axes.figure.axes[1:])  # they would hide it
    assert axes.has_data()
    axes.figure.draw_without_rendering()


def test_files_of_unlike_discs_are_one_scan_and_keep_their_discs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also chosen from, and merged again; as many discs in other places are refused."""
    discs, files = [0.0, 0.01, 0.01, 0.2, -0.01, 0.01], []
    for name, values in (("two", discs), ("none", None), ("one", discs[:3]), ("moved", discs[3:])):
        table = {"channel2_width": 0.08, "scatterers": values}
        scan = {"threshold": 2, "replicas": 2}
        files.append(results_of(tmp_path / f"{name}.h5", table=table, scan=scan, **SMALL))
    data = postproc.merge(files[:3])
    assert data.scatterer_count.to_index().tolist() == [0, 1, 2]
    assert postproc.table(data)["scatterer_count"].tolist() == [0, 1, 2]
    again = postproc.merge([data.sel(scatterer_count=2), *files[1:3]])
    for points in (by_point(data), by_point(again), by_point(data.sel(scatterer_count=[0, 1, 2]))):
        found = [np.ravel(one.scatterers).tolist() for one in points["circuit"].values]
        assert found == [[], discs[:3], discs]
    for at, path in enumerate((files[1], files[2], files[0])):
        alone = postproc.open_results(path)
        np.testing.assert_array_equal(again.chi.sel(scatterer_count=at), alone.chi.squeeze())
    more = results_of(tmp_path / "more.h5", scan={"threshold": 4}, **SMALL)
    with pytest.raises(InputError, match="there are point, replica, threshold, channel2_w"):
        selected(postproc.merge([*files[:3], more]), [("scatterers", 1.0)])
    with pytest.raises(InputError, match="scatterers differ that are equally many"):
        postproc.merge(files[1:])
    assert call("plot", ["characteristic", *map(str, files[:3]), "--output", str(tmp_path)]) == 0
    assert "no theory has discs in channel 2" in capsys.readouterr().err
    with pytest.raises(InputError, match="no theory is drawn where there are discs"):
        plot.characteristic(data, ax=Figure().add_subplot(), theory="window")
    axes = Figure().add_subplot()
    plot.characteristic(data, ax=axes)
    assert "discs" in " ".join(axes.get_legend_handles_labels()[1])


def test_points_that_a_figure_cannot_show_are_named_with_a_way_to_choose(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The way works, also where a fraction was scanned."""
    scan = {"threshold_fraction": [0.01, 0.02], "urn1_fraction": [0.5, 1.0], "threshold": None}
    starts = postproc.open_results(results_of(tmp_path / "starts.h5", scan=scan, **SMALL))
    with pytest.raises(InputError, match=r"data.sel\(urn1_fraction=0.5\)"):
        plot.curves(starts, ax=Figure().add_subplot())
    assert plot.curves(starts.sel(urn1_fraction=0.5), ax=Figure().add_subplot())
    data = postproc.open_results(folder / "map.h5")
    for draw in (plot.flows, plot.scene):
        with pytest.raises(InputError, match=r"data.sel\(threshold=2\)"):
            draw(data, ax=Figure().add_subplot())
    for name in ("scene", "circuit"):
        words = [name, str(folder / "map.h5"), "--output", str(tmp_path)]
        assert call("plot", words) == 2
        assert "--select threshold=2 or" in capsys.readouterr().err
        one, other = ("--select", "threshold=2"), ("--select", "channel2_width=0.01")
        assert call("plot", [*words, *one, *other]) == 0
        assert (tmp_path / f"map_{name}_threshold=2_channel2_width=0.01.pdf").exists()
    with pytest.raises(InputError, match="no theory 'widow'"):
        plot.curves(data, ax=Figure().add_subplot(), theory="widow")
    with pytest.raises(InputError, match=r"data.sel\(threshold=2\)"):
        plot.characteristic(data, ax=Figure().add_subplot())
    for draw in (plot.phase_diagram, plot.curves, plot.relaxation):
        with pytest.raises(InputError, match=r"no (variable )?'widow'"):
            draw(data.sel(channel2_width=0.01), ax=Figure().add_subplot(), variable="widow")


def test_every_point_of_pairs_that_repeat_a_value_is_shown_and_can_be_chosen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All combinations of both gates are scanned so; the second value is a key of its own."""
    pairs = [(1, 1), (1, 9), (3, 1), (3, 9)]
    first, second = zip(*pairs, strict=True)
    grid = {"threshold": [*first], "threshold2": [*second], "channel2_width": [0.02, 0.1],
            "replicas": 1}  # fmt: skip
    path = results_of(tmp_path / "pairs.h5", run=SHORT, output=BARE, scan=grid)
    data = postproc.open_results(path)
    with pytest.raises(InputError, match="--select threshold2=1 or"):
        plot.phase_diagram(data, ax=Figure().add_subplot())
    (shown,) = plot.curves(selected(data, [("threshold", 1), ("channel2_width", 0.1)]),
                           ax=Figure().add_subplot(), variable="chi")  # fmt: skip
    part = data.sel(channel2_width=0.1, threshold=1)
    assert np.array_equal(shown.lines[0].get_data(), [part["threshold2"], part["chi"].values[:, 0]])
    for at, (one, other) in enumerate(pairs):
        found = selected(data, [("threshold2", other), ("threshold", one)])
        assert found.identical(data.isel(threshold=at))
        point = by_point(found.sel(channel2_width=0.1))
        assert ("$T_2 = " in circuits.title(point, 0)) is (other != one)
        assert ("$T_2 = " in circuits.common(point)) is (other != one)
    assert exactly(data["channel2_width"].values[0]) == "0.02"
    assert float(exactly(4.0 / 3.0)) == 4.0 / 3.0  # as messages name it
    assert exactly(1234567) == "1234567"
    with pytest.raises(InputError, match="no point has these values together: threshold, thresh"):
        selected(data.isel(threshold=[0, 1, 2]), [("threshold", 3), ("threshold2", 9)])
    part = data.isel(threshold=[0, 1, 2])  # of which T = 3 is one
    found = selected(part, [("threshold", 3), ("threshold2", 1)])
    assert found.identical(data.isel(threshold=2))
    both = selected(data, [("channel2_width", 0.1), ("threshold", 3), ("channel2_width", 0.02)])
    assert both.identical(data.sel(threshold=3))
    points = by_point(data)
    scan = columns_of.scanned(points)
    columns = columns_of.points_of(points, scan, {})
    cells = {*zip(columns["left"], columns["bottom"], columns["threshold2"], strict=True)}
    assert len(cells) == data["task"].size
    assert "threshold2" in scan.others
    words = ["curves", str(path), "--output", str(tmp_path), "--select", "threshold2 = 8"]
    assert call("plot", words) == 2
    assert "no point has threshold2 = 8; there are 1, 9" in capsys.readouterr().err


def test_single_runs_that_where_chose_are_no_means(folder: Path) -> None:
    data = postproc.open_results(folder / "map.h5").isel(replica=0)
    found = postproc.table(data.where(data["threshold"] > 2, drop=True))
    assert np.array_equal(found["chi"], data["chi"].values[1:].ravel())


def test_points_without_a_finite_voltage_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = results_of(
        tmp_path / "full.h5", particles={"number": 60, "urn1_fraction": 1.0}, output=BARE,
        gate={"threshold": 0}, run=SHORT,
        scan={"threshold": None, "channel2_width": [1e-7, 0.1], "replicas": 1},
    )  # fmt: skip
    assert call("plot", ["characteristic", str(path), "--output", str(tmp_path)]) == 0
    assert "U is infinite (chi = 1), not shown: 1 of 2 points" in capsys.readouterr().err


def test_a_map_is_of_two_keys_and_has_the_lines_that_are_asked_for(
    folder: Path, tmp_path: Path
) -> None:
    data = postproc.open_results(folder / "map.h5")
    scan = {"number": [200, 400], "threshold": None, "replicas": 1}
    at_fixed = {"scan": scan, "gate": {"threshold_fraction": 0.01}, "particles": {"number": None}}
    by_number = postproc.open_results(
        results_of(tmp_path / "sizes.h5", run=SHORT, output=BARE, **at_fixed)
    )
    for one, said in (
        (data.sel(channel2_width=0.01), "threshold alone was scanned"),
        (data.sel(channel2_width=0.01, threshold=2), "here is one point"),
        (by_number, "number alone was scanned"),
        (postproc.merge([folder / "seed1.h5", tmp_path / "sizes.h5"]).isel(point=[0, 3]),
         "threshold and number change together"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=f"{said}: figure 'curves' shows it"):
            plot.phase_diagram(one, ax=Figure().add_subplot())
    pairs = {"threshold": [1, 2], "threshold2": [2, 1], "replicas": 1}
    path = results_of(tmp_path / "pairs.h5", scan=pairs, output=BARE, **SMALL)
    with pytest.raises(InputError, match="threshold and threshold2 change together: battery-p"):
        plot.phase_diagram(postproc.open_results(path), ax=Figure().add_subplot())
    starts = {"threshold": 2, "urn1_fraction": [0.5, 0.7, 1.0], "replicas": 1}
    path = results_of(tmp_path / "starts.h5", scan=starts, output=BARE, **SMALL)
    said = "other than the start, urn1_fraction alone was scanned: figure 'relaxation' shows it"
    with pytest.raises(InputError, match=said):
        plot.phase_diagram(postproc.open_results(path), ax=Figure().add_subplot())
    scan |= {"threshold_fraction": [0.01, 0.02]}
    other = postproc.open_results(
        results_of(tmp_path / "fractions.h5", run=SHORT, output=BARE, scan=scan,
                   particles={"number": None})
    )  # fmt: skip
    assert plot.phase_diagram(other, ax=Figure().add_subplot()).get_array().count() == 4
    with pytest.raises(InputError, match="theories have lines over threshold and channel2_width"):
        plot.phase_diagram(other, ax=Figure().add_subplot(), theory="window")


def test_a_negative_current_has_a_colour_of_its_own(tmp_path: Path) -> None:
    """From the fuller urn, which is the larger and thinner one, more return than come."""
    path = results_of(
        tmp_path / "negative.h5", table={"urn_radius": [3.0, 1.0]}, output=BARE,
        particles={"number": 200, "urn1_number": 180}, gate={"threshold": [200, 2]},
        scan={"threshold": None, "channel1_width": [0.2, 0.4], "channel2_width": [0.2, 0.4]},
    )  # fmt: skip
    data = postproc.open_results(path)
    current = data["polarised_current"].mean("replica")
    assert float(current.max()) < 0.0
    for more in (0.0, -current.min(), -current.mean()):  # all below 0, all above, both
        given = data.assign(polarised_current=data["polarised_current"] + more)
        points, shown = by_point(given), (current + more).values
        ends = pytest.approx((min(0.0, shown.min()), max(0.0, shown.max())), rel=1e-3, abs=1e-9)
        alone = plot.phase_diagram(given, Figure().add_subplot(), variable="polarised_current")
        beside_chi = maps.figure_phase_diagram(points).axes[1].collections[0]
        assert (alone.get_clim(), beside_chi.get_clim()) == (ends, ends)
        scan = columns_of.scanned(points)
        drawn = Page(points, scan, {}, columns_of.points_of(points, scan, {})).panels()[1]
        mapper = drawn.select_one(LinearColorMapper)
        assert (mapper.low, mapper.high) == ends


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Give the pictures that commands make, none of which is written."""
    kept: list[Figure] = []
    monkeypatch.setattr("postproc.figures.style.save", lambda one, *_: kept.append(one))
    return kept


def shown(figure: Figure) -> list[list[float]]:
    """Return what lines and maps of a figure show."""
    values = [line.get_xydata() for axes in figure.axes for line in axes.lines]
    values += [one.get_array().filled(math.nan) for axes in figure.axes for one in axes.collections
               if isinstance(one, QuadMesh)]  # fmt: skip
    return [np.nan_to_num(np.ravel(one), nan=-1.0).tolist() for one in values]


@pytest.mark.parametrize(
    ("name", "words", "part"),
    [
        ("flows", "--replica=1 --select channel2_width=0.01", {"channel2_width": [0]}),
        ("flows", "--point=3", {"threshold": [1], "channel2_width": [1]}),
        ("relaxation", "--replica=1 --select channel2_width=0.01", {"channel2_width": [0]}),
        ("relaxation", "--point=3", {"threshold": [1], "channel2_width": [1]}),
        ("curves", "--replica=1", {}),
        ("curves", "--point=3", {"threshold": [1], "channel2_width": [1]}),
        ("characteristic", "--point=3", {"threshold": [1], "channel2_width": [1]}),
        ("phase_diagram", "--replica=1", {}),
        ("lifetimes", "--point=3", {"threshold": [1], "channel2_width": [1]}),
        ("lifetimes", "--replica=1", {}),
    ],
)
def test_a_chosen_point_or_replica_is_all_that_a_figure_shows(
    folder: Path, made: list[Figure], name: str, words: str, part: dict[str, list[int]]
) -> None:
    path = folder / "map.h5"
    assert call("plot", [name, str(path), *words.split(), "--theory", "window"]) == 0
    places = {**part, **({"replica": [1]} if "--replica" in words else {})}
    points = by_point(postproc.open_results(path).isel(places))
    alone = commands.FIGURES[name](points, [MODELS["window"]])
    assert shown(made[0]) == shown(alone)
    if name == "flows":
        titles = [axes.get_title("left") for axes in made[0].axes]
        assert sum(map(bool, titles)) == points.sizes["point"]


def test_lifetimes_of_other_widths_and_thresholds_are_told_apart(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the table and the panels of the command."""
    data = postproc.open_results(folder / "map.h5")
    figure = passages.figure_lifetimes(by_point(data), [MODELS["window"]])
    head, *lines = capsys.readouterr().out.splitlines()
    at = head.split().index("w'")
    assert [line.split()[at] for line in lines] == ["0.01", "0.05"] * 3
    assert [axes.get_title("left") for axes in figure.axes] == [
        f"$T = {threshold}$, $\\ell = 1$, $w' = {width}$"
        for threshold in (2, 4, 40) for width in (0.01, 0.05)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("part", "choice"),
    [({"threshold": 2}, "channel2_width=0.01"), ({"channel2_width": 0.01}, "threshold=2")],
)
def test_lifetimes_in_axes_of_ones_own_are_of_one_width_and_threshold(
    folder: Path, part: dict[str, float], choice: str
) -> None:
    data = postproc.open_results(folder / "map.h5").sel(part)
    with pytest.raises(InputError, match=rf"data.sel\({choice}\)"):
        plot.lifetimes(data, ax=Figure().add_subplot(), theory="window")


@pytest.mark.parametrize(
    ("scan", "said"),
    [({"urn1_fraction": [0.5, 0.75]}, r"chi = 0\.5 are in neither state: choose"),
     ({"threshold": list(range(1, 8))}, "at most 6 panels, of one T, l and w' each, here are 7")],
)  # fmt: skip
def test_lifetimes_that_have_no_place_are_refused(
    tmp_path: Path, scan: dict[str, object], said: str
) -> None:
    data = postproc.open_results(results_of(tmp_path / "run.h5", scan=scan, **SMALL))
    with pytest.raises(InputError, match=said):
        passages.figure_lifetimes(by_point(data))


def test_runs_from_two_starts_have_two_labels(tmp_path: Path) -> None:
    scan = {"urn1_fraction": [0.5, 1.0], "threshold": 2, "replicas": 1}
    path = results_of(tmp_path / "starts.h5", scan=scan, **SMALL)
    labels = [r"$\chi(0) = 0$", r"$\chi(0) = 1$"]
    lines = plot.relaxation(postproc.open_results(path), ax=Figure().add_subplot())
    assert [line.get_label() for line in lines] == labels
    assert [circuits.title(points_of(path), at) for at in (0, 1)] == labels


@pytest.mark.parametrize("name", ["curves", "phase_diagram"])
def test_points_in_two_states_are_said_to_be_left_out(
    folder: Path, tmp_path: Path, made: list[Figure], name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = in_two_states(folder, tmp_path)
    assert call("plot", [name, str(path), "--theory", "window"]) == 0
    said = "in two states, not shown: 1 of 6 points"
    assert capsys.readouterr().err == f"{path}: {said}\n"
    assert said in [text.get_text() for text in made[0].findobj(Text)]


def test_replicas_in_two_states_relax_each_on_its_own(folder: Path, tmp_path: Path) -> None:
    """Their mean is no state; a point in one state has its mean and the band about it."""
    data = postproc.open_results(in_two_states(folder, tmp_path)).sel(threshold=4)
    axes = Figure().add_subplot()
    two, one = plot.relaxation(data, ax=axes, variable="chi")
    plot.curves(data.isel(replica=0), variable="chi", ax=Figure().add_subplot())  # one is in one
    assert "replicas in two states" in two.get_label()
    assert "replicas" not in one.get_label()
    drawn = [line for line in axes.lines if line.get_color() == two.get_color()]
    last = np.abs(1.0 - 2.0 * data.series["urn1_number"][0, :, -1] / 200.0)
    assert [line.get_ydata()[-1] for line in drawn] == pytest.approx(last.values, abs=0.1)
    assert len(axes.collections) == 1


def in_two_states(folder: Path, into: Path) -> Path:
    """Return a copy of the map whose third point is in two states."""
    path = Path(shutil.copy(folder / "map.h5", into / "two.h5"))
    with edited(path) as file:
        file["point_status"] = np.array([0, 0, 2, 0, 0, 0], dtype="i4")
        file["point_status"].dims[0].attach_scale(file["point"])
    return path


@pytest.mark.parametrize(
    ("chi", "two"),
    [
        ([0.963, 0.962, 0.960, 0.014], True),
        ([0.92, 0.03, 0.91, 0.05, 0.93, 0.90], True),
        ([0.963, 0.014, math.nan, math.nan], False),  # of two nothing is known
        ([0.40, 0.40, 0.10, 0.40, 0.40, 0.40], True),  # their spread is 0.3, rounded
        ([0.750, 0.751, 0.760, 0.761], False),  # of one kind
        ([0.40, 0.55, 0.62, 0.85], False),  # one state that scatters, or decays
        ([0.30, 0.45, 0.50, 0.80, 0.84, 0.90], False),
    ],
)
def test_chi_tells_two_states_where_the_program_was_not_asked(
    tmp_path: Path, chi: list[float], two: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Table, figures and report have no mean of both, also where two files are merged."""
    size = len(chi) // 2
    files, scan = [tmp_path / "one.h5", tmp_path / "other.h5"], {"threshold": [2, 4]}
    for seed, path in enumerate(files):
        particles = {"number": 200, "seed": seed + 1}
        results_of(path, scan=scan | {"replicas": size}, run=SHORT, particles=particles)
        with edited(path) as file:
            file["chi"][0] = chi[seed * size : (seed + 1) * size]
    found = postproc.table(files)["chi"]
    assert np.isnan(found).tolist() == [two, False]
    words = [*map(str, files), "--theory", "window", "--output", str(tmp_path)]
    assert call("plot", ["curves", *words]) == call("report", words) == 0
    assert ("in two states, not shown: 1 of 2 points" in capsys.readouterr().err) is two
    assert ("the replicas fall into two" in (tmp_path / "one.html").read_text()) is two
    lines = plot.relaxation(postproc.merge(files), ax=Figure().add_subplot())
    assert ["two states" in line.get_label() for line in lines] == [two, False]


def test_more_series_than_colours_look_different(tmp_path: Path) -> None:
    scan = {"threshold": [1, 2], "number": [10 * (one + 1) for one in range(14)], "replicas": 1}
    path = results_of(tmp_path / "many.h5", scan=scan, run=SHORT, particles={"number": None})
    lines = [one.lines[0] for one in plot.curves(postproc.open_results(path), variable="chi",
             ax=Figure().add_subplot())]  # fmt: skip
    assert len({(one.get_color(), one.get_marker()) for one in lines}) == len(lines) == 14
    with pytest.raises(InputError, match="at most 28 entries in its legend, here are 30"):
        style.legend_above(Figure(), [lines[0]] * 30, ["one"] * 30, 4)
    scan = {"threshold": [1, 2], "channel2_width": [0.01, 0.010000001], "replicas": 1}
    path = results_of(tmp_path / "fine.h5", scan=scan, run=SHORT)
    drawn = plot.curves(postproc.open_results(path), variable="chi", ax=Figure().add_subplot())
    assert [one.get_label() for one in drawn] == ["$w' = 0.01$", "$w' = 0.010000001$"]


def test_a_norm_of_the_user_has_bounds_of_its_own(folder: Path) -> None:
    for variable in plot.maps.LOOKS:
        norm = mpl.colors.LogNorm(1e-6, 1e3)
        mesh = plot.phase_diagram(postproc.open_results(folder / "map.h5"), variable=variable,
                                  norm=norm, ax=Figure().add_subplot())  # fmt: skip
        assert mesh.norm is norm


def test_states_of_unequal_urns_have_a_sign(tmp_path: Path) -> None:
    """Chi of 0.7 in urn 1 and of 0.64 in urn 2 are two states; of equal urns it is one."""
    means = []
    for radius in ([1.0, 0.7], [1.0, 1.0]):
        path = results_of(tmp_path / f"{radius[1]}.h5", table={"urn_radius": radius}, run=SHORT,
                          scan={"threshold": 4, "replicas": 4})  # fmt: skip
        with edited(path) as file:
            file["chi"][0], file["polarised_current"][0] = [0.70, 0.64, 0.71, 0.63], 1.1
            file["current2"][0] = [1.1, -1.1, 1.1, -1.1]
        means.append(postproc.table(path)["chi"][0])
    np.testing.assert_allclose(means, [math.nan, 0.67])


def test_a_line_of_theory_is_broken_where_chi_jumps(tmp_path: Path) -> None:
    scan = {"channel2_width": [0.01, 0.05], "threshold": 2, "replicas": 1}
    path = results_of(tmp_path / "jump.h5", scan=scan, run={"duration": 20.0}, output=BARE,
                      particles={"urn1_number": 1000})  # fmt: skip
    axes = Figure().add_subplot()
    plot.curves(postproc.open_results(path), ax=axes, variable="chi", theory="window")
    (line,) = (one for one in axes.lines if one.get_linestyle() == "--" and len(one.get_xdata()))
    width, chi = line.get_data()
    (gap,) = np.flatnonzero(np.isnan(chi))
    assert chi[gap - 1] > 0.8
    assert chi[gap + 1] == 0.0
    assert np.all(np.diff(width) > 0.0)
    assert np.nanmax(np.abs(np.diff(chi))) < circuits.JUMP


def test_between_the_points_of_a_width_a_theory_is_computed(folder: Path) -> None:
    data = postproc.open_results(folder / "map.h5", theory="window").sel(threshold=2)
    axes = Figure().add_subplot()
    (measured,) = plot.curves(data, ax=axes, variable="chi", theory="window")
    (line,) = (one for one in axes.lines if one.get_linestyle() == "--" and len(one.get_xdata()))
    widths, chi = line.get_data()
    assert len(widths) > 50
    at = np.searchsorted(widths, data.channel2_width)
    assert chi[at] == pytest.approx(data.theory_chi.values)
    handles, labels = axes.get_legend_handles_labels()
    assert labels == ["measured", "theory, window (the paper's)"]
    assert handles[1].lines[0].get_color() == line.get_color() == measured.lines[0].get_color()


def test_numbers_of_particles_have_their_ticks_and_theories_marks(tmp_path: Path) -> None:
    scan = {"number": [200, 210, 400], "threshold": None, "replicas": 1}
    path = results_of(tmp_path / "sizes.h5", run=SHORT, output=BARE, scan=scan,
                      particles={"number": None}, gate={"threshold_fraction": 0.01})  # fmt: skip
    data, axes = postproc.open_results(path, theory="window"), Figure().add_subplot()
    plot.curves(data, ax=axes, theory="window")
    assert axes.get_xticks().tolist() == [200, 400]  # two labels would touch
    marks = next(line for line in axes.lines if line.get_marker() == circuits.THEORY_MARKS[0])
    assert marks.get_linestyle() == "None"
    assert marks.get_ydata() == pytest.approx(data.theory_polarised_current.values)


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda one: plot.curves(one, against="channel2_width"), "no variable 'channel2_width' of"),
        (lambda one: plot.curves(one, variable="threshold"), "no variable 'threshold' of runs"),
        (lambda one: plot.scene(one, snapshot=1.5), "has 3 snapshots, 1.5 is none of them"),
        (lambda one: plot.scene(one, replica="a"), "replica a is not one of 0 to 1"),
        (lambda one: plot.flows(one, replica=0.5), "replica 0.5 is not one of 0 to 1"),
        (lambda one: postproc.mean_error(one["chi"].values), "replica, not ndarray"),
        (lambda _: postproc.merge(3), "file = 3: must be a path"),
        (
            lambda one: postproc.merge([one.where(one["chi"] > 2.0)]),
            "is not known at every point",
        ),
        (lambda one: postproc.table(one.isel(replica=[])), "data: is empty along replica"),
        (lambda one: postproc.table(one.drop_vars("threshold")), "threshold is not known at every"),
        (lambda one: postproc.merge([one.drop_vars("number")]), "data: must be a dataset that"),
        (lambda one: postproc.merge([one.drop_vars("threshold")]), "threshold is not known at"),
        (lambda one: postproc.table(xr.concat([one, one], "run")), "data: run is no key of a scan"),
        (lambda one: postproc.table(one.mean("replica")), "has no replicas any more"),
        (lambda one: one.isel(replica=[]).series, "of points of it that sel or isel choose"),
        (lambda one: plot.curves(one, variable=["chi"]), "no variable .'chi'. of runs"),
        (lambda one: plot.relaxation(one, variable=["chi"]), "there is no .'chi'."),
        (
            lambda one: plot.curves(one, variable="chi", against="current1", theory="window"),
            "theories are drawn of chi and polarised_current, not of chi against current1",
        ),
        (lambda one: postproc.mean_error(one["chi"].isel(replica=[])), "there is no replica"),
        (lambda one: plot.curves(one.where(one["chi"] > 2.0)), "is not known at every point"),
    ],
)
def test_a_wrong_argument_is_one_line(
    folder: Path, ask: Callable[[xr.Dataset], object], said: str
) -> None:
    data = postproc.open_results(folder / "map.h5").sel(threshold=2, channel2_width=0.01)
    with pytest.raises(InputError, match=said):
        ask(data)


@pytest.mark.parametrize(("high", "named"), [(0.1, 1), (0.05, 0)])
def test_a_tricritical_point_is_named_where_it_is_in_the_frame(high: float, named: int) -> None:
    axes = Figure().add_subplot()
    axes.set(xlim=(0.0, 0.02), ylim=(0.0, high))
    maps.draw_lines(axes, [], np.array([[0.0071, 0.0084], [0.083, 0.155]]))
    assert len(axes.get_legend_handles_labels()[1]) == len(axes.collections) == named


FIGURES = ["flows", "scene", "lifetimes", "phase_diagram", "curves", "relaxation", "characteristic",
           "circuit"]  # fmt: skip


def test_without_a_complete_task_every_figure_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = results_of(tmp_path / "none.h5", scan={"threshold": [2, 4], "replicas": 1}, **SMALL)
    leave_out(path, (0, 0), (1, 0))
    data, said = postproc.open_results(path), "none.h5: no task is complete yet"
    for name in plot.__all__:
        with pytest.raises(InputError, match=said):
            getattr(plot, name)(data, ax=Figure().add_subplot())
    for name in FIGURES:
        assert call("plot", [name, str(path), "--output", str(tmp_path)]) == 2, name
        assert said in capsys.readouterr().err
    assert call("report", [str(path), "--output", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("*.p*"))


def test_the_legend_of_a_scene_leaves_its_table_free(folder: Path) -> None:
    data = postproc.open_results(folder / "map.h5").sel(channel2_width=0.01, threshold=2)
    axes = Figure(figsize=(5.0, 3.0)).add_subplot()
    drawn = plot.scene(data, ax=axes)
    axes.figure.draw_without_rendering()
    box = axes.get_legend().get_window_extent()
    assert box.y1 <= axes.get_window_extent().y0
    assert axes.figure.bbox.x0 <= box.x0 <= box.x1 <= axes.figure.bbox.x1
    free, counted = (drawn[at].get_sizes()[0] for at in (0, -1))
    assert counted >= 9 * free
    other = Figure().add_subplot()
    plot.scene(data, ax=other, legend=False)
    assert other.get_legend() is None


def test_figures_are_seen_on_a_dark_page(folder: Path) -> None:
    data = postproc.open_results(folder / "map.h5")
    one = data.sel(channel2_width=0.01, threshold=2)
    with mpl.style.context(["dark_background", {"text.color": (0.9, 0.9, 0.9)}]):
        page = Figure()
        eta, scene, flows, relaxation = page.subplots(4)
        postproc.Circuit(number=1000, threshold=7).plot_eta(ax=eta)
        plot.scene(one, ax=scene)
        plot.flows(one, ax=flows, theory="window")
        plot.relaxation(data.sel(channel2_width=0.01), ax=relaxation)
        for axes in page.axes:
            colours = [to_rgb(line.get_color()) for line in axes.lines]
            assert len(colours) > 2
            assert to_rgb(page.get_facecolor()) not in colours
        edges = [to_rgb(one) for dots in scene.collections for one in dots.get_edgecolors()]
        assert edges
        assert to_rgb(page.get_facecolor()) not in edges
        assert to_rgb(page.get_facecolor()) in [to_rgb(one.get_mfc()) for one in eta.lines]


@pytest.mark.parametrize(
    ("name", "value", "shown"),
    [
        ("number", 16384.0, "$N = 16384$"),
        ("threshold_fraction", 0.01234567, "$T/N = 0.0123457$"),
        ("channel2_width", 1.25e-5, "$w' = 1.25 \\times 10^{-5}$"),
        ("seed", 10001.0, "seed = 10001"),
    ],
)
def test_numbers_in_titles_are_those_of_the_run(name: str, value: float, shown: str) -> None:
    assert maps.equals(name, value) == shown


def test_eta_has_a_unit_and_its_help_no_label_of_a_manuscript() -> None:
    axes = Figure().add_subplot()
    circuit = postproc.Circuit(number=1000, threshold=7)
    circuit.plot_eta(ax=axes)
    assert axes.get_ylabel() == "$\\eta$ (per unit time)"
    for public in (postproc.Circuit, type(circuit.states()[0])):
        assert "eq. (" not in pydoc.render_doc(public)


def test_help_describes_every_argument() -> None:
    for name in plot.__all__:
        draw = getattr(plot, name)
        told = inspect.getdoc(draw)
        assert "above" not in told
        assert all(f"\n{one}\n" in told for one in inspect.signature(draw).parameters), name


def test_voltage_of_a_battery_whose_full_urn_returns_all_is_that_of_the_widths() -> None:
    """U = ln(1 + w/w') where one gate lets all through (q = 1) and the other none (q = 0)."""
    for width in (0.005, 0.01, 0.02):
        state = postproc.Circuit(number=1000, threshold=7, channel2_width=width).states()[-1]
        voltage, _ = circuits.voltage_of(np.array([state.mass_spread]), 0.0)
        assert voltage == pytest.approx(math.log(1.0 + 0.3 / width), rel=2e-3)


def test_the_characteristic_has_measured_voltage_and_power(folder: Path) -> None:
    data, axes = postproc.open_results(folder / "map.h5").sel(threshold=2), Figure().add_subplot()
    voltage, power = plot.characteristic(data, ax=axes)
    chi, current = (postproc.mean_error(data[name])["mean"].values
                    for name in ("chi", "polarised_current"))  # fmt: skip
    expected = np.log((1.0 + chi) / (1.0 - chi))
    assert np.array(voltage.get_data()) == pytest.approx(np.array([current, expected]))
    assert np.array(power.get_data()) == pytest.approx(np.array([current, current * expected]))


def test_an_open_circuit_is_where_no_current_flows(tmp_path: Path) -> None:
    path = results_of(tmp_path / "open.h5", run=SHORT, output=BARE, particles={"number": 20},
                      scan={"channel2_width": [0.0, 0.1]})  # fmt: skip
    voltage, power = plot.characteristic(postproc.open_results(path), ax=Figure().add_subplot())
    assert (voltage.get_xdata()[0], power.get_ydata()[0]) == (0.0, 0.0)
    assert voltage.get_ydata()[0] > 0.0


def test_replicas_that_differ_by_rounding_have_no_scatter() -> None:
    equal, other = [0.1, np.nextafter(0.1, 1.0), 0.1], [0.1, 0.1 + 1e-9, 0.1]
    found = postproc.mean_error(xr.DataArray([equal, other], dims=("point", "replica")))
    assert found["error"].values.tolist() == [0.0, pytest.approx(1e-9 / 3.0)]


def test_merged_replicas_are_side_by_side_and_errors_made_anew(folder: Path) -> None:
    paths = [folder / "seed1.h5", folder / "seed2.h5"]
    merged, parts = postproc.merge(paths), [postproc.open_results(path) for path in paths]
    assert merged["chi"].dims == ("threshold", "replica")
    both = np.concatenate([part["chi"].values for part in parts], axis=1)
    assert np.sort(merged["chi"].values) == pytest.approx(np.sort(both))
    error = both.std(axis=1, ddof=1) / 2.0
    assert merged["chi_spread"].values == pytest.approx(error)
    assert postproc.table(paths)["chi_error"].values == pytest.approx(error)
    assert merged.attrs["tasks"] == "8 of 8 tasks are complete"
    assert postproc.merge([*paths, paths[0]]).sizes["replica"] == 4  # the same runs once
    twice = postproc.merge([*paths, folder / "map.h5"])
    assert twice["chi"].dims == ("point", "replica")  # not all combinations are there
    assert len(postproc.table(twice)) == 2 + 6
    assert set(selected(twice, [("threshold", 2.0)])["threshold"].values) == {2}


def test_merged_scans_over_fractions_keep_their_grid(tmp_path: Path) -> None:
    """T and N1 of a fraction change with N, so they are no grid."""
    scan = {"number": [10, 20], "threshold_fraction": [0.1, 0.2], "urn1_fraction": [0.5, 0.7],
            "threshold": None, "replicas": 2}  # fmt: skip
    parts = [postproc.open_results(results_of(
        tmp_path / f"{seed}.h5", scan=scan, particles={"number": None, "seed": seed},
        run=SHORT, output=BARE)) for seed in (1, 2)]  # fmt: skip
    merged = postproc.merge(parts)
    assert set(merged.chi.dims) == set(parts[0].chi.dims)
    for key in ("number", "threshold_fraction", "urn1_fraction"):
        assert merged[key].values.tolist() == scan[key]
    at = {"number": 20, "threshold_fraction": 0.2, "urn1_fraction": 0.7}
    apart = [one.chi.sel(at).values.tolist() for one in parts]
    assert merged.chi.sel(at).values.tolist() == [*apart[0], *apart[1]]
    assert int(merged.threshold.sel(number=20, threshold_fraction=0.2)) == 4


@pytest.mark.parametrize("other", [{"threshold": [5, 6]}, {}], ids=["thresholds", "one"])
def test_a_scan_over_fractions_merges_with_any_other(
    tmp_path: Path, other: dict[str, list[int]]
) -> None:
    """No run is lost, in whatever order the files are given."""

    def made(name: str, scan: dict[str, object], threshold: int | None) -> Path:
        return results_of(tmp_path / name, run=SHORT, output=BARE, particles={"number": 10},
                          gate={"threshold": threshold},
                          scan={"threshold": None, **scan})  # fmt: skip

    files = [made("f.h5", {"threshold_fraction": [0.1, 0.2]}, None),
             made("o.h5", other, None if other else 5)]  # fmt: skip
    count = sum(postproc.open_results(one)["task"].size for one in files)
    for order in (files, files[::-1]):
        merged = postproc.merge(order)
        assert merged.attrs["tasks"] == f"{count} of {count} tasks are complete"
        assert int(merged.chi.notnull().sum()) == count


def test_merged_points_of_a_precision_have_one_state_and_one_error(tmp_path: Path) -> None:
    """Of one file those of the file; of two the scatter of all replicas, and two states stay."""
    paths = [results_of(tmp_path / f"{seed}.h5", scan={"threshold": [1, 3, 5], "replicas": 16},
                        particles={"number": 50, "seed": seed}, run={"duration": 50.0},
                        precision={"chi_replica_error": 0.02, "largest_replicas": 20}, output=BARE)
             for seed in (1, 2)]  # fmt: skip
    for path, states in zip(paths, ([2, 1, 0], [0, 1, 1]), strict=True):
        with edited(path) as file:
            file["point_status"][:] = states
            file["chi_replica_error"][0] = np.nan if states[0] == 2 else 1.0
    one, alone, both = (postproc.open_results(paths[0]), postproc.merge(paths[:1]),
                        postproc.merge(paths))  # fmt: skip
    for name in ("point_status", "chi_replica_error", "chi_spread"):
        assert alone[name].dims == ("threshold",)
        assert alone[name].values == pytest.approx(one[name].values, nan_ok=True)
        assert both[name].attrs["long_name"] == one[name].attrs["long_name"]
    assert both["point_status"].values.tolist() == [2, 1, 3]
    spread = postproc.mean_error(both["chi"])["error"].values
    assert both["chi_replica_error"].values == pytest.approx([np.nan, *spread[1:]], nan_ok=True)
    shown = postproc.table(both)
    assert shown["replicas"].tolist() == both["chi"].count("replica").values.tolist()
    assert shown["chi_error"].values == pytest.approx(both["chi_replica_error"], nan_ok=True)


def test_what_is_complete_in_one_of_merged_files_is_in_the_results(tmp_path: Path) -> None:
    """Whatever their order, as the file of a part of a run and that of the whole."""
    whole = results_of(tmp_path / "whole.h5", scan={"threshold": [2, 4]}, output=BARE, **SMALL)
    part = Path(shutil.copy(whole, tmp_path / "part.h5"))
    with edited(part) as file:
        file["task_status"][:] = [[0, 2], [1, 0]]
    chi = postproc.open_results(whole)["chi"]
    for paths in ([whole, part], [part, whole]):
        merged = postproc.merge(paths)
        assert merged.attrs["tasks"] == "4 of 4 tasks are complete"
        assert np.array_equal(merged["chi"].values, chi.values)


def test_whole_numbers_of_merged_results_are_those_of_the_files(tmp_path: Path) -> None:
    """Seeds to the last digit, where points have unequal numbers of replicas."""
    paths = [results_of(tmp_path / f"{count}.h5", scan={"threshold": count, "replicas": count},
                        output=BARE, **SMALL) for count in (1, 2)]  # fmt: skip
    seeds = [postproc.open_results(path)["seed"].values.ravel().tolist() for path in paths]
    merged = postproc.merge(paths)
    found = merged["seed"].values[merged["task"] >= 0]
    assert found.tolist() == [*seeds[0], *seeds[1]]
    assert merged["seed"].attrs
    assert {merged[name].dtype.kind for name in ("number", "urn1_number", "threshold")} == {"i"}


@pytest.mark.parametrize(
    ("fraction", "numbers"),
    [(0.5, [1, 2, 3, 25, 100]), (0.9, [1, 2, 3, 25, 100]), (0.7, [155, 204, 355, 1000])],
)
def test_a_start_that_is_rounded_to_whole_numbers_is_one_at_each_number(
    tmp_path: Path, fraction: float, numbers: list[int]
) -> None:
    """As half of an odd N; two starts of one N are two."""
    path = results_of(tmp_path / "n.h5", scan={"number": numbers}, output=BARE,
                      particles={"number": None, "urn1_fraction": fraction}, run=SHORT)  # fmt: skip
    data = postproc.open_results(path)
    assert points_of(path)["start"].values == pytest.approx([2.0 * fraction - 1.0] * len(numbers))
    for draw in (plot.curves, plot.characteristic):
        assert len(draw(data, ax=Figure().add_subplot())) > 0
    path = results_of(tmp_path / "two.h5", scan={"urn1_fraction": [0.5, 0.501]}, output=BARE,
                      run=SHORT)  # fmt: skip
    assert points_of(path)["start"].values == pytest.approx([0.0, 0.002])


def test_what_differs_in_merged_runs_is_said(folder: Path, tmp_path: Path) -> None:
    longer = results_of(tmp_path / "longer.h5", scan={"threshold": 2, "replicas": 1}, output=BARE,
                        particles={"number": 200, "seed": 3}, run={"duration": 200.0})  # fmt: skip
    unlike = "&run duration: 100.0, 200.0"
    with pytest.warns(UserWarning, match=f"the runs differ in {unlike}"):
        assert unlike in postproc.merge([folder / "seed1.h5", longer]).attrs["differs"]
    urn = results_of(tmp_path / "urn.h5", table={"shape": "urn"}, run=SHORT, output=BARE)
    with pytest.raises(InputError, match="shape differs: circuit, urn"):
        postproc.merge([folder / "seed1.h5", urn])


@pytest.mark.parametrize("is_kept", [False, True])
def test_series_come_with_a_part_of_the_dataset(
    folder: Path, tmp_path: Path, *, is_kept: bool
) -> None:
    """Also with one that was kept as netCDF, which knows no list of one text."""
    data = postproc.open_results(folder / "map.h5").sel(threshold=4)
    if is_kept:
        data.to_netcdf(tmp_path / "kept.nc", engine="h5netcdf")
        data = xr.open_dataset(tmp_path / "kept.nc", engine="h5netcdf")
        assert postproc.merge([data]).attrs["files"] == [str(folder / "map.h5")]
    series = data.series
    assert series["urn1_number"].dims == ("channel2_width", "replica", "time")
    one = postproc.residences(data.isel(replica=1).series)
    stays = postproc.residences(series)
    assert one["duration"].tolist() == stays[stays["replica"] == 1]["duration"].tolist()
    assert set(postproc.residences(data.isel(replica=[1]).series)["replica"]) == {1}
    assert stays.groupby(["channel2_width", "replica"]).ngroups == 4
    ends = stays.groupby(["channel2_width", "replica"]).agg({"start": "min", "duration": "sum"})
    assert (ends["start"] + ends["duration"]).unique().tolist() == [100.0]


def test_stays_of_runs_from_several_starts_are_told_apart(tmp_path: Path) -> None:
    scan = {"urn1_fraction": [0.0, 0.5], "replicas": 2}
    path = results_of(tmp_path / "run.h5", scan=scan, run={"duration": 30.0})
    stays = postproc.residences(postproc.open_results(path).series)
    assert stays.groupby(["urn1_fraction", "replica"])["duration"].sum().tolist() == [30.0] * 4


def test_merged_runs_from_several_starts_are_told_apart(tmp_path: Path) -> None:
    starts = [{"number": 200, "urn1_number": one} for one in (100, 200)]
    paths = [results_of(tmp_path / f"{at}.h5", run={"duration": 30.0}, particles=one)
             for at, one in enumerate(starts)]  # fmt: skip
    stays = postproc.residences(postproc.merge(paths).series)
    assert stays.groupby(["urn1_fraction", "replica"])["duration"].sum().tolist() == [30.0] * 4
    paths += [results_of(tmp_path / "2.h5", run={"duration": 30.0}, particles={"number": 100},
                         scan={"urn1_fraction": [0.5, 1.0], "replicas": 1})]  # fmt: skip
    merged = postproc.merge(paths)  # no grid
    assert set(postproc.residences(merged.series)["urn1_fraction"]) == {0.5, 1.0}
    assert len(plot.relaxation(merged.isel(point=[0]))) == 1


def test_starts_in_either_of_unequal_urns_are_two(tmp_path: Path) -> None:
    path = results_of(
        tmp_path / "run.h5", particles={"number": 100}, run={"duration": 30.0}, output=BARE,
        scan={"urn_radius": [1.0], "urn_radius2": [0.7], "urn1_fraction": [0.0, 1.0],
              "channel2_width": [0.01, 0.05]},
    )  # fmt: skip
    with pytest.raises(InputError, match="no place for urn1_number"):
        plot.curves(postproc.open_results(path))
    one = results_of(
        tmp_path / "one.h5", particles={"number": 60, "urn1_number": 12}, run={"duration": 30.0},
        scan={"threshold": [3, 3, 3], "threshold2": [2, 3, 4]}, output=BARE,
    )  # fmt: skip
    assert points_of(one)["start"].values.tolist() == [-0.6] * 3  # also where gates are equal


def test_a_map_has_its_columns_at_the_thresholds_that_were_run(tmp_path: Path) -> None:
    path = results_of(
        tmp_path / "run.h5", particles={"number": 100}, run={"duration": 30.0}, output=BARE,
        scan={"threshold": None, "threshold_fraction": [0.006, 0.018, 0.03],
              "channel2_width": [0.01, 0.05]},
    )  # fmt: skip
    points = points_of(path)
    shown = maps.map_of(points, maps.map_axes(points), points["start"].values)
    assert shown.columns.tolist() == [0.01, 0.02, 0.03]


def test_urns_are_alike_at_the_bounds_of_states() -> None:
    """Where |N1 - N2|/N is 0.9 to the last digit."""
    first = xr.DataArray([[95.0, 95.0], [5.0, 5.0]], dims=("replica", "time"))
    data = {"urn1_number": first, "number": 100, "task": ("replica", [0, 1])}
    stays = postproc.residences(xr.Dataset(data, {"time": [1.0, 2.0]}), high=0.9)
    assert stays["state"].tolist() == [1, -1]


def test_merged_results_have_their_series_each_to_its_end(tmp_path: Path) -> None:
    paths = [results_of(tmp_path / f"{one}.h5", scan={"replicas": 1}, run={"duration": one},
                        particles={"number": 200, "seed": one}) for one in (50, 90)]  # fmt: skip
    merged, (short, long) = postproc.merge(paths).series, map(postproc.open_results, paths)
    assert merged["urn1_number"].dims[-2:] == ("replica", "time")
    for at, part in enumerate((short, long)):
        own = part.series["urn1_number"].values.ravel()
        shown = merged["urn1_number"].isel(replica=at).values.ravel()
        assert shown[: own.size].tolist() == own.tolist()
        assert np.isnan(shown[own.size :]).all()
    more = results_of(tmp_path / "more.h5", scan={"replicas": 2, "threshold": 3},
                      run={"duration": 50}, particles={"number": 200})  # fmt: skip
    joined = postproc.merge([paths[0], more])
    (at,) = np.flatnonzero(joined["threshold"] != 3)
    assert joined.isel(threshold=at, replica=1).series["urn1_number"].isnull().all()
    with pytest.raises(InputError, match="replica 1 of point 0 is not complete; complete: 0"):
        plot.flows(joined.isel(threshold=at), ax=Figure().add_subplot(), replica=1)
    both = postproc.merge([postproc.merge(paths[:1]), paths[1]])
    joined = xr.concat([short, long], "replica")
    assert joined.isel(replica=[0]).series["urn1_number"].notnull().any()
    for part in (joined, joined.isel(replica=1)):
        with pytest.raises(InputError, match="of some runs is not that of the file"):
            part.series  # noqa: B018 (it reads)
    with edited(paths[1]) as file:
        file.attrs["created"] = np.bytes_("2000-01-01T00:00:00Z")
    assert both.isel(replica=[0]).series["urn1_number"].notnull().any()
    with pytest.raises(InputError, match=r"90\.h5: has changed since it was opened"):
        both.series  # noqa: B018 (it reads)
    for part in (short[["chi"]], short.mean("replica")):
        with pytest.raises(InputError, match="or of points of it that"):
            part.series  # noqa: B018 (it reads)


def test_of_a_part_only_its_series_are_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In any order, also where all series together do not fit into memory."""
    data = postproc.open_results(folder / "map.h5")
    whole = data.series
    assert np.ravel(whole["task"]).tolist() == list(range(whole["task"].size))
    with h5py.File(folder / "map.h5") as file:
        size = sum(one.nbytes for one in file["series"].values())
    monkeypatch.setattr(results_file, "memory_left", lambda: 0.8 * size)
    with pytest.raises(InputError, match="bytes of memory"):
        postproc.open_results(folder / "map.h5", group="series")
    for places in ({"threshold": [0]}, {"replica": 1}, {"threshold": -1, "replica": [1, 0]},
                   {"threshold": [2, 0], "channel2_width": 1, "replica": 0}):  # fmt: skip
        part = data.isel(places).series
        xr.testing.assert_identical(part, whole.isel(places))


def test_one_thing_has_one_number_wherever_it_is_shown(folder: Path) -> None:
    """Polarised, homogeneous, two-state, failed and missing points."""
    path = folder / "map.h5"
    with edited(path) as file:
        file["chi"][:4] = [[0.8, 0.82], [0.02, 0.03], [0.05, 0.9], [0.5, 0.6]]
        file["polarised_current"][:4] = [[0.4, 0.42], [0.01, -0.02], [0.0, 0.5], [0.2, 0.21]]
        file["point_status"] = np.array([0, 0, 2, 0, 0, 0], dtype="i4")
        file["point_status"].dims[0].attach_scale(file["point"])
        file["task_status"][3, 1] = 1
    leave_out(path, (4, 0), (4, 1))
    data, points = postproc.open_results(path), points_of(path)
    table, scan = postproc.table(path), columns_of.scanned(points)
    page = columns_of.points_of(points, scan, {})
    for name, column in (("chi", "chi"), ("polarised_current", "current")):
        found = postproc.mean_error(data[name], data[f"{name}_error"]).transpose("threshold", ...)
        for what, suffix in (("mean", ""), ("error", "_error")):
            expected = found[what].values.ravel()
            expected[2] = math.nan  # two states have no mean
            assert table[f"{name}{suffix}"].values == pytest.approx(expected, nan_ok=True)
            digits = 0.05 if suffix else 1e-4
            assert page[f"{column}{suffix}"] == pytest.approx(expected, rel=digits, nan_ok=True)
        axes = Figure().add_subplot()
        cells = plot.phase_diagram(data, ax=axes, variable=name).get_array().filled(math.nan)
        shown = table[name].values.reshape(3, 2).T
        assert cells == pytest.approx(shown, nan_ok=True)
    assert isinstance(axes, Axes)
    assert maps.values_of(points, "chi")[0] == pytest.approx(table["chi"], nan_ok=True)


TWO = {"threshold": [2, 4], "replicas": 3}
CASES = {
    "circuit": {"scan": TWO},
    "polygons": {"table": {"urn_shape": "polygon", "urn_sides": 6}, "scan": TWO},
    "one channel": {"table": {"channel2_width": 0.0}, "scan": TWO},
    "one urn": {"table": {"shape": "urn"}, "scan": TWO},
    "one point": {"gate": {"threshold": 4}, "scan": {"replicas": 4}},
    "one replica": {"gate": {"threshold": 4}},
}
SHOWN = {"one channel": ["chi"], "one urn": ["current1"]}  # others: chi and polarised current


def on_screen(printed: str, points: int) -> np.ndarray:
    """Return the last table that a run printed, a row a point, mean and error of each quantity."""
    lines = printed.rsplit("     N    T ", maxsplit=1)[-1].splitlines()[1 : points + 1]
    return np.array([[one.replace("-", "nan") if one == "-" else one for one in line.split()[5:]]
                     for line in lines], float)  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_screen_and_python_show_the_same_of_any_table(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table that a run prints, `open_results`, `table`, report and figure; theories as well."""
    groups = {"particles": {"number": 200}, "run": {"duration": 200.0}, "output": {"file": "a.h5"}}
    path = postproc.run({**groups, **CASES[case]}, folder=tmp_path)
    data, points = postproc.open_results(path, theory="window"), points_of(path)
    names = SHOWN.get(case, ["chi", "polarised_current"])
    screen = on_screen(capsys.readouterr().out, points.sizes["point"])
    assert screen.shape == (points.sizes["point"], 2 * len(names))
    table = postproc.table(path, theory="window")
    page = columns_of.points_of(points, columns_of.scanned(points), {"window": MODELS["window"]})
    for at, name in enumerate(names):
        column = "chi" if name == "chi" else "current"
        known = postproc.mean_error(data[name], data[f"{name}_error"])
        mean, error = (np.atleast_1d(known[what]) for what in ("mean", "error"))
        theory = np.atleast_1d(data[f"theory_{name}"])
        (drawn,) = plot.curves(data, ax=Figure().add_subplot(), variable=name)
        for expected, shown, rounding in (
            (mean, screen[:, 2 * at], {"abs": 6e-6}), (error, screen[:, 2 * at + 1], {"abs": 6e-6}),
            (mean, table[name], {}), (error, table[f"{name}_error"], {}),
            (mean, page[column], {"abs": 1e-6}), (error, page[f"{column}_error"], {"rel": 0.05}),
            (mean, drawn.lines[0].get_ydata(), {}),
            (theory, table[f"window_{name}"], {}),
            (theory, page[f"window_{column}"], {"rel": 1e-4}),
        ):  # fmt: skip
            assert np.asarray(shown) == pytest.approx(expected, nan_ok=True, **rounding)

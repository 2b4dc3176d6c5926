"""The one-channel model: its lines, where runs change, its figure and its namelists."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import f90nml
import numpy as np
import pytest

from postproc.cli import InputError
from postproc.figures import one_channel, theories
from postproc.figures.one_channel import Plane
from postproc.reading.points import means
from postproc.tests.commands import call
from postproc.tests.runs import BARE, points_of, results_of
from postproc.theory.circuit import Circuit, flow1, homogeneous_kind

NAMELISTS = Path(__file__).resolve().parents[2] / "namelists/one_channel"
CLOSED = {"channel1_width": 0.5, "channel1_length": 0.5, "channel2_width": 0.0}
SHORT = {"duration": None, "collisions": 20000, "transient_collisions": 10000}
BASE = Circuit(1000, 10, channel1_width=0.5, channel1_length=0.5, channel2_width=0.0)
AXES = {
    "channel1_length": (0.2, 0.8),
    "channel1_width": (0.2, 0.8),
    "urn_radius": (0.8, 1.5),
    "threshold": (4.0, 22.0),
}
PLANES = list(combinations(AXES, 2))


def plane_over(keys: tuple[str, str], circuit: Circuit = BASE) -> Plane:
    """Return a plane whose chi is 0 before N w l/(8 T A) = 0.8 and rises from there to 1 at 0.9."""
    x, y = (np.linspace(*AXES[key], 181) for key in keys)
    bare = Plane(circuit, keys, x, y, np.empty(0), 0.5)
    loads = one_channel.relative_load(bare.at(x[None, :], y[:, None]))
    return replace(bare, chi=np.clip((loads - 0.8) / 0.1, 0.0, 1.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give tiny runs: for either of two N a plane of lengths and one with T, and no planes."""
    made = tmp_path_factory.mktemp("runs")

    def plane(name: str, number: int, table: dict[str, object], **scan: object) -> None:
        particles = {"number": number, "urn1_fraction": 0.75}
        gate = {} if "threshold" in scan else {"threshold": number // 50}
        scan = {"threshold": None, "replicas": 1, **scan}
        groups = {"gate": gate, "run": SHORT, "scan": scan, "output": BARE}
        results_of(made / f"{name}.h5", table=table, particles=particles, **groups)

    for number in (50, 100):
        plane(
            f"lengths_{number}", number, CLOSED,
            urn_radius=[0.8, 1.1, 1.5], channel1_width=[0.2, 0.4, 0.6, 0.8],
        )  # fmt: skip
        plane(
            f"thresholds_{number}", number, CLOSED,
            channel1_length=[0.2, 0.5, 0.8], threshold=[1, 2, 4],
        )  # fmt: skip
    plane("one_list", 50, CLOSED, channel1_length=[0.2, 0.5])
    opened_ = {**CLOSED, "channel2_width": 0.1}
    plane("opened", 50, opened_, channel1_length=[0.2, 0.5], urn_radius=[1.0, 1.2])
    return made


NAMES = ("lengths_50", "thresholds_50", "lengths_100", "thresholds_100")


@pytest.mark.parametrize("keys", PLANES)
def test_the_published_line_is_where_the_formula_says(keys: tuple[str, str]) -> None:
    """N w l = 8 T A, A the disc less the segment at its one opening (integrated here)."""
    x, y = one_channel.line(plane_over(keys), one_channel.published_load)
    there = np.isfinite(y)
    assert there.sum() > 20
    for place in zip(x[there], y[there], strict=True):
        one = replace(BASE, **dict(zip(keys, place, strict=True)))
        radius, width = float(one.urn_radius), float(one.channel1_width)
        angle = np.linspace(0.0, math.pi - math.asin(width / (2.0 * radius)), 4001)
        area = 2.0 * np.trapezoid((radius * np.sin(angle)) ** 2, angle)
        load = 1000.0 * width * float(one.channel1_length) / (8.0 * area)
        assert load == pytest.approx(float(one.threshold), rel=2e-3)


@pytest.mark.parametrize("name", ["window", "renewal"])
@pytest.mark.parametrize("number", [1000, 10000])
def test_at_the_zero_of_its_slope_the_homogeneous_state_changes(name: str, number: int) -> None:
    """Stable below, unstable beyond, at several T, and whatever length makes the load."""
    model, thresholds = theories.MODELS[name], np.array([4.0, 10.0, 22.0]) * number / 1000
    found = one_channel.slope_load(replace(BASE, number=number), thresholds, model)
    for threshold, load in zip(thresholds, found, strict=True):
        one = replace(BASE, number=number, threshold=int(threshold), urn_radius=1.2)
        unit = load / float(one_channel.relative_load(one))
        kinds = [
            homogeneous_kind(model.of(replace(one, channel1_length=0.5 * unit * factor)))
            for factor in (0.999, 1.001)
        ]
        assert kinds == ["stable", "unstable"]


def test_of_the_start_the_fuller_urn_sends_more_below_and_less_beyond() -> None:
    """Where J(N1) = J(N2), by the flows themselves."""
    model, thresholds = theories.MODELS["renewal"], np.array([4.0, 10.0, 22.0])
    for threshold, load in zip(
        thresholds, one_channel.start_load(BASE, thresholds, model, 0.5), strict=True
    ):
        one = model.of(replace(BASE, threshold=int(threshold)))
        unit = 0.5 * load / float(one_channel.relative_load(one))
        for factor, sign in ((0.999, 1.0), (1.001, -1.0)):
            at = replace(one, channel1_length=unit * factor)
            assert sign * float(flow1(at, 750.0) - flow1(at, 250.0)) > 0.0


@pytest.mark.parametrize("keys", PLANES)
def test_transitions_of_a_known_map_are_found(keys: tuple[str, str]) -> None:
    """In N w l/(8 T A), over whatever the map is."""
    plane = plane_over(keys)
    found = one_channel.transitions(plane, one_channel.PAIR)
    assert np.nanmean(found["runs, chi = 0.25"]) == pytest.approx(0.825, abs=2e-3)
    assert np.nanmean(found["runs, chi = 0.5"]) == pytest.approx(0.85, abs=2e-3)
    assert "runs, chi = 0.25 0.825 +- 0.00" in " ".join(one_channel.table([plane]).split())


def test_a_plane_without_a_transition_has_none() -> None:
    """NaN, not a number of some column."""
    plane = replace(plane_over(PLANES[0]), chi=np.zeros((181, 181)))
    found = one_channel.transitions(plane, one_channel.PAIR)
    assert np.isnan(found["runs, chi = 0.5"]).all()
    assert one_channel.table([plane]).count(" -\n") >= 2


def test_the_figure_has_each_map_with_its_lines(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [points_of(folder / f"{name}.h5") for name in NAMES]
    made = one_channel.figure_one_channel(files)
    planes = [plane for points in files for plane in one_channel.planes_of(points)]
    chi = [means(points, "chi")[0] for points in files]
    maps = [axes for axes in made.axes if axes.collections and axes.lines]
    symbols = [(axes.get_xlabel(), axes.get_ylabel()) for axes in maps]
    assert symbols == 2 * [("$l$", "$T$"), ("$w$", "$r$")]
    assert [axes.get_title("left") for axes in maps] == [
        r"$N = 50$, $\chi(0) = 0.52$", "", r"$N = 100$, $\chi(0) = 0.5$", "",
    ]  # fmt: skip
    for axes, at in zip(maps, (1, 0, 3, 2), strict=True):
        plane, shown = planes[at], axes.collections[0].get_array().filled(np.nan)
        assert shown == pytest.approx(plane.chi)
        assert sorted(shown.ravel()) == pytest.approx(sorted(chi[at]))
        assert axes.get_xlim()[0] < plane.x[0] < plane.x[-1] < axes.get_xlim()[1]
        lines = one_channel.lines_of(one_channel.PAIR, plane.start)
        assert [one.get_label() for one in axes.lines] == list(lines)
        for drawn, (load_of, dashes, _) in zip(axes.lines, lines.values(), strict=True):
            x, y = one_channel.line(plane, load_of)
            assert drawn.get_linestyle() == dashes
            assert drawn.get_data()[0] == pytest.approx(x)
            assert drawn.get_data()[1] == pytest.approx(y, nan_ok=True)
    (legend,) = made.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        r"$N w \ell / 8 T A = 1$", "$J' = 0$, window (the paper's)", "$J' = 0$, renewal gate",
        r"$J(N_1) = J(N_2)$ at $\chi(0)$, renewal gate",
    ]  # fmt: skip
    together = [axes for axes in made.axes if axes.get_xlabel() == r"$N w \ell / 8 T A$"]
    titles = [axes.get_title("left") for axes in together]
    assert titles == ["$N = 50$, $T = 1$", "$N = 100$, $T = 2$"]
    for axes, plane in zip(together, (planes[0], planes[2]), strict=True):
        loads = one_channel.relative_load(plane.at(plane.x[None, :], plane.y[:, None]))
        assert axes.lines[0].get_data()[0] == pytest.approx(loads.ravel())
        assert axes.lines[0].get_data()[1] == pytest.approx(plane.chi.ravel())
    heads = [line.split() for line in capsys.readouterr().out.splitlines() if line[:4] == "N = "]
    assert heads == [["N", "=", one, "l,", "T", "w,", "r"] for one in ("50", "100")]


@pytest.mark.parametrize(
    ("name", "words"), [("one_list", "two of l, w, r and T"), ("opened", "channel2_width = 0")]
)
def test_what_is_no_plane_of_the_model_is_refused(folder: Path, name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        one_channel.planes_of(points_of(folder / f"{name}.h5"))


def test_one_plane_is_drawn_by_the_command(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(folder / "thresholds_50.h5"), "--output", str(tmp_path)]
    assert call("plot", ["one_channel", *arguments, "--theory", "window"]) == 0
    assert "start, window (the paper's)" in capsys.readouterr().out
    assert (tmp_path / "thresholds_50_one_channel.png").read_bytes().startswith(b"\x89PNG")


def test_the_namelists_are_the_six_planes_at_the_published_size() -> None:
    """Of (l, w, r, T), for N = 1e3 and 1e4; T is whole, so it has as many as whole steps allow."""
    names = {"channel1_length": "length", "channel1_width": "width", "urn_radius": "radius",
             "threshold": "threshold"}  # fmt: skip
    expected = {f"{names[x]}_{names[y]}_{n}" for x, y in PLANES for n in (1000, 10000)}
    assert {path.stem for path in NAMELISTS.glob("*")} == expected
    for x, y in PLANES:
        for number in (1000, 10000):
            name, many = f"{names[x]}_{names[y]}_{number}", number // 1000
            case = f90nml.read(NAMELISTS / f"{name}.nml")
            ranges = {
                "channel1_length": [0.2, 0.8, 50], "channel1_width": [0.2, 0.8, 50],
                "urn_radius": [0.8, 1.5, 50],
                "threshold": [4, 22, 19] if number == 1000 else [40, 220, 46],
            }  # fmt: skip
            base = {"channel1_length": 0.5, "channel1_width": 0.5, "channel2_width": 0}
            assert case["scan"].todict() == {f"{key}_range": ranges[key] for key in (x, y)}
            assert case["table"].todict() == {k: v for k, v in base.items() if k not in (x, y)}
            assert case.get("gate") == (None if y == "threshold" else {"threshold": 10 * many})
            assert case["particles"] == {"number": number, "urn1_fraction": 0.75}
            assert case["run"] == {"collisions": 6000000, "transient_collisions": 5000000}
            assert case["output"] == {"file": f"one_channel_{name}.h5"}

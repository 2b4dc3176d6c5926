"""The one-channel model: its lines, where runs change, and its picture."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pytest
import xarray as xr

from postproc.tests.looks import assert_looks_apart
from postproc.theory.circuit import Circuit, flow1, homogeneous_kind
from postproc.theory.models import MODELS
from studies.common.study import Study
from studies.one_channel import picture, study
from studies.one_channel.picture import Plane

if TYPE_CHECKING:
    from pathlib import Path

BASE = study.circuit_of(1000)
AXES = {**study.LENGTHS, "threshold": (4.0, 22.0)}
PLANES = list(combinations(AXES, 2))


def plane_over(keys: tuple[str, str], circuit: Circuit = BASE) -> Plane:
    """Return a plane whose chi is 0 before N w l/(8 T A) = 0.8 and rises from there to 1 at 0.9."""
    x, y = (np.linspace(*AXES[key], 181) for key in keys)
    bare = Plane(circuit, keys, x, y, np.empty(0), 0.5)
    loads = picture.relative_load(bare.at(x[None, :], y[:, None]))
    return replace(bare, chi=np.clip((loads - 0.8) / 0.1, 0.0, 1.0))


@pytest.mark.parametrize("keys", PLANES)
def test_the_published_line_is_where_the_formula_says(keys: tuple[str, str]) -> None:
    """N w l = 8 T A, A the disc less the segment at its one opening (integrated here)."""
    x, y = picture.line(plane_over(keys), picture.published_load)
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
    model, thresholds = MODELS[name], np.array([4.0, 10.0, 22.0]) * number / 1000
    found = picture.slope_load(replace(BASE, number=number), thresholds, model)
    for threshold, load in zip(thresholds, found, strict=True):
        one = replace(BASE, number=number, threshold=int(threshold), urn_radius=1.2)
        unit = load / float(picture.relative_load(one))
        kinds = [
            homogeneous_kind(model.of(replace(one, channel1_length=0.5 * unit * factor)))
            for factor in (0.999, 1.001)
        ]
        assert kinds == ["stable", "unstable"]


def test_of_the_start_the_fuller_urn_sends_more_below_and_less_beyond() -> None:
    """Where J(N1) = J(N2), by the flows themselves."""
    model, thresholds = MODELS["renewal"], np.array([4.0, 10.0, 22.0])
    for threshold, load in zip(
        thresholds, picture.start_load(BASE, thresholds, model, 0.5), strict=True
    ):
        one = model.of(replace(BASE, threshold=int(threshold)))
        unit = 0.5 * load / float(picture.relative_load(one))
        for factor, sign in ((0.999, 1.0), (1.001, -1.0)):
            at = replace(one, channel1_length=unit * factor)
            assert sign * float(flow1(at, 750.0) - flow1(at, 250.0)) > 0.0


@pytest.mark.parametrize("keys", PLANES)
def test_transitions_of_a_known_map_are_found(keys: tuple[str, str]) -> None:
    """In N w l/(8 T A), over whatever the map is."""
    plane = plane_over(keys)
    found = picture.transitions(plane)
    assert np.nanmean(found["runs, chi = 0.25"]) == pytest.approx(0.825, abs=2e-3)
    assert np.nanmean(found["runs, chi = 0.5"]) == pytest.approx(0.85, abs=2e-3)
    assert "runs, chi = 0.25 0.825 +- 0.00" in " ".join(picture.table([plane]).split())


def test_a_plane_without_a_transition_has_none() -> None:
    """NaN, not a number of some column."""
    plane = replace(plane_over(PLANES[0]), chi=np.zeros((181, 181)))
    found = picture.transitions(plane)
    assert np.isnan(found["runs, chi = 0.5"]).all()
    assert picture.table([plane]).count(" -\n") >= 2


def test_the_picture_has_each_map_with_its_lines() -> None:
    found = [plane_over(keys, study.circuit_of(number)) for number in study.NUMBERS
             for keys in PLANES[:3]]  # fmt: skip
    made = picture.figure(found)
    made.draw_without_rendering()
    assert_looks_apart(made)
    maps = [axes for axes in made.axes if axes.collections and axes.lines]
    symbols = [(axes.get_xlabel(), axes.get_ylabel()) for axes in maps]
    assert symbols == 2 * [("$l$", "$w$"), ("$l$", "$r$"), ("$l$", "$T$")]
    assert [axes.get_title("left") for axes in maps] == [
        r"$N = 1000$, $\chi(0) = 0.5$", "", "", r"$N = 10000$, $\chi(0) = 0.5$", "", "",
    ]  # fmt: skip
    for axes, plane in zip(maps, found, strict=True):
        assert np.asarray(axes.collections[0].get_array()) == pytest.approx(plane.chi)
        x, y = picture.line(plane, picture.published_load)
        assert axes.lines[0].get_data()[0] == pytest.approx(x)
        assert axes.lines[0].get_data()[1] == pytest.approx(y, nan_ok=True)
    (legend,) = made.legends
    box = legend.get_window_extent()
    assert made.bbox.x0 <= box.x0 <= box.x1 <= made.bbox.x1
    assert [text.get_text() for text in legend.get_texts()] == list(picture.lines_of(0.5))
    together = [axes for axes in made.axes if axes.get_xlabel() == r"$N w \ell / 8 T A$"]
    titles = [axes.get_title("left") for axes in together]
    assert titles == ["$N = 1000$, $T = 10$", "$N = 10000$, $T = 100$"]


@pytest.mark.parametrize("number", study.NUMBERS)
@pytest.mark.parametrize("keys", PLANES)
def test_planes_are_scanned_at_the_published_size(
    keys: tuple[str, str], number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of (l, w, r, T); T is whole, so it has as many values as whole steps allow."""
    asked = {}
    monkeypatch.setattr(Study, "run", lambda _, *words: asked.update(changes=words[2]))
    study.run_plane(Study(tmp_path, full=True), number, keys)
    ranges = {"channel1_length": [0.2, 0.8, 50], "channel1_width": [0.2, 0.8, 50],
              "urn_radius": [0.8, 1.5, 50],
              "threshold": [4, 22, 19] if number == 1000 else [40, 220, 46]}  # fmt: skip
    assert asked["changes"]["scan"] == {f"{key}_range": ranges[key] for key in keys}
    threshold = None if "threshold" in keys else number // 100
    assert asked["changes"]["gate"] == {"threshold": threshold}
    assert asked["changes"]["particles"] == {"number": number}


def test_what_was_measured_is_laid_along_the_keys_of_the_plane() -> None:
    """Whatever the order of dimensions; the mean over replicas."""
    chi = np.arange(12.0).reshape(2, 3, 2)  # T, l, replica
    data = xr.Dataset(
        {"chi": (("threshold", "channel1_length", "replica"), chi)},
        {"threshold": [4, 6], "channel1_length": [0.2, 0.5, 0.8], "urn1_number": 750},
    )
    plane = study.plane_of(data, BASE, ("channel1_length", "threshold"))
    assert plane.chi.tolist() == [[0.5, 2.5, 4.5], [6.5, 8.5, 10.5]]
    assert (plane.x.tolist(), plane.y.tolist(), plane.start) == ([0.2, 0.5, 0.8], [4.0, 6.0], 0.5)

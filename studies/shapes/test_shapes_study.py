"""Experiments with other urns: comparable shapes, directions in a square, the picture."""

from __future__ import annotations

import csv
from fractions import Fraction
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from studies.common import event_log, geometry
from studies.common.study import Study
from studies.shapes import study as shapes


def test_all_urns_have_the_area_of_the_disc() -> None:
    area = geometry.urn_area(0.05)
    given = geometry.shapes(0.05)
    for name in (geometry.SQUARE, geometry.REGULAR):
        angles = 2.0 * np.pi * np.arange(given[name]["urn_sides"]) / given[name]["urn_sides"]
        corners = given[name]["urn_radius"] * np.transpose([np.cos(angles), np.sin(angles)])
        assert geometry.area_of(corners) == pytest.approx(area, rel=1e-12)
    corners = np.reshape(given[geometry.IRRATIONAL]["urn_vertices"], (-1, 2))
    assert geometry.area_of(corners) == pytest.approx(area, rel=1e-12)


def test_crooked_hexagon_is_convex_with_irrational_angles() -> None:
    corners = [[Fraction(str(one)) for one in xy] for xy in geometry.CROOKED]
    following = corners[1:] + corners[:1]
    sides = [(c - a, d - b) for (a, b), (c, d) in zip(corners, following, strict=True)]
    for (a, b), (c, d) in zip(sides, sides[1:] + sides[:1], strict=True):
        assert a * d - b * c > 0
    upright = [side for side in sides if side[0] == 0]
    assert len(upright) == 2
    # The tangent of a rational part of pi is irrational, or one of 0, 1, -1 and infinity (Niven).
    for (a, b), (c, d) in combinations([*upright[:1], *(s for s in sides if s[0] != 0)], 2):
        over, along = abs(a * d - b * c), abs(a * c + b * d)
        assert over not in (0, along)
        assert along != 0


Entries = list[tuple[np.ndarray, np.ndarray, np.ndarray]]  # by shape, of `entries_of`


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, shapes.Found, Entries]:
    """Make tiny runs of all kinds; return their folder, results, and the entries they have seen."""
    folder, seen = tmp_path_factory.mktemp("shapes"), []

    def entries_of(events: event_log.ParticleEvents) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        seen.append(event_log.entries_of(events))
        return seen[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shapes, "event_log", SimpleNamespace(**vars(event_log)))
        patch.setattr(shapes.event_log, "entries_of", entries_of)
        patch.setattr(shapes, "THRESHOLDS", (7,))
        patch.setattr(shapes, "PASSAGES", (0.05,))
        patch.setattr(shapes, "LAGS", (1, 2))
        patch.setattr(shapes, "MANY", 1000)
        for kind in ("shorter", "equal"):  # as "states", but for a number
            patch.delitem(shapes.KINDS, kind)
        work = Study(folder, ranks=1)
        found = shapes.measure(work, 2, 20.0)
        shapes.write_tables(work, found)
    return folder, found, seen


def test_only_a_square_keeps_the_direction(made: tuple[Path, shapes.Found, Entries]) -> None:
    for shape, (_, particle, cosine) in zip(shapes.LOOKS, made[2], strict=True):
        again = particle[1:] == particle[:-1]
        change = np.abs(np.diff(cosine))[again]
        assert change.size > 100
        assert (change.max() < 1e-6) == (shape == geometry.SQUARE)


def test_picture_shows_every_shape(made: tuple[Path, shapes.Found, Entries]) -> None:
    _, found, _ = made
    spread, current, memory, back = shapes.figure(found).axes
    labels = [axes.get_ylabel() for axes in (spread, current)]
    assert labels == [r"$\chi$", "net current (per unit time)"]
    for axes, points in ((spread, 1), (current, 1), (memory, 2), (back, 1)):
        assert len(axes.containers) == len(shapes.LOOKS)
        assert all(len(one.lines[0].get_xdata()) == points for one in axes.containers)
    names = [text.get_text() for text in spread.get_legend().get_texts()]
    assert sorted(names) == sorted(["well mixed", *shapes.LOOKS])
    drawn = [one.lines[0].get_ydata()[0] for one in spread.containers]
    assert drawn == [found["states"][shape][0]["chi"] for shape in shapes.LOOKS]
    assert min(drawn) > 0.5


def test_returns_are_those_of_the_page(made: tuple[Path, shapes.Found, Entries]) -> None:
    """Within 5 errors of the few visits; by chance w'/(w + w') of them return."""
    with (Path(shapes.__file__).parent / "returns.csv").open(encoding="utf-8") as file:
        page = {row["shape"]: float(row["a, w' = 0.05"].split()[0]) for row in csv.DictReader(file)}
    for shape, (row,) in made[1]["returns"].items():
        assert row["chance"] == pytest.approx(0.05 / 0.35)
        error = np.sqrt(page[shape] * (1.0 - page[shape]) / row["visits"])
        assert abs(row["return"] - page[shape]) < 5.0 * error


def test_tables_have_every_shape(made: tuple[Path, shapes.Found, Entries]) -> None:
    folder, found, _ = made
    with (folder / "states_chi.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert list(row) == ["T", "chi, disc", "square", "regular hexagon", "crooked hexagon",
                         "well mixed"]  # fmt: skip
    assert row["square"].startswith(f"{found['states'][geometry.SQUARE][0]['chi']:.3f} ±")

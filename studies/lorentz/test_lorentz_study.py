"""Experiments of the Lorentz circuit: discs that fit, Ohm's law of mixed urns, the picture."""

from __future__ import annotations

import csv
import math
from itertools import combinations, pairwise
from typing import TYPE_CHECKING

import f90nml
import h5py
import numpy as np
import pytest

import postproc
from studies.common.geometry import lattice
from studies.common.study import Study
from studies.lorentz import study as lorentz

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, lorentz.Rows]]:
    """Make tiny runs of all kinds; return their folder and results."""
    folder = tmp_path_factory.mktemp("lorentz")
    with pytest.MonkeyPatch.context() as patch:
        for name, values in (
            ("RADII", (0.0, 0.02)), ("COLUMNS", (2,)), ("WIDTHS", (0.03, 0.06)),
            ("THRESHOLDS", (7, 9)), ("FREE_RADII", (0.02,)), ("CLOSE", {200: (0.015, 0.03)}),
        ):  # fmt: skip
            patch.setattr(lorentz, name, values)
        work = Study(folder, ranks=1)
        found = lorentz.measure(work, 2, 10.0)
        lorentz.tables(work, found)
    return folder, found


def discs_of(folder: Path, name: str) -> int:
    """Return the number of discs of a run, from its results."""
    with h5py.File(folder / f"{name}.h5") as file:
        groups = f90nml.reads(file.attrs["namelist"])
    return len(groups["table"].get("scatterers", [])) // 3


@pytest.mark.parametrize("columns", [c for c in lorentz.COLUMNS if c])
def test_discs_are_apart_and_the_channel_is_not_closed(columns: int) -> None:
    discs = np.reshape(lattice(columns, max(lorentz.RADII)), (-1, 3))
    for one, other in combinations(discs, 2):
        assert math.hypot(*(one - other)[:2]) > one[2] + other[2]
    for place in set(discs[:, 0]):
        heights = np.sort(discs[discs[:, 0] == place, 1])
        gaps = [high - low - 2.0 * discs[0, 2] for low, high in pairwise(heights)]
        assert min(gaps) > 0.0
    assert np.abs(discs[:, 0]).max() + discs[0, 2] < 0.5


def test_without_memory_two_conductors_scatter_by_the_weaker() -> None:
    """Two conductors in a ring: twice N/2 times g1 g2/(g1 + g2), here for one particle."""
    area = math.pi - sum(math.asin(x) - x * math.sqrt(1.0 - x**2) for x in (0.15, 0.1))
    equal = lorentz.nyquist([{"radius": 0.02, "conductance": 1.5}], 0.02)
    assert equal == pytest.approx(0.15 / (math.pi * area))
    free = lorentz.nyquist([], 0.0)  # 0.3 and 0.2 instead of 0.3 twice
    assert free == pytest.approx(equal * 0.12 / 0.15)
    weak = lorentz.nyquist([{"radius": 0.02, "conductance": 1e-3}], 0.02)
    assert weak == pytest.approx(equal * 2e-3 / 1.5, rel=1e-2)


def test_cumulant_tells_one_state_from_two_and_from_three() -> None:
    random = np.random.default_rng(5)
    one = random.normal(0.0, 0.1, (8, 20000))
    value, error = lorentz.cumulant(one)
    assert 0.0 < error < 0.02
    assert abs(value) < 4.0 * error
    two = np.where(random.random(one.shape) < 0.5, -0.7, 0.7)
    assert lorentz.cumulant(two)[0] == pytest.approx(2.0 / 3.0)
    # m = 0 most of the time, and sometimes m0.
    value, error = lorentz.cumulant(np.where(random.random(one.shape) < 0.8, 0.0, two))
    assert value == pytest.approx(1.0 - 1.0 / 0.6, abs=4.0 * error)


def test_close_to_the_transition_both_starts_stand_side_by_side(
    made: tuple[Path, dict[str, lorentz.Rows]],
) -> None:
    folder, found = made
    data = postproc.open_results(folder / "close_200_0.03.h5")
    assert float(data.threshold) == 1.0
    assert data.urn1_number.to_numpy().tolist() == [100, 200]
    assert discs_of(folder, "close_200_0.03") == 15
    assert [row["urn1_number"] for row in found["close"]] == [100.0, 200.0] * 2
    with (folder / "close.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["radius"] for row in rows] == ["0.015", "0.03"]
    assert rows[1]["chi, from one full urn"].startswith(f"{found['close'][3]['chi']:.3f} ±")


def test_every_row_has_its_discs(made: tuple[Path, dict[str, lorentz.Rows]]) -> None:
    folder, found = made
    assert [row["radius"] for row in found["radius"]] == [0.0, 0.0, 0.02, 0.02]
    for name, discs in (("radius_0", 0), ("radius_0.02", 15), ("columns_2", 5), ("straight", 0)):
        assert discs_of(folder, name) == discs
    # Discs reduce the conductance of the channel.
    conducts = {row["radius"]: row["conductance"] for row in found["radius"]
                if row["urn1_number"] == lorentz.NUMBER}  # fmt: skip
    assert 0.0 < conducts[0.02] < 0.5


def test_picture_shows_both_starts_and_all_families(
    made: tuple[Path, dict[str, lorentz.Rows]],
) -> None:
    _, found = made
    radius, columns, ohm, collapse = lorentz.figure(found).axes
    assert [len(axes.containers) for axes in (radius, columns, ohm, collapse)] == [4, 2, 2, 3]
    for axes in (radius, ohm, collapse):
        assert axes.get_legend() is not None
    assert radius.containers[2].lines[0].get_ydata()[-1] == found["radius"][-1]["chi"]
    assert ohm.get_xlabel() == r"$\chi$"
    assert ohm.get_ylabel() == "net current (per unit time)"

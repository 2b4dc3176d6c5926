"""Legends of figures: each entry has a look of its own, and none is cut."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from postproc.figures import appendix, circuits, maps, passages, style
from postproc.figures.theories import named
from postproc.tests.looks import assert_looks_apart
from postproc.tests.runs import BARE, points_of, results_of

if TYPE_CHECKING:
    from pathlib import Path

MIXED = named(["window", "renewal"])
SHORT = {"duration": 100.0}
DRAWN = {
    "comp05": (circuits.figure_flows, "circuit", MIXED),
    "comp06": (circuits.figure_relaxation, "circuit", MIXED),
    "comp01": (circuits.figure_curves, "circuit", MIXED),
    "characteristic": (circuits.figure_characteristic, "one_key", MIXED),
    "numris": (maps.figure_phase_diagram, "circuit", MIXED),
    "lifetimes": (passages.figure_lifetimes, "circuit", MIXED),
    "app2": (appendix.figure_urn_current, "urn", MIXED),
    "app3": (appendix.figure_urn_difference, "urn", MIXED),
    "app4": (appendix.figure_urn_scaled, "urn", MIXED),
}
NARROWEST = {
    "point": ("comp05", "comp06", "comp01", "characteristic", "lifetimes"),
    "circuit": ("numris",),
    "urn_point": ("app2", "app3", "app4"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("legends")
    scan = {"threshold": [4, 5], "replicas": 1}
    results_of(made / "circuit.h5", run=SHORT, scan={"channel2_width": [0.01, 0.03], **scan},
               output={"series_interval": 10.0})  # fmt: skip
    results_of(made / "one_key.h5", run=SHORT, gate={"threshold": 4}, output=BARE,
               scan={"threshold": None, "channel2_width": [0.01, 0.03], "replicas": 1})  # fmt: skip
    results_of(made / "urn.h5", table={"shape": "urn"}, particles={"number": None}, run=SHORT,
               scan={"number": [500, 1000], "channel1_width": [0.1, 0.3], **scan},
               output=BARE)  # fmt: skip
    results_of(made / "point.h5", run=SHORT, gate={"threshold": 4}, scan={"replicas": 1},
               output={"series_interval": 10.0})  # fmt: skip
    results_of(made / "urn_point.h5", table={"shape": "urn"}, particles={"number": 500}, run=SHORT,
               gate={"threshold": 4}, scan={"replicas": 1}, output=BARE)  # fmt: skip
    results_of(made / "unlike.h5", run=SHORT, gate={"threshold": [3, 9]}, output=BARE | {
               "series_interval": 10.0}, scan={"threshold": None, "threshold2": [1, 2],
               "replicas": 1})  # fmt: skip
    return made


@pytest.mark.parametrize("name", DRAWN)
def test_no_two_entries_of_a_legend_look_alike(name: str, folder: Path) -> None:
    draw, file, models = DRAWN[name]
    points = points_of(folder / f"{file}.h5")
    assert_looks_apart(draw(points, models))


@pytest.mark.parametrize(
    ("file", "name"), [(file, name) for file, names in NARROWEST.items() for name in names]
)
def test_no_legend_is_cut_in_the_narrowest_form_of_a_figure(
    name: str, file: str, folder: Path
) -> None:
    draw, _, models = DRAWN[name]
    points = points_of(folder / f"{file}.h5")
    made = draw(points, models)
    made.draw_without_rendering()
    for legend in made.legends:
        box = legend.get_window_extent()
        assert made.bbox.x0 <= box.x0 <= box.x1 <= made.bbox.x1
        assert made.bbox.y0 <= box.y0 <= box.y1 <= made.bbox.y1


def test_a_legend_is_not_cut_at_the_resolution_at_which_it_is_written() -> None:
    """Letters are up to 6 % wider there than on screen."""
    made = style.figure()
    axes = made.add_subplot()
    theories = [f"theory, {one.label}, in the same colours" for one in MIXED]
    labels = ["$T_2 = 1$", "$T_2 = 2$", "$T_2 = 5$", *theories]
    handles = [axes.errorbar([], [], [], fmt="o") for _ in labels]
    style.legend_above(made, handles, labels, 4, fontsize=7.5)
    made.set_dpi(style.RESOLUTION)
    made.draw_without_rendering()
    assert made.legends[0].get_window_extent().width <= made.bbox.width


def test_a_legend_names_no_theory_that_is_not_drawn(folder: Path) -> None:
    """None is drawn of unequal gates."""
    points = points_of(folder / "unlike.h5")
    for draw in (circuits.figure_curves, circuits.figure_relaxation):
        (legend,) = draw(points).legends
        assert not [text for text in legend.get_texts() if "theory" in text.get_text()]

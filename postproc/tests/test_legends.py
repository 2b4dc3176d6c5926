"""Legends of figures: each entry has a look of its own."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from matplotlib.offsetbox import DrawingArea

from postproc.accuracy import experiments_page, gated_reversal, ladder_map_figure, observables
from postproc.figures import appendix, circuits, maps, one_channel, passages
from postproc.figures.models import named
from postproc.reading.results import opened
from postproc.tests.runs import BARE, results_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

HERE = Path(__file__).parent
KEPT = json.loads((HERE / "accuracy_numbers.json").read_text())
EXPERIMENTS = json.loads((HERE.parents[1] / "docs/experiments.json").read_text())
MIXED = named(["window", "renewal", "renewal_occupation"])
SHORT = {"duration": 100.0}
TOLD: dict[str, Callable[[], Figure]] = {
    "observables": lambda: observables.figure_observables(KEPT["observables"]["rows"]),
    "ladder_map": lambda: ladder_map_figure.figure(KEPT["ladder_map"]["rows"]),
    "reversal_gated": lambda: gated_reversal.figure_reversal(
        KEPT["gated_reversal"]["scan"], KEPT["gated_reversal"]["turned"]
    ),
    "experiments": lambda: experiments_page.figure(EXPERIMENTS),
}
DRAWN = {
    "comp01": (circuits.figure_comp01, "circuit", MIXED),
    "numris": (maps.figure_numris, "circuit", MIXED),
    "lifetimes": (passages.figure_lifetimes, "circuit", MIXED),
    "app2": (appendix.figure_app2, "urn", MIXED),
    "app3": (appendix.figure_app3, "urn", appendix.WELL_MIXED),
    "app4": (appendix.figure_app4, "urn", MIXED[:2]),
    "one_channel": (one_channel.figure_one_channel, "plane", one_channel.PAIR),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("legends")
    scan = {"threshold": [7, 12], "replicas": 1}
    results_of(made / "circuit.h5", run=SHORT, scan={"channel2_width": [0.01, 0.03], **scan},
               output={"series_interval": 10.0})  # fmt: skip
    results_of(made / "urn.h5", table={"shape": "urn"}, particles={"number": None}, run=SHORT,
               scan={"number": [500, 1000], "channel1_width": [0.1, 0.3], **scan},
               output=BARE)  # fmt: skip
    lengths = {"channel1_length": [0.5, 1.0], "channel1_width": [0.2, 0.4], "replicas": 1}
    results_of(made / "plane.h5", table={"channel2_width": 0.0}, run=SHORT, scan=lengths,
               particles={"urn1_number": 750}, output=BARE)  # fmt: skip
    return made


def looks(legend: Legend) -> dict[str, str]:
    """Return what can be seen of each entry, by its label."""
    seen = ("color", "facecolor", "linestyle", "marker", "fillstyle", "markerfacecolor", "alpha",
            "markersize", "linewidth")  # fmt: skip
    return {
        text.get_text(): " ".join(
            str(part.properties().get(name)) for part in box.get_children() for name in seen
        )
        for text, box in zip(legend.get_texts(), legend.findobj(DrawingArea), strict=True)
    }


@pytest.mark.parametrize("name", [*TOLD, *DRAWN])
def test_no_two_entries_of_a_legend_look_alike(name: str, folder: Path) -> None:
    if name in TOLD:
        made = TOLD[name]()
    else:
        draw, file, models = DRAWN[name]
        with opened([folder / f"{file}.h5"]) as files:
            made = draw(files, models)
    inside = [axes.get_legend() for axes in made.axes]
    legends = [*made.legends, *(one for one in inside if one is not None)]
    assert legends
    for legend in legends:
        for (one, look), (other, same) in combinations(looks(legend).items(), 2):
            assert look != same, f"{one} and {other} look alike"

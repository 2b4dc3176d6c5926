"""Legends of figures: each entry has a look of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from postproc.figures import appendix, circuits, maps, one_channel, passages
from postproc.figures.models import named
from postproc.reading.results import opened
from postproc.tests.looks import assert_looks_apart
from postproc.tests.runs import BARE, results_of

if TYPE_CHECKING:
    from pathlib import Path

MIXED = named(["window", "renewal"])
SHORT = {"duration": 100.0}
DRAWN = {
    "comp01": (circuits.figure_comp01, "circuit", MIXED),
    "numris": (maps.figure_numris, "circuit", MIXED),
    "lifetimes": (passages.figure_lifetimes, "circuit", MIXED),
    "app2": (appendix.figure_app2, "urn", MIXED),
    "app3": (appendix.figure_app3, "urn", MIXED),
    "app4": (appendix.figure_app4, "urn", MIXED),
    "one_channel": (one_channel.figure_one_channel, "plane", one_channel.PAIR),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("legends")
    scan = {"threshold": [4, 5], "replicas": 1}
    results_of(made / "circuit.h5", run=SHORT, scan={"channel2_width": [0.01, 0.03], **scan},
               output={"series_interval": 10.0})  # fmt: skip
    results_of(made / "urn.h5", table={"shape": "urn"}, particles={"number": None}, run=SHORT,
               scan={"number": [500, 1000], "channel1_width": [0.1, 0.3], **scan},
               output=BARE)  # fmt: skip
    lengths = {"channel1_length": [0.5, 1.0], "channel1_width": [0.2, 0.4], "replicas": 1}
    results_of(made / "plane.h5", table={"channel2_width": 0.0}, run=SHORT, scan=lengths,
               particles={"urn1_number": 750}, output=BARE)  # fmt: skip
    return made


@pytest.mark.parametrize("name", DRAWN)
def test_no_two_entries_of_a_legend_look_alike(name: str, folder: Path) -> None:
    draw, file, models = DRAWN[name]
    with opened([folder / f"{file}.h5"]) as files:
        assert_looks_apart(draw(files, models))

"""The map of the errors of models: every model of the product is on it."""

from __future__ import annotations

import csv

from postproc.accuracy.model_errors import TABLE
from postproc.theory.models import MODELS
from studies.where_models_fail import study


def test_every_model_is_asked_and_is_in_the_table() -> None:
    assert list(MODELS) == study.THEORIES
    with TABLE.open(encoding="utf-8") as file:
        assert {row["model"] for row in csv.DictReader(file)} >= set(MODELS)

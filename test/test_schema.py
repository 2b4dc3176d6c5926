"""`battery --schema`: what it takes and refuses, next to what the program does."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis.strategies import DataObject, data
from support.program import ROOT, namelist, run
from support.schema import namelists, read, schema_of

if TYPE_CHECKING:
    from pathlib import Path

    from jsonschema import Draft202012Validator

# Each is given to all keys at once, as it stands in a namelist.
VALUES = [
    "0", "-1", "0.5", "1.5", "2147483648", "1000000000000000000", "'text'", "''", "' text'", "T",
    "1, 2", "0, 1, 2", "3, 1, 1.5", "2147483648, 1, 2", "1, 2, 3, 4", "",
]  # fmt: skip


@pytest.fixture(scope="module")
def schema(tmp_path_factory: pytest.TempPathFactory) -> Draft202012Validator:
    """Give what the program says."""
    return schema_of(tmp_path_factory.mktemp("schema"))


def test_every_namelist_of_ours_is_valid(schema: Draft202012Validator) -> None:
    """As f90nml reads them."""
    paths = sorted((ROOT / "namelists").rglob("*.nml"))
    assert paths
    for path in paths:
        schema.validate(read(path.read_text()))


def test_what_f90nml_makes_of_an_index_is_valid(schema: Draft202012Validator) -> None:
    schema.validate(
        read(
            "&scan number(1:2) = 10, 20 /\n&run duration(1) = 5 engine(1) = 'collision' /\n"
            "&output final_state(1) = T /\n"
        )
    )


@pytest.mark.parametrize("ranges", [False, True])
@pytest.mark.parametrize("value", VALUES)
def test_the_schema_refuses_the_keys_that_the_program_refuses(
    tmp_path: Path, schema: Draft202012Validator, value: str, *, ranges: bool
) -> None:
    """For a type or a bound of their own; every key there is, and no other."""
    groups = schema.schema["properties"]
    names = {group: groups[group]["properties"] for group in groups}
    # A list and its range do not go together.
    left_out = {
        key if ranges else f"{key}_range"
        for key in names["scan"]
        if f"{key}_range" in names["scan"]
    }
    case: dict[str, Any] = {
        group: dict.fromkeys(names[group].keys() - (left_out if group == "scan" else set()), value)
        for group in groups
    }
    (tmp_path / "case.nml").write_text(namelist(**case))
    ended = run("--check", "case.nml", folder=tmp_path)
    assert "more; the last" not in ended.stderr
    told = re.findall(r"&(\w+) (\w+) = .*: (?:is|has|how many|begins) .*; allowed", ended.stderr)
    told += re.findall(r"&(\w+) (\w+) = .*; (?=allowed: numbers up to)", ended.stderr)
    refused = {
        tuple(error.absolute_path)[:2]
        for error in schema.iter_errors(read((tmp_path / "case.nml").read_text()))
    }
    assert refused == set(told)


# What the program says of a name, a type or a bound of a key; rules between keys have other words.
OWN = re.compile(r"(?:: (?:there is no such|is |has |how many|begins )|; allowed: numbers up to).*")


@given(drawn=data())
@settings(
    max_examples=int(os.environ.get("EXAMPLES", "15")), derandomize=True, database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.filter_too_much],
)  # fmt: skip
def test_drawn_namelists_are_refused_by_both_or_by_none(
    tmp_path: Path, schema: Draft202012Validator, drawn: DataObject
) -> None:
    """Unless the reason is a rule between keys. `EXAMPLES=5000` tries more, the same each time."""
    text = drawn.draw(namelists(schema.schema), label="namelist")
    (tmp_path / "case.nml").write_text(text)
    ended = run("--check", "case.nml", folder=tmp_path)
    own = OWN.search(ended.stderr)
    taken = schema.is_valid(read(text))
    event("taken" if taken else "refused")
    assert ended.returncode in (0, 2), ended.stderr
    assert taken or ended.returncode == 2, "only the schema refuses it"
    assert not (taken and own), "only the program refuses it"


def test_descriptions_have_unit_and_default(schema: Draft202012Validator) -> None:
    """And the meaning, what is allowed, and the paper's symbol."""
    width = schema.schema["properties"]["table"]["properties"]["channel1_width"]
    words = ["width of channel 1", "one number above 0", "unit: length", "paper: w", "default: 0.3"]
    assert all(word in width["description"] for word in words)

"""Kept answers of theories: believed only where they are whole, of this question, of this code."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import pytest

from postproc.theory import direction
from postproc.theory import kept as keeping
from postproc.theory.circuit import Circuit
from postproc.theory.gates import WINDOW
from postproc.theory.models import MODELS, describe
from postproc.theory.renewal import RENEWAL

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from postproc.theory.gates import Gate

BATTERY = Circuit(1000, 7)


@dataclass
class Asked:
    """A theory that counts how often it is asked."""

    times: int = 0

    def __call__(self) -> list[float]:
        """Answer."""
        self.times += 1
        return [0.5, 2.0]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    keeping._version.cache_clear()
    yield tmp_path / "battery" / "theory"
    keeping._version.cache_clear()


def test_who_was_asked_is_not_asked_again(place: Path) -> None:
    theory = Asked()
    answers = [keeping.kept("states", BATTERY, theory) for _ in range(3)]
    assert answers == [[0.5, 2.0]] * 3
    assert theory.times == 1
    keeping.kept("flows", BATTERY, theory)
    keeping.kept("states", Circuit(1000, 8), theory)
    assert theory.times == 3
    assert len(list(place.iterdir())) == 3


@pytest.mark.parametrize("gate", [WINDOW, RENEWAL])
def test_a_circuit_is_written_alike_in_each_process(gate: Gate) -> None:
    """The place of an object in memory is not part of the question."""
    assert f"gate={type(gate).__name__}()," in repr(replace(BATTERY, gate=gate))


def test_an_answer_of_which_a_digit_has_changed_is_made_again(place: Path) -> None:
    theory = Asked()
    keeping.kept("states", BATTERY, theory)
    (path,) = place.iterdir()
    path.write_text(path.read_text().replace("[0.5, 2.0]", "[0.7, 2.0]"))
    assert keeping.kept("states", BATTERY, theory) == [0.5, 2.0]
    assert theory.times == 2


@pytest.mark.parametrize(
    "text", ["", '{"asked": "states", "fou', "[1, 2]", "null", '{"found": [9.0]}', "\x00\x01"]
)
def test_a_damaged_answer_is_made_again(place: Path, text: str) -> None:
    theory = Asked()
    keeping.kept("states", BATTERY, theory)
    (path,) = place.iterdir()
    whole = path.read_bytes()
    path.write_text(text)
    assert keeping.kept("states", BATTERY, theory) == [0.5, 2.0]
    assert theory.times == 2
    assert path.read_bytes() == whole


def test_the_answer_to_another_question_is_not_believed(place: Path) -> None:
    theory = Asked()
    keeping.kept("states", BATTERY, theory)
    (path,) = place.iterdir()
    keeping.kept("other", BATTERY, lambda: [9.0])
    (other,) = set(place.iterdir()) - {path}
    other.replace(path)
    assert json.loads(path.read_text())["found"] == [9.0]
    assert keeping.kept("states", BATTERY, theory) == [0.5, 2.0]


def test_modules_of_the_theories_are_part_of_the_question(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    theory = Asked()
    keeping.kept("states", BATTERY, theory)
    (place.parent / "code").mkdir()
    (place.parent / "code" / "kept.py").write_text("other code")
    monkeypatch.setattr(keeping, "__file__", str(place.parent / "code" / "kept.py"))
    keeping._version.cache_clear()
    keeping.kept("states", BATTERY, theory)
    assert theory.times == 2


def test_what_cannot_be_kept_is_computed(place: Path) -> None:
    place.parent.parent.joinpath("battery").write_text("no folder")
    assert keeping.kept("states", BATTERY, Asked()) == [0.5, 2.0]


def test_whoever_asks_a_theory_that_takes_seconds_asks_once(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command, results and figures share what is kept."""
    circuit, model = Circuit(40, 2), MODELS["direction"]
    told = describe(circuit, model)
    assert place.is_dir()

    def again(*_: object) -> None:
        raise AssertionError("asked again")

    direction.scan.cache_clear()
    direction.held_states.cache_clear()
    monkeypatch.setattr(direction, "Directions", again)
    assert describe(circuit, model) == told
    assert [vars(one) for one in model.states(circuit)] == told["roots"]

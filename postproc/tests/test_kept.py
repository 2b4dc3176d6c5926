"""Kept answers of theories: believed only where they are whole, of this question, of this code."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import pytest

from postproc.theory import kept as keeping
from postproc.theory.circuit import Circuit
from postproc.theory.gates import WINDOW
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
    (tmp_path / "bin").mkdir()
    monkeypatch.setattr(keeping, "FOLDER", tmp_path / "bin")
    monkeypatch.setattr(keeping, "PLACE", tmp_path / "theory")
    keeping._version.cache_clear()
    yield tmp_path / "theory"
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
    assert f"gate={gate.name}," in repr(replace(BATTERY, gate=gate))


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


def test_another_program_is_asked_anew(place: Path) -> None:
    """What walkers are made of is part of the question, as are the modules of the theories."""
    theory = Asked()
    keeping.kept("states", BATTERY, theory)
    (keeping.FOLDER / "one_particle").write_bytes(b"of another build")
    keeping._version.cache_clear()
    keeping.kept("states", BATTERY, theory)
    assert theory.times == 2
    assert len(list(place.iterdir())) == 2


def test_modules_of_the_theories_are_part_of_the_question(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    theory = Asked()
    keeping.kept("states", BATTERY, theory)
    (place.parent / "kept.py").write_text("other code")
    monkeypatch.setattr(keeping, "__file__", str(place.parent / "kept.py"))
    keeping._version.cache_clear()
    keeping.kept("states", BATTERY, theory)
    assert theory.times == 2


def test_without_a_build_nothing_is_kept(place: Path) -> None:
    keeping.FOLDER.rmdir()
    assert keeping.kept("states", BATTERY, Asked()) == [0.5, 2.0]
    assert not place.exists()

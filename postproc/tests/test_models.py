"""The list of theories: the only one, read by whoever offers, asks, draws or prices them."""

from __future__ import annotations

import argparse
import ast
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from postproc.advice import advice
from postproc.figures.theories import add_models
from postproc.tests.commands import call
from postproc.theory.circuit import Circuit
from postproc.theory.model import Model
from postproc.theory.models import MODELS, defaults
from postproc.theory.outlines import regular
from postproc.theory.states import State

ROOT = Path(__file__).resolve().parents[2]
TWIN = replace(MODELS["renewal"], name="twin", label="the twin", adds_to="renewal")
WORDS = ["--number", "1000", "--threshold", "7", "--theory", "twin"]
SINGLE = Circuit(1000, 7, shape="urn", channel2_width=0.0)


@pytest.fixture
def twin(monkeypatch: pytest.MonkeyPatch) -> Model:
    """Return a theory that was added to the list, and to nothing else."""
    monkeypatch.setitem(MODELS, "twin", TWIN)
    return TWIN


@pytest.mark.parametrize("theory", MODELS)
@pytest.mark.parametrize("circuit", [
    Circuit(400, 4, channel2_width=0.02),
    Circuit(400, 4, channel2_width=0.02, gate2_threshold=12),
    Circuit(400, 4, channel2_width=0.02, urn2_radius=1.2),
    Circuit(400, 4, 0.5, 0.02, gate2_threshold=1000, urn2_radius=1.2),
])  # fmt: skip
def test_eta_is_zero_in_each_state(theory: str, circuit: Circuit) -> None:
    """`direction` interpolates its flows, which has an error of a few thousandths."""
    model = MODELS[theory]
    assert any(kind == "stable" for _, kind in model.zeros(circuit))
    for number, kind in model.zeros(circuit):
        levels = model.levels(circuit, State(number, kind, 0.0, 0.0))
        sent = levels["flow1_12"] + levels["flow2_12"]
        allowed = sent * (1e-9 if model.mixed else 5e-3)
        assert float(model.eta(circuit, number)) == pytest.approx(0.0, abs=allowed)
        away = 0.01 * float(circuit.number) * (1.0 if kind == "stable" else -1.0)
        assert model.eta(circuit, number - away) > allowed or number < away
        assert model.eta(circuit, number + away) < -allowed or number + away > circuit.number


@pytest.mark.usefixtures("twin")
def test_a_theory_that_is_added_to_the_list_is_known_everywhere(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert call("theory", [*WORDS, "--tricritical"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["roots"][0]["mass_spread"] == pytest.approx(0.93607, abs=1e-5)
    assert call("lifetimes", WORDS) == 0
    options = argparse.ArgumentParser()
    add_models(options)
    assert options.parse_args(["--theory", "twin"]).theory == ["twin"]
    asked = []
    monkeypatch.setattr(
        advice, "theory_says", lambda _, model, *__: asked.append(model.name) or (math.nan, 0.0)
    )
    circuit = Circuit(300, 3, 0.4, 0.02)
    found = advice.Pilot(0.9, 0.009, 0.0, 1000.0, 2000.0, 1.0, 0.05)
    advice.advise(advice.table_of(circuit), circuit, "chi", 0.02, found)
    assert asked == list(MODELS)


def test_no_other_module_lists_theories() -> None:
    """Nowhere do most of their names, or of their labels, stand in one list, dictionary or call."""
    known = [set(MODELS), {model.label for model in MODELS.values()}]
    for path in (ROOT / "postproc").rglob("*.py"):
        inside = path.relative_to(ROOT).parts
        if "tests" in inside or inside[-2:] == ("theory", "models.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.List | ast.Tuple | ast.Set | ast.Dict | ast.Call):
                texts = {one.value for one in ast.walk(node) if isinstance(one, ast.Constant)}
                most = max(len(texts & names) for names in known)
                assert most < 3, f"{path}:{node.lineno} lists theories"


def test_each_theory_is_called_unlike_the_others() -> None:
    assert all(name == model.name for name, model in MODELS.items())
    assert len({model.label for model in MODELS.values()}) == len(MODELS)


def test_what_a_theory_refuses_is_said_before_it_is_asked() -> None:
    unlike = Circuit(1000, 7, urn2_radius=1.2)
    for model in MODELS.values():
        assert bool(model.refusal(SINGLE)) != model.mixed
        assert bool(model.refusal(unlike)) == (model.unlike is None)


def test_the_default_theories_are_the_same_wherever_none_is_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The paper's beside memory, or beside the exact gate for many circuits, and polygons."""
    square = Circuit(1000, 7, outline=regular(4, 1.0))
    many = [Circuit(1000, 30, channel2_width=0.01 * width) for width in range(1, 14)]
    wide = Circuit(20, 2, 1.2, 1.0)  # of which direction finds no flows
    for circuits, better in ((many[:2] * 12, "direction"), (many, "renewal"),
                             ([square], "renewal"), ([SINGLE], "renewal"),
                             ([many[0], wide], "renewal")):  # fmt: skip
        assert [one.name for one in defaults(circuits)] == ["window", better]
    for command in ("theory", "lifetimes"):
        printed = {}
        for named in ([], ["--theory", "window"], ["--theory", "direction"]):
            assert call(command, ["--number", "60", "--threshold", "2", *named]) == 0
            printed[" ".join(named)] = json.loads(capsys.readouterr().out)
        paper, memory = printed["--theory window"], printed["--theory direction"]
        assert printed[""] == paper | {"direction": memory}


@pytest.mark.parametrize(
    ("threshold", "number2", "reached"),
    [(2, 500, 0.0), (2, 1000, 0.9), (2, 740, 0.0), (7, 500, 0.93), (16, 0, 0.75)],
)
def test_a_theory_reaches_the_stable_state_of_its_own_drift(
    threshold: int, number2: float, reached: float
) -> None:
    """From a start in the basin of one of two states, and from an unstable state."""
    circuit, model = Circuit(1000, threshold, channel2_width=0.01), MODELS["window"]
    state = model.reached(circuit, number2)
    assert state.mass_spread == pytest.approx(reached, abs=0.1)
    place = number2 + (1e-3 if model.homogeneous_kind(circuit) == "unstable" else 0.0)
    for _ in range(20_000):
        place += 20.0 * float(model.eta(circuit, place))
    assert abs(place - 500.0) + 500.0 == pytest.approx(state.urn2_number, abs=0.5)

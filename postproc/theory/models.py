"""The theories by name, each declared once, for command lines, figures and benchmarks.

They are in the order of cost. For the fields of a declaration see `model.Model`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from postproc.cli import InputError, finite
from postproc.theory import direction, ports, settling
from postproc.theory.gates import WINDOW
from postproc.theory.model import Model
from postproc.theory.renewal import RENEWAL
from postproc.theory.states import Theory

if TYPE_CHECKING:
    from postproc.theory.circuit import Circuit


def _no_line(_: Circuit) -> float:
    return math.nan


def _of_ports(circuit: Circuit) -> dict[str, object]:
    """Return the ports of an urn or, if they are unequal, of urns 1 and 2."""
    found = [ports.disc(side) for side in circuit.sides]
    names = ("return_chance", "stay1", "stay2")
    return {name: _of_sides(circuit, [getattr(one, name) for one in found]) for name in names}


def _of_sides(circuit: Circuit, values: list[float]) -> float | list[float]:
    """Return a value of urn 1 and of urn 2, one if urns and gates are equal."""
    return values[0] if circuit.alike else values


_MIXED_UNLIKE = Theory(transition_width=_no_line)
_DIRECTIONS = Theory(
    direction.stationary_states, direction.homogeneous_kind, _no_line, direction.outflows,
    settling.passages, direction.flows, direction.growth,
)  # fmt: skip
DECLARED = (
    Model(
        "window", "window (the paper's)", "the paper's gate, a window of fixed time",
        "where a circuit may polarise; the paper's results", 1e-3, "--",
        changes={"gate": WINDOW}, unlike=_MIXED_UNLIKE, mixed=True,
    ),
    Model(
        "renewal", "renewal gate", "the gate's exact rule",
        "the upper transition in milliseconds; the single urn", 3e-3, "-.",
        "window", {"gate": RENEWAL}, unlike=_MIXED_UNLIKE, mixed=True,
    ),
    Model(
        "direction", "directions", "exact gates, memory of the opening and direction of entry",
        "chi, currents and transitions alike; lifetimes", 1.0, ":", "renewal",
        {"gate": RENEWAL}, _DIRECTIONS, _DIRECTIONS, extras=_of_ports,
        aged=True, widest=1.0,
    ),
)  # fmt: skip
MODELS = {model.name: model for model in DECLARED}
FEW = 12  # circuits for which memory is computed unasked: about a second each


def defaults(circuits: Iterable[Circuit]) -> tuple[Model, ...]:
    """Return the two theories that are given beside these circuits where none is named.

    The paper's, and memory; the exact gate in its place if there are more than `FEW` different
    circuits, or if it does not apply to one of them, or does not find its states. None if there are
    discs in channel 2, which no theory has.
    """
    asked = set(circuits)
    if any(one.scatterers for one in asked):
        return ()
    better = MODELS["direction"]
    if len(asked) > FEW or not all(map(better.answers_for, asked)):
        better = MODELS["renewal"]
    return MODELS["window"], better


def left_out(circuits: Iterable[Circuit]) -> str:
    """Return a remark on the theory that `defaults` leaves out of many circuits, "" of few."""
    asked = set(circuits)
    if len(asked) <= FEW or any(map(MODELS["direction"].refusal, asked)):
        return ""
    return f"of more than {FEW} points direction is left out (--theory direction adds it)"


def named(names: str | Iterable[str], circuits: Iterable[Circuit] = ()) -> tuple[Model, ...]:
    """Return theories by their names, one or several.

    Raises `InputError` if there is none of a name, or if one does not apply to a circuit.
    """
    found, asked = [], set(circuits)
    for name in names if isinstance(names, Iterable) and not isinstance(names, str) else [names]:
        if not (isinstance(name, str) and name in MODELS):
            raise InputError(f"there is no theory {name!r}; there are {', '.join(MODELS)}")
        if refused := next((one for one in map(MODELS[name].refusal, asked) if one), ""):
            able = [one for one in MODELS if not any(map(MODELS[one].refusal, asked))]
            raise InputError(f"{refused}; these apply: {', '.join(able) or 'none'}")
        found.append(name)
    return tuple(MODELS[name] for name in dict.fromkeys(found))


def ancestry(name: str) -> tuple[str, ...]:
    """Return a theory's name after those whose physics it contains, the simplest first."""
    before = MODELS[name].adds_to
    return (*ancestry(before), name) if before else (name,)


def describe(circuit: Circuit, model: Model) -> dict[str, object]:
    """Return a model's results for one circuit, as the command line prints them."""
    own, theory = model.of(circuit), model.theory_of(circuit)
    return finite(
        {
            "homogeneous": model.homogeneous_kind(circuit) or None,
            "roots": [
                {name: value for name, value in vars(state).items() if value is not None}
                for state in model.states(circuit)
            ],
            "transition_width": theory.transition_width(own),
            "urn_area": _of_sides(own, [float(side.urn_area) for side in own.sides]),
            **model.extras(own),
        }
    )

"""Theories that are not on the menu of `postproc.theory.models`, since a better one is.

`two_port` is a part of `direction`: memory of the opening of entry alone. `renewal_occupation` has
exact gates between well mixed urns, and counts particles in the channels.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from postproc import circuits
from postproc.theory import two_port
from postproc.theory.circuit import PAPERS_AGE, transition_width
from postproc.theory.models import MODELS, describe
from postproc.theory.states import Theory

if TYPE_CHECKING:
    from postproc.theory.circuit import Circuit


def _line_of_two_ports(circuit: Circuit) -> float:
    return two_port.transition_width(circuit, transition_width(circuit))


_PORTS = Theory(
    two_port.stationary_states, two_port.homogeneous_kind, _line_of_two_ports, two_port.outflows,
    flows=two_port.flows, growth=two_port.growth,
)  # fmt: skip
_COUNTED = MODELS["direction"].changes
_OTHERS = (
    replace(
        MODELS["renewal"], name="renewal_occupation", label="renewal gate with channels",
        meaning="as `renewal`, and particles in the channels taken into account", seconds=0.03,
        dashes=":", mark="*", colour="brown", adds_to="renewal", changes=_COUNTED,
    ),
    replace(
        MODELS["direction"], name="two_port", label="two ports",
        meaning="exact gates, and memory of the opening of entry", seconds=0.3, dashes="-.",
        mark="P", colour="purple", theory=_PORTS,
        unlike=replace(_PORTS, transition_width=MODELS["direction"].theory.transition_width),
    ),
)  # fmt: skip
THEORIES = MODELS | {model.name: model for model in _OTHERS}


def told(name: str, age: float | None = None, **keys: object) -> dict[str, object]:
    """Return what the command `theory` would print of a circuit, given by its keys."""
    circuit = circuits.Circuit(**keys).model(PAPERS_AGE if age is None else age)
    return describe(circuit, THEORIES[name])

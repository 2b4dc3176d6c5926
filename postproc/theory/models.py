"""The theories by name: what each makes of a circuit, and what it says of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from postproc.cli import finite
from postproc.theory import direction, one_particle, ports, settling, two_port
from postproc.theory.circuit import transition_width
from postproc.theory.gates import WINDOW
from postproc.theory.renewal import RENEWAL
from postproc.theory.states import WELL_MIXED, Theory

if TYPE_CHECKING:
    from collections.abc import Callable

    from postproc.theory.circuit import Circuit


def _no_extras(_: Circuit) -> dict[str, object]:
    return {}


@dataclass(frozen=True)
class Model:
    """A theory as it is asked for by name.

    Attributes
    ----------
    meaning : what it is, in a line.
    changes : what it makes of a circuit, fields by name.
    theory : what it says of circuits with equal urns and gates.
    unlike : what it says of others.
    extras : what it prints besides.
    """

    meaning: str
    changes: dict[str, object]
    theory: Theory
    unlike: Theory
    extras: Callable[[Circuit], dict[str, object]] = _no_extras

    def of(self, circuit: Circuit) -> tuple[Circuit, Theory]:
        """Return the circuit as the model has it, and what answers about it."""
        circuit.need_empty_channels()
        return replace(circuit, **self.changes), self.theory if circuit.alike else self.unlike


def _no_line(_: Circuit) -> float:
    return math.nan


def _line_of_two_ports(circuit: Circuit) -> float:
    return two_port.transition_width(circuit, transition_width(circuit))


def _of_ports(circuit: Circuit) -> dict[str, object]:
    """Return what the urns remember, of an urn or, if they are unlike, of urns 1 and 2."""
    found = [ports.disc(side) for side in circuit.sides]
    names = {"return_chance": "return_chance", "stay1": "stay1", "stay2": "stay2"}
    if circuit.alike:
        return {name: getattr(found[0], field) for name, field in names.items()}
    return {name: [getattr(one, field) for one in found] for name, field in names.items()}


def _walked_kind(circuit: Circuit) -> str:
    """Return what becomes of equal shares: walkers tell, of equal urns that are open to each."""
    if circuit.alike and float(circuit.channel2_width) > 0.0 and float(circuit.threshold) > 0.0:
        return one_particle.homogeneous_kind(circuit)
    return two_port.homogeneous_kind(circuit)


_MIXED_UNLIKE = Theory(
    states=partial(two_port.stationary_states, memory=ports.well_mixed),
    homogeneous_kind=partial(two_port.homogeneous_kind, memory=ports.well_mixed),
    transition_width=_no_line,
    outflows=partial(two_port.outflows, memory=ports.well_mixed),
)
_PORTS = Theory(
    two_port.stationary_states, two_port.homogeneous_kind, _line_of_two_ports, two_port.outflows
)
_DIRECTIONS = Theory(
    direction.stationary_states, direction.homogeneous_kind, _no_line, direction.outflows,
    settling.passages,
)  # fmt: skip
_WALKERS = Theory(
    one_particle.stationary_states, _walked_kind, _no_line, two_port.outflows
)
_COUNTED = {"gate": RENEWAL, "occupation": True}

MODELS = {
    "window": Model("the paper's gate, a window of time tau", {"gate": WINDOW}, WELL_MIXED,
                    _MIXED_UNLIKE),
    "renewal": Model("the gate's own rule", {"gate": RENEWAL}, WELL_MIXED, _MIXED_UNLIKE),
    "two_port": Model("and urns that know by which opening one came, and circulation", _COUNTED,
                      _PORTS, replace(_PORTS, transition_width=_no_line), _of_ports),
    "direction": Model("and in which direction", _COUNTED, _DIRECTIONS, _DIRECTIONS),
    "one_particle": Model("walkers between gates made of all the others", _COUNTED, _WALKERS,
                          _WALKERS),
}  # fmt: skip


def describe(circuit: Circuit, model: Model) -> dict[str, object]:
    """Return what a model says of one circuit, as the command line prints it."""
    circuit, theory = model.of(circuit)
    return finite(
        {
            "homogeneous": theory.homogeneous_kind(circuit),
            "roots": [
                {name: value for name, value in vars(state).items() if value is not None}
                for state in theory.states(circuit)
            ],
            "transition_width": theory.transition_width(circuit),
            "urn_area": _area(circuit),
            **model.extras(circuit),
        }
    )


def _area(circuit: Circuit) -> float | list[float]:
    areas = [float(side.urn_area) for side in circuit.sides]
    return areas[0] if circuit.alike else areas

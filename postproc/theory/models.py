"""The theories by name, each declared once, for command lines, figures and benchmarks.

They are in the order of cost. For the fields of a declaration see `model.Model`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from postproc.cli import finite
from postproc.theory import chain, direction, one_particle, ports, settling, two_port
from postproc.theory.circuit import transition_width
from postproc.theory.gates import WINDOW
from postproc.theory.model import Model
from postproc.theory.renewal import RENEWAL
from postproc.theory.states import Theory

if TYPE_CHECKING:
    from postproc.theory.circuit import Circuit


def _no_line(_: Circuit) -> float:
    return math.nan


def _line_of_two_ports(circuit: Circuit) -> float:
    return two_port.transition_width(circuit, transition_width(circuit))


def _of_ports(circuit: Circuit) -> dict[str, object]:
    """Return the ports of an urn or, if they are unequal, of urns 1 and 2."""
    found = [ports.disc(side) for side in circuit.sides]
    names = {"return_chance": "return_chance", "stay1": "stay1", "stay2": "stay2"}
    if circuit.alike:
        return {name: getattr(found[0], field) for name, field in names.items()}
    return {name: [getattr(one, field) for one in found] for name, field in names.items()}


def _walked_kind(circuit: Circuit) -> str:
    """Return the kind of the homogeneous state by walkers, for equal urns with open channels."""
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
    two_port.stationary_states, two_port.homogeneous_kind, _line_of_two_ports, two_port.outflows,
    flows=two_port.flows, growth=two_port.growth,
)  # fmt: skip
_DIRECTIONS = Theory(
    direction.stationary_states, direction.homogeneous_kind, _no_line, direction.outflows,
    settling.passages, direction.flows, direction.growth,
)  # fmt: skip
_WALKERS = Theory(one_particle.stationary_states, _walked_kind, _no_line, flows=one_particle.flows)
_COUNTED = {"gate": RENEWAL, "occupation": True}
_CHAIN_TO = 3000.0  # N; a state of 10000 takes 1.6 s, and time grows faster than N

DECLARED = (
    Model(
        "window", "window (the paper's)", "the paper's gate, a window of fixed time",
        "where a circuit may polarise; the paper's results", 1e-3, "--", "P",
        "vermilion", changes={"gate": WINDOW}, unlike=_MIXED_UNLIKE, mixed=True,
    ),
    Model(
        "renewal", "renewal gate", "the gate's exact rule",
        "the upper transition in milliseconds; the single urn", 3e-3, "-.", "X", "orange",
        "window", {"gate": RENEWAL}, unlike=_MIXED_UNLIKE, mixed=True,
    ),
    Model(
        "renewal_occupation", "renewal gate with channels",
        "as `renewal`, and particles in the channels taken into account",
        "the effect of exact gates between urns without memory", 0.03, ":", "*", "brown",
        "renewal", _COUNTED, unlike=_MIXED_UNLIKE, mixed=True,
    ),
    Model(
        "renewal_chain", "renewal chain",
        "as `renewal_occupation`, averaged over the fluctuations of N2",
        "the same where fluctuations matter: small N, next to a transition", 0.04,
        (0, (4, 1, 1, 1, 1, 1)), "v", "olive",
        "renewal_occupation", _COUNTED, Theory(chain.mean_state), largest=_CHAIN_TO,
    ),
    Model(
        "two_port", "two ports",
        "as `renewal_occupation`, with memory of the opening of entry, and circulation",
        "net currents well inside the polarised region, and their growth with time", 0.3, "-.",
        "P", "purple",
        "renewal_occupation", _COUNTED, _PORTS, replace(_PORTS, transition_width=_no_line),
        extras=_of_ports, aged=True,
    ),
    Model(
        "direction", "directions", "as `two_port`, with memory of the direction of entry",
        "chi, currents and transitions alike; lifetimes", 1.0, "-", "X", "violet",
        "two_port", _COUNTED, _DIRECTIONS, _DIRECTIONS, aged=True,
    ),
    Model(
        "one_particle", "one particle",
        "simulated independent particles; each gate counts particles of independent copies",
        "the most accurate numbers without a run; they have statistical errors", 1.0, "-", "*",
        "navy", "direction", _COUNTED, _WALKERS, _WALKERS, draws=True, program="one_particle",
    ),
)  # fmt: skip
MODELS = {model.name: model for model in DECLARED}


def guide() -> list[str]:
    """Return the lines of a table of all theories and their use, in Markdown."""
    lines = ["| `--model` | label | what it is | time per state | also computes | use it for |",
             "| --- | --- | --- | --- | --- | --- |"]  # fmt: skip
    for one in MODELS.values():
        seconds = f"{1e3 * one.seconds:g} ms" if one.seconds < 1.0 else f"{one.seconds:g} s"
        limit = f" (N up to {one.largest:g})" if one.largest < math.inf else ""
        cells = (f"`{one.name}`", one.label, one.meaning + limit, seconds,
                 ", ".join(one.answers), one.use)  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def ancestry(name: str) -> tuple[str, ...]:
    """Return a theory's name after those whose physics it contains, the simplest first."""
    before = MODELS[name].adds_to
    return (*ancestry(before), name) if before else (name,)


def describe(circuit: Circuit, model: Model) -> dict[str, object]:
    """Return a model's results for one circuit, as the command line prints them."""
    own, theory = model.of(circuit), model.theory_of(circuit)
    return finite(
        {
            "homogeneous": theory.homogeneous_kind(own),
            "roots": [
                {name: value for name, value in vars(state).items() if value is not None}
                for state in theory.states(own)
            ],
            "transition_width": theory.transition_width(own),
            "urn_area": _area(own),
            **model.extras(own),
        }
    )


def _area(circuit: Circuit) -> float | list[float]:
    areas = [float(side.urn_area) for side in circuit.sides]
    return areas[0] if circuit.alike else areas

"""Theories that are not on the menu of `postproc.theory.models`, since a better one is.

Both have exact gates and count particles in the channels. `two_port` is a part of `direction`:
memory of the opening of entry alone. In `renewal_occupation` the urns are well mixed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

from postproc import circuits
from postproc.theory import ports
from postproc.theory.circuit import PAPERS_AGE, transition_width
from postproc.theory.models import MODELS, describe
from postproc.theory.states import Theory
from studies.common import two_port

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model
    from studies.common.two_port import Memory

    Floats = NDArray[np.float64]

WIDTHS_TRIED = 24  # of channel 2, at which a transition is searched for


def _flows(circuit: Circuit, number2: float, memory: Memory) -> Floats:
    """Return the flows of channels 1 and 2 from urn 1 to 2 and back at N2 = `number2`.

    Per unit time, shape (channel, way); without circulation.
    """
    at = two_port.with_number2(circuit, number2, memory)
    return np.stack([at.through[:, 0], at.across[:, 0]])


def _transition_width(circuit: Circuit, memory: Memory) -> float:
    """Return the w' at which equal urns' homogeneous state becomes stable, NaN without one.

    The search begins around that of the paper's theory.
    """
    start = transition_width(circuit)
    diameter = 2.0 * float(circuit.urn_radius)

    def at(width: float) -> float:
        return two_port.growth(replace(circuit, channel2_width=width), memory)

    if float(circuit.threshold) == 0.0:
        return 0.0  # any open channel 2 brings both urns to equal densities
    if at(0.0) <= 0.0:
        return math.nan
    widths = np.geomspace(1e-3, 0.99, WIDTHS_TRIED) * diameter
    near = start * np.array([0.5, 0.8, 1.25, 2.0])
    tried = [near] if math.isfinite(start) else []
    for candidates in (*tried, np.concatenate([[0.0], widths])):
        places = candidates[candidates < diameter]
        values = [at(width) for width in places]
        for k in range(len(values) - 1):
            if values[k] > 0.0 >= values[k + 1]:
                return float(optimize.brentq(at, places[k], places[k + 1], rtol=1e-6))
    return math.nan


def _model(memory: Memory, **names: object) -> Model:
    """Return the theory of two urns with this memory, and exact gates."""
    alike = Theory(
        partial(two_port.stationary_states, memory=memory),
        partial(two_port.homogeneous_kind, memory=memory),
        partial(_transition_width, memory=memory),
        partial(two_port.outflows, memory=memory),
        flows=partial(_flows, memory=memory),
        growth=partial(two_port.growth, memory=memory),
    )
    no_line = MODELS["direction"].theory.transition_width
    unlike = replace(alike, transition_width=no_line)
    return replace(MODELS["direction"], theory=alike, unlike=unlike, **names)


_OTHERS = (
    _model(
        ports.well_mixed, name="renewal_occupation", label="renewal gate with channels",
        meaning="as `renewal`, and particles in the channels taken into account", seconds=0.1,
        dashes="-", aged=False, extras=MODELS["renewal"].extras,
    ),
    _model(
        ports.disc, name="two_port", label="two ports",
        meaning="exact gates, and memory of the opening of entry", seconds=0.3, dashes="-.",
    ),
)  # fmt: skip
THEORIES = MODELS | {model.name: model for model in _OTHERS}


def told(name: str, age: float | None = None, **keys: object) -> dict[str, object]:
    """Return what the command `theory` would print of a circuit, given by its keys."""
    circuit = circuits.Circuit(**keys).model(PAPERS_AGE if age is None else age)
    return describe(circuit, THEORIES[name])

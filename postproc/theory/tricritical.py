"""Order of the transition of equal, well mixed urns with renewal gates: continuous or a jump.

Let f(n) be the flow of an urn with n of the particles to the other. The states of equal urns are
f(N/2 - d) = f(N/2 + d), or f'(N/2) d + f'''(N/2) d^3/6 + ... = 0. The homogeneous state is unstable
where f' < 0, d = 0. If f''' > 0 where f' vanishes, polarised states begin there with d = 0 and
exist where f' < 0: the transition is continuous. If f''' < 0 they exist also where the homogeneous
state is still stable, so there is a jump, and hysteresis. In between is the tricritical point, f' =
f''' = 0.

With J(x) = x q(x), x the load of the gate, f is J plus the flow of channel 2. The latter is linear
in n and drops out of f''': the order depends on T and the load only, the same for any Ohmic channel
2, and f' = 0 is J' = -w'/w. (If particles in the channels are counted f is a function of them as
well.)

It holds for small d only. From about T = 50 up, at small loads, a polarised state with large d is
stable beside the homogeneous one although f''' > 0; `order` calls that continuous.

This is mean field: fluctuations at finite N smooth a jump.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import Chebyshev
from scipy import optimize

from postproc.cli import InputError
from postproc.theory.circuit import flow1, flow2, gate_load, transition_width

if TYPE_CHECKING:
    from postproc.theory.circuit import Circuit

REACH, DEGREE = 0.05, 10  # of the polynomial through f about N/2, whose derivatives are taken
LOADS = np.geomspace(0.5, 6.0, 16)  # over T, of gates at N/2, between which it is searched for


@dataclass(frozen=True)
class Tricritical:
    """The point at which the transition changes from a jump to continuous, for one T, w, l and r.

    Attributes
    ----------
    number : N.
    channel2_width : w'.
    load_per_threshold : load of either gate over T.
    """

    number: float
    channel2_width: float
    load_per_threshold: float


def slopes(circuit: Circuit) -> tuple[float, float, float]:
    """Return N f', N^2 f'' and N^3 f''' over f, at N/2.

    By a polynomial through f at Chebyshev nodes, as accurate as f is smooth.
    """
    half = 0.5 * float(circuit.number)
    around = Chebyshev.interpolate(
        lambda number: flow1(circuit, number) + flow2(circuit, number),
        DEGREE,
        [half * (1.0 - REACH), half * (1.0 + REACH)],
    )
    scale = 1.0 / float(around(half))
    one, two, three = (
        scale * float(circuit.number) ** k * float(around.deriv(k)(half)) for k in (1, 2, 3)
    )
    return one, two, three


def cubic(circuit: Circuit) -> float:
    """Return N^3 f'''/f at the transition of a circuit, NaN without one; w' is not used.

    Above 0 the transition is continuous, below 0 it is a jump.
    """
    width = transition_width(circuit)
    if not width > 0.0:
        return math.nan
    return slopes(replace(circuit, channel2_width=width))[2]


def order(circuit: Circuit) -> str | None:
    """Return "continuous" or "jump", of the transition at this N, T, w; None without one."""
    found = cubic(circuit)
    return None if math.isnan(found) else "continuous" if found >= 0.0 else "jump"


def tricritical(circuit: Circuit) -> Tricritical | None:
    """Return the tricritical point at this T, w, l and r, None if there is none.

    `number` and `channel2_width` are not used.

    Raises `InputError` if the urns or gates are unequal, which have no homogeneous state.
    """
    if not circuit.alike:
        raise InputError("a tricritical point is of equal urns and gates")
    if float(circuit.threshold) == 0.0:
        return None
    empty = replace(circuit, channel2_width=0.0)
    numbers = 2.0 * LOADS * float(circuit.threshold) / float(empty.load_per_particle)

    def at(number: float) -> float:
        return cubic(replace(circuit, number=number))

    values = [at(number) for number in numbers]
    for (low, high), (few, many) in zip(pairwise(values), pairwise(numbers), strict=True):
        if low > 0.0 > high:
            number = float(optimize.brentq(at, few, many, rtol=1e-9))
            width = transition_width(replace(circuit, number=number))
            there = replace(circuit, number=number, channel2_width=width)
            load = float(gate_load(there, 0.5 * number))
            return Tricritical(number, width, load / float(circuit.threshold))
    return None

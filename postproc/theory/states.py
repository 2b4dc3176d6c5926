"""All stationary states of a circuit: the zeros of eta, eq. (eq007), each with its kind.

Zeros are searched for in d = N2 - N/2 > 0 by g(d) = log f(N1) - log f(N2), which has the sign of
eta and does not underflow. f has a large curvature only where the load of a gate is near its
threshold, over a width of its square root, so points there, at equal steps, and on a logarithmic
scale towards both ends bracket every zero; minima of |g| in between are computed for pairs that are
closer. Of unequal urns or gates g is f of urn 1 over its area less f of urn 2, and all N2 from 0
to N are searched.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

from postproc.theory.circuit import (
    NEAREST,
    Circuit,
    homogeneous_kind,
    log_outflow,
    net_current2,
    transition_width,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    Balance = Callable[[ArrayLike], NDArray[np.float64]]

    Passages = Callable[[int, int], float]
    Outflows = Callable[[Circuit], tuple[NDArray[np.float64], NDArray[np.float64]]]


@dataclass(frozen=True)
class State:
    """A stationary state, of equal urns and gates with N2 > N/2 (its mirror image is one too).

    Attributes
    ----------
    urn2_number : N2.
    kind : "stable" or "unstable".
    mass_spread : chi = |N1 - N2|/N.
    net_current : of channel 1 from urn 1 to urn 2, and back through channel 2 (per unit time), in a
        run of the circuit's age.
    circulating_current : the part of circulating particles, which have no wall hit in an urn; None
        if the theory does not have it.
    net_current_infinite_age : the net current that no run reaches, of circulations of ever more
        rounds; None if it does not depend on the age.
    net_current_error : standard error if the theory uses random numbers.
    """

    urn2_number: float
    kind: str
    mass_spread: float
    net_current: float
    circulating_current: float | None = None
    net_current_infinite_age: float | None = None
    net_current_error: float | None = None

    def polarised_current(self, number: ArrayLike) -> float:
        """Return the current of channel 2 from the fuller half to the emptier, of N particles."""
        fuller = np.greater_equal(2.0 * self.urn2_number, number)
        return self.net_current if fuller else -self.net_current


def stationary_states(circuit: Circuit) -> list[State]:
    """Return all states of a circuit with scalar fields, by increasing N2.

    Of equal urns and gates those with N2 > N/2.
    """
    half = 0.5 * float(np.asarray(circuit.number))
    one, two = circuit.sides
    if float(circuit.channel2_width) == one.threshold == two.threshold == 0.0:
        return []  # nothing flows
    larger = np.log(one.urn_area / two.urn_area)

    def balance(first: ArrayLike) -> NDArray[np.float64]:
        some = np.asarray(first, float)
        return log_outflow(one, some) - log_outflow(two, 2.0 * half - some) - larger

    # N1, decreasing from N/2 to 0, or from N
    places = places_of(one, half) if circuit.alike else places_of_unequal(circuit)
    values = balance(places)
    if circuit.alike and values[0] == 0.0:
        values[0] = -1.0  # as `homogeneous_kind`
    roots = crossings(balance, places, values)
    if values[-1] > 0.0:
        roots.append((0.0, "stable"))  # N1 underflows: all particles in one urn
    if values[0] < 0.0 and not circuit.alike:
        roots.insert(0, (2.0 * half, "stable"))  # N2 does
    return [_state(circuit, 2.0 * half, first, kind) for first, kind in roots]


def places_of(circuit: Circuit, half: float) -> NDArray[np.float64]:
    """Return N1 at which g is evaluated, from just below N/2 down to 0."""
    threshold = float(circuit.threshold)
    per_particle = float(circuit.load_per_particle)
    bend = threshold + 1.0 + np.sqrt(threshold + 1.0) * np.linspace(-9.0, 9.0, 181)
    bend = bend / per_particle
    near_half = half * (1.0 - np.geomspace(NEAREST, 0.5, 60))
    near_empty = np.geomspace(1e-300, 1.0, 200) * half
    even = np.linspace(0.0, half, 401)[1:-1]
    inside = np.concatenate([bend, 2.0 * half - bend, near_half, near_empty, even])
    first = half * (1.0 - NEAREST)
    inside = inside[(inside > 0.0) & (inside < first)]
    return np.concatenate([[first], np.unique(inside)[::-1]])


def places_of_unequal(circuit: Circuit) -> NDArray[np.float64]:
    """Return N1 at which g is evaluated if urns or gates differ, from just below N to 0."""
    half = 0.5 * float(circuit.number)
    above, below = (places_of(side, half) for side in circuit.sides)
    found = np.unique(np.concatenate([above, [half], 2.0 * half - below]))[::-1]
    return found[(found > 0.0) & (found < 2.0 * half)]


def crossings(
    balance: Balance, places: NDArray[np.float64], values: NDArray[np.float64]
) -> list[tuple[float, str]]:
    """Return (N1, kind) of the zeros of `balance`, searched for between `places`, N1 decreasing.

    `values` are those of `balance` there.
    """
    places, values = _with_close_pairs(balance, places, values)
    places, values = places[values != 0.0], values[values != 0.0]  # some are, by rounding
    roots: list[tuple[float, str]] = []
    for at in np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0.0):
        high, low = places[at], places[at + 1]
        first = optimize.brentq(balance, low, high, xtol=1e-300, rtol=1e-14, maxiter=500)
        roots.append((float(first), "stable" if values[at] > 0.0 else "unstable"))
    return sorted(roots, reverse=True)


def _with_close_pairs(
    balance: Balance, places: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Add the minima of |g| between places of one sign, where g may dip through zero and back."""
    size = np.abs(values)
    same = (np.sign(values[:-2]) == np.sign(values[1:-1])) & (
        np.sign(values[2:]) == np.sign(values[1:-1])
    )
    flat = (size[1:-1] == size[:-2]) & (size[1:-1] == size[2:])
    dips = np.flatnonzero(same & ~flat & (size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:])) + 1
    extra = []
    for at in dips:
        sign = np.sign(values[at])
        if sign == 0.0 or not np.isfinite(size[at]):
            continue
        found = optimize.minimize_scalar(
            lambda first, sign=sign: sign * float(balance(first)),
            bounds=(places[at + 1], places[at - 1]),
            method="bounded",
            options={"xatol": 1e-10 * places[at - 1]},
        )
        if found.fun < 0.0:
            extra.append(float(found.x))
    if not extra:
        return places, values
    places = np.concatenate([places, extra])
    values = np.concatenate([values, balance(np.array(extra))])
    order = np.argsort(places)[::-1]
    return places[order], values[order]


def _state(circuit: Circuit, number: float, first: float, kind: str) -> State:
    second = number - first
    current = float(net_current2(circuit, second))
    return State(second, kind, abs(2.0 * second - number) / number, current)


@dataclass(frozen=True)
class Theory:
    """The functions of a theory of a circuit.

    Attributes
    ----------
    states : all its stationary states, `State`s.
    homogeneous_kind : "stable", "unstable" or "neutral", of the state with equal densities.
    transition_width : w' of the transition line, NaN without one.
    outflows : N2, shape (case,), and the logarithms of the flows of halves 1 and 2 to each other,
        shape (half, case); None: `circuit.log_outflow`.
    passages : mean time from one |N2 - N/2| to another, as `chain.passages`, for urns that relax
        more slowly than N2; None: that of a chain with these outflows.
    flows : flows of channels 1 and 2 from urn 1 to 2 and back at an N2, shape (channel, way); None:
        `circuit.flow1` and `flow2`.
    growth : a number that is positive if the homogeneous state is unstable; None: it has none.
    """

    states: Callable[[Circuit], list[State]] = stationary_states
    homogeneous_kind: Callable[[Circuit], str] = homogeneous_kind
    transition_width: Callable[[Circuit], float] = transition_width
    outflows: Outflows | None = None
    passages: Callable[[Circuit], Passages] | None = None
    flows: Callable[[Circuit, float], NDArray[np.float64]] | None = None
    growth: Callable[[Circuit], float] | None = None


WELL_MIXED = Theory()

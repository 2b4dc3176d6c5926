"""States of two ports with circulation in the balance: what it changes of the numbers in the urns.

postproc/theory/circulation.py adds the circulating current to a state. Here the flows that cross
an urn straight, more than two ports have (`down` from channel 1 to channel 2, `up` the other way),
are part of the balance. With b_i what channel 1 brings into urn i, c_i = f_j what channel 2 brings,
S_i = (1 - P12) down_i - a up_i, d the way across an urn, and q' the share of the shortest stay:

    e_i = (1 - P12) b_i + (1 - a) c_i - S_i            f_i = P12 b_i + a c_i + S_i
    n_i = t1 b_i + t2 c_i - (t1 - d) down_i - (t2 - d) up_i
    gate i lets through q_i (e_i - up_i) + q'_i up_i, at load (e_i - up_i) pi l/4 + up_i l/2

since who crosses an urn straight is there for d, and who enters a gate along the axis is there for
l/2. A state is where the gates send as much as channel 2 brings back, with all N particles held;
walls send e_i - up_i and f_i - down_i, from which `down` and `up` are found again. No fitted
number; without `down` and `up` this is `two_port`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

from postproc.theory import circulation, ports
from studies.common.theories import THEORIES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.states import State

    Floats = NDArray[np.float64]

ITERATIONS = 12  # at most, of states and what circulates in them
AGREED = 1e-9  # change of N2, relative to N, at which it ends
APART = (1.02, 1.1, 1.25, 1.5, 2.0)  # factors of the emptier urn's share, to look for a state


@dataclass(frozen=True)
class Passing:
    """What crosses urns straight per unit time, more than two ports have, shape (urn,).

    Attributes
    ----------
    down, up : from channel 1 to channel 2, and from channel 2 to channel 1.
    share : q', of the gates for the shortest stay.
    """

    down: Floats
    up: Floats
    share: Floats


@dataclass(frozen=True)
class Found:
    """A state: the halves' numbers and the current of channel 2 from urn 2 to urn 1."""

    halves: Floats
    net_current: float
    passing: Passing

    @property
    def mass_spread(self) -> float:
        """Spread chi = |N1 - N2|/N."""
        return float(abs(self.halves[0] - self.halves[1]) / self.halves.sum())


NOTHING = Passing(np.zeros(2), np.zeros(2), np.ones(2))


def passing(
    circuit: Circuit, entries: Floats, across: Floats, age: float, seed: int = circulation.FIRST
) -> Passing:
    """Return what crosses urns straight at an age, if walls send `entries` and `across`."""
    straight = circulation.followed(circuit, entries, across, seed=seed)
    rounds = np.asarray(age / circulation.round_time(circuit))
    total = np.zeros((2, 2))
    for start in (0, 1):
        for way, by_urn in enumerate(straight.passages(start)):
            for urn, terms in enumerate(by_urn):
                total[way, urn] += circulation.filled(terms, straight.decay, rounds)
    return Passing(total[0], total[1], straight.share)


class Balance:
    """Both urns of a circuit with what passes them straight."""

    def __init__(self, circuit: Circuit, known: Passing) -> None:
        """Prepare the ports."""
        self.circuit, self.known = circuit, known
        urns = [ports.disc(side) for side in circuit.sides]
        self.back, self.across, self.stay1, self.stay2 = np.array(
            [[one.return_chance, one.across, one.stay1, one.stay2] for one in urns]
        ).T
        self.distance = np.array([float(sum(side.chords)) for side in circuit.sides])
        self.threshold = np.array([float(side.threshold) for side in circuit.sides])

    def flows(self, arriving1: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return e, f, what gates let through and the halves' numbers; shape (urn,) each."""
        down, up, share = self.known.down, self.known.up, self.known.share
        source = (1.0 - self.across) * down - self.back * up
        leaving2 = self.across * arriving1 + source
        leaving2 = (leaving2 + self.back * leaving2[::-1]) / (1.0 - self.back.prod())
        arriving2 = leaving2[::-1]
        entries = (1.0 - self.across) * arriving1 + (1.0 - self.back) * arriving2 - source
        in_urn = self.stay1 * (arriving1 - down) + self.stay2 * (arriving2 - up)
        in_urn += self.distance * (down + up)
        mean, least = 0.25 * math.pi, 0.5  # of half a channel's length: by the cosine law; straight
        length1, length2 = (float(getattr(self.circuit, f"channel{one}_length")) for one in (1, 2))
        loads = length1 * (mean * (entries - up) + least * up)
        sides = zip(self.circuit.sides, self.threshold, loads, strict=True)
        passed = np.exp([float(side.gate.log_share(of, load)) for side, of, load in sides])
        turning = (1.0 - passed) * np.minimum(self.threshold, loads)
        slow, fast = passed * (entries - up), share * up
        flying = length1 * (mean * slow + least * fast)
        flying += length2 * (mean * (leaving2 - down) + least * down)
        return entries, leaving2, slow + fast, in_urn + turning + flying + flying[::-1]

    def state(self, first: float) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the flows where N particles are held, and `first`/N of b comes to urn 1."""
        number = float(self.circuit.number)
        shares = np.array([first, number - first]) / number

        def missing(scale: float) -> float:
            return float(self.flows(scale * shares)[3].sum()) - number

        scale = number / float(self.stay1.mean())
        found = optimize.brentq(missing, 0.05 * scale, 5.0 * scale, rtol=1e-13)
        return self.flows(found * shares)

    def excess(self, first: float) -> float:
        """Return what the gates send from half 1 to 2 more than channel 2 brings back."""
        _, across, through, _ = self.state(first)
        return float(through[0] - through[1] - across[1] + across[0])

    def nearest(self, first: float) -> float:
        """Return the `first` of the state that is nearest to a given one."""
        number = float(self.circuit.number)
        few = min(first, number - first)

        def excess(share: float) -> float:
            return self.excess(share if first <= 0.5 * number else number - share)

        for apart in APART:
            ends = few / apart, min(few * apart, 0.5 * number)
            if excess(ends[0]) * excess(ends[1]) < 0.0:
                found = float(optimize.brentq(excess, *ends, rtol=1e-12))
                return found if first <= 0.5 * number else number - found
        raise ArithmeticError("no state with circulation near the one without")


@lru_cache(maxsize=16)
def most_polarised(circuit: Circuit) -> State:
    """Return the most polarised stable state of `two_port`, of a circuit as that takes it."""
    return max(THEORIES["two_port"].solve_stable(circuit), key=lambda one: one.mass_spread)


def polarised(circuit: Circuit) -> float:
    """Return the `first` of the most polarised stable state of `two_port`."""
    number2 = most_polarised(circuit).urn2_number
    number, balance = float(circuit.number), Balance(circuit, NOTHING)

    def excess(first: float) -> float:
        return float(balance.state(first)[3][1]) - number2

    return float(optimize.brentq(excess, 1e-6 * number, (1.0 - 1e-6) * number, rtol=1e-13))


def solved(circuit: Circuit, age: float, draws: int = 1) -> tuple[Found, list[Found]]:
    """Return the most polarised state without circulation, and with it at an age of the run.

    The latter for each of several sets of particles: the first is iterated until it agrees with
    itself, others are one step from there. That overstates their scatter, by a third at T = 12,
    w' = 0.05.
    """
    circuit = THEORIES["two_port"].of(circuit)
    first, found = polarised(circuit), []

    def state(known: Passing) -> tuple[Floats, Floats]:
        """Find the state with what passes straight; return what walls send in that."""
        nonlocal first
        balance = Balance(circuit, known)
        first = balance.nearest(first)
        entries, across, _, halves = balance.state(first)
        found.append(Found(halves, float(across[1] - across[0]), known))
        return entries - known.up, across - known.down

    walls = state(NOTHING)
    for _ in range(ITERATIONS):
        walls = state(passing(circuit, *walls, age))
        change = found[-1].halves[1] - found[-2].halves[1]
        if abs(float(change)) < AGREED * float(circuit.number):
            break
    last = len(found) - 1
    for draw in range(1, draws):
        state(passing(circuit, *walls, age, circulation.FIRST + draw))
    return found[0], found[last:]

"""Stationary states of two urns that remember the opening of entry.

With e_i and f_i the outflows of urn i into channels 1 and 2, q_i the share of e_i that gets through
its gate at load e_i pi l/4, j the other urn, and the ports of `ports`:

    back into urn i through channel 1   b_i = (1 - q_i) e_i + q_j e_j      through channel 2   f_j
    e_i = (1 - P12) b_i + (1 - a) f_j   f_i = P12 b_i + a f_j              n_i = t1 b_i + t2 f_j

If the urns are stationary channel 2 carries J = f_2 - f_1 and channel 1 as much, b_1 = e_1 - J
and b_2 = e_2 + J; all are linear in b_1, b_2. For equal urns J = G (n_2 - n_1), G that of `ports`.
So every ratio b_1/b_2 is a stationary pair of urns, and a state of the circuit if the gates carry J
as well. Well mixed urns give the flows of eqs. (eqapp5) and (eq007).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

from postproc.theory import ports
from postproc.theory.circulation import circulating, with_circulation
from postproc.theory.states import State, crossings, places_of, places_of_unequal

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.ports import Ports

    Floats = NDArray[np.float64]
    Memory = Callable[[Circuit], Ports]

STEP = 1e-5  # relative, of N1, next to equal urns
FEWEST = 1e-9  # smallest share of channel 1's particles to one urn
ROUNDS = 60  # at most, of the iteration for the number in the channels


@dataclass(frozen=True)
class Balance:
    """A stationary pair of urns; fields of shape (urn, case).

    Attributes
    ----------
    entries : e, outflow of each urn into channel 1 per unit time.
    across : f, its outflow into channel 2.
    log_share : logarithm of q, the share of `entries` that gets through its gate.
    in_urn : n, number in it.
    in_half : N, with its gate and its half of channel 2.
    """

    entries: Floats
    across: Floats
    log_share: Floats
    in_urn: Floats
    in_half: Floats

    @property
    def through(self) -> Floats:
        """Flow through each gate per unit time, q e."""
        return np.exp(self.log_share) * self.entries

    @property
    def net_current(self) -> Floats:
        """Current of channel 2 from urn 2 to urn 1, shape (case,)."""
        return self.across[1] - self.across[0]

    @property
    def log_excess(self) -> Floats:
        """Logarithm of the flow of urn 1 over that of urn 2, shape (case,): 0 in a state.

        Of flows that are positive for any gates: q_1 e_1 + J - and q_2 e_2 + J + , the two parts of
        J by its sign.
        """
        with np.errstate(divide="ignore"):
            current = np.log(np.maximum([-self.net_current, self.net_current], 0.0))
            sent = self.log_share + np.log(self.entries)
        return np.logaddexp(sent[0], current[0]) - np.logaddexp(sent[1], current[1])


def held(circuit: Circuit, arriving1: Floats, memory: Memory = ports.disc) -> Balance:
    """Return the stationary pair of urns for inflows `arriving1` by channel 1, (urn, case)."""
    sides = circuit.sides
    own = [memory(side) for side in sides]
    back, across, stay1, stay2 = np.array(
        [[one.return_chance, one.across, one.stay1, one.stay2] for one in own]
    ).T[:, :, None]
    leaving2 = across * arriving1
    leaving2 = (leaving2 + back * leaving2[::-1]) / (1.0 - back[0] * back[1])
    arriving2 = leaving2[::-1]
    entries = (1.0 - across) * arriving1 + (1.0 - back) * arriving2
    in_urn = stay1 * arriving1 + stay2 * arriving2
    loads = 0.25 * np.pi * float(circuit.channel1_length) * entries
    log_share = np.stack(
        [side.gate.log_share(side.threshold, load) for side, load in zip(sides, loads, strict=True)]
    )
    share, thresholds = np.exp(log_share), np.array([[float(one.threshold)] for one in sides])
    beyond = share * loads + 0.25 * np.pi * float(circuit.channel2_length) * leaving2
    turning = (1.0 - share) * np.minimum(thresholds, loads)
    in_half = in_urn + turning + beyond + beyond[::-1]
    return Balance(entries, leaving2, log_share, in_urn, in_half)


def balance(circuit: Circuit, first: ArrayLike, memory: Memory = ports.disc) -> Balance:
    """Return the pair with N particles in which urn 1 has the share `first`/N of inflows 1.

    `first` is of shape (case,) or a number; with a narrow channel 2 it is nearly N1. The share of
    outflows is not suitable: it is the same for all states of two equal urns at w' = w, in the
    limit of narrow openings.
    """
    number = float(circuit.number)
    one = np.atleast_1d(np.asarray(first, float))
    shares = np.stack([one, number - one]) / number
    scale = np.full(one.shape, number / float(circuit.urn_area))
    for _ in range(ROUNDS):
        found = held(circuit, scale * shares, memory)
        total = found.in_half.sum(axis=0)
        if np.all(np.abs(total - number) <= 1e-13 * number):
            break
        scale = scale * number / total
    return found


def homogeneous_kind(circuit: Circuit, memory: Memory = ports.disc) -> str:
    """Return whether the state with equal densities is "stable" or "unstable".

    "neutral": there is no flow. For unequal urns or gates: of the state that is nearest to it.
    """
    if float(circuit.channel2_width) == 0.0 and float(circuit.threshold) == 0.0:
        return "neutral"
    if circuit.alike:
        return "stable" if growth(circuit, memory) <= 0.0 else "unstable"
    middle = 0.5 * float(circuit.number)  # the outflows are equal: densities are equal
    roots = _roots(circuit, memory)
    return min(roots, key=lambda one: abs(one[0] - middle))[1] if roots else "neutral"


def growth(circuit: Circuit, memory: Memory = ports.disc) -> float:
    """Return a number with the sign of the growth of a small difference between equal urns."""
    excess = balance(circuit, 0.5 * float(circuit.number) * (1.0 - STEP), memory).log_excess
    return float(np.nan_to_num(excess[0]))


def _roots(circuit: Circuit, memory: Memory) -> list[tuple[float, str]]:
    """Return (first, kind) of all states, for equal urns and gates only those with urn 2 fuller."""
    number = float(circuit.number)
    if circuit.alike and float(circuit.threshold) == 0.0:
        return []  # channel 2 only

    def excess(first: ArrayLike) -> Floats:
        found = np.nan_to_num(balance(circuit, first, memory).log_excess, posinf=1e9, neginf=-1e9)
        return found if np.ndim(first) else found[0]

    places = places_of(circuit, 0.5 * number) if circuit.alike else places_of_unequal(circuit)
    closed = float(circuit.channel2_width) == 0.0
    if not closed:  # an urn with a smaller inflow 1 has only what channel 2 brings
        places = places[(places > FEWEST * number) & (places < (1.0 - FEWEST) * number)]
    values = excess(places)
    if circuit.alike:
        values[0] = 1.0 if growth(circuit, memory) > 0.0 else -1.0
    roots = crossings(excess, places, values)
    if closed and values[-1] > 0.0 and float(circuit.threshold) > 0.0:
        roots.append((0.0, "stable"))  # too few to be resolved
    return roots


def stationary_states(circuit: Circuit, memory: Memory = ports.disc) -> list[State]:
    """Return all states of a circuit with scalar fields, for equal urns those with N2 > N/2.

    Parameters
    ----------
    circuit : the circuit with its gate.
    memory : memory of an urn, `ports.disc` or `ports.well_mixed`. With the former the current of
        circulating particles (`circulation`) is added.
    """
    found = []
    for at, state in _states(circuit, memory):
        if memory is not ports.disc:
            found.append(state)
            continue
        found.append(with_circulation(state, *_around(circuit, at, [circuit.age, math.inf])))
    return found


def _states(circuit: Circuit, memory: Memory) -> list[tuple[Balance, State]]:
    """Return all states, as the urns are there, without circulation."""
    number, found = float(circuit.number), []
    for first, kind in _roots(circuit, memory):
        at = balance(circuit, first, memory)
        second, current = float(at.in_half[1, 0]), float(at.net_current[0])
        found.append((at, State(second, kind, abs(2.0 * second - number) / number, current)))
    return found


def _around(circuit: Circuit, at: Balance, ages: ArrayLike = math.inf) -> tuple[Floats, Floats]:
    """Return the circulating current of one pair of urns at each age, and its standard error."""
    urns = [ports.disc(side) for side in circuit.sides]
    return circulating(circuit, urns, at.entries[:, 0], at.across[:, 0], ages)


def outflows(circuit: Circuit, memory: Memory = ports.disc) -> tuple[Floats, Floats]:
    """Return N2 and the logarithms of the flows of halves 1 and 2 to each other.

    Shapes (case,) and (half, case), N2 increasing over what the theory can hold.
    """
    at = balance(circuit, places_of_unequal(circuit), memory)
    with np.errstate(divide="ignore"):
        through2 = np.log(np.maximum(at.across, 0.0))
        sent = np.logaddexp(np.log(at.entries) + at.log_share, through2)
    return at.in_half[1], sent


def with_number2(circuit: Circuit, number2: float, memory: Memory = ports.disc) -> Balance:
    """Return the stationary pair of urns at N2 = `number2`."""
    number = float(circuit.number)

    def excess(first: float) -> float:
        return float(balance(circuit, first, memory).in_half[1, 0]) - number2

    fewest, most = FEWEST * number, (1.0 - FEWEST) * number
    if excess(fewest) <= 0.0:  # so many do not fit beside those in the channels
        return balance(circuit, fewest, memory)
    if excess(most) >= 0.0:  # fewer are not possible: channel 2 brings more
        return balance(circuit, most, memory)
    return balance(circuit, optimize.brentq(excess, fewest, most, rtol=1e-12), memory)

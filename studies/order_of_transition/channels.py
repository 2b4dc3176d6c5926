"""The prediction with the particles in the channels, for each N: computed after the runs.

The rule of `prediction` puts all particles into the urns. Those in the channels are not there: at
fixed N l their share grows with l, so the load depends on N. Here the program's `two_port` counts
them. Channels 1 and 2 together send the half 2 particles at the rate s_1, and it sends s_2 back;
N2 as a birth-death chain has the weight P(N2), with d ln P/d N2 = ln(s_1/s_2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize, special
from scipy.interpolate import PchipInterpolator

from postproc.theory import direction, two_port
from postproc.theory.circuit import Circuit
from postproc.theory.renewal import RENEWAL
from studies.order_of_transition.prediction import WIDTH

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

FINE = 4000  # places of m, from 0 to the most that the theory can hold
WIDEST = 0.3  # w', up to which states are looked for
NARROWEST = 1e-4
DISCS, WIDTH2_OF_DISCS = 15, 0.2  # of the Lorentz circuit
SMOOTH = 0.02  # m, from which on a polarised state is told from the homogeneous one


def circuit(threshold: int, reach: float, number: int, width2: float) -> Circuit:
    """Return a circuit with N l = `reach`, w = 0.3, r = 1, its channels' particles counted."""
    return Circuit(number, threshold, WIDTH, width2, channel1_length=reach / number,
                   gate=RENEWAL, occupation=True)  # fmt: skip


def load(one: Circuit) -> float:
    """Return the load of a gate in the homogeneous state."""
    held = two_port.balance(one, 0.5 * float(one.number))
    return float(held.entries[0, 0]) * math.pi * float(one.channel1_length) / 4.0


def load_beside(threshold: int, reach: float, number: int, area2: float) -> float:
    """Return the load of the homogeneous state if channel 2 has the free area `area2`.

    The density is the same everywhere but in gates, whatever channel 2 is.
    """
    one = circuit(threshold, reach, number, NARROWEST)
    area, length = float(one.urn_area), float(one.channel1_length)

    def total(inside: float) -> float:
        own = inside * WIDTH * length / (4.0 * area)
        share = float(RENEWAL.share(threshold, own))
        gates = 2.0 * (1.0 - share) * min(threshold, own) + 4.0 * share * own
        return 2.0 * inside + gates + inside * area2 / area - number

    inside = optimize.brentq(total, 1e-3 * number, 0.5 * number)
    return inside * WIDTH * length / (4.0 * area)


def load_with_discs(threshold: int, reach: float, number: int, radius: float) -> float:
    """Return it for the Lorentz circuit: channel 2 is 0.2 wide, 1 long, with 15 discs."""
    return load_beside(threshold, reach, number, WIDTH2_OF_DISCS - DISCS * math.pi * radius**2)


@dataclass(frozen=True)
class Weight:
    """ln P of m = 2 N2/N - 1 from 0 up, 0 at m = 0.

    Attributes
    ----------
    spread : m.
    log : ln P there.
    polarises : whether m grows anywhere from `SMOOTH` on.
    """

    spread: Floats
    log: Floats
    polarises: bool

    @property
    def wells(self) -> tuple[int, int, float]:
        """Places of the deepest minimum and of the largest weight beyond it, and the barrier.

        The barrier is counted from the lower of the two modes; 0 if there is only one mode.
        """
        left = np.maximum.accumulate(self.log)
        right = np.maximum.accumulate(self.log[::-1])[::-1]
        depth = np.minimum(left, right) - self.log
        wall = int(depth.argmax())
        return wall, wall + int(self.log[wall:].argmax()), float(depth[wall])

    @property
    def odds(self) -> float:
        """The logarithm of the weight beyond the minimum over the weight before it."""
        wall, _, _ = self.wells
        return float(special.logsumexp(self.log[wall:]) - special.logsumexp(self.log[: wall + 1]))


@lru_cache(maxsize=64)
def weight(one: Circuit) -> Weight:
    """Return ln P of a circuit by `two_port`."""
    return _weight(one, two_port.outflows(one))


def _weight(one: Circuit, flows: tuple[Floats, Floats]) -> Weight:
    second, sent = flows
    spread, drift = 2.0 * second / float(one.number) - 1.0, sent[0] - sent[1]
    good = (spread > 0.0) & np.isfinite(drift)
    spread, first = np.unique(spread[good], return_index=True)
    spread = np.concatenate([[0.0], spread])
    drift = np.concatenate([[0.0], drift[good][first]])
    fine = np.linspace(0.0, spread[-1], FINE)
    rise = PchipInterpolator(spread, drift)(fine) * 0.5 * float(one.number)
    middles = 0.5 * (rise[1:] + rise[:-1]) * np.diff(fine)
    total = np.concatenate([[0.0], np.cumsum(middles)])
    return Weight(fine, total, bool(drift[spread > SMOOTH].max() > 0.0))


@dataclass(frozen=True)
class Directed:
    """What the theory with memory of directions, `direction`, has for one circuit.

    Attributes
    ----------
    homogeneous : "stable" or "unstable".
    unstable, stable : chi of the polarised state of either kind; NaN: there is none.
    barrier : of ln P, below the lower mode.
    gain : ln P of the polarised mode, less that of the homogeneous one.
    """

    homogeneous: str
    unstable: float
    stable: float
    barrier: float
    gain: float


def directed(one: Circuit) -> Directed:
    """Return the states of a circuit, and ln P from some 20 places: its barrier is rough."""
    chi = {"unstable": math.nan, "stable": math.nan}
    chi |= {state.kind: state.mass_spread for state in direction.stationary_states(one)}
    own = _weight(one, direction.outflows(one))
    _, mode, barrier = own.wells
    return Directed(direction.homogeneous_kind(one), **chi, barrier=barrier,
                    gain=float(own.log[mode]))  # fmt: skip


@dataclass(frozen=True)
class Finite:
    """The transition of one circuit at one N, as channel 2 becomes wider.

    Attributes
    ----------
    load : of the homogeneous state, at the w' of equal weight (without one: where it turns stable).
    homogeneous : w' above which the homogeneous state is stable; NaN: at all.
    polarised : w' up to which a polarised state is stable; NaN: there is none.
    equal : w' where the polarised modes have half the weight; NaN: nowhere.
    jump : chi of the polarised mode there; 0: the transition is continuous.
    barrier : of ln P, the largest over w'.
    barrier_at : w' there.
    """

    load: float
    homogeneous: float
    polarised: float
    equal: float
    jump: float
    barrier: float
    barrier_at: float


def _homogeneous(one: Circuit) -> float:
    """Return w' above which the homogeneous state is stable, NaN if it is so for all of them."""

    def growth(width: float) -> float:
        return two_port.growth(replace(one, channel2_width=width))

    if growth(NARROWEST) <= 0.0:
        return math.nan
    return float(optimize.brentq(growth, NARROWEST, WIDEST, xtol=1e-6))


def finite(threshold: int, reach: float, number: int) -> Finite:
    """Return the transition of one circuit at one N.

    Parameters
    ----------
    threshold, reach, number : T, N l and N.
    """
    one = circuit(threshold, reach, number, NARROWEST)
    homogeneous = _homogeneous(one)

    def at(width: float) -> Weight:
        return weight(replace(one, channel2_width=float(width)))

    first = NARROWEST if math.isnan(homogeneous) else homogeneous * (1.0 + 1e-5)
    if not at(first).polarises:
        own = load(replace(one, channel2_width=first))
        ends = homogeneous if homogeneous > 0.0 else math.nan
        return Finite(own, homogeneous, ends, math.nan, 0.0, 0.0, math.nan)
    low, high = first, 1.05 * first if homogeneous > 0.0 else 0.002
    while at(high).polarises:
        low, high = high, 1.1 * high
    while high - low > 1e-5:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if at(middle).polarises else (low, middle)
    polarised = low
    found = optimize.minimize_scalar(
        lambda width: -at(width).wells[2], bounds=(first, polarised), method="bounded",
        options={"xatol": 1e-5},
    )  # fmt: skip
    least = first + 1e-3 * (polarised - first)
    if at(least).odds > 0.0 > at(polarised).odds:
        equal = float(optimize.brentq(lambda width: at(width).odds, least, polarised, xtol=1e-6))
        jump = float(at(equal).spread[at(equal).wells[1]])
    else:
        equal = jump = math.nan
    own = load(replace(one, channel2_width=polarised if math.isnan(equal) else equal))
    return Finite(own, homogeneous, polarised, equal, jump, float(-found.fun), float(found.x))

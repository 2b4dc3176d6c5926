"""Lifetimes of states if directions relax no faster than N2 changes: a chain in two variables.

Directions relax in some hundred units of time, and N2 may reach a barrier in the same time. So they
lag behind: M is the N2 to which they have relaxed, and dM/dt = (N2 - M)/tau_r. The rate at which an
urn sends particles out relaxes within a visit, and follows N2; their distribution of directions
follows M: F_i(s; M) e_i(N2)/e_i(M). Gates are those for these entries. For N2 = M these are the
rates of `direction.outflows`, and if gates do not depend on directions they are so for any M.

tau_r: a deviation of the directions in one urn, and its negative in the other, is multiplied by K11
(1 - 2 q) in each visit, in the circuit of equal halves; a visit and the stay in the gate after it
take about n_i/e_i. So its slowest component decays in n_i/e_i/(1 - kappa), kappa the largest
eigenvalue, without the component that changes numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import interpolate, sparse
from scipy.sparse import linalg

from postproc.cli import InputError
from postproc.progress import each
from postproc.theory import direction

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.direction import Directions, Held

    Floats = NDArray[np.float64]

STEPS = 100  # of M
LONGEST = 3e13  # steps in a lifetime, above which it counts as infinite: 150 roundings of it


@dataclass(frozen=True)
class Settling:
    """A circuit whose directions lag behind N2.

    Attributes
    ----------
    number : N.
    places2 : N2 at which rates are computed, increasing.
    settled2 : M at which they are computed.
    sent : logarithms of the flows between the halves, shape (N2, M, half).
    time : tau_r, in units of length/v.
    """

    number: int
    places2: Floats
    settled2: Floats
    sent: Floats
    time: float

    def rates(self, number2: Floats, settled: Floats) -> tuple[Floats, Floats]:
        """Return the rates of N2 -> N2 + 1 and N2 -> N2 - 1 at each N2 and each M: (N2, M)."""
        second = np.clip(number2, self.places2[0], self.places2[-1])
        there = np.clip(settled, self.settled2[0], self.settled2[-1])
        up, down = (
            np.exp(interpolate.RectBivariateSpline(self.places2, self.settled2, one)(second, there))
            for one in np.moveaxis(self.sent, 2, 0)
        )
        up[number2 == self.number], down[number2 == 0] = 0.0, 0.0
        return up, down

    def passage(self, start: int, stop: int) -> float:
        """Return the mean time from one |N2 - N/2|, with relaxed directions, to another.

        Both are states of `chain.folded`; infinite above `LONGEST` steps.
        """
        offset = (self.number + 1) // 2
        if stop > start:
            second = np.arange(self.number - offset - stop + 1, offset + stop)
        else:
            second = np.arange(offset + stop + 1, self.number + 1)
        settled = np.linspace(second[0], second[-1], STEPS + 1)
        up, down = self.rates(second, settled)
        lag = second[:, None] - settled
        if second.size > 1:
            lag = lag / (self.time * (settled[1] - settled[0]))
        rise, fall = np.maximum(lag, 0.0), np.maximum(-lag, 0.0)
        rise[:, -1], fall[:, 0] = 0.0, 0.0
        state = np.arange(lag.size).reshape(lag.shape)
        moves = (
            (up[:-1], state[:-1], state[1:]), (down[1:], state[1:], state[:-1]),
            (rise[:, :-1], state[:, :-1], state[:, 1:]), (fall[:, 1:], state[:, 1:], state[:, :-1]),
        )  # fmt: skip
        rate, here, there = (np.concatenate([one[k].ravel() for one in moves]) for k in range(3))
        leaving = sparse.diags((up + down + rise + fall).ravel())
        equations = leaving - sparse.csc_matrix((rate, (here, there)), shape=leaving.shape)
        times = linalg.spsolve(equations.tocsc(), np.ones(lag.size)).reshape(lag.shape)
        first = offset + start
        found = float(np.interp(first, settled, times[first - second[0]]))
        return found if 0.0 < found < LONGEST / float((up + down).max()) else math.inf


def passages(circuit: Circuit) -> Callable[[int, int], float]:
    """Return a function for the mean time from one |N2 - N/2| to another (`Settling.passage`)."""
    return settling(circuit).passage


def settling(circuit: Circuit) -> Settling:
    """Return the chain of a circuit with equal urns and gates whose directions lag behind N2."""
    equations = direction.Directions(circuit)
    held = [one for _, one in direction.scan(circuit)]
    circuits = [*(_mirrored(one) for one in held[::-1]), equations.held(0.5), *held]
    chosen = circuits[len(held) % 2 :: 2]  # the even one among them, and the ends or nearly so
    second, settled = (np.array([one.in_half[1] for one in few]) for few in (circuits, chosen))
    if np.any(np.diff(second) <= 0.0):
        raise InputError(f"theory direction: it knows no lifetimes of {circuit.brief}")
    half = np.array([[_sent(equations, one, other) for other in chosen]
                     for one in each(circuits, "what is sent, share")])  # fmt: skip
    sent = np.stack([half, half[::-1, ::-1]], axis=2)
    time = _time(equations, circuits[len(held)])
    return Settling(int(circuit.number), second, settled, sent, time)


def _mirrored(held: Held) -> Held:
    by_urn = {name: one[::-1] for name, one in vars(held).items() if name != "agreed"}
    return replace(held, **by_urn)


def _sent(equations: Directions, held: Held, settled: Held) -> float:
    """Return the logarithm of half 1's outflow: its rate from `held`, directions from `settled`."""
    more = held.entries[0, 0] / settled.entries[0, 0]
    law = np.maximum(more * settled.entries[0] @ equations.basis, 0.0) * equations.weights
    through = equations.passing(0, law) @ law
    return math.log(through + max(held.across[0, 0], 0.0))


def _time(equations: Directions, even: Held) -> float:
    """Return tau_r of a circuit held with equal halves."""
    gate = equations.weighted(1.0 - 2.0 * even.passing.mean(axis=0))
    visit = (equations.urns[0].kernel[0, 0].T @ gate)[1:, 1:]
    slowest = np.linalg.eigvals(visit).real.max()
    return float(even.in_half[0] / even.entries[0, 0] / (1.0 - slowest))

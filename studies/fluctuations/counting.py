"""Counts of channel 2 in the renewal chain: urns without memory, N2 a Markov chain.

The chain has particles pass one at a time through channels 1 and 2 at rates that depend on N2, the
number of urn 2, alone. It starts from its stationary distribution; where both gates are alike, from
that over N2 > N/2, and it never goes below. With J_t the net number that channel 2 has brought from
urn 2 to urn 1, the generating function of J_t and its growth rate are those of the chain's
generator with a factor exp(s) at each step that counts +1 and exp(-s) at each that counts -1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal
from scipy.optimize import minimize_scalar
from scipy.special import ive

from postproc.theory.circuit import Circuit, flow1, flow2
from studies.common.theories import THEORIES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

PRECISION = 1e-15  # at which a series ends
RESOLVED = 1e-10  # of the largest probability, below which rounding counts
PIECE = 20.0  # steps, on average, that one series takes the distribution over


@dataclass(frozen=True)
class Chain:
    """Rates at which N2 changes by one; fields of shape (state,), in the order of N2.

    Attributes
    ----------
    number2 : N2.
    up1, up2 : rates of N2 -> N2 + 1 through channels 1 and 2; 0 in the last state.
    down1, down2 : rates of N2 -> N2 - 1; 0 in the first state.
    """

    number2: Floats
    up1: Floats
    up2: Floats
    down1: Floats
    down2: Floats

    @property
    def stationary(self) -> Floats:
        """Probability of each state."""
        with np.errstate(divide="ignore"):
            steps = np.log((self.up1 + self.up2)[:-1]) - np.log((self.down1 + self.down2)[1:])
        weights = np.concatenate([[0.0], np.cumsum(steps)])
        found = np.exp(weights - weights.max())
        return found / found.sum()

    @property
    def flows2(self) -> tuple[float, float]:
        """Mean flows of channel 2 from urn 2 to urn 1 and back."""
        return float(self.stationary @ self.down2), float(self.stationary @ self.up2)

    @property
    def affinity(self) -> float:
        """Entropy production over the net current: what it costs to take one particle round."""
        chance, total = self.stationary, 0.0
        for up, down in ((self.up1, self.down1), (self.up2, self.down2)):
            there, back = (chance * up)[:-1], (chance * down)[1:]
            moved = (there > 0.0) & (back > 0.0)
            total += float(((there - back)[moved] * np.log(there[moved] / back[moved])).sum())
        with_, against = self.flows2
        return total / (with_ - against)

    def growth(self, tilt: float) -> float:
        """Return the rate at which the mean of exp(s J_t) grows, s the tilt."""
        up = self.up1 + self.up2 * math.exp(-tilt)
        down = self.down1 + self.down2 * math.exp(tilt)
        diagonal = -(self.up1 + self.up2 + self.down1 + self.down2)
        last = diagonal.size - 1
        off = np.sqrt(up[:-1] * down[1:])
        return float(eigvalsh_tridiagonal(diagonal, off, select="i", select_range=(last, last))[0])

    def last_variance(self, step: float = 1e-3) -> float:
        """Return var(J_t)/t at long times."""
        return (self.growth(step) + self.growth(-step)) / step**2

    def last_slope(self, least: float = -12.0) -> float:
        """Return ln[P(j)/P(-j)]/j at long times and any fixed j.

        P(J_t = j) tends to exp(growth(s) t - s j) where growth is least; so the slope is -2 s.
        """
        found = minimize_scalar(self.growth, bounds=(least, 0.0), method="bounded")
        return -2.0 * float(found.x)

    def slopes(
        self, times: Sequence[float], counts: Sequence[int], *, tilt: float, size: int
    ) -> Floats:
        """Return ln[P(J_t = j)/P(J_t = -j)]/j, shape (time, count); NaN where rounding hides them.

        Parameters
        ----------
        times : t, increasing.
        counts : j.
        tilt : s at which P(j) exp(s j) is computed, of which the ratios are undone; -1/2 of the
            slope makes both terms equal.
        size : how many j the Fourier transform tells apart.
        """
        waves = np.exp(tilt + 2j * np.pi * np.arange(size // 2 + 1) / size)
        leaving = self.up1 + self.up2 + self.down1 + self.down2
        fastest = float(leaving.max())
        up = (self.up1[:, None] + self.up2[:, None] / waves)[:-1] / fastest
        down = (self.down1[:, None] + self.down2[:, None] * waves)[1:] / fastest
        stay = (1.0 - leaving / fastest)[:, None]
        state = np.repeat(self.stationary[:, None], waves.size, axis=1).astype(complex)
        found, now = [], 0.0
        for time in times:
            pieces = max(1, math.ceil(fastest * (time - now) / PIECE))
            mean = fastest * (time - now) / pieces
            for _ in range(pieces):
                state = _after(state, up, down, stay, mean)
                state /= np.abs(state).max()
            now = time
            weight = np.fft.irfft(state.sum(axis=0).conj(), size)
            pairs = np.array([[weight[j], weight[-j]] for j in counts]).T
            pairs[pairs < RESOLVED * weight.max()] = math.nan
            found.append(np.log(pairs[0] / pairs[1]) / np.array(counts) - 2.0 * tilt)
        return np.array(found)


def _after(state: NDArray[np.complex128], up: NDArray[np.complex128], down: NDArray[np.complex128],
           stay: Floats, mean: float) -> NDArray[np.complex128]:  # fmt: skip
    """Return the state after a Poisson number of steps with a mean (uniformisation)."""
    term, weight = state, math.exp(-mean)
    total, step = weight * term, 0
    while True:
        step += 1
        new = stay * term
        new[1:] += up * term[:-1]
        new[:-1] += down * term[1:]
        term, weight = new, weight * mean / step
        total = total + weight * term
        if step > mean and weight * np.abs(term).max() < PRECISION * np.abs(total).max():
            return total


def renewal_chain(circuit: Circuit) -> Chain:
    """Return the chain of a circuit; of one whose gates are alike, that with N2 > N/2."""
    one, two = (THEORIES["renewal_occupation"].of(side) for side in circuit.sides)
    number = int(circuit.number)
    number2 = np.arange(number // 2 + 1 if circuit.alike else 0, number + 1)
    up1, up2, down1, down2 = (
        np.where(held > 0, flow(side, np.maximum(held, 1)), 0.0)
        for side, held in ((one, number - number2), (two, number2))
        for flow in (flow1, flow2)
    )
    down1[0] = down2[0] = 0.0
    return Chain(number2.astype(float), up1, up2, down1, down2)


def frozen_slope(
    weight: Floats, with_: Floats, against: Floats, time: float, count: int
) -> float:
    """Return ln[P(j)/P(-j)]/j of independent crossings whose rates are drawn once and then kept.

    Parameters
    ----------
    weight : of each pair of rates.
    with_, against : the rates of counts +1 and -1, of the same shape.
    time, count : t and j.
    """
    here = (weight > 0.0) & (with_ > 0.0) & (against > 0.0)
    weight, ahead, back = weight[here], with_[here] * time, against[here] * time
    common = weight * np.exp(-((np.sqrt(ahead) - np.sqrt(back)) ** 2))
    common *= ive(count, 2.0 * np.sqrt(ahead * back))
    ratio = (ahead / back) ** (0.5 * count)
    return math.log(float((common * ratio).sum() / (common / ratio).sum())) / count

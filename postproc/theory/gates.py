"""Share of entries that gets through a gate: the paper's window, and the interface of gates.

A gate sees Poisson entries at rate e, each inside for (l/2)/cos(theta) (speed 1, cosine law), on
average tau = pi l/4. Its *load* x = e tau = n w l/(4A) is the paper's lambda, eq. (eqapp3), the
mean number inside without reversals. A gate model gives the share of the entries that gets through
at a load, and the slope of load times share, which determines stability.

Source: Cirillo, Colangeli, Richardson, Rondoni, PRE 103, 032119 (2021), appendix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy import special

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

TINY = 1e-280  # below it the logarithm of the incomplete gamma function is computed directly
FRACTION_LEVELS = 200


class Gate(Protocol):
    """A model of the gate: thresholds and loads broadcast, arrays in, arrays out."""

    def share(self, threshold: ArrayLike, load: ArrayLike) -> NDArray[np.float64]:
        """Return the share of the entries that gets through, between 0 and 1."""

    def log_share(self, threshold: ArrayLike, load: ArrayLike) -> NDArray[np.float64]:
        """Return the logarithm of `share`, -inf where it is 0."""

    def slope(self, threshold: ArrayLike, load: ArrayLike) -> NDArray[np.float64]:
        """Return d(load * share)/d(load)."""


@dataclass(frozen=True)
class WindowGate:
    """The paper's gate: at most T Poisson entries in a window of length tau, eq. (eqapp4)."""

    def share(self, threshold: ArrayLike, load: ArrayLike) -> NDArray[np.float64]:
        """Return Q(T, x) = Gamma(T, x)/(T-1)!, eq. (eqapp5); 0 for T = 0: nothing passes."""
        count, x = _as_floats(threshold, load)
        return np.where(count > 0, special.gammaincc(np.maximum(count, 1.0), x), 0.0)

    def log_share(self, threshold: ArrayLike, load: ArrayLike) -> NDArray[np.float64]:
        """Return log Q(T, x), accurate also if Q underflows."""
        count, x = _as_floats(threshold, load)
        share = self.share(count, x)
        far = (share < TINY) & (count > 0) & (x > count)
        with np.errstate(divide="ignore"):
            result = np.log(share)
        if np.any(far):
            result = np.where(
                far, _log_tail(np.where(far, count, 1.0), np.where(far, x, 2.0)), result
            )
        return result

    def slope(self, threshold: ArrayLike, load: ArrayLike) -> NDArray[np.float64]:
        """Return d(x Q)/dx = Q(T, x) - x^T exp(-x)/(T-1)!."""
        count, x = _as_floats(threshold, load)
        positive = np.maximum(count, 1.0)
        log_loss = special.xlogy(positive, x) - x - special.gammaln(positive)
        return np.where(count > 0, self.share(count, x) - np.exp(log_loss), 0.0)


def _as_floats(
    threshold: ArrayLike, load: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    count, x = np.broadcast_arrays(np.asarray(threshold, float), np.asarray(load, float))
    return count, x


def _log_tail(count: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return log Q(T, x) far above T, by Legendre's continued fraction of Gamma(T, x)."""
    fraction = np.zeros_like(x)
    for level in range(FRACTION_LEVELS, 0, -1):
        fraction = level * (count - level) / (x + 2 * level + 1 - count + fraction)
    return count * np.log(x) - x - np.log(x + 1 - count + fraction) - special.gammaln(count)


WINDOW = WindowGate()

"""Selection at random of a few of many weighted things, such that sums stay unbiased."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def selected(
    scores: ArrayLike, number: int, random: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Select about `number` things; return which, and with what probability each was.

    The probability is min(1, score/c), with c such that they add up to `number`; the selection is
    systematic, from one random number. A sum over the things selected of value/probability has the
    sum over all as its mean.
    """
    scores = np.asarray(scores, float)
    if scores.size <= number:
        return np.arange(scores.size), np.ones(scores.size)
    falling = np.sort(scores)[::-1]
    rest = np.cumsum(falling[::-1])[::-1]  # sum of this score and all that are smaller
    certain = np.arange(number)
    first = int(np.argmax(falling[:number] * (number - certain) <= rest[:number]))
    chance = np.minimum(1.0, scores * ((number - first) / rest[first]))
    steps = np.floor(np.cumsum(chance) + random.uniform())
    taken = np.flatnonzero((np.diff(steps, prepend=0.0) > 0.0) | (chance >= 1.0))
    return taken, chance[taken]

"""The probability to leave through the opening of entry, as a sum over polygons.

Let alpha be the half angle of the narrower opening of a disc and beta >= alpha that of the other,
opposite. A visit that enters at y and returns after n segments of the angle delta leaves at
y' = y + epsilon, epsilon = n delta - 2 pi k: it is nearly a polygon of n corners that winds k
times. It does return if it has not left before. There are three conditions.

1. n and k have no common factor, else a shorter polygon has returned.
2. n is odd, else corner n/2 is at (y + y')/2 from the middle of the other opening, within it.
3. Then the corners nearest to that middle are two, one on either side: at pi/n + y + epsilon x/n
   after x = m segments and at -pi/n + y + epsilon x/n after x = n - m, with 2 k m = 1 mod n. They
   miss the other opening if

       |y + y'| < 2 (pi/n - beta) + h epsilon,        h = 2 m/n - 1,

   and then so do all other corners, and none of them is in the opening of entry.

So with xi = |epsilon| and mu = |y + y'|, 0 <= mu <= 2 alpha - xi, and the measure of entries,

    a = r/(4 w) sum over odd n of 1/n sum over k of the integral over xi and mu of
        sin(pi k/n + xi/2n) [mu < g + h xi] + sin(pi k/n - xi/2n) [mu < g - h xi],

g = 2 pi/n - 2 beta, w the width of the narrower opening. This is exact for any widths. n = 1 is no
return: such a line meets the arc of the opening and never its chord. The sum ends at n = pi/(beta -
alpha); for openings of one width terms fall as 1/n^3.

For narrow openings n is large where it matters, h is then even in (-1, 1), the sum over k becomes
(2/pi) phi(n), phi Euler's, and that over odd n an integral with the density 4/pi^2 of phi(n)/n. In
this limit a is a function of rho <= 1, the ratio of the widths, alone: with Li2 the dilogarithm

    a = 4/(pi^2 rho) [(1 + rho) Li2(2 rho/(1 + rho)) + Li2(-rho) - Li2(rho)],

4 rho/pi^2 for small rho and 1/3 at 1.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise, repeat
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

ORDER = 1000  # corners up to which every polygon is computed; beyond, h is taken as uniform
COUNTED = 2**16  # corners up to which odd n are summed one by one; beyond, the sum is an integral
PLACES = 1600  # in log n, at which the mean over h is computed
TOGETHER = 8192  # polygons at a time, few enough for the fast memory of a processor
ODD_PRIMITIVE = 4.0 / math.pi**2  # mean of phi(n)/n over odd n, times their density 1/2
GAUSS = np.polynomial.legendre.leggauss(4)
EVEN_H = np.polynomial.legendre.leggauss(32)


@lru_cache(maxsize=512)
def return_chance(radius: float, own: float, other: float, order: int = ORDER) -> float:
    """Return the probability to leave through the opening of entry, of width `own`.

    Parameters
    ----------
    radius : r of the disc.
    own, other : chords of the opening of entry and of the opposite one, below 2r.
    order : corners of the largest polygons that are computed one by one.
    """
    if own > other:
        return 1.0 - other / own * (1.0 - return_chance(radius, other, own, order))
    alpha, beta = math.asin(0.5 * own / radius), math.asin(0.5 * other / radius)
    last = math.pi / (beta - alpha) if beta > alpha else math.inf
    one_by_one = _polygons(alpha, beta, int(min(order, last)))
    return 0.25 * radius / own * (one_by_one + _many_corners(alpha, beta, order, last))


def _polygons(alpha: float, beta: float, order: int) -> float:
    """Return the sum over odd n from 3 to `order`."""
    corners, h, angle = _primitive(max(order, 2).bit_length())
    last, total = int(np.searchsorted(corners, order, side="right")), 0.0
    for start in range(0, last, TOGETHER):
        part = slice(start, min(start + TOGETHER, last))
        for sign in (1.0, -1.0):
            found = _integral(alpha, beta, corners[part], sign * h[part], angle[part], sign)
            total += 2.0 * float((found / corners[part]).sum())
    return total


@lru_cache(maxsize=16)
def _primitive(bits: int) -> tuple[Floats, Floats, Floats]:
    """Return n, h and pi k/n of the polygons of less than 2^bits corners, by increasing n.

    For k below n/2: k and n - k give the same, with the signs of epsilon and h exchanged.
    """
    n = np.arange(3, 2**bits, 2)
    corners = np.repeat(n, n // 2)
    winds = np.arange(corners.size) - np.repeat(np.cumsum(n // 2) - n // 2, n // 2) + 1
    own = np.gcd(winds, corners) == 1
    corners, winds = corners[own], winds[own]
    inverse = list(map(pow, (2 * winds).tolist(), repeat(-1), corners.tolist()))
    h = 2.0 * np.array(inverse) / corners - 1.0
    return corners.astype(float), h, math.pi * winds / corners


def _integral(
    alpha: float, beta: float, n: Floats, h: Floats, angle: Floats | None = None, sign: float = 1
) -> Floats:
    """Return the integral over xi and mu of sin(angle + sign xi/2n), or of 1, where mu < g + h xi.

    The upper limit of mu is the lesser of 2 alpha - xi and g + h xi, lines that cross at xi =
    `bend`.
    """
    width, gap = 2.0 * alpha, 2.0 * math.pi / n - 2.0 * beta
    with np.errstate(divide="ignore", invalid="ignore"):
        bend = np.clip((width - gap) / (1.0 + h), 0.0, width)
        zero = np.clip(np.where(h == 0.0, 0.0, -gap / h), 0.0, bend)
    shape = np.shape(bend)
    ends = (np.zeros(shape), zero, bend, np.full(shape, width))
    total = np.zeros(shape)
    for low, high in pairwise(ends):
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        # linear in between, of one sign: without an angle the middle has its mean
        height = np.maximum(np.minimum(width - middle, gap + h * middle), 0.0)
        if angle is None:
            total += 2.0 * half * height
            continue
        some = np.flatnonzero((half > 0.0) & (height > 0.0))
        xi = middle[some] + half[some] * GAUSS[0][:, None]
        height = np.maximum(np.minimum(width - xi, gap[some] + h[some] * xi), 0.0)
        height *= np.sin(angle[some] + sign * xi / (2.0 * n[some]))
        total[some] += half[some] * (GAUSS[1] @ height)
    return total


def _many_corners(alpha: float, beta: float, order: int, last: float) -> float:
    """Return the sum over odd n from `order` to `last`, h being even in (-1, 1)."""
    if order >= last:
        return 0.0
    width, reach = 2.0 * alpha, 1e4 * math.pi / beta
    places = np.geomspace(order, min(last, max(reach, 2.0 * COUNTED)), PLACES)
    h, weight = EVEN_H
    # two signs of epsilon, mean over h
    means = 2.0 * (_integral(alpha, beta, places[:, None], h) @ (0.5 * weight)) / width**2
    n = np.arange(1, int(min(COUNTED, last)) + 1)
    odd = (n % 2 == 1) & (n > order)
    first = (2.0 / math.pi) * (_totients(n.size)[odd] / n[odd])
    found = float(first @ np.interp(np.log(n[odd]), np.log(places), means))
    if last > COUNTED:
        beyond = np.geomspace(max(COUNTED, order), places[-1], 20 * PLACES)
        values = beyond * np.interp(np.log(beyond), np.log(places), means)
        integral = float(np.trapezoid(values, np.log(beyond)))
        found += (2.0 / math.pi) * ODD_PRIMITIVE * integral
    return found * width**2


@lru_cache(maxsize=4)
def _totients(largest: int) -> Integers:
    """Return Euler's phi(n) for n = 1 ... `largest`."""
    found = np.arange(largest + 1)
    for one in range(2, largest + 1):
        if found[one] == one:
            found[one::one] -= found[one::one] // one
    return found[1:]

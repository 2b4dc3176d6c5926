"""Share of the particles that pass a renewal gate: moment equations, and a simulation as a check.

Particles enter as a Poisson process of rate nu, and each is inside for the time (l/2)/cos(theta),
with theta from the cosine law. An entry while T particles are inside makes the gate reverse: none
is inside then, which ends a cycle. Within a cycle, the distribution of the number inside and of the
times of entry, in cells of width 1/cells, obeys linear equations: the time derivative of the
probability of n inside depends on the density of one of them over the cells, that of this density
on the pair density, and so on. The hierarchy is closed at order 2 (pairs) or 3 (triples): given n,
higher joint cumulants are zero, which is exact for T up to the order.

No particle leaves before time 1, so the integration starts there, from a Poisson distribution. It
uses the fourth-order Runge-Kutta method. Its variable is the square root of the time within a cell,
since the rate at which particles leave a cell starts as a square root when the cell reaches age 1.
Pairs of old cells are merged. At the end, the survival probability is extrapolated from the last
rate of reversals and its change. Lengths are in units of l/2, so the mean time inside without
reversals, tau, is pi/2.

Moments have the shape (n, a, b) or (n, a, b, c), symmetric in a, b and c: 0 stands for no
particle in particular, 1 ... k for one that entered in this cell. So [n, 0, 0] is the probability
of n inside, [n, i, 0] the density of one of them, [n, i, j] that of pairs.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

LONGEST = 32.0  # time up to which the equations are integrated
LEAST = 1e-250  # probabilities below it are taken as 0
LANES = 4096  # gates that are simulated together


def share_of_one(load: Floats) -> Floats:
    """Return the exact share for T = 1, with p the probability of no entry during a stay.

    From an entry into an empty gate e C - 1 = 1 + p (e C - 1), so the share is p/(2 - p).
    """
    nodes, weights = np.polynomial.legendre.leggauss(200)
    angle = 0.25 * np.pi * (nodes + 1.0)
    stay = np.exp(-np.multiply.outer(load / (0.5 * np.pi), 1.0 / np.cos(angle)))
    alone = stay @ (0.25 * np.pi * weights * np.cos(angle))
    return alone / (2.0 - alone)


def share(threshold: int, load: float, order: int, cells: int) -> float:
    """Return the share that passes; load: mean number inside without a threshold."""
    nu, h, now, rate = load / (0.5 * math.pi), 1.0 / cells, 1.0, 1.0
    edges = np.stack([np.arange(cells), np.arange(1, cells + 1)]) * h  # from, to
    state = _at_time_1(nu, threshold, order, cells)
    begun = state[(slice(None), *[0] * order)]
    survivors = begun.sum()
    cycle = (1.0 - begun.cumsum()).sum() / nu
    while now < LONGEST and survivors > 1e-10:
        state = _grouped(state, np.eye(edges.shape[1], edges.shape[1] + 1))
        edges = np.column_stack([edges, [now, now + h]])
        state, lasting = _over_cell(state, edges, now, h, nu)
        cycle += lasting
        survivors = _survival(state)
        before, rate = rate, nu * state[(-1, *[0] * order)] / survivors
        now += h
        groups = _pairs_of_old(edges, now, h)
        state = _grouped(state, groups)
        edges = np.stack([[edges[end, one > 0].take(at) for one in groups.T]
                          for end, at in ((0, 0), (1, -1))])  # fmt: skip
    limit = rate + (rate - before) * (now - h) / h
    if 0.5 * rate < limit < 2.0 * rate:
        rate = limit + (rate - limit) * now / (now + 1.0 / rate)
    return 1.0 - (threshold + 1) / (nu * (cycle + survivors / rate))


def _at_time_1(nu: float, threshold: int, order: int, cells: int) -> Floats:
    """Return a Poisson distribution of the number, and independent times of entry."""
    n = np.arange(threshold + 1)
    tagged = np.sum(np.indices((cells + 1,) * order) > 0, axis=0)
    m = np.arange(order + 1)
    above = np.maximum(n[:, None] - m + 1.0, 1.0)
    falling = np.where(n[:, None] >= m, special.poch(above, m), 0.0)  # n (n - 1) ... (n - m + 1)
    poisson = np.exp(-nu + n * math.log(nu) - special.gammaln(n + 1.0))
    return (poisson[:, None] * falling / float(cells) ** m)[:, tagged]


def _survival(state: Floats) -> float:
    """Return the probability that the gate has not reversed."""
    return float(state[(slice(None), *[0] * (state.ndim - 1))].sum())


def _over_cell(
    state: Floats, edges: Floats, now: float, h: float, nu: float
) -> tuple[Floats, float]:
    """Integrate over the newest cell; return the state and the mean duration of cycles in it."""
    steps = max(8, math.ceil(6.0 * h * nu))
    du, lasting = 1.0 / steps, 0.0

    def slopes(at: Floats, u: float) -> Floats:
        return 2.0 * h * u * _slopes(at, _rates(edges, now + h * u * u), nu)

    for u in np.arange(steps) * du:
        alive, first = _survival(state), slopes(state, u)
        second = slopes(state + 0.5 * du * first, u + 0.5 * du)
        third = slopes(state + 0.5 * du * second, u + 0.5 * du)
        fourth = slopes(state + du * third, u + du)
        state = state + du / 6.0 * (first + 2.0 * (second + third) + fourth)
        left, weight, late = _survival(state), 2.0 * h * u, 2.0 * h * (u + du)
        falls = _survival(first) + nu * state[(-1, *[0] * (state.ndim - 1))] * late
        # Simpson's rule; the value at the midpoint is from Hermite interpolation
        middle = 0.5 * (alive + left) + du / 8.0 * falls
        lasting += du / 6.0 * (weight * alive + late * left + 2.0 * (weight + late) * middle)
    return state, lasting


def _rates(edges: Floats, now: float) -> Floats:
    """Return the rate at which a particle of each cell leaves, 0 of none in particular first."""
    youngest, oldest = now - np.minimum(edges[1], now), now - edges[0]
    leaving = oldest > 1.0

    def still_inside(age: Floats) -> Floats:
        old = np.maximum(age, 1.0)
        return 1.0 / (old**2 + old * np.sqrt((old - 1.0) * (old + 1.0)))

    def time_inside(age: Floats) -> Floats:
        old = np.maximum(age, 1.0)
        late = 1.0 / (old + np.sqrt((old - 1.0) * (old + 1.0))) + np.arccos(1.0 / old)
        return np.where(age > 1.0, late, age)

    spent = np.where(leaving, time_inside(oldest) - time_inside(youngest), 1.0)
    rates = np.where(leaving, (still_inside(youngest) - still_inside(oldest)) / spent, 0.0)
    return np.concatenate([[0.0], rates])


def _slopes(state: Floats, mu: Floats, nu: float) -> Floats:
    """Return the time derivative of the moments."""
    order = state.ndim - 1
    out = _untagged(state, mu)
    slope = -(nu + sum(np.meshgrid(*[mu] * order, indexing="ij", sparse=True))) * state
    slope -= out
    slope[:-1] += out[1:]
    slope[1:] += nu * state[:-1]
    for axis in range(1, order + 1):  # entries into the newest cell
        newest, none = ([slice(1, None)] + [slice(None)] * order for _ in range(2))
        newest[axis], none[axis] = -1, 0
        none[0] = slice(-1)
        slope[tuple(newest)] += nu * state[tuple(none)]
    return slope


def _untagged(state: Floats, mu: Floats) -> Floats:
    """Return the loss of each moment by particles that it does not specify.

    A moment that does not specify all has it from the next one; the highest by the closure.
    """
    order = state.ndim - 1
    one_less = state @ mu
    out = np.empty_like(state)
    for axis in range(1, order + 1):
        np.moveaxis(out, axis, 1)[:, 0] = one_less
    n = np.arange(len(state), dtype=float)
    chance = state[(slice(None), *[0] * order)]
    falling = [np.prod([n - k for k in range(m)], axis=0) for m in range(order + 2)]
    unit = [np.where(chance > LEAST, chance, 1.0) * np.maximum(one, 1.0) for one in falling]
    scale = np.where(chance > LEAST, chance * falling[order + 1], 0.0)
    cells, rest = slice(1, None), [0] * (order - 2)
    single = state[(slice(None), cells, 0, *rest)] / unit[1][:, None]
    pair = state[(slice(None), cells, cells, *rest)] / unit[2][:, None, None]
    mean = one_less[(slice(None), 0, *rest)] / unit[1]
    drift = one_less[(slice(None), cells, *rest)] / unit[2][:, None] - mean[:, None] * single
    inner = out[(slice(None), *[cells] * order)]
    weight = (scale * mean / unit[order]).reshape(-1, *[1] * order)
    inner[:] = weight * state[(slice(None), *[cells] * order)]
    along = drift[:, :, None] * single[:, None, :]
    along += along.transpose(0, 2, 1)
    if order == 2:
        inner += scale[:, None, None] * along
        return out
    moved = one_less[:, 1:, 1:] / unit[3][:, None, None] - mean[:, None, None] * pair - along
    sizes = pair.shape
    left = scale[:, None, None] * np.stack([drift, single], axis=2)
    right = np.stack([pair, moved], axis=1)
    inner += (left @ right.reshape(sizes[0], 2, -1)).reshape(inner.shape)
    every = (np.broadcast_to(one[:, None], sizes) for one in (drift, single))
    parts = [*every, pair, moved]
    left = scale[:, None, None, None] * np.stack(parts, axis=3)
    inner += left @ np.stack([parts[k] for k in (2, 3, 0, 1)], axis=2)
    return out


def _grouped(state: Floats, groups: Floats) -> Floats:
    """Sum moments over the cells of each group; shape (cell, group), 1 where a cell is in it."""
    whole = np.zeros(np.add(groups.shape, 1))
    whole[0, 0], whole[1:, 1:] = 1.0, groups
    for _ in range(state.ndim - 1):
        state = np.moveaxis(np.tensordot(state, whole, (1, 0)), -1, state.ndim - 1)
    return state


def _pairs_of_old(edges: Floats, now: float, h: float) -> Floats:
    """Return groups of adjacent cells of equal width that are narrow relative to their age."""
    groups, at = [], 0
    widths = edges[1] - edges[0]
    while at < widths.size:
        count = 1
        if at + 1 < widths.size:
            age = now - edges[1, at + 1]
            allowed = h if age < 2.0 else 2.0 * h * 2.0 ** math.floor(math.log2(age))
            alike = abs(widths[at + 1] - widths[at]) < 0.01 * h
            count += bool(alike and edges[1, at + 1] - edges[0, at] <= 1.0001 * allowed)
        groups.append(np.isin(np.arange(widths.size), range(at, at + count)))
        at += count
    return np.array(groups, float).T


def simulated(threshold: int, load: float, entries: int, seed: int) -> tuple[float, float]:
    """Return the share that passes, and its error, of gates with so many entries in all.

    Each of `LANES` gates makes complete cycles, the last of which reaches its part of the entries.
    """
    random, rate = np.random.default_rng(seed), load / (0.5 * math.pi)
    lanes = min(LANES, max(1, entries // 1000))
    leaves, now = np.zeros((lanes, threshold)), np.zeros(lanes)  # times
    count, made = np.zeros(lanes), np.zeros(lanes)  # entries of this cycle, and before it
    cycles, squares = 0, 0.0
    while (going := np.flatnonzero(made < entries / lanes)).size:
        now[going] += random.exponential(1.0 / rate, going.size)
        count[going] += 1
        free = leaves[going] <= now[going, None]
        cosine = np.sqrt(1.0 - random.random(going.size) ** 2)
        fires = ~free.any(axis=1)
        entered = going[~fires]
        leaves[entered, free[~fires].argmax(axis=1)] = (now[going] + 1.0 / cosine)[~fires]
        fired = going[fires]
        cycles, squares = cycles + fired.size, squares + np.sum(count[fired] ** 2)
        made[fired] += count[fired]
        leaves[fired], now[fired], count[fired] = 0.0, 0.0, 0.0
    mean = made.sum() / cycles
    error = math.sqrt((squares / cycles - mean**2) / cycles)
    out = (threshold + 1.0) / mean
    return 1.0 - out, out * error / mean

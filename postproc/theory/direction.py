"""Stationary states of two urns that remember the opening and the direction of entry.

A visit conserves the angle of incidence. From opening 1 to opening 1 the angle to the channel
changes only by the difference of two positions on one arc, so s = |sin(theta)| of successive
entries into a gate diffuses, nearly as D d/ds (1 - s^2) d/ds. Oblique particles stay long in the
gate and are reversed again and again; the fast ones pass. With F_i(s), H_i(s) the densities of the
outflows of urn i into channels 1 and 2, and q_i(s) the probability to pass its gate
(`fate.passing`),

    B_i = (1 - q_i) F_i + q_j F_j          F_i = K11 B_i + K21 H_j          H_i = K12 B_i + K22 H_j.

The K are exact, not a diffusion: K_oo'(s, s') is the density of exits through opening o' at s' of
entries through opening o at s, summed over the pieces of `visits`. They are expanded in even
Legendre polynomials, orthonormal over 0 ... 1, as are F, H and B; the first is the cosine law.

D is half the mean square of the change of the angle, which is the sum of the positions y and y' of
entry and exit on their arcs. If these were independent it would be (w/r)^2/12. But for narrow
openings a visit from y back to y' has passed the opening before. With the lattice of `returns`,
without a second opening, xi = |y' - y| and mu = |y + y'| in units of the opening's arc have the
density (12/pi^2) ln((1 + mu + xi)/(1 + mu - xi))/xi on xi + mu < 1, so that

    D = (w/r)^2 <mu^2>/2 = (1/6 - 1/pi^2) (w/r)^2.

The second eigenvalues of K11, exp(-6 D), give 0.0664, 0.0655 and 0.0653 at w/r = 0.3, 0.1 and 0.03.

A circuit out of balance is held stationary by moving the difference of the flows from one urn to
the other, by the cosine law.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg, optimize
from scipy.special import expit, logit

from postproc.cli import InputError
from postproc.progress import doing
from postproc.theory import fate, ports
from postproc.theory.chain import between
from postproc.theory.circuit import Circuit
from postproc.theory.circulation import FIRST, circulating, with_circulation
from postproc.theory.ports import stays
from postproc.theory.states import State
from postproc.theory.visits import NARROW, visits

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

POLYNOMIALS = 12
DIFFUSION = 1.0 / 6.0 - 1.0 / math.pi**2  # D of narrow openings, in (w/r)^2 per visit
NARROWEST = 1e-9  # width of channel 2, in radii, that represents a closed one
ROUNDS = 56  # at most, of the iteration of gates and flows, over the weight of new q
AGREED = 1e-5 / 0.7  # change of q, and of flows relative to the largest, at which it ends
TAKEN = (0.7, 0.3, 0.1)  # weights of new q, a smaller one if a larger one overshoots
TURN_STEPS = 5  # parabolas, at most
NEAR = 0.3  # lowest |excess| of a parabola over that of the points, above which there is no zero
LEAST_SHARE = 1e-3  # of the particles in urns, in the emptier one, down to which all is computed
LAST_EVEN = 0.1  # of them, down to which points are even
EVENLY, FALLING = 10, 10  # points down to that, and from there to `LEAST_SHARE`
FURTHER, FEWEST = 10.0**-0.5, 1e-12  # step and end of shares below it
PASSES = 0.99  # of the entries into a gate, from which on it counts as one that never reverses
NEARER, NEAREST = 5, 40  # bisections of the last step towards what channel 2 alone brings, or more
APART = 1e-3  # of N, least distance of a state from a point of `scan` for flows of its own
NEXT_TO_EQUAL = 0.02  # distance of the first from equal urns


@dataclass(frozen=True)
class Transfer:
    """Effect of an urn on densities of direction, in the basis of polynomials.

    Attributes
    ----------
    kernel : kernel[o, p] takes entries through opening o to exits through p (0, 1: channels 1, 2),
        shape (2, 2, polynomial in, polynomial out).
    stay : mean number in the urn for entries at rate 1, shape (2, polynomial in).
    """

    kernel: Floats
    stay: Floats


def polynomials(sine: Floats) -> Floats:
    """Return the even Legendre polynomials, orthonormal over 0 ... 1: shape (polynomial, *s)."""
    square, found = sine**2, np.empty((POLYNOMIALS, *np.shape(sine)))
    found[0], before = 1.0, 0.0
    for k in range(POLYNOMIALS - 1):
        # s^2 p_k = after p_(k+1) + own p_k + before p_(k-1)
        n = 2.0 * k
        own = (2.0 * n * (n + 1.0) - 1.0) / ((2.0 * n - 1.0) * (2.0 * n + 3.0))
        after = (n + 1.0) * (n + 2.0) / (2.0 * n + 3.0)
        after /= math.sqrt((2.0 * n + 1.0) * (2.0 * n + 5.0))
        np.multiply(square - own, found[k], out=found[k + 1])
        if k:
            found[k + 1] -= before * found[k - 1]
        found[k + 1] /= after
        before = after
    return found


@lru_cache(maxsize=32)
def transfer(radius: float, width1: float, width2: float) -> Transfer:
    """Return the transfer of directions by a disc with openings of these widths.

    Summed over `visits`, and corrected such that all particles leave: quadrature loses up to 1e-6
    of them, and 5e-3 of the highest polynomial, more than leave through a very narrow channel 2.
    For narrow openings their limit is used.
    """
    widths = (width1, width2)
    if max(widths) < NARROW * radius:
        return _narrow_transfer(radius, *widths)
    kernel, stay = np.zeros((2, 2, POLYNOMIALS, POLYNOMIALS)), np.zeros((2, POLYNOMIALS))
    for own, other in ((0, 1), (1, 0)):
        found = visits(radius, widths[own], widths[other])
        for out, chosen in ((own, found.same), (other, ~found.same)):
            for part in found.parts(chosen):
                place, weight = part.nodes()
                entering = polynomials(np.sin(place - part.incidence).ravel())
                leaving = polynomials(np.sin(place + part.shift + part.incidence).ravel())
                inside = stays(radius, part, widths[own], widths[other])
                stay[own] += entering @ (weight * inside).ravel()
                kernel[own, out] += (entering * weight.ravel()) @ leaving.T
    for own in (0, 1):  # all particles leave, whatever their directions; so do reversed ones
        lost = np.eye(POLYNOMIALS)[0] - kernel[own, :, :, 0].sum(axis=0)
        kernel[own, own, :, 0] += lost
        kernel[own, own, 0, 1:] += lost[1:]
    return Transfer(kernel, stay)


def _narrow_transfer(radius: float, width1: float, width2: float) -> Transfer:
    """Return the transfer by narrow openings: probabilities, stays, and a diffusion for each way.

    In this limit the number of segments, and the positions of entry and exit, do not depend on the
    incidence.
    """
    widths = (width1, width2)
    port = ports.disc(Circuit(1, 1, width1, width2, radius))
    chance = np.array(
        [[1.0 - port.across, port.across], [1.0 - port.return_chance, port.return_chance]]
    )
    degree = 2.0 * np.arange(POLYNOMIALS)
    kernel = np.zeros((2, 2, POLYNOMIALS, POLYNOMIALS))
    for own, other in ((0, 1), (1, 0)):
        found = visits(radius, widths[own], widths[other])
        for out, chosen in ((own, found.same), (other, ~found.same)):
            square = total = 0.0
            for part in found.parts(chosen):
                place, weight = part.nodes()
                square += float((weight * (2.0 * place + part.shift) ** 2).sum())
                total += float(weight.sum())
            factor = np.exp(-0.5 * square / total * degree * (degree + 1.0))
            kernel[own, out] = np.diag(chance[own, out] * factor)
    sine, weights = fate.directions()
    chord = polynomials(sine) @ (weights * np.sqrt(1.0 - sine**2))
    return Transfer(kernel, np.outer([port.stay1, port.stay2], chord / chord[0]))


@dataclass(frozen=True)
class Held:
    """A circuit held stationary with given numbers in the urns; arrays by urn.

    Attributes
    ----------
    entries, across : densities F and H by polynomial, shape (urn, polynomial).
    passing : q at the nodes of `fate.directions`, shape (urn, node).
    in_urn, in_half : numbers in the urns, and in the halves.
    through : flow through each gate per unit time.
    agreed : whether the iteration that finds them has come to its end.
    """

    entries: Floats
    across: Floats
    passing: Floats
    in_urn: Floats
    in_half: Floats
    through: Floats
    agreed: bool = False

    @property
    def net_current(self) -> float:
        """Current of channel 2 from urn 2 to urn 1."""
        return float(self.across[1, 0] - self.across[0, 0])

    @property
    def possible(self) -> bool:
        """Whether all flows are positive: an urn holds at least what channel 2 brings."""
        return bool(self.entries[:, 0].min() > 0.0 and self.across[:, 0].min() > 0.0)

    @property
    def known(self) -> bool:
        """Whether flows are found."""
        return self.possible and self.agreed

    @property
    def sent(self) -> Floats:
        """Flow from each half to the other per unit time."""
        return self.through + np.maximum(self.across[:, 0], 0.0)


class Directions:
    """The equations of one circuit, ready to be solved."""

    def __init__(self, circuit: Circuit) -> None:
        """Prepare the transfer matrices of both urns (equal circuits: one)."""
        self.circuit = circuit
        self.sides = circuit.sides
        radii, width = [float(one.urn_radius) for one in self.sides], float(circuit.channel2_width)
        wide = max(width, NARROWEST * max(radii))
        self.part = width / wide  # of what flows in the channel 2 that represents a narrower one
        self.urns = [transfer(radius, float(circuit.channel1_width), wide) for radius in radii]
        self.sine, self.weights = fate.directions()
        self.basis = polynomials(self.sine)
        half = 0.5 * float(circuit.channel1_length)
        self.stays = half / np.sqrt((1.0 - self.sine) * (1.0 + self.sine))

    def weighted(self, share: Floats) -> Floats:
        """Return the matrix that takes a density to it times a share at each direction."""
        return (self.basis * (self.weights * share)) @ self.basis.T

    def passing(self, urn: int, density: Floats) -> Floats:
        """Return q of a gate, given the number of entries per unit time at each direction."""
        rate = max(float(density.sum()), 1e-300)
        return fate.passing(int(self.sides[urn].threshold), rate, self.stays, density / rate)

    def allow(self, held: Held) -> bool:
        """Whether flows are found and, of equal circuits, the fuller urn 2 feeds channel 2."""
        return held.known and (not self.circuit.alike or held.net_current >= 0.0)

    def held(self, share: float, start: Held | None = None) -> Held:
        """Return the circuit held with N particles, given urn 1's share of those in urns.

        `start` is a neighbouring solution to begin with.
        """
        number = float(self.circuit.number)
        found = start
        if found is None:
            parts = number * np.array([share, 1.0 - share])
            entries, across = np.zeros((2, POLYNOMIALS)), np.zeros((2, POLYNOMIALS))
            for k, one in enumerate(self.sides):
                per_width = parts[k] / (math.pi * float(one.urn_area))
                entries[k, 0] = per_width * float(one.channel1_width)
                across[k, 0] = per_width * float(one.channel2_width)
            found = self._with_fates(entries, across, parts)
        first = found
        for taken in TAKEN:
            found = self._iterated(share, first, taken)
            if found.agreed or not found.possible:
                break
        return found

    def _iterated(self, share: float, found: Held, taken: float) -> Held:
        """Return the last iteration of gates and flows with a weight of new q."""
        least = AGREED * taken
        for _ in range(round(ROUNDS / taken)):
            parts = np.array([share, 1.0 - share]) * found.in_urn.sum()
            parts *= float(self.circuit.number) / found.in_half.sum()
            entries, across = self._flows(found.passing, parts)
            before, found = found, self._with_fates(entries, across, parts, found.passing, taken)
            if not found.possible:
                break
            changed = np.abs(found.entries - before.entries).max()
            if changed <= least * np.abs(found.entries).max() and np.all(
                np.abs(found.passing - before.passing) < least
            ):
                return replace(found, agreed=True)
        return found

    def _flows(self, passing: Floats, parts: Floats) -> tuple[Floats, Floats]:
        """Return F and H for given q and `parts` in the urns: linear equations."""
        size = POLYNOMIALS
        gate = [self.weighted(one) for one in passing]
        unit = np.eye(size)
        source = np.zeros((size, 4 * size))  # the difference of flows, by the cosine law
        source[0, :size], source[0, size : 2 * size] = gate[0][0], -gate[1][0]
        source[0, 2 * size], source[0, 3 * size] = 1.0, -1.0
        rows, held = [], []
        for k in (0, 1):
            mine, theirs = slice(k * size, (k + 1) * size), slice((1 - k) * size, (2 - k) * size)
            sent_back = source * (1.0 if k == 0 else -1.0)
            sent_back[:, mine] += unit - gate[k]
            sent_back[:, theirs] += gate[1 - k]
            arriving = np.zeros((size, 4 * size))
            arriving[:, (3 - k) * size : (4 - k) * size] = unit
            urn = self.urns[k]
            for opening in (0, 1):
                leaving = np.zeros((size, 4 * size))
                at = (2 * opening + k) * size
                leaving[:, at : at + size] = unit
                made = urn.kernel[0, opening].T @ sent_back + urn.kernel[1, opening].T @ arriving
                rows.append(leaving - made)
            held.append(urn.stay[0] @ sent_back + urn.stay[1] @ arriving)
        matrix = np.concatenate([*rows, np.array(held)])
        right = np.concatenate([np.zeros(4 * size), parts])
        # many times faster than by singular values, and as sure of the rank
        solution = linalg.lstsq(matrix, right, lapack_driver="gelsy")[0].reshape(4, size)
        return solution[:2], solution[2:]

    def _with_fates(
        self, entries: Floats, across: Floats, parts: Floats, before: Floats | float = 0.0,
        taken: float = 1.0,
    ) -> Held:  # fmt: skip
        """Return flows with the q that they determine, mixed with those of `before`."""
        density = np.maximum(entries @ self.basis, 0.0) * self.weights
        rates = np.maximum(density.sum(axis=1), 1e-300)
        loads = density @ self.stays
        passing = np.array([self.passing(urn, law) for urn, law in enumerate(density)])
        passing = taken * passing + (1.0 - taken) * before
        through = (passing * density).sum(axis=1)
        thresholds = np.array([float(one.threshold) for one in self.sides])
        beyond = (passing * density) @ self.stays
        beyond = beyond + 0.25 * math.pi * float(self.circuit.channel2_length) * across[:, 0]
        turning = (1.0 - through / rates) * np.minimum(thresholds, loads)
        return Held(
            entries, across, passing, parts, parts + turning + beyond + beyond[::-1], through
        )


def _shares() -> Floats:
    """Return shares of an urn at which a circuit is held, decreasing from almost 1/2."""
    even = np.linspace(0.5 * (1.0 - NEXT_TO_EQUAL), LAST_EVEN, EVENLY)
    return np.concatenate([even, np.geomspace(LAST_EVEN, LEAST_SHARE, FALLING + 1)[1:]])


def _excess(held: Held, urn: int = 0) -> float:
    return math.log(held.sent[urn] / held.sent[1 - urn])


@lru_cache(maxsize=8)
def scan(circuit: Circuit) -> tuple[tuple[float, Held], ...]:
    """Return (share of urn 1, circuit held there) for decreasing shares; also above 1/2 if unequal.

    States, flows and outflows are computed from it, so it is cached.
    """
    equations = Directions(circuit)
    found = _emptied(equations, 0)
    if not circuit.alike:
        above = [(1.0 - share, held) for share, held in _emptied(equations, 1)]
        found = [*reversed(above), *found]
    if not found:
        raise _no_flows(circuit)
    return tuple(found)


def _no_flows(circuit: Circuit) -> InputError:
    return InputError(f"theory direction: it finds no flows between the urns, {circuit.brief}")


def _emptied(equations: Directions, urn: int) -> list[tuple[float, Held]]:
    """Return (share of an urn, circuit held there) from almost 1/2 until it gains for good."""
    shares, tries = list(_shares()), 0
    found: list[tuple[float, Held]] = []
    with doing("directions, share", len(shares)) as advance:
        while shares and (tries < NEARER or (tries < NEAREST and _excess(found[-1][1], urn) > 0.0)):
            share1 = shares[0] if urn == 0 else 1.0 - shares[0]
            held = equations.held(share1, found[-1][1] if found else None)
            if equations.allow(held):
                found.append((shares.pop(0), held))
            elif found and (tries or not held.possible or shares[0] <= LAST_EVEN):
                shares, tries = [0.5 * (found[-1][0] + shares[0])], tries + 1
            else:  # next to equal urns the fuller one may gain by channel 2
                shares.pop(0)
            ended = not found or found[-1][0] <= FEWEST
            if not (shares or ended) and _excess(found[-1][1], urn) <= 0.0:
                # with fewer it gains, too, if its gate hardly reverses
                held = found[-1][1]
                ended = tries > 0 or held.through[urn] >= PASSES * held.entries[urn, 0]
            if not (shares or ended):
                shares = [FURTHER * found[-1][0]]
            advance()
    return found


def growth(circuit: Circuit) -> float:
    """Return a number with the sign of the growth of a small difference between equal urns."""
    equations = Directions(circuit)
    here, beside = _shares()[:2]
    held = equations.held(here)
    # the fuller urn may gain by channel 2 next to equal urns, if it feeds it farther off
    known = equations.allow(held) or (held.known and equations.allow(equations.held(beside)))
    # a channel 2 that represents a closed one must carry less than the gates
    if not known or (equations.part < 1.0 and held.across[0, 0] > held.through[0]):
        raise _no_flows(circuit)
    found = _excess(held)
    return -found if found < 0.0 and _growing_modes(equations, held) > 1 else found


def _growing_modes(equations: Directions, held: Held) -> int:
    """Return how many modes of small differences between equal urns grow, given flows close by.

    A circuit that is held tells by its sign only whether their number is odd. Where directions
    relax slowly, in a narrow channel 1 beside a narrower channel 2, a second mode may grow.

    Equal urns have F and H of the cosine law. A difference phi of F, chi of H gives

        B = (1 - 2 q) phi - 2 F (dq/dF) phi,  out of an urn  K11 B - K21 chi  and  K12 B - K22 chi.

    Each outflow is taken to relax to this in the mean stay of those who enter by its opening; the
    time in gates and channels is neglected.
    """
    rate, urn, size = float(held.entries[:, 0].mean()), equations.urns[0], POLYNOMIALS
    unit = np.eye(size)

    def passing(entries: Floats) -> Floats:
        return equations.passing(0, np.maximum(entries @ equations.basis, 0.0) * equations.weights)

    step = 1e-4 * rate
    change = [(passing(rate * unit[0] + step * one) - passing(rate * unit[0] - step * one))
              / (2.0 * step) for one in unit]  # fmt: skip
    sent_back = equations.weighted(1.0 - 2.0 * passing(rate * unit[0]))
    sent_back -= 2.0 * rate * (equations.basis * equations.weights) @ np.array(change).T
    leaving = np.block(
        [[urn.kernel[0, out].T @ sent_back, -urn.kernel[1, out].T] for out in (0, 1)]
    )
    rates = (leaving - np.eye(2 * size)) / np.repeat(urn.stay[:, 0], size)
    return int((linalg.eigvals(rates).real > 0.0).sum())


def homogeneous_kind(circuit: Circuit) -> str:
    """Return whether the state with equal numbers is "stable" or "unstable"."""
    if circuit.closed:
        return "neutral"
    return "stable" if growth(circuit) <= 0.0 else "unstable"


def _with_turns(
    equations: Directions, points: Sequence[tuple[float, Held]]
) -> list[tuple[float, Held]]:
    """Return points of a scan, and places between them where `_excess` has another sign.

    There it is between two states that lie between the same two points, next to where both begin to
    exist. They are sought where |excess| has a minimum, by parabolas in ln(share/(1 - share)).
    """
    more = []
    for trio in zip(points, points[1:], points[2:], strict=False):
        places, values = [logit(one[0]) for one in trio], [_excess(one[1]) for one in trio]
        sign, latest = np.sign(values[1]), trio[1][1]
        heights = [sign * one for one in values]
        if not 0.0 < heights[1] < min(heights[0], heights[2]):
            continue
        for _ in range(TURN_STEPS):
            shape = np.polynomial.Polynomial.fit(places, heights, 2)
            (lowest,) = shape.deriv().roots()
            if not places[2] < lowest < places[0] or shape(lowest) > NEAR * heights[1]:
                break
            latest = equations.held(share := float(expit(lowest)), latest)
            if not equations.allow(latest):
                break
            height, at = sign * _excess(latest), 1 if lowest > places[1] else 2
            if height < 0.0:
                more.append((share, latest))
                break
            places.insert(at, lowest)
            heights.insert(at, height)
            kept = slice(0, 3) if np.argmin(heights) == 1 else slice(1, 4)
            places, heights = places[kept], heights[kept]
    return sorted([*points, *more], key=lambda one: -one[0])


@lru_cache(maxsize=8)
def held_states(circuit: Circuit) -> tuple[tuple[Held, str], ...]:
    """Return the circuit held in each of its states, and the kind of the state.

    As `scan`, it is asked for states and kinds.
    """
    equations, found = Directions(circuit), []
    for (one, here), (other, there) in pairwise(_with_turns(equations, scan(circuit))):
        before, after = _excess(here), _excess(there)
        if np.sign(before) * np.sign(after) >= 0.0:
            continue

        latest, ends = [here], {one: before, other: after}

        def excess(
            share: float, latest: list[Held] = latest, ends: dict[float, float] = ends
        ) -> float:
            if share in ends:  # iterated from another start it might differ
                return ends[share]
            latest[0] = equations.held(share, latest[0])
            return _excess(latest[0])

        emptier = min(one, 1.0 - other)
        optimize.brentq(excess, other, one, xtol=1e-5 * min(1.0, emptier / LEAST_SHARE))
        found.append((latest[0], "stable" if before > 0.0 else "unstable"))
    last = scan(circuit)[-1][1]
    if circuit.alike and _excess(last) > 0.0:  # all that channel 2 does not bring is in one urn
        found.append((last, "stable"))
    return tuple(found)


def around(
    circuit: Circuit, held: Held, age: ArrayLike = math.inf, *, seed: int = FIRST
) -> tuple[Floats, Floats]:
    """Return the circulating current of a held circuit at each age, and its standard error."""
    urns = [ports.disc(side) for side in circuit.sides]
    flows = held.entries[:, 0], held.across[:, 0]
    return circulating(circuit, urns, *flows, age, seed=seed)


def stationary_states(circuit: Circuit) -> list[State]:
    """Return the states of a circuit, for equal urns those with N2 > N/2 (chi above 0.02).

    Left out is an unstable one next to unstable equal urns: there the second of the modes that grow
    (`_growing_modes`) ceases to. `flows` and `outflows`, at given numbers, balance there too.

    Raises `InputError` if of unequal urns or gates the first or the last is not stable: it is not
    found.
    """
    number, found = float(circuit.number), []
    held_ones = held_states(circuit)
    kinds = [kind for _, kind in held_ones]
    if circuit.alike and kinds[:1] == ["unstable"] and homogeneous_kind(circuit) == "unstable":
        held_ones = held_ones[1:]
    if not circuit.alike and {"stable"} != {*kinds[:1], *kinds[-1:]}:
        raise InputError(f"theory direction: it does not find all states, {circuit.brief}")
    part = Directions(circuit).part
    for held, kind in held_ones:
        second = float(held.in_half[1])
        chi = abs(2.0 * second - number) / number
        state = State(second, kind, chi, part * held.net_current)
        found.append(with_circulation(state, *around(circuit, held, [circuit.age, math.inf])))
    return found


def _along(circuit: Circuit, what: Callable[[Held], ArrayLike]) -> tuple[Floats, Floats]:
    """Return N2 at places, and what is asked there of the urns: (N2, ..., urn).

    Places are the points of `scan`, and the states between them, so that eta is 0 there.
    """
    held = [one for _, one in scan(circuit)]
    known = np.array([one.in_half[1] for one in held])
    held += [one for one, _ in held_states(circuit)
             if np.abs(known - one.in_half[1]).min() > APART * float(circuit.number)]  # fmt: skip
    second, found = np.array([one.in_half[1] for one in held]), np.array(list(map(what, held)))
    if circuit.alike:  # the mirror images
        second = np.concatenate([float(circuit.number) - second[::-1], second])
        found = np.concatenate([found[::-1, ..., ::-1], found])
    return second, found


def flows(circuit: Circuit, number2: float) -> Floats:
    """Return the flows of channels 1 and 2 from urn 1 to 2 and back at N2 = `number2`.

    Per unit time, shape (channel, way); without circulation. Interpolated between points of `scan`.
    """
    second, carried = _along(circuit, lambda held: [held.through, held.across[:, 0]])
    carried[:, 1] *= Directions(circuit).part
    return between(second, np.moveaxis(carried, 0, -1), number2)


def outflows(circuit: Circuit) -> tuple[Floats, Floats]:
    """Return N2 and the logarithms of the flows between the halves, as `Theory.outflows`."""
    second, sent = _along(circuit, lambda held: held.sent)
    return second, np.log(np.maximum(sent.T, 1e-300))

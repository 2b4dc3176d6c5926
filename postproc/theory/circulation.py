"""Circulating particles, which cross urns without a wall hit, and the current they carry.

In `ports` the memory of an urn is only the opening of entry. Along the axis it is more: a
particle that leaves one opening nearly along the axis crosses the urn without a wall hit, passes
channel 1 or is reversed there as by a flat mirror, crosses an urn again, and so on until it hits a
wall. This depends only on walls and gates, so such particles are followed one by one.

All lengths are along the axis, the slope is u > 0 (a state and its mirror image at the axis are
one). From the position x in the opening of channel 2 to y in that of channel 1 and back:

    x -> y = x + u d                              lost unless |y| < w/2
    y -> y + u l  mod w    if the gate lets it through, chance q, into the other urn
    y -> y + 2 u s mod w   if it is turned back at depth s, into the same urn
    y -> x = y + u d                              lost unless |x| < w'/2
    x -> x + u l' mod w'                          through channel 2, into the other urn

d is the distance across the urn. Particles that come from walls have the densities of the outflows
of urns in position and sin(theta): e/(2w) into channel 1, f/(2w') into channel 2. So particles are
put into channel 2 uniformly in x and u, with the weight of each way by which they come *from a
wall* in one step: straight out of the urn; reversed by its gate; through channel 1 from the other
urn. Those that come from an opening are counted already, as later rounds of others: so orbits
between two openings are not filled again from the dense urn in each round.

Of the T + 1 particles that a gate reverses, the j-th to enter has been inside for j entries.

The flow that crosses an urn straight is compared with that of `ports` on the same lines, e (1 - q)
+ e' q' and f. The difference crosses with certainty, while by `ports` it crosses with the
probability P12, or returns with the probability a: this is a source between the openings, with the
effect `response` on the current. Beyond `ROUNDS` the rest falls as 1/m, less the particles that the
gate of the sparse urn reverses.

The particles are random, but always the same ones; half of them have slopes at which they may
circulate for long: those at which a round shifts them by nearly a simple fraction of w'. So the
current has a statistical error, 0.05 to 1 % of the net current; it is found from the scatter of
groups of particles (`circulating`).
"""

from __future__ import annotations

import math
from dataclasses import astuple, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize, special

from postproc.theory import fate, ports

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.ports import Ports
    from postproc.theory.states import State

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]
    Flags = NDArray[np.bool_]

SAMPLES = 2**16  # particles that are put into channel 2 from each urn
GROUPS = 16  # of particles, whose scatter gives the error
FIRST = 1  # seed of the particles that are always the same
PARTS = 6  # of w': fractions by which a round shifts long-lived particles
MOST_TURNS = 300  # of reflections a round whose shifts are listed, where channel 1 is long
NEAR = (3e-4, 0.3)  # of w' per round: distances to such shifts at which slopes are drawn
ROUNDS = 512  # for which they are followed
LATE = 64  # rounds from which the 1/m law is used
GONE = 30.0  # exponent above which the rest is 0
FEWEST = 1e-9  # smallest share of the particles from which the search for flows begins


def _folded(place: Floats, width: float) -> Floats:
    """Fold positions, unfolded at the walls of a channel, back into it."""
    return place - width * np.floor(place / width + 0.5)


class Straight:
    """Particles of a circuit that cross urns without a wall hit.

    Parameters
    ----------
    circuit : the circuit.
    entries, across : e and f, outflows of urns 1 and 2 into channels 1 and 2 per unit time.
    share : q of the shortest stay, of both gates.
    seed : of the particles drawn; another one draws others.
    """

    def __init__(
        self, circuit: Circuit, entries: Floats, across: Floats, share: Floats, *,
        seed: int = FIRST,
    ) -> None:  # fmt: skip
        """Prepare the lengths and shares for following particles."""
        self.widths = float(circuit.channel1_width), float(circuit.channel2_width)
        self.lengths = float(circuit.channel1_length), float(circuit.channel2_length)
        self.distance = np.array([float(sum(one.chords)) for one in circuit.sides])
        self.threshold = np.array([int(one.threshold) for one in circuit.sides])
        self.entries, self.share, self.seed = entries, share, seed
        self.into_gate = entries / (2.0 * self.widths[0])
        self.in_channel = across / (2.0 * self.widths[1])

    @property
    def decay(self) -> float:
        """Logarithm by which the sparse gate makes each round less."""
        return -math.log(min(max(float(self.share.max()), 1e-300), 1.0 - 1e-12))

    def depth(self, urn: Integers, slope: Floats, draw: np.random.Generator) -> Floats:
        """Return the depths in the gates at which particles are reversed."""
        place = draw.integers(0, (self.threshold + 1)[urn])
        inside = draw.standard_gamma(place) / np.maximum(self.entries, 1e-300)[urn]
        deep = inside / np.sqrt(1.0 + slope**2)
        anywhere = 0.5 * self.lengths[0] * draw.random(urn.size)
        return np.where(deep < 0.5 * self.lengths[0], deep, anywhere)

    def slopes(self, draw: np.random.Generator) -> tuple[Floats, Floats]:
        """Return slopes and the interval of slopes of each; 0 outside of all openings."""
        (width1, width2), outside = self.widths, self.distance.sum() + self.lengths[0]
        whole = outside + self.lengths[1]
        steepest = 0.5 * (width1 + width2) / self.distance.min()
        lasting = [np.zeros(0)]
        # Their choice changes only the error: the density below is exact whichever they are.
        last_turn = int(steepest * outside / width1 + 1.0)
        for k in np.unique(np.linspace(0, last_turn, min(last_turn, MOST_TURNS) + 1).astype(int)):
            first, last = ((k * width1 + sign * width2) / outside for sign in (-1.0, 1.0))
            lasting.append(np.array([k * width1 / outside]))
            for part in range(1, PARTS + 1):
                ends = [(one * whole - k * width1) * part / width2 for one in (first, last)]
                turns = np.arange(math.ceil(ends[0]), math.floor(ends[1]) + 1) / part
                lasting.append((k * width1 + turns * width2) / whole)
        middle = np.unique(np.concatenate(lasting).round(12))
        middle = middle[(middle >= 0.0) & (middle <= steepest)]
        least, most = (one * width2 / whole for one in NEAR)
        spread = math.log(most / least)
        off = least * np.exp(spread * draw.random(SAMPLES)) * draw.choice([-1.0, 1.0], SAMPLES)
        near = draw.choice(middle, SAMPLES) + off
        slope = np.where(draw.random(SAMPLES) < 0.5, near, steepest * draw.random(SAMPLES))
        order = np.argsort(slope)
        ascending, density = slope[order], np.full(SAMPLES, 0.5 / steepest)
        ends = np.searchsorted(ascending, middle[:, None] + [-most, -least, least, most])
        for one, (first, last, start, stop) in zip(middle, ends, strict=True):
            for here in (slice(first, last), slice(start, stop)):  # on either side of it
                away = np.abs(ascending[here] - one)
                density[here] += 0.25 / (spread * middle.size * away)
        density[order] = density.copy()
        allowed = (slope > 0.0) & (slope < steepest)
        return np.abs(slope), np.where(allowed, 1.0 / (density * SAMPLES), 0.0)

    def begun(self, start: int, draw: np.random.Generator) -> tuple[Floats, ...]:
        """Return position, slope, and volume in both, of the outflow of urn `start` into channel 2.

        Also its parts that come from a wall, per unit time: straight out of the urn; reversed by
        its gate; through channel 1 from the other urn; shape (origin, particle).
        """
        other, (width1, width2) = 1 - start, self.widths
        slope, share = self.slopes(draw)
        place = width2 * (draw.random(SAMPLES) - 0.5)
        volume = 2.0 * width2 * share * (1.0 + slope**2) ** -1.5  # slopes of both signs
        mouth = place - slope * self.distance[start]
        on_line = np.abs(mouth) < 0.5 * width1
        weights = [np.where(on_line, 0.0, self.in_channel[start]) * volume]
        turned = 2.0 * slope * self.depth(np.full(slope.size, start), slope, draw)
        for urn, chance, shift in (
            (start, 1.0 - self.share[start], turned),
            (other, self.share[other], slope * self.lengths[0]),
        ):
            came = _folded(mouth - shift, width1) - slope * self.distance[urn]
            from_wall = on_line & (np.abs(came) >= 0.5 * width2)
            weights.append(np.where(from_wall, chance * self.into_gate[urn], 0.0) * volume)
        return place, slope, volume, np.array(weights)

    def rounds(
        self, start: int, place: Floats, slope: Floats, draw: np.random.Generator
    ) -> Iterator[tuple[Integers, Integers, Integers, Integers, Flags]]:
        """Follow particles that urn `start` sends into channel 2, round by round.

        Yields the particles that have crossed an urn from channel 2 to channel 1, and the urn;
        those that have then crossed one from channel 1 to channel 2, the urn, and whether they have
        come through channel 1 from the other urn.
        """
        (width1, width2), (length1, length2) = self.widths, self.lengths
        which, urn = np.arange(slope.size), np.full(slope.size, 1 - start)
        for _ in range(ROUNDS):
            place = _folded(place + slope * length2, width2) + slope * self.distance[urn]
            there = np.flatnonzero(np.abs(place) < 0.5 * width1)
            place, slope, urn, which = (one.take(there) for one in (place, slope, urn, which))
            arrived = which, urn
            through = draw.random(urn.size) < self.share[urn]
            shift = np.where(through, length1, 2.0 * self.depth(urn, slope, draw))
            urn = np.where(through, 1 - urn, urn)
            place = _folded(place + slope * shift, width1) + slope * self.distance[urn]
            there = np.flatnonzero(np.abs(place) < 0.5 * width2)
            place, slope, urn, which = (one.take(there) for one in (place, slope, urn, which))
            yield *arrived, which, urn, through.take(there)
            if not which.size:
                return
            urn = 1 - urn

    def by_group(self, start: int) -> tuple[Floats, Floats]:
        """Return the flows that cross urns straight in excess of those by `ports`, by round.

        For particles that begin in urn `start`, per unit time: from channel 1 to channel 2, and
        from channel 2 to channel 1; by group of particles, shape (group, urn, round).
        """
        draw = np.random.default_rng(self.seed)
        place, slope, volume, weights = self.begun(start, draw)
        weight, other = weights.sum(axis=0), 1 - start
        down, up = np.zeros((2, GROUPS, 2, ROUNDS + 1))
        group = np.arange(SAMPLES) % GROUPS
        arriving = (1.0 - self.share[start]) * self.into_gate[start]
        arriving += self.share[other] * self.into_gate[other]
        on_line = np.abs(place - slope * self.distance[start]) < 0.5 * self.widths[0]
        more = weights[1:].sum(axis=0) - arriving * np.where(on_line, volume, 0.0)
        down[:, start, 0] = np.bincount(group, more, GROUPS)
        ahead = _folded(place + slope * self.lengths[1], self.widths[1])
        on_line = np.abs(ahead + slope * self.distance[other]) < 0.5 * self.widths[0]
        more = -self.in_channel[start] * np.where(on_line, volume, 0.0)
        up[:, other, 0] = np.bincount(group, more, GROUPS)
        known = weight > 0.0
        weight, group = weight[known], 2 * group[known]
        followed = self.rounds(start, place[known], slope[known], draw)
        for m, (arrived, urn1, left, urn2, _) in enumerate(followed, start=1):
            for flow, which, urn in ((up, arrived, urn1), (down, left, urn2)):
                found = np.bincount(group.take(which) + urn, weight.take(which), 2 * GROUPS)
                flow[:, :, m] = found.reshape(GROUPS, 2)
        return down, up


def followed(
    circuit: Circuit, entries: Floats, across: Floats, *, seed: int = FIRST
) -> Straight:  # fmt: skip
    """Return the particles that cross urns straight, with the gates' shares at these entries."""
    stays, shares = fate.cosine_law(0.5 * float(circuit.channel1_length))
    share = [
        fate.passing(int(one.threshold), float(rate), stays, shares)[0]
        for one, rate in zip(circuit.sides, entries, strict=True)
    ]
    return Straight(circuit, entries, across, np.array(share), seed=seed)


def filled(terms: Floats, decay: float, rounds: Floats) -> Floats:
    """Return the sum of terms by round, 0 to `ROUNDS` and `beyond`, to each of `rounds`."""
    flown = np.interp(rounds, np.arange(ROUNDS + 1), np.cumsum(terms))
    return flown + beyond(terms, decay, rounds)


def round_time(circuit: Circuit) -> float:
    """Return the time of a round at speed 1: across both urns and through both channels."""
    across = sum(float(sum(one.chords)) for one in circuit.sides)
    return across + float(circuit.channel1_length) + float(circuit.channel2_length)


def response(one: Ports) -> float:
    """Return the current due to a source of 1 between an urn's openings, at fixed numbers.

    J (1 + a - 2 P12) = P12 (e_2 - e_1) + source, t1 (e_2 - e_1) = n_2 - n_1 - (2 t1 - t2) J.
    """
    drop = one.across * (2.0 - one.stay2 / one.stay1)
    return 1.0 / (1.0 + one.return_chance - 2.0 * one.across + drop)


def beyond(late: Floats, decay: float, rounds: Floats) -> Floats:
    """Return the sum of the terms after `late`, as exp(-decay m)/m, up to each of `rounds`.

    Parameters
    ----------
    late : terms to be summed, of rounds 0 to ROUNDS.
    decay : decay rate per round, apart from the 1/m.
    rounds : of any shape.
    """
    if decay * ROUNDS > GONE:
        return np.zeros(rounds.shape)
    m = np.arange(LATE, late.size)
    height = (m * np.exp(decay * m) * late[LATE:]).mean()
    ends = [special.exp1(decay * (one + 0.5)) for one in (ROUNDS, np.maximum(rounds, ROUNDS))]
    return height * (ends[0] - ends[1])


def with_circulation(state: State, around: Floats, error: Floats) -> State:
    """Return a state with the circulating currents at the circuit's age and at an infinite one."""
    now, late = map(float, around)
    return replace(
        state, net_current=state.net_current + now, circulating_current=now,
        net_current_infinite_age=state.net_current + late, net_current_error=float(error[0]),
    )  # fmt: skip


def carried(
    straight: Straight, circuit: Circuit, urns: Sequence[Ports], age: ArrayLike = math.inf
) -> tuple[Floats, Floats]:
    """Return the current of `circulating` that some particles carry, and its error."""
    rounds = np.asarray(age, float) / round_time(circuit)
    terms = np.zeros((GROUPS, ROUNDS + 1))
    for start in (0, 1):
        down, up = straight.by_group(start)
        for urn, sign in ((0, -1.0), (1, 1.0)):
            one = urns[urn]
            source = (1.0 - one.across) * down[:, urn] - one.return_chance * up[:, urn]
            terms += sign * response(one) * source
    found = np.array([filled(one, straight.decay, rounds) for one in terms])
    return found.sum(axis=0), math.sqrt(GROUPS) * found.std(axis=0, ddof=1)


def circulating(
    circuit: Circuit, urns: Sequence[Ports], entries: Floats, across: Floats,
    age: ArrayLike = math.inf, *, seed: int = FIRST,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return the current of channel 2 from urn 2 to urn 1 by straight passages, at each age.

    Without the part that `ports` includes already; and its standard error, from the scatter of
    groups of the particles that are drawn. Zero unless channel 2 is the narrower one: the effect of
    a source is derived for urns that an opening does not empty.

    Parameters
    ----------
    urns : the ports of urns 1 and 2.
    entries, across : e and f, their outflows into channels 1 and 2 per unit time, shape (2,).
    age : age of the run, of any shape: orbits of more rounds than fit into it are not filled yet.
    seed : of the particles drawn.
    """
    if not 0.0 < float(circuit.channel2_width) < float(circuit.channel1_width):
        return np.zeros(np.shape(age)), np.zeros(np.shape(age))
    own = np.asarray(entries, float), np.asarray(across, float)
    return carried(followed(circuit, *own, seed=seed), circuit, urns, age)


def circulating_at(circuit: Circuit, number2: float, ages: ArrayLike) -> Floats:
    """Return the circulating current of a circuit held at N2 = `number2`, at each age of a run.

    Age 0 is the current of one round, which is present at once; infinity the stationary one. The
    urns are discs that remember the opening of entry; their inflows b by channel 1 are those that
    give both halves their numbers, or the nearest if channel 2 alone brings more to one:

        f_i = P12 b_i + a f_j          e_i = (1 - P12) b_i + (1 - a) f_j.
    """
    urns = [ports.disc(side) for side in circuit.sides]
    back, across, stay1, stay2 = np.array([astuple(one) for one in urns]).T
    wanted = np.array([float(circuit.number) - number2, number2])
    thresholds = np.array([float(side.threshold) for side in circuit.sides])
    time1, time2 = (0.25 * math.pi * float(one)
                    for one in (circuit.channel1_length, circuit.channel2_length))  # fmt: skip

    def outflows(arriving1: Floats) -> tuple[Floats, Floats]:
        leaving2 = across * arriving1
        leaving2 = (leaving2 + back * leaving2[::-1]) / (1.0 - back.prod())
        return (1.0 - across) * arriving1 + (1.0 - back) * leaving2[::-1], leaving2

    def excess(log_arriving1: Floats) -> Floats:
        arriving1 = np.exp(log_arriving1)
        entries, leaving2 = outflows(arriving1)
        share = circuit.gate.share(thresholds, time1 * entries)
        beyond = share * time1 * entries + time2 * leaving2
        turning = (1.0 - share) * np.minimum(thresholds, time1 * entries)
        in_urn = stay1 * arriving1 + stay2 * leaving2[::-1]
        return in_urn + turning + beyond + beyond[::-1] - wanted

    start = np.log(np.maximum(wanted, FEWEST * wanted.sum()) / stay1)
    found = optimize.least_squares(excess, start).x
    return circulating(circuit, urns, *outflows(np.exp(found)), ages)[0]

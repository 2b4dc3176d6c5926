"""One-particle theory: exact visits of a particle, and gates filled by independent others.

The program `one_particle` moves walkers by exact visits in several copies of the
circuit; a walker enters the gate of a random copy. So every gate is a renewal gate at the walkers'
own rate, with their own stays, and no number is taken from a run. One copy would be the circuit
itself. With two, the fewest, particles that a gate has reversed together do not meet again
systematically; their numbers fluctuate with half the variance of the circuit's. That matters next
to a transition: with many copies chi is too large there, by up to 0.03 at N = 1000. chi and current
are, as in runs, those of the urn that is the fuller one at the time. States are found by starting
walkers from several shares of the urns; unstable ones are not found. Errors are those of the mean
of independent batches of walkers.
"""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from postproc.cli import InputError, ended_with_python
from postproc.progress import doing
from postproc.theory.states import State
from studies.common.study import ROOT
from studies.common.theories import THEORIES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

MOST_VISITS = 2e7  # from one start, in all batches: two to four seconds of a processor
RELAXATIONS = 3.25  # transient in relaxation times of directions, 25 r^4/w^3
SHORTEST = 500.0  # transient in mean free paths, 2r
COPIES = 2  # for the search of states
BATCHES = 8
LONGEST = 20.0  # measured time in transients, at most
EMPTIER = 0.05  # share of the emptier urn at a polarised start if no theory has one
LEAST = 0.04  # chi by which states differ at least
LEAST_SPREAD = 0.15  # chi of the states of equal urns that are compared
APART = 4.0  # standard errors between different states


@dataclass(frozen=True)
class Drawn(State):
    """A state found by walkers, whose chi has a standard error, too."""

    mass_spread_error: float = 0.0


@dataclass(frozen=True)
class Effort:
    """Number of walkers and duration.

    Attributes
    ----------
    copies : copies of the circuit, N walkers for each.
    batches : independent batches; errors are from their scatter.
    transient, duration : time before the measurement, and measured time.
    seed : seed of the first batch; the others have the next numbers.
    """

    copies: int
    batches: int
    transient: float
    duration: float
    seed: int = 1


@dataclass(frozen=True)
class Walked:
    """Results of batches of walkers; arrays of shape (batch,) or (batch, urn), of one circuit.

    Attributes
    ----------
    flow1, flow2 : crossings of channels 1 and 2 from urn 1 to 2 and from 2 to 1, per unit time.
    entries, turned : entries into the gate of each urn, and reversed walkers, per unit time.
    half2_number : N2, time average; shape (batch,).
    fuller_number, polarised_current : mean number in the half that is the fuller one at the time,
        and net current of channel 2 from there, per unit time; shape (batch,).
    """

    flow1: Floats
    flow2: Floats
    entries: Floats
    turned: Floats
    half2_number: Floats
    fuller_number: Floats
    polarised_current: Floats

    @property
    def net_current(self) -> Floats:
        """Net current of channel 1 from urn 1 to urn 2, from that of channel 2."""
        return self.flow2[:, 1] - self.flow2[:, 0]


def effort_for(circuit: Circuit, copies: int = COPIES) -> Effort:
    """Return an effort of at most about `MOST_VISITS`, by a limited time."""
    if circuit.outline is not None:
        raise InputError("the one-particle model knows urns that are discs only")
    radius = max(float(side.urn_radius) for side in circuit.sides)
    width1, width2 = float(circuit.channel1_width), float(circuit.channel2_width)
    transient = max(RELAXATIONS * 25.0 * radius**4 / width1**3, 2.0 * SHORTEST * radius)
    area = sum(float(side.urn_area) for side in circuit.sides)
    per_time = float(circuit.number) * copies * BATCHES * (width1 + width2) / (0.5 * np.pi * area)
    longest = MOST_VISITS / per_time
    transient = min(transient, 0.5 * longest)
    return Effort(copies, BATCHES, transient, min(LONGEST * transient, longest - transient))


def walk(circuit: Circuit, share2: float, effort: Effort, *, well_mixed: bool = False) -> Walked:
    """Run walkers, `share2` of them from urn 2; `well_mixed` urns forget the start of each visit.

    Raises
    ------
    postproc.cli.InputError : the program does not exist (make build builds it), or it fails.
    """
    one, two = circuit.sides
    words = [int(circuit.number), int(one.threshold), int(two.threshold)]
    words += [float(one.urn_radius), float(two.urn_radius)]
    words += [float(circuit.channel1_width), float(circuit.channel1_length)]
    words += [float(circuit.channel2_width), float(circuit.channel2_length)]
    words += [float(share2), effort.copies, float(effort.transient), float(effort.duration)]
    line = " ".join(map(repr, words))
    mixed = "T" if well_mixed else "F"
    seeds = range(effort.seed, effort.seed + effort.batches)
    with doing(f"walkers, {share2:.2g} of them from urn 2"):
        found = _answers("".join(f"{line} {seed} {mixed}\n" for seed in seeds))
    pairs = (found[:, first : first + 2] for first in (0, 2, 4, 6))
    return Walked(*pairs, *found[:, 8:].T)


def _answers(lines: str) -> Floats:
    """Return the numbers that the program prints, a row for each line."""
    program = ROOT / "build/bin/one_particle"
    if not program.is_file():
        raise InputError(f"{program}: no such program (make build/bin/one_particle)")
    done = subprocess.run(
        ended_with_python([program]), input=lines, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise InputError(f"{program}: {done.stderr.strip() or done.returncode}")
    return np.array([line.split() for line in done.stdout.splitlines()], float)


def stationary_states(circuit: Circuit, effort: Effort | None = None) -> list[Drawn]:
    """Return the stable states that walkers reach, by increasing N2.

    For equal urns with equal gates that with N2 > N/2, if there is one: its mirror image is a state
    too, and walkers may go from one to the other. For others all that are reached from either urn
    and from equal densities.
    """
    given = effort or effort_for(circuit)
    number = float(circuit.number)
    if circuit.alike:
        walked = walk(circuit, _polarised_share(circuit), given)
        state = _state(walked.fuller_number, walked.polarised_current, number)
        return [state] if state.mass_spread > LEAST_SPREAD else []
    one, two = (float(side.urn_area) for side in circuit.sides)
    found: list[Drawn] = []
    for share in (EMPTIER, two / (one + two), 1.0 - EMPTIER):
        walked = walk(circuit, share, given)
        state = _state(walked.half2_number, walked.net_current, number)
        if not any(_same(state, other, number) for other in found):
            found.append(state)
    return sorted(found, key=lambda state: state.urn2_number)


def _polarised_share(circuit: Circuit) -> float:
    """Return a polarised share of urn 2, that of the renewal gate if it has such a state."""
    guess = THEORIES["renewal_occupation"].stable_state(circuit)
    return guess.urn2_number / float(circuit.number) if guess else 1.0 - EMPTIER


def _state(second: Floats, current: Floats, number: float) -> Drawn:
    """Return a state from N2 and net current of each batch."""
    spread, batches = 2.0 * second / number - 1.0, np.sqrt(second.size)
    return Drawn(
        float(second.mean()),
        "stable",
        float(abs(spread.mean())),
        float(current.mean()),
        mass_spread_error=float(spread.std(ddof=1) / batches),
        net_current_error=float(current.std(ddof=1) / batches),
    )


def _same(one: Drawn, other: Drawn, number: float) -> bool:
    """Whether two states agree within their errors."""
    errors = np.hypot(one.mass_spread_error, other.mass_spread_error)
    apart = 2.0 * abs(one.urn2_number - other.urn2_number) / number
    return bool(apart <= max(LEAST, APART * errors))

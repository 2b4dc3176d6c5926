"""The circuit, and the probabilistic theory of it: flows, eta, the transition line.

Every quantity is in the program's units: lengths over the speed v = 1. The equations are those of
Cirillo, Colangeli, Richardson, Rondoni, PRE 103, 032119 (2021), named by their labels there:
(eq000) area of an urn, (eqapp5) flow through a gate, (eq007) eta, (transition) the transition line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

from postproc.cli import InputError
from postproc.theory import outlines
from postproc.theory.gates import WINDOW

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.gates import Gate
    from postproc.theory.outlines import Outline

    Floats = NDArray[np.float64]

PAPERS_AGE = 1.4e5  # at which the paper's runs end
NEAREST = 1e-6  # states closer to N/2 than this, relative to it, are the homogeneous one
WIDTHS_TRIED = 400  # values between 0 and 2r at which a transition is searched for


@dataclass(frozen=True)
class Circuit:
    """A circuit and the model of its gates; fields may be arrays, which then broadcast.

    The origin is the middle of channel 1, urn 1 lies at x < 0.

    Attributes
    ----------
    number : N, how many particles.
    threshold : T, a gate reverses the particles that it counts if these are more than T.
    channel1_width, channel1_length : w and l of the gated channel, both gates together.
    channel2_width, channel2_length : w' and l' of the channel that closes the circuit; w' = 0 is
        the one-channel model of J. Phys. A 53, 305001 (2020).
    urn_radius : r.
    gate : model of the gates, the share of entries that gets through.
    shape : "circuit", or "urn": the appendix's single urn with gate 1 and an end wall. It has no
        channel 2, so w' = 0; particles that hit the wall return through the gate, so they are in it
        for 2 tau, as in the circuit particles are in both gates.
    urn2_radius, gate2_threshold : r of urn 2 and T of its gate if they differ from those of urn 1.
        Functions of the number in one urn are those of urn 1: call them for each of `sides`.
    scatterers : z, y, radius of each disc in channel 2, z from urn 2 to urn 1. They are drawn in
        figures; no theory includes them (`InputError`).
    outline, urn2_outline : the corners of urns that are polygons, see `outlines`; None: discs
        (and urn 2 as urn 1). Then `urn_radius` is only a length scale.
    age : age of the run, its time since the start, for theories whose net current grows with it.
    """

    number: ArrayLike
    threshold: ArrayLike
    channel1_width: ArrayLike = 0.3
    channel2_width: ArrayLike = 0.01
    urn_radius: ArrayLike = 1.0
    channel1_length: ArrayLike = 1.0
    channel2_length: ArrayLike = 1.0
    gate: Gate = WINDOW
    shape: str = "circuit"
    urn2_radius: ArrayLike | None = None
    gate2_threshold: ArrayLike | None = None
    scatterers: tuple[tuple[float, float, float], ...] = ()
    outline: Outline | None = None
    urn2_outline: Outline | None = None
    age: float = PAPERS_AGE

    def need_empty_channels(self) -> None:
        """Raise `InputError` if there are scatterers in channel 2, which no theory has."""
        if self.scatterers:
            raise InputError("no theory knows scatterers in channel 2: it would give wrong numbers")

    @property
    def brief(self) -> str:
        """Short name of the circuit: N and T."""
        return f"N = {self.number}, T = {self.threshold}"

    @property
    def sides(self) -> tuple[Circuit, Circuit]:
        """Two circuits with equal urns and gates, those of urn 1 and those of urn 2."""
        one = replace(self, urn2_radius=None, gate2_threshold=None, urn2_outline=None)
        outline = self.outline if self.urn2_outline is None else self.urn2_outline
        radius = self.urn_radius if self.urn2_radius is None else self.urn2_radius
        threshold = self.threshold if self.gate2_threshold is None else self.gate2_threshold
        return one, replace(one, urn_radius=radius, threshold=threshold, outline=outline)

    @property
    def closed(self) -> bool:
        """Whether nothing passes: there is no channel 2, and both gates reverse all particles."""
        shut = all(np.all(np.equal(side.threshold, 0)) for side in self.sides)
        return shut and bool(np.all(np.equal(self.channel2_width, 0.0)))

    @property
    def alike(self) -> bool:
        """Whether both urns and both gates are equal."""
        return not self.unlike

    @property
    def beyond_theory(self) -> bool:
        """Whether it has scatterers or unequal sides: no theory of figures applies."""
        return bool(self.scatterers or self.unlike)

    @property
    def unlike(self) -> str:
        """Differences of the sides in words; empty if urns and gates are equal."""
        pairs = {
            "threshold": (self.threshold, self.gate2_threshold),
            "urn_radius": (self.urn_radius, self.urn2_radius),
        }
        differences = [f"{name} is {one:g} and {two:g}" for name, (one, two) in pairs.items()
                if two not in (None, one)]  # fmt: skip
        one, two = self.sides
        return ", ".join(differences) or ("" if one == two else "its urns are unlike polygons")

    @property
    def thresholds(self) -> str:
        """T of both gates as text: once if they are equal."""
        return ", ".join(dict.fromkeys(str(side.threshold) for side in self.sides))

    @property
    def chords(self) -> tuple[Floats, Floats]:
        """Distances of the chords of channels 1 and 2 from the centre of an urn."""
        if self.outline is not None:
            right, left = outlines.ends(self.outline)
            return np.asarray(0.5 * (right - left)), np.asarray(0.5 * (right - left))
        diameter = 2.0 * np.asarray(self.urn_radius, float)
        widths = (np.asarray(self.channel1_width, float), np.asarray(self.channel2_width, float))
        one, two = (0.5 * np.sqrt((diameter - width) * (diameter + width)) for width in widths)
        return one, two

    @property
    def urn_centre(self) -> Floats:
        """Distance of the centres of the urns from the middle of channel 1."""
        return 0.5 * np.asarray(self.channel1_length) + self.chords[0]

    @property
    def end(self) -> Floats:
        """Distance of the periodic line (or of the far wall) from the middle of channel 1."""
        behind = np.where(np.asarray(self.channel2_width) > 0.0, self.channel2_length, 0.0)
        return self.urn_centre + self.chords[1] + 0.5 * behind

    @property
    def urn_area(self) -> Floats:
        """A of eq. (eq000), the disc less the segments cut off by the chords (length squared).

        For a polygon it is the area enclosed by its corners.
        """
        if self.outline is not None:
            return np.asarray(outlines.area(self.outline))
        radius = np.asarray(self.urn_radius, float)
        area = np.pi * radius**2
        widths = (self.channel1_width, self.channel2_width)
        for width, chord in zip(widths, self.chords, strict=True):
            half = 0.5 * np.asarray(width, float)
            area = area - radius**2 * np.arcsin(half / radius) + half * chord
        return area

    @property
    def widest(self) -> float:
        """Upper bound of w' for channel 2 to fit into an urn."""
        if self.outline is not None:
            return outlines.widest(self.outline, -1.0)
        return 2.0 * float(np.asarray(self.urn_radius))

    @property
    def load_per_particle(self) -> Floats:
        """Load of a gate per particle in its urn: lambda/n = w l/(4A), eq. (eqapp3)."""
        self.need_empty_channels()
        width, length = np.asarray(self.channel1_width), np.asarray(self.channel1_length)
        return width * length / (4.0 * self.urn_area)


def gate_load(circuit: Circuit, urn_number: ArrayLike) -> Floats:
    """Return lambda = n w l/(4A) of eq. (eqapp3) for `urn_number` particles in the urn."""
    return np.asarray(urn_number, float) * circuit.load_per_particle


def flow1(circuit: Circuit, number: ArrayLike) -> Floats:
    """Return the outflow of an urn with n particles through channel 1, eq. (eqapp5)."""
    inside = np.asarray(number, float)
    share = circuit.gate.share(circuit.threshold, gate_load(circuit, inside))
    return inside * np.asarray(circuit.channel1_width) * share / (np.pi * circuit.urn_area)


def flow2(circuit: Circuit, number: ArrayLike) -> Floats:
    """Return the outflow of an urn with n particles through channel 2, n w'/(pi A)."""
    width = np.asarray(circuit.channel2_width)
    return np.asarray(number, float) * width / (np.pi * circuit.urn_area)


def eta(circuit: Circuit, urn2_number: ArrayLike) -> Floats:
    """Return eta of eq. (eq007): flow from urn 1 to urn 2 minus the flow back, per unit time.

    Parameters
    ----------
    circuit : its fields broadcast with `urn2_number`.
    urn2_number : N2, between 0 and N.
    """
    second = np.asarray(urn2_number, float)
    first = np.asarray(circuit.number, float) - second
    one, two = circuit.sides
    return flow1(one, first) + flow2(one, first) - flow1(two, second) - flow2(two, second)


def stability(circuit: Circuit, width: ArrayLike) -> Floats:
    """Return the derivative of an urn's outflow by its number at N/2, up to a positive factor.

    Equal urns with channels 2 of these widths are stable where it is positive.
    """
    at_width = replace(circuit, channel2_width=width)
    load = gate_load(at_width, 0.5 * float(np.asarray(circuit.number)))
    slope = circuit.gate.slope(circuit.threshold, load)
    return np.asarray(width) + float(circuit.channel1_width) * slope


def log_outflow(circuit: Circuit, number: ArrayLike) -> Floats:
    """Return log f(n), f(n) = n [w share(T, lambda) + w'], accurate also if f underflows."""
    inside = np.asarray(number, float)
    log_share = circuit.gate.log_share(circuit.threshold, gate_load(circuit, inside))
    # For an empty urn numpy computes -inf + -inf.
    with np.errstate(divide="ignore", invalid="ignore"):
        through2 = np.log(np.asarray(circuit.channel2_width, float))
        return np.log(inside) + np.logaddexp(np.log(circuit.channel1_width) + log_share, through2)


def net_current2(circuit: Circuit, urn2_number: ArrayLike) -> Floats:
    """Return the net current of channel 2 from urn 2 to urn 1, (N2 - N1) w'/(pi A)."""
    second = np.asarray(urn2_number, float)
    one, two = circuit.sides
    return flow2(two, second) - flow2(one, np.asarray(circuit.number, float) - second)


def homogeneous_kind(circuit: Circuit) -> str:
    """Return whether N2 = N/2 is "stable" or "unstable" ("neutral": there is no flow).

    A state nearer than `NEAREST` is one with it.
    """
    half = 0.5 * float(np.asarray(circuit.number))
    if float(circuit.channel2_width) == float(circuit.threshold) == 0.0:
        return "neutral"
    near = half * (1.0 - NEAREST)
    difference = log_outflow(circuit, near) - log_outflow(circuit, 2.0 * half - near)
    return "stable" if float(difference) <= 0.0 else "unstable"


def transition_width(circuit: Circuit) -> float:
    """Return w' of the transition line, eq. (transition), at this N, T, w; NaN if there is none.

    The least w' at which the homogeneous state turns stable; `channel2_width` is not used. There is
    none where that state is stable without channel 2, or unstable for every w' that fits.
    """
    widths = circuit.widest * np.linspace(0.0, 1.0, WIDTHS_TRIED, endpoint=False)
    values = stability(circuit, widths)
    if values[0] == 0.0:
        return 0.0  # underflow
    changes = np.flatnonzero((values[:-1] < 0.0) & (values[1:] >= 0.0))
    if values[0] > 0.0 or changes.size == 0:
        return math.nan
    at = changes[0]
    ends = widths[at], widths[at + 1]
    return float(optimize.brentq(partial(stability, circuit), *ends, xtol=1e-15, rtol=1e-14))


def single_urn_current(urn: Circuit) -> Floats:
    """Return the current of the appendix's single urn, eq. (eqapp5): hits on the end wall.

    Per unit time, with all particles in the urn.
    """
    return flow1(urn, urn.number)

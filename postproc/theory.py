"""The probabilistic theory of the circuit: flows, eta, stationary states, the transition line.

Prints, as JSON, what it says of one circuit; options are named like the keys of the namelist.

Every quantity is in the program's units: lengths over the speed v = 1. The equations are those of
Cirillo, Colangeli, Richardson, Rondoni, PRE 103, 032119 (2021), named by their labels there:
(eq000) area of an urn, (eqapp5) flow through a gate, (eq007) eta, (transition) the transition line.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

from postproc import cli
from postproc.gates import WINDOW

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from postproc.gates import Gate

WIDTHS_TRIED = 400  # places between 0 and 2r where a transition is looked for


@dataclass(frozen=True)
class Circuit:
    """A circuit and the model of its gates; fields may be arrays, which then broadcast.

    Attributes
    ----------
    number : N, how many particles.
    threshold : T, a gate turns back what heads for the other when that is more than T.
    channel1_width, channel1_length : w and l of the gated channel, both gates together.
    channel2_width, channel2_length : w' and l' of the channel that closes the circuit; w' = 0 is
        the one-channel model of J. Phys. A 53, 305001 (2020).
    urn_radius : r.
    gate : how much of what enters a gate gets through.
    """

    number: ArrayLike
    threshold: ArrayLike
    channel1_width: ArrayLike = 0.3
    channel2_width: ArrayLike = 0.01
    urn_radius: ArrayLike = 1.0
    channel1_length: ArrayLike = 1.0
    channel2_length: ArrayLike = 1.0
    gate: Gate = WINDOW

    @property
    def urn_area(self) -> NDArray[np.float64]:
        """A of eq. (eq000), the disc less the segments cut off by the chords (length squared)."""
        return urn_area(self.urn_radius, self.channel1_width, self.channel2_width)

    @property
    def load_per_particle(self) -> NDArray[np.float64]:
        """Load of a gate per particle in its urn: lambda/n = w l/(4A), eq. (eqapp3)."""
        width, length = np.asarray(self.channel1_width), np.asarray(self.channel1_length)
        return width * length / (4.0 * self.urn_area)


def urn_area(
    urn_radius: ArrayLike, channel1_width: ArrayLike, channel2_width: ArrayLike
) -> NDArray[np.float64]:
    """Return A of eq. (eq000), the area of an urn between its two chords (length squared)."""
    radius = np.asarray(urn_radius, float)
    area = np.pi * radius**2
    for width in (np.asarray(channel1_width, float), np.asarray(channel2_width, float)):
        chord = np.sqrt((2.0 * radius - width) * (2.0 * radius + width))
        area = area - radius**2 * np.arcsin(width / (2.0 * radius)) + 0.25 * width * chord
    return area


def gate_load(circuit: Circuit, urn_number: ArrayLike) -> NDArray[np.float64]:
    """Return lambda = n w l/(4A) of eq. (eqapp3) for `urn_number` particles in the urn."""
    return np.asarray(urn_number, float) * circuit.load_per_particle


def flow1(circuit: Circuit, urn_number: ArrayLike) -> NDArray[np.float64]:
    """Return what an urn with n particles sends through channel 1, eq. (eqapp5), per unit time."""
    number = np.asarray(urn_number, float)
    share = circuit.gate.share(circuit.threshold, gate_load(circuit, number))
    return number * np.asarray(circuit.channel1_width) * share / (np.pi * circuit.urn_area)


def flow2(circuit: Circuit, urn_number: ArrayLike) -> NDArray[np.float64]:
    """Return what an urn with n particles sends through channel 2, n w'/(pi A), per unit time."""
    number = np.asarray(urn_number, float)
    return number * np.asarray(circuit.channel2_width) / (np.pi * circuit.urn_area)


def eta(circuit: Circuit, urn2_number: ArrayLike) -> NDArray[np.float64]:
    """Return eta of eq. (eq007): what urn 1 sends to urn 2 less what comes back, per unit time.

    Parameters
    ----------
    circuit : its fields broadcast with `urn2_number`.
    urn2_number : N2, between 0 and N.
    """
    second = np.asarray(urn2_number, float)
    first = np.asarray(circuit.number, float) - second
    return (
        flow1(circuit, first)
        + flow2(circuit, first)
        - flow1(circuit, second)
        - flow2(circuit, second)
    )


def eta_slope(circuit: Circuit, urn2_number: ArrayLike) -> NDArray[np.float64]:
    """Return d eta/d N2: a stationary state is stable where it is negative (per unit time)."""
    second = np.asarray(urn2_number, float)
    first = np.asarray(circuit.number, float) - second
    return -_outflow_slope(circuit, first) - _outflow_slope(circuit, second)


def _outflow_slope(circuit: Circuit, urn_number: NDArray[np.float64]) -> NDArray[np.float64]:
    slope = circuit.gate.slope(circuit.threshold, gate_load(circuit, urn_number))
    widths = np.asarray(circuit.channel1_width) * slope + np.asarray(circuit.channel2_width)
    return widths / (np.pi * circuit.urn_area)


def log_outflow(circuit: Circuit, urn_number: ArrayLike) -> NDArray[np.float64]:
    """Return log f(n), f(n) = n [w share(T, lambda) + w'], good where f underflows."""
    number = np.asarray(urn_number, float)
    log_share = circuit.gate.log_share(circuit.threshold, gate_load(circuit, number))
    with np.errstate(divide="ignore"):
        through2 = np.log(np.asarray(circuit.channel2_width, float))
        return np.log(number) + np.logaddexp(np.log(circuit.channel1_width) + log_share, through2)


def net_current1(circuit: Circuit, urn2_number: ArrayLike) -> NDArray[np.float64]:
    """Return the net current of channel 1 from urn 1 to urn 2 (per unit time), from eq. (eqapp5).

    In a stationary state `net_current2`, from urn 1 to urn 2 too, is the opposite.
    """
    second = np.asarray(urn2_number, float)
    return flow1(circuit, np.asarray(circuit.number, float) - second) - flow1(circuit, second)


def net_current2(circuit: Circuit, urn2_number: ArrayLike) -> NDArray[np.float64]:
    """Return the net current of channel 2 from urn 1 to urn 2, (N1 - N2) w'/(pi A)."""
    second = np.asarray(urn2_number, float)
    return flow2(circuit, np.asarray(circuit.number, float) - 2.0 * second)


def homogeneous_kind(circuit: Circuit) -> str:
    """Return whether N2 = N/2 is "stable" or "unstable" ("neutral": nothing moves at all)."""
    half = 0.5 * float(np.asarray(circuit.number))
    if float(circuit.channel2_width) > 0.0:
        return "stable" if float(eta_slope(circuit, half)) <= 0.0 else "unstable"
    if float(circuit.threshold) == 0.0:
        return "neutral"
    near = half * (1.0 + 1e-6)
    difference = log_outflow(circuit, 2.0 * half - near) - log_outflow(circuit, near)
    return "stable" if float(difference) <= 0.0 else "unstable"


def transition_width(circuit: Circuit) -> float:
    """Return w' of the transition line, eq. (transition), at this N, T, w; NaN if there is none.

    The least w' at which the homogeneous state turns stable; `channel2_width` is not used. There is
    none where that state is stable without channel 2, or unstable for every w' < 2r.
    """
    limit = 2.0 * float(circuit.urn_radius)

    def slope(width: float) -> float:
        at_width = replace(circuit, channel2_width=width)
        x = gate_load(at_width, 0.5 * float(np.asarray(circuit.number)))
        bent = float(circuit.gate.slope(circuit.threshold, x))
        return width + float(circuit.channel1_width) * bent

    widths = limit * np.linspace(0.0, 1.0, WIDTHS_TRIED, endpoint=False)
    values = np.array([slope(width) for width in widths])
    if values[0] == 0.0:
        return 0.0  # too small for any number
    changes = np.flatnonzero((values[:-1] < 0.0) & (values[1:] >= 0.0))
    if values[0] > 0.0 or changes.size == 0:
        return math.nan
    at = changes[0]
    return float(optimize.brentq(slope, widths[at], widths[at + 1], xtol=1e-15, rtol=1e-14))


def single_urn_current(
    number: ArrayLike,
    threshold: ArrayLike,
    channel1_width: ArrayLike,
    urn_radius: ArrayLike = 1.0,
    channel1_length: ArrayLike = 1.0,
    gate: Gate = WINDOW,
) -> NDArray[np.float64]:
    """Return the current of the appendix's single urn, eq. (eqapp5): hits on the end wall.

    Per unit time, with all `number` particles counted as in the urn; the gate is l/2 long.
    """
    urn = Circuit(number, threshold, channel1_width, 0.0, urn_radius, channel1_length, gate=gate)
    return flow1(urn, number)


def describe(circuit: Circuit) -> dict[str, object]:
    """Return what the theory says of one circuit, as the command line prints it."""
    from postproc.states import stationary_states  # noqa: PLC0415 (it builds on this module)

    width = transition_width(circuit)
    return {
        "homogeneous": homogeneous_kind(circuit),
        "roots": [
            {
                "urn2_number": state.urn2_number,
                "kind": state.kind,
                "mass_spread": state.mass_spread,
                "net_current": state.net_current,
            }
            for state in stationary_states(circuit)
        ],
        "transition_width": None if math.isnan(width) else width,
        "urn_area": float(circuit.urn_area),
    }


def _options() -> argparse.ArgumentParser:
    options = cli.parser("theory", __doc__)
    options.add_argument("--number", type=int, required=True, help="N, how many particles")
    options.add_argument("--threshold", type=int, required=True, help="T of the gates")
    for key, default, meaning in (
        ("urn-radius", 1.0, "r"),
        ("channel1-width", 0.3, "w"),
        ("channel1-length", 1.0, "l, both gates together"),
        ("channel2-width", 0.01, "w', 0 for the one-channel model"),
        ("channel2-length", 1.0, "l', both halves together"),
    ):
        options.add_argument(
            f"--{key}", type=float, default=default, help=f"{meaning} (default: {default})"
        )
    options.add_argument("--gate", choices=("window", "renewal"), default="window")
    return options


def _check(given: argparse.Namespace) -> None:
    """Raise with every problem of the values given."""
    diameter = 2.0 * given.urn_radius
    rules = (
        (given.number >= 1, f"--number {given.number} must be at least 1"),
        (given.threshold >= 0, f"--threshold {given.threshold} must not be negative"),
        (0 < given.urn_radius < math.inf, f"--urn-radius {given.urn_radius} must be positive"),
        (
            0 < given.channel1_width < diameter,
            f"--channel1-width {given.channel1_width} must lie above 0 and below 2r = {diameter}",
        ),
        (
            0 <= given.channel2_width < diameter,
            f"--channel2-width {given.channel2_width} must be at least 0 and below 2r = {diameter}",
        ),
        (
            0 < given.channel1_length < math.inf,
            f"--channel1-length {given.channel1_length} must be positive",
        ),
        (
            0 < given.channel2_length < math.inf,
            f"--channel2-length {given.channel2_length} must be positive",
        ),
    )
    problems = [text for good, text in rules if not good]
    if problems:
        raise cli.InputError("; ".join(problems))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the theory of one circuit as JSON."""
    given = _options().parse_args(arguments)
    _check(given)
    gate = WINDOW
    if given.gate == "renewal":
        from postproc.renewal import RENEWAL  # noqa: PLC0415 (only read when asked for)

        gate = RENEWAL
    values = {key: value for key, value in vars(given).items() if key != "gate"}
    print(json.dumps(describe(Circuit(**values, gate=gate)), indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(cli.run(main))

"""The theories that figures draw, by name: what a figure may ask of one, and how it looks.

A figure asks only what it draws, and leaves out what a theory has no answer to (`None`, NaN, no
level). So a theory of another kind is a class with the methods of `Model` that it can answer, and a
line in `MODELS`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy import interpolate

from postproc.cli import InputError
from postproc.progress import each
from postproc.theory import direction, one_particle, two_port
from postproc.theory import models as theories
from postproc.theory.chain import between, passage_times
from postproc.theory.circuit import (
    eta,
    flow1,
    flow2,
    gate_load,
    homogeneous_kind,
    in_urn,
    net_current2,
    single_urn_current,
    transition_width,
)
from postproc.theory.kept import kept
from postproc.theory.programs import there
from postproc.theory.renewal import THEORIES
from postproc.theory.states import State, stationary_states
from postproc.theory.tricritical import cubic

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

STRONGEST = 4.0  # load of a gate over T at which a transition is a jump, whatever T
STEPS = 20  # places on a line of transition from one whole T to the next
WIDTHS = 400  # places between w' = 0 and 2r where a transition is looked for
FEW_WIDTHS = 13  # of a theory that takes longer, as far as well mixed urns have a line


@dataclass(frozen=True)
class Model:
    """A theory of the balance of flows: eta of a circuit with some of its fields changed.

    Attributes
    ----------
    label : what legends call it.
    dashes : style of its lines.
    changes : what it changes of a circuit, by the field's name.
    """

    label: str
    dashes: str
    changes: dict[str, object] = field(default_factory=dict)

    def of(self, circuit: Circuit) -> Circuit:
        """Return the circuit as this theory has it."""
        return replace(circuit, **self.changes)

    def states(self, circuit: Circuit) -> list[State]:
        """Return all states with N2 > N/2."""
        return stationary_states(self.of(circuit))

    def stable_state(self, circuit: Circuit) -> State | None:
        """Return the stable polarised state with the largest chi, None if there is none."""
        stable = [state for state in self.states(circuit) if state.kind == "stable"]
        return stable[-1] if stable else None

    def zeros(self, circuit: Circuit) -> list[tuple[float, str]]:
        """Return (N2, kind) of all stationary states, on both sides of N/2 and at it."""
        total = float(circuit.number)
        found = [(one.urn2_number, one.kind) for one in self.states(circuit)]
        found += [(total - number, kind) for number, kind in found]
        return [*found, (0.5 * total, self.homogeneous_kind(circuit))]

    def homogeneous_kind(self, circuit: Circuit) -> str:
        """Return the kind of the state with equal densities."""
        return homogeneous_kind(self.of(circuit))

    def nearest_stable(self, circuit: Circuit, number2: float) -> float:
        """Return N2 of the stable state (either sign of N2 - N1) nearest to `number2`."""
        stable = [number for number, kind in self.zeros(circuit) if kind != "unstable"]
        return min(stable, key=lambda number: abs(number - number2))

    def eta(self, circuit: Circuit, number2: ArrayLike) -> Floats:
        """Return eta of eq. (eq007) (per unit time)."""
        return eta(self.of(circuit), number2)

    def levels(self, circuit: Circuit, number2: float) -> dict[str, float]:
        """Return flows and net current (per unit time) of the stable state nearest to `number2`.

        By name: flow1_12 ... flow2_21 as in results, and "net", that of channel 2 by its size.
        """
        own, second = self.of(circuit), self.nearest_stable(circuit, number2)
        held = {"12": float(circuit.number) - second, "21": second}
        found = {
            f"flow{channel}_{way}": float(flow(own, inside))
            for channel, flow in ((1, flow1), (2, flow2))
            for way, inside in held.items()
        }
        return {**found, "net": abs(float(net_current2(own, second)))}

    def transition_line(self, circuit: Circuit, first: int, last: int) -> tuple[Floats, Floats]:
        """Return (T, w') along the line of transition, eq. (transition), from one T to another.

        w' is the least at which the homogeneous state turns stable, NaN where there is none. It is
        what it is at whole T only: in between, what decides on stability is interpolated. Beyond
        its last T the homogeneous state is stable without channel 2, so the line ends at w' = 0.
        """
        own, whole = self.of(circuit), np.arange(max(first, 1), last + 1)
        widths = self._widths(circuit, whole)
        values = np.array(
            [self._stability(replace(own, threshold=int(one)), widths)
             for one in each(whole, f"line of transition, {self.label}, threshold")]
        )  # fmt: skip
        thresholds = np.linspace(whole[0], whole[-1], (whole.size - 1) * STEPS + 1)
        if whole.size > 1:
            values = interpolate.PchipInterpolator(whole, values)(thresholds)
        return _where_zero(thresholds, widths, values)

    def tricritical_place(self, circuit: Circuit) -> tuple[float, float] | None:
        """Return (T, w') on the line of transition at this N where a jump turns continuous.

        None where there is none, or the theory does not tell. Between whole T it is interpolated.
        """
        own = self.of(circuit)
        load = 0.5 * float(circuit.number) * float(circuit.load_per_particle)
        whole = range(max(int(load / STRONGEST), 1), int(load) + 1)
        values = [cubic(replace(own, threshold=one)) for one in whole]
        for one, (low, high) in zip(whole, pairwise(values), strict=False):
            if low < 0.0 <= high:
                part = low / (low - high)
                widths = [transition_width(replace(own, threshold=at)) for at in (one, one + 1)]
                return one + part, float(np.interp(part, [0.0, 1.0], widths))
        return None

    def _widths(self, circuit: Circuit, _: NDArray[np.int_]) -> Floats:
        return np.linspace(0.0, 2.0 * float(circuit.urn_radius), WIDTHS, endpoint=False)

    def _stability(self, circuit: Circuit, widths: Floats) -> Floats:
        """Return what is negative at the w' where the homogeneous state is unstable.

        The change with N1 of what an urn sends out, but for a positive factor, eq. (transition).
        """
        at_width = replace(circuit, channel2_width=widths)
        load = gate_load(at_width, in_urn(at_width, 0.5 * float(circuit.number)))
        return widths + float(circuit.channel1_width) * circuit.gate.slope(circuit.threshold, load)

    def urn_current(self, urn: Circuit) -> Floats:
        """Return the current of the single urn of the appendix (per unit time)."""
        return single_urn_current(self.of(urn))

    def passage_times(self, circuit: Circuit, low: float, high: float) -> tuple[float, float]:
        """Return how long homogeneous and polarised state last by the chain (length/v)."""
        return passage_times(self.of(circuit), low, high)


@dataclass(frozen=True)
class Remembering(Model):
    """A theory of urns that remember, one of `theory.models`, that takes seconds: answers are kept.

    Attributes
    ----------
    name : of the theory.
    flows : what channels 1 and 2 carry from urn 1 to 2 and back at an N2, shape (channel, way).
    growth : what is positive where the homogeneous state is unstable; None: it has no line.
    balanced : whether it has an eta and a chain of rates, or states alone.
    """

    name: str = ""
    flows: Callable[[Circuit, float], Floats] = two_port.flows
    growth: Callable[[Circuit], float] | None = None
    balanced: bool = True

    def tricritical_place(self, _: Circuit) -> None:
        """Return None: it does not tell."""

    @property
    def _theory(self) -> theories.Theory:
        return theories.MODELS[self.name].theory

    def of(self, circuit: Circuit) -> Circuit:
        """Return the circuit as this theory has it."""
        if circuit.shape != "circuit":
            raise InputError(f"theory {self.name}: of the single urn it says nothing")
        return theories.MODELS[self.name].of(circuit)[0]

    def states(self, circuit: Circuit) -> list[State]:
        """Return all states with N2 > N/2."""
        own = self.of(circuit)
        found = kept(
            f"states {self.name}", own, lambda: [vars(one) for one in self._theory.states(own)]
        )
        return [State(**one) for one in found]

    def homogeneous_kind(self, circuit: Circuit) -> str:
        """Return the kind of the state with equal densities."""
        own = self.of(circuit)
        return str(kept(f"kind {self.name}", own, lambda: self._theory.homogeneous_kind(own)))

    def eta(self, circuit: Circuit, number2: ArrayLike) -> Floats:
        """Return what urn 2 gains (per unit time), NaN if the theory does not tell."""
        second = np.asarray(number2, float)
        if not self.balanced:
            return np.full(second.shape, math.nan)
        places, sent = self._theory.outflows(self.of(circuit))
        # what each urn sends is smooth and keeps its sign; their difference has peaks in between
        one, two = np.exp(between(places, sent, second))
        known = (second >= places.min()) & (second <= places.max())
        return np.where(known, one - two, math.nan)

    def levels(self, circuit: Circuit, number2: float) -> dict[str, float]:
        """Return flows and net current of the stable state nearest to `number2`.

        What circulates is part of them: it goes from the fuller urn through channel 2.
        """
        own, second = self.of(circuit), self.nearest_stable(circuit, number2)
        flows = np.array(
            kept(f"flows {self.name} {second!r}", own, lambda: self.flows(own, second).tolist())
        )
        pairs = [abs(second - one.urn2_number) for one in self.states(circuit)]
        pairs += [abs(own.number - second - one.urn2_number) for one in self.states(circuit)]
        around = 0.0
        if pairs and min(pairs) < 1e-6 * float(own.number):
            state = self.states(circuit)[int(np.argmin(pairs)) % (len(pairs) // 2)]
            around = abs(state.circulating_current or 0.0)
        fuller = int(2.0 * second > float(own.number))
        flows[1, fuller] += around
        flows[0, 1 - fuller] += around
        found = {
            f"flow{channel}_{way}": float(flows[channel - 1, at])
            for channel in (1, 2)
            for at, way in enumerate(("12", "21"))
        }
        return {**found, "net": float(abs(flows[1, 0] - flows[1, 1]))}

    def transition_line(self, circuit: Circuit, first: int, last: int) -> tuple[Floats, Floats]:
        """Return (T, w') along the line of transition, NaN if the theory has none."""
        if self.growth is None:
            whole = np.arange(max(first, 1), last + 1, dtype=float)
            return whole, np.full(whole.shape, math.nan)
        return super().transition_line(circuit, first, last)

    def _widths(self, circuit: Circuit, whole: NDArray[np.int_]) -> Floats:
        _, line = MODELS["renewal"].transition_line(circuit, whole[0], whole[-1])
        most = float(np.nanmax(line, initial=0.0))
        even = np.linspace(0.0, most or float(circuit.channel1_width), FEW_WIDTHS)
        narrow = np.geomspace(1e-3 * even[-1], even[1], FEW_WIDTHS // 2)
        return np.concatenate([even[:1], narrow, even[2:]])

    def _stability(self, circuit: Circuit, widths: Floats) -> Floats:
        told, ask = f"growth {self.name} {widths.tolist()}", self.growth
        asked = [replace(circuit, channel2_width=float(one)) for one in widths]
        found = kept(told, circuit, lambda: [ask(one) for one in each(asked, "w'")])
        return -np.array(found, float)

    def passage_times(self, circuit: Circuit, low: float, high: float) -> tuple[float, float]:
        """Return how long homogeneous and polarised state last by the chain (length/v)."""
        if not self.balanced or circuit.number < 2:  # one particle is always polarised
            return math.nan, math.nan
        own = self.of(circuit)
        one, two = kept(
            f"passages {self.name} {low!r} {high!r}", own,
            lambda: passage_times(own, low, high, theory=self._theory),
        )  # fmt: skip
        return one, two


PAPER, GATE, CHANNELS = THEORIES.values()
MODELS: dict[str, Model] = {
    "window": Model("paper", "--", PAPER),
    "renewal": Model("renewal gate", "-.", GATE),
    "renewal_occupation": Model("renewal gate, channels counted", ":", CHANNELS),
    "two_port": Remembering(
        "two ports", "-.", name="two_port", flows=two_port.flows, growth=two_port.growth
    ),
    "direction": Remembering(
        "directions", "-", name="direction", flows=direction.flows, growth=direction.growth
    ),
    "one_particle": Remembering(
        "one particle", "-", name="one_particle", flows=one_particle.flows, balanced=False
    ),
}
# of circuits: the paper's, the gate's own rule with well mixed urns, and the best
ALL = (MODELS["window"], MODELS["renewal_occupation"], MODELS["direction"])
PAIR = (ALL[0], ALL[-1])  # where there is no room for more
QUICK = ALL[:2]  # where the best takes a minute
WELL_MIXED = (ALL[0], replace(MODELS["renewal"], dashes="-"), ALL[1])  # of the single urn


def best() -> tuple[Model, ...]:
    """Return the theories of `ALL`, the last one that of walkers where they are built."""
    return (*ALL[:-1], MODELS["one_particle"]) if there("one_particle") else ALL


def named(names: Iterable[str]) -> tuple[Model, ...]:
    """Return models by their names in `MODELS`, in that order."""
    return tuple(MODELS[name] for name in names)


def _where_zero(thresholds: Floats, widths: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return (T, w') where `values` of shape (T, w') first rise through 0, its end at w' = 0."""
    rises = (values[:, :-1] < 0.0) & (values[:, 1:] >= 0.0)
    there = rises.any(axis=1) & (values[:, 0] <= 0.0)
    at, row = np.argmax(rises, axis=1), np.arange(thresholds.size)
    low, high = values[row, at], values[row, at + 1]
    share = low / np.where(there, low - high, 1.0)
    line = np.where(there, widths[at] + share * (widths[at + 1] - widths[at]), math.nan)
    line = np.where(values[:, 0] == 0.0, 0.0, line)  # too small for any number
    start = values[:, 0]
    for one in np.flatnonzero((start[:-1] < 0.0) & (start[1:] > 0.0))[::-1]:
        share = start[one] / (start[one] - start[one + 1])
        end = thresholds[one] + share * (thresholds[one + 1] - thresholds[one])
        thresholds, line = np.insert(thresholds, one + 1, end), np.insert(line, one + 1, 0.0)
    return thresholds, line


def add_models(options: argparse.ArgumentParser) -> None:
    """Add `--model NAME ...`, the theories to draw."""
    options.add_argument(
        "--model",
        metavar="NAME",
        nargs="+",
        choices=sorted(MODELS),
        help=f"theories to draw: {', '.join(MODELS)} (default: what the figure has room for)",
    )


def spread_and_current(
    model: Model, circuit: Circuit, thresholds: Sequence[int]
) -> tuple[Floats, Floats]:
    """Return chi and net current of the stable polarised state at each T, NaN without one."""
    states = [model.stable_state(replace(circuit, threshold=int(one)))
              for one in each(thresholds, f"states, {model.label}, threshold")]  # fmt: skip
    found = [
        (math.nan, math.nan) if one is None else (one.mass_spread, one.net_current)
        for one in states
    ]
    spread, current = np.reshape(found, (-1, 2)).T
    return spread, current

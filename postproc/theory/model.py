"""Common interface of the theories in `theory.models`.

Callers leave out quantities that a theory does not have (`None`, NaN, no level, `Model.refusal`).
Results that take seconds are cached (`kept`), except for those of `solve`, which are timed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy import interpolate, optimize

from postproc.cli import InputError
from postproc.progress import each
from postproc.theory.chain import Lifetimes, between, lifetimes, passage_times
from postproc.theory.circuit import (
    PAPERS_AGE,
    WIDTHS_TRIED,
    eta,
    flow1,
    flow2,
    gate_load,
    single_urn_current,
    stability,
    transition_width,
)
from postproc.theory.kept import kept
from postproc.theory.renewal import RENEWAL
from postproc.theory.states import WELL_MIXED, State
from postproc.theory.tricritical import cubic

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.states import Theory

    Floats = NDArray[np.float64]

STRONGEST = 4.0  # load of a gate over T at which a transition is a jump, whatever T
STEPS = 20  # points on a line of transition from one integer T to the next
FEW_WIDTHS = 13  # for a slower theory, up to somewhat beyond the line of well mixed urns
WIDER = 1.3  # how far beyond
NEAR = 2.0  # factor to both sides of such a first value within which the zero is looked for first
LEAST = 1e-6  # of it, down to which the zero is looked for


def _no_extras(_: Circuit) -> dict[str, object]:
    return {}


@dataclass(frozen=True)
class Model:
    """A theory with its name.

    Attributes
    ----------
    name : name on command lines and in files.
    label : name in legends and tables.
    meaning : description, in a line.
    use : when to use it, in a line.
    seconds : processor time of a state at N = 1000, at least.
    dashes : style of its lines.
    adds_to : name of the theory whose physics it contains; "": none.
    changes : fields of a circuit that it changes, by name.
    theory : its functions for circuits with equal urns and gates.
    unlike : its functions for other circuits; None: it has none.
    mixed : whether its urns are well mixed and its states are zeros of eta. Then it has an eta, the
        line of eq. (transition), a tricritical point, and applies to the single urn.
    extras : further output.
    aged : whether its net current depends on the age of the run, `Circuit.age`.
    widest : largest w'/r at which it applies.
    """

    name: str
    label: str
    meaning: str
    use: str
    seconds: float
    dashes: str | tuple[int, tuple[int, ...]]
    adds_to: str = ""
    changes: Mapping[str, object] = field(default_factory=dict)
    theory: Theory = WELL_MIXED
    unlike: Theory | None = None
    mixed: bool = False
    extras: Callable[[Circuit], dict[str, object]] = _no_extras
    aged: bool = False
    widest: float = math.inf

    @property
    def has_rates(self) -> bool:
        """Whether it has outflows at any N2, so an eta and a chain of lifetimes."""
        return self.mixed or self.theory.outflows is not None

    @property
    def has_line(self) -> bool:
        """Whether it has a line of transition."""
        return self.mixed or self.theory.growth is not None

    @property
    def answers(self) -> list[str]:
        """Its results besides the states of two equal urns, in words."""
        abilities = (
            (self.unlike is not None, "unequal urns"),
            (self.has_rates, "eta, lifetimes"),
            (self.has_line, "line of transition"),
            (self.mixed, "tricritical point, single urn, polygons"),
            (self.aged, "age of a run"),
        )
        return [words for known, words in abilities if known]

    def refusal(self, circuit: Circuit) -> str:
        """Return why it does not apply to a circuit; empty: it does."""
        if circuit.shape != "circuit" and not self.mixed:
            return f"theory {self.name}: of the single urn it says nothing"
        if self.unlike is None and not circuit.alike:
            return f"theory {self.name}: it needs two equal urns and gates"
        if circuit.outline is not None and not self.mixed:
            return f"theory {self.name}: it knows urns that are discs only, these are polygons"
        most = self.widest * min(float(side.urn_radius) for side in circuit.sides)
        if np.any(np.greater(circuit.channel2_width, most)):
            return f"theory {self.name}: it knows widths of channel 2 up to {most:g}, the radius"
        return ""

    def answers_for(self, circuit: Circuit) -> bool:
        """Whether it applies to a circuit, and finds its states."""
        if self.refusal(circuit) or circuit.beyond_theory:
            return False
        try:
            self.states(circuit)
            self.homogeneous_kind(circuit)
        except InputError:
            return False
        return True

    def of(self, circuit: Circuit) -> Circuit:
        """Return the circuit for this theory; raise `InputError` if it does not apply."""
        circuit.need_empty_channels()
        if refused := self.refusal(circuit):
            raise InputError(refused)
        return replace(circuit, **_reachable(circuit), **self.changes)

    def theory_of(self, circuit: Circuit) -> Theory:
        """Return the functions for a circuit, depending on whether urns and gates are equal."""
        return self.theory if self.unlike is None or self.of(circuit).alike else self.unlike

    def solve(self, circuit: Circuit) -> list[State]:
        """Return all states with N2 > N/2, computed without the cache."""
        own = self.of(circuit)
        return [] if own.closed else self.theory_of(circuit).states(own)

    def solve_stable(self, circuit: Circuit) -> list[State]:
        """Return those of `solve` that are stable."""
        return [state for state in self.solve(circuit) if state.kind == "stable"]

    def states(self, circuit: Circuit) -> list[State]:
        """Return all states with N2 > N/2, from the cache if they take seconds."""
        found = self._cached("states", circuit, lambda: [vars(one) for one in self.solve(circuit)])
        return [State(**one) for one in found]

    def homogeneous_kind(self, circuit: Circuit) -> str:
        """Return the kind of the state with equal numbers; "" for unequal urns or gates."""
        own, theory = self.of(circuit), self.theory_of(circuit)
        if not own.alike:
            return ""
        return str(self._cached("kind", circuit, lambda: theory.homogeneous_kind(own)))

    def _cached(
        self, what: str, circuit: Circuit, compute: Callable[[], object], at: object = ""
    ) -> object:
        """Return the result of `compute`, from the cache unless it is fast."""
        if self.mixed:
            return compute()
        own = self.of(circuit)
        if what != "states":  # nothing else depends on it
            own = replace(own, age=PAPERS_AGE)
        return kept(f"{what} {self.name} {at}", own, compute)

    def stable_state(self, circuit: Circuit) -> State | None:
        """Return the stable polarised state with the largest chi, None if there is none."""
        stable = [state for state in self.states(circuit) if state.kind == "stable"]
        return stable[-1] if stable else None

    def reached(self, circuit: Circuit, number2: float) -> State | None:
        """Return the stable state that the drift reaches from N2, None if there is none.

        Of two equal urns that with N2 >= N/2, which has a mirror image. From an unstable state
        fluctuations lead to the next one.
        """
        half = 0.5 * float(circuit.number)
        if circuit.closed:  # each number is kept
            return State(number2, "neutral", abs(number2 - half) / half, 0.0)
        found = list(self.states(circuit))
        if self.of(circuit).alike:
            found.insert(0, State(half, self.homogeneous_kind(circuit), 0.0, 0.0))
            number2 = half + abs(number2 - half)
        stable = [one for one in found if one.kind != "unstable"]
        barriers = [one.urn2_number for one in found if one.kind == "unstable"]
        free = [one for one in stable
                if not any(min(number2, one.urn2_number) < place < max(number2, one.urn2_number)
                           for place in barriers)]  # fmt: skip
        return min(free, key=lambda one: abs(one.urn2_number - number2), default=None)

    def zeros(self, circuit: Circuit) -> list[tuple[float, str]]:
        """Return (N2, kind) of all stationary states, on both sides of N/2 and at it."""
        total = float(circuit.number)
        found = [(one.urn2_number, one.kind) for one in self.states(circuit)]
        if not self.of(circuit).alike:
            return found
        found += [(total - number, kind) for number, kind in found]
        return [*found, (0.5 * total, self.homogeneous_kind(circuit))]

    def eta(self, circuit: Circuit, number2: ArrayLike) -> Floats:
        """Return eta of eq. (eq007), the gain of urn 2 (per unit time); NaN if it has none."""
        second = np.asarray(number2, float)
        if not self.has_rates:
            return np.full(second.shape, math.nan)
        if self.mixed:
            return eta(self.of(circuit), second)
        if circuit.closed:
            return np.zeros(second.shape)
        places, sent = self.theory.outflows(self.of(circuit))
        # the outflow of each urn is smooth and positive; their difference has peaks in between
        one, two = np.exp(between(places, sent, second))
        known = (second >= places.min()) & (second <= places.max())
        return np.where(known, one - two, math.nan)

    def levels(self, circuit: Circuit, state: State, *, mirrored: bool = False) -> dict[str, float]:
        """Return flows and net current (per unit time) of a state, or of its mirror image.

        By name, as in results: flow1_12 ... flow2_21, current1 and current2, which are opposite.
        Circulation is included: it goes from the fuller urn through channel 2.
        """
        own, second = self.of(circuit), state.urn2_number
        carried = self.theory.flows or _carried
        flows = np.array(
            self._cached("flows", circuit, lambda: carried(own, second).tolist(), second)
        )
        around = abs(state.circulating_current or 0.0)
        fuller = int(2.0 * second > float(own.number))
        flows[1, fuller] += around
        flows[0, 1 - fuller] += around
        found = {
            f"flow{channel}_{way}": float(flows[channel - 1, at])
            for channel in (1, 2)
            for at, way in enumerate(("21", "12") if mirrored else ("12", "21"))
        }
        current2 = found["flow2_12"] - found["flow2_21"]
        return {**found, "current1": 0.0 - current2, "current2": current2}  # no -0.0

    def transition_line(self, circuit: Circuit, first: int, last: int) -> tuple[Floats, Floats]:
        """Return (T, w') along the line of transition, eq. (transition), from one T to another.

        w' is the least at which the homogeneous state becomes stable, NaN if there is none. It is
        exact at integer T; in between, where that is cheap, the function that determines stability
        is interpolated.
        Beyond its last T the homogeneous state is stable without channel 2, so the line ends at w'
        = 0.
        """
        last = min(last, max(int(np.max(circuit.number)) - 1, 1))  # no gate reverses from T = N on
        own, whole = self.of(circuit), np.arange(min(max(first, 1), last), last + 1)
        if not self.has_line:
            return whole.astype(float), np.full(whole.shape, math.nan)
        label = f"line of transition, {self.label}, threshold"
        if self.mixed:
            return _mixed_line(own, whole, label)
        if whole.size == 1:  # most widths are not needed where it is stable without channel 2
            closed = replace(own, threshold=int(whole[0]), channel2_width=0.0)
            if self._stability(closed, np.zeros(1))[0] > 0.0:
                return whole.astype(float), np.full(1, math.nan)
        _, mixed = _mixed_line(replace(circuit, gate=RENEWAL), whole, label)
        most = float(np.nanmax(mixed, initial=0.0))
        most = max(WIDER * most, 0.5 * float(circuit.channel1_width))
        even = np.linspace(0.0, most, FEW_WIDTHS)
        narrow = np.geomspace(1e-3 * even[-1], even[1], FEW_WIDTHS // 2)
        widths = np.concatenate([even[:1], narrow, even[2:]])
        thresholds, line = _line(own, whole, widths, self._stability, label)
        rough = line[np.searchsorted(thresholds, whole - 0.5 / STEPS)]
        exact = [self._zero_near(replace(own, threshold=int(at)), width)
                 for at, width in zip(whole, rough, strict=True)]  # fmt: skip
        with np.errstate(invalid="ignore"):
            factors = np.where(rough > 0.0, exact / rough, 1.0)
        known = np.isin(thresholds, whole) | (line == 0.0)
        return thresholds[known], (line * np.interp(thresholds, whole, factors))[known]

    def _zero_near(self, circuit: Circuit, width: float) -> float:
        """Return where the growth of a difference is 0, next to a first value of w'.

        It may be far below that, which is interpolated from w' = 0. NaN if it is not found.
        """

        def growth(at: float) -> float:
            return self._growth(replace(circuit, channel2_width=at))

        def found() -> float:
            low, high = width / NEAR, NEAR * width
            while growth(low) <= 0.0 and low > LEAST * width:
                low, high = low / NEAR**2, low
            if not growth(low) > 0.0 > growth(high):
                return math.nan
            try:
                return float(optimize.brentq(growth, low, high, xtol=1e-4 * low, rtol=1e-4))
            except ValueError:  # the theory has no answer in between
                return math.nan

        return float(self._cached("width", circuit, found, width) if width > 0.0 else width)

    def _stability(self, circuit: Circuit, widths: Floats) -> Floats:
        """Return a function of w' that is negative where the homogeneous state is unstable.

        Where the theory does not answer it goes on as before, so there is no zero.
        """
        circuits = [replace(circuit, channel2_width=float(one)) for one in widths]
        found = np.array(self._cached(
            "growth", circuit, lambda: list(map(self._growth, each(circuits, "w'"))),
            widths.tolist(),
        ), float)  # fmt: skip
        known = np.isfinite(found)
        return -np.interp(widths, widths[known], found[known]) if known.any() else found

    def _growth(self, circuit: Circuit) -> float:
        """Return the growth of a small difference of the urns, NaN if the theory has no answer."""
        try:
            return float(self.theory.growth(circuit))
        except InputError:
            return math.nan

    def tricritical_place(self, circuit: Circuit) -> tuple[float, float] | None:
        """Return (T, w') on the line of transition at this N where a jump becomes continuous.

        None if there is none, or the theory does not have it. It is interpolated between integer T.
        """
        if not self.mixed:
            return None
        own = self.of(circuit)
        load = 0.5 * float(circuit.number) * float(circuit.load_per_particle)
        whole = range(max(int(load / STRONGEST), 1), min(int(load) + 1, int(circuit.number)))
        values = [cubic(replace(own, threshold=one)) for one in whole]
        for one, (low, high) in zip(whole, pairwise(values), strict=False):
            if low < 0.0 <= high:
                part = low / (low - high)
                widths = [transition_width(replace(own, threshold=at)) for at in (one, one + 1)]
                return one + part, float(np.interp(part, [0.0, 1.0], widths))
        return None

    def urn_current(self, urn: Circuit) -> Floats:
        """Return the current of the single urn of the appendix (per unit time)."""
        return single_urn_current(self.of(urn))

    def lifetimes(self, circuit: Circuit) -> Lifetimes:
        """Return the lifetimes of both states of equal urns and gates."""
        own = self.of(circuit)
        return Lifetimes(**self._cached(
            "lifetimes", circuit, lambda: vars(lifetimes(own, self.theory))
        ))  # fmt: skip

    def passage_times(self, circuit: Circuit, low: float, high: float) -> tuple[float, float]:
        """Return the lifetimes of homogeneous and polarised state by the chain (length/v).

        NaN if it has none, or for one particle, which is always polarised.
        """
        if not self.has_rates or circuit.number < 2:
            return math.nan, math.nan
        own = self.of(circuit)
        one, two = self._cached(
            "passages", circuit,
            lambda: passage_times(own, low, high, theory=self.theory), (low, high),
        )  # fmt: skip
        return one, two


def _reachable(circuit: Circuit) -> dict[str, object]:
    """Return the thresholds of a circuit; from T = N on, when no gate reverses, beyond any load."""
    most = np.max([gate_load(side, circuit.number) for side in circuit.sides])
    # The Poisson tail is 0 there. No integer of numpy is as large as some loads.
    beyond = np.ceil(most + 40.0 * math.sqrt(most)) + 100.0
    names = ("threshold", "gate2_threshold")
    given = {name: getattr(circuit, name) for name in names}
    return {name: np.where(np.less(one, circuit.number), one, beyond)[()]
            for name, one in given.items() if one is not None}  # fmt: skip


def _carried(circuit: Circuit, number2: float) -> Floats:
    """Return the flows of channels 1 and 2 from urn 1 to 2 and back, for well mixed urns."""
    held = list(zip(circuit.sides, (float(circuit.number) - number2, number2), strict=True))
    return np.array([[flow(*one) for one in held] for flow in (flow1, flow2)])


def _mixed_line(circuit: Circuit, whole: NDArray[np.int_], label: str) -> tuple[Floats, Floats]:
    widths = np.linspace(0.0, circuit.widest, WIDTHS_TRIED, endpoint=False)
    return _line(circuit, whole, widths, stability, label)


def _line(
    circuit: Circuit, whole: NDArray[np.int_], widths: Floats,
    stability: Callable[[Circuit, Floats], Floats], label: str,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return (T, w') of the line, from the stability of a circuit at each integer T and each w'."""
    values = np.array(
        [stability(replace(circuit, threshold=int(one)), widths) for one in each(whole, label)]
    )
    thresholds = np.linspace(whole[0], whole[-1], (whole.size - 1) * STEPS + 1)
    if whole.size > 1:
        values = interpolate.PchipInterpolator(whole, values)(thresholds)
    return _where_zero(thresholds, widths, values)


def _where_zero(thresholds: Floats, widths: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return (T, w') where `values` of shape (T, w') first rise through 0, its end at w' = 0."""
    rises = (values[:, :-1] < 0.0) & (values[:, 1:] >= 0.0)
    crossed = rises.any(axis=1) & (values[:, 0] <= 0.0)
    at, row = np.argmax(rises, axis=1), np.arange(thresholds.size)
    low, high = values[row, at], values[row, at + 1]
    share = low / np.where(crossed, low - high, 1.0)
    line = np.where(crossed, widths[at] + share * (widths[at + 1] - widths[at]), math.nan)
    line = np.where(values[:, 0] == 0.0, 0.0, line)  # underflow
    start = values[:, 0]
    for one in np.flatnonzero((start[:-1] < 0.0) & (start[1:] > 0.0))[::-1]:
        share = start[one] / (start[one] - start[one + 1])
        end = thresholds[one] + share * (thresholds[one + 1] - thresholds[one])
        thresholds, line = np.insert(thresholds, one + 1, end), np.insert(line, one + 1, 0.0)
    return thresholds, line

"""A circuit by the keys of the namelist, and what the theories say of it."""

from __future__ import annotations

import math
import reprlib
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from postproc.cli import InputError, plain_value
from postproc.theory.circuit import PAPERS_AGE
from postproc.theory.circuit import Circuit as Model
from postproc.theory.models import named
from postproc.theory.outlines import ends, is_simple, outline_of, regular, widest
from postproc.theory.states import State

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D
    from numpy.typing import ArrayLike, NDArray

    from postproc.theory.chain import Lifetimes
    from postproc.theory.model import Model as Theory
    from postproc.theory.outlines import Outline

    Floats = NDArray[np.float64]

PAPERS = "window"
MOST_SIDES = 1000  # of regular polygons, as in the program
MOST = 2**31 - 1  # of whole numbers, as in the program
LARGEST = 200_000_000  # N, as in the program
FINEST = 2.0**-40  # least width over the longest length, as in the program


@dataclass(frozen=True)
class Circuit:
    """Two urns joined by two channels, with keys and defaults of the namelist.

    Lengths are in one unit, the speed is 1. Two values are those of urn 1 and of urn 2.

    Attributes
    ----------
    number
        N, how many particles.
    threshold
        T, one number or two: a gate reverses the particles that it counts if these are more than T.
    urn_radius
        r, one number or two.
    channel1_width, channel1_length
        w and l of the gated channel, both gates together.
    channel2_width, channel2_length
        w' and l' of the channel that closes the circuit, of which there is none if w' = 0.
    urn_sides
        How many sides urns have that are regular polygons of radius r; None: discs.
    urn_vertices
        x1, y1, x2, y2, ... of urns that are any polygons, counterclockwise, x towards channel 1;
        None: discs.

    Raises
    ------
    InputError
        It names every key that is not allowed, and what is.

    Examples
    --------
    >>> from postproc import Circuit
    >>> circuit = Circuit(number=1000, threshold=7, channel2_width=0.02)
    >>> circuit
    Circuit(number=1000, threshold=7, channel2_width=0.02)
    >>> [f"{state.mass_spread:.3f} {state.kind}" for state in circuit.states()]
    ['0.000 unstable', '0.882 stable']
    """

    number: int
    threshold: int | Sequence[int]
    urn_radius: float | Sequence[float] = 1.0
    channel1_width: float = 0.3
    channel1_length: float = 1.0
    channel2_width: float = 0.01
    channel2_length: float = 1.0
    urn_sides: int | None = None
    urn_vertices: Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Check all values; lists become tuples, so that circuits can be compared."""
        for one in fields(self):
            plain = plain_value(getattr(self, one.name))
            if isinstance(plain, list):
                plain = tuple(np.ravel(np.asarray(plain, object)).tolist())
            object.__setattr__(self, one.name, plain)
        if problems := self._problems():
            raise InputError("; ".join(problems))

    def __repr__(self) -> str:
        """Return the call that makes it, without defaults."""
        given = (f"{one.name}={reprlib.repr(getattr(self, one.name))}" for one in fields(self)
                 if getattr(self, one.name) != one.default)  # fmt: skip
        return f"Circuit({', '.join(given)})"

    def eta(self, urn2_number: ArrayLike, theory: str = PAPERS) -> Floats:
        """Return eta, how many particles urn 2 gains in a unit of time, in the mean.

        It is the flow from urn 1 to urn 2 through both channels minus that from urn 2 to urn 1.

        Parameters
        ----------
        urn2_number
            N2, between 0 and N, of any shape.
        theory
            "window" (the paper's), "renewal" or "direction".

        Returns
        -------
        numpy.ndarray
            Of the same shape; NaN where the theory knows no flow.

        Examples
        --------
        >>> Circuit(number=1000, threshold=7).eta([600, 900]).round(2).tolist()
        [1.54, 2.19]
        """
        known = _one(theory)
        return known.eta(self.model(), urn2_number)

    def states(self, theory: str = PAPERS, age: float = PAPERS_AGE) -> list[State]:
        """Return the stationary states with N2 >= N/2; each but the first has a mirror image.

        Parameters
        ----------
        theory
            As for `eta`.
        age
            Time since the start of a run, for "direction", whose net current grows with it; by
            default that of the paper's runs.

        Returns
        -------
        list of State
            By increasing N2. The first is the homogeneous one; of unequal urns or gates all N2 from
            0 to N are searched. `kind` is "stable" or "unstable" ("neutral": nothing flows),
            `mass_spread` is chi, `net_current` that of channel 1 from urn 1 to urn 2.

        Examples
        --------
        >>> state = Circuit(number=1000, threshold=7).states()[-1]
        >>> round(state.mass_spread, 3), round(state.net_current, 2)
        (0.937, 0.95)
        """
        age = plain_value(age)
        if not (isinstance(age, (int, float)) and age >= 0.0):
            raise InputError(f"age = {age}; allowed: one number from 0 up")
        known, own = _one(theory), self.model(age)
        found = known.states(own)
        if not known.of(own).alike:  # two gates that never reverse are alike
            return found
        return [State(0.5 * self.number, known.homogeneous_kind(own), 0.0, 0.0), *found]

    def transition_width(self, theory: str = PAPERS) -> float:
        """Return w' from which on the homogeneous state is stable, at this N, T and w.

        There the derivative of eta by N2 at N2 = N/2 changes its sign. NaN: there is none.
        `channel2_width` is not used.

        Examples
        --------
        >>> round(Circuit(number=1000, threshold=7).transition_width(), 3)
        0.08
        """
        own, known = self.model(), _one(theory)
        if known.mixed or not own.alike:
            return float(known.theory_of(own).transition_width(known.of(own)))
        return float(self.transition_line([_both(self.threshold)[0]], theory)[1][0])

    def transition_line(
        self, thresholds: int | Iterable[int], theory: str = PAPERS
    ) -> tuple[Floats, Floats]:
        """Return T and w' of the line on which the homogeneous state becomes stable.

        Parameters
        ----------
        thresholds
            T of both gates for which it is computed, whole numbers, or one. `channel2_width` is not
            used, `threshold` only if its two values differ: then there is no line.
        theory
            As for `eta`.

        Returns
        -------
        tuple of numpy.ndarray
            T, and w' of the same shape, NaN where there is no line.

        Examples
        --------
        >>> thresholds, widths = Circuit(number=1000, threshold=1).transition_line([2, 7, 18])
        >>> widths.round(3).tolist()
        [0.0, 0.08, nan]
        """
        own, known = self.model(), _one(theory)
        given = list(thresholds) if np.iterable(thresholds) else [thresholds]
        if not all(_is_number(one) and 0 <= one <= MOST and one == round(one) for one in given):
            told = f"allowed: whole numbers from 0 to {MOST}"
            raise InputError(f"thresholds = {reprlib.repr(given)}; {told}")
        asked = np.asarray(given, int)
        # A gate of T = 0 lets nothing pass, and from T = N on none reverses.
        widths = np.where(asked == 0, 0.0, math.nan)
        within = (asked > 0) & (asked < self.number)
        if own.alike and within.any():
            low, high = int(asked[within].min()), int(asked[within].max())
            line = known.transition_line(own, low, high)
            widths[within] = line[1][np.searchsorted(line[0], asked[within])]
        return asked.astype(float), widths

    def lifetimes(self, theory: str = PAPERS) -> Lifetimes:
        """Return the mean times in which fluctuations end the homogeneous and polarised state.

        In units of length over speed; infinite: a state is never left, 0: there is no such state.

        Examples
        --------
        >>> found = Circuit(number=700, threshold=2).lifetimes()
        >>> f"{found.homogeneous:.2g} {found.polarised:.2g}"
        '4.1e+10 3.9e+29'
        """
        own, known = self.model(), _one(theory)
        if not own.alike:
            raise InputError("lifetimes need two equal urns and gates")
        return known.lifetimes(own)

    def plot_eta(
        self, theory: str | Sequence[str] = PAPERS, ax: Axes | None = None
    ) -> list[Line2D]:
        """Draw eta against N2/N; discs mark its zeros, full ones those that are stable.

        Parameters
        ----------
        theory
            One or several.
        ax
            Axes to draw into; None: the current ones of pyplot.

        Returns
        -------
        list of matplotlib.lines.Line2D
            One for each theory.

        Examples
        --------
        >>> (line,) = Circuit(number=1000, threshold=7).plot_eta()
        >>> line.get_label()
        "window (the paper's)"
        """
        from matplotlib import pyplot as plt  # noqa: PLC0415 (not every user draws)

        from postproc.figures.currents import draw_eta  # noqa: PLC0415

        return draw_eta(ax or plt.gca(), self.model(), named(theory))

    def model(self, age: float = PAPERS_AGE) -> Model:
        """Return the circuit as the theories take it."""
        one, two = _both(self.urn_radius)
        threshold, other = _both(self.threshold)
        first, *second = self._outlines()
        return Model(
            self.number, threshold, urn_radius=one, urn2_radius=two if two != one else None,
            gate2_threshold=other if other != threshold else None, outline=first,
            urn2_outline=second[0] if second and second[0] != first else None, age=age,
            channel1_width=float(self.channel1_width), channel1_length=float(self.channel1_length),
            channel2_width=float(self.channel2_width), channel2_length=float(self.channel2_length),
        )  # fmt: skip

    def _outlines(self) -> list[Outline | None]:
        """Return the outline of the urns, or those of urn 1 and urn 2; None of a disc."""
        if self.urn_vertices is not None:
            return [outline_of(np.reshape(self.urn_vertices, (-1, 2)))]
        if self.urn_sides is not None:
            return [regular(self.urn_sides, radius) for radius in _both(self.urn_radius)]
        return [None]

    def _shape(self) -> tuple[bool, str]:
        """Return whether the corners are those of an urn, and what is allowed."""
        (outline,) = self._outlines()
        if outline is None or not is_simple(outline):
            return False, "sides that do not cross or touch each other"
        x, y = np.transpose(outline)
        right, left = ends(outline)
        for beyond, length, width in (
            (x - right, self.channel1_length, self.channel1_width),
            (left - x, self.channel2_length, self.channel2_width),
        ):
            within = (beyond > 0.0) & (np.abs(y) <= 0.5 * width)
            if width > 0.0 and (beyond.max() >= 0.5 * length or within.any()):
                return False, "corners beside a channel, short of its middle"
        return True, ""

    def _problems(self) -> list[str]:
        """Return what is wrong with the values, a line for each."""
        given = asdict(self)
        rules = [("number", _is_whole(self.number, 1, LARGEST),
                  f"a whole number from 1 to {LARGEST}")]  # fmt: skip
        for key, allowed, good in (
            (
                "threshold",
                f"one whole number from 0 to {MOST}, or two",
                lambda one: _is_whole(one, 0),
            ),
            ("urn_radius", "one number above 0, or two", _is_length),
        ):
            values = given[key] if isinstance(given[key], tuple) else (given[key],)
            rules.append((key, len(values) in (1, 2) and all(map(good, values)), allowed))
        corners, sides = self.urn_vertices, self.urn_sides
        rules += [
            ("urn_vertices", corners is None or (isinstance(corners, tuple) and len(corners) >= 6
                                                 and len(corners) % 2 == 0
                                                 and all(map(_is_number, corners))),
             "two numbers for each of three corners or more"),
            ("urn_radius", corners is None or self.urn_radius == 1.0, "only without urn_vertices"),
            ("urn_sides", sides is None or (_is_whole(sides, 4) and sides % 2 == 0
                                            and sides <= MOST_SIDES),
             f"even numbers from 4 to {MOST_SIDES}"),
            ("urn_sides", sides is None or corners is None, "only without urn_vertices"),
            ("channel1_length", _is_length(self.channel1_length), "one number above 0"),
            ("channel2_length", _is_length(self.channel2_length), "one number above 0"),
        ]  # fmt: skip
        if all(good for _, good, _ in rules) and corners is not None:
            rules.append(("urn_vertices", *self._shape()))
        if all(good for _, good, _ in rules):
            radii, first = _both(self.urn_radius), self.channel1_length
            second = self.channel2_length if self.channel2_width else 0.0  # if it is open
            least = FINEST * max(*radii, first, second)
            for key, value, other in (
                ("urn_radius", max(radii), max(first, second)),
                ("channel1_length", first, second),
                ("channel2_length", second, first),
            ):
                low, high = FINEST * max(min(radii), other), min(radii) / FINEST
                fits = corners is not None or value == 0.0 or low <= value <= high
                rules.append((key, fits, f"from {low:.1e} to {high:.1e}"))
        if all(good for _, good, _ in rules):
            for key, value, way, zero in (
                ("channel1_width", self.channel1_width, 1.0, ""),
                ("channel2_width", self.channel2_width, -1.0, "0, or "),
            ):
                most = min(2.0 * radius if outline is None else widest(outline, way)
                           for radius in _both(self.urn_radius)
                           for outline in self._outlines())  # fmt: skip
                discs = corners is None and sides is None
                below = f"below 2r = {most:g}" if discs else f"below {most:g}, an upright side"
                fits = _is_length(value) and least <= value < most
                rules.append((key, fits or bool(zero and value == 0),
                              f"{zero}one number from {least:.1e} up and {below}"))  # fmt: skip
        return [f"{key} = {given[key]}; allowed: {allowed}"
                for key, good, allowed in rules if not good]  # fmt: skip


def _both(value: Any) -> tuple[Any, Any]:  # noqa: ANN401 (a number, or a sequence of them)
    """Return the values of urn 1 and urn 2 from one or two."""
    values = value if isinstance(value, tuple) else (value,)
    return values[0], values[-1]


def _one(theory: str) -> Theory:
    """Return the theory of a name; raise `InputError` for several."""
    found = named(theory)
    if len(found) != 1:
        raise InputError(f"theory = {theory!r}: must be one name")
    return found[0]


def _is_whole(value: object, least: int, most: int = MOST) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        return False
    return bool(least <= value <= most)


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        return False
    return math.isfinite(value)


def _is_length(value: object) -> bool:
    return _is_number(value) and float(value) > 0.0  # type: ignore[arg-type]

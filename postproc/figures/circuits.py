"""Circuits against time and against a key: comp05, comp06, comp01, and their parts."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator

from postproc.cli import InputError
from postproc.figures import style
from postproc.figures.currents import (
    binned,
    draw_currents,
    draw_eta,
    explain_eta,
    settled_number2,
)
from postproc.figures.maps import STARTS, SYMBOLS, THRESHOLDS, WIDTH, equals, values_of
from postproc.progress import each
from postproc.reading.groups import series_of
from postproc.reading.points import (
    JUMP,
    alike,
    files_of,
    groups,
    keys_of,
    means,
    need_only,
    second_values,
    with_first,
    with_tasks,
)
from postproc.theory.models import defaults

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.container import ErrorbarContainer
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray

    from postproc.theory.model import Model

    Floats = NDArray[np.float64]

PARAMETERS = ("number", "threshold", "channel1_width", "channel2_width")  # in titles
MARKS = "os^DvP"  # the paper's first
MOST = 6  # points in a figure against time
HEAD = 13.0  # characters above a panel of flows, per inch of its width
STEPS = 400  # places along the time axis
BRANCHES = ("chi", "polarised_current")  # what theories have, of a state
WHOLE = (*THRESHOLDS, "number")  # keys between whose values there is nothing
THEORY_MARKS = ("x", "+", "1")
PLACES = 60  # of a fast theory along another key
EARLY = 3000.0  # time within which the transient battery at T = 2 decays


def few_points(points: xr.Dataset) -> xr.Dataset:
    """Return the points with a complete task, by T; raise `InputError` if they are too many."""
    found = points.isel(point=points["complete"].any("replica").values).sortby("threshold")
    if (count := found.sizes["point"]) > MOST:
        raise InputError(
            f"a figure against time shows at most {MOST} points, here are {count}: choose, "
            "--select KEY=VALUE ... or data.sel(KEY=VALUE)"
        )
    return with_tasks(found)


def title(points: xr.Dataset, at: int) -> str:
    """Return what distinguishes a point: the keys of the scan, or N, T, w and w'."""
    names = [name for name in keys_of(points) if name not in STARTS]
    names += ["start"] * (np.unique(points["start"]).size > 1)
    names = with_first([*(names or PARAMETERS), *second_values(points)])
    return ", ".join(equals(name, float(points[name][at]), points[name]) for name in names)


def common(points: xr.Dataset) -> str:
    """Return N, T, w and w', and T and r where the sides differ, as far as all points agree."""
    # a scanned r of urn 2 asks for r of urn 1
    names = with_first([*PARAMETERS, *keys_of(points), *second_values(points)])
    values = {name: np.unique(points[name]) for name in names}
    return ", ".join(equals(name, float(one[0])) for name, one in values.items() if one.size == 1)


@style.settings()
def figure_flows(points: xr.Dataset, models: Sequence[Model] = ()) -> Figure:
    """Return flows and net currents against time, a panel for each point by T, eta below.

    Of the first complete replica. Circuits beyond the theories and the single urn are drawn alone.
    """
    points = few_points(points)
    circuits, starts = points["circuit"].values, starts_of(points)
    count = len(circuits)
    if any(one.beyond_theory for one in circuits):
        models = ()
    elif all(one.shape == "circuit" for one in circuits):
        models = models or defaults(points["circuit"].values)
    width = max(3.1 * count, 4.6)
    made = style.figure(width, 5.4)
    cells = made.add_gridspec(1 + bool(models), count, height_ratios=(2.0, 1.0)[: 1 + bool(models)])
    for at, circuit in enumerate(circuits):
        first = int(points["complete"].values[at].argmax())
        (series,) = series_of(points, at, first)
        panels = draw_currents(made, cells[0, at], circuit, series, models, starts[at])
        replica = f", replica {first}" if points["asked"].values[at].sum() > 1 else ""
        letter = f"({chr(97 + at)})  " if count > 1 else ""
        head = letter + title(points, at) + replica
        panels[0].set_title(style.in_lines(head, int(HEAD * width / count)))
        for axes in panels if at > 0 else ():
            axes.set_ylabel("")
        if models:
            balance = made.add_subplot(cells[1, at])
            draw_eta(balance, circuit, models, settled_number2(circuit, series))
            if at > 0:
                balance.set_ylabel("")
    if models:
        explain_eta(made.axes[0])
    handles, labels = made.axes[0].get_legend_handles_labels()
    style.legend_above(made, handles, labels, 6, columnspacing=1.0, fontsize=7)
    return made


@style.settings()
def figure_relaxation(points: xr.Dataset, models: Sequence[Model] = ()) -> Figure:
    """Return chi, and below it the polarised current, against time, a colour for each point.

    Mean over the replicas, and a band of their standard deviation. The beginning is shown on the
    left if the run is much longer.
    """
    points = few_points(points)
    models = models or defaults(points["circuit"].values)
    times = [series["time"].values for at in range(points.sizes["point"])
             for series in series_of(points, at)]  # fmt: skip
    last = max(float(one[-1]) for one in times)
    few = any(one[0] > 0.5 * EARLY for one in times)  # entries at early times
    ends = [last] if last < 3.0 * EARLY or few else [EARLY, last]
    made = style.figure(style.PAGE if len(ends) > 1 else 4.6, 4.8)
    panels = made.subplots(2, len(ends), squeeze=False, sharex="col", sharey="row")
    for column, end in zip(panels.T, ends, strict=True):
        for axes, quantity in zip(column, QUANTITIES, strict=True):
            draw_relaxation(axes, points, models, quantity, end)
    for axes in panels.flat:
        axes.label_outer()
    handles, labels = panels[0, 0].get_legend_handles_labels()
    style.legend_above(made, handles, labels, 3, fontsize=7.5)
    return made


def starts_of(points: xr.Dataset) -> list[float]:
    """Return N2 at the start of each point's runs."""
    return (points["number"] - points["urn1_number"]).values.astype(float).tolist()


def mass_spread_of(series: xr.Dataset, number: float, start: float) -> tuple[Floats, Floats]:
    """Return the start and the ends of intervals, and chi at these times."""
    first = abs(number - 2.0 * start) / number
    return np.append(0.0, series["time"]), np.append(first, series["chi"])


def polarised_current_of(series: xr.Dataset, number: float, start: float) -> tuple[Floats, Floats]:
    """Return the middles of intervals, and the current of channel 2 from the urn fuller then.

    At the end those that crossed are missing from the urn that they left, which is less often the
    fuller one. It is too small where the fuller urn changes within intervals (`changes_within`).
    """
    fuller = np.sign(_ends_of(series, start).sum(axis=0) - number)
    return series["middle"].values, fuller * (series["flow2_12"] - series["flow2_21"]).values


def changes_within(series: xr.Dataset, number: float, start: float) -> NDArray[np.bool_]:
    """Tell of each interval of a series whether the fuller urn is the other one at its end."""
    fuller = np.sign(2.0 * _ends_of(series, start) - number)
    return fuller[0] * fuller[1] < 0.0


def _ends_of(series: xr.Dataset, start: float) -> Floats:
    """Return N1 at both ends of all intervals of a series."""
    later = series["urn1_number"].values
    return np.array([np.concatenate([[start], later[:-1]]), later])


# What is drawn against time: its label, how it is found, steps along the axis, theory's field, and
# the values that it can have.
QUANTITIES = {
    "chi": (r"mass spread $\chi$", mass_spread_of, STEPS, "mass_spread", (0.0, 1.0)),
    "polarised_current": ("polarised current\n(per unit time)", polarised_current_of, STEPS // 8,
                          "net_current", (-np.inf, np.inf)),
}  # fmt: skip
# Share of intervals (`changes_within`) above which the current against time lacks several per cent.
CHANGING = 0.2
TOO_LONG = (
    "the polarised current against time is too small: the fuller urn changes in up to {:.0%} of "
    "the intervals of the series; take a shorter series_interval (the mean of the run is right)"
)
MARGIN = 0.03  # of the axis of chi, for lines at its ends


def draw_relaxation(
    axes: Axes, points: xr.Dataset, models: Sequence[Model], quantity: str, end: float = np.inf
) -> list[Line2D]:
    """Draw a quantity of each point against time up to `end`; return the lines of the means.

    Replicas in two states have no mean: each is a line, of which the first is returned.
    """
    known = [] if points.attrs.get("shape") == "urn" else [*QUANTITIES]
    if quantity not in known:
        told = ", ".join(known) or "none of the single urn"
        raise InputError(f"against time there is no {quantity!r}; there are {told}")
    label, _, _, field, possible = QUANTITIES[quantity]
    lines, latest, theories, changing = [], 0.0, set(), 0.0
    circuits, starts = points["circuit"].values, starts_of(points)
    colours = (style.BLUE, style.VERMILION, style.ink(), style.GREEN, style.PURPLE, style.ORANGE)
    for at, (circuit, colour) in enumerate(zip(circuits, colours, strict=False)):
        found, share = _binned_series(points, at, quantity, float(circuit.number) - starts[at], end)
        changing = max(changing, share)
        # Replicas of merged files may have other lengths and intervals.
        last = min(middle[-1] for middle, _ in found)
        latest = max(latest, last)
        middle = min((middle[middle <= last] for middle, _ in found), key=len)
        band = np.array([np.interp(middle, *one) for one in found])
        mean, deviation = band.mean(axis=0), band.std(axis=0, ddof=min(len(band) - 1, 1))
        apart = bool(points["two_states"][at])
        shown = band if apart else [mean]
        first, *_ = axes.plot(middle, np.transpose(shown), color=colour, lw=1.1 / len(shown) ** 0.5)
        first.set_label(title(points, at) + (", replicas in two states" if apart else ""))
        lines.append(first)
        if len(shown) < len(band):
            ends = np.clip([mean - deviation, mean + deviation], *possible)
            axes.fill_between(middle, *ends, color=colour, alpha=0.25, lw=0)
        for model in models:
            if circuit.beyond_theory or model.refusal(circuit):
                continue
            if (state := model.reached(circuit, starts[at])) is not None:
                axes.axhline(getattr(state, field), color=colour, ls=model.dashes, lw=0.9)
                theories.add(model.name)
    if quantity == "polarised_current" and changing > CHANGING:
        warnings.warn(f"{files_of(points)}: {TOO_LONG.format(changing)}", stacklevel=3)
    for model in (one for one in models if one.name in theories):
        axes.plot([], [], ls=model.dashes, lw=0.9, **_theory_entry(model, lines))
    axes.set(xlabel="time $t$  (length / $v$)", ylabel=label)
    if quantity == "chi":
        axes.set_ylim(-MARGIN, 1.0 + MARGIN)
    else:
        axes.axhline(0.0, color=style.GREY, lw=0.5)
    axes.set_xlim(0.0, end if np.isfinite(end) else max(latest, axes.dataLim.x1))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    return lines


def _binned_series(
    points: xr.Dataset, at: int, quantity: str, start: float, end: float
) -> tuple[list[tuple[Floats, Floats]], float]:
    """Return times and values of each replica up to `end`, and the share of `changes_within`."""
    _, quantity_of, steps, *_ = QUANTITIES[quantity]
    found, shares, number = [], [], float(points["circuit"].values[at].number)
    for series in series_of(points, at):
        time, values = quantity_of(series, number, start)
        early = time <= max(end, time[0])  # one entry at least
        found.append(binned(time[early], values[early], steps)[:2])
        drawn = series["middle"].values <= max(end, series["middle"].values[0])
        shares.append(changes_within(series, number, start)[drawn].mean())
    return found, float(np.mean(shares))


def across_of(points: xr.Dataset) -> tuple[str, str]:
    """Return the key along the axis of curves, T if it varies, and that of their marks, or ""."""
    names = [name for name in keys_of(points) if name not in STARTS]
    first = next((name for name in names if name in ("threshold", "threshold_fraction")), "")
    across = first or ("number" if "number" in names else (names or ["threshold"])[0])
    others = [name for name in names if name != across and
              not (across == "number" and name == "threshold")]  # fmt: skip
    need_only(points, across, *others[:1])
    return across, "".join(others[:1])


def draw_curves(
    axes: Axes, points: xr.Dataset, models: Sequence[Model], quantity: str = "polarised_current",
    against: str = "",
) -> list[ErrorbarContainer]:  # fmt: skip
    """Draw means of a variable against a key, or another variable; a mark for each second key.

    T/N is that of the whole T with which a fraction was run.
    """
    across, other = across_of(points)
    axes.set_ylabel(values_of(points, quantity)[1])
    along = values_of(points, against)[1] if against else ""
    as_share = across == "threshold_fraction" or (
        across == "threshold" and np.unique(points["number"]).size == 1
    )
    shown = [one for one in (quantity, against) if one]
    if models and not {*shown} <= {*BRANCHES}:
        raise InputError(f"theories are drawn of {' and '.join(BRANCHES)}, not of "
                         f"{' against '.join(shown)}")  # fmt: skip
    theories = _theory_looks(models, across)
    drawn, known = [], set()
    for at, (value, part) in enumerate(groups(points, *([other] if other else []))):
        mark, colour = style.look(at, MARKS)
        group = part.sortby(across)
        places = (group["threshold"] / group["number"] if as_share else group[across]).values
        x, x_error = _means(group, against) if against else (places, None)
        y, y_error = _means(group, quantity)
        label = ", ".join(equals(name, one, points[name]) for name, one in value.items())
        drawn.append(axes.errorbar(x, y, y_error, x_error, fmt=mark, color=colour, mfc="none",
                                   elinewidth=0.7, ms=3.8, label=label or "measured"))  # fmt: skip
        for model, look in theories:
            found = _branch(group, model, across)
            if found:
                known.add(model.name)
                found["x"] = found["x"] / (float(group["number"][0]) if as_share else 1)
                axes.plot(found[against or "x"], found[quantity], color=colour, **look)
    for model, look in (one for one in theories if one[0].name in known):
        axes.errorbar([], [], **_theory_entry(model, [one.lines[0] for one in drawn]), **look)
    axes.set_xlabel(along or ("$T/N$" if as_share else SYMBOLS.get(across, across)))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    if across == "number" and not against:
        style.ticks_at(axes, points["number"].values.tolist())
    return drawn


def _means(points: xr.Dataset, name: str) -> tuple[Floats, ...]:
    """Return `means`; a polarised current of 0 without channel 2, the open circuit, where known."""
    closed = (points[WIDTH] == 0.0).values & (name == "polarised_current")
    closed &= np.isfinite(means(points, "chi")[0])
    return tuple(np.where(closed, 0.0, one) for one in means(points, name))


def _theory_entry(model: Model, measured: Sequence[Line2D]) -> dict[str, str]:
    """Return label and colour of a theory in a legend: that of what is measured, grey for many."""
    if len(measured) == 1:
        return {"label": f"theory, {model.label}", "color": str(measured[0].get_color())}
    return {"label": f"theory, {model.label}, in the same colours", "color": style.GREY}


def _theory_looks(models: Sequence[Model], across: str) -> list[tuple[Model, dict[str, object]]]:
    """Return how each theory is drawn: as a line if it is computed between the points, or marks."""
    looks = []
    for model, mark in zip(models, THEORY_MARKS, strict=False):
        line = {"ls": model.dashes, "lw": 0.9}
        marks = {"ls": "none", "marker": mark, "ms": 4.5, "mew": 0.8}
        looks.append((model, line if model.mixed and across not in WHOLE else marks))
    return looks


def _branch(group: xr.Dataset, model: Model, across: str) -> dict[str, Floats]:
    """Return the states that a theory reaches from the start of the runs, by their place.

    Places are all whole T, or the points of other keys and, if it is fast, many between them.
    """
    circuits, starts = group["circuit"].values, starts_of(group)
    if any(one.beyond_theory for one in circuits) or model.refusal(circuits[0]):
        return {}
    name = "threshold" if across in THRESHOLDS else across
    known = places = group[name].values
    polygons = circuits[0].outline is not None  # with outlines of their own
    if name == "threshold":
        first, last = int(known.min()), min(int(known.max()), int(circuits[0].number))
        places = np.arange(first, max(first, last) + 1)  # N is as all above
    elif name not in WHOLE and model.mixed and not (name == "urn_radius" and polygons):
        places = np.union1d(known, np.linspace(known.min(), known.max(), PLACES))
    states = []
    for place in each(places.tolist(), f"states, {model.label}, {name}"):
        at = int(np.argmin(np.abs(known - place)))
        value = int(place) if name in WHOLE else place
        found = model.reached(replace(circuits[at], **{name: value}), starts[at])
        states.append((math.nan,) * 2 if found is None else (found.mass_spread, found.net_current))
    branches = np.reshape(states, (-1, 2))
    # No line leads from one kind of state to the other.
    jumps = np.flatnonzero((np.abs(np.diff(branches[:, 0])) > JUMP) & (name not in WHOLE)) + 1
    places = np.insert(places * 1.0, jumps, 0.5 * (places[jumps - 1] + places[jumps]))
    branches = np.insert(branches, jumps, math.nan, axis=0)
    return {"x": places, **dict(zip(BRANCHES, branches.T, strict=True))}


@style.settings()
def figure_curves(points: xr.Dataset, models: Sequence[Model] = ()) -> Figure:
    """Return currents along the polarity against a key and against chi, one mark for each w'.

    The polarity is the instantaneous one, at all points: next to a transition chi does not decide
    which points are polarised.
    """
    models = models or defaults(points["circuit"].values)
    made = style.figure(style.PAGE, 3.4)
    left, right = made.subplots(1, 2, sharey=True)
    draw_curves(left, points, models)
    draw_curves(right, points, models, against="chi")
    left.set_title(common(points), loc="left")
    right.set(xlim=(-MARGIN, 1.0 + MARGIN), ylabel="")
    low, high = min(0.0, left.get_ylim()[0]), left.get_ylim()[1]
    left.set_ylim(low, high + MARGIN * (high - low))
    style.legend_above(made, *left.get_legend_handles_labels(), 4, fontsize=7.5)
    return made


def draw_characteristic(axes: Axes, points: xr.Dataset, models: Sequence[Model]) -> list[Line2D]:
    """Draw the voltage U = ln(N2/N1) of the halves against the net current J over a scan.

    N1 is the number in the emptier half, J the current along the polarity. On a second axis the
    power J U, full at its maximum. The ratio follows from the means of chi; in the homogeneous
    state chi and J are those of fluctuations. Points with chi = 1 are not shown: U is infinite.
    Return the lines of U and of J U.
    """
    alike(points)
    across = WIDTH if WIDTH in keys_of(points) else across_of(points)[0]
    need_only(points, across)
    values_of(points, "polarised_current")
    points = points.sortby(across)
    current, error = _means(points, "polarised_current")
    voltage, deviation = voltage_of(*means(points, "chi"))
    if not np.isfinite(voltage).any():
        raise InputError(f"{files_of(points)}: no point has a finite U: chi is 1, or not a mean")
    shown = axes.errorbar(current, voltage, deviation, error, fmt="o", color=style.BLUE,
                          mfc="none", ms=3.8, lw=0.7, label="$U$, measured")  # fmt: skip
    right = axes.twinx()
    right.patch.set_visible(False)  # over an inset matplotlib shows it
    if axes in axes.figure.axes:  # not an inset
        axes.figure.sca(axes)  # those of what is drawn next, such as a legend
    power, look = current * voltage, {"color": style.ORANGE, "ms": 3.4, "lw": 0.7}
    (line,) = right.plot(current, power, "s", mfc="none", **look)
    axes.plot([], [], "s", mfc="none", label="$J U$, measured", **look)
    if np.isfinite(power).any():
        best = int(np.nanargmax(power))
        where = equals(across, float(points[across][best]))
        right.plot(current[best], power[best], "s", **look)
        axes.plot([], [], "s", label=f"largest $J U$, {power[best]:.3g} at {where}", **look)
    for model, look in _theory_looks(models, across):
        found = _branch(points, model, across)
        if found:
            level = voltage_of(found["chi"], 0.0)[0]
            axes.plot(found["polarised_current"], level, color=style.BLUE,
                      label=f"$U$, theory, {model.label}", **look)  # fmt: skip
    axes.set(xlabel="polarised current $J$ (per unit time)",
             ylabel=r"$U = \ln(N_2/N_1)$, $N_2$ in the fuller half")  # fmt: skip
    axes.set_ylim(bottom=0.0)
    right.set_ylabel("power $J U$", color=style.ORANGE)
    right.set_ylim(bottom=min(0.0, right.get_ylim()[0] * (power < 0.0).any()))
    return [shown.lines[0], line]


def voltage_of(chi: Floats, error: Floats | float) -> tuple[Floats, Floats]:
    """Return U = ln(N2/N1) = ln((1 + chi)/(1 - chi)) and its standard error; NaN at chi = 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        known = np.where(chi < 1.0, chi, math.nan)
        return 2.0 * np.arctanh(known), 2.0 * error / (1.0 - known**2)


@style.settings()
def figure_characteristic(points: xr.Dataset, models: Sequence[Model] = ()) -> Figure:
    """Return the characteristic of the battery, with a legend above."""
    made = style.figure(4.8, 3.8)
    axes = made.subplots()
    draw_characteristic(axes, points, models or defaults(points["circuit"].values))
    axes.set_title(common(points), loc="left")
    style.legend_above(made, *axes.get_legend_handles_labels(), 2, fontsize=7.5)
    return made

"""The points of a dataset one after the other: means over replicas, circuits, tasks.

Figures, report, table and film take a dataset of `open_results` or `merge`, or a part of it, as
`by_point` returns it: with the dimensions `point` and `replica`. Points are chosen, sorted and
counted by xarray (`isel`, `sortby`, `sizes`).
"""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy import special

from postproc.cli import InputError
from postproc.theory.circuit import PAPERS_AGE, Circuit
from postproc.theory.outlines import outline_of, regular

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from postproc.theory.outlines import Outline

    Floats = NDArray[np.float64]

#: What makes a point, scanned or not.
PARAMETERS = (
    "number", "threshold", "threshold2", "urn1_number", "urn_radius", "urn_radius2",
    "channel1_width", "channel1_length", "channel2_width", "channel2_length", "scatterer_count",
)  # fmt: skip
OPTIONAL = ("threshold2", "urn_radius2", "scatterer_count")  # where it is of use
WHOLE = ("number", "threshold", "threshold2", "urn1_number", "scatterer_count")
FLOWS = ("flow1_12", "flow1_21", "flow2_12", "flow2_21")
COUNTS = ("task", "collisions", "reversals", "bounce_backs")  # whole in each run, not on average
COMPLETE, NOT_ASKED = 0, 3  # values of `task_status`
TWO_STATES, UNDECIDED = 2, 3  # values of `point_status`
#: Variables whose names end so are errors of the mean over all replicas of a point.
OVER_REPLICAS = ("_spread", "_replica_error")
ROUNDING = 1e-12  # numbers that differ by less, relative to the greatest, are equal
WITHIN = 0.1  # of the variance, most that two states have within them, as in precision.f90
CHANCE = 1e-3  # probability that few replicas in one state, normally distributed, look like two
MANY = 20  # replicas from which it is always less
JUMP = 0.3  # of chi, least difference between two kinds of states
FLUCTUATION = 4.0  # over sqrt(N): chi that no fluctuations have
#: Values of gate 2 and urn 2, scanned in pairs with those of 1.
PAIRS = {"threshold2": "threshold", "urn_radius2": "urn_radius"}
#: Keys that may be scanned in place of a parameter.
FRACTIONS = {"threshold": "threshold_fraction", "urn1_number": "urn1_fraction"}


def mean_error(values: xr.DataArray, own_error: xr.DataArray | None = None) -> xr.Dataset:
    """Return the mean over replicas and its standard error.

    The error is the scatter of n >= 2 complete replicas over sqrt(n); for one replica it is the
    run's own. Mean and scatter are 0 where they are rounding. A variable does not know where
    replicas are in two states, so there, too, it has a mean; `table`, figures and reports have
    none.

    Parameters
    ----------
    values
        A variable of `open_results` with the dimension `replica`; NaN where a task is not complete.
    own_error
        The same variable with `_error`; without it the error of one replica is NaN.

    Returns
    -------
    xarray.Dataset
        `mean`, `error` and `replicas`, how many are complete.

    Examples
    --------
    >>> import xarray as xr
    >>> found = mean_error(xr.DataArray([0.2, 0.3, float("nan")], dims="replica"))
    >>> round(float(found["mean"]), 3), round(float(found["error"]), 3), int(found["replicas"])
    (0.25, 0.05, 2)
    """
    if not (isinstance(values, xr.DataArray) and "replica" in values.dims):
        found = getattr(values, "dims", type(values).__name__)
        raise InputError(f"values: a variable with the dimension replica, not {found}")
    if values.sizes["replica"] == 0:
        raise InputError("values: there is no replica")
    good = values.notnull() & (abs(values) < math.inf)
    count = good.sum("replica")
    scatter = values.where(count > 1).std("replica", ddof=1) / np.sqrt(count.where(count > 1))
    rounding, mean = ROUNDING * abs(values).max("replica"), values.mean("replica")
    scatter, mean = (one.where(~(abs(one) < rounding), 0.0) for one in (scatter, mean))
    if own_error is not None:
        scatter = scatter.where(count > 1, own_error.where(good).sum("replica", min_count=1))
    return xr.Dataset({"mean": mean, "error": scatter, "replicas": count})


def flat(data: xr.Dataset, *needed: str) -> xr.Dataset:
    """Return a dataset with one dimension `point` in place of the scan's keys."""
    if not (isinstance(data, xr.Dataset) and {"task", "number", *needed} <= set(data.variables)):
        raise InputError("data: must be a dataset that postproc.open_results or merge returns")
    others = set(data["task"].dims) - {"point", "replica", *PARAMETERS, *FRACTIONS.values()}
    if others:
        raise InputError(f"data: {min(map(str, others))} is no key of a scan; merge joins results")
    if empty := [str(name) for name, size in data["task"].sizes.items() if size == 0]:
        raise InputError(f"data: is empty along {empty[0]}")
    if "replica" not in data.dims:  # one that was chosen
        if any(np.any(data[name].values % 1 > 0) for name in COUNTS if name in data):
            told = "give all of them, or one that isel chooses"
            raise InputError(f"data: has no replicas any more, such as after mean; {told}")
        by_point = {name for name in data if set(data[name].dims) <= set(data["task"].dims)
                    and name in (*PARAMETERS, "point_status", "scatterers")}  # fmt: skip
        tasks = [name for name in data if not (name in by_point or
                 str(name).startswith("theory_") or str(name).endswith(OVER_REPLICAS))]  # fmt: skip
        data = data.assign({name: data[name].expand_dims("replica", axis=-1) for name in tasks})
    axes = [name for name in data["task"].dims if name != "replica"]
    if axes == ["point"]:
        data = data.reset_index("point") if "point" in data.indexes else data  # of several keys
        return data.drop_vars("point", errors="ignore")
    if axes:
        return data.stack(point=axes, create_index=False)
    return data.expand_dims("point")


def flat_results(data: xr.Dataset, *needed: str) -> xr.Dataset:
    """Return `flat` of a dataset with all parameters, how tasks ended, and what else is needed."""
    points = flat(data, "task_status", *needed)
    for name in PARAMETERS:
        if name in OPTIONAL and name not in points:
            continue
        if name not in points or "replica" in points[name].dims or points[name].isnull().any():
            told = "choose points by sel or isel"
            raise InputError(f"data: {name} is not known at every point; {told}")
        if name in WHOLE and (points[name] % 1 != 0).any():
            told = "give other units to a coordinate beside it"
            raise InputError(f"data: {name} must be whole; {told}")
    return points


def by_point(data: xr.Dataset) -> xr.Dataset:
    """Return a dataset with the dimension `point`, and what is known of each point and task.

    Coordinates along `point` are the keys of the scan, in its order, and the second values of pairs
    that repeat a first one. Every parameter has a value at each point. Added are `circuit`, whose
    urns and gates may be unequal; `start`, chi at the beginning (`_starts`); `two_states`, whether
    replicas are in two (`_two_states`), so that they have no mean; and of each task `asked`,
    whether it was requested, and `complete`.
    """
    points = flat_results(data)
    known = [name for name in PARAMETERS if name in points]
    keys = [str(name) for name in data["task"].dims if name not in ("replica", "point")] or known
    size, status = points.sizes["point"], points["task_status"]
    columns = {name: ("point", np.broadcast_to(points[name].values, size))
               for name in (*known, *keys)}  # fmt: skip
    for second, first in PAIRS.items():
        if first in keys and second in known and second not in keys:
            pairs = np.stack([columns[name][1] for name in (first, second)])
            # A first value with several second ones does not tell which point it is.
            if np.unique(pairs, axis=1).shape[1] > np.unique(pairs[0]).size:
                keys.append(second)
    others = [name for name in known if name not in keys]
    points = points.drop_vars(keys).assign({name: columns[name] for name in others})
    points = points.assign_coords({name: columns[name] for name in keys})
    points["complete"], points["asked"] = status == COMPLETE, status != NOT_ASKED
    points = points.transpose("point", "replica", ...)
    points["circuit"] = "point", np.empty(size, object)
    points["circuit"].values[:] = _circuits(points)
    points["start"] = "point", _starts(points)
    points["two_states"] = "point", _two_states(points)
    return points


def _two_states(points: xr.Dataset) -> NDArray[np.bool_]:
    """Return where replicas are in two states: by `point_status`, or by their `_signed_chi`.

    The rule is that of the program, that the values form two groups with a small share of the
    variance within them. For one division of n normal values the share has the beta distribution of
    (n - 2)/2 and 1/2, and there are 2**(n - 1) - 1 divisions. Fewer than four show nothing.
    """
    known = (points.get("point_status", xr.zeros_like(points["start"])) == TWO_STATES).values
    if "chi" not in points or points.sizes["replica"] == 1:
        return known & (points.sizes["replica"] > 1)
    values = np.sort(_signed_chi(points))  # NaN at the end
    count = np.isfinite(values).sum(axis=1, keepdims=True)
    away = values - np.nansum(values, axis=1, keepdims=True) / np.maximum(count, 1)
    lower = np.arange(1, values.shape[1] + 1)
    # What a division into the lowest values and the others takes from the sum of squares.
    taken = np.nancumsum(away, axis=1) ** 2 * count / (lower * np.maximum(count - lower, 1))
    squares = np.nansum(away**2, axis=1)
    share = 1.0 - taken.max(axis=1) / np.where(squares > ROUNDING, squares, math.inf)
    few = np.clip(count[:, 0], 4, MANY)
    by_chance = 2.0 ** (few - 1) * special.betainc(0.5 * few - 1.0, 0.5, np.clip(share, 0.0, 1.0))
    apart = np.fmax.reduce(values, axis=1) - values[:, 0] > JUMP
    return known | ((count[:, 0] > 3) & (share < WITHIN) & (by_chance < CHANCE) & apart)


def _signed_chi(points: xr.Dataset) -> Floats:
    """Return chi; with the sign of N1 - N2 at points in polarised states that are no mirror images.

    The rule is that of the program: urns or gates are unequal, chi is clearly above 0, and the
    fuller urn never changed, so that the current through channel 2 is that along the polarity, or
    its negative.
    """
    chi = points["chi"].values
    unlike = np.array([bool(one.unlike) for one in points["circuit"].values])
    if not unlike.any() or not {"current2", "polarised_current"} <= {*points}:
        return chi
    current, along = points["current2"].values, points["polarised_current"].values
    least = np.maximum(JUMP, FLUCTUATION / np.sqrt(np.maximum(points["number"].values, 1)))
    one_state = (chi > least[:, np.newaxis]) & (np.abs(along) > 0.0)
    one_state &= np.abs(np.abs(current) - np.abs(along)) <= ROUNDING * np.abs(along)
    signed = unlike & (one_state | np.isnan(chi)).all(axis=1)
    return np.where(signed[:, np.newaxis], np.copysign(chi, current * along), chi)


def keys_of(points: xr.Dataset) -> dict[str, NDArray[np.generic]]:
    """Return the keys of the scan that have more than one value, with that at each point."""
    return {str(name): one.values for name, one in points.coords.items()
            if one.dims == ("point",) and np.unique(one).size > 1}  # fmt: skip


def second_values(points: xr.Dataset) -> dict[str, NDArray[np.generic]]:
    """Return the values of gate 2 and urn 2 where they differ from those of 1, unless a key."""
    return {second: points[second].values for second, first in PAIRS.items()
            if second in points and second not in keys_of(points)
            and not np.array_equal(points[second], points[first])}  # fmt: skip


def with_first(names: list[str]) -> list[str]:
    """Return names of parameters, before that of gate 2 or urn 2 alone that of 1.

    If only r of urn 2 were named, a reader would take r of urn 1 for the default.
    """
    found = list(names)
    for second, first in PAIRS.items():
        if second in found and first not in found:
            found.insert(found.index(second), first)
    return found


def groups(points: xr.Dataset, *keys: str) -> Iterator[tuple[dict[str, float], xr.Dataset]]:
    """Iterate over the values of parameters, and the points that have them."""
    if not keys:
        yield {}, points
        return
    columns = np.stack([points[key].values for key in keys], axis=-1)
    for values in np.unique(columns, axis=0):
        chosen = (columns == values).all(axis=1)
        yield dict(zip(keys, values.tolist(), strict=True)), points.isel(point=chosen)


def means(points: xr.Dataset, name: str) -> tuple[Floats, Floats]:
    """Return mean and standard error of a variable over the replicas (`mean_error`).

    NaN if replicas are in two states, or there is no such variable.
    """
    if name not in points:
        return (np.full(points.sizes["point"], math.nan),) * 2
    found = mean_error(points[name], points.get(f"{name}_error")).where(~points["two_states"])
    return found["mean"].values, found["error"].values


def current_name(points: xr.Dataset) -> str:
    """Return the variable that is the current: along the polarity, of a single urn its own.

    Along the instantaneous polarity, so that reversals of it do not cancel the current.
    """
    return "current1" if points.attrs.get("shape") == "urn" else "polarised_current"


def of_files(data: xr.Dataset, name: str) -> list[str]:
    """Return an attribute that has a text for each file; netCDF keeps a list of one as a text."""
    return [str(one) for one in np.ravel(data.attrs.get(name, []))]


def files_of(data: xr.Dataset) -> str:
    """Return the names of the files, for messages."""
    return ", ".join(of_files(data, "files") or ["the dataset"])


def remark(points: xr.Dataset) -> str:
    """Return the remark about a partial run; empty for a complete one."""
    done, asked = int(points["complete"].sum()), int(points["asked"].sum())
    return f"partial run: {done} of {asked} tasks" if done < asked else ""


def say(points: xr.Dataset, *remarks: str) -> None:
    """Print remarks about results on standard error, those that are not empty."""
    for one in filter(None, remarks):
        print(f"{files_of(points)}: {one}", file=sys.stderr)


def with_tasks(points: xr.Dataset) -> xr.Dataset:
    """Return the points; raise `InputError` if no task is complete."""
    if not points["complete"].any():
        raise InputError(f"{files_of(points)}: no task is complete yet")
    return points


def exactly(value: float) -> str:
    """Return a number as it must be typed to be found: with all its digits."""
    return f"{value:g}" if float(f"{value:g}") == value else repr(float(value)).removesuffix(".0")


def need_only(points: xr.Dataset, *shown: str) -> None:
    """Raise `InputError` if points differ in other parameters than a figure can show."""
    free = {"urn1_number" if name == "start" else name for name in shown}
    if free & {"number", "threshold_fraction"}:
        free.add("threshold")
    # Starts are compared as chi(0), which is scanned with N.
    columns = {name: points["start" if name == "urn1_number" else name].values
               for name in PARAMETERS if name in points and name not in free}  # fmt: skip
    varying = [name for name, one in columns.items() if np.unique(one).size > 1]
    if varying:
        # What is chosen is a key of the scan: of pairs the first, of fractions these.
        first = varying[0].removesuffix("2")
        known = (varying[0], first, FRACTIONS.get(first), *keys_of(points))
        name = next(name for name in known if name in points.coords)
        values = [exactly(one) for one in np.unique(points[name])]
        raise InputError(
            f"this figure has no place for {' and '.join(varying)} "
            f"({name}: {', '.join(values[:6])}): choose, "
            f"--select {name}={values[0]} or data.sel({name}={values[0]}) "
            f"(data.isel where {name} is no dimension of data)"
        )


def task_of(points: xr.Dataset, point: int | None, replica: int | None) -> tuple[int, int]:
    """Return point and replica of a task; an argument that is None is the first complete one."""
    done = with_tasks(points)["complete"].values
    for what, one, count in zip(("point", "replica"), (point, replica), done.shape, strict=True):
        if one is not None and one not in range(count):
            raise InputError(f"{files_of(points)}: {what} {one} is not one of 0 to {count - 1}")
    at = int(done.any(axis=1).argmax() if point is None else point)
    return at, int(done[at].argmax() if replica is None else replica)


def alike(points: xr.Dataset) -> list[Circuit]:
    """Return the circuits of points; raise `InputError` if urns or gates of one are unequal."""
    found = points["circuit"].values.tolist()
    for at, one in enumerate(found):
        if one.unlike:
            raise InputError(
                f"{files_of(points)}: {one.unlike} at point {at}; "
                "this needs two urns and two gates that are alike"
            )
    return found


def _starts(points: xr.Dataset) -> Floats:
    """Return chi at the beginning of each point's runs; (N1 - N2)/N if urns or gates are unequal.

    N1 is rounded to a whole number, so a chi(0) that was asked for is known to 1/N. Points that may
    have one chi(0) have that of the largest N among them.
    """
    number = np.maximum(points["number"].values, 1).astype(float)
    start = (2.0 * points["urn1_number"].values - number) / number
    if not any(one.unlike for one in points["circuit"].values):
        start = abs(start)
    low, high, found = start - 1.0 / number, start + 1.0 / number, start.copy()
    left = np.isfinite(start)
    while left.any():
        one = left & (low < high[left].min() + ROUNDING)
        # The next start of the same N is another one.
        least = pd.Series(start[one]).groupby(number[one]).transform("min")
        one[one] = start[one] == least
        found[one] = start[one][number[one].argmax()]
        left &= ~one
    return found


def _circuits(points: xr.Dataset) -> list[Circuit]:
    """Return the circuits of all points, from the values of their `PARAMETERS`."""
    names = [name for name in PARAMETERS
             if name in points and name not in ("urn1_number", "scatterer_count")]  # fmt: skip
    columns = [points[name].values.tolist() for name in names]
    texts = np.broadcast_to(points.get("scatterers", ""), points.sizes["point"])
    found = []
    for row, age, text in zip(zip(*columns, strict=True), _ages(points), texts, strict=True):
        values: dict[str, Any] = {name: int(one) if name in WHOLE else one
                  for name, one in zip(names, row, strict=True)}  # fmt: skip
        discs = np.reshape(str(text).split(), (-1, 3)).astype(float).tolist()
        other = values.pop("threshold2", values["threshold"])
        beyond = values.pop("urn_radius2", values["urn_radius"])
        first, second = _outlines(points.attrs, (values["urn_radius"], beyond))
        found.append(Circuit(
            **values, shape=str(points.attrs.get("shape", "circuit")), age=age, outline=first,
            scatterers=tuple(map(tuple, discs)),
            gate2_threshold=other if other != values["threshold"] else None,
            urn2_radius=beyond if beyond != values["urn_radius"] else None,
            urn2_outline=second if second != first else None,
        ))  # fmt: skip
    return found


def _ages(points: xr.Dataset) -> list[float]:
    """Return the mean age of each point's runs in the middle of their averages, to two digits.

    Where no task is complete, that of the paper's runs.
    """
    if "age" not in points:
        return [PAPERS_AGE] * points.sizes["point"]
    age = points["age"]
    mean = age.where(points["complete"] & (age >= 0.0)).mean("replica")
    return [float(f"{one:.2g}") if math.isfinite(one) else PAPERS_AGE for one in mean.values]


def _outlines(
    attributes: dict[str, Any], radii: tuple[float, float]
) -> tuple[Outline | None, Outline | None]:
    """Return the outlines of urns that are polygons, from their radii if they are regular."""
    if attributes.get("urn_shape", "disc") == "disc":
        return None, None
    if "urn_sides" in attributes:
        sides = int(attributes["urn_sides"])
        return regular(sides, radii[0]), regular(sides, radii[1])
    one, two = (outline_of(np.reshape(attributes[name], (-1, 2)))
                for name in ("urn_vertices", "urn2_vertices"))  # fmt: skip
    return one, two

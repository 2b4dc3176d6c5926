"""Results as datasets of xarray on the grid of the scan, of one file or several."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import f90nml
import numpy as np
import pandas as pd
import xarray as xr

from postproc.cli import InputError, path_of
from postproc.progress import each
from postproc.reading.groups import GROUPS, created, group_of
from postproc.reading.points import (
    COMPLETE,
    FRACTIONS,
    NOT_ASKED,
    OVER_REPLICAS,
    PAIRS,
    PARAMETERS,
    TWO_STATES,
    UNDECIDED,
    by_point,
    exactly,
    flat_results,
    mean_error,
    of_files,
)
from postproc.reading.results_file import ResultsFile
from postproc.theory.models import defaults, named

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Axes = dict[str, tuple[NDArray[np.generic], dict[str, object]]]

# Texts and comments of a namelist, which stay as they are, and the index of one element of a key.
ELEMENT = re.compile(r"""('[^'\n]*'|"[^"\n]*"|![^\n]*)|\(\s*(\d+)\s*\)(?=\s*=)""")
SIDES = {"gate_threshold": ("gate", "threshold"), "urn_radius": ("urn", "urn_radius")}
TABLE = ("shape", "urn_shape", "urn_sides", "urn_vertices", "urn2_vertices")
UNSAID = {"created", "files", "namelist", "status", "tasks", "mpi_ranks", "scan", "differs",
          "scatterers"}  # fmt: skip
# Whole numbers of merged results where a point has fewer replicas than others.
MISSING = {"task_status": NOT_ASKED, "task": -1, "file": -1, "seed": -1}
STABLE = {"stable": 1.0, "unstable": 0.0}
THEORY = {
    "theory_chi": ("", "mass spread by theory"),
    "theory_polarised_current": ("1/time", "polarised current by theory"),
    "theory_polarised_current_error": ("1/time", "polarised current by theory, standard error"),
    "theory_homogeneous_stable": ("", "whether the homogeneous state is stable by theory"),
    "theory_transition_width": ("length", "width w' of channel 2 on the transition line"),
}
URN_THEORY = {"theory_current1": ("1/time", "hits on the end wall by theory")}


def open_results(
    file: str | Path,
    *,
    theory: str | Sequence[str] | bool = (),
    group: str | None = None,
    verify: bool = False,
) -> xr.Dataset:
    """Return a results file as a dataset on the grid of its scan.

    Every key that was scanned is a dimension with its values as coordinates, in the order of the
    scan, and `replica` comes after them. What was not scanned has no dimension. What belongs to
    tasks that are not complete is NaN. All is in memory, and the file is closed.

    Parameters
    ----------
    file
        The results file.
    theory
        The name of a theory, "window" (the paper's), "renewal" or "direction": variables
        `theory_...` have its results at the age of the runs, those of the stable state that its
        drift reaches from their start; several theories become a dimension `theory`. True: the
        paper's beside memory ("direction"), which takes two seconds a point; beyond 12 points and
        for polygons beside the exact gate ("renewal"); none if there are discs in channel 2, which
        no theory has.
    group
        What to read in place of the averages: "series", "snapshots", "final" or "events". A dataset
        has them as `data.series`, ... as well; of a part of it (`data.sel(threshold=7)`) only that
        part is read.
    verify
        Whether to read the whole file and check its digest, which detects any damage.

    Returns
    -------
    xarray.Dataset
        Variables have `long_name` and `units`, unless they are dimensionless, and some a `comment`.
        Attributes are those of the file (`namelist`, `version`, `status` ...), `tasks`, how many of
        how many are complete, and `files`. A file of before the program wrote the grid has the
        dimension `point`.

    Raises
    ------
    InputError
        A `ValueError` of one line: the file is not there, damaged, of another version, or not of
        this program; there is no such theory or group; the theory is not for this table.

    Examples
    --------
    >>> data = open_results("map.h5")
    >>> data.chi.dims, data.tasks
    (('threshold', 'channel2_width', 'replica'), '8 of 8 tasks are complete')
    >>> data.sel(threshold=7).series.urn1_number.dims
    ('channel2_width', 'replica', 'time')
    """
    if not (group is None or (isinstance(group, str) and group in GROUPS)):
        raise InputError(f"there is no group {group!r}; there are {', '.join(GROUPS)}")
    data = _read(path_of(file, "file"), verify=verify)
    if group is not None:
        return group_of(data, group)
    return with_theory(data, theory) if theory else data


def _read(path: Path, *, verify: bool) -> xr.Dataset:
    """Return the averages of a file."""
    with ResultsFile(path, verify=verify) as opened, opened.damage_reported():
        axes, attributes, data = opened.axes(), opened.attributes, opened.dataset()
        if "task_status" not in data:  # of before version 0.2.0
            data["task_status"] = xr.where(np.isfinite(data["current1"]), COMPLETE, 2)
        known = data["task_status"] == COMPLETE
        asked = int((data["task_status"] != NOT_ASKED).sum())
        data = _with_sides(data, attributes).map(lambda one: _masked(one, known), keep_attrs=True)
        about = {"long_name": "place of the task in its file, from 0"}
        data["task"] = known.dims, np.arange(known.size).reshape(known.shape), about
        if {"time", "transient_time"} <= set(data):
            data["age"] = _age(data, attributes)
        if text := str(attributes.get("scatterers", "")):
            about = {"long_name": "number of discs in channel 2"}
            data["scatterer_count"] = (), len(text.split()) // 3, about
            data["scatterers"] = (), text, {"long_name": "z, y, radius of each disc"}
        data = _on_grid(data, axes)
    data.attrs = {**attributes, "files": [str(path.absolute())],
                  "tasks": f"{int(known.sum())} of {asked} tasks are complete"}  # fmt: skip
    return data


def _age(data: xr.Dataset, attributes: dict[str, object]) -> xr.DataArray:
    """Return the age of each run in the middle of its averages.

    One with a file of its start goes on from a run that ended at its `start_time`.
    """
    goes_on = attributes.get("initial_file_fingerprint")
    before = float(str(attributes.get("start_time", 0.0))) if goes_on else 0.0
    age = before + 0.5 * (data["transient_time"] + data["time"])
    return age.assign_attrs(long_name="age in the middle of the averages", units="time")


def with_theory(data: xr.Dataset, theory: str | Sequence[str] | bool) -> xr.Dataset:
    """Return results with those of theories beside them, as `open_results`."""
    points = by_point(data)
    circuits = points["circuit"].values.tolist()
    models = defaults(circuits) if theory is True else named(theory or (), circuits)
    if not models:
        return data
    urn = data.attrs.get("shape") == "urn"
    meanings = URN_THEORY if urn else THEORY
    starts = (points["number"] - points["urn1_number"]).values.astype(float)
    found = np.full((len(meanings), len(models), len(circuits)), math.nan)
    for at, model in enumerate(models):
        results_of = cache(partial(_of_urn if urn else _of_circuit, model))
        for point, circuit in enumerate(each(circuits, f"states, {model.label}, point")):
            found[:, at, point] = results_of(circuit, starts[point])
    axes = [name for name in data["task"].dims if name != "replica"]
    sizes = [data.sizes[name] for name in axes]
    added = {"theory": xr.Variable("theory", [one.name for one in models])}
    for (name, (unit, meaning)), values in zip(meanings.items(), found, strict=True):
        if name.endswith("_error") and np.isnan(values).all():
            continue
        about = {"long_name": meaning, **({"units": unit} if unit else {})}
        added[name] = xr.Variable(("theory", *axes), values.reshape(-1, *sizes), about)
    data = data.drop_dims("theory", errors="ignore").assign(added)  # theories that it has
    return data.squeeze("theory", drop=True) if isinstance(theory, str) else data


def _of_urn(model: Model, circuit: Circuit, _: float) -> list[float]:
    """Return a model's results for the single urn, in the order of `URN_THEORY`."""
    return [float(model.urn_current(circuit))]


def _of_circuit(model: Model, circuit: Circuit, number2: float) -> list[float]:
    """Return a model's results for a circuit that starts with N2, in the order of `THEORY`."""
    state = model.reached(circuit, number2)
    values: list[float | None] = [None] * 3
    if state is not None:
        current = state.polarised_current(circuit.number)
        values = [state.mass_spread, current, state.net_current_error]
    stable = STABLE.get(model.homogeneous_kind(circuit))
    width = model.theory_of(circuit).transition_width(model.of(circuit))
    return [math.nan if one is None else float(one) for one in (*values, stable, width)]


def merge(parts: Iterable[str | Path | xr.Dataset]) -> xr.Dataset:
    """Return several results as one dataset, replicas of the same point side by side.

    Parameters
    ----------
    parts
        Results files, or datasets of `open_results`.

    Returns
    -------
    xarray.Dataset
        On the grid of the parameters that differ, or with the dimension `point` if the points are
        not all combinations of these. `..._spread` and `..._replica_error` are those of all
        replicas; `point_status` is two_states where a part says so, else that of the parts that
        decided, undecided where these differ. A run that is in two parts, by its seed, is in it
        once, complete if it is so in one. The attribute `differs` says what else differs: keys of
        the namelists, versions of the program; of the length and the engine there is a warning.

    Raises
    ------
    InputError
        The tables differ in more than lengths and the number of discs in channel 2: polygons, a
        single urn, equally many discs in other places.

    Examples
    --------
    >>> data = open_results("map.h5")
    >>> both = merge([data.sel(threshold=7), data.sel(threshold=2)])
    >>> both.threshold.values.tolist(), both.sizes["replica"]
    ([2, 7], 2)
    """
    if isinstance(parts, (str, Path, xr.Dataset)) or not isinstance(parts, Iterable):
        parts = [parts]
    given = [dataset_of(one) for one in parts]
    if not given:
        raise InputError("merge: no results are given")
    _need_one_table(given)
    table, keys = _tasks(given)
    axes = _independent(table[keys])
    if table[keys].drop_duplicates().shape[0] != math.prod(table[name].nunique() for name in axes):
        table["point"], axes = table.groupby(keys).ngroup(), ["point"]
    table["replica"] = table.groupby(keys).cumcount()
    table["row"] = np.arange(len(table))
    data = table.set_index([*axes, "replica"]).to_xarray()
    rows = data["row"].fillna(-1).astype(int)
    whole = {name: (rows.dims, np.append(table[name], none)[rows])
             for name, none in MISSING.items()}  # fmt: skip
    data = data.drop_vars("row").assign(whole)
    for name in keys:
        if name not in axes:
            values = data[name].max("replica").astype(table[name].dtype)
            data[name] = _without_idle(values.variable, axes)
    data = _of_all_replicas(data)
    if "scatterers" in table:  # each number of discs has its places
        of_count = dict(zip(table["scatterer_count"], table["scatterers"], strict=True))
        counts = data["scatterer_count"]
        data["scatterers"] = counts.dims, np.vectorize(of_count.get, "U")(counts)
    for key, one in chain.from_iterable(part.variables.items() for part in given):
        if key in data and not data[key].attrs:
            data[key].attrs = one.attrs
    data.attrs = _attributes([one.attrs for one in given])
    complete, asked = int((data["task_status"] == COMPLETE).sum()), len(table)
    data.attrs |= {"files": [file for one in given for file in of_files(one, "files")],
                   "created": [date for one in given for date in created(one)],
                   "tasks": f"{complete} of {asked} tasks are complete"}  # fmt: skip
    return data


def _of_all_replicas(data: xr.Dataset) -> xr.Dataset:
    """Make `point_status` and errors over replicas anew, from all replicas of each point.

    What is there of each replica is that of its file.
    """
    if "point_status" in data:
        decided = data["point_status"].where(data["point_status"] != UNDECIDED)
        low, high = decided.min("replica"), decided.max("replica")
        found = low.where(low == high, UNDECIDED)
        found = found.where((decided != TWO_STATES).all("replica"), TWO_STATES)
        data["point_status"] = found.astype(int)
    for name in [str(name) for name in data]:
        for ending in (one for one in OVER_REPLICAS
                       if name.endswith(one) and name.removesuffix(one) in data):  # fmt: skip
            apart = ending != "_spread" and data.get("point_status") == TWO_STATES
            found = mean_error(data[name.removesuffix(ending)])["error"]
            data[name] = found.where(np.logical_not(apart))
    return data


def _need_one_table(given: Sequence[xr.Dataset]) -> None:
    """Raise `InputError` if tables differ in more than the parameters of points."""
    for name in TABLE:
        if len(found := {str(one.attrs.get(name, "")) for one in given}) > 1:
            told = ", ".join(one or "none" for one in sorted(found))
            raise InputError(f"merge: {name} differs: {told}")


def _tasks(given: Sequence[xr.Dataset]) -> tuple[pd.DataFrame, list[str]]:
    """Return all different tasks, a row each with its parameters, and the names of these."""
    fractions = [name for name in FRACTIONS.values() if all(name in one.dims for one in given)]
    frames, files = [], 0
    for one in given:
        rows = flat_results(one, "seed")
        if rows["task_status"].dtype.kind != "i":  # such as after `where`
            raise InputError(
                "merge: of datasets of open_results, or points that sel or isel choose"
            )
        kept = [name for name, values in rows.data_vars.items()
                if set(values.dims) <= {"point", "replica"}
                and not str(name).startswith("theory_")]  # fmt: skip
        frame = rows[[*kept, *fractions]].to_dataframe().reset_index(drop=True)
        frame["file"] = frame.get("file", 0) + files
        frames.append(frame[frame["task_status"] != NOT_ASKED])
        files += len(of_files(one, "files"))
    table = pd.concat(frames, ignore_index=True)
    for second, first in PAIRS.items():
        if second in table:
            table[second] = table[second].fillna(table[first])
    if "scatterers" in table:
        table = table.fillna({"scatterer_count": 0, "scatterers": ""})
        table["scatterer_count"] = table["scatterer_count"].astype(int)
        if table["scatterers"].nunique() > table["scatterer_count"].nunique():
            raise InputError("merge: scatterers differ that are equally many")
    # A fraction that was scanned in all is a key, and determines its parameter.
    known = chain.from_iterable((FRACTIONS.get(name), name) for name in PARAMETERS)
    keys = [str(name) for name in known if name in table and name in (*fractions, *PARAMETERS)]
    # A run of two files has its place in the first, and is that of the file that has more of it.
    table["run"] = table.groupby([*keys, "seed"], sort=False, dropna=False).ngroup()
    table = table.sort_values(["run", "task_status"], kind="stable")
    return table.drop_duplicates("run").drop(columns="run"), keys


def dataset_of(
    results: str | Path | xr.Dataset | Iterable[str | Path], *, verify: bool = False
) -> xr.Dataset:
    """Return a dataset of one results file, of several, or the dataset that is given."""
    if isinstance(results, xr.Dataset):
        return results
    if isinstance(results, (str, Path)) or not isinstance(results, Iterable):
        return open_results(results, verify=verify)
    found = [open_results(str(one), verify=verify) for one in results]
    return found[0] if len(found) == 1 else merge(found)


def selected(data: xr.Dataset, values: Iterable[tuple[str, float]]) -> xr.Dataset:
    """Return the points with these values of keys; raise `InputError` if there are none.

    Of a key that is given more than once, the points with any of its values.
    """
    wanted: dict[str, list[float]] = {}
    for key, value in values:
        wanted.setdefault(key, []).append(value)
    # Merged points that are no grid have values of their own.
    names = dict.fromkeys([*map(str, data["task"].dims), *PARAMETERS, *FRACTIONS.values()])
    known = [one for one in names if one in data
             and data[one].dims in ((one,), ("point",), (PAIRS.get(one),))]  # fmt: skip
    chosen: dict[Hashable, NDArray[np.bool_]] = {}  # along each dimension
    for key, allowed in wanted.items():
        if key not in known:
            raise InputError(
                f"there is no scanned key {key} to select by; there are {', '.join(known)}"
            )
        (name,) = data[key].dims
        near = np.isclose(data[key].values[:, np.newaxis], allowed, rtol=1e-9, atol=0.0)
        if not near.any(axis=0).all():
            missing = exactly(allowed[near.any(axis=0).argmin()])
            there = ", ".join(map(exactly, np.unique(data[key])))
            raise InputError(f"no point has {key} = {missing}; there are {there}")
        chosen[name] = near.any(axis=1) & chosen.get(name, True)
        if not chosen[name].any():
            raise InputError(f"no point has these values together: {', '.join(wanted)}")
    places = {name: np.flatnonzero(one) for name, one in chosen.items()}
    return data.isel({name: found if name == "point" or found.size > 1 else found[0]
                      for name, found in places.items()})  # fmt: skip


def _independent(table: pd.DataFrame) -> list[str]:
    """Return the parameters that vary, without those that others determine."""
    chosen: list[str] = []
    found = 1
    for name in table:
        if (count := len(table[[*chosen, name]].drop_duplicates())) > found:
            chosen, found = [*chosen, str(name)], count
    return chosen


def groups_in(namelist: str) -> dict[str, Any]:
    """Return values by group and key; none where the program accepts more than the reader does.

    Of `key(1) = 3, 9` f90nml takes one value, of `key(1:) = 3, 9` all, as Fortran of both.
    """
    try:
        return f90nml.reads(  # type: ignore[no-any-return]
            ELEMENT.sub(lambda found: found[1] or f"({found[2]}:)", namelist)
        )
    except Exception:  # of any class
        return {}


def _attributes(given: Sequence[dict[str, object]]) -> dict[str, object]:
    """Return the attributes that are the same in all, and what differs."""
    first, *others = given
    same = {name: value for name, value in first.items()
            if name == "version" or all(one.get(name) == value for one in others)}  # fmt: skip
    told = {name: [one.get(name) for one in given] for name in first if name not in UNSAID}
    groups = [groups_in(str(one.get("namelist", ""))) for one in given]
    for group in ("run", "initial"):
        for key in sorted({key for one in groups for key in one.get(group, {})}):
            told[f"&{group} {key}"] = [one.get(group, {}).get(key) for one in groups]
    lines = [f"{name}: {', '.join(dict.fromkeys(map(str, values)))}"
             for name, values in told.items() if len({str(one) for one in values}) > 1]  # fmt: skip
    if unlike := [line for line in lines if line.startswith(("engine: ", "&"))]:
        warnings.warn(f"merge: the runs differ in {'; '.join(unlike)}", stacklevel=3)
    return {**same, "differs": "; ".join(lines)}


def _masked(values: xr.DataArray, known: xr.DataArray) -> xr.DataArray:
    """Return the values of complete tasks, NaN for the others; integers are unchanged."""
    by_task = {"point", "replica"} <= set(values.dims)
    if not by_task or values.dtype.kind != "f":
        return values
    return values.where(known)


def _with_sides(data: xr.Dataset, attributes: dict[str, object]) -> xr.Dataset:
    """Return the parameters of urn 1 and its gate, and of urn 2 (`...2`) where they differ."""
    urn = attributes.get("shape") == "urn"
    for name, (side, one) in SIDES.items():
        if name not in data or side not in data[name].dims:
            continue
        both = data[name]
        first, second = (both.isel({side: at}, drop=True) for at in (0, 1))
        data = data.drop_vars([name, side], errors="ignore")
        if one == "urn_radius":
            data[one] = first.assign_attrs(long_name="radius r of urn 1")
        if not urn and bool((first != second).any()):
            what = "threshold T of gate 2" if one == "threshold" else "radius r of urn 2"
            data[f"{one}2"] = second.assign_attrs(long_name=what)
    return data


def _on_grid(data: xr.Dataset, axes: Axes | None) -> xr.Dataset:
    """Replace `point` by the scan's keys; drop dimensions on which a parameter does not depend."""
    if axes is None or "point" not in data.dims:
        return data
    shape = [len(values) for values, _ in axes.values()]
    variables = {}
    for name, values in data.variables.items():
        if name == "point" or name in axes:
            continue
        grid = values
        if "point" in values.dims:
            rest = [one for one in values.dims if one != "point"]
            columns = values.transpose("point", *rest).data
            grid = xr.Variable(
                [*axes, *rest], columns.reshape(shape + list(columns.shape[1:])), values.attrs
            )
        of_point = name in PARAMETERS and "replica" not in values.dims
        variables[name] = _without_idle(grid, axes) if of_point else grid
    for key, (places, about) in axes.items():
        variables[key] = xr.Variable(key, places, data[key].attrs if key in data else about)
    found = xr.Dataset(variables)
    return found.set_coords([name for name in data.coords if name in found])


def _without_idle(values: xr.Variable, axes: Iterable[str]) -> xr.Variable:
    """Return values without the dimensions along which they do not change."""
    for axis in axes:
        if axis in values.dims:
            first = values.isel({axis: 0})
            values = first if bool((values == first).all()) else values
    return values

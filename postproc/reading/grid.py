"""Results as a dataset of xarray on the grid of the scan, with theories if requested."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from postproc.cli import InputError, path_of
from postproc.reading.results import COMPLETE, NOT_ASKED, Results
from postproc.theory.models import MODELS, defaults, describe

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from postproc.theory.circuit import Circuit

    Axes = dict[str, tuple[NDArray[np.generic], dict[str, str]]]

GROUPS = ("series", "snapshots", "final", "events")
# Parameters of a point, scanned or not.
PARAMETERS = (
    "number", "threshold", "gate_threshold", "urn1_number", "urn_radius",
    "channel1_width", "channel1_length", "channel2_width", "channel2_length",
)  # fmt: skip
STATES = {"stable": 1.0, "unstable": 0.0}
THEORY = {
    "theory_chi": ("1", "mass spread of the most polarised stable state"),
    "theory_polarised_current": ("1/time", "net current of that state, from the fuller urn"),
    "theory_homogeneous_stable": ("1", "whether the homogeneous state is stable"),
    "theory_transition_width": ("length", "width w' of channel 2 on the transition line"),
    "theory_polarised_current_error": ("1/time", "net current by theory, standard error"),
}
URN_THEORY = {"theory_current1": ("1/time", "hits on the end wall")}


def open_results(
    file: str | Path,
    *,
    theory: str | Sequence[str] | bool = (),
    group: str | None = None,
    verify: bool = False,
) -> xr.Dataset:
    """Return a results file as a dataset on the grid of its scan.

    Every key that was scanned is a dimension with its values as coordinates, in the order of the
    scan, and `replica` comes after them. What was not scanned is a coordinate without a dimension.
    What belongs to tasks that are not complete is NaN. All is in memory, and the file is closed.

    Parameters
    ----------
    file : the results file.
    theory : the name of a model ("window" is the paper's, see `postproc.theory.models`): variables
        `theory_...` have its results; several models become a dimension `theory`. True: the paper's
        beside memory ("direction"), which takes two seconds a point; beyond 12 points and for
        polygons beside the exact gate ("renewal"); none if there are discs in channel 2, which no
        theory has. Currents are those of runs as old as the file's.
    group : what to read in place of the averages: "series", "snapshots", "final" or "events".
    verify : whether to read the whole file and check its digest, which detects any damage.

    Returns
    -------
    xarray.Dataset
        Variables have `units` and `long_name`. Attributes are those of the file (`namelist`,
        `version`, `status` ...) and `tasks`, how many of how many are complete. A file of before
        the program wrote the grid has the dimension `point`, with what it is as coordinates.

    Raises
    ------
    ValueError
        One line: the file is not there, damaged, of another version, or not of this program;
        there is no such model or group; the model is not for this table.
    """
    models = [theory] if isinstance(theory, str) or not isinstance(theory, Iterable) else [*theory]
    if isinstance(theory, bool):
        models = []
    for model in models:
        if not (isinstance(model, str) and model in MODELS):
            raise InputError(f"there is no theory {model!r}; there are {', '.join(MODELS)}")
    if not (group is None or (isinstance(group, str) and group in GROUPS)):
        raise InputError(f"there is no group {group!r}; there are {', '.join(GROUPS)}")
    path = path_of(file, "file")
    with Results(path, verify=verify) as results:
        if group is not None and not results.has(group):
            raise InputError(f"{path}: has no {group}")
        axes = results.axes()
        if theory is True and not results.scatterers:
            circuits = map(results.any_circuit, range(results.points))
            models = [one.name for one in defaults(circuits)]
        added = _theory(results, models) if models and group is None else {}
        data = results.dataset()
        inner = results.dataset(group) if group is not None else None
        known = data["task_status"] == COMPLETE
        asked = int((data["task_status"] != NOT_ASKED).sum())
        points = data[[name for name in PARAMETERS if name in data]]
        if inner is None:
            data = data.drop_vars(list(points.data_vars)).assign(added)
        else:
            data = inner.assign_coords(replica=data["replica"])
            points = points.drop_vars(list(data.variables), errors="ignore")
        data = data.map(lambda one: _masked(one, known)).assign_coords(points.data_vars)
        data = _on_grid(_with_second_radius(data, axes), axes)
        data.attrs = dict(results.attributes)
    if isinstance(theory, str) and "theory" in data.dims:
        data = data.isel(theory=0)
    data.attrs["tasks"] = f"{int(known.sum())} of {asked} tasks are complete"
    return data


def _masked(values: xr.DataArray, known: xr.DataArray) -> xr.DataArray:
    """Return the values of complete tasks, NaN for the others; integers are unchanged."""
    by_task = {"point", "replica"} <= set(values.dims)
    if not by_task or values.dtype.kind != "f":
        return values
    return values.where(known)


def _with_second_radius(data: xr.Dataset, axes: Axes | None) -> xr.Dataset:
    """Keep the radius of urn 2 where the dimension `urn_radius` is that of urn 1."""
    if not axes or "urn_radius" not in axes or "urn" not in data["urn_radius"].dims:
        return data
    second = data["urn_radius"].isel(urn=1, drop=True)
    attributes = {"units": "length", "long_name": "radius r of urn 2"}
    return data.assign_coords(urn_radius2=(second.dims, second.data, attributes))


def _on_grid(data: xr.Dataset, axes: Axes | None) -> xr.Dataset:
    """Replace `point` by the scan's keys; drop dimensions on which a parameter does not depend."""
    if axes is None or "point" not in data.dims:
        return data
    shape = [len(values) for values, _ in axes.values()]
    variables, coordinates = {}, {}
    for name, values in data.variables.items():
        if name == "point" or name in axes:
            continue
        grid = values
        if "point" in values.dims:
            rest = [one for one in values.dims if one != "point"]
            columns = values.transpose("point", *rest)
            columns = columns.data.reshape(shape + list(columns.shape[1:]))
            grid = xr.Variable([*axes, *rest], columns, values.attrs)
        if name in data.coords:
            coordinates[name] = _without_idle(grid, axes)
        else:
            variables[name] = grid
    for name, (values, attributes) in axes.items():
        known = data[name].attrs if name in data else attributes
        coordinates[name] = xr.Variable(name, values, known)
    if "urn_radius" in axes and "urn_radius" in data:
        coordinates |= _second_radius(data["urn_radius"], axes)
    return xr.Dataset(variables, coordinates)


def _second_radius(both: xr.DataArray, axes: Axes) -> dict[str, xr.Variable]:
    """Return the radius of urn 2 where it was scanned in pairs with that of urn 1, else nothing."""
    radius = both.transpose("point", ...).data
    if radius.ndim == 1 or bool((radius[:, 0] == radius[:, -1]).all()):
        return {}
    column = radius[:, -1].reshape([len(values) for values, _ in axes.values()])
    return {"urn_radius2": _without_idle(xr.Variable(list(axes), column, both.attrs), axes)}


def _without_idle(values: xr.Variable, axes: Axes) -> xr.Variable:
    """Return values without the dimensions along which they do not change."""
    for axis in axes:
        if axis not in values.dims:
            continue
        first = values.isel({axis: 0})
        if bool((values == first).all()):
            values = first
    return values


def _theory(results: Results, models: Sequence[str]) -> dict[str, xr.Variable]:
    """Return the models' results at each point, by name, with dimensions (theory, point)."""
    urn = results.shape == "urn"
    meanings = URN_THEORY if urn else THEORY
    mixed = [name for name, model in MODELS.items() if model.mixed]
    if urn and not set(models) <= set(mixed):
        raise InputError(f"{results.path}: of the shape 'urn' only {', '.join(mixed)} know")
    found = np.full((len(meanings), len(models), results.points), math.nan)
    known: dict[tuple[Circuit, str], list[float]] = {}
    for at, model in enumerate(models):
        for point in range(results.points):
            case = results.any_circuit(point), model
            if case not in known:
                known[case] = _theory_values_of_urn(*case) if urn else _theory_values(*case)
            found[:, at, point] = known[case]
    added = {
        name: xr.Variable(("theory", "point"), values, {"units": unit, "long_name": meaning})
        for (name, (unit, meaning)), values in zip(meanings.items(), found, strict=True)
        if not (name.endswith("_error") and np.isnan(values).all())
    }
    return {"theory": xr.Variable("theory", models), **added}


def _theory_values_of_urn(circuit: Circuit, model: str) -> list[float]:
    """Return a model's results for the single urn, in the order of `URN_THEORY`."""
    return [float(MODELS[model].urn_current(circuit))]


def _theory_values(circuit: Circuit, model: str) -> list[float]:
    """Return a model's results for a circuit, in the order of `THEORY`."""
    answer = describe(circuit, MODELS[model])
    stable = [root for root in answer["roots"] if root["kind"] == "stable"]
    none = {"mass_spread": 0.0, "net_current": 0.0}
    best = max(stable, key=lambda root: root["mass_spread"], default=none)
    values = [
        best["mass_spread"],
        best["net_current"],
        STATES.get(answer["homogeneous"]),
        answer["transition_width"],
        best.get("net_current_error"),
    ]
    return [math.nan if value is None else value for value in values]

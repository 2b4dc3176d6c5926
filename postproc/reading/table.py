"""Prints a table of results, one row a point: means over replicas with errors, and theories.

The table is CSV. Columns are the keys that make the points, then each mean with its standard error,
the number of complete replicas, and the results of theories if any are named.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from postproc import cli
from postproc.reading.grid import PARAMETERS, open_results
from postproc.reading.results import TWO_STATES
from postproc.theory.models import MODELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

MEANS = ("chi", "polarised_current", "current1", "current2")


def mean_error(values: xr.DataArray, own_error: xr.DataArray | None = None) -> xr.Dataset:
    """Return the mean over replicas and its standard error.

    The error is the scatter of n >= 2 complete replicas over sqrt(n); for one replica it is the
    run's own.

    Parameters
    ----------
    values : a variable of `open_results` with the dimension `replica`; NaN where a task is not
        complete.
    own_error : the same variable with `_error`; without it the error of one replica is NaN.

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
    good = np.isfinite(values)
    count = good.sum("replica")
    scatter = values.where(count > 1).std("replica", ddof=1) / np.sqrt(count.where(count > 1))
    if own_error is not None:
        scatter = scatter.where(count > 1, own_error.where(good).sum("replica", min_count=1))
    return xr.Dataset({"mean": values.mean("replica"), "error": scatter, "replicas": count})


def table(file: str | Path, *, theory: str | Sequence[str] = ()) -> pd.DataFrame:
    """Return a table of results, one row a point.

    Parameters
    ----------
    file : the results file.
    theory : names of theories, "window" (the paper's), "renewal" or "direction".

    Returns
    -------
    pandas.DataFrame
        The keys that make the points; mean and `_error` over replicas of chi and the currents
        (`mean_error`), NaN where replicas are in two states; `replicas`, how many are complete; of
        each theory `chi`, `polarised_current` and `transition_width` after its name.
    """
    data = open_results(file, theory=[theory] if isinstance(theory, str) else theory)
    one_state = True
    if "point_status" in data:
        one_state = data["point_status"] != TWO_STATES
    columns = _parameters(data)
    for name in (one for one in MEANS if one in data):
        found = mean_error(data[name], data.get(f"{name}_error"))
        columns[name] = found["mean"].where(one_state)
        columns[f"{name}_error"] = found["error"].where(one_state)
    columns["replicas"] = np.isfinite(data["current1"]).sum("replica")
    for name in data.get("theory", xr.DataArray([])).values.tolist():
        for what in ("chi", "polarised_current", "transition_width"):
            if f"theory_{what}" in data:
                columns[f"{name}_{what}"] = data[f"theory_{what}"].sel(theory=name, drop=True)
    plain = {name: one.reset_coords(drop=True) for name, one in columns.items()}
    points = [name for name in data["chi"].dims if name != "replica"]
    if not points:
        return xr.Dataset(plain).expand_dims("point").to_dataframe().reset_index(drop=True)
    rows = xr.Dataset(plain).stack(point=points).reset_index("point")
    return rows.to_dataframe()[list(columns)].reset_index(drop=True)


def _parameters(data: xr.Dataset) -> dict[str, xr.DataArray]:
    """Return the keys that make the points; of what belongs to an urn, both if they differ."""
    found = {}
    for name in (one for one in PARAMETERS if one in data.coords):
        ends = {"gate", "urn"} & set(data[name].dims)
        if not ends:
            found[name] = data[name]
        for end in ends:
            first, second = (data[name].isel({end: at}, drop=True) for at in (0, 1))
            if not bool((first == second).all()):
                found |= {f"{name}_1": first, f"{name}_2": second}
    return found


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    options = cli.parser("table", __doc__)
    options.add_argument("file", metavar="FILE.h5", type=Path)
    options.add_argument(
        "--theory", metavar="NAME", nargs="+", choices=tuple(MODELS), default=[],
        help=f"theories beside the runs: {', '.join(MODELS)}",
    )  # fmt: skip
    given = options.parse_args(arguments)
    table(given.file, theory=given.theory).to_csv(sys.stdout, index=False, float_format="%.8g")
    return 0

"""Results as a table of pandas, one row a point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from postproc.reading.grid import dataset_of, with_theory
from postproc.reading.points import PARAMETERS, by_point, keys_of, means, remark, say

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    import xarray as xr

MEANS = ("chi", "polarised_current", "current1", "current2")
THEORY = ("chi", "polarised_current", "transition_width", "current1")


def table(
    results: str | Path | xr.Dataset | Iterable[str | Path], *, theory: str | Sequence[str] = ()
) -> pd.DataFrame:
    """Return a table of results, one row a point.

    Parameters
    ----------
    results
        A results file, several (`merge`), or a dataset of `open_results` or `merge`.
    theory
        Names of theories, "window" (the paper's), "renewal" or "direction".

    Returns
    -------
    pandas.DataFrame
        The parameters of the points; mean and `_error` over replicas of chi and the currents
        (`mean_error`), NaN where replicas are in two states; `replicas`, how many are complete; of
        each theory `chi`, `polarised_current` and `transition_width` after its name, or `current1`
        of a single urn. `direction` has no `transition_width` here (`Circuit.transition_line`).

    Examples
    --------
    >>> found = table("map.h5", theory="window")
    >>> found[["threshold", "channel2_width", "replicas", "window_chi"]].round(3).iloc[0].tolist()
    [2.0, 0.01, 2.0, 0.801]
    """
    data = dataset_of(results)
    data = with_theory(data, [theory] if isinstance(theory, str) else theory)
    points = by_point(data)
    say(points, remark(points))
    names = [*PARAMETERS, *keys_of(points)]
    columns = {name: points[name].values for name in names if name in points}
    for name in (one for one in MEANS if one in data):
        columns[name], columns[f"{name}_error"] = means(points, name)
    columns["replicas"] = points["complete"].sum("replica").values
    for name in np.atleast_1d(points.get("theory", np.empty(0))).tolist():
        for what in (f"theory_{one}" for one in THEORY):
            if what in points:
                columns[what.replace("theory", name, 1)] = points[what].sel(theory=name).values
    return pd.DataFrame(columns)

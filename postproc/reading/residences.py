"""Residence times in the homogeneous and the polarised states, from series."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from postproc.cli import InputError
from postproc.reading.points import FRACTIONS, PARAMETERS, flat

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def residences(series: xr.Dataset, *, low: float = 0.2, high: float = 0.7) -> pd.DataFrame:
    """Return how long runs stay in each state.

    A polarised state begins where chi, the size of (N1 - N2)/N, reaches `high`, and ends where it
    falls to `low`; then the homogeneous state begins. So short recrossings do not count.

    Parameters
    ----------
    series
        Those of a dataset, `data.series`.
    low, high
        Of chi, 0 < low < high < 1.

    Returns
    -------
    pandas.DataFrame
        A row for each stay: the parameters of the point, `replica`, `state` (1: urn 1 is full, -1:
        urn 2, 0: homogeneous), `start` and `duration`, and `ended`, whether it ended before the run
        did. The first stay of a run begins with its series.

    Examples
    --------
    >>> import xarray as xr
    >>> n1 = xr.DataArray([[50.0, 95.0, 75.0, 52.0, 5.0]], dims=("replica", "time"))
    >>> times = {"time": [1.0, 2.0, 3.0, 4.0, 5.0]}
    >>> series = xr.Dataset({"urn1_number": n1, "number": 100, "task": ("replica", [0])}, times)
    >>> residences(series)[["state", "start", "duration"]].to_numpy().tolist()
    [[0.0, 1.0, 1.0], [1.0, 2.0, 2.0], [0.0, 4.0, 1.0], [-1.0, 5.0, 0.0]]
    """
    if not 0.0 < low < high < 1.0:
        raise InputError(f"low = {low}, high = {high}: 0 < low < high < 1 is wanted")
    if "urn1_number" not in series or "time" not in series["urn1_number"].dims:
        raise InputError("series: must be those of a dataset, data.series")
    points, rows = flat(series), []
    time = np.asarray(series["time"], float)
    for at in range(points.sizes["point"]):
        one = points.isel(point=at)
        about = {name: one[name].item() for name in (*PARAMETERS, *FRACTIONS.values())
                 if name in one and one[name].ndim == 0}  # fmt: skip
        for place, replica in enumerate(points["replica"].values.tolist()):
            first = np.asarray(one["urn1_number"].isel(replica=place), float)
            known = np.isfinite(first) & (first >= 0.0)
            spread = (2.0 * first[known] - about["number"]) / about["number"]  # rounded once
            for state, start, duration, ended in _stays(time[known], spread, low, high):
                rows.append({**about, "replica": replica, "state": state, "start": start,
                             "duration": duration, "ended": ended})  # fmt: skip
    return pd.DataFrame(rows)


def _stays(
    time: Floats, spread: Floats, low: float, high: float
) -> list[tuple[int, float, float, bool]]:
    """Return state, start, duration of each stay, and whether it ended."""
    if time.size == 0:
        return []
    inside = np.where(abs(spread) <= low, 0.0, np.nan)  # of a state; else the last one goes on
    known = pd.Series(np.where(abs(spread) >= high, np.sign(spread), inside))
    states = known.ffill().fillna(0.0).to_numpy(int)
    places = np.flatnonzero(np.append(True, states[1:] != states[:-1]))
    ends = np.append(time[places[1:]], time[-1])
    ended = np.arange(places.size) < places.size - 1
    stays = zip(states[places], time[places], ends - time[places], ended, strict=True)
    return [(int(state), float(start), float(length), bool(over))
            for state, start, length, over in stays]  # fmt: skip

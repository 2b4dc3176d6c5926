"""Event logs by particle: the fate of each entry into a gate, and the events before and after."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc.theory.circuit import Circuit

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]
    Flags = NDArray[np.bool_]

ENTRY, REVERSAL, CROSSING1, CROSSING2 = 1, 2, 3, 4  # kinds of events
GROUPS = 10  # of particles, whose scatter gives an error


@dataclass(frozen=True)
class Log:
    """An event log in the order of time; every field has shape (event,)."""

    time: Floats
    kind: Integers
    where: Integers
    particle: Integers


@dataclass(frozen=True)
class ParticleEvents:
    """The events of single particles, by particle and then time; fields of shape (event,).

    Attributes
    ----------
    time, kind, where, particle : as in the log, without the reversals.
    before, after : index of the particle's event before and after, -1 if there is none.
    turned : of an entry, when its gate reversed with the particle in it; NaN if it got through, if
        the log ends before, or if the event is no entry.
    """

    time: Floats
    kind: Integers
    where: Integers
    particle: Integers
    before: Integers
    after: Integers
    turned: Floats


def read_log(path: Path) -> Log:
    """Return the event log of a file."""
    events = postproc.open_results(path, group="events")
    names = ("kind", "where", "particle")
    return Log(events.time.to_numpy(), **{one: events[one].to_numpy().astype(int) for one in names})


def circuit_of(data: xr.Dataset) -> Circuit:
    """Return the circuit of results of one point."""
    names = ("number", "channel1_width", "channel1_length", "channel2_width", "channel2_length")
    radius = float(data.urn_radius.to_numpy().flat[0])
    return Circuit(urn_radius=radius, threshold=int(data.threshold),
                   **{name: float(data[name]) for name in names})  # fmt: skip


def particle_events(log: Log) -> ParticleEvents:
    """Return the events by particle, with the fate of each entry."""
    place = np.flatnonzero(log.kind != REVERSAL)
    place = place[np.argsort(log.particle[place], kind="stable")]
    particle = log.particle[place]
    same = np.flatnonzero(particle[1:] == particle[:-1])
    before, after = np.full(place.size, -1), np.full(place.size, -1)
    before[same + 1], after[same] = same, same + 1
    turned = np.full(place.size, np.nan)
    for gate in (1, 2):
        mine = np.flatnonzero((log.kind[place] == ENTRY) & (log.where[place] == gate))
        reversals = np.append(
            np.flatnonzero((log.kind == REVERSAL) & (log.where == gate)), log.time.size
        )
        following = reversals[np.searchsorted(reversals, place[mine])]
        own = np.where(after[mine] >= 0, place[after[mine]], log.time.size)
        caught = following < own
        turned[mine[caught]] = log.time[following[caught]]
    columns = (log.time[place], log.kind[place], log.where[place], particle)
    return ParticleEvents(*columns, before, after, turned)


def outward_stays(events: ParticleEvents) -> tuple[Integers, Floats, Floats]:
    """Return (gate, begin, end) of every stay in a gate in which a particle moves outwards.

    A reversed particle leaves as long after the reversal as it entered before it; one that crossed
    the middle line leaves the other gate as long after the crossing as it entered the first before
    it.
    """
    entered = np.flatnonzero(events.kind == ENTRY)
    turned = entered[np.isfinite(events.turned[entered])]
    through = entered[np.isnan(events.turned[entered]) & (events.after[entered] >= 0)]
    crossed = events.time[events.after[through]]
    gate = np.concatenate([events.where[turned], 3 - events.where[through]])
    start = np.concatenate([events.turned[turned], crossed])
    stop = 2.0 * start - np.concatenate([events.time[turned], events.time[through]])
    return gate, start, stop


def entries_of(events: ParticleEvents) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Return (time, particle, cos(theta)) of entries into gate 1 that reach the end wall.

    Without a gate the flight from the chord to the wall takes (l/2)/cos(theta); here l = 1.
    """
    entry = np.flatnonzero((events.kind == ENTRY) & (events.after >= 0))
    entry = entry[events.kind[events.after[entry]] == CROSSING1]
    flight = events.time[events.after[entry]] - events.time[entry]
    return events.time[entry], events.particle[entry], 0.5 / flight


def autocorrelations(
    time: Floats, particle: NDArray[np.int64], cosine: Floats, lags: NDArray[np.int64], last: float
) -> Floats:
    """Return the autocorrelation of cos(theta), shape (group of particles, lag).

    Pairs begin before `last`, so that hardly any is cut off by the end of the run, which would
    favour short visits. The mean is that of the cosine law, pi/4; the variance is that of each
    group.
    """
    away = cosine - 0.25 * math.pi
    group = particle % GROUPS
    variance = np.bincount(group, away**2) / np.bincount(group)
    found = np.empty((GROUPS, lags.size))
    for at, lag in enumerate(lags):
        pair = (particle[lag:] == particle[:-lag]) & (time[:-lag] < last)
        product = (away[lag:] * away[:-lag])[pair]
        sums = np.bincount(group[:-lag][pair], product, minlength=GROUPS)
        found[:, at] = sums / np.bincount(group[:-lag][pair], minlength=GROUPS) / variance
    return found


def after_channel2(events: ParticleEvents, channel2_length: float = 1.0) -> tuple[Floats, Floats]:
    """Return (share whose next event is channel 2 again, mean stay in the urn) by group.

    The path from the line to the urn, and from the urn back to the line, takes pi l'/4 on average.
    """
    crossed = np.flatnonzero((events.kind == CROSSING2) & (events.after >= 0))
    following = events.after[crossed]
    again = events.kind[following] == CROSSING2
    flight = events.time[following] - events.time[crossed]
    group = events.particle[crossed] % GROUPS
    count = np.bincount(group, minlength=GROUPS)
    share = np.bincount(group, again, minlength=GROUPS) / count
    half = 0.25 * math.pi * channel2_length
    return share, np.bincount(group, flight, minlength=GROUPS) / count - half * (1.0 + share)

"""Event logs by particle: the fate of each entry into a gate, and the events before and after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from postproc.cli import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from postproc.reading.results import Results

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]
    Flags = NDArray[np.bool_]

ENTRY, REVERSAL, CROSSING1, CROSSING2 = 1, 2, 3, 4  # kinds of events


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


def read_log(results: Results) -> Log:
    """Return the event log of a file."""
    events = results.events()
    if not events:
        raise InputError(f"{results.path}: has no event log (set event_log in &output)")
    whole = {name: events[name].astype(np.int64) for name in ("kind", "where", "particle")}
    return Log(events["time"], **whole)


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

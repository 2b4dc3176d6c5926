"""Event logs read as stories: what became of each entry into a gate, and who came from where."""

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
class Stories:
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


def stories(log: Log) -> Stories:
    """Return the events by particle, with what became of each entry."""
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
    return Stories(*columns, before, after, turned)


def outward_stays(told: Stories) -> tuple[Integers, Floats, Floats]:
    """Return (gate, from when, until when) of every stay in a gate with the way out ahead.

    Those turned back leave as long after the reversal as they came before it; those who crossed the
    middle line leave the other gate as long after it as they entered the first before it.
    """
    entered = np.flatnonzero(told.kind == ENTRY)
    turned = entered[np.isfinite(told.turned[entered])]
    through = entered[np.isnan(told.turned[entered]) & (told.after[entered] >= 0)]
    crossed = told.time[told.after[through]]
    gate = np.concatenate([told.where[turned], 3 - told.where[through]])
    start = np.concatenate([told.turned[turned], crossed])
    stop = 2.0 * start - np.concatenate([told.time[turned], told.time[through]])
    return gate, start, stop

"""Runs from single states, forwards and back: events of a few particles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc.study.text import number
from studies.event_log import CROSSING1, CROSSING2, ENTRY, REVERSAL, read_log

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from postproc import study
    from postproc.study.study import Groups

    Floats = NDArray[np.float64]

# x y ux uy; all move along the channel, so that every event can be computed by hand
FROM_URN2 = ((0.7, 0.05, -1.0, 0.0), (0.8, -0.05, -1.0, 0.0))
PASSER = (-0.1, 0.0, 1.0, 0.0)
EXAMPLE_TIME = 0.8


def states_file(path: Path, columns: Sequence[Floats]) -> str:
    """Write positions and velocities as an initial file; return its name."""
    np.savetxt(path, np.column_stack(columns), fmt="%.17g")
    return path.name


def final_state(path: Path) -> list[Floats]:
    """Return x, y, ux, uy of all particles at the end of a single task."""
    end = postproc.open_results(path, group="final").squeeze("replica")
    return [end[name].to_numpy() for name in ("x", "y", "ux", "uy")]


def forth_and_back(
    work: study.Study, name: str, changes: Groups, columns: Sequence[Floats]
) -> list[Path]:
    """Run from a state, reverse all velocities, run as long again; return both results files."""
    files = []
    for way in ("forth", "back"):
        state = states_file(work.folder / f"{name}_{way}.txt", columns)
        own = {**changes, "particles": {**changes["particles"], "initial_file": state}}
        files.append(work.run("reversal", f"{name}_{way}", own, alone=True))
        x, y, ux, uy = final_state(files[-1])
        columns = (x, y, -ux, -uy)
    return files


def example(
    work: study.Study, name: str, states: Sequence[Sequence[float]], turn: float = EXAMPLE_TIME
) -> dict[str, object]:
    """Run a few particles forwards and back; return the events as rows, and the final states."""
    changes = {
        "particles": {"number": len(states), "urn1_number": None},
        "gate": {"threshold": 1},
        "run": {"duration": turn},
    }
    columns = np.array(states).T
    events = {"turn": turn}
    for way, file in zip(
        ("forth", "back"), forth_and_back(work, name, changes, columns), strict=True
    ):
        log, end = read_log(file), final_state(file)
        events[way] = [
            (time, words(kind, where, particle))
            for time, kind, where, particle in zip(
                log.time, log.kind, log.where, log.particle, strict=True
            )
        ]
        events[f"{way}_end"] = np.column_stack(end)
    start = np.array(states)
    events["returns_within"] = float(np.abs(events["back_end"][:, :2] - start[:, :2]).max())
    return events


def words(kind: int, where: int, particle: int) -> str:
    """Return an event as text."""
    urns = "from urn 1 to urn 2" if where == 12 else "from urn 2 to urn 1"
    return {
        ENTRY: f"particle {particle} enters gate {where}",
        REVERSAL: f"gate {where} reverses {particle} particles",
        CROSSING1: f"particle {particle} crosses the middle line {urns}",
        CROSSING2: f"particle {particle} crosses the periodic line {urns}",
    }[int(kind)]


def table(work: study.Study, name: str, events: dict[str, object]) -> None:
    """Write the events forwards and back in the order of time."""
    turn = events["turn"]
    rows = [[number(time), text] for time, text in events["forth"]]
    rows.append([f"**{number(turn)}**", "**all velocities are turned**"])
    rows += [[number(turn + time), text] for time, text in events["back"]]
    work.table(name, ["t", "event"], rows)

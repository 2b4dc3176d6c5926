"""Runs from single states, forwards and back: events of a few particles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import postproc
from studies.common.event_log import CROSSING1, CROSSING2, ENTRY, REVERSAL, read_log
from studies.common.text import number

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from studies.common import study

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


def flown(
    work: study.Study, name: str, columns: Sequence[Floats], duration: float
) -> tuple[Path, list[Floats]]:
    """Run a few particles from a state; return the results file and the final state."""
    state = states_file(work.folder / f"{name}.txt", columns)
    changes = {
        "particles": {"number": len(columns[0]), "urn1_number": None, "initial_file": state},
        "gate": {"threshold": 1},
        "run": {"duration": duration},
    }
    file = work.run("reversal", name, changes, alone=True)
    return file, final_state(file)


def example(
    work: study.Study, name: str, states: Sequence[Sequence[float]], turn: float = EXAMPLE_TIME,
    ways: Sequence[str] = ("forth", "back"),
) -> dict[str, object]:  # fmt: skip
    """Run a few particles forwards and back; return the events as rows, and the final states.

    Back: from the end with all velocities reversed, as long again. Without it in `ways` only forth.
    """
    start = np.array(states)
    columns, events = list(start.T), {"turn": turn}
    for way in ways:
        file, (x, y, ux, uy) = flown(work, f"{name}_{way}", columns, turn)
        log = read_log(file)
        events[way] = [
            (time, words(kind, where, particle))
            for time, kind, where, particle in zip(
                log.time, log.kind, log.where, log.particle, strict=True
            )
        ]
        events[f"{way}_end"] = np.column_stack([x, y, ux, uy])
        columns = [x, y, -ux, -uy]
    if "back" not in events:
        return events
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

"""Legal values from all over their ranges, the ends among them, for every key and engine.

Each short run must end with exit 0 or 2 (or 3, when the time limit it is given has come), with the
checks at its end passed; where memory is short, with a message that says so.
"""

from __future__ import annotations

import random
import resource
import sys
from typing import TYPE_CHECKING, Any

from support.program import namelist, start

from .common import Outcome, command_line, ended
from .scene import ENGINES

if TYPE_CHECKING:
    from pathlib import Path

ADDRESS_SPACE = 4 << 30
LARGEST = 2**31 - 1
WALL_MINUTES = 0.05


def spread(choice: random.Random, around: float, decades: float) -> float:
    """Give a number near another one, or some decades away, or very many."""
    far = choice.choice([0.0, 1.0, decades, 300.0])
    try:
        value = around * 10.0 ** choice.uniform(-far, far)
    except OverflowError:
        value = 1.0e300
    return min(max(value, 1.0e-300), 1.0e300)


def width(choice: random.Random, radius: float, *, closed: bool) -> float:
    """Give a width below 2r: plain, tiny, nearly 2r, or none."""
    kind = choice.choice(["plain", "plain", "tiny", "wide", "none"])
    if kind == "none" and closed:
        return 0.0
    if kind == "tiny":
        return max(radius * 10.0 ** choice.uniform(-320, -3), 5e-324)
    if kind == "wide":
        return min(2 * radius * (1 - 10.0 ** choice.uniform(-17, -1)), 2 * radius * (1 - 2.0**-53))
    return radius * choice.uniform(0.01, 1.9)


def table(choice: random.Random) -> dict[str, Any]:
    """Draw the table."""
    radius = choice.choice([1.0, 1.0, spread(choice, 1.0, 6.0)])
    return {
        "shape": choice.choice(["'circuit'", "'circuit'", "'urn'"]),
        "urn_radius": radius,
        "channel1_width": width(choice, radius, closed=False),
        "channel1_length": choice.choice([radius, spread(choice, radius, 4.0)]),
        "channel2_width": width(choice, radius, closed=True),
        "channel2_length": choice.choice([radius, spread(choice, radius, 4.0)]),
    }


def length_of_run(choice: random.Random, radius: float) -> dict[str, Any]:
    """Draw how long it runs, in collisions or in time."""
    if choice.random() < 0.5:
        collisions = choice.choice([1, 2, 1000, 20000])
        return {
            "collisions": collisions,
            "transient_collisions": choice.choice([0, collisions // 2]),
        }
    duration = spread(choice, 10.0 * radius, 1.0)
    return {
        "duration": duration,
        "transient_duration": duration * choice.choice([0.0, 0.5, 1 - 1e-12]),
    }


def draw(choice: random.Random) -> dict[str, dict[str, Any]]:
    """Draw a namelist."""
    shape = table(choice)
    number = choice.choice([1, 2, 3, 10, 100, 2000])
    engine = choice.choice(list(ENGINES))
    shortest = min(shape["urn_radius"], shape["channel1_length"] / 2, shape["channel2_length"] / 2)
    run = {
        "engine": f"'{engine}'",
        "time_step": shortest * choice.choice([0.9, 0.01, 1e-6]),
        "start_time": choice.choice([0, 0, spread(choice, 1.0, 12.0)]),
        **length_of_run(choice, shape["urn_radius"]),
    }
    moments = sorted(
        {
            choice.choice([0.0, spread(choice, shape["urn_radius"], 2.0)])
            for _ in range(choice.randint(1, 4))
        }
    )
    output = {
        "file": "'out.h5'",
        "snapshot_times": ", ".join(map(str, moments)),
        "event_log": choice.choice([".true.", ".false."]),
        "final_state": choice.choice([".true.", ".false."]),
    }
    if choice.random() < 0.4:
        output["series_interval"] = spread(choice, shape["urn_radius"], 2.0)
    return {
        "table": shape,
        "particles": {
            "number": number,
            "urn1_number": choice.choice([0, number, choice.randint(0, number)]),
            "seed": choice.choice([0, 1, LARGEST, choice.randrange(LARGEST)]),
        },
        "gate": {"threshold": choice.choice([0, 1, number, LARGEST, choice.randint(0, number)])},
        "run": run,
        "output": output,
        "limits": {
            "wall_minutes": WALL_MINUTES,
            "checkpoint_minutes": choice.choice([0, 1e-300, 1e-3, 10, 1e300]),
        },
    }


def attack(folder: Path, choice: random.Random) -> Outcome:
    """Run one namelist, with --check before it, in little memory."""
    outcome = Outcome()
    groups = draw(choice)
    if groups["table"]["shape"] == "'urn'":
        groups["particles"]["urn1_number"] = groups["particles"]["number"]
    (folder / "case.nml").write_text(namelist(**groups), encoding="utf-8")
    codes = []
    for words in (["--check"], []):
        process = start(*words, "case.nml", folder=folder)
        resource.prlimit(process.pid, resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
        found = ended(process)
        codes.append(found.code)
        memory = found.code == 1 and "memory" in found.words
        if wrong := found.wrong({0, 1, 2, 3} if memory else {0, 2, 3}):
            outcome.findings.append(f"{' '.join(words)} {groups}: {wrong}")
    if 2 in codes and codes[0] != codes[1]:
        outcome.findings.append(f"--check gives {codes[0]}, the run {codes[1]}: {groups}")
    return outcome


if __name__ == "__main__":
    sys.exit(command_line("extremes", attack, __doc__ or ""))

"""Integrals over visits against random visits: python -m studies.accuracy.visits_check.

For each pair of widths the probe (`make probes`) draws visits to the disc of radius 1 in double
precision, with entries by the cosine law through both openings. Prints theory, sampled value, its
error and their difference in errors, for: the return probabilities a (through channel 2) and P11,
the mean stays t1 and t2, D (half the mean square change of the angle to the channel, from channel 1
back to it, over (w/r)^2), and the mean of the second Legendre polynomial of s after each way
through the urn (K). Arguments: number of visits for each pair (default 4000000), then pairs W1,W2.
"""

from __future__ import annotations

import math
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from postproc import cli
from postproc.theory import ports
from postproc.theory.circuit import Circuit
from postproc.theory.direction import transfer
from postproc.theory.visits import visits
from studies.common import study
from studies.common.numbers import mean_of
from studies.common.visits import visits_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

COUNT = 4_000_000
PAIRS = ((0.3, 0.01), (0.1, 0.05), (0.03, 0.003), (0.01, 0.01), (0.001, 0.0005), (0.003, 0.03))
BITS = 52  # of a random number


def drawn(width1: float, width2: float, count: int) -> dict[str, Floats]:
    """Return entries and exits of random visits.

    "into" and "out" are the opening, 0 or 1 for channels 1 and 2, "sine" and "out_sine" |s| at
    entry and exit, "stay" the time from chord to chord.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "visits.bin"
        words = ["visits", "disc", repr(width1), repr(width2), str(count), str(BITS), str(path)]
        program = study.ROOT / "build/bin/accuracy-real64"
        subprocess.run([program, *words], check=True, stdout=subprocess.DEVNULL)
        found = visits_of(path)
        found = np.array(found[:, found[0] != 0.0])  # but truncated ones, less than 1 in 1e6
    into, out = ((found[one] < 0.0).astype(int) for one in (6, 0))
    return {"into": into, "out": out, "sine": np.abs(found[7]), "out_sine": np.abs(found[3]),
            "stay": found[4]}  # fmt: skip


def _change(sine: Floats, other: Floats) -> Floats:
    """Return the change of the angle to the channel between entry and exit."""
    return np.abs(np.arcsin(sine) - np.arcsin(other))


def measured(found: dict[str, Floats], width1: float) -> dict[str, tuple[float, float]]:
    """Return means over random visits and their standard errors, by name."""
    into, out = found["into"], found["out"]
    second = math.sqrt(5.0) * (1.5 * np.stack([found["sine"], found["out_sine"]]) ** 2 - 0.5)
    product = second[0] * second[1]
    values = {
        "a": mean_of(out[into == 1] == 1),
        "P11": mean_of(out[into == 0] == 0),
        "t1": mean_of(found["stay"][into == 0]),
        "t2": mean_of(found["stay"][into == 1]),
    }
    back = (into == 0) & (out == 0)
    change = _change(found["sine"][back], found["out_sine"][back])
    values["D"] = mean_of(0.5 * (change / width1) ** 2)
    for one in (0, 1):
        for other in (0, 1):
            went = np.where(out[into == one] == other, product[into == one], 0.0)
            values[f"K{one + 1}{other + 1}"] = mean_of(went)
    return values


def expected(width1: float, width2: float) -> dict[str, float]:
    """Return the values of the theory for the same quantities."""
    port, urn = ports.disc(Circuit(1, 1, width1, width2)), transfer(1.0, width1, width2)
    back = visits(1.0, width1, width2)
    place, weight = back.nodes()
    leaving = np.abs(np.sin(place + back.shift + back.incidence))
    change = _change(np.abs(np.sin(place - back.incidence)), leaving)
    square = 0.5 * (change / width1) ** 2
    values = {
        "a": port.return_chance, "P11": 1.0 - port.across, "t1": port.stay1, "t2": port.stay2,
        "D": float(np.average(square[:, back.same], weights=weight[:, back.same])),
    }  # fmt: skip
    blocks = {f"K{one + 1}{other + 1}": float(urn.kernel[one, other, 1, 1])
              for one in (0, 1) for other in (0, 1)}  # fmt: skip
    return values | blocks


def pair(text: str) -> tuple[float, float]:
    """Return w and w' of a word W1,W2."""
    width1, width2 = map(float, text.split(","))
    return width1, width2


def main(arguments: list[str] | None = None) -> int:
    """Print a line for each integral and pair of widths."""
    options = study.parser(__file__, __doc__)
    options.add_argument("count", metavar="COUNT", nargs="?", type=cli.integer(1), default=COUNT)
    options.add_argument("pairs", metavar="W1,W2", nargs="*", type=pair, default=PAIRS)
    given = options.parse_args(arguments)
    count, pairs = given.count, given.pairs or PAIRS
    print("w w' integral theory drawn error errors_apart")
    for width1, width2 in pairs:
        theory = expected(width1, width2)
        for name, (mean, error) in measured(drawn(width1, width2, count), width1).items():
            apart = (theory[name] - mean) / error
            print(f"{width1:g} {width2:g} {name} {theory[name]:.6g} {mean:.6g} "
                  f"{error:.2g} {apart:+.1f}")  # fmt: skip
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

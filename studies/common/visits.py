"""Single visits to an urn in two precisions, compared with the same in quadruple precision.

The start of a visit determines its end, whose sensitivity grows with the length of the visit. To
first order, a change of the start by eps changes the direction at the end by K_u eps, the height by
K_y eps, and the length by K_l eps. The condition numbers are, with n the number of wall hits, s and
c the sine and cosine of the incidence, q and u position and direction at the end:
  K_u = 1 + 2 n/c,  K_y = (|q.u| K_u + r)/|u_x|,  K_l = 2 r (n |s|/c + 1) + r K_u + |u_y| K_y.
In a polygon walls are straight, so errors grow in proportion to the length l of the path; r is the
reach of the polygon:
  K_u = 1 + 2 n,  K_y = (l + r) K_u/|u_x|,  K_l = (l + r) K_u + |u_y| K_y.
The errors of a visit divided by its condition numbers are compared with the precision. Visits that
end at another wall hit than the reference are of two kinds: those that pass so close to a corner
that a change of the start by `TOLERANCE` rounding errors decides at which side of it they pass, and
those that are wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from postproc.theory import outlines
from studies.common.probes import EPSILON, Question, ask

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from studies.common.study import Study

    Floats = NDArray[np.float64]

BITS = {"real32": 23, "real64": 52}  # mantissa bits of the starts
TOLERANCE = {"disc": 8.0, "polygon": 128.0}  # for a tie at a corner, in changes of the start
BINS = 400  # of the histogram of errors, each a tenth of the decimal logarithm, from 1e-40 to 1
TOGETHER = 100_000  # visits that are compared together


def visits_of(path: Path) -> Floats:
    """Return a probe's visits, a column for each number (`probe_visits.f90`), from its file."""
    return np.memmap(path, np.float64, "r").reshape(-1, 9).T


def compared_visits(
    study: Study, name: str, urns: dict[str, tuple[str, ...]], count: float
) -> list[dict[str, Any]]:
    """Return visits in real32 and real64 compared with the same in real128: a row for each.

    urns : by name, the words of the probe for urn and widths.
    """
    asked, rows = [], []
    for at, (urn, words) in enumerate(urns.items()):
        for precision, bits in BITS.items():
            pair = [f"{name}-{at}-{precision}", f"{name}-{at}-{precision}-real128"]
            for one, built in zip(pair, (precision, "real128"), strict=True):
                told = ("visits", *words, str(int(count)), str(bits), f"{one}.bin")
                asked.append(Question(one, built, told, 36000))
            rows.append((urn, precision, words, pair))
    ask(study, asked, exact=False)
    return [
        {"urn": urn, "input": precision, "unit": EPSILON[precision]}
        | _comparison(words, BITS[precision],
                      *(visits_of(study.folder / f"{one}.bin") for one in pair))
        for urn, precision, words, pair in rows
    ]  # fmt: skip


def _comparison(words: tuple[str, ...], bits: int, own: Floats, truth: Floats) -> dict[str, Any]:
    """Return numbers of visits by their kind, and the greatest errors over condition."""
    rounded = np.float32 if bits < 24 else np.float64  # as the probe rounds its input
    widths = np.array(words[1:], float).astype(rounded).astype(float)
    shape = "disc" if words[0] == "disc" else "polygon"
    reach = 1.0
    if shape == "polygon":
        corners = np.array(words[0].split(","), float).astype(rounded).reshape(-1, 2).astype(float)
        middle = 0.5 * sum(outlines.ends(tuple(map(tuple, corners.tolist()))))
        reach = float(np.hypot(corners[:, 0] - middle, corners[:, 1]).max())
    found: dict[str, Any] = dict.fromkeys(("same", "corner", "wrong"), 0)
    found |= dict.fromkeys(("farthest", "worst", "greatest_condition"), 0.0)
    histogram = np.zeros(BINS, int)
    for begin in range(0, own.shape[1], TOGETHER):
        mine, true = (one[:, begin : begin + TOGETHER] for one in (own, truth))
        alike = (mine[0] == true[0]) & (mine[5] == true[5])
        other = np.flatnonzero(~alike)
        same = np.flatnonzero(alike & (true[0] != 0.0))
        k = _conditions(true[:, same], widths, reach, disc=shape == "disc")
        off = np.abs(true[1:5, same] - mine[1:5, same])
        error = np.max([off[0], np.hypot(off[1], off[2]), off[3]] / k, axis=0)
        if not np.all(error < 1.0):
            raise ArithmeticError("a visit is not a number, or wrong at all")
        distance = true[8, other]
        if shape == "disc":  # of the visit with fewer wall hits
            first = np.where(mine[5, other] < true[5, other], mine[:, other], true[:, other])
            half = 0.5 * np.where(first[0] > 0.0, *widths)
            distance = (half - np.abs(first[1])) / _conditions(first, widths, reach, disc=True)[0]
        distance = distance / 0.5 ** (bits + 1)
        near = int(np.sum(distance <= TOLERANCE[shape]))
        for key, number in (("same", same.size), ("corner", near), ("wrong", other.size - near)):
            found[key] += number
        for key, values in (("farthest", distance), ("worst", error), ("greatest_condition", k)):
            found[key] = max(found[key], float(np.max(values, initial=0.0)))
        place = BINS - 1 + np.floor(10.0 * np.log10(np.maximum(error, 1e-37))).astype(int)
        histogram += np.bincount(np.maximum(place, 0), minlength=BINS)
    return {"visits": own.shape[1], "channel1_width": widths[0], "channel2_width": widths[1],
            **found, "histogram": histogram.tolist()}  # fmt: skip


def _conditions(visit: Floats, widths: Floats, reach: float, *, disc: bool) -> Floats:
    """Return the condition numbers K_y, K_u, K_l at the ends of visits, shape (3, visit)."""
    side, y, across, up, length, hits = visit[:6]
    if not disc:
        turned = 1.0 + 2.0 * hits
        place = (length + reach) * turned
        return np.array([place / across, turned, place + np.abs(up) * place / across])
    chords = np.sqrt(1.0 - 0.25 * widths**2)
    x, ux = np.where(side > 0.0, chords[0], -chords[1]), side * across
    sine = x * up - y * ux
    cosine = np.sqrt(np.maximum((1.0 - sine) * (1.0 + sine), 1e-60))
    turned = 1.0 + 2.0 * hits / cosine
    height = (np.abs(x * ux + y * up) * turned + 1.0) / across
    lasting = 2.0 * (hits * np.abs(sine) / cosine + 1.0) + turned + np.abs(up) * height
    return np.array([height, turned, lasting])

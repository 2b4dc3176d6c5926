"""Experiments of the Lorentz circuit: scatterers in channel 2, current over chi.

Runs are made in build/lorentz/quick, or full (some minutes of one core), and not repeated if they
are complete. Writes numbers to lorentz.json, tables to CSV files, the picture to lorentz.png.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

import postproc
from postproc.figures import style
from studies.common import study
from studies.common.geometry import lattice, urn_area
from studies.common.numbers import bars, said, with_errors

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import xarray as xr
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Rows = list[dict[str, float]]

WIDTH = 0.2  # of channel 2
NUMBER, MANY = 1000, 4000
THRESHOLD = 7
RADII = (0.0, 0.005, 0.01, 0.0125, 0.015, 0.0175, 0.02, 0.03, 0.04)
COLUMNS = (0, 1, 2, 4, 6, 8)
WIDTHS = (0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08)
THRESHOLDS = (3, 5, 6, 7, 8, 9, 11, 13, 14)
FREE_RADII = (0.0, 0.02, 0.04)
STARTS = (0.5, 1.0)
# Runs close to the transition: radii by N, all at the same T/N.
CLOSE = {
    NUMBER: (0.012, 0.013, 0.014, 0.015, 0.016, 0.017, 0.018),
    MANY: (0.008, 0.009, 0.010, 0.011, 0.012, 0.013, 0.014),
}
LONG = 8.0  # factor of the duration, and of the transient
APART = 20.0  # time between two records
HALFWAY, BETWEEN = 0.3, (0.2, 0.5)  # chi between homogeneous and polarised


class Runs:
    """Runs of one kind, in a study's folder."""

    def __init__(self, work: study.Study, replicas: int, duration: float) -> None:
        """Store the study, the number of replicas and the duration."""
        self.work, self.replicas, self.duration = work, replicas, duration

    def rows(self, name: str, scan: dict[str, object], **table: object) -> Rows:
        """Run a scan; return a row for each of its points."""
        groups: dict[str, dict[str, object]] = {
            "table": {"channel2_width": WIDTH, **table},
            "particles": {"number": NUMBER},
            "gate": {} if "threshold" in scan else {"threshold": THRESHOLD},
            "run": {"duration": 1.5 * self.duration, "transient_duration": 0.5 * self.duration},
            "scan": {"replicas": self.replicas, **scan},
        }
        return [self._row(one) for one in points(self.work.run(groups, name))]

    def close_rows(self, number: int, radius: float) -> Rows:
        """Make long runs from both starts; return chi and Binder's cumulant of each."""
        groups: dict[str, dict[str, object]] = {
            "table": {"channel2_width": WIDTH, "scatterers": lattice(6, radius)},
            "particles": {"number": number},
            "gate": {"threshold": THRESHOLD * number // NUMBER},
            "run": {"duration": 1.5 * LONG * self.duration,
                    "transient_duration": 0.5 * LONG * self.duration},
            "scan": {"replicas": max(self.replicas // 2, 2), "urn1_fraction": list(STARTS)},
            "output": {"series_interval": APART},
        }  # fmt: skip
        made = self.work.run(groups, f"close_{number}_{radius:g}")
        found = []
        for start, whole, looks in zip(STARTS, points(made), points(made, "series"), strict=True):
            spread = 2.0 * looks.urn1_number.to_numpy() / number - 1.0
            late = spread[:, looks.time.to_numpy() >= float(whole.transient_time.max())]
            binder, binder_error = cumulant(late)
            beyond = (np.abs(spread) > HALFWAY) if start == STARTS[0] else (
                np.abs(spread) < HALFWAY)  # fmt: skip
            low, high = BETWEEN
            found.append({
                **with_errors(chi=whole.chi.to_numpy()),
                "number": number, "radius": radius, "urn1_number": start * number,
                "binder": binder, "binder_error": binder_error,
                "stay": int((~beyond.any(axis=1)).sum()), "runs": len(spread),
                "between": float(((np.abs(late) > low) & (np.abs(late) < high)).mean()),
            })  # fmt: skip
        return found

    def _row(self, point: xr.Dataset) -> dict[str, float]:
        """Return the averages of a point, with standard errors over its replicas."""
        row = {name: float(point[name])
               for name in ("threshold", "channel2_width", "urn1_number")}  # fmt: skip
        chi, current = point.chi.to_numpy(), point.polarised_current.to_numpy()
        # Conductance, over that of a straight channel of this width and well mixed urns.
        width = row["channel2_width"]
        ratio = current / (chi * NUMBER * well_mixed(width, width))
        row |= with_errors(chi=chi, polarised_current=current, conductance=ratio)
        # Variance of the net crossings over replicas, per particle and unit time.
        net = point.current2.to_numpy()
        row["noise"] = float(net.var(ddof=1) * self.duration / NUMBER)
        row["noise_error"] = row["noise"] * math.sqrt(2.0 / (net.size - 1))
        return row


def points(path: Path, group: str | None = None) -> Iterator[xr.Dataset]:
    """Yield the results of each point of a scan, with the dimension replica."""
    data = postproc.open_results(path, group=group)
    axes = [name for name in data.dims if name not in ("replica", "time", "urn", "gate")]
    for place in itertools.product(*(range(data.sizes[name]) for name in axes)):
        yield data.isel(dict(zip(axes, place, strict=True)))


def well_mixed(width: float, channel2_width: float = WIDTH) -> float:
    """Return the conductance of a straight channel of a width between well mixed urns.

    `channel2_width` is that of the other opening of the urns, whose radius is 1.
    """
    return width / (math.pi * urn_area(channel2_width))


def cumulant(spread: NDArray[np.float64]) -> tuple[float, float]:
    """Return 1 - <m^4>/(3 <m^2>^2) of m, shape (replica, record), and its error by jackknife.

    It is 0 if m is Gaussian about 0, and 2/3 if m is m0 or -m0. If states m = 0 and m0 alternate,
    at a transition that is not continuous, it is below 0.
    """
    second, fourth = (spread**2).mean(axis=1), (spread**4).mean(axis=1)
    count = second.size
    left_out = 1.0 - (fourth.sum() - fourth) / (count - 1) / (
        3.0 * ((second.sum() - second) / (count - 1)) ** 2
    )
    error = math.sqrt((count - 1) * left_out.var())
    return float(1.0 - fourth.mean() / (3.0 * second.mean() ** 2)), error


def measure(work: study.Study, replicas: int, duration: float) -> dict[str, Rows]:
    """Make all runs; return their rows."""
    runs = Runs(work, replicas, duration)
    both = {"urn1_fraction": list(STARTS)}
    found: dict[str, Rows] = {"radius": [], "columns": [], "free": []}
    for radius in RADII:
        discs = {"scatterers": lattice(6, radius)} if radius else {}
        rows = runs.rows(f"radius_{radius:g}", both, **discs)
        found["radius"] += [{"radius": radius} | row for row in rows]
    for columns in COLUMNS:
        discs = {"scatterers": lattice(columns, 0.04)} if columns else {}
        rows = runs.rows(f"columns_{columns}", both, **discs)
        found["columns"] += [{"columns": columns} | row for row in rows]
    found["straight"] = runs.rows("straight", {"channel2_width": list(WIDTHS)} | both)
    polarised = {"threshold": list(THRESHOLDS), "urn1_fraction": [1.0]}
    found["ohm"] = runs.rows("ohm", polarised, scatterers=lattice(6, 0.015))
    found["ohm_straight"] = runs.rows("ohm_straight", polarised, channel2_width=0.06)
    for radius in FREE_RADII:
        discs = {"scatterers": lattice(6, radius)} if radius else {}
        scan = {"threshold": [NUMBER], "replicas": 4 * replicas}
        chance = nyquist(found["radius"], radius)
        found["free"] += [{"radius": radius, "nyquist": chance} | row
                          for row in runs.rows(f"free_{radius:g}", scan, **discs)]  # fmt: skip
    found["close"] = [row for number, radii in CLOSE.items() for radius in radii
                      for row in runs.close_rows(number, radius)]  # fmt: skip
    return found


def nyquist(rows: Rows, radius: float) -> float:
    """Return the variance of the net crossings for urns and a channel without memory.

    Two conductors in a ring at equilibrium: 2 (N/2) g1 g2/(g1 + g2), for one particle. Without
    scatterers both conduct as straight channels at well mixed urns do.
    """
    rates = [well_mixed(width) for width in (0.3, WIDTH)]
    if radius:
        rates[1] *= next(row["conductance"] for row in reversed(rows) if row["radius"] == radius)
    return rates[0] * rates[1] / sum(rates)


def _from(rows: Rows, start: float, number: int = NUMBER) -> Rows:
    return [row for row in rows if row.get("number", NUMBER) == number
            and row["urn1_number"] == start * number]  # fmt: skip


def figure(found: dict[str, Rows]) -> Figure:
    """Return chi over radius (both N), number and conductance, and current over chi."""
    made = style.figure(style.PAGE, 5.4)
    (by_radius, by_columns), (ohm, collapse) = made.subplots(2, 2)
    looks = (
        {"marker": "o", "ls": "-", "color": style.BLUE, "label": "from equal urns"},
        {"marker": "s", "ls": "--", "mfc": "none", "color": style.VERMILION,
         "label": "from one full urn"},
    )  # fmt: skip
    more = (
        {"marker": "^", "ls": "-", "color": style.GREEN, "label": f"$N = {MANY}$, equal urns"},
        {"marker": "D", "ls": "--", "mfc": "none", "color": style.PURPLE,
         "label": f"$N = {MANY}$, one full urn"},
    )  # fmt: skip
    for start, look, other in zip(STARTS, looks, more, strict=True):
        bars(by_radius, _from(found["radius"], start), "radius", "chi", capsize=1.5, **look)
        bars(by_columns, _from(found["columns"], start), "columns", "chi", capsize=1.5, **look)
        bars(by_radius, _from(found["close"], start, MANY), "radius", "chi", capsize=1.5, **other)
    by_radius.set(xlabel="radius of 15 scatterers", ylabel=r"$\chi$")
    by_columns.set(xlabel="columns of scatterers of radius 0.04", ylabel=r"$\chi$")
    by_radius.legend(loc="lower right", fontsize=6.5)
    for name, colour, label in (
        ("ohm", style.BLUE, "scatterers of radius 0.015, $w' = 0.2$"),
        ("ohm_straight", style.GREEN, "none, $w' = 0.06$"),
    ):
        look = {"marker": "o", "ls": "none", "color": colour, "label": label}
        bars(ohm, found[name], "chi", "polarised_current", capsize=1.5, **look)
    ohm.set(xlabel=r"$\chi$", ylabel="net current (per unit time)", xlim=(0, 1), ylim=(0, None))
    ohm.legend()
    for name, colour, label in (
        ("radius", style.BLUE, "scatterers of growing radius"),
        ("columns", style.ORANGE, "more and more of them"),
        ("straight", style.GREEN, "none, narrower channel"),
    ):
        look = {"marker": "o", "ls": "none", "color": colour, "label": label}
        rows = [row | {"width": row["conductance"] * row["channel2_width"]}
                for row in _from(found[name], 1.0) if row["chi"] > 0.1]  # fmt: skip
        bars(collapse, rows, "width", "chi", capsize=1.5, **look)
    collapse.set(xlabel="width of a straight channel that conducts as well", ylabel=r"$\chi$")
    collapse.legend()
    return made


def tables(work: study.Study, found: dict[str, Rows]) -> None:
    """Write the tables of the page."""
    chi, conductance = ("chi", 3), ("conductance", 3)
    work.table(
        "ohm", ["T", "chi, discs", "conductance, discs", "chi, straight", "conductance, straight"],
        [[f"{discs['threshold']:g}", *(said(row, *one) for row in (discs, straight)
                                       for one in (chi, conductance))]
         for discs, straight in zip(found["ohm"], found["ohm_straight"], strict=True)],
    )  # fmt: skip
    for name, head in (("radius", "radius"), ("columns", "columns of radius 0.04")):
        work.table(
            name, [head, "chi, from equal urns", "chi, from one full urn", "conductance"],
            [[f"{equal[name]:g}", said(equal, "chi", 4), said(full, "chi", 4),
              said(full, *conductance)]
             for equal, full in zip(found[name][::2], found[name][1::2], strict=True)],
        )  # fmt: skip
    work.table(
        "circulation",
        ["discs of radius", "scatter of the net current, in what it would be without memory"],
        [[f"{row['radius']:g}", f"{row['noise'] / row['nyquist']:.1f} ± "
          f"{row['noise_error'] / row['nyquist']:.1f}"] for row in found["free"]],
    )  # fmt: skip
    head = ["N", "radius", "chi, from equal urns", "chi, from one full urn", "cumulant, equal",
            "cumulant, full", "stay, equal", "stay, full", "time in between"]  # fmt: skip
    rows = []
    for equal, full in zip(found["close"][::2], found["close"][1::2], strict=True):
        rows.append([
            f"{equal['number']:g}", f"{equal['radius']:g}",
            *(said(row, name, digits) for name, digits in (("chi", 3), ("binder", 2))
              for row in (equal, full)),
            *(f"{row['stay']:g} of {row['runs']:g}" for row in (equal, full)),
            f"{50.0 * (equal['between'] + full['between']):.1f} %",
        ])  # fmt: skip
    work.table("close", head, rows)


def run(work: study.Study) -> None:
    """Make the runs; store numbers, write tables, draw `lorentz`."""
    found = measure(work, int(work.pick(4, 16)), 2000.0)
    work.keep("lorentz", found)
    tables(work, found)
    work.draw(figure(found), "lorentz")


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))

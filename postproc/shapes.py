"""Makes the experiments of other urns: disc, square and hexagons of one area, openings alike.

Runs are made in build/shapes (minutes of one core), and not repeated where they are complete.
Numbers go to shapes.json, the picture to shapes.png and shapes.pdf.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from postproc import cli, running
from postproc.accuracy.events import CROSSING2, read_log, stories
from postproc.accuracy.experiments import (
    after_channel2,
    autocorrelations,
    entries_of,
    mean_of_groups,
)
from postproc.figures import style
from postproc.reading.results import Results
from postproc.theory import outlines
from postproc.theory.circuit import Circuit
from postproc.theory.renewal import RENEWAL
from postproc.theory.states import stable_state

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Row = dict[str, float]
    Rows = list[Row]
    Found = dict[str, dict[str, Rows]]

NUMBER = 1000
MANY = 10000  # where particles are independent: those in rational polygons keep what they are
WIDTH = 0.01  # of channel 2
THRESHOLDS = (1, 2, 3, 5, 7, 9, 11, 13, 15, 17, 20, 24)
PASSAGES = (0.01, 0.05)  # widths of channel 2 at which returns are counted
LAGS = (1, 2, 5, 10, 20, 40, 80)  # visits
DISC, SQUARE, REGULAR, IRRATIONAL = "disc", "square", "regular hexagon", "crooked hexagon"
LOOKS = {
    DISC: ("o", style.BLUE), SQUARE: ("s", style.VERMILION), REGULAR: ("h", style.ORANGE),
    IRRATIONAL: ("^", style.GREEN),
}  # fmt: skip


def tables(width: float) -> dict[str, dict[str, object]]:
    """Return the keys of `&table` by shape: all urns have the area of the disc of radius 1."""
    area = float(Circuit(NUMBER, 1, channel2_width=width).urn_area)
    stretch = math.sqrt(area / outlines.area(outlines.CROOKED))
    radii = {sides: math.sqrt(area / outlines.area(outlines.regular(sides, 1.0)))
             for sides in (4, 6)}  # fmt: skip
    polygon = {"urn_shape": "polygon"}
    return {
        DISC: {},
        SQUARE: polygon | {"urn_sides": 4, "urn_radius": radii[4]},
        REGULAR: polygon | {"urn_sides": 6, "urn_radius": radii[6]},
        IRRATIONAL: polygon
        | {"urn_vertices": [stretch * one for xy in outlines.CROOKED for one in xy]},
    }


class Job:
    """Runs in a folder; all their times are multiples of `duration`."""

    def __init__(self, folder: Path, replicas: int, duration: float) -> None:
        """Keep where, how many, how long."""
        self.folder, self.replicas, self.duration = folder, replicas, duration

    def run(self, name: str, **groups: dict[str, object]) -> Path:
        """Make a run; return its results."""
        output = {**groups.get("output", {}), "file": f"{name.replace(' ', '_')}.h5"}
        given = {"particles": {"number": NUMBER}, **groups, "output": output}
        return running.run(given, folder=self.folder, quiet=True)

    def states(self, shape: str, fraction: float, transients: float) -> Rows:
        """Return chi and current over T, with standard errors over replicas."""
        transient = transients * self.duration
        made = self.run(
            f"{shape} {fraction:g} {transients:g}",
            table={"channel2_width": WIDTH, **tables(WIDTH)[shape]},
            run={"duration": transient + self.duration, "transient_duration": transient},
            scan={"threshold": list(THRESHOLDS), "replicas": self.replicas,
                  "urn1_fraction": [fraction]},
        )  # fmt: skip
        with Results(made) as results:
            rows = []
            for point in range(results.points):
                row = {"threshold": float(results.value("threshold")[point])}
                for name in ("chi", "polarised_current"):
                    row[name], row[f"{name}_error"] = mean_of_groups(results.value(name)[point])
                rows.append(row)
        return rows

    def returns(self, shape: str) -> Rows:
        """Return how often a particle leaves through channel 2, through which it came."""
        rows = []
        for width in PASSAGES:
            made = self.run(
                f"returns {shape} {width:g}",
                table={"channel2_width": width, **tables(width)[shape]},
                particles={"number": MANY}, gate={"threshold": MANY},
                run={"duration": 4.0 * self.duration}, output={"event_log": True},
            )  # fmt: skip
            with Results(made) as results:
                circuit, told = results.circuit(0), stories(read_log(results))
            share, stay = (mean_of_groups(one) for one in after_channel2(told, circuit))
            chance = width / (width + float(circuit.channel1_width))
            count = int(np.count_nonzero((told.kind == CROSSING2) & (told.after >= 0)))
            rows.append({
                "channel2_width": width, "visits": count, "chance": chance,
                "return": share[0], "return_error": share[1], "stay": stay[0],
                "stay_error": stay[1], "binomial": math.sqrt(share[0] * (1.0 - share[0]) / count),
            })  # fmt: skip
        return rows

    def directions(self, shape: str) -> Rows:
        """Return the autocorrelation of cos(theta) from visit to visit, of one urn without gate."""
        duration = 40.0 * self.duration
        made = self.run(
            f"directions {shape}", table={"shape": "urn", **tables(0.0)[shape]},
            gate={"threshold": NUMBER}, run={"duration": duration}, output={"event_log": True},
        )  # fmt: skip
        with Results(made) as results:
            seen = entries_of(stories(read_log(results)))
        values = autocorrelations(*seen, np.array(LAGS), 0.5 * duration)
        rows = []
        for lag, column in zip(LAGS, values.T, strict=True):
            mean, error = mean_of_groups(column)
            rows.append({"lag": lag, "correlation": mean, "correlation_error": error})
        return rows


def measure(folder: Path, replicas: int, duration: float) -> Found:
    """Make all runs; return rows by kind and shape."""
    job = Job(folder, replicas, duration)
    return {
        "states": {shape: job.states(shape, 1.0, 2.0) for shape in LOOKS},
        "shorter": {shape: job.states(shape, 1.0, 1.0) for shape in LOOKS},
        "equal": {shape: job.states(shape, 0.5, 2.0) for shape in LOOKS},
        "returns": {shape: job.returns(shape) for shape in LOOKS},
        "directions": {shape: job.directions(shape) for shape in LOOKS},
    }


def well_mixed() -> Rows:
    """Return chi and current of well mixed urns of this area behind renewal gates, over T."""
    rows = []
    for threshold in range(THRESHOLDS[0], THRESHOLDS[-1] + 1):
        circuit = Circuit(NUMBER, threshold, channel2_width=WIDTH, gate=RENEWAL, occupation=True)
        state = stable_state(circuit)
        rows.append({
            "threshold": threshold, "chi": state.mass_spread if state else 0.0,
            "polarised_current": abs(state.net_current) if state else 0.0,
        })  # fmt: skip
    return rows


def _bars(axes: Axes, by_shape: dict[str, Rows], across: str, up: str, line: str = "none") -> None:
    for shape, (marker, colour) in LOOKS.items():
        rows = by_shape[shape]
        x, y, error = ([row[name] for row in rows] for name in (across, up, f"{up}_error"))
        axes.errorbar(x, y, error, marker=marker, ms=3.5, mfc="none", color=colour, ls=line,
                      lw=0.8, label=shape)  # fmt: skip


def figure(found: Found) -> Figure:
    """Return chi and current over T, memory of directions over visits, and returns over chance."""
    made = style.figure(style.PAGE, 4.8)
    (spread, current), (memory, back) = made.subplots(2, 2)
    mixed = well_mixed()
    for axes, name, label in (
        (spread, "chi", r"$\chi$"), (current, "polarised_current", "net current (per unit time)"),
    ):  # fmt: skip
        axes.plot([row["threshold"] for row in mixed], [row[name] for row in mixed],
                  color=style.GREY, lw=0.8, label="well mixed")  # fmt: skip
        _bars(axes, found["states"], "threshold", name)
        axes.set(xlabel="$T$", ylabel=label, ylim=(0, None))
    spread.legend(loc="center", bbox_to_anchor=(0.36, 0.45))
    _bars(memory, found["directions"], "lag", "correlation", "-")
    memory.axhline(0.0, color=style.GREY, lw=0.6)
    memory.set(xscale="log", xlabel="visits", ylabel=r"autocorrelation of $\cos\theta$")
    shares = {shape: [{"width": row["channel2_width"], "share": row["return"] / row["chance"],
                       "share_error": row["return_error"] / row["chance"]} for row in rows]
              for shape, rows in found["returns"].items()}  # fmt: skip
    _bars(back, shares, "width", "share")
    back.axhline(1.0, color=style.GREY, lw=0.8)
    back.set(xlabel="width of channel 2", ylabel="returns over those by chance", ylim=(0, None),
             xlim=(0.0, None))  # fmt: skip
    return made


def _number(row: Row, name: str, digits: int) -> str:
    return f"{row[name]:.{digits}f} ± {row[f'{name}_error']:.{digits}f}"


def _print(heads: list[str], rows: list[list[str]]) -> None:
    lines = [heads, ["---"] * len(heads), *rows]
    print("\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n")


def tell(found: Found) -> None:
    """Print all numbers as tables of Markdown."""
    mixed = {row["threshold"]: row for row in well_mixed()}
    for kind in ("states", "shorter", "equal"):
        for name in ("chi", "polarised_current"):
            print(f"{kind}, {name}\n")
            columns = found[kind].values()
            _print(["T", *LOOKS, "well mixed"], [
                [f"{rows[0]['threshold']:g}", *(_number(row, name, 4) for row in rows),
                 f"{mixed[rows[0]['threshold']][name]:.4f}"]
                for rows in zip(*columns, strict=True)
            ])  # fmt: skip
    print("returns through channel 2\n")
    _print(["shape", "w'", "visits", "a", "binomial error", "over chance", "mean stay"], [
        [shape, f"{row['channel2_width']:g}", f"{row['visits']}", _number(row, "return", 5),
         f"{row['binomial']:.5f}", f"{row['return'] / row['chance']:.3f}", _number(row, "stay", 2)]
        for shape, rows in found["returns"].items() for row in rows
    ])  # fmt: skip
    print("autocorrelation of cos(theta) after so many visits\n")
    _print(["visits", *LOOKS], [
        [f"{rows[0]['lag']}", *(_number(row, "correlation", 3) for row in rows)]
        for rows in zip(*found["directions"].values(), strict=True)
    ])  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Make the runs, print the tables, write numbers and picture."""
    given = cli.parser_of_runs("shapes", __doc__, replicas=8).parse_args(arguments)
    folder = cli.output_folder(given.output)
    found = measure(folder, given.replicas, given.duration)
    (folder / "shapes.json").write_text(json.dumps(cli.finite(found), indent=1) + "\n", "utf-8")
    tell(found)
    style.save(figure(found), folder, "shapes")
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))

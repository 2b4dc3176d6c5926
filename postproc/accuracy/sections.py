"""What the page says of the parts that follow single trajectories, from their kept numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from postproc.accuracy.ladder_map_page import ladder_map
from postproc.study.text import measured, number, table

if TYPE_CHECKING:
    from collections.abc import Callable

AT = 10.0  # time at which trajectories are compared
EXACT = ("excursion", "collision", "synchronous")


def trajectories(numbers: dict) -> str:
    """Return chart one in words: cost and error of a trajectory, growth of errors, horizons."""
    lines = []
    for row in numbers["rows"]:
        if row["gate"] != "free" or row["engine"] not in EXACT:
            continue
        name = f"{row['engine']} {row['precision']}"
        error = row["median"][row["time"].index(AT)]
        lines.append(
            [
                f"`{row['engine']}`", row["precision"],
                number(row["seconds_per_particle_time"], 2),
                "reference" if name == "collision real128" else number(error, 2),
                number(numbers["fitted"].get(name), 3), number(numbers["horizon"].get(name), 3),
                number(numbers["horizon_gated"].get(name), 3),
            ]
        )  # fmt: skip
    head = [
        "engine", "precision", "seconds per particle and time unit", "median error at t = 10",
        "lambda", "horizon, free", "horizon, T = 7",
    ]  # fmt: skip
    order = numbers["order"]["free"]
    predicted = ", ".join(
        f"{number(time, 3)} ({precision})"
        for precision, time in numbers["predicted_horizon"].items()
    )
    growth = measured(numbers["lyapunov"], numbers["lyapunov_error"])
    return f"""{numbers["number"]} particles fly from one file; their places and the times of their events are held
against `collision` in quadruple precision.

![Error of places and of event times against cost](accuracy_trajectory_cost.png)

{table(head, lines)}

- **A fixed step** is of first order: {number(order["place"], 3)} in places, {number(order["event_time"], 3)} in
event times. Halving it costs twice as much and gains one bit; `excursion` has all bits for less than its coarsest
step. Some particles it sends astray
  altogether, past a corner on the wrong side; their share falls as the step to the power
{number(order["worst"], 2)}. In single precision small steps make it worse: their rounding adds up.
- **Errors grow** as exp(lambda t). The tangent map of the free billiard gives lambda = {growth} directly
({number(numbers["lyapunov_same_start"], 3)} over the time that these particles fly); the column lambda is fitted
to the errors themselves. The picture has lines of both rates: the errors follow the second, that of the same
{numbers["number"]} particles.
- **The horizon** of a precision is where the median error passes 0.1: half of the particles have taken another way.
Half a unit in the last place grows to that in
{predicted}. With gates it is nearer, since one particle that goes astray makes a gate fire, or not, for all the
others.

![Growth of errors, and order of the fixed step](accuracy_trajectory_growth.png)
"""  # noqa: E501 (a paragraph is a line)


def _cell(markdown: str, case: str, engine: str, precision: str) -> str:
    """Return a cell of the stability table: case by its first words."""
    current = ""
    for line in markdown.splitlines()[2:]:
        cells = [cell.strip() for cell in line.strip("| ").split(" | ")]
        if not line.startswith("|  |"):
            current, *cells = cells
        if current.startswith(case) and cells[0].strip("` |") == engine:
            return cells[1 + ("real32", "real64", "real128").index(precision)]
    return "-"


def verdict(numbers: dict) -> str:
    """Return what the stability table says, in five lines."""
    markdown, summary = numbers["markdown"], numbers["summary"]
    good = {name: row for name, row in summary.items() if not name.endswith("real32")}
    lost = sum(row["lost"] + row["not_a_number"] for row in good.values())
    single = sum(row["lost"] for name, row in summary.items() if name.endswith("real32"))
    hits = sum(row["hits"] for row in summary.values())

    def cell(case: str, engine: str = "excursion", precision: str = "real64") -> str:
        return _cell(markdown, case, engine, precision)

    return f"""**Verdict**, in five lines:

1. Lost or not a number, in all odd cases and {number(hits, 2)} hits of long runs: {lost} in double and quadruple
precision, {single} in single.
2. Corner shots in double precision are wrong within {cell("beside a corner").split("within ")[-1]} of the corner
(`excursion`), which is the rounding of a place; `timestep` is wrong within
{cell("beside a corner", "timestep").split("within ")[-1]}.
3. Grazing orbits, error of the exit time down to the smallest angle that was got: `excursion`
{cell("whispering")}, `collision` {cell("whispering", "collision")}.
4. Orders in memory that matter, of 96: {cell("four entries")}. Events move by {cell("clock")} where the clock
shows 1e12.
5. Given up are grazing orbits by `collision` and `synchronous`, which are too slow for them (in single precision
their angle sticks), and digits by `timestep`, which has its step's error in all of it."""  # noqa: E501


def stability(numbers: dict) -> str:
    """Return the stability table with what it sums up to."""
    good = {name: row for name, row in numbers["summary"].items() if not name.endswith("real32")}
    single = {name: row for name, row in numbers["summary"].items() if name.endswith("real32")}
    lost, odd = (sum(row[key] for row in good.values()) for key in ("lost", "not_a_number"))
    lost_single = sum(row["lost"] for row in single.values())
    trapped = sum(row["trapped"] for row in good.values())
    visits = table(
        ["`excursion`", "w", "visits", "worst error over condition", "other side of a corner"],
        [
            [
                row["input"], number(row["channel1_width"], 1), number(row["visits"], 2),
                number(row["worst"], 2), str(row["corner"]),
            ]
            for row in numbers["visits"]
        ],
    )  # fmt: skip
    return f"""One particle or a few are sent where methods fail. In double and quadruple precision {lost}
particles were lost and {odd} were not a number ({lost_single} lost in single precision); {trapped} orbits that
never end were counted as trapped, in place of hanging the run.

{verdict(numbers)}

"Too slow" or "stopped" is an engine that ran out of the time the table gives it, "stick" one whose angle is
rounded to zero, so that it takes the orbit for endless.

{numbers["markdown"].strip()}

Single visits to an urn, against quadruple precision from the same way in; the error of place, direction and time
is divided by the visit's own condition number. Where the opening is as
small as the rounding of a place on the wall, some visits end on the other side of a corner: no precision of that
size could tell.

{visits}

![Errors of single visits over their condition number](accuracy_visits.png)
"""  # noqa: E501 (a paragraph is a line)


def polygons(numbers: dict) -> str:
    """Return how exact single visits to polygons are."""
    lines = [
        [
            row["urn"], row["input"], number(row["visits"], 2), number(row["worst"], 2),
            number(row["greatest_condition"], 2), str(row["corner"]), number(row["farthest"], 2),
            str(row["wrong"]),
        ]
        for row in numbers["visits"]
    ]  # fmt: skip
    head = [
        "polygon", "`excursion`", "visits", "worst error over condition", "greatest condition",
        "other side of a corner", "within, in units of rounding", "wrong",
    ]  # fmt: skip
    handed_on = sum(row["handed_on"] for row in numbers["visits"])
    return f"""The same for [polygons](shapes.md), w = {number(numbers["visits"][0]["channel1_width"], 1)}. Walls are
straight, so the condition grows in proportion to the way and to the hits. A side that is met
again is looked for up to 64 epsilon behind a place, so visits that come closer to a corner than 128 times the rounding
of their way in, grown by the condition, may pass it on the other side; farther away they are wrong. {handed_on} were so
long that they were handed on in parts, and are left out.

{table(head, lines)}
"""  # noqa: E501 (a paragraph is a line)


def reversal(numbers: dict) -> str:
    """Return how far the free circuit finds the way back."""
    lines = []
    for name, time in numbers["horizon"].items():
        engine, precision = name.split()
        predicted = "-" if engine == "timestep" else number(
            numbers["predicted_horizon"][precision], 3
        )  # fmt: skip
        lines.append([f"`{engine}`", precision, predicted, number(time, 3)])
    return f"""Run for a time t, turn all velocities, run as long again: without gates everyone arrives where he
began, until rounding, grown by exp(lambda t), sends him another way (predicted as the horizons above, from the
tangent map's lambda = {number(numbers["lyapunov"], 3)}: the time in which half a unit in the
last place grows to 0.1). A fixed step is lost much sooner, since its errors are not rounding.

{table(["engine", "precision", "predicted", "half are astray after"], lines)}

![Distance from the start against the time of the turn](accuracy_reversal_free.png)
"""  # noqa: E501 (a paragraph is a line)


SECTIONS: dict[str, Callable[[dict], str]] = {
    "ladder_map": ladder_map,
    "trajectories": trajectories,
    "stability": stability,
    "polygons": polygons,
    "reversal": reversal,
}

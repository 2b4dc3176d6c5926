"""What the page says of the ladder over the map, from its kept numbers."""

from __future__ import annotations

from postproc.accuracy.ladder import QUANTITIES
from postproc.study.text import measured, number, percent, seconds, table

HEADS = {"chi": "chi", "current": "current over chi", "transition": "transition T"}
SHOWN = {"chi": lambda value: number(value, 2), "current": percent, "transition": percent}


def _error(one: dict, quantity: str) -> str:
    """Return a rung's error: a bound where none is seen, a star where errors cancel."""
    known = one["bias"] if one["seen"] else (one["bias"] ** 2 + one["bias_error"] ** 2) ** 0.5
    if quantity == "transition" and one["missing"]:
        return "none in reach"
    text = f"{'' if one['seen'] else '< '}{SHOWN[quantity](known)}{' *' if one['cancels'] else ''}"
    return f"{text} ({one['missing']} without)" if one["missing"] else text


def ladder_map(numbers: dict) -> str:
    """Return the ladder over the map: points, errors, the doubled transient, the Pareto line."""
    head = ["rung", "a point costs", *(f"error of {HEADS[name]}" for name in QUANTITIES)]
    rows = [
        [
            line["name"],
            seconds(line["chi"]["seconds"]),
            *(_error(line[name], name) for name in QUANTITIES),
        ]
        for line in numbers["rows"]
    ]
    widths = sorted({point[0] for point in numbers["points"]})
    places = ", ".join(
        f"{measured(value, error)} at w' = {width:g}"
        for width, value, error in zip(widths, *numbers["transitions"], strict=True)
    )
    twice = numbers["doubling"]
    away, near = numbers["transients"]
    chosen = [
        [
            f"{one['error']:g}",
            *(
                "none" if one[name][1] is None else f"{one[name][0]}, {seconds(one[name][1])}"
                for name in QUANTITIES
            ),
        ]
        for one in numbers["choice"]
    ]
    return f"""One point may flatter. So all rungs go to {len(numbers["points"])} points of the map, at w' =
{", ".join(f"{one:g}" for one in widths)}: three T well below each upper transition and five across it. chi and current
over chi are compared at the {numbers["polarised"]} of them that are polarised (chi > 0.3), so that an error of chi does
not hide one of the conductance. The transitions lie at T = {places}.

![Error over the map against processor time](accuracy_ladder_map.png)

Faint marks are of a rung that has no polarised state at some of the points ("without" in the table), a ring is where
errors cancel (the star in the table), an open mark with an arrow is a bound.

{table(head, rows)}

Errors are root mean squares over the points, of chi absolute and of the others relative, less what runs add by chance;
"<" is a bound where none is seen. A star marks errors that cancel: a rung that has all of its physics and more is
farther off. "Without" counts points at which the rung has no polarised state. `timestep 0.003` goes over the map in
full runs only.

**What a run costs.** Its transient is {number(away, 4)} time units, three relaxations of directions (25 r^4/w^3), and
{number(near, 4)} next to a transition, a wide margin: at w' = 0.01 runs found the same transition after 500 time units
as after 5000 ([experiment 5](experiments.md#5-the-transient-near-the-upper-transition)). All of it is charged, also to a
run that could begin at the answer. Is it enough? With twice the transient chi differs by {number(twice["root_mean_square"], 2)} standard
errors (root mean square over the {twice["points"]} points; one is chance), at most by
{number(abs(twice["worst"]), 2)}, at w' = {twice["worst_width"]:g}, T = {twice["worst_threshold"]}.
Currents settle later: at narrow channels even the reference's lack 1 to 2 %
([the age of a run](../studies/age_of_a_run/README.md)), so smaller errors of current over chi are not told apart.

The Pareto line is what can be had for the processor time of a point. Read from it, the cheapest rung that has an error:

{table(["error", *(HEADS[name] for name in QUANTITIES)], chosen)}
"""  # noqa: E501 (a paragraph is a line)

"""Single visits to polygons in single and double precision, against quadruple precision."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from postproc.theory import outlines
from studies.common.geometry import CROOKED
from studies.common.text import number
from studies.common.visits import compared_visits

if TYPE_CHECKING:
    from collections.abc import Sequence

    from postproc.theory.outlines import Outline
    from studies.common.study import Study

WIDTHS = ("0.3", "0.01")  # w, w'
# Vertical sides to the last digit of the highest precision.
POLYGONS: dict[str, Outline] = {
    "regular hexagon": tuple((round(x, 12), round(y, 12)) for x, y in outlines.regular(6, 1.0)),
    "crooked hexagon": CROOKED,
    "twelve sides, some reach in": (
        (1.0, -0.6), (1.0, 0.6), (1.4, 0.7), (1.3, 1.2), (-0.5, 1.1), (-0.6, 0.3), (-1.0, 0.9),
        (-1.2, 0.5), (-1.2, -0.5), (-0.3, -1.0), (0.2, -0.4), (0.7, -1.1),
    ),
}  # fmt: skip


def run(study: Study) -> None:
    """Run the probes, and store the errors of each precision for each polygon."""
    words = {
        urn: (",".join(repr(float(one)) for corner in outline for one in corner), *WIDTHS)
        for urn, outline in POLYGONS.items()
    }
    rows = compared_visits(study, "polygons", words, study.pick(1e5, 1e6))
    for row in rows:
        del row["histogram"]
    study.keep("polygons", {"visits": rows})
    table(study, rows)


def table(study: Study, rows: Sequence[dict[str, Any]]) -> None:
    """Write the table of the page."""
    head = ["polygon", "`excursion`", "visits", "worst error over condition", "greatest condition",
            "other side of a corner", "within, in units of rounding", "wrong"]  # fmt: skip
    study.table("polygons", head, [
        [row["urn"], row["input"], number(row["visits"], 2), number(row["worst"], 2),
         number(row["greatest_condition"], 2), str(row["corner"]), number(row["farthest"], 2),
         str(row["wrong"])]
        for row in rows
    ])  # fmt: skip

"""What can be seen of the entries of a legend."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

from matplotlib.offsetbox import DrawingArea

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend


def looks(legend: Legend) -> dict[str, str]:
    """Return what can be seen of each entry, by its label."""
    seen = ("color", "facecolor", "linestyle", "marker", "fillstyle", "markerfacecolor", "alpha",
            "markersize", "linewidth")  # fmt: skip
    return {
        text.get_text(): " ".join(
            str(known.get(name))
            for known in (part.properties() for part in box.get_children())
            for name in seen
        )
        for text, box in zip(legend.get_texts(), legend.findobj(DrawingArea), strict=True)
    }


def assert_looks_apart(made: Figure) -> None:
    """Hold that a figure has legends, no two entries of which look alike."""
    inside = [axes.get_legend() for axes in made.axes]
    legends = [*made.legends, *(one for one in inside if one is not None)]
    assert legends
    for legend in legends:
        for (one, look), (other, same) in combinations(looks(legend).items(), 2):
            assert look != same, f"{one} and {other} look alike"

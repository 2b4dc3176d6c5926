"""Common style of all pictures: sizes, colours for colour-blind readers, PNG and PDF.

What makes, changes or writes a picture does it within `settings`, a context and a decorator.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import re
import textwrap
from contextlib import contextmanager
from typing import TYPE_CHECKING

import matplotlib as mpl
import matplotlib.style
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import MaxNLocator

from postproc.cli import MARK, InputError, file_to_write, output_folder, replaced

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike

# Okabe and Ito's palette
BLACK = "#000000"
ORANGE = "#E69F00"
SKY = "#56B4E9"
GREEN = "#009E73"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
GREY = "#8C8C8C"
MOST_ENTRIES = 28  # of a legend above the panels
LONGEST_NAME = 200  # bytes, of the 255 of most file systems
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)

COLUMN = 3.4  # width of one column of the journal, inches
PAGE = 7.0  # width of both columns, inches
RESOLUTION = 200  # dots per inch of the PNG
ABOUT = {"png": {"Software": MARK}, "pdf": {"Creator": MARK, "CreationDate": None}}
TICKS = 0.12  # of their range, least distance between ticks at given values

SETTINGS = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "legend.fontsize": 8,
    "legend.frameon": False,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "lines.linewidth": 1.2,
    "lines.markersize": 4,
    "errorbar.capsize": 1.5,
    "axes.linewidth": 0.7,
    "image.cmap": "viridis",
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "battery",
    "mathtext.fontset": "dejavusans",
}

# it warns of the dates inside the fonts that matplotlib ships
logging.getLogger("fontTools").setLevel(logging.ERROR)


def settings() -> AbstractContextManager[None]:
    """Draw with this style alone, whatever matplotlibrc says; afterwards all is as before."""
    return mpl.style.context(["default", SETTINGS])


def ink() -> str:
    """Return the colour of text: black in `settings`, else as the user's axes have it."""
    return to_hex(mpl.rcParams["text.color"], keep_alpha=True)


def brief(value: float, digits: int = 4) -> str:
    """Return a whole number with all its digits, another one with some."""
    whole = float(value).is_integer() and abs(value) < 1e15
    return f"{value + 0.0:.0f}" if whole else f"{value:.{digits}g}"  # no -0


def look(at: int, marks: str) -> tuple[str, str]:
    """Return mark and colour of a series; with six marks those of the first 36 differ."""
    turn, place = divmod(at, len(CYCLE))
    return marks[(place + turn) % len(marks)], CYCLE[place]


def digits_apart(values: ArrayLike, least: int) -> int:
    """Return the fewest digits, not below `least`, at which different values look different."""
    different, digits = np.unique(values), least
    while digits < 17 and len({f"{one:.{digits}g}" for one in different}) < different.size:
        digits += 1
    return digits


def in_math(value: float, digits: int = 4) -> str:
    """Return `brief` for a formula, in which e would be a letter."""
    mantissa, exponential, power = brief(value, digits).partition("e")
    return f"{mantissa} \\times 10^{{{int(power)}}}" if exponential else mantissa


def figure(width: float = PAGE, height: float = 3.2) -> Figure:
    """Return an empty figure of that size in inches."""
    made = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(made)
    return made


def on_map(colour: str = BLACK, width: float = 1.2) -> dict[str, object]:
    """Return the style of a line that is visible on any colour of a map, and in a legend."""
    solid = {"dash_offset": 0.0, "dash_list": None}
    border = [Stroke(linewidth=width + 1.8, foreground="white", dashes=solid), Normal()]
    return {"color": colour, "lw": width, "path_effects": border}


def ticks_at(axes: Axes, values: Iterable[float]) -> None:
    """Put ticks of the horizontal axis at values, but at none that is too near to the last one."""
    known = sorted(values)
    kept = known[:1]
    for value in known[1:]:
        if value - kept[-1] > TICKS * (known[-1] - known[0]):
            kept.append(value)
    axes.set_xticks(kept)


def label_fraction(axes: Axes) -> None:
    """Label the horizontal axis T/N, with few enough ticks that they do not touch."""
    axes.set_xlabel("$T/N$")
    axes.xaxis.set_major_locator(MaxNLocator(5))


@contextmanager
def measured(made: Figure) -> Iterator[Figure]:
    """Give a figure the resolution of the PNG in a block: widths of letters depend on it."""
    resolution = made.dpi
    made.set_dpi(RESOLUTION)
    try:
        yield made
    finally:
        made.set_dpi(resolution)


def legend_above(
    made: Figure, handles: Sequence[Artist], labels: Sequence[str], columns: int, **look: object
) -> None:
    """Put a legend above the panels, in at most that many columns, so that it is not cut.

    One that leaves too little room for them is refused.
    """
    if len(labels) > MOST_ENTRIES:
        raise InputError(f"a figure has at most {MOST_ENTRIES} entries in its legend, here are "
                         f"{len(labels)}: choose, --select KEY=VALUE ...")  # fmt: skip
    with measured(made):
        _fitted_legend(made, handles, labels, columns, loc="outside upper center", **look)


def legend_below(axes: Axes, columns: int, **look: object) -> None:
    """Put a legend below the axes, in at most that many columns, not wider than they are."""
    place = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0)}
    _fitted_legend(axes, *axes.get_legend_handles_labels(), columns, **place, **look)


def _fitted_legend(
    owner: Figure | Axes, handles: Sequence[Artist], labels: Sequence[str], columns: int,
    **look: object,
) -> None:  # fmt: skip
    for count in range(columns, 0, -1):
        legend = owner.legend(handles, labels, ncols=count, **look)
        if legend.get_window_extent().width <= owner.bbox.width or count == 1:
            return
        legend.remove()


def in_lines(text: str, most: int) -> str:
    """Return text in lines of at most that many characters, broken after commas only."""
    kept = re.sub("(?<!,) ", "\xa0", text)
    lines = textwrap.fill(kept, most, break_long_words=False, break_on_hyphens=False)
    return lines.replace("\xa0", " ")


@settings()
def note(axes: Axes, text: str) -> None:
    """Write a small remark below the axes, on the right, e.g. that a run is partial."""
    if text:
        axes.figure.supxlabel(text, x=0.995, ha="right", fontsize=6.5, color=GREY)


@settings()
def save(made: Figure, folder: Path, name: str) -> list[Path]:
    """Write `name`.png and `name`.pdf into `folder`, print and return their paths.

    A name that is too long for a file ends with its digest.
    """
    output_folder(folder)
    if len(encoded := os.fsencode(name)) > LONGEST_NAME:
        digest = hashlib.sha256(encoded).hexdigest()[:8]
        name = f"{os.fsdecode(encoded[:LONGEST_NAME])}_{digest}"
    paths = [file_to_write(folder / f"{name}.{kind}", kind) for kind in ABOUT]
    made.draw_without_rendering()  # a layout changes ticks; the next one makes room for them
    for path, about in zip(paths, ABOUT.values(), strict=True):
        drawn = io.BytesIO()
        made.savefig(drawn, format=path.suffix[1:], dpi=RESOLUTION, metadata=about)
        with replaced(path) as half:
            half.write_bytes(drawn.getvalue())
        print(path)
    return paths

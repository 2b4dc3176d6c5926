"""A page about results."""

from __future__ import annotations

from typing import TYPE_CHECKING

from postproc import cli
from postproc.figures.theories import asked
from postproc.reading.grid import dataset_of
from postproc.reading.points import by_point, of_files, remark, say
from postproc.theory.models import defaults

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    import xarray as xr


def report(
    results: str | Path | xr.Dataset | Iterable[str | Path],
    file: str | Path | None = None,
    *,
    theory: str | Sequence[str] | None = None,
    verify: bool = False,
) -> Path:
    """Write one self-contained HTML page about results; return its path.

    Parameters
    ----------
    results
        A results file, several (`merge`), or a dataset of `open_results` or `merge`.
    file
        The page; None: in the current folder, with the name of the first results file.
    theory
        Names of theories, "window" (the paper's), "renewal" or "direction"; None: those that the
        figures draw.
    verify
        Whether to read files as a whole and check their digests.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    InputError
        There are no results, the page cannot be written, or Bokeh is not installed.

    Examples
    --------
    >>> print(report("map.h5", theory="window"))
    map.html
    """
    points = by_point(dataset_of(results, verify=verify))
    name = (of_files(points, "files") or ["results"])[0].rpartition("/")[2].removesuffix(".h5")
    path = cli.path_of(f"{name}.html" if file is None else file, "file")
    cli.file_to_write(path, "html")
    models = defaults(points["circuit"].values) if theory is None else asked(points, theory)
    page = cli.extra("report", "postproc.reporting.page").page
    text = page(points, {one.name: one for one in models})
    say(points, remark(points))
    cli.output_folder(path.parent)
    with cli.replaced(path) as half:
        half.write_text(text, encoding="utf-8", errors="replace")
    return path

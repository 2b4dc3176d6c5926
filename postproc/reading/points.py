"""Parameter points of several runs side by side, with means over replicas and their errors."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from postproc.reading.results import Results

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Points:
    """Averages at parameter points; every field has shape (point,).

    Attributes
    ----------
    number, threshold, channel1_width, channel2_width : N, T, w, w'.
    start : chi at the beginning, |N1 - N2|/N.
    chi, chi_error : mean over the replicas and its standard error; NaN where no task is done.
    current, current_error : net current, per unit time, along the polarity of a polarised state,
        from urn 1 to urn 2 of a homogeneous one (`Results.net_current`); likewise.
    along, along_error : net current along the instantaneous polarity, whatever chi is
        (`Results.polarised_current`); likewise.
    file, point : origin of the point: index of the file, and of the point in it, from 0.
    """

    number: Floats
    threshold: Floats
    channel1_width: Floats
    channel2_width: Floats
    start: Floats
    chi: Floats
    chi_error: Floats
    current: Floats
    current_error: Floats
    along: Floats
    along_error: Floats
    file: NDArray[np.int_]
    point: NDArray[np.int_]

    def where(self, chosen: NDArray[np.bool_]) -> Points:
        """Return the chosen points, in the same order."""
        return Points(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def sorted_by_threshold(self) -> Points:
        """Return the points by increasing T."""
        order = np.argsort(self.threshold, kind="stable")
        return Points(*(getattr(self, field.name)[order] for field in fields(self)))


def gather(files: Sequence[Results]) -> Points:
    """Return the points of all files, in order."""
    columns: list[list[Floats]] = []
    for index, results in enumerate(files):
        results.need_tasks()
        number, first = results.value("number"), results.value("urn1_number")
        chi, current = results.replica_mean("chi"), results.net_current()
        along = results.polarised_current()
        columns.append(
            [
                number,
                results.value("threshold"),
                results.value("channel1_width"),
                results.value("channel2_width"),
                np.abs(2.0 * first - number) / number,
                *chi,
                *current,
                *along,
                np.full(number.size, index),
                np.arange(number.size),
            ]
        )
    return Points(*(np.concatenate(column) for column in zip(*columns, strict=True)))

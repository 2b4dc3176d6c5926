"""The file that `battery --partial` writes of the output `out.h5`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import h5py
import numpy as np

from postproc import open_results

if TYPE_CHECKING:
    from pathlib import Path

PARTIAL = "out.h5.partial.h5"


def check_true(partial: Path, whole: Path) -> int:
    """Compare a partial file with the whole results; return how many tasks it has."""
    with h5py.File(partial) as one, h5py.File(whole) as other:
        done = one["task_status"][()] == 0
        assert one.attrs["status"] == ("complete" if done.all() else "partial")
        for name in ("chi", "current2", "seed", "series/urn1_number", "final/x", "snapshots/uy"):
            values = one[name][()][done]
            # The longest series may not be there yet.
            right = other[name][()][done][..., : values.shape[-1]]
            assert np.array_equal(values, right, equal_nan=True), name
        assert np.isnan(one["chi"][()][~done]).all()
        assert np.isnan(one["final/x"][()][~done]).all()
    assert int(open_results(partial)["chi"].notnull().sum()) == done.sum()
    return int(done.sum())

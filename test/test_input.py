"""Inputs that are odd or large: what they hold is read as it stands, or refused with a word."""

from __future__ import annotations

from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
from support.program import run

if TYPE_CHECKING:
    from pathlib import Path

HEAD = "&particles number = 10 /\n&gate threshold = 2 /\n&output file = 'o.h5' /\n"
WITH_FILE = (
    "&particles number = 1 initial_file = 'i.txt' /\n&gate threshold = 2 /\n"
    "&run collisions = 1000 /\n&output file = 'o.h5' /\n"
)


def test_the_greatest_whole_numbers_are_computed_with(tmp_path: Path) -> None:
    """Threshold, seed and collisions at their bounds: a run that is stopped, or a plan."""
    (tmp_path / "c.nml").write_text(
        "&particles number = 10 seed = 999999999999999999 /\n&gate threshold = 2147483647 /\n"
        "&run collisions = 999999999999999999 transient_collisions = 999999999999999998 /\n"
        "&output file = 'o.h5' /\n"
    )
    ended = run("--check", "c.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    (tmp_path / "d.nml").write_text(
        "&particles number = 10 seed = 999999999999999999 /\n&gate threshold = 2147483647 /\n"
        "&run duration = 20 /\n&output file = 'o.h5' /\n"
    )
    ended = run("d.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    with h5py.File(tmp_path / "o.h5") as file:
        assert file["threshold"][0] == 2147483647
        assert file["reversals"][0, 0] == 0


MANY = 30_000
LARGE = {
    "a list": (HEAD + "&scan channel2_width = " + ", ".join(
        f"{0.01 + 1.7e-7 * at:.17g}" for at in range(MANY)) + " /\n", 0, "nothing was written"),
    "wrong keys": (HEAD + "&run\n" + " colisions = 5\n" * MANY + "/\n", 2, f"{MANY - 50} more"),
    "wrong signs": (HEAD + "&run 5 /\n" * MANY, 2, f"{2 * MANY - 51} more"),
    "stray lines": (HEAD + "stray\n" * MANY, 2, "text outside of any group: stray"),
    "wrong groups": (HEAD + "&rum /\n" * MANY + "&run /\n" * MANY, 2, f"{2 * MANY - 51} more"),
    "wrong widths": (HEAD + f"&scan channel2_width = {MANY}*7 /\n", 2, "below 2 urn_radius"),
    "a long text": (HEAD + "&particles initial_file = '" + "a" * 10 * MANY + "' /\n", 2, "letters"),
    "a long text, repeated": (HEAD + f"&particles initial_file = {MANY - 1}*'{'a' * MANY}' /\n", 2,
        "too long to repeat"),
    "snapshots": (HEAD.replace("'o.h5'", "'o.h5' snapshot_times = " + ", ".join(
        f"{0.001 * at:.17g}" for at in range(MANY))) + "&run duration = 200 /\n",
        0, "nothing was written"),
}  # fmt: skip


@pytest.mark.parametrize("case", LARGE)
def test_large_inputs_are_read_in_seconds(tmp_path: Path, case: str) -> None:
    """Tens of thousands of anything: minutes or more, were the cost to grow with the square."""
    text, code, words = LARGE[case]
    (tmp_path / "c.nml").write_text(text)
    ended = run("--check", "c.nml", folder=tmp_path)
    assert ended.returncode == code, ended.stderr[:1000]
    assert words in ended.stdout + ended.stderr
    assert len(ended.stderr) < 30000


def test_a_large_initial_file_is_read_in_seconds(tmp_path: Path) -> None:
    """Lines with one fault are counted, the first are named."""
    (tmp_path / "c.nml").write_text(WITH_FILE.replace("number = 1", f"number = {MANY}"))
    (tmp_path / "i.txt").write_text("".join(f"9 {at} 1 0\n" for at in range(MANY)))
    ended = run("--check", "c.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "line 1: lies outside the table: x = 9, y = 0; further such lines: " in ended.stderr
    assert f": {MANY - 1} (2, 3, " in ended.stderr
    assert ", 21, ...)" in ended.stderr


def test_many_snapshots_are_kept_in_seconds(tmp_path: Path) -> None:
    """All of them, in their order, each with its time."""
    count = 40000
    times = ", ".join(f"{0.001 * at:.17g}" for at in range(count))
    (tmp_path / "c.nml").write_text(
        "&particles number = 10 /\n&gate threshold = 2 /\n&run duration = 40 /\n"
        f"&output file = 'o.h5' snapshot_times = {times} /\n"
    )
    ended = run("c.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    with h5py.File(tmp_path / "o.h5") as file:
        x = file["snapshots/x"][0, 0]
        ux = file["snapshots/ux"][0, 0]
    assert x.shape == (count, 10)
    # No particle is faster than 1, and straight on is usual.
    step = np.diff(x, axis=0)
    assert np.all(np.abs(step[np.abs(step) < 1]) <= 0.001 * (1 + 1e-9))
    assert np.mean(np.abs(step - 0.001 * ux[:-1]) < 1e-9) > 0.9

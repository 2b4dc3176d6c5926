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

# What was read as something else, or cut, and what is said now.
LINES = {
    "an empty field": ("-1.4,,1,0,1", "comma without a number"),
    "a comma first": (",-1.4 0 1 0", "comma without a number"),
    "a comma last": ("-1.4,0,1,0,", "comma without a number"),
    "an exponent without its letter": ("-140-2 0.1 1 0", "-140-2 is not a number"),
    "a repeat": ("-1.4 2*0.1 1", "has 3 columns"),
    "a repeat as a column": ("-1.4 0.1 1 2*0", "2*0 is not a number"),
    "two points": ("-1.4.0 0.1 1 0", "-1.4.0 is not a number"),
    "no digits behind e": ("-1.4e 0.1 1 0", "-1.4e is not a number"),
    "what becomes 0": ("-1.4 1e-400 1 0", "1e-400 is too near 0"),
    "what is not finite": ("-1.4 0 1 1e400", "1e400 is not finite"),
    "a column far out": ("-1.4 0.1 1 0" + " " * 1100 + "9", "has 5 columns"),
    "a column half out": (" " * 1016 + "-1.4 0.1 1 0 7", "has 5 columns"),
}


@pytest.mark.parametrize("case", LINES)
def test_a_line_has_four_numbers_that_a_person_would_write(tmp_path: Path, case: str) -> None:
    """Anything else is refused with file, line and what is wrong with it."""
    line, words = LINES[case]
    (tmp_path / "c.nml").write_text(WITH_FILE)
    (tmp_path / "i.txt").write_text(f"# x y ux uy\n{line}\n")
    ended = run("--check", "c.nml", folder=tmp_path)
    assert ended.returncode == 2, ended.stdout
    told = [word for word in ended.stderr.splitlines() if "i.txt, line 2: " in word]
    assert words in told[0]


def test_lines_may_be_long_and_end_in_any_way(tmp_path: Path) -> None:
    """Blanks, tabs, commas with blanks, and the ends of lines of other systems are all read."""
    (tmp_path / "c.nml").write_text(WITH_FILE.replace("number = 1", "number = 3"))
    text = "-1.4" + " " * 2000 + "0.1 1 0\r\n1.4 , .2d0,\t+0. ,-1E0\r\n-1.5\t0\t3\t4"
    (tmp_path / "i.txt").write_bytes(text.encode())
    ended = run("--check", "c.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("value", ["2147483647", "2147483648", "200000001"])
@pytest.mark.parametrize("where", ["&particles number = {} /", "&scan number = 5, {} /",
                                   "&scan number_range = 5, {}, 2 /"])  # fmt: skip
def test_more_particles_than_can_be_counted_are_refused(
    tmp_path: Path, value: str, where: str
) -> None:
    """Before the plan is printed, with the bound."""
    head = "&gate threshold = 2 /\n&output file = 'o.h5' /\n"
    (tmp_path / "c.nml").write_text(head + where.format(value))
    ended = run("--check", "c.nml", folder=tmp_path)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert ended.stdout == ""
    assert "200000000" in ended.stderr


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
    (tmp_path / "e.nml").write_text(
        HEAD + "&scan replicas = 2147483647 channel2_width_range = 0.01, 0.1, 100000 /\n"
    )
    ended = run("--check", "e.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "up to 10000000 points times replicas" in ended.stderr


MANY = 30_000
LARGE = {
    "a list": (HEAD + "&scan channel2_width = " + ", ".join(
        f"{0.01 + 1.7e-7 * at:.17g}" for at in range(MANY)) + " /\n", 0, "nothing was written"),
    "wrong keys": (HEAD + "&run\n" + " colisions = 5\n" * MANY + "/\n", 2, f"{MANY - 50} more"),
    "wrong signs": (HEAD + "&run\n" + " 5\n" * MANY + "/\n", 2, "more; the last"),
    "stray lines": (HEAD + "stray\n" * MANY, 2, f"{MANY - 50} more"),
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
    """As many wrong lines are counted, the first are told."""
    (tmp_path / "c.nml").write_text(WITH_FILE.replace("number = 1", f"number = {MANY}"))
    (tmp_path / "i.txt").write_text("9 9 1 0\n" * MANY)
    ended = run("--check", "c.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "line 50: lies outside" in ended.stderr
    assert f"{MANY - 50} more; the last: i.txt, line {MANY}: lies outside" in ended.stderr


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

"""Progress: shown on a terminal, of what takes long, and nowhere else."""

from __future__ import annotations

import io
import sys
import time

import pytest

from postproc import cli, progress


class Screen(io.StringIO):
    """A terminal."""

    def isatty(self) -> bool:
        """Say so."""
        return True


def slow(_: object) -> int:
    """Compute in parts until the second is shown, for at most 20 s on a terminal."""
    until = time.monotonic() + (20.0 if sys.stderr.isatty() else 0.2)
    for point in progress.each([1, 2, 3, 4], "point"):
        with progress.doing("theory"):
            while point == 2 and time.monotonic() < until:
                shown = sys.stderr.getvalue()
                if all(text in shown for text in ("point", " 25%", "theory")):
                    break
                time.sleep(0.005)
    print("answer")
    return 0


@pytest.mark.parametrize("answer", [io.StringIO(), None])
def test_all_that_is_under_way_is_shown_and_gone_at_the_end(
    monkeypatch: pytest.MonkeyPatch, answer: io.StringIO | None
) -> None:
    """Nothing is erased of an answer on the same terminal."""
    stream = Screen()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(sys, "stdout", answer or stream)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(progress, "SILENT", 0.02)
    assert cli.run(slow) == 0
    if answer:
        assert answer.getvalue() == "answer\n"
    else:
        assert "\x1b[1A" not in stream.getvalue().partition("answer\n")[2]
    assert " 25%" in stream.getvalue()
    assert stream.getvalue().endswith("\x1b[2K\x1b[?25h\r")  # with the cursor back
    with progress.doing("theory"):  # called from Python
        time.sleep(0.1)
    assert stream.getvalue().endswith("\x1b[2K\x1b[?25h\r")


@pytest.mark.parametrize(("stream", "silent"), [(io.StringIO(), 0.02), (Screen(), 60.0)])
def test_nothing_is_shown_in_a_log_or_of_what_is_quick(
    monkeypatch: pytest.MonkeyPatch, stream: io.StringIO, silent: float
) -> None:
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(progress, "SILENT", silent)
    assert cli.run(lambda _: sum(progress.each([0], "point"))) == 0
    assert "point" not in stream.getvalue()


def test_a_computation_that_fails_is_not_under_way_any_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "stderr", Screen())
    with progress.told():
        with pytest.raises(ZeroDivisionError), progress.doing("theory"):
            _ = [1 // one for one in progress.each([0], "point")]
        assert progress._shown.get().tasks == []

"""Progress: told to standard error, of what takes long, and nowhere else."""

from __future__ import annotations

import io
import sys
import time

import pytest

from postproc import cli, progress


@pytest.fixture(autouse=True)
def _hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "SILENT", 0.02)
    monkeypatch.setattr(progress, "AGAIN", 0.02)


def wait_for(stream: io.StringIO, text: str) -> None:
    """Wait until a text was told; a test that hangs is ended by its patience."""
    until = time.monotonic() + 20.0
    while text not in stream.getvalue():
        assert time.monotonic() < until, stream.getvalue()
        time.sleep(0.005)


class Screen(io.StringIO):
    """A terminal."""

    def isatty(self) -> bool:
        """Say so."""
        return True


@pytest.mark.parametrize("stream", [io.StringIO(), Screen()])
def test_all_that_is_under_way_is_told_and_how_far(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], stream: io.StringIO
) -> None:
    """On a terminal it is gone when the command ends; what is piped as data has none of it."""
    monkeypatch.setattr(sys, "stderr", stream)

    def slow(_: object) -> int:
        for point in progress.each([1, 2, 3], "point"):
            with progress.doing("theory"):
                if point == 2:
                    wait_for(stream, " s: point 2 of 3: theory")
        print("answer")
        return 0

    assert cli.run(slow) == 0
    assert capsys.readouterr().out == "answer\n"
    assert stream.getvalue().endswith(progress.ERASED if stream.isatty() else ": theory\n")


def test_nothing_is_told_of_what_is_quick_or_called_from_python(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    with progress.doing("theory"):
        time.sleep(0.1)
    monkeypatch.setattr(progress, "SILENT", 60.0)
    assert cli.run(lambda _: sum(progress.each([0], "point"))) == 0
    assert stream.getvalue() == ""


def test_a_computation_that_fails_is_not_under_way_any_more() -> None:
    with pytest.raises(ZeroDivisionError), progress.doing("theory"):
        _ = [1 // one for one in progress.each([0], "point")]
    assert progress._under_way == []

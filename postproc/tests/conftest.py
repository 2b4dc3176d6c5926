"""What the tests of pictures share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# what tests compute is not kept in the user's own folder
os.environ["XDG_CACHE_HOME"] = str(Path(__file__).resolve().parents[2] / "build" / "cache")


@pytest.fixture
def unwritten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw each picture once, instead of twice for its PNG and twice for its PDF.

    For tests that look at what a command says. Layout and all parts are worked out as for a file.
    """

    def save(made: Figure, folder: Path, name: str) -> list[Path]:
        made.draw_without_rendering()
        return [folder / f"{name}.png", folder / f"{name}.pdf"]

    monkeypatch.setattr("postproc.figures.style.save", save)

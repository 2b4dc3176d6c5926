"""Benchmarks: figures, bounds and comparisons of files whose numbers are known."""

from __future__ import annotations

import stat
import sys
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from studies.speed import benchmarks, ratios
from studies.speed.bounds import Figure, Rows, figures

# rounds of a machine whose speed drifts
DRIFT = (1.0, 0.8, 0.9, 1.1, 0.7)


def _row(table: str, cost: float = 1.0, **case: Any) -> dict[str, Any]:
    """Return a row that is `cost` times as slow as 2e8 collisions a second."""
    known = {"engine": "excursion", "number": 1000, "threshold": 7}
    known |= {"channel1_width": 0.3, "channel2_width": 0.01, "sides": 0}
    rates = {
        "collisions_per_second": [2e8 * drift / cost for drift in DRIFT],
        "visits_per_second": [1e7 * drift / cost for drift in DRIFT],
        "particle_time_per_second": [1e8 * drift / cost for drift in DRIFT],
    }
    return {"table": table} | known | case | rates


def _rows() -> list[dict[str, Any]]:
    return [
        _row("engines"),
        _row("engines", 16.0, engine="collision"),
        _row("engines", 30.0, engine="synchronous"),
        _row("number"),
        _row("number", 1.5, number=1_000_000, threshold=7000),
        _row("openings", channel1_width=0.3, channel2_width=0.3),
        _row("openings", 4.0, channel1_width=1e-6, channel2_width=1e-6),
        _row("visits"),
        _row("visits", 1.8, sides=6),
        _row("visits", 2.2, sides=6, channel2_width=0.3),
        _row("lorentz", channel2_width=0.3),
        _row("lorentz", 5.5, engine="collision", channel2_width=0.3),
        _row("map", 1.0, threshold=3),
        _row("map", 3.0, threshold=23),
    ]


def _by_name(found: list[Figure]) -> dict[str, Figure]:
    return {one.name: one for one in found}


def test_figures_are_ratios_of_the_rounds_in_one_run() -> None:
    found = _by_name(figures(Rows(_rows()), [95.0], [23.0]))
    assert found["ratio to collision"].values == pytest.approx([16.0] * 5)
    assert found["ratio to synchronous"].values == pytest.approx([30.0] * 5)
    assert found["ratio to collision, 20 scatterers"].values == pytest.approx([5.5] * 5)
    assert found["wall hits a second, visits to hexagons"].values == pytest.approx(
        [2e8 * drift / 1.8 for drift in DRIFT]
    )
    assert found["visit, w = w' = 1e-6 over 0.3"].values == pytest.approx([4.0] * 5)
    assert found["time unit and particle, 1e6 over 1e3"].values == pytest.approx([1.5] * 5)
    # 625 points of half a second and three halves a point, in the round without drift
    assert found["half the map, minutes"].values[0] == pytest.approx(625 * 1.0 / 60.0)


def _program(path: Path, text: str) -> Path:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_instructions_are_those_of_the_difference(tmp_path: Path) -> None:
    # 1000 instructions at the start, 20 a collision; runs are 5 collisions longer than asked
    text = """for word; do last=$word; done
echo $((last + 5)); echo "== Collected : $((1000 + 20 * (last + 5)))" >&2"""
    valgrind = _program(tmp_path / "valgrind", text)
    found = benchmarks.count_instructions(tmp_path / "bench", str(valgrind), (200, 800))
    assert found == pytest.approx(20.0)


def test_memory_is_shared_among_the_particles(tmp_path: Path) -> None:
    text = """test "$1" = single && exec """
    program = _program(tmp_path / "bench", f"{text}{sys.executable} -c 'b\"x\" * 2**29'")
    found = benchmarks.peak_memory(program, 2**20, 1)
    assert 512.0 < found < 640.0


def test_ratios_are_of_pairs_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    spent = {"old": iter((6.0, 8.0, 3.0)), "new": iter((3.0, 2.0, 1.0))}

    def seconds(program: Path, words: tuple[str, ...]) -> float:
        asked.append(program.name)
        assert words == ratios.POINTS["T = 18"]
        return next(spent[program.name])

    monkeypatch.setattr(ratios, "processor_seconds", seconds)
    found = ratios.ratio("T = 18", Path("old"), Path("new"), 3)
    assert found.values == (2.0, 4.0, 3.0)
    assert asked == ["old", "new", "new", "old", "old", "new"]
    console = Console(width=100, record=True, quiet=False)
    console.print(ratios.table_of([found]))
    assert "T = 18 3.00 2.00 4.00" in " ".join(console.export_text().split())

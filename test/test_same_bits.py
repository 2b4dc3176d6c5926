"""The same bits on other processors: builds for x86-64-v3, for AVX-512 and for this processor."""

from __future__ import annotations

import subprocess
from pathlib import Path

import h5py
import pytest
from support.program import ALONE, PATIENCE, PROGRAM, ROOT, contents, make, namelist

PROCESSORS = ("x86-64-v3", "x86-64-v4")
NEEDED = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
ENGINES = ("excursion", "collision", "synchronous", "timestep", "reservoir")
# What tells how a program was built.
OF_THE_BUILD = {"/@compiler_options"}
WIDE = {
    "urn_radius": 1.25,
    "channel1_width": 0.9,
    "channel1_length": 1.5,
    "channel2_width": 0.6,
    "channel2_length": 0.75,
}
TABLES: dict[str, dict[str, dict[str, object]]] = {
    "paper": {"particles": {"number": 300}, "gate": {"threshold": 5}},
    "wide": {"table": WIDE, "particles": {"number": 60}, "gate": {"threshold": "2, 3"}},
    "unequal": {
        "table": {"urn_radius": "1.0, 0.7", "channel2_width": 0.2},
        "particles": {"number": 100},
        "gate": {"threshold": 4},
    },
    "narrow": {
        "table": {"channel1_width": 1e-2, "channel2_width": 1e-3},
        "particles": {"number": 50},
        "gate": {"threshold": 1},
    },
}
# Collisions of a second or two, so that a run can be stopped in the middle.
LONG = {
    "excursion": 400_000_000,
    "collision": 10_000_000,
    "synchronous": 2_500_000,
    "timestep": 2_000_000,
    "reservoir": 800_000_000,
}

pytestmark = pytest.mark.full


def flags_of_processor() -> set[str]:
    """Give what the processor can do, as Linux tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return set()
    return next((set(line.split()) for line in lines if line.startswith("flags")), set())


@pytest.fixture(scope="module")
def builds() -> list[Path]:
    """Build the program for both processors; the third is the one for this processor."""
    missing = NEEDED - flags_of_processor()
    if missing:
        pytest.skip(f"this processor has no AVX-512 ({', '.join(sorted(missing))})")
    make(*(f"build/{name}/bin/battery" for name in PROCESSORS))
    return [*(ROOT / "build" / name / "bin/battery" for name in PROCESSORS), PROGRAM]


def run_by(program: Path, folder: Path, text: str) -> int:
    """Run one of the builds in a folder; give its exit code."""
    folder.mkdir(exist_ok=True)
    (folder / "case.nml").write_text(text, encoding="utf-8")
    ended = subprocess.run(
        [str(program), "--quiet", "case.nml"],
        cwd=folder,
        env=ALONE,
        capture_output=True,
        text=True,
        check=False,
        timeout=10 * PATIENCE,
    )
    assert ended.returncode in (0, 3), ended.stderr
    return ended.returncode


def assert_same_but_for_the_build(one: Path, other: Path) -> None:
    """Two results files hold the same bits, and tell of two builds."""
    left, right = contents(one), contents(other)
    assert left.keys() == right.keys()
    differing = {name for name in left if left[name] != right[name]}
    assert differing <= OF_THE_BUILD, f"these differ: {sorted(differing - OF_THE_BUILD)}"


def assert_all_the_same(folder: Path, builds: list[Path], text: str) -> Path:
    """All builds make the same of a case; give the results of the first."""
    results = []
    for number, program in enumerate(builds):
        assert run_by(program, folder / str(number), text) == 0
        results.append(folder / str(number) / "out.h5")
        assert_same_but_for_the_build(results[0], results[-1])
    return results[0]


def case_of(
    engine: str,
    run: dict[str, object],
    limits: dict[str, object] | None = None,
    table: str = "paper",
    **output: object,
) -> str:
    """Write the namelist of a case."""
    if engine == "timestep":
        run = {"time_step": 0.01, **run}
    return namelist(
        **TABLES[table],
        run={"engine": f"'{engine}'", **run},
        output={"file": "'out.h5'", "final_state": ".true.", **output},
        limits=limits or {},
    )


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("engine", ENGINES)
def test_events_and_final_states_are_the_same(
    tmp_path: Path, builds: list[Path], engine: str, table: str
) -> None:
    """Event log, series, snapshots, final state and all results, to the last bit."""
    duration = 1000 if table == "narrow" else 100
    text = case_of(
        engine,
        {"duration": duration, "start_time": 1000},
        table=table,
        event_log=".true.",
        snapshot_times="1, 50",
        series_interval=5,
    )
    with h5py.File(assert_all_the_same(tmp_path, builds, text)) as file:
        assert len(file["events/time"]) > 20


@pytest.mark.parametrize("engine", ENGINES)
def test_results_of_a_scan_are_the_same(tmp_path: Path, builds: list[Path], engine: str) -> None:
    """Averages and errors of many tasks: what differs in the last bit once in a hundred shows."""
    run: dict[str, object] = {"engine": f"'{engine}'", "collisions": 4000}
    if engine == "timestep":
        run["time_step"] = 0.01
    text = namelist(
        particles={"number": 30},
        run=run,
        scan={"threshold": "1, 3", "channel1_width": "0.3, 0.7", "replicas": 12},
        output={"file": "'out.h5'", "final_state": ".true."},
    )
    assert_all_the_same(tmp_path, builds, text)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_goes_on_with_the_other_build(
    tmp_path: Path, builds: list[Path], engine: str
) -> None:
    """What one build stopped in the middle the other ends, and it is as if never stopped."""
    length = {"collisions": LONG[engine]}
    whole, changed = tmp_path / "whole", tmp_path / "changed"
    assert run_by(builds[0], whole, case_of(engine, length)) == 0
    for program in (builds[0], builds[2]):
        assert run_by(program, changed, case_of(engine, length, {"wall_minutes": 0.005})) == 3
    assert run_by(builds[1], changed, case_of(engine, length)) == 0
    assert_same_but_for_the_build(whole / "out.h5", changed / "out.h5")

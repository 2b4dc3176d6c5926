"""Points of a scan are known by their values; urns and gates may differ from each other."""

from __future__ import annotations

import itertools
import math
import re
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
from support.program import contents, namelist, run

if TYPE_CHECKING:
    from pathlib import Path

ENGINES = ["excursion", "collision", "synchronous", "timestep", "reservoir"]
RADII, THRESHOLDS, WIDTHS = (1.0, 1.4), (1, 2), (0.5, 0.4)
NUMBER, CROWD = 40, 120
#: Who is turned back, who crosses which line.
REVERSES, CROSSES1, CROSSES2 = 2, 3, 4


def calculate(folder: Path, name: str, **groups: dict[str, object]) -> Path:
    """Run a case to its end; give its results."""
    case = {
        "particles": {"number": NUMBER},
        "gate": {"threshold": 2},
        "run": {"duration": 40},
        **groups,
    }
    case["output"] = {"file": f"'{name}.h5'", **case.get("output", {})}
    (folder / f"{name}.nml").write_text(namelist(**case))
    ended = run("--quiet", f"{name}.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    return folder / f"{name}.h5"


def scattered() -> list[tuple[float, float, float, float]]:
    """Give particles in both unequal urns, off their chords."""
    random = np.random.default_rng(5)
    found = []
    for at in range(CROWD):
        urn = at % 2
        radius = RADII[urn]
        away, angle, way = 0.9 * radius * math.sqrt(random.random()), *random.uniform(0, 6.28, 2)
        centre = 0.5 + math.sqrt(radius**2 - WIDTHS[0] ** 2 / 4)
        x = (centre if urn else -centre) + away * math.cos(angle)
        found.append((x, away * math.sin(angle), math.cos(way), math.sin(way)))
    return found


@pytest.mark.parametrize("engine", ENGINES)
def test_each_gate_turns_back_one_more_than_its_own_threshold(tmp_path: Path, engine: str) -> None:
    """Of unequal urns, from the namelist to the file; and N1 changes by what crosses."""
    lines = [f"{x!r} {y!r} {ux!r} {uy!r}\n" for x, y, ux, uy in scattered()]
    (tmp_path / "start.txt").write_text("".join(lines))
    path = calculate(
        tmp_path,
        engine,
        table={
            "urn_radius": ", ".join(map(str, RADII)),
            "channel1_width": WIDTHS[0],
            "channel2_width": WIDTHS[1],
        },
        particles={"number": CROWD, "initial_file": "'start.txt'"},
        gate={"threshold": ", ".join(map(str, THRESHOLDS))},
        run={
            "engine": f"'{engine}'",
            "duration": 12,
            **({"time_step": 1 / 128} if engine == "timestep" else {}),
        },
        output={"event_log": ".true.", "final_state": ".true.", "series_interval": 1},
    )
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["urn_radius"], [RADII])
        np.testing.assert_array_equal(file["gate_threshold"], [THRESHOLDS])
        assert file["threshold"][0] == THRESHOLDS[0]
        kind, where, who = (file[f"events/{name}"][()] for name in ("kind", "where", "particle"))
        course, x = file["series/urn1_number"][0, 0], file["final/x"][()]
    for gate, threshold in enumerate(THRESHOLDS, start=1):
        turned = who[(kind == REVERSES) & (where == gate)]
        assert turned.size > 0
        assert (turned == threshold + 1).all()
    crossings = where[(kind == CROSSES1) | (kind == CROSSES2)]
    change = np.count_nonzero(crossings == 21) - np.count_nonzero(crossings == 12)
    assert set(crossings) == {12, 21}
    assert course[-1] - course[0] == change
    assert np.count_nonzero(x < 0) == course[-1]


def measured(path: Path) -> dict[str, tuple[object, ...]]:
    """Give all that a results file holds but the text of its input, and what of it is a list."""
    found = contents(path).items()
    return {
        name: held for name, held in found
        if name not in ("/@namelist", "/@scan") and not name.startswith("scan/")
    }  # fmt: skip


# Keys that can be scanned: their groups and values.
SCANNED: list[dict[str, tuple[str, object]]] = [
    {
        "threshold": ("gate", 3),
        "number": ("particles", 50),
        "channel1_width": ("table", 0.2),
        "channel2_width": ("table", 0.1),
    },
    {
        "urn_radius": ("table", 1.1),
        "channel1_width": ("table", 0.4),
        "channel1_length": ("table", 0.7),
        "channel2_width": ("table", 0.2),
        "channel2_length": ("table", 1.6),
    },
    {
        "threshold_fraction": ("gate", 0.05),
        "number": ("particles", 60),
        "urn1_fraction": ("particles", 0.3),
    },
]


@pytest.mark.parametrize("keys", SCANNED, ids=["numbers", "lengths", "fractions"])
def test_a_list_of_one_is_the_value_in_its_own_group(
    tmp_path: Path, keys: dict[str, tuple[str, object]]
) -> None:
    """The same seeds and the same bits, a range of one as well."""
    own: dict[str, dict[str, object]] = {"table": {}, "particles": {}, "gate": {}}
    for key, (group, value) in keys.items():
        own[group][key] = value
    own = {group: inside for group, inside in own.items() if inside}
    listed = {key: value for key, (_, value) in keys.items()}
    ranged = {f"{key}_range": f"{value}, {value}, 1" for key, value in listed.items()}
    none: dict[str, dict[str, object]] = {group: {} for group in own}
    results = [
        calculate(tmp_path, "own", **own),
        calculate(tmp_path, "listed", **none, scan=listed),
        calculate(tmp_path, "ranged", **none, scan=ranged),
    ]
    first, *others = [measured(path) for path in results]
    assert all(other == first for other in others)


LENGTHS = {
    "channel1_width": (0.3, 0.5),
    "channel2_width": (0.0, 0.1),
    "channel1_length": (0.5, 1.2),
    "urn_radius": (0.8, 1.5),
}


def test_points_of_a_scan_over_lengths_are_single_runs(tmp_path: Path) -> None:
    """Each of the sixteen, by the bits of all that was measured; the file says which is which."""
    scan = {f"{key}_range": f"{first}, {last}, 2" for key, (first, last) in LENGTHS.items()}
    names = ["seed", "chi", "current1", "flow1_12", "flow2_21", "collisions", "time"]
    with h5py.File(calculate(tmp_path, "many", scan=scan)) as file:
        many = {name: file[name][()] for name in (*names, *LENGTHS)}
    points = list(itertools.product(*LENGTHS.values()))
    for at, point in enumerate(points):
        table = dict(zip(LENGTHS, point, strict=True))
        with h5py.File(calculate(tmp_path, f"alone{at}", table=table)) as one:
            for name in names:
                assert many[name][at].tobytes() == one[name][0].tobytes(), (name, table)
        assert [np.ravel(many[key][at])[0] for key in LENGTHS] == list(point)
    assert np.unique(many["seed"]).size == len(points)


def refused(folder: Path, *options: str, **groups: dict[str, object]) -> list[str]:
    """Give the lines that are said of a case that must be refused and leave nothing behind."""
    case = {"particles": {"number": 20}, "gate": {"threshold": 2}, "run": {"duration": 5}}
    (folder / "case.nml").write_text(namelist(**case, **groups))
    before = set(folder.iterdir())
    ended = run(*options, "case.nml", folder=folder)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert set(folder.iterdir()) == before
    return ended.stderr.splitlines()


@pytest.mark.parametrize("options", [(), ("--check",)])
def test_points_that_cannot_exist_are_listed_before_anything_runs(
    tmp_path: Path, options: tuple[str, ...]
) -> None:
    """All of them, each with its lengths and what they would have to be; first how many."""
    scan = {"urn_radius_range": "0.3, 0.5, 3", "channel1_width": "0.2, 0.6, 0.7, 0.9"}
    first, *found = refused(tmp_path, *options, scan=scan)
    assert first == "case.nml: 4 of 12 points of the scan cannot be simulated"
    expected = [
        (width, radius)
        for width in (0.6, 0.7, 0.9) for radius in (0.3, 0.4, 0.5) if width >= 2 * radius
    ]  # fmt: skip
    assert found == [
        f"case.nml, line 12: &scan channel1_width = {width}; allowed: below 2 urn_radius, which is "
        f"{2 * radius:.12g} (1 of 12 points: urn_radius = {radius})"
        for width, radius in expected
    ]


def test_a_problem_that_points_share_is_told_once(tmp_path: Path) -> None:
    """With how many have it; one that all points have is none of the scan."""
    scan = {"urn_radius": "1, 0.4", "number": "5, 6"}
    where = "number = {}, urn_radius = 0.4".format
    assert refused(tmp_path, table={"channel1_width": 0.8}, scan=scan) == [
        "case.nml, line 11: &table channel1_width = 0.8; allowed: below 2 urn_radius, which is 0.8 "
        f"(2 of 4 points, the first: {where(5)}, the last: {where(6)})"
    ]
    assert refused(tmp_path, table={"channel1_width": 2}, scan={"number": "5, 6"}) == [
        "case.nml, line 11: &table channel1_width = 2; allowed: below 2 urn_radius, which is 2"
    ]


def test_many_points_that_cannot_exist_are_told_by_value(tmp_path: Path) -> None:
    """A line for each of fifty widths that are too wide somewhere, and no point left out."""
    scan = {"urn_radius_range": "0.1, 0.5, 50", "channel1_width_range": "0.2, 0.8, 50"}
    first, *found = refused(tmp_path, "--check", scan=scan)
    radii, widths = (np.linspace(*ends, 50).round(12) for ends in ((0.1, 0.5), (0.2, 0.8)))
    many = [np.count_nonzero(width >= 2.0 * radii) for width in widths]
    assert first == f"case.nml: {sum(many)} of 2500 points of the scan cannot be simulated"
    told = [re.search(r"_range = ([\d.]+);.*\((\d+) of 2500 points", line) for line in found]
    assert [float(one[1]) for one in told] == pytest.approx(widths)
    assert [int(one[2]) for one in told] == many


def test_an_initial_file_that_does_not_fit_a_point_is_refused_with_the_point(
    tmp_path: Path,
) -> None:
    """The first that it does not fit, and the particles that lie outside of its table."""
    (tmp_path / "start.txt").write_text("-1.2 0.6 1 0\n1.2 -0.6 0 1\n")
    case = {"particles": {"number": 2, "initial_file": "'start.txt'"}, "gate": {"threshold": 2}}
    (tmp_path / "case.nml").write_text(namelist(**case, scan={"urn_radius": "1, 1.5, 0.5, 0.3"}))
    ended = run("--check", "case.nml", folder=tmp_path)
    assert ended.returncode == 2
    first, *lines = ended.stderr.splitlines()
    assert first.endswith("initial_file = 'start.txt' cannot be used where urn_radius = 0.5:")
    assert lines[0].startswith("start.txt, line 1: lies outside the table: x = -1.2, y = 0.6")


@pytest.mark.parametrize(("engine", "code"), [("collision", 2), ("reservoir", 0)])
def test_replicas_of_one_initial_file_are_refused_unless_the_engine_draws(
    tmp_path: Path, engine: str, code: int
) -> None:
    """They would be one run, and the error over them 0."""
    (tmp_path / "start.txt").write_text("-1.2 0.6 1 0\n1.2 -0.6 0 1\n")
    (tmp_path / "case.nml").write_text(namelist(
        particles={"number": 2, "initial_file": "'start.txt'"}, gate={"threshold": 2},
        run={"engine": f"'{engine}'"}, scan={"replicas": 3},
    ))  # fmt: skip
    ended = run("--check", "case.nml", folder=tmp_path)
    assert ended.returncode == code
    assert ("&scan replicas = 3; allowed: 1, and no" in ended.stderr) == (code == 2)


def test_large_numbers_are_shown_whole(tmp_path: Path) -> None:
    """The table on the screen makes room for them."""
    case = namelist(
        particles={"number": 20}, gate={"threshold": 2147483647}, run={"collisions": 1000}
    )
    (tmp_path / "case.nml").write_text(case)
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    shown = [line.split()[:4] for line in ended.stdout.splitlines()]
    assert ["20", "2147483647", "0.3000", "0.010000"] in shown

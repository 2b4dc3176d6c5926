"""Points of a scan are known by their values; urns and gates may differ from each other."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
from support.program import contents, namelist, run

if TYPE_CHECKING:
    from pathlib import Path

ENGINES = ["excursion", "collision", "synchronous", "timestep"]
RADII, THRESHOLDS, WIDTHS = (1.0, 1.4), (1, 2), (0.5, 0.4)
NUMBER, CROWD = 40, 120
#: Who enters a gate, who is turned back, who crosses which line.
ENTERS, REVERSES, CROSSES1, CROSSES2 = 1, 2, 3, 4


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


def unequal(folder: Path, engine: str, exchanged: bool) -> dict[str, np.ndarray]:
    """Run unequal urns with unequal gates, as they are or with urn 1 and urn 2 exchanged."""
    order, sign = (slice(None, None, -1), -1.0) if exchanged else (slice(None), 1.0)
    lines = [f"{sign * x!r} {y!r} {sign * ux!r} {uy!r}\n" for x, y, ux, uy in scattered()]
    (folder / "start.txt").write_text("".join(lines))
    path = calculate(
        folder,
        f"{engine}{exchanged}",
        table={
            "urn_radius": ", ".join(map(str, RADII[order])),
            "channel1_width": WIDTHS[0],
            "channel2_width": WIDTHS[1],
        },
        particles={"number": CROWD, "initial_file": "'start.txt'"},
        gate={"threshold": ", ".join(map(str, THRESHOLDS[order]))},
        run={
            "engine": f"'{engine}'",
            "duration": 12,
            **({"time_step": 1 / 128} if engine == "timestep" else {}),
        },
        output={"event_log": ".true.", "final_state": ".true.", "series_interval": 1},
    )
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["urn_radius"], [RADII[order]])
        np.testing.assert_array_equal(file["gate_threshold"], [THRESHOLDS[order]])
        assert file["threshold"][0] == THRESHOLDS[order][0]
        names = [f"events/{name}" for name in ("time", "kind", "where", "particle")]
        names += [f"final/{name}" for name in ("x", "y", "ux", "uy")]
        names += ["series/urn1_number", "bounce_backs", "reversals"]
        return {name: file[name][()] for name in names}


def assert_gates_and_counts_hold(found: dict[str, np.ndarray], thresholds: tuple[int, ...]) -> None:
    """Each gate turns back one more than its own threshold; N1 changes by what crosses."""
    kind, where, who = (found[f"events/{name}"] for name in ("kind", "where", "particle"))
    for gate, threshold in enumerate(thresholds, start=1):
        turned = who[(kind == REVERSES) & (where == gate)]
        assert turned.size > 0
        assert (turned == threshold + 1).all()
    crossings = where[(kind == CROSSES1) | (kind == CROSSES2)]
    change = np.count_nonzero(crossings == 21) - np.count_nonzero(crossings == 12)
    assert set(crossings) == {12, 21}
    course = found["series/urn1_number"][0, 0]
    assert course[-1] - course[0] == change
    assert np.count_nonzero(found["final/x"] < 0) == course[-1]


@pytest.mark.parametrize("engine", ENGINES)
def test_exchanged_urns_and_gates_mirror_every_event(tmp_path: Path, engine: str) -> None:
    """Radii, thresholds and particles exchanged: the same events, in the other urn and gate."""
    one, other = (unequal(tmp_path, engine, exchanged) for exchanged in (False, True))
    assert_gates_and_counts_hold(one, THRESHOLDS)
    assert_gates_and_counts_hold(other, THRESHOLDS[::-1])
    mirrored = {1: 2, 2: 1, 12: 21, 21: 12}
    np.testing.assert_array_equal(one["events/kind"], other["events/kind"])
    np.testing.assert_array_equal(one["events/particle"], other["events/particle"])
    assert [mirrored[at] for at in one["events/where"]] == other["events/where"].tolist()
    np.testing.assert_allclose(one["events/time"], other["events/time"], atol=1e-8)
    for name, sign in (("x", -1), ("y", 1), ("ux", -1), ("uy", 1)):
        np.testing.assert_allclose(one[f"final/{name}"], sign * other[f"final/{name}"], atol=1e-6)
    course = one["series/urn1_number"] + other["series/urn1_number"]
    assert (course == CROWD).all()


def test_reservoir_has_a_threshold_for_each_gate(tmp_path: Path) -> None:
    """The engine of chance, too, turns back by each gate's own threshold."""
    assert_gates_and_counts_hold(unequal(tmp_path, "reservoir", exchanged=False), THRESHOLDS)


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
        "threshold_fraction": ("gate", 0.05),
        "number": ("particles", 60),
        "urn1_fraction": ("particles", 0.3),
    },
]


@pytest.mark.parametrize("keys", SCANNED, ids=["numbers", "fractions"])
def test_a_list_of_one_is_the_value_in_its_own_group(
    tmp_path: Path, keys: dict[str, tuple[str, object]]
) -> None:
    """The same seeds and the same bits, a range of one as well."""
    own: dict[str, dict[str, object]] = {"table": {}, "particles": {}, "gate": {}}
    for key, (group, value) in keys.items():
        own[group][key] = value
    listed = {key: value for key, (_, value) in keys.items()}
    ranged = {f"{key}_range": f"{value}, {value}, 1" for key, value in listed.items()}
    none: dict[str, dict[str, object]] = {"table": {}, "particles": {}, "gate": {}}
    results = [
        calculate(tmp_path, "own", **own),
        calculate(tmp_path, "listed", **none, scan=listed),
        calculate(tmp_path, "ranged", **none, scan=ranged),
    ]
    first, *others = [measured(path) for path in results]
    assert all(other == first for other in others)


def test_a_point_is_the_same_however_many_are_scanned_with_it(tmp_path: Path) -> None:
    """Alone, or in the middle of a scan in which its key is a list and replicas are more."""
    many = calculate(
        tmp_path, "many", gate={},
        scan={"threshold": "3, 1, 2", "channel2_width": "0.1, 0.01, 0.2", "replicas": 2},
    )  # fmt: skip
    alone = calculate(tmp_path, "alone", table={"channel2_width": "0.01"}, gate={"threshold": 1})
    with h5py.File(many) as file, h5py.File(alone) as one:
        assert len(np.unique(file["seed"])) == 18
        at = np.flatnonzero((file["threshold"][()] == 1) & (file["channel2_width"][()] == 0.01))
        for name in ("seed", "chi", "current1", "flow1_12", "collisions", "bounce_backs"):
            assert file[name][at[0], 0].tobytes() == one[name][0, 0].tobytes(), name


def test_the_values_of_a_range_are_those_that_a_person_would_write(tmp_path: Path) -> None:
    """A range from 0.1 to 0.3 has 0.2 in its middle: the same seeds, the same bits."""
    ranged = calculate(tmp_path, "ranged", scan={"channel2_width_range": "0.1, 0.3, 3"})
    listed = calculate(tmp_path, "listed", scan={"channel2_width": "0.1, 0.2, 0.3"})
    assert measured(ranged) == measured(listed)
    with h5py.File(ranged) as file:
        assert file["channel2_width"][()].tolist() == [0.1, 0.2, 0.3]


TWICE = {
    "a value": ({"threshold": "1, 2, 1"}, "&scan threshold = 1;"),
    "equal to twelve digits": (
        {"channel2_width": "0.1, 0.10000000000000002"}, "&scan channel2_width = 0.1"),
    "a rounded share": ({"threshold_fraction": "0.05, 0.051"}, "threshold_fraction = 0.051"),
}  # fmt: skip


@pytest.mark.parametrize("case", TWICE)
def test_a_point_that_is_there_twice_is_refused(tmp_path: Path, case: str) -> None:
    """Its task would be done twice, with the same seed."""
    scan, words = TWICE[case]
    gate = {} if "threshold" in str(scan) else {"threshold": 2}
    (tmp_path / "case.nml").write_text(
        namelist(particles={"number": NUMBER}, gate=gate, run={"duration": 1}, scan=scan)
    )
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2, ended.stdout
    assert words in ended.stderr
    assert "every point once" in ended.stderr


def test_large_numbers_are_shown_whole(tmp_path: Path) -> None:
    """The table on the screen makes room for them."""
    case = namelist(
        particles={"number": 20}, gate={"threshold": 2147483647}, run={"collisions": 1000}
    )
    (tmp_path / "case.nml").write_text(case)
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[1].split()[:4] == ["20", "2147483647", "0.3000", "0.010000"]

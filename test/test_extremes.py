"""Tables at the ends of what numbers can hold: the scale is free, and what cannot be is refused."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest
from support.program import namelist, run

if TYPE_CHECKING:
    from pathlib import Path
    from subprocess import CompletedProcess

EXACT = ["excursion", "collision", "synchronous", "timestep"]
ENGINES = [*EXACT, "reservoir"]
POWERS = [-200, -3, 64, 200]

# Lengths and times of a case, all of which grow with the scale.
TABLE = {
    "urn_radius": 1.0,
    "channel1_width": 0.3,
    "channel1_length": 1.1,
    "channel2_width": 0.2,
    "channel2_length": 0.7,
}
DURATION = 50.0
# Datasets by the power of the length that they grow with; all others stay as they are.
LENGTHS = {
    "time",
    "transient_time",
    "channel1_width",
    "channel1_length",
    "channel2_width",
    "channel2_length",
    "urn_radius",
    "series/time",
    "events/time",
    "snapshots/time",
    "snapshots/x",
    "snapshots/y",
    "final/x",
    "final/y",
}


# In both channels, in both ways, on the way across as well, and in the urns: x y ux uy.
PLACES = [
    (-0.2, 0.1, 1.0, 1e-3),
    (0.3, -0.1, 1e-13, 1.0),
    (0.1, 0.0, 0.0, 1.0),
    (2.6, 0.05, 0.6, 0.8),
    (-2.6, 0.05, 0.6, -0.8),
    (-1.5, 0.2, 0.1, 0.7),
    (1.5, 0.7, -0.4, 0.3),
]


def calculate(
    folder: Path,
    table: dict[str, float] | dict[str, str],
    engine: str = "excursion",
    name: str = "case",
    number: int = 60,
    **groups: dict[str, Any],
) -> CompletedProcess[str]:
    """Run a case with this table."""
    path = folder / f"{name}.nml"
    settings = {"engine": f"'{engine}'", **groups.pop("run", {})}
    output = {"file": f"'{name}.h5'", **groups.pop("output", {})}
    path.write_text(
        namelist(
            table={key: str(value) for key, value in table.items()},
            particles={"number": str(number), **groups.pop("particles", {})},
            gate={"threshold": "2", **groups.pop("gate", {})},
            run=settings,
            output=output,
            **groups,
        )
    )
    return run(path.name, folder=folder)


def read(path: Path) -> dict[str, np.ndarray]:
    """Read all datasets of a results file."""
    found = {}

    def keep(name: str, item: h5py.Dataset | h5py.Group) -> None:
        if isinstance(item, h5py.Dataset):
            found[name] = item[()]

    with h5py.File(path) as file:
        file.visititems(keep)
    return found


def from_starts(
    folder: Path,
    starts: list[tuple[float, float, float, float]],
    table: dict[str, float],
    engine: str,
    duration: float,
    snapshots: str = "0",
    threshold: int | None = None,
) -> dict[str, np.ndarray]:
    """Run particles from given starts, which no gate reverses by default; read the results."""
    lines = [" ".join(repr(float(value)) for value in start) + "\n" for start in starts]
    (folder / "start.txt").write_text("".join(lines))
    ended = calculate(
        folder,
        {"channel1_length": 1.0, **table},
        engine,
        engine,
        number=len(starts),
        particles={"initial_file": "'start.txt'"},
        gate={"threshold": str(threshold or len(starts))},
        run={"duration": repr(duration)},
        output={"snapshot_times": snapshots},
    )
    assert ended.returncode == 0, ended.stderr
    return read(folder / f"{engine}.h5")


def scattered() -> list[tuple[float, float, float, float]]:
    """Give particles in both urns, off their chords; a scaled table has other random numbers.

    Some are in the channels too, with the slowest passages: what is endless is so at any scale.
    """
    random = np.random.default_rng(1)
    centre = 0.5 * TABLE["channel1_length"] + math.sqrt(1.0 - 0.25 * TABLE["channel1_width"] ** 2)
    found = [*PLACES]
    for at in range(60):
        away, angle, way = 0.9 * math.sqrt(random.random()), *random.uniform(0.0, 6.28, 2)
        x = away * math.cos(angle) + (centre if at % 2 else -centre)
        found.append((x, away * math.sin(angle), math.cos(way), math.sin(way)))
    return found


def scaled(folder: Path, engine: str, power: int) -> dict[str, np.ndarray]:
    """Run the case on a table whose lengths and times are 2**power as long."""
    unit, starts = math.ldexp(1.0, power), scattered()
    lines = [f"{x * unit!r} {y * unit!r} {ux!r} {uy!r}\n" for x, y, ux, uy in starts]
    (folder / "start.txt").write_text("".join(lines))
    settings = {"duration": DURATION * unit, "transient_duration": 3.0 * unit}
    if engine == "timestep":
        settings["time_step"] = 0.01 * unit
    ended = calculate(
        folder,
        {key: repr(value * unit) for key, value in TABLE.items()},
        engine,
        f"scale{power}",
        number=len(starts),
        particles={"initial_file": "'start.txt'"},
        run={key: repr(value) for key, value in settings.items()},
        output={
            "series_interval": repr(0.7 * unit),
            "snapshot_times": f"0, {1.5 * unit!r}, {20 * unit!r}",
            "event_log": ".true.",
            "final_state": ".true.",
        },
    )
    assert ended.returncode == 0, ended.stderr
    return read(folder / f"scale{power}.h5")


def factor(name: str, power: int) -> float:
    """Give what a dataset is multiplied by on a scaled table."""
    if name in LENGTHS:
        return math.ldexp(1.0, power)
    rate = name.rsplit("/", 1)[-1].startswith(("current", "flow", "polarised_current"))
    return math.ldexp(1.0, -power) if rate else 1.0


@pytest.mark.parametrize("engine", EXACT)
def test_a_power_of_two_in_all_lengths_and_times_changes_no_bit_but_the_factor(
    tmp_path: Path, engine: str
) -> None:
    """Events, states, series and averages are those of the table of radius 1, to the last bit."""
    one = scaled(tmp_path, engine, 0)
    assert len(one["events/time"]) > 100
    assert np.all(np.isfinite(one["chi"]))
    for power in POWERS:
        other = scaled(tmp_path, engine, power)
        assert other.keys() == one.keys()
        for name in one.keys() - {"cpu_seconds", "seed"}:
            if name.startswith("provenance/"):
                continue
            expected = one[name]
            if expected.dtype.kind == "f":
                expected = expected * factor(name, power)
            np.testing.assert_array_equal(other[name], expected, f"{name} at 2**{power}")


@pytest.mark.parametrize("scale", ["1e-13", "1e-20", "1e-60", "1e60"])
def test_a_run_is_as_long_as_it_is_to_be_at_any_scale(tmp_path: Path, scale: str) -> None:
    """Fifty radii are fifty radii."""
    unit = float(scale)
    table = {key: repr(value * unit) for key, value in TABLE.items()}
    ended = calculate(tmp_path, table, run={"duration": repr(50 * unit)})
    assert ended.returncode == 0, ended.stderr
    assert "***" not in ended.stdout
    found = read(tmp_path / "case.h5")
    assert found["time"][0, 0] == pytest.approx(50 * unit, rel=1e-12, abs=0)
    assert found["collisions"][0, 0] > 500


@pytest.mark.parametrize("engine", ENGINES)
def test_the_snapshot_at_the_start_is_what_was_given(tmp_path: Path, engine: str) -> None:
    """Not what an engine makes of it: to the last digit of place and direction."""
    lines = [f"{x!r} {y!r} {ux!r} {uy!r}\n" for x, y, ux, uy in PLACES]
    (tmp_path / "start.txt").write_text("".join(lines))
    settings = {"duration": "2"}
    if engine == "timestep":
        settings["time_step"] = "0.01"
    ended = calculate(
        tmp_path,
        TABLE,
        engine,
        number=len(PLACES),
        particles={"initial_file": "'start.txt'"},
        run=settings,
        output={"snapshot_times": "0, 1"},
    )
    assert ended.returncode == 0, ended.stderr
    found = read(tmp_path / "case.h5")
    given = np.array(PLACES).T
    given[2:] /= np.hypot(given[2], given[3])
    for name, expected in zip(("x", "y", "ux", "uy"), given, strict=True):
        first = np.moveaxis(found[f"snapshots/{name}"], -1, 0).reshape(len(PLACES), -1)[:, 0]
        np.testing.assert_array_equal(first, expected, name)


# Tables at the ends of what is allowed.
ODD = {
    "narrow": {"channel1_width": "1e-12", "channel2_width": "1e-12"},
    "narrow and closed": {"channel1_width": "1e-12", "channel2_width": "0"},
    "nearly all opening": {"channel1_width": "1.999999999999", "channel2_width": "1.999999999999"},
    "one nearly all opening": {"channel1_width": "1.999999999999", "channel2_width": "1e-9"},
    "long": {"channel1_length": "1e12", "channel1_width": "1.1", "channel2_width": "0"},
    "both long": {"channel1_length": "1e6", "channel2_length": "3e6"},
    "short": {"channel1_length": "1e-12", "channel2_length": "1e-12"},
    "a closed channel counts for nothing": {"channel2_length": "1e300", "channel2_width": "0"},
    "no channel 2": {"shape": "'urn'", "channel2_length": "1e300", "channel2_width": "1e300"},
}


@pytest.mark.parametrize("engine", ["excursion", "collision", "synchronous", "reservoir"])
@pytest.mark.parametrize("case", ODD)
def test_what_is_allowed_runs(tmp_path: Path, engine: str, case: str) -> None:
    """No table within the bounds loses a particle, stops the program or never begins."""
    short = {"collisions": "100", "transient_collisions": "0"}
    ended = calculate(tmp_path, ODD[case], engine, number=20, run=short)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("gap", [1e-4, 5e-5, 1e-6, 1e-9])
def test_a_particle_beside_the_wall_of_a_wide_channel_is_located_before_it_enters_the_urn(
    tmp_path: Path, gap: float
) -> None:
    """There the path in the urn makes many short chords; traced back it has lost digits.

    All start in channel 1, along its wall, and are still there at the time of the snapshot.
    """
    half_width = 1 - gap
    offsets = [0.0, *(10 ** np.random.default_rng(3).uniform(-16, -11, 400))]
    starts = [(-0.1, -half_width * (1 - offset), 1.0, 0.0) for offset in offsets]
    table = {"channel1_width": 2 * half_width, "channel2_width": 0.0}
    hits = []
    for engine in ("excursion", "collision"):
        found = from_starts(tmp_path, starts, table, engine, 1.0, "0.3")
        hits.append(found["collisions"].item())
        np.testing.assert_allclose(found["snapshots/x"].ravel(), 0.2, rtol=0, atol=1e-8)
        heights = np.array([start[1] for start in starts])
        np.testing.assert_allclose(found["snapshots/y"].ravel(), heights, rtol=0, atol=1e-8)
    assert len(set(hits)) == 1, hits


def test_who_starts_at_the_mouth_of_a_channel_into_its_wall_hits_it(tmp_path: Path) -> None:
    """The hit is still to come, however near to the corner it is."""
    mouth = {0.15: (0.5, -1), 0.05: (0.5 + math.sqrt(1 - 0.15**2) + math.sqrt(1 - 0.05**2), 1)}
    starts = [
        (side * at, high * half_width, side * way, high * slope)
        for half_width, (at, way) in mouth.items()
        for side in (1, -1)
        for high in (1, -1)
        for slope in (1e-12, 1e-3, 0.1, 0.5)
    ]
    table = {"channel1_width": 0.3, "channel2_width": 0.1}
    hits = [from_starts(tmp_path, starts, table, engine, 0.2)["collisions"].item()
            for engine in ("excursion", "collision", "synchronous")]  # fmt: skip
    assert len(set(hits)) == 1, hits
    assert hits[0] >= len(starts)


@pytest.mark.parametrize("width", [0.3, 0.01, 1e-6, 1.999999999998])
@pytest.mark.parametrize("speed", [1e-3, 1e-6, 1e-10])
@pytest.mark.parametrize("shape", ["disc", "polygon"])
def test_a_slow_particle_in_a_channel_is_located_before_it_enters_the_urn(
    tmp_path: Path, width: float, speed: float, shape: str
) -> None:
    """The path in the urn, and the long time before it, take no digit from the place."""
    outline = {"urn_shape": "'polygon'", "urn_vertices": "1, -1, 1, 1, 0.1, 1.7, -1, 0.6, -1, -0.5"}
    random = np.random.default_rng(5)
    starts = [
        (-0.25, 0.49 * width * random.uniform(-1, 1), -speed, random.choice([-1.0, 1.0]))
        for _ in range(40)
    ]
    table = {"channel1_width": width, "channel2_width": 0.0}
    table |= outline if shape == "polygon" else {}
    one, other = (from_starts(tmp_path, starts, table, engine, 0.1, "0.01, 0.09")
                  for engine in ("excursion", "collision"))  # fmt: skip
    for name in ("x", "y", "ux", "uy"):
        values = [found[f"snapshots/{name}"] for found in (one, other)]
        np.testing.assert_allclose(*values, rtol=0, atol=2e-11, err_msg=name)
    assert one["collisions"].item() == other["collisions"].item()


def test_a_visit_of_many_short_chords_takes_no_digit_from_the_channel_before(
    tmp_path: Path,
) -> None:
    """Some 8000 hits at a cosine of 0.016; until then the particle flies straight."""
    x, ux, time = -0.17456781466393767, -0.015723350768998542, 0.0408
    start = (x, -0.00022314587001215824, ux, 0.9998763804794045)
    table = {"channel1_width": 0.0014559289346818662, "channel1_length": 0.4160723875504878,
             "channel2_width": 0.0015419199815254216}  # fmt: skip
    found = from_starts(tmp_path, [start], table, "excursion", 5.0, repr(time))
    assert found["snapshots/x"].item() == pytest.approx(x + ux * time, abs=2e-11)
    assert found["snapshots/ux"].item() == pytest.approx(ux, abs=2e-11)


def test_who_comes_out_of_a_narrow_slot_after_a_million_hits_goes_on(tmp_path: Path) -> None:
    """The slot is 2e-6 of the polygon's width; its path is shorter than others with few hits."""
    corners = (
        "1, -0.5, 1, 0.5, 0.250004, 0.5, 0.250004, 1.5, 0.25, 1.5, 0.25, 0.5, -1, 0.5, -1, -0.5"
    )
    table = {"urn_shape": "'polygon'", "urn_vertices": corners, "channel1_width": 0.5}
    one, other = (from_starts(tmp_path, [(-1.249998, 0.6, 1.0, 0.2)],
                              {**table, "channel2_width": 0.0}, engine, 30.0, "9, 24, 30")
                  for engine in ("excursion", "collision"))  # fmt: skip
    np.testing.assert_allclose(one["snapshots/x"].ravel()[1:], [0.783938, 2.332578], atol=1e-5)
    for name in ("snapshots/x", "snapshots/y", "collisions", "trapped"):
        np.testing.assert_allclose(one[name], other[name], rtol=0, atol=1e-8, err_msg=name)


# What no number can represent, and the key that is told.
REFUSED = [
    *[
        ("channel1_width", {"channel1_width": f"1e-{k}", "channel2_width": "0"})
        for k in (13, 16, 17, 20, 40, 160, 300)
    ],
    ("channel2_width", {"channel2_width": "1e-20"}),
    ("channel1_width", {"channel1_width": "1.99999999999999"}),
    ("channel1_length", {"channel1_length": "1e6", "channel1_width": "1e-9"}),
    ("channel1_length", {"channel1_length": "1e300"}),
    ("channel1_length", {"channel1_length": "1e-300"}),
    ("channel2_length", {"channel2_length": "1e-300"}),
    ("urn_radius", {"urn_radius": "1e160"}),
    ("urn_radius", {"urn_radius": "1e-160"}),
    ("duration", {"duration": "1e300"}),
    ("duration", {"duration": "1e-300"}),
    ("start_time", {"start_time": "1e300", "duration": "10"}),
    ("time_step", {"engine": "'timestep'", "duration": "10", "time_step": "1e-300"}),
    ("transient_duration", {"duration": "10", "transient_duration": "9.999999999999998"}),
    ("number", {"channel1_width": "1e-12", "channel2_width": "0", "number": "100000000"}),
]


@pytest.mark.parametrize(("key", "given"), REFUSED)
def test_what_cannot_be_represented_is_refused(
    tmp_path: Path, key: str, given: dict[str, str]
) -> None:
    """Exit 2 with the one key, its value and what is allowed; nothing is written."""
    (tmp_path / "case.nml").write_text(
        namelist(
            table={name: value for name, value in given.items() if name in {"urn_radius", *TABLE}},
            particles={"number": given.get("number", "100")},
            gate={"threshold": "2"},
            run={
                name: value
                for name, value in given.items()
                if name not in {"urn_radius", "number", *TABLE}
            },
        )
    )
    ended = run("--check", "case.nml", folder=tmp_path)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    lines = [line for line in ended.stderr.splitlines() if f" {key} = " in line]
    assert lines, ended.stderr
    assert "allowed: " in lines[0]


@pytest.mark.parametrize("engine", ENGINES[:3])
@pytest.mark.parametrize("x", [-0.25, 0.25])
def test_a_run_may_end_with_a_particle_on_the_counted_line(
    tmp_path: Path, engine: str, x: float
) -> None:
    """What happens at the very end is not made any more, and is no fault."""
    (tmp_path / "start.txt").write_text(f"{x} 0.0625 {math.copysign(1, -x)} 0\n")
    (tmp_path / "case.nml").write_text(
        namelist(
            particles={"number": 1, "initial_file": "'start.txt'"},
            gate={"threshold": 1},
            run={"engine": f"'{engine}'", "duration": 0.25},
            output={"file": "'out.h5'", "final_state": ".true."},
        )
    )
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    with h5py.File(tmp_path / "out.h5") as file:
        assert abs(file["final/x"][0, 0, 0]) < 1e-15


@pytest.mark.parametrize("engine", ENGINES[:3])
@pytest.mark.parametrize(
    ("x", "way"), [(-0.3, 6e-17), (0.0, -1.8e-16), (-0.5, 6e-17), (0.3, -6e-17)]
)
def test_an_upright_direction_in_a_channel_may_be_rounded(
    tmp_path: Path, engine: str, x: float, way: float
) -> None:
    """As cos(pi/2) is: in a gate, on the counted line, on an opening; no gate counts it."""
    starts = [(x, 0.0, way, 1.0), (-0.9, 0.0, 1.0, 0.01), (0.9, 0.0, -1.0, 0.01)]
    found = from_starts(tmp_path, starts, TABLE, engine, 5.0, "5", threshold=1)
    assert found["trapped"].item() == 1
    assert found["reversals"].sum() == 0
    assert found["chi"].item() == pytest.approx(1 / 3)
    assert found["snapshots/x"].ravel()[0] == x


@pytest.mark.parametrize("engine", ENGINES[:3])
@pytest.mark.parametrize("disc", [{}, {"scatterers": "-0.3, 0.2, 0.02"}], ids=["straight", "disc"])
def test_crossings_of_both_channels_at_one_instant_have_one_order(
    tmp_path: Path, engine: str, disc: dict[str, str]
) -> None:
    """One of either at t = 1/4: channel 1 comes first, whatever the order of the file."""
    table = {"urn_shape": "'polygon'", "urn_vertices": "1,-1,1,1,-1,1,-1,-1",
             "channel1_width": 0.5, "channel2_width": 0.5, **disc}  # fmt: skip
    starts = [(-2.75, 0, -1, 0), (0.25, 0.125, -1, 0), (-1.25, 0.6, 0.6, 0.8),
              (1.25, 0.6, 0.6, 0.8), (1.3, 0.6, 0.6, 0.8)]  # fmt: skip
    orders = {"given": starts, "reversed": starts[::-1]}
    for name, order in orders.items():
        (tmp_path / name).mkdir()
        found = from_starts(tmp_path / name, order, table, engine, 1.0)
        assert found["polarised_current"].item() == 0.0

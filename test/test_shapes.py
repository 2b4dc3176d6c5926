"""Urns that are polygons, from the namelist to results and pictures."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
from matplotlib.path import Path as Outline
from support.program import namelist, run

from postproc.figures import scene
from postproc.reading.grid import open_results
from postproc.reading.groups import snapshot_of
from postproc.reading.points import by_point
from postproc.tests.commands import call

if TYPE_CHECKING:
    from pathlib import Path

HEAD = (
    "&particles number = 40 /\n&gate threshold = 2 /\n&run collisions = 20000 /\n"
    "&output file = 'o.h5', snapshot_times = 0, 0.25, 5, final_state = T /\n"
)
EXACT = ("excursion", "collision", "synchronous")
SQUARE = "1,-1, 1,1, -1,1, -1,-1"
# It reaches in, and over channel 1.
REACHING = (
    "1.0,-0.6, 1.0,0.6, 1.4,0.7, 1.3,1.2, -0.5,1.1, -0.6,0.3, -1.0,0.9, -1.2,0.5, -1.2,-0.5, "
    "-0.3,-1.0, 0.2,-0.4, 0.7,-1.1"
)
WRONG = {
    "shape = 'urn' urn_vertices = 1,2,3": ["urn_vertices is given; allowed: nothing, since"],
    "urn_shape = 'polygon'": ["urn_shape = 'polygon'; allowed: with urn_vertices or urn_sides"],
    "urn_shape = 'polygon' urn_sides = 7": ["urn_sides = 7; allowed: even numbers"],
    "urn_shape = 'polygon' urn_sides = 2": ["urn_sides = 2"],
    "urn_shape = 'polygon' urn_vertices = 1, -1, x": ["urn_vertices = 1, -1, x"],
    f"urn_shape = 'polygon' urn_sides = 6 urn_vertices = {SQUARE}": ["given beside corners"],
    f"urn_shape = 'polygon' urn_radius = 1 urn_vertices = {SQUARE}": [
        "urn_radius is given beside urn_vertices; allowed: one of the two"
    ],
    "urn_shape = 'polygon' urn_vertices = 1,-1, 1,1, 0": ["has 5 numbers"],
    "urn_shape = 'polygon' urn_vertices = 1,-1, 1,1": ["has 2 corners; allowed: three corners"],
    "urn_shape = 'polygon' urn_vertices = 1,-1, 1,1, 1,1, -1,1, -1,-1": [
        "the side from corner 2 to 3, which has no length"
    ],
    "urn_shape = 'polygon' urn_vertices = 1,-1, 1,1, -1,-1, -1,1": [
        "the side from corner 2 to 3, which meets the side from corner 4 to 1"
    ],
    "urn_shape = 'polygon' urn_vertices = 1,-1, 1,1, 1,3, 1,2, -1,1, -1,-1": [
        "the side from corner 2 to 3, which meets the side from corner 3 to 4"
    ],
    # A slot, a visit to which has 1e9 hits.
    "urn_shape = 'polygon' urn_vertices = 1,-1, 1,1, 1e-9,1, 0,2, -1e-9,1, -1,1, -1,-1": [
        "the side from corner 2 to 3, which meets the side from corner 4 to 5",
        "sides that are 3e-6 apart",
    ],
    "urn_shape = 'polygon' urn_vertices = 1,-1, 1.2,1, -1,1, -1.2,-1": [
        "the side from corner 1 to 2, which is not upright, where channel 1 is to begin",
        "the side from corner 3 to 4, which is not upright, where channel 2 is to begin",
    ],
    "urn_shape = 'polygon' urn_vertices = 1,-1, 2,0, 1,1, -1,1, -1,-1": [
        "has a corner on the axis y = 0 or no side there, where channel 1 is to begin"
    ],
    "urn_shape = 'polygon' channel1_width = 1.5 channel2_width = 1.9 "
    "urn_vertices = 1,-0.7, 1,1, -1,1, -1,-0.7": [
        "channel1_width = 1.5; allowed: below 1.4",
        "channel2_width = 1.9; allowed: below 1.4",
    ],
    f"urn_shape = 'polygon' channel1_length = 0.6 urn_vertices = {REACHING}": [
        "has corner 3, which is 0.39",
        "beyond the beginning of channel 1; allowed: short of its middle, which is 0.3 beyond",
    ],
    "urn_shape = 'polygon' channel1_width = 0.3 urn_vertices = "
    "1,-0.6, 1,0.6, 1.2,0.1, 1.1,1.2, -1,1, -1,-1": ["lies in channel 1"],
    # A corner on another side: that is level, or slanted so that rounding hides it.
    "urn_shape = 'polygon' urn_vertices = 1,-1, 1,1, 0,-1, -1,1, -1,-1": [
        "the side from corner 2 to 3, which meets the side from corner 5 to 1"
    ],
    "urn_shape = 'polygon' urn_vertices = 1,-0.7, 1,1, 0.3,-0.84, -1,1, -1,-1.1": [
        "the side from corner 2 to 3, which meets the side from corner 5 to 1"
    ],
}
# Those of more than one.
FAULTS = {
    table: 2 for table in WRONG if "which is not upright" in WRONG[table][0] or "1.9" in table
}


@pytest.mark.parametrize("table", WRONG)
def test_a_polygon_that_cannot_be_is_refused(tmp_path: Path, table: str) -> None:
    """With its key, the corner and what is allowed; all of it at once, each fault in one line."""
    (tmp_path / "c.nml").write_text(f"{HEAD}&table {table} /\n")
    ended = run("--check", "c.nml", folder=tmp_path)
    assert ended.returncode == 2, ended.stdout + ended.stderr
    told = [line for line in ended.stderr.splitlines() if "c.nml" in line]
    assert len(told) == FAULTS.get(table, 1)
    for words in WRONG[table]:
        assert sum(words in line for line in told) == 1


def test_polygons_need_corners_in_a_scan_too(tmp_path: Path) -> None:
    """The radius of urns that are given by their corners cannot be scanned, that of others can."""
    text = f"{HEAD}&table urn_shape = 'polygon' WHAT /\n&scan urn_radius = 1, 1.5 /\n"
    (tmp_path / "c.nml").write_text(text.replace("WHAT", f"urn_vertices = {SQUARE}"))
    ended = run("--check", "c.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "urn_radius is scanned beside urn_vertices" in ended.stderr
    (tmp_path / "c.nml").write_text(text.replace("WHAT", "urn_sides = 6"))
    assert run("--check", "c.nml", folder=tmp_path).returncode == 0


def test_clockwise_corners_are_turned_round_with_a_note(tmp_path: Path) -> None:
    """The task is the same as that of the corners the other way round."""
    square = "1,-1, -1,-1, -1,1, 1,1"
    seeds = []
    for corners, told in ((SQUARE, False), (square, True)):
        text = f"{HEAD}&table urn_shape = 'polygon' urn_vertices = {corners} /\n"
        (tmp_path / "c.nml").write_text(text)
        ended = run("--check", "c.nml", folder=tmp_path)
        assert ended.returncode == 0, ended.stderr
        assert ("urn 1 turned round to run counterclockwise" in ended.stdout) == told
        assert run("c.nml", folder=tmp_path).returncode == 0
        with h5py.File(tmp_path / "o.h5") as file:
            assert file.attrs["urn_shape"] == "polygon"
            corner = file.attrs["urn_vertices"]
            seeds.append(file["seed"][()].item())
        x, y = corner.T
        assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) == 8.0
        (tmp_path / "o.h5").unlink()
    assert corner.shape == (4, 2)
    assert seeds[0] == seeds[1]


@pytest.mark.parametrize("engine", ["excursion", "collision", "synchronous", "reservoir"])
@pytest.mark.parametrize(
    "table",
    [
        f"urn_vertices = {REACHING}", "urn_sides = 6 urn_radius = 1.3",
        f"urn_vertices = {REACHING} urn2_vertices = {SQUARE}", "urn_sides = 4 urn_radius = 1.3, 1",
    ],
)  # fmt: skip
def test_pictures_have_all_particles_inside(tmp_path: Path, table: str, engine: str) -> None:
    """Walls are those of the run: in snapshots nobody is outside of them."""
    text = f"{HEAD}&table urn_shape = 'polygon' {table} /\n&run engine = '{engine}' /\n"
    text = text.replace("&run collisions = 20000 /\n", "").replace(
        "&run engine", "&run collisions = 20000 engine"
    )
    (tmp_path / "c.nml").write_text(text)
    ended = run("c.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    results = by_point(open_results(tmp_path / "o.h5"))
    circuit = results["circuit"].values[0]
    snapshots = [snapshot_of(results, 0, 0, index) for index in range(3)]
    walls = np.vstack(scene.walls(circuit))
    outline = Outline(_boundary(scene.walls(circuit)))
    for shot in snapshots:
        places = np.column_stack([shot.x, shot.y])
        inside = outline.contains_points(places, radius=1e-9)
        inside |= outline.contains_points(places, radius=-1e-9)
        assert inside.all()
    assert walls[:, 0].max() == pytest.approx(float(circuit.sides[1].end))
    assert walls[:, 0].min() == pytest.approx(-float(circuit.sides[0].end))


HALF, FAR = 0.25, 0.25 + 2.0 * np.sqrt(1.0 - 0.25**2)


OCTAGON = "urn_shape = 'polygon', urn_vertices = 1,-.5,1,.5,.5,1,-.5,1,-1,.5,-1,-.5,-.5,-1,.5,-1,"


@pytest.mark.parametrize(
    ("start", "urns"),
    [(f"-0.09375 {HALF} 1 0", ""), (f"{FAR + 0.25} -{HALF} 1 0", ""), (f"0.25 {HALF} 2 -1", ""),
     (f"0.25 {HALF} 3 1", ""), ("-0.25 0.1 0 1", OCTAGON),
     ("2.25 0.1 0 -1", OCTAGON)],
)  # fmt: skip
def test_who_begins_at_the_end_or_along_an_opening_is_where_it_is(
    tmp_path: Path, start: str, urns: str
) -> None:
    """As by the engine that counts hits.

    It enters a disc at the end of its arc, along the wall of either channel or from the corner, or
    moves along the line of an opening, which is in the urn.
    """
    (tmp_path / "start.txt").write_text(f"{start}\n")
    widths = f"channel1_width = {2 * HALF}, channel2_width = {2 * HALF}"
    places = {}
    for engine in ("excursion", "collision"):
        (tmp_path / "c.nml").write_text(
            f"&particles number = 1, initial_file = 'start.txt' /\n&gate threshold = 9 /\n"
            f"&table {urns} {widths}, channel1_length = 0.5, channel2_length = 1 /\n"
            f"&run engine = '{engine}', duration = 3 /\n"
            f"&output file = '{engine}.h5', snapshot_times_range = 0.0625, 2.9375, 47 /\n"
        )
        ended = run("c.nml", folder=tmp_path)
        assert ended.returncode == 0, ended.stderr
        with h5py.File(tmp_path / f"{engine}.h5") as file:
            places[engine] = np.array([file[f"snapshots/{name}"][0, 0, :, 0] for name in "xy"])
    assert places["excursion"] == pytest.approx(places["collision"], abs=1e-9)


SLANTED = (
    "urn_shape = 'polygon', channel1_width = 1.3, channel2_width = 1.3, urn_vertices = "
    "1,-1.3, 1,1.3, 0,3.175, -3,3.175, -3,-3.175, 0,-3.175"
)
# A side below or above sends the particle along the opening of channel 1 or of channel 2.
ALONG_IN_POLYGONS = {
    "gate": (SLANTED,
             "-0.5259515570934256 -1.317409169550173 0.8304498269896193 0.5570934256055363", 0.5),
    "channel2": ("urn_shape = 'polygon', channel1_width = 0.5, channel2_width = 1.3, "
                 "urn_vertices = 3,-3.175, 3,3.175, 0,3.175, -1,1.3, -1,-1.3, 0,-3.175",
                 "-4.474048442906574 1.317409169550173 -0.8304498269896193 -0.5570934256055363",
                 4.5),
    "gate, from beside it": (SLANTED, "-0.5000000000000001 0.37 2.2e-17 1", 0.5),
    "gate, from within it": (SLANTED, "-0.49999999999999956 0.1366 3e-16 1", 0.5),
    "gate, from its line": (SLANTED, "-0.5 0.37 2.2e-17 1", 0.5),
    "short gate": (f"{SLANTED}, channel1_length = 0.01", "-0.005 0.37 3e-14 1", 0.005),
}  # fmt: skip
ALONG_IN_DISCS = {
    "disc": ("urn_radius = 4.25, channel1_width = 4, channel2_width = 0",
             "-0.50732421875 -2.004913330078125 240 161", 0.5),
    "disc, exactly": ("shape = 'urn', urn_radius = 0.8149801915519674, channel1_length = 2.25, "
                      "channel1_width = 0.6269078396553596",
                      "-1.8425110460593714 0.7526067856611007 28560 239", 1.125),
    "disc, far away": ("shape = 'urn', urn_radius = 1.625, channel1_length = 4096, "
                       "channel1_width = 1.25",
                       "-2050.6083374023438 1.0119400024414062 3369960 3455641", 2048.0),
}  # fmt: skip


def flown(folder: Path, table: str, start: str, of_run: str, output: str) -> Path:
    """Run one particle from a start; return the path of the results."""
    folder.mkdir(exist_ok=True)
    (folder / "s.txt").write_text(f"{start}\n")
    (folder / "o.nml").write_text(
        f"&table {table} /\n&particles number = 1, initial_file = 's.txt' /\n"
        f"&gate threshold = 1 /\n&run {of_run} /\n&output file = 'o.h5', {output} /\n"
    )
    ended = run("o.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    return folder / "o.h5"


@pytest.mark.parametrize(
    ("case", "engine"),
    [
        *((case, engine) for case in ALONG_IN_POLYGONS | ALONG_IN_DISCS for engine in EXACT),
        # By steps, reflections from an arc are approximations.
        *((case, "timestep") for case in ALONG_IN_POLYGONS),
    ],
)
def test_who_is_reflected_along_an_opening_passes_over_it(
    tmp_path: Path, case: str, engine: str
) -> None:
    """In the channel it would run from wall to wall for ever, and a gate would count it."""
    table, start, chord = (ALONG_IN_POLYGONS | ALONG_IN_DISCS)[case]
    step = ", time_step = 0.0009765625" if engine == "timestep" else ""
    path = flown(tmp_path, table, start, f"duration = 5, engine = '{engine}'{step}",
                 "final_state = T, event_log = T")  # fmt: skip
    with h5py.File(path) as file:
        assert abs(abs(file["final/x"][0, 0, 0]) - chord) > 0.1
        assert file["events/kind"].size == 0


OVER = "urn_shape = 'polygon', channel1_width = 0.3, channel2_width = 0, urn_vertices = "
# Starts of which rounding says when they cross the line of an opening, and when they hit a wall.
UPRIGHT = {
    "T, low": (f"{OVER} 0,-1, 0,1, .3,1, .3,1.3, -1,1.3, -1,-1, channel1_length = 1.3",
               "0.65 1.2 -6.123233995736766e-17 -1"),
    "T, high": (f"{OVER} 0,-1, 0,1, .3,1, .3,1.5, -1,1.5, -1,-1, channel1_length = 0.9",
                "-0.45 1.2 6.123233995736766e-17 -1"),
    "wedge": (f"{OVER} 0,-.6, 0,.6, .1,.9, -.8,.9, -.8,-.6, channel1_length = 1.5",
              "0.75 0.85 -1.8369701987210297e-16 -1"),
    "wide disc": ("channel1_width = 1.8, channel2_width = 0",
                  "-0.5000000000020187 -0.6652489469725353 2.018718525675922e-12 "
                  "1.5652489469725355"),
    # A passage of the channel would take longer than the clock resolves: it is upright.
    "long channel": ("channel1_width = 0.9, channel1_length = 1e9, channel2_width = 0",
                     "-2.5e8 0.1 9e-4 1"),
}  # fmt: skip


@pytest.mark.parametrize("engine", EXACT)
def test_the_length_of_a_closed_channel_changes_nothing(tmp_path: Path, engine: str) -> None:
    """Its particle enters the gate nearly along it."""
    ends = []
    for length in (1.0, 1e12):
        table = f"channel1_width = 1, channel2_width = 0, channel2_length = {length}"
        path = flown(tmp_path / str(length), table, "-0.5001 -0.4 5e-4 1",
                     f"duration = 5, engine = '{engine}'", "final_state = T")  # fmt: skip
        with h5py.File(path) as file:
            ends.append([file[f"final/{name}"][0, 0, 0] for name in ("x", "y", "ux", "uy")])
    assert ends[0] == ends[1]
    assert ends[0][0] > -0.5


@pytest.mark.parametrize("engine", EXACT)
@pytest.mark.parametrize("case", UPRIGHT)
def test_who_moves_nearly_along_an_opening_flies_freely_at_first(
    tmp_path: Path, case: str, engine: str
) -> None:
    table, start = UPRIGHT[case]
    path = flown(tmp_path, table, start, f"duration = 3.3, engine = '{engine}'",
                 "snapshot_times = 0.0625, 0.125")  # fmt: skip
    _, height, _, u_y = (float(word) for word in start.split())
    upwards = np.sign(u_y)
    with h5py.File(path) as file:
        moved = file["snapshots/y"][0, 0, :, 0] - height
    assert moved == pytest.approx([0.0625 * upwards, 0.125 * upwards], abs=1e-11)


@pytest.mark.parametrize("engine", EXACT)
def test_from_corner_to_corner_nobody_flies_outside(tmp_path: Path, engine: str) -> None:
    """Turned by a sharp corner along the line that joins it to another one, over a notch."""
    (tmp_path / "start.txt").write_text("-1.5 -0.5 0.6 0.8\n")
    text = namelist(
        table={"urn_shape": "'polygon'", "urn_vertices": "1, -1, 1, 1, 0, 0.5, -1, 1, -1, -1",
               "channel1_width": 0.5, "channel1_length": 0.75, "channel2_width": 0.25},
        particles={"number": 1, "initial_file": "'start.txt'"}, gate={"threshold": 1},
        run={"engine": f"'{engine}'", "duration": 3}, output={"final_state": ".true."},
    )  # fmt: skip
    (tmp_path / "a.nml").write_text(text)
    assert run("--quiet", "a.nml", folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "battery.h5") as file:
        place = [file[f"final/{name}"][0, 0, 0] for name in "xy"]
    # Either side of the corner will do: both paths are known.
    ends = np.array([[-1.05, 0.1], [-0.69, -0.08]])
    assert np.abs(ends - place).sum(axis=1).min() < 1e-9


@pytest.mark.parametrize("start", ["-0.5 0.1 0 1", "-2.5 0.1 0 1"])
def test_by_steps_who_runs_along_a_side_is_reflected_at_its_end(tmp_path: Path, start: str) -> None:
    """Beyond a corner two sides are as near: one along which it moves, and one that it has hit."""
    path = flown(tmp_path, f"{OVER} 0,-1, 0,1, -2,1, -2,-1", start, "engine = 'timestep', "
                 "time_step = 0.0009765625, duration = 9.3", "final_state = T")  # fmt: skip
    with h5py.File(path) as file:
        assert file["collisions"][0, 0] == 5
        assert file["final/y"][0, 0, 0] == pytest.approx(0.6)


def test_who_runs_along_a_wall_into_its_corner_is_not_trapped(tmp_path: Path) -> None:
    """Two hits in one corner, with directions that rounding alone tells apart, are no orbit."""
    (tmp_path / "start.txt").write_text("2.125 0.5 -0.6 0.8\n")
    corners = "-1, -1, 1, -1, 1, 1, 0.25, 1, 0, 0.5, -0.25, 1, -1, 1"
    text = namelist(
        table={"urn_shape": "'polygon'", "urn_vertices": corners, "channel2_width": 0.25,
               "channel2_length": 0.5},
        particles={"number": 1, "initial_file": "'start.txt'"}, gate={"threshold": 50},
        run={"duration": 13}, output={"snapshot_times": "5, 6, 7, 8, 9, 10, 11, 12"},
    )  # fmt: skip
    (tmp_path / "a.nml").write_text(text)
    assert run("--quiet", "a.nml", folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "battery.h5") as file:
        assert file["trapped"][0, 0] == 0
        assert (np.diff(file["snapshots/x"][0, 0, :, 0]) != 0.0).all()


def _boundary(walls: list[np.ndarray]) -> np.ndarray:
    """Return the walls of the circuit as one closed line."""
    upper1, lower1, upper2, lower2 = walls
    return np.vstack([upper1, lower1, lower2[::-1], upper2[::-1]])


def test_who_meets_a_corner_after_many_events_of_another_is_not_trapped(tmp_path: Path) -> None:
    """In `synchronous` each event moves all, so rounding puts particle 1 far beyond its side."""
    (tmp_path / "s.txt").write_text("2.3 -0.4 1 -3\n3 0.00025 0.001 1\n")
    found = {}
    for engine in ("collision", "synchronous"):
        (tmp_path / "o.nml").write_text(
            f"&table urn_shape = 'polygon', urn_vertices = {SQUARE}, channel1_width = 0.25, "
            "channel2_width = 0.001, channel2_length = 2 /\n"
            "&particles number = 2, initial_file = 's.txt' /\n&gate threshold = 2 /\n"
            f"&run duration = 5, engine = '{engine}' /\n"
            f"&output file = '{engine}.h5', final_state = T /\n"
        )
        ended = run("o.nml", folder=tmp_path)
        assert ended.returncode == 0, ended.stderr
        with h5py.File(tmp_path / f"{engine}.h5") as file:
            found[engine] = [file[f"final/{name}"][()].ravel() for name in ("x", "y", "ux", "uy")]
    np.testing.assert_allclose(found["synchronous"], found["collision"], rtol=0, atol=1e-9)


def test_theories_take_the_area_or_say_that_they_know_discs_only(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A square of side 2 has A = 4 in the window's and the renewal gate's theory."""
    words = ["--number", "1000", "--threshold", "7"]
    words += ["--urn-vertices", *SQUARE.replace(",", " ").split()]
    for model in ("window", "renewal", "direction"):
        code = call("theory", [*words, "--model", model])
        said = capsys.readouterr()
        if model in ("window", "renewal"):
            assert json.loads(said.out)["urn_area"] == 4.0
        else:
            assert code == 2, model
            assert "discs only" in said.err

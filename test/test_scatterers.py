"""Scatterers from the namelist on: what is refused, what is run, kept, and said of it."""

from __future__ import annotations

import re
import signal
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
from support.program import finish, namelist, run, send, start, wait_for

if TYPE_CHECKING:
    from pathlib import Path

DISCS = "0.03, 0.02, 0.07, -0.2, 0.19, 0.06, 0.18, -0.08, 0.05"
TABLE = {"channel2_width": "0.4", "scatterers": DISCS}


def write(folder: Path, name: str, table: dict[str, str], **more: dict[str, str]) -> str:
    """Write a namelist that is `name`.nml, whose results are `name`.h5; return its name."""
    groups = {
        "table": table,
        "particles": {"number": "60"},
        "gate": {"threshold": "2"},
        "run": {"duration": "30"},
        "output": {"file": f"'{name}.h5'"},
    }
    groups |= {key: groups.get(key, {}) | value for key, value in more.items()}
    (folder / f"{name}.nml").write_text(namelist(**groups))
    return f"{name}.nml"


def refused(folder: Path, table: dict[str, str], **more: dict[str, str]) -> list[str]:
    """Return what is said of a namelist that is refused."""
    ended = run("--check", write(folder, "c", table, **more), folder=folder)
    assert ended.returncode == 2, ended.stdout
    assert not list(folder.glob("c.h5*"))
    return [line for line in ended.stderr.splitlines() if "c.nml" in line]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ("0, 0, 0.1, 0.2", ["has 4 values", "three for each disc"]),
        ("0, 0, 0", ["disc 1 (values 1 to 3: 0, 0, 0) is too small"]),
        ("0, 0, -0.1", ["disc 1 (values 1 to 3: 0, 0, -0.1) is too small"]),
        ("0.4, 0, 0.1", ["disc 1", "reaches into an opening", "channel2_length/2, which is 0.5"]),
        ("0, 0, 0.1, -0.45, 0, 0.06", ["disc 2 (values 4 to 6", "reaches into an opening"]),
        ("0, 0.31, 0.1", ["disc 1", "outside of the channel", "channel2_width/2, which is 0.2"]),
        ("0, 0, 0.1, 0.1, 0.1, 0.05", ["disc 2", "meets disc 1", "discs that are apart"]),
        # They touch, along the channel, and aslant, where rounding could have it either way.
        ("0, 0, 0.125, 0.25, 0, 0.125", ["disc 2", "meets disc 1", "discs that are apart"]),
        ("0, 0, 0.05, 0.06, 0.08, 0.05", ["disc 2", "meets disc 1", "discs that are apart"]),
        ("0, 0, 0.07, 0.072, 0.096, 0.05", ["disc 2", "meets disc 1", "discs that are apart"]),
        # Beside it a gap without width, from which rounding would never let a particle go.
        ("0, 0.1, 0.1", ["disc 1", "touches a wall of the channel", "channel2_width/2"]),
        ("0, -0.137, 0.063", ["disc 1", "touches a wall of the channel", "channel2_width/2"]),
        ("0, 0.5, 0.6", ["reaches into an opening", "|z| + 0.519", "which is how far it reaches"]),
        ("", ["has no value"]),
    ],
)
def test_scatterers_that_cannot_stand_there_are_refused(
    tmp_path: Path, values: str, words: list[str]
) -> None:
    """Key, index, what is allowed."""
    (told,) = refused(tmp_path, {"channel2_width": "0.4", "scatterers": values})
    assert "&table scatterers" in told
    assert "allowed: " in told
    for word in words:
        assert word in told


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    """Each disc, and the engine that cannot."""
    values = "0, 0, 0.1, 0.05, 0, 0.1, 0.45, 0, 0.1, 0, 1, 0.1, 7"
    table = {"channel2_width": "0.4", "scatterers": values}
    told = refused(tmp_path, table, run={"engine": "'reservoir'"})
    assert len(told) == 5
    engine = [line for line in told if "&run engine" in line]
    assert re.search(r"'reservoir'.* scatterers; allowed: 'excursion', 'collision'", engine[0])
    for word in ("meets", "opening", "outside", "13 values"):
        assert sum(word in line for line in told) == 1


@pytest.mark.parametrize("engine", ["reservoir", "timestep"])
def test_engines_that_cannot_say_so(tmp_path: Path, engine: str) -> None:
    """With the names of those that can."""
    (told,) = refused(tmp_path, TABLE, run={"engine": f"'{engine}'", "time_step": "0.01"})
    assert "allowed: 'excursion', 'collision'" in told


def test_a_point_whose_channel_has_no_room_is_named(tmp_path: Path) -> None:
    """Of a scan, before anything runs."""
    table = {"channel2_width": "0.4", "scatterers": "0.3, 0, 0.1"}
    told = refused(tmp_path, table, scan={"channel2_length": "2, 1, 0.7"})
    assert len(told) == 1
    assert "reaches into an opening" in told[0]
    assert "(1 of 3 points: channel2_length = 0.7)" in told[0]
    table = {"scatterers": "0.1, 0.1, 0.06"}
    told = refused(tmp_path, table, scan={"channel2_width": "0.4, 0.05"})
    assert "(1 of 2 points: channel2_width = 0.05)" in told[0]
    told = refused(tmp_path, {"scatterers": "0, 1, 0.1"}, scan={"channel2_width": "0.3, 0.4, 0.5"})
    assert len(told) == 1
    assert "outside of the channel" in told[0]


def test_a_channel_that_is_not_there_has_none(tmp_path: Path) -> None:
    """Closed, or of the single urn."""
    assert "closed" in refused(tmp_path, {"channel2_width": "0", "scatterers": "0, 0, 0.1"})[0]
    assert "no channel 2" in refused(tmp_path, {"shape": "'urn'", "scatterers": "0, 0, 0.1"})[0]


def test_the_plan_tells_of_them(tmp_path: Path) -> None:
    """And the schema, and the list of keys."""
    ended = run("--check", write(tmp_path, "c", TABLE), folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "3 scatterers" in ended.stdout
    assert '"scatterers"' in run("--schema", folder=tmp_path).stdout


def log_of(path: Path) -> np.ndarray:
    """Return the events of a file, one a row."""
    with h5py.File(path) as file:
        assert file.attrs["status"] in (b"complete", "complete")
        return np.array([file[f"events/{name}"][()] for name in ("kind", "where", "particle")]).T


@pytest.mark.parametrize("discs", [DISCS, "0, 0.9, 0.8, 0.1, -1.15, 1"])
def test_engines_tell_the_same_events(tmp_path: Path, discs: str) -> None:
    """From the namelist to the file, with those who cross the line to and fro.

    Of a disc counts what it cuts out of the channel: centred outside, it may be longer than that.
    """
    logs = []
    for engine in ("excursion", "collision"):
        (tmp_path / "i.txt").write_text(initial(600))
        name = write(
            tmp_path, engine, TABLE | {"scatterers": discs},
            particles={"number": "600", "initial_file": "'i.txt'"},
            run={"engine": f"'{engine}'", "duration": "4"}, output={"event_log": "T"},
        )  # fmt: skip
        ended = run(name, folder=tmp_path)
        assert ended.returncode == 0, ended.stderr
        logs.append(log_of(tmp_path / f"{engine}.h5"))
    assert np.count_nonzero(logs[0][:, 0] == 4) > 20
    assert np.array_equal(*logs)


def initial(number: int) -> str:
    """Return particles in the urns, of all directions."""
    random = np.random.default_rng(5)
    (angle, turn), away = random.uniform(0, 2 * np.pi, (2, number)), random.uniform(0, 0.9, number)
    side = np.where(np.arange(number) % 2 == 0, 1.0, -1.0)
    x, y = side * (1.48 + away * np.cos(turn)), away * np.sin(turn)
    rows = zip(x, y, np.cos(angle), np.sin(angle), strict=True)
    return "".join(" ".join(f"{value:.15f}" for value in row) + "\n" for row in rows)


def test_they_are_in_the_file_and_make_another_task(tmp_path: Path) -> None:
    """A file made without them, or with others, is not gone on with."""
    name = write(tmp_path, "c", TABLE)
    assert run(name, folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "c.h5") as file:
        text = file.attrs["scatterers"]
        seed = file["seed"][()].item()
    text = text.decode() if isinstance(text, bytes) else text
    assert [float(word) for word in text.split()] == [float(word) for word in DISCS.split(",")]
    write(tmp_path, "c", TABLE | {"scatterers": DISCS.replace("0.05", "0.051")})
    ended = run(name, folder=tmp_path)
    assert ended.returncode == 2
    assert "&table scatterers: was" in ended.stderr
    ended = run("--overwrite", name, folder=tmp_path)
    assert ended.returncode == 0
    with h5py.File(tmp_path / "c.h5") as file:
        assert file["seed"][()].item() != seed


def test_a_path_through_corners_has_no_jump(tmp_path: Path) -> None:
    """From one picture to the next a particle goes no further than its speed allows.

    Starts on a lattice, along the axes, hit corners of a notched urn exactly; its slanted sides
    round what follows. One gate reverses, the other does not.
    """
    step = 1.0 / 16.0
    corners = "-1, -1, 1, -1, 1, 1, 0.25, 1, 0, 0.5, -0.25, 1, -1, 1"
    table = {"urn_shape": "'polygon'", "urn_vertices": corners, "channel1_width": "1",
             "channel2_width": "0.5", "scatterers": "0.0625, 0.03125, 0.0625"}  # fmt: skip
    starts = [f"{side * (1.5 + 0.125 * k)} {y} {u} 0" for k in range(-7, 8) if k
              for side, y, u in [(-1, 0.5, -1), (1, 0.5, 1), (-1, 0.625, 1)]]  # fmt: skip
    (tmp_path / "starts.txt").write_text("\n".join(starts))
    times = ", ".join(repr(step * k) for k in range(97))
    text = write(
        tmp_path, "a", table,
        particles={"number": str(len(starts)), "initial_file": "'starts.txt'"},
        gate={"threshold": "1, 50"}, run={"duration": "13"}, output={"snapshot_times": times},
    )  # fmt: skip
    assert run("--quiet", text, folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "a.h5") as file:
        x, y = (file[f"snapshots/{name}"][0, 0] for name in "xy")
    along, across = np.diff(x, axis=0), np.diff(y, axis=0)
    within = np.abs(along) < 2.0  # not over the periodic line
    assert (np.hypot(along, across)[within] <= step * (1.0 + 1e-9)).all()


@pytest.mark.parametrize("engine", ["excursion", "collision"])
def test_who_never_leaves_does_not_hang_the_run(tmp_path: Path, engine: str) -> None:
    """Over the counted line between two discs, a billion times a time unit: until time is up."""
    table = {
        "urn_radius": "1.25", "channel1_width": "1.5", "channel2_width": "1.5",
        "scatterers": "0.1000000005, 0, 0.1, -0.1000000005, 0, 0.1",
    }  # fmt: skip
    (tmp_path / "i.txt").write_text("-2.9999999999 0 1 0\n-1.5 0.1 1 0\n")
    name = write(
        tmp_path, "c", table,
        particles={"number": "2", "initial_file": "'i.txt'"},
        run={"engine": f"'{engine}'", "duration": "1000"}, limits={"wall_minutes": "0.003"},
    )  # fmt: skip
    ended = run(name, folder=tmp_path)
    assert ended.returncode == 3, ended.stdout + ended.stderr
    # The state is there, and is gone on with.
    assert run(name, folder=tmp_path).returncode == 3


def test_who_goes_to_and_fro_between_a_disc_and_an_urn_does_not_hang_the_run(
    tmp_path: Path,
) -> None:
    """Its visit has no end: engines agree on hits and place."""
    table = {
        "urn_shape": "'polygon'", "urn_vertices": "1, -1, 1, 1, -1, 1, -1, -1",
        "channel1_width": "0.25", "channel2_width": "1.5", "scatterers": "0.25, 0.5, 0.0625",
    }  # fmt: skip
    (tmp_path / "i.txt").write_text("-1.5 0.5 -1 0\n")
    found = {}
    for engine in ("excursion", "collision"):
        name = write(
            tmp_path, engine, table, run={"engine": f"'{engine}'", "duration": "100"},
            particles={"number": "1", "initial_file": "'i.txt'"}, output={"final_state": ".true."},
        )  # fmt: skip
        assert run(name, folder=tmp_path).returncode == 0
        with h5py.File(tmp_path / f"{engine}.h5") as file:
            found[engine] = [file["collisions"][0, 0], file["final/x"][0, 0, 0]]
    assert found["excursion"] == pytest.approx(found["collision"], abs=1e-9)
    assert found["excursion"][0] > 40


def test_hits_in_channel_1_before_a_visit_to_discs_are_counted_once(tmp_path: Path) -> None:
    """However many they are: this particle has 1e6 of them in a unit of time."""
    table = {"channel1_width": "1e-6", "channel2_width": "0.3", "scatterers": "0.2, 0, 0.05"}
    (tmp_path / "i.txt").write_text("0 0 -0.28 0.96\n")
    name = write(
        tmp_path, "many", table, run={"engine": "'excursion'", "duration": "1"},
        particles={"number": "1", "initial_file": "'i.txt'"}, gate={"threshold": "5"},
    )  # fmt: skip
    assert run(name, folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "many.h5") as file:
        assert file["collisions"][0, 0] == 960000


@pytest.mark.parametrize("engine", ["excursion", "collision"])
@pytest.mark.parametrize("side", [1, -1])
def test_who_glides_along_a_wall_of_channel_2_stays_there(
    tmp_path: Path, engine: str, side: int
) -> None:
    table = {"urn_radius": "0.5", "channel1_width": "0.8", "channel1_length": "2",
             "channel2_width": "0.6", "channel2_length": "2",
             "scatterers": "0.2, 0, 0.0625"}  # fmt: skip
    (tmp_path / "i.txt").write_text(f"-1.825 {0.3 * side} -1 0\n")
    particles = {"number": "1", "initial_file": "'i.txt'"}
    output = {"file": "'c.h5'", "snapshot_times": "0.05, 0.1"}
    run_of = {"engine": f"'{engine}'", "duration": "1"}
    name = write(tmp_path, "c", table, particles=particles, run=run_of, output=output)
    assert run(name, folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "c.h5") as file:
        assert file["snapshots/y"][0, 0, :, 0].tolist() == [0.3 * side] * 2


def test_a_state_of_other_walls_is_not_gone_on_with(tmp_path: Path) -> None:
    """Other discs, or another polygon: exit 2, and the state stays for the task that it is of."""
    corners = "1, -0.6, 1, 0.7, -0.1, 1.1, -1, 0.6, -1, -0.5"
    table = TABLE | {"urn_shape": "'polygon'", "urn_vertices": corners}
    long = {"run": {"duration": "1e6"}, "limits": {"checkpoint_minutes": "0.002"}}
    name = write(tmp_path, "c", table, **long)
    process = start(name, folder=tmp_path)
    kept = tmp_path / "c.h5.tasks"
    assert wait_for(lambda: any(kept.glob("task_*")), process)
    send([process.pid], signal.SIGTERM)
    assert finish(process).returncode == 3
    states = {path.name: path.read_bytes() for path in kept.glob("task_*")}
    for key, value in (("scatterers", DISCS.replace("0.05", "0.051")),
                       ("urn_vertices", corners.replace("1.1", "1.11"))):  # fmt: skip
        write(tmp_path, "c", table | {key: value}, **long)
        ended = run(name, folder=tmp_path)
        assert ended.returncode == 2
        assert f"&table {key}: was" in ended.stderr
    assert {path.name: path.read_bytes() for path in kept.glob("task_*")} == states

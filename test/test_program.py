"""The program from end to end: its input, its command line, and the file it leaves."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest
import xarray
from support import program
from support.program import assert_same, listing, namelist, run

if TYPE_CHECKING:
    from pathlib import Path
    from subprocess import CompletedProcess

NUMBER = 60
PARTICLES = {"number": str(NUMBER)}
GATE = {"threshold": "2"}
RUN = {"duration": "402", "transient_duration": "100"}
OUTPUT = {
    "series_interval": "5",
    "snapshot_times": "0, 10, 20.5",
    "final_state": ".true.",
}


def write(folder: Path, name: str = "case.nml", **groups: dict[str, Any]) -> Path:
    """Write a small case; groups given replace those of the small case, None leaves one out."""
    case = {
        "particles": PARTICLES,
        "gate": GATE,
        "run": RUN,
        "output": {"file": "'out.h5'", **OUTPUT},
        **groups,
    }
    path = folder / name
    path.write_text(namelist(**{key: keys for key, keys in case.items() if keys is not None}))
    return path


def problems(folder: Path, text: str, *arguments: str, ranks: int = 0) -> list[str]:
    """Run a bad input; give the lines of its complaint. Nothing may be written."""
    (folder / "bad.nml").write_text(text)
    before = listing(folder)
    ended = run(*arguments, "bad.nml", folder=folder, ranks=ranks)
    assert ended.returncode == 2, (ended.returncode, ended.stdout, ended.stderr)
    assert listing(folder) == before
    assert ended.stdout == ""
    ours = re.compile(r"(bad\.nml|start\.txt)\b")
    return [line for line in ended.stderr.splitlines() if ours.match(line)]


MANY_WRONG = """&particles
  number = 0, seed = 1.5
/
&gate
  threshold = -1
/
&table
  channel2_width = -0.1
  urn_radius = NaN
  colour = 'red'
/
&gate
/
&nonsense
/
&output
  file = 'nowhere/out.h5'
"""
MANY_WORDS = [
    "number = 0",
    "seed = 1.5",
    "threshold = -1",
    "channel2_width = -0.1",
    "urn_radius = NaN",
    "colour = 'red'",
    "&gate: ",
    "&nonsense",
    "missing",
    "nowhere",
]


@pytest.mark.parametrize("ranks", [0, 2])
def test_all_problems_at_once(tmp_path: Path, ranks: int) -> None:
    """Every problem has its own line, in the order of the file, on one rank or two."""
    lines = problems(tmp_path, MANY_WRONG, ranks=ranks)
    assert len(lines) == len(MANY_WORDS)
    for word in MANY_WORDS:
        assert sum(word in line for line in lines) == 1, (word, lines)
    numbers = [int(re.search(r"line (\d+)", line)[1]) for line in lines]
    assert numbers == sorted(numbers)


def test_problems_of_initial_file_and_namelist_together(tmp_path: Path) -> None:
    """Problems in the namelist do not hide those in the initial file, on two ranks as well."""
    (tmp_path / "start.txt").write_text("9 9 1 0\n-1 0 0 0\n")
    particles = {"number": 2, "initial_file": "'start.txt'"}
    lines = problems(tmp_path, namelist(particles=particles, gate=GATE, run={"speed": 2}), ranks=2)
    assert any("&run speed = 2" in line for line in lines)
    assert any("line 1" in line and "outside" in line for line in lines)
    assert any("line 2" in line and "speed 0" in line for line in lines)


def test_folder_where_nothing_can_be_made(tmp_path: Path) -> None:
    """Where even the superuser cannot write, the output file is refused like any bad input."""
    write(tmp_path, output={"file": "'/proc/out.h5'"})
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2, (ended.stdout, ended.stderr)
    assert "/proc/out.h5" in ended.stderr


def run_without_rights(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the program as one who may read and write only what the rights of files say."""
    # Root may read and write anything, unless it gives up that right.
    humble = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]
    return program.finish(
        subprocess.Popen(
            [*(humble if os.getuid() == 0 else []), *program.command_of(*words)],
            cwd=folder, env=program.ALONE, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True,
        )
    )  # fmt: skip


def test_a_folder_of_tasks_that_may_not_be_read_is_named(tmp_path: Path) -> None:
    """It may have results: they are not computed again."""
    write(tmp_path, output={"file": "'out.h5'"})
    tasks = tmp_path / "out.h5.tasks"
    tasks.mkdir()
    for mode in (0o300, 0o600):
        tasks.chmod(mode)
        for option in ("--quiet", "--check", "--partial"):
            ended = run_without_rights(option, "case.nml", folder=tmp_path)
            assert ended.returncode == 1
            assert re.search("out.h5.tasks.* cannot be read.*Permission denied", ended.stderr)
    tasks.chmod(0o700)
    assert not any(tasks.iterdir())


def test_folder_without_rights(tmp_path: Path) -> None:
    """A folder that cannot be written to is found out before the run."""
    folder = tmp_path / "closed"
    folder.mkdir()
    folder.chmod(0o555)
    write(tmp_path, "bad.nml", output={"file": "'closed/out.h5'"})
    ended = run_without_rights("bad.nml", folder=tmp_path)
    assert ended.returncode == 2, ended.stderr
    assert "&output file = 'closed/out.h5'" in ended.stderr
    assert "cannot be written" in ended.stderr
    assert not list(folder.iterdir())


@pytest.mark.parametrize("folder_mode", [0o755, 0o555])
def test_complete_results_may_be_protected(tmp_path: Path, folder_mode: int) -> None:
    """Complete results are said complete where nothing can be written; more is refused."""
    folder, kept = tmp_path / "kept", tmp_path / "kept/out.h5"
    folder.mkdir()
    write(tmp_path, "case.nml", output={"file": "'kept/out.h5'"})
    write(tmp_path, "more.nml", scan={"replicas": 2}, output={"file": "'kept/out.h5'"})
    assert run("case.nml", folder=tmp_path).returncode == 0
    whole = kept.read_bytes()
    without_digest = whole[:-512]
    for contents, words, code in (
        (whole, ["case.nml"], 0), (whole, ["--check", "case.nml"], 0),
        (whole, ["more.nml"], 2), (whole, ["--check", "more.nml"], 2),
        (whole, ["--overwrite", "case.nml"], 2), (whole, ["--check", "--overwrite", "case.nml"], 2),
        (without_digest, ["--accept", "case.nml"], 2),
    ):  # fmt: skip
        kept.chmod(0o644)
        kept.write_bytes(contents)
        kept.chmod(0o444)
        folder.chmod(folder_mode)
        ended = run_without_rights(*words, folder=tmp_path)
        folder.chmod(0o755)
        assert ended.returncode == code
        if code == 0:
            assert ended.stdout.startswith("kept/out.h5 is complete")
        else:
            assert re.fullmatch(r"kept/out.h5.*: .*cannot be written.*\n", ended.stderr)
        assert kept.read_bytes() == contents
    assert [path.name for path in folder.iterdir()] == ["out.h5"]


@pytest.mark.parametrize("ranks", [0, 2])
def test_no_such_namelist(tmp_path: Path, ranks: int) -> None:
    """A namelist that is not there is named."""
    ended = run("none.nml", folder=tmp_path, ranks=ranks)
    assert ended.returncode == 2
    assert "none.nml" in ended.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ranks", [0, 2])
def test_bad_command_line(tmp_path: Path, ranks: int) -> None:
    """It is told once, with what is allowed."""
    ended = run("--nonsense", folder=tmp_path, ranks=ranks)
    assert ended.returncode == 2
    assert ended.stderr.count("--nonsense: ") == 1
    assert "usage" in ended.stderr
    assert not list(tmp_path.iterdir())


def test_help_and_version(tmp_path: Path) -> None:
    """The help knows options, exit codes and every key; the version has a number."""
    helped = run("--help", folder=tmp_path)
    assert helped.returncode == 0
    for word in ("--check", "--overwrite", "--quiet", "channel2_width_range", "checkpoint_minutes"):
        assert word in helped.stdout
    versioned = run("--version", folder=tmp_path)
    assert versioned.returncode == 0
    assert re.match(r"battery \d+\.\d+", versioned.stdout)
    assert helped.stderr == versioned.stderr == ""


@pytest.mark.parametrize("ranks", [0, 2])
def test_check_writes_nothing(tmp_path: Path, ranks: int) -> None:
    """--check shows the plan with tasks, time and memory, and leaves the folder as it was."""
    write(tmp_path, scan={"channel2_width": "0.01, 0.1", "replicas": "3"})
    before = listing(tmp_path)
    ended = run("--check", "case.nml", folder=tmp_path, ranks=ranks)
    assert ended.returncode == 0
    for word in ("6", "2 points, 3 replicas", "channel2_width = 0.01, 0.1\n", "time", "memory",
                 "out.h5"):  # fmt: skip
        assert word in ended.stdout
    assert listing(tmp_path) == before


def test_currents_of_a_young_run_are_remarked_on(tmp_path: Path) -> None:
    """The plan and the run say in the same line what currents lack, --quiet says nothing."""
    table = {"channel1_width": "0.3", "channel2_width": "0.01"}
    length = {"duration": "3000", "transient_duration": "1000"}
    groups = {"table": table, "run": length, "output": {"file": "'out.h5'"}}
    write(tmp_path, particles={"number": "1000"}, gate={"threshold": "7"}, **groups)
    told = [
        re.findall(r"remark: +(currents lack .* %) \(", run(*words, folder=tmp_path).stdout)
        for words in (["--check", "case.nml"], ["case.nml"], ["--quiet", "--overwrite", "case.nml"])
    ]
    assert len(told[0]) == 1
    assert "%: circulations still build up; &run transient_duration = " in told[0][0]
    assert told[1:] == [told[0], []]
    groups["run"] = {"duration": "3", "transient_duration": "1"}
    write(tmp_path, particles={"number": "1000"}, gate={"threshold": "7"}, **groups)
    advice = run("--check", "--overwrite", "case.nml", folder=tmp_path).stdout
    assert "more than 100 times this one; compare with theory at the age of the run" in advice


def test_an_mpi_that_does_not_come_to_its_end(tmp_path: Path) -> None:
    """The program ends by itself, with its exit code; here its clock runs fast."""
    source, library = tmp_path / "hangs.c", tmp_path / "hangs.so"
    source.write_text("""
        #include <unistd.h>
        #include <sys/time.h>
        int MPI_Finalize(void) { for (;;) pause(); }
        int PMPI_Finalize(void) { for (;;) pause(); }
        unsigned alarm(unsigned seconds) {
          struct itimerval soon = {{0, 0}, {0, 10000*seconds}};
          return setitimer(ITIMER_REAL, &soon, 0);
        }
    """)
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source], check=True)
    hangs = {"LD_PRELOAD": str(library)}
    write(tmp_path)
    assert run("--quiet", "case.nml", folder=tmp_path, environment=hangs).returncode == 0
    assert (tmp_path / "out.h5").exists()
    assert run("no.nml", folder=tmp_path, environment=hangs).returncode == 2


def test_quiet(tmp_path: Path) -> None:
    """--quiet prints nothing, without quiet there is a summary."""
    write(tmp_path)
    ended = run("--quiet", "case.nml", folder=tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
    loud = run("--overwrite", "case.nml", folder=tmp_path)
    assert loud.returncode == 0
    assert "1 of 1 tasks are complete" in loud.stdout
    assert "out.h5" in loud.stdout


def test_small_numbers_have_digits_in_the_summary(tmp_path: Path) -> None:
    """A width that no fixed number of decimals shows has an exponent."""
    write(tmp_path, table={"channel2_width": "1.25e-7"})
    assert " 1.2500E-07 " in run("case.nml", folder=tmp_path).stdout


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a scan of two points with two replicas."""
    folder = tmp_path_factory.mktemp("scan")
    write(folder, scan={"channel2_width": "0.01, 0.1", "replicas": "2"})
    ended = run("case.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    assert sorted(path.name for path in folder.iterdir()) == ["case.nml", "out.h5"]
    return folder / "out.h5"


BY_POINT = [
    *("number", "threshold", "urn1_number"),
    *("channel1_width", "channel1_length", "channel2_width", "channel2_length"),
]
BY_TASK = [
    *("seed", "chi", "chi_error", "chi_collision"),
    *("current1", "current1_error", "current2", "current2_error"),
    *("polarised_current", "polarised_current_error"),
    *("flow1_12", "flow1_21", "flow2_12", "flow2_21"),
    *("collisions", "bounce_backs", "time", "cpu_seconds", "task_status"),
]
SERIES = ["urn1_number", "flow1_12", "flow1_21", "flow2_12", "flow2_21"]


def test_datasets_have_units_and_a_long_name(scan: Path) -> None:
    """Every one of the file."""

    def look(name: str, thing: h5py.Dataset | h5py.Group) -> None:
        if isinstance(thing, h5py.Dataset):
            assert thing.attrs["units"], name
            assert thing.attrs["long_name"], name

    with h5py.File(scan) as file:
        file.visititems(look)


def test_attributes_of_the_contract(scan: Path) -> None:
    """The root tells where the results come from; the namelist is the whole input."""
    with h5py.File(scan) as file:
        attributes = {
            key: value.decode() if isinstance(value, bytes) else value
            for key, value in file.attrs.items()
        }
    expected = (
        "program version git_commit compiler compiler_options mpi_library mpi_ranks namelist "
        "created status"
    )
    assert set(expected.split()) <= attributes.keys()
    assert attributes["program"] == "battery"
    assert attributes["status"] == "complete"
    assert attributes["mpi_ranks"] == 1
    assert attributes["namelist"] == (scan.parent / "case.nml").read_text()
    assert re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ?$", attributes["created"])


@pytest.mark.parametrize("zone", ["EAST-14", "WEST+11:30"])
def test_created_is_utc(tmp_path: Path, zone: str) -> None:
    """The file tells the time of day in UTC, wherever it is written: hours lie between zones."""
    write(tmp_path, output={"file": "'out.h5'"})
    assert run("case.nml", folder=tmp_path, environment={"TZ": zone}).returncode == 0
    with h5py.File(tmp_path / "out.h5") as file:
        created = datetime.fromisoformat(file.attrs["created"])
    assert abs(created - datetime.now(UTC)) < timedelta(hours=1)


def test_xarray_opens_it(scan: Path) -> None:
    """No more than xarray.open_dataset gives named dimensions and units, root and groups."""
    with xarray.open_dataset(scan) as root:
        for name in BY_POINT:
            assert root[name].dims == ("point",), name
        for name in BY_TASK:
            assert root[name].dims == ("point", "replica"), name
        assert root["gate_threshold"].dims == ("point", "gate")
        assert root["urn_radius"].dims == ("point", "urn")
        assert root["gate"].values.tolist() == root["urn"].values.tolist() == [1, 2]
        assert root["current1"].attrs["units"] == "1/time"
        np.testing.assert_array_equal(root["channel2_width"], [0.01, 0.1])
    with xarray.open_dataset(scan, group="series") as series:
        assert all(series[name].dims == ("point", "replica", "time") for name in SERIES)
        np.testing.assert_allclose(series["time"], 5.0 * np.arange(series.sizes["time"]))
    with xarray.open_dataset(scan, group="final") as final:
        assert final.sizes["particle"] == NUMBER
        for name in ("x", "y", "ux", "uy"):
            assert final[name].dims == ("point", "replica", "particle"), name
    with xarray.open_dataset(scan, group="snapshots") as snapshots:
        assert snapshots["x"].dims == ("point", "replica", "time", "particle")
        np.testing.assert_array_equal(snapshots["time"], [0.0, 10.0, 20.5])


def test_flows_currents_and_particles_agree(scan: Path) -> None:
    """Currents are differences of flows; N1 follows from them; nothing is lost."""
    with xarray.open_dataset(scan) as root, xarray.open_dataset(scan, group="series") as series:
        for channel in ("1", "2"):
            net = root[f"flow{channel}_12"] - root[f"flow{channel}_21"]
            np.testing.assert_allclose(net, root[f"current{channel}"], rtol=1e-12, atol=1e-12)
        assert ((root["chi"] > 0) & (root["chi"] < 1)).all()
        assert np.isnan(root["chi_collision"]).all()
        assert (root["task_status"] == 0).all()
        assert (root["collisions"] > 0).all()
        np.testing.assert_allclose(root["time"], 402.0, rtol=1e-6)
        assert len(np.unique(root["seed"])) == 4
        urn1 = series["urn1_number"]
        assert ((urn1 >= 0) & (urn1 <= NUMBER)).all()
        assert (urn1[..., 0] == NUMBER // 2).all()
        leaving = sum(series[f"flow{c}_12"] - series[f"flow{c}_21"] for c in "12")
        steps = np.diff(urn1.astype(int), axis=-1)
        np.testing.assert_allclose(steps, -5.0 * leaving.values[..., 1:], atol=1e-9)


def test_series_ends_with_the_run(tmp_path: Path) -> None:
    """Runs of the same duration have series of the same length, the end included or not."""
    scanned = {"channel2_width": "0.01, 0.1", "replicas": "2"}
    write(tmp_path, run={"duration": "400", "transient_duration": "100"}, scan=scanned)
    assert run("case.nml", folder=tmp_path).returncode == 0
    with xarray.open_dataset(tmp_path / "out.h5", group="series") as series:
        assert np.isfinite(series["flow1_12"][..., 1:]).all()


def test_positions_are_in_the_table(scan: Path) -> None:
    """Snapshots and the final state hold all particles, inside, with speed 1 and in their half."""
    snapshots = xarray.load_dataset(scan, group="snapshots")
    final = xarray.load_dataset(scan, group="final")
    series = xarray.load_dataset(scan, group="series")
    for state in (snapshots, final):
        assert np.isfinite(state["x"]).all()
        np.testing.assert_allclose(np.hypot(state["ux"], state["uy"]), 1.0, atol=1e-12)
        assert (abs(state["y"]) <= 1.0).all()
        assert (abs(state["x"]) <= 3.0 + 1e-9).all()
    for snapshot, entry in ((0, 0), (1, 2)):
        halves = (snapshots["x"][:, :, snapshot] < 0).sum("particle")
        np.testing.assert_array_equal(halves, series["urn1_number"][:, :, entry])


@pytest.mark.parametrize("engine", ["collision", "synchronous"])
def test_other_engines(tmp_path: Path, engine: str) -> None:
    """Engines that see every wall collision average over them, and count about the same."""
    write(tmp_path, run={**RUN, "engine": f"'{engine}'"})
    assert run("case.nml", folder=tmp_path).returncode == 0
    with xarray.open_dataset(tmp_path / "out.h5") as root:
        assert (root["chi_collision"] - root["chi"]).item() == pytest.approx(0.0, abs=0.05)
        # The mean free path in an urn is near pi r/2; channels make it a little shorter.
        assert 0.4 < (root["collisions"] / root["time"] / NUMBER).item() < 0.9


def test_urn_shape(tmp_path: Path) -> None:
    """With one urn there is no channel 2 and no chi; hits on the end wall are current 1."""
    write(tmp_path, table={"shape": "'urn'"})
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    with xarray.open_dataset(tmp_path / "out.h5") as root:
        assert np.isnan(root["chi"]).all()
        assert root["current1"].item() > 0
        assert root["urn1_number"].item() == NUMBER
        assert not np.nan_to_num(root["current2"]).any()


def test_summary_has_a_line_for_a_point_over_its_replicas(tmp_path: Path) -> None:
    """Mean over replicas, and the error from their scatter: not for a single replica."""
    scan = {"channel2_width": "0.2, 0.3", "replicas": "3"}
    write(tmp_path, scan=scan, output={"file": "'out.h5'"})
    lines = run("case.nml", folder=tmp_path).stdout.splitlines()
    at = next(at for at, line in enumerate(lines) if "errors over replicas" in line)
    with xarray.open_dataset(tmp_path / "out.h5") as root:
        for point, line in enumerate(lines[at + 1 : at + 3]):
            part = root.isel(point=point)
            for name, shown in (("chi", 5), ("polarised_current", 7)):
                values = part[name].values
                mean, error = (float(word) for word in line.split()[shown : shown + 2])
                assert mean == pytest.approx(values.mean(), abs=1e-5)
                assert error == pytest.approx(values.std(ddof=1) / np.sqrt(3), abs=1e-5)
            assert line.split()[4] == "3"
    write(tmp_path, output={"file": "'out.h5'"})
    assert "over replicas" not in run("--overwrite", "case.nml", folder=tmp_path).stdout


def test_summary_tells_points_apart(tmp_path: Path) -> None:
    """A row ends with the keys of the scan that have no column; keys that have one are not told."""
    scan = {"channel1_length": "0.5, 1", "threshold": "1, 2", "replicas": "2"}
    write(tmp_path, scan=scan, output={"file": "'out.h5'"})
    lines = run("case.nml", folder=tmp_path).stdout.splitlines()
    rows = [line for line in lines if line.split()[0] == str(NUMBER)]
    for length in ("0.5", "1"):
        for threshold in ("1", "2"):
            words = f"threshold = {threshold}, channel1_length = {length}"
            assert len([row for row in rows if row.endswith(words)]) == 3
    assert len(rows) == 12
    assert any(line.startswith("slowest task: ") and "channel1_length = " in line for line in lines)
    write(tmp_path, scan={"threshold": "1, 2"}, output={"file": "'out.h5'"})
    assert (
        "threshold"
        not in run("--overwrite", "case.nml", folder=tmp_path).stdout.split("complete")[0]
    )


def test_the_command_for_all_points_can_be_typed(tmp_path: Path) -> None:
    write(tmp_path, scan={"threshold_range": "1, 13, 13"}, output={"file": "'out.h5'"})
    (line,) = (line for line in run("case.nml", folder=tmp_path).stdout.splitlines()
               if line.startswith("all points: "))  # fmt: skip
    command = line.removeprefix("all points: ").split()
    typed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert len(typed.stdout.splitlines()) == 1 + 13


def test_series_of_a_run_of_collisions_have_their_last_entry(tmp_path: Path) -> None:
    """Its end falls on that of an interval, but for rounding."""
    length = {"engine": "'collision'", "collisions": "5000"}
    write(tmp_path, particles={"number": "60", "seed": "1"}, run=length,
          output={"file": "'out.h5'", "series_interval": "1"})  # fmt: skip
    assert run("case.nml", folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "out.h5") as file:
        assert file["series/time"][-1] == np.floor((1.0 + 1e-12) * file["time"][0, 0])


def test_a_stopped_scan_says_how_to_see_its_points(tmp_path: Path) -> None:
    """Tasks go replica by replica: at first no point has two, of which there would be a mean."""
    scan = {"threshold_range": "1, 8, 8"}
    write(tmp_path, scan=scan, output={"file": "'out.h5'"})
    run("case.nml", folder=tmp_path)
    write(tmp_path, scan=scan | {"replicas": "2"}, output={"file": "'out.h5'"},
          limits={"wall_minutes": "1e-9"})  # fmt: skip
    printed = run("case.nml", folder=tmp_path).stdout.splitlines()
    assert "8 of 16 tasks are complete" in printed
    assert any(line.startswith("all points: ") for line in printed)


def test_run_too_short_for_an_error_has_none_and_says_so(tmp_path: Path) -> None:
    """Directions relax in 32 time units here: a run of ten times that has errors, half has none."""
    wide = {"channel1_width": "0.9", "channel2_width": "0.6"}
    for duration, known in (("170", False), ("1000", True)):
        length = {"duration": duration, "transient_duration": "0"}
        write(tmp_path, table=wide, run=length, output={"file": "'out.h5'"})
        printed = run("--overwrite", "case.nml", folder=tmp_path).stdout
        assert ("-: no error of its own: the run is too short" in printed) is not known
        with xarray.open_dataset(tmp_path / "out.h5") as root:
            for name in ("chi", "current1", "polarised_current"):
                assert np.isfinite(root[name].item())
                assert np.isfinite(root[f"{name}_error"].item()) == known, name
            assert "NaN" in root["chi_error"].attrs["long_name"]


def test_it_says_that_directions_never_relax_where_no_length_of_a_run_helps(tmp_path: Path) -> None:
    """In a rectangle they do not, as in regular polygons, also with discs in channel 2."""
    rectangle = {"urn_shape": "'polygon'", "urn_vertices": "1, -1.3, 1, 1.3, -1, 1.3, -1, -1.3"}
    hexagon = {"urn_shape": "'polygon'", "urn_sides": "6"}
    discs = {"channel2_width": "0.3", "scatterers": "0.2, 0.05, 0.03"}
    crooked = rectangle | {"urn_vertices": "1, -1.3, 1, 1.1, 0.2, 1.5, -1, 1, -1, -0.9"}
    for table, never in ((rectangle, True), (hexagon | discs, True), (crooked, False)):
        write(tmp_path, table=table, run={"duration": "170"}, output={"file": "'out.h5'"})
        printed = run("--overwrite", "case.nml", folder=tmp_path).stdout
        assert "-: no error of its own" in printed
        assert ("directions of motion never relax" in printed) is never


def test_event_log(tmp_path: Path) -> None:
    """Events come in order, of the four kinds; crossings and reversals are those counted."""
    write(
        tmp_path,
        run={"duration": "100"},
        table={"channel2_width": "0.2"},
        output={"file": "'out.h5'", "event_log": ".true."},
    )
    assert run("case.nml", folder=tmp_path).returncode == 0
    root = xarray.load_dataset(tmp_path / "out.h5")
    events = xarray.load_dataset(tmp_path / "out.h5", group="events")
    assert events["time"].dims == ("event",)
    time, kind, where, particle = (
        events[name].values for name in ("time", "kind", "where", "particle")
    )
    assert (np.diff(time) >= 0).all()
    assert time[0] >= 0
    assert time[-1] <= 100
    assert set(kind) == {1, 2, 3, 4}
    assert set(where[kind <= 2]) == {1, 2}
    assert set(where[kind >= 3]) == {12, 21}
    assert particle.min() >= 1
    assert particle[kind != 2].max() <= NUMBER
    assert (particle[kind == 2] > 2).all()
    for channel, number in (("1", 3), ("2", 4)):
        for way in (12, 21):
            flow = root[f"flow{channel}_{way}"].item()
            count = ((kind == number) & (where == way)).sum()
            assert flow * root["time"].item() == pytest.approx(count, abs=1e-6)
    assert particle[kind == 2].sum() == root["bounce_backs"].item()
    assert (kind == 2).sum() == root["reversals"].item()


def write_start(state: xarray.Dataset, path: Path) -> None:
    """Write particles as an initial file."""
    columns = [state[name].values.ravel() for name in ("x", "y", "ux", "uy")]
    lines = zip(*(column.tolist() for column in columns), strict=True)
    path.write_text("".join("{!r} {!r} {!r} {!r}\n".format(*line) for line in lines))


def test_final_state_goes_on(tmp_path: Path) -> None:
    """A final state is a start: snapshots at time 0 are the initial file, and runs join up."""
    output = {"file": "'one.h5'", "final_state": ".true.", "snapshot_times": "0"}
    write(tmp_path, "one.nml", run={"duration": "3"}, output=output)
    assert run("one.nml", folder=tmp_path).returncode == 0
    final = xarray.load_dataset(tmp_path / "one.h5", group="final")
    first = xarray.load_dataset(tmp_path / "one.h5", group="snapshots")
    write_start(first, tmp_path / "first.txt")
    write_start(final, tmp_path / "start.txt")
    output = {"file": "'two.h5'", "final_state": ".true.", "snapshot_times": "0, 2"}
    # The namelist as it was: the particles of the file count, not the fraction.
    particles = {**PARTICLES, "initial_file": "'start.txt'", "seed": "77", "urn1_fraction": "1"}
    write(tmp_path, "two.nml", particles=particles, run={"duration": "2"}, output=output)
    ended = run("two.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    snapshots = xarray.load_dataset(tmp_path / "two.h5", group="snapshots")
    write(
        tmp_path,
        "whole.nml",
        particles={**PARTICLES, "initial_file": "'first.txt'"},
        run={"duration": "5"},
        output={"file": "'whole.h5'", "final_state": ".true.", "snapshot_times": "3"},
    )
    assert run("whole.nml", folder=tmp_path).returncode == 0
    whole = xarray.load_dataset(tmp_path / "whole.h5", group="snapshots")
    last = xarray.load_dataset(tmp_path / "whole.h5", group="final")
    second = xarray.load_dataset(tmp_path / "two.h5", group="final")
    for name in ("x", "y", "ux", "uy"):
        np.testing.assert_allclose(
            snapshots[name].values[0, 0, 0], final[name].values[0, 0], rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(
            snapshots[name].values[0, 0, 1], second[name].values[0, 0], rtol=0, atol=1e-12
        )
        # Rounding grows with every bounce: the digits left after so short a time are plenty.
        np.testing.assert_allclose(whole[name].values[0, 0, 0], final[name].values[0, 0], atol=1e-9)
        np.testing.assert_allclose(last[name].values[0, 0], second[name].values[0, 0], atol=1e-6)
    with xarray.open_dataset(tmp_path / "two.h5") as root:
        assert root["urn1_number"].item() == (final["x"] < 0).sum().item()


def part(
    folder: Path, engine: str, start: str, begin: float, end: float, table: dict[str, float]
) -> tuple[str, list[tuple[int, int]], list[float]]:
    """Let one particle move in a square table from `begin` to `end`, a gate turning it back.

    Its final state as a line of an initial file, and its events with their times.
    """
    (folder / "start.txt").write_text(start)
    (folder / "part.h5").unlink(missing_ok=True)
    write(
        folder, "part.nml", gate={"threshold": 0},
        table={"urn_shape": "'polygon'", "urn_vertices": "1,-1,1,1,-1,1,-1,-1",
               "channel1_width": 0.25, "channel2_width": 0.25, **table},
        particles={"number": 1, "initial_file": "'start.txt'"},
        run={"engine": f"'{engine}'", "duration": end - begin, "start_time": begin,
             "transient_duration": 0},
        output={"file": "'part.h5'", "final_state": ".true.", "event_log": ".true."},
    )  # fmt: skip
    ended = run("--quiet", "part.nml", folder=folder)
    assert ended.returncode == 0, ended.stdout
    with h5py.File(folder / "part.h5") as file:
        kind, where, time = (
            file[f"events/{key}"][()].tolist() for key in ("kind", "where", "time")
        )
        final = [float(file[f"final/{key}"][0, 0, 0]) for key in ("x", "y", "ux", "uy")]
    return " ".join(map(repr, final)), list(zip(kind, where, strict=True)), time


@pytest.mark.parametrize("engine", ["excursion", "collision", "synchronous"])
@pytest.mark.parametrize(
    ("start", "cut"),
    [("-0.75 0.0625 1 0", 0.25), ("0.75 0.0625 -1 0", 0.25), ("-0.25 0.0625 1 0", 0.25),
     ("0.25 0.0625 -1 0", 0.25)],
)  # fmt: skip
def test_an_event_of_the_last_instant_is_that_of_who_goes_on(
    tmp_path: Path, engine: str, start: str, cut: float
) -> None:
    """A particle at a gate, or on the middle line, at the end; the gate turns back whoever enters.

    A run ends before the events of its last instant. All numbers are exact.
    """
    whole = part(tmp_path, engine, start, 0.0, 1.25, {})
    first = part(tmp_path, engine, start, 0.0, cut, {})
    second = part(tmp_path, engine, first[0], cut, 1.25, {})
    np.testing.assert_allclose(*(np.fromstring(of[0], sep=" ") for of in (whole, second)), 0, 1e-14)
    assert len(whole[1]) in (1, 2)
    assert first[1] + second[1] == whole[1]


@pytest.mark.parametrize("engine", ["excursion", "collision", "synchronous"])
def test_a_run_and_who_goes_on_from_it_have_each_event_once(tmp_path: Path, engine: str) -> None:
    """Rounding may not leave a final place beyond a line whose crossing is still to come."""
    table = {"channel1_length": 0.3}
    start, begin, end = "-1.1 0.03 1 0", 0.3, 3.3
    _, events, times = part(tmp_path, engine, start, begin, end, table)
    assert len(events) == 2
    at = begin + times[0]
    for cut in (np.nextafter(at, begin), at, np.nextafter(at, end)):
        middle, first, _ = part(tmp_path, engine, start, begin, float(cut), table)
        _, second, _ = part(tmp_path, engine, middle, float(cut), end, table)
        assert first + second == events, repr(cut)


@pytest.mark.parametrize("engine", ["excursion", "collision", "synchronous"])
def test_places_and_counts_are_of_the_same_urn(tmp_path: Path, engine: str) -> None:
    """A particle on the middle line, whose crossing is still to come, has a place in its half."""
    (tmp_path / "start.txt").write_text("-0.25 0 1 0")
    write(
        tmp_path, gate={"threshold": 1}, particles={"number": 1, "initial_file": "'start.txt'"},
        run={"engine": f"'{engine}'", "duration": 1, "transient_duration": 0},
        output={"file": "'out.h5'", "series_interval": 0.25, "snapshot_times": 0.25},
    )  # fmt: skip
    assert run("--quiet", "case.nml", folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "out.h5") as file:
        assert file["series/urn1_number"][0, 0, 0] == (file["snapshots/x"][()] < 0).sum() == 1


@pytest.mark.parametrize("engine", ["excursion", "collision", "synchronous"])
@pytest.mark.parametrize(
    ("hits", "start", "events"),
    [
        (0, "-0.5 0.05 1 0\n-0.5 0.02 0.8 0.6\n-0.5 -0.05 0.28 0.96",
         [(1, 1, 1), (1, 1, 2), (1, 1, 3), (2, 1, 3)]),
        (0, "-0.5 0.15 0.6 -0.8\n-0.5 -0.15 1 0\n1 0 0 1", [(1, 1, 1), (1, 1, 2), (2, 1, 2)]),
        (0, "0 0.1 1 0\n-0.5 0.1 1 0\n-1 0 0 1", [(3, 12, 1), (1, 1, 2)]),
        (1, "0 0.15 0.6 0.8\n-0.5 0.1 1 0\n-1 0 0 1", [(3, 12, 1), (1, 1, 2)]),
    ],
)  # fmt: skip
def test_a_run_that_goes_on_begins_with_all_events_of_its_first_instant(
    tmp_path: Path, engine: str, hits: int, start: str, events: list[tuple[int, ...]]
) -> None:
    """Particles that enter a gate, also in its corners; one that leaves as another enters. T = 1.

    The one that leaves may be on a wall.
    """
    (tmp_path / "start.txt").write_text(start)
    write(
        tmp_path, gate={"threshold": 1}, particles={"number": 3, "initial_file": "'start.txt'"},
        run={"engine": f"'{engine}'", "duration": 0.1, "start_time": 1, "transient_duration": 0},
        output={"file": "'out.h5'", "event_log": ".true."},
    )  # fmt: skip
    assert run("--quiet", "case.nml", folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "out.h5") as file:
        found = [file[f"events/{key}"][()].tolist() for key in ("kind", "where", "particle")]
        assert list(zip(*found, strict=True)) == events
        assert not file["events/time"][()].any()
        assert file["collisions"][0, 0] == hits


def test_variables_of_a_fortran_library_change_nothing(tmp_path: Path) -> None:
    """Some climate models want another order of bytes, and export that; a stopped run goes on."""
    odd = {
        "GFORTRAN_CONVERT_UNIT": "big_endian",
        "GFORTRAN_OPTIONAL_PLUS": "1",
        "GFORTRAN_STDERR_UNIT": "6",
    }
    write(tmp_path)
    ended = run("case.nml", folder=tmp_path, environment=odd)
    assert (ended.returncode, ended.stderr) == (0, "")


def complete_run(folder: Path) -> CompletedProcess[str]:
    """Make a complete results file."""
    write(folder)
    ended = run("case.nml", folder=folder)
    assert ended.returncode == 0, ended.stderr
    return ended


def test_complete_file_is_kept(tmp_path: Path) -> None:
    """The same command again says that all is complete, exits 0 and writes nothing."""
    complete_run(tmp_path)
    before = listing(tmp_path)
    for ranks in (0, 2):
        again = run("case.nml", folder=tmp_path, ranks=ranks)
        assert again.returncode == 0
        assert "complete" in again.stdout
    assert listing(tmp_path) == before


def test_another_input_is_refused(tmp_path: Path) -> None:
    """Results of another input are not touched; the keys that differ are named with both values."""
    complete_run(tmp_path)
    write(tmp_path, gate={"threshold": "3"}, particles={"number": "61"})
    before = listing(tmp_path)
    for ranks in (0, 2):
        ended = run("case.nml", folder=tmp_path, ranks=ranks)
        assert ended.returncode == 2
        assert "&gate threshold: was 2, is 3" in ended.stderr
        assert "&particles number: was 60, is 61" in ended.stderr
        assert "duration" not in ended.stderr
    assert listing(tmp_path) == before


def test_another_spelling_is_the_same_input(tmp_path: Path) -> None:
    """Defaults written out, other ways of writing and limits make no other run."""
    complete_run(tmp_path)
    write(
        tmp_path,
        run={"transient_duration": "1.0e2", "duration": "402.0", "engine": "'excursion'"},
        limits={"wall_minutes": "5"},
    )
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "complete" in ended.stdout


def test_overwrite(tmp_path: Path) -> None:
    """--overwrite discards results of another input, and runs a complete one again."""
    complete_run(tmp_path)
    (tmp_path / "out.h5").rename(tmp_path / "first.h5")
    write(tmp_path, gate={"threshold": "3"})
    assert run("case.nml", folder=tmp_path).returncode == 0
    write(tmp_path)
    assert run("--overwrite", "case.nml", folder=tmp_path).returncode == 0
    assert_same(tmp_path / "first.h5", tmp_path / "out.h5")


def test_a_file_of_someone_else_is_kept(tmp_path: Path) -> None:
    """A file that is no results file is not replaced, nor discarded with --overwrite."""
    write(tmp_path)
    with h5py.File(tmp_path / "mine.h5", "w") as file:
        file["mine"] = np.arange(10.0)
    others = (b"my notes", (tmp_path / "mine.h5").read_bytes(), np.arange(1000.0).tobytes())
    # Results are first written as out.h5.part.
    names, commands = ("out.h5", "out.h5.part"), ((), ("--overwrite",))
    for name, words, contents in itertools.product(names, commands, others):
        (tmp_path / name).write_bytes(contents)
        ended = run(*words, "case.nml", folder=tmp_path)
        assert ended.returncode == 2
        assert f"{name} is not a results file" in ended.stderr
        assert (tmp_path / name).read_bytes() == contents
        (tmp_path / name).unlink()

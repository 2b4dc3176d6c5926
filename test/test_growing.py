"""Ensembles that grow: a namelist that only adds goes on, to the bits of one run of the whole."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import signal
import struct
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student
from support.program import (
    assert_same,
    finish,
    listing,
    processor_seconds,
    run,
    start,
    wait_for,
    write_case,
)

import postproc
from postproc.reading.grid import open_results
from postproc.reading.points import by_point, means, remark
from postproc.reading.seal import seal_of
from postproc.reporting.warn import explanations, warnings

if TYPE_CHECKING:
    from pathlib import Path

ACCESS_LIST = "system.posix_acl_access"
CASE: dict[str, dict[str, Any]] = {
    "particles": {"number": 100},
    "gate": {"threshold": 2},
    "run": {"duration": 200},
    "scan": {"channel2_width": "0.01, 0.1", "replicas": 2},
    "output": {"file": "'out.h5'"},
}
# In the middle of what was there, with other numbers of particles.
WHOLE = {"number": "50, 100", "channel2_width": "0.01, 0.03, 0.1", "replicas": 3}
KEPT = {"series_interval": 10, "snapshot_times": "0, 20", "final_state": ".true."}


write = partial(write_case, CASE)


def complete(folder: Path, ranks: int = 0) -> str:
    """Run to the end; nothing is left but the results."""
    ended = run("case.nml", folder=folder, ranks=ranks)
    assert ended.returncode == 0, (ended.stdout, ended.stderr)
    assert sorted(path.name for path in folder.iterdir()) == ["case.nml", "out.h5"]
    return ended.stdout


@pytest.mark.parametrize("output", [{}, KEPT])
@pytest.mark.parametrize("ranks", [0, 2])
def test_grown_results_are_those_of_the_whole(
    tmp_path: Path, output: dict[str, Any], ranks: int
) -> None:
    """More replicas, more values of a list, and a list that was one value: the same bits."""
    write(tmp_path / "grown", output=output)
    complete(tmp_path / "grown")
    write(tmp_path / "grown", scan=WHOLE, output=output)
    said = complete(tmp_path / "grown", ranks)
    assert "going on: 4 of 18 tasks are finished" in said
    write(tmp_path / "whole", scan=WHOLE, output=output)
    complete(tmp_path / "whole", ranks)
    assert_same(tmp_path / "grown/out.h5", tmp_path / "whole/out.h5")


def access_list(path: Path) -> bytes:
    """Let one more user read a file, and its group nothing; nothing where no such lists are."""
    owner, user, group, mask, other = 0x01, 0x02, 0x04, 0x10, 0x20
    entries = [(owner, 6, -1), (user, 4, 1001), (group, 0, -1), (mask, 4, -1), (other, 0, -1)]
    listed = struct.pack("<I", 2) + b"".join(struct.pack("<HHi", *one) for one in entries)
    try:
        os.setxattr(path, ACCESS_LIST, listed)
    except (AttributeError, OSError):
        return b""
    return listed


def test_finished_tasks_are_not_done_again(tmp_path: Path) -> None:
    """What a task took of a processor is what it took then; who may read the file is who might."""
    write(tmp_path)
    complete(tmp_path)
    with h5py.File(tmp_path / "out.h5") as file:
        before = file["cpu_seconds"][()]
    (tmp_path / "out.h5").chmod(0o640)
    listed = access_list(tmp_path / "out.h5")
    write(tmp_path, scan={"replicas": 5})
    complete(tmp_path)
    with h5py.File(tmp_path / "out.h5") as file:
        assert file["chi"].shape == (2, 5)
        np.testing.assert_array_equal(file["cpu_seconds"][:, :2], before)
    assert (tmp_path / "out.h5").stat().st_mode & 0o777 == 0o640
    if listed:
        assert os.getxattr(tmp_path / "out.h5", ACCESS_LIST) == listed


def test_run_under_way_grows(tmp_path: Path) -> None:
    """A run that is stopped in the middle of tasks goes on with a larger namelist."""
    longer = {"duration": 60_000}
    # The signal may come between two tasks, or when the run is over: then there is another.
    tried = (tmp_path / f"{number}" for number in range(5))
    folder = next(folder for folder in tried if is_stopped_in_its_second_task(folder, longer))
    more = {"replicas": 3, "channel2_width": "0.001, 0.01, 0.1"}
    write(folder, run=longer, scan=more)
    # The state of the task that was under way is found, though its number is another now.
    complete(folder)
    write(tmp_path / "whole", run=longer, scan=more)
    complete(tmp_path / "whole")
    assert_same(folder / "out.h5", tmp_path / "whole/out.h5")


def is_stopped_in_its_second_task(folder: Path, run: dict[str, Any]) -> bool:
    """Stop a run after its first task; tell whether it has saved the state of another."""
    write(folder, run=run)
    process = start("case.nml", folder=folder)
    number = [process.pid]
    assert wait_for((folder / "out.h5.tasks/rank_0").exists, process, 0.001)
    # A start and a task are done: a part of that time is a part of the next task.
    until = 1.15 * processor_seconds(number)
    wait_for(lambda: processor_seconds(number) >= until, process, 0.001)
    process.send_signal(signal.SIGTERM)
    return finish(process).returncode == 3 and any((folder / "out.h5.tasks").glob("task_*"))


def test_growing_run_that_is_stopped_keeps_what_was_there(tmp_path: Path) -> None:
    """The file of a growing run that is stopped stays; `--partial` has its tasks and the new."""
    write(tmp_path)
    complete(tmp_path)
    before = (tmp_path / "out.h5").read_bytes()
    write(tmp_path, scan={"replicas": 300})
    process = start("case.nml", folder=tmp_path)
    assert wait_for((tmp_path / "out.h5.tasks/rank_0").exists, process)
    process.send_signal(signal.SIGTERM)
    assert finish(process).returncode == 3
    assert (tmp_path / "out.h5").read_bytes() == before
    assert run("--partial", "case.nml", folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "out.h5.partial.h5") as file:
        assert file["task_status"].shape == (2, 300)
        assert not file["task_status"][:, :2].any()
        done = np.count_nonzero(file["task_status"][()] == 0)
    said = run("--check", "case.nml", folder=tmp_path).stdout
    assert f"finished:   {done} tasks; to be done: {600 - done}" in said


def test_check_says_how_many_tasks_are_to_be_done(tmp_path: Path) -> None:
    """It looks at the results that are there, and writes nothing."""

    def said(*words: str) -> str:
        return run("--check", *words, "case.nml", folder=tmp_path).stdout

    write(tmp_path)
    assert "finished:   0 tasks; to be done: 4" in said()
    complete(tmp_path)
    assert "finished:   4 tasks; to be done: 0" in said()
    write(tmp_path, scan={"replicas": 7})
    before = listing(tmp_path)
    assert "finished:   4 tasks; to be done: 10" in said()
    assert "finished:   0 tasks; to be done: 14" in said("--overwrite")
    assert listing(tmp_path) == before


@pytest.mark.parametrize(
    ("scan", "named"),
    [
        ({"replicas": 1}, "&scan replicas: was 2, is 1"),
        ({"channel2_width": "0.01", "replicas": 3}, "&scan channel2_width: was 0.01 0.1, is 0.01"),
        ({"channel2_width": "0.01, 0.1, 0.2", "replicas": 1}, "&scan replicas: was 2, is 1"),
        ({"channel2_width": "0.01, 0.2, 0.3"}, "&scan channel2_width"),
    ],
)
@pytest.mark.parametrize("words", [("case.nml",), ("--check", "case.nml")])
def test_what_shrinks_is_refused(
    tmp_path: Path, scan: dict[str, Any], named: str, words: tuple[str, ...]
) -> None:
    """A namelist that lacks a task of before: one message with the keys, and nothing changes."""
    write(tmp_path)
    complete(tmp_path)
    write(tmp_path, scan=scan)
    before = listing(tmp_path)
    ended = run(*words, folder=tmp_path)
    assert ended.returncode == 2
    assert named in ended.stderr
    assert listing(tmp_path) == before


def test_growth_that_is_given_up_leaves_the_results(tmp_path: Path) -> None:
    """They are of the input of before; the journal is not, and can be removed."""
    write(tmp_path)
    complete(tmp_path)
    write(tmp_path, scan={"replicas": 5000})
    process = start("case.nml", folder=tmp_path)
    assert wait_for((tmp_path / "out.h5.tasks/rank_0").exists, process)
    process.send_signal(signal.SIGTERM)
    assert finish(process).returncode == 3
    write(tmp_path)
    for words in (["case.nml"], ["--check", "case.nml"], ["--partial", "case.nml"]):
        ended = run(*words, folder=tmp_path)
        assert ended.returncode == 2
        assert ended.stderr.startswith("out.h5.tasks was made from another input; these differ:")
        assert "&scan replicas: was 5000, is 2" in ended.stderr
        assert "or remove this folder; out.h5 stays as it is" in ended.stderr
        assert "--overwrite" not in ended.stderr
    shutil.rmtree(tmp_path / "out.h5.tasks")
    assert "is complete" in run("case.nml", folder=tmp_path).stdout


def test_no_advice_discards_what_is_of_this_input(tmp_path: Path) -> None:
    """Beside a journal of it other results are to be moved; what is accepted is to be kept."""
    write(tmp_path)
    complete(tmp_path)
    write(tmp_path, scan={"replicas": 5000}, particles={"number": 90})
    ended = run("case.nml", folder=tmp_path)
    assert ended.stderr.endswith("name another output file, or discard it with --overwrite\n")
    (tmp_path / "out.h5").rename(tmp_path / "other.h5")
    process = start("case.nml", folder=tmp_path)
    assert wait_for((tmp_path / "out.h5.tasks/rank_0").exists, process)
    process.send_signal(signal.SIGTERM)
    assert finish(process).returncode == 3
    (tmp_path / "other.h5").rename(tmp_path / "out.h5")
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "move it away, with out.h5.tasks if that is of the same input; --over" in ended.stderr
    for option in ("--partial", "--accept"):
        ended = run(option, "case.nml", folder=tmp_path)
        assert ended.returncode == 2
        assert ended.stderr.endswith("\nuse the namelist and the version that it was made with\n")
        h5py.File(tmp_path / "out.h5", "a").close()  # has no digest then


def test_other_output_is_refused(tmp_path: Path) -> None:
    """What is kept beside the averages cannot be had of tasks that are finished."""
    write(tmp_path)
    complete(tmp_path)
    write(tmp_path, scan={"replicas": 3}, output={"series_interval": 10})
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "&output series_interval: was 0, is 10" in ended.stderr


def test_results_of_another_version_do_not_grow(tmp_path: Path) -> None:
    """One message that names the version; nothing changes."""
    write(tmp_path)
    complete(tmp_path)
    with h5py.File(tmp_path / "out.h5", "r+") as file:
        file.attrs["version"] = "0.0.9"
    content = (tmp_path / "out.h5").read_bytes().split(b"battery results 1")[0]
    seal = seal_of(len(content), hashlib.sha256(content).hexdigest())
    (tmp_path / "out.h5").write_bytes(content + seal)
    before = listing(tmp_path)
    ended = run("--partial", "case.nml", folder=tmp_path)
    assert (ended.returncode, "was made by version 0.0.9" in ended.stderr) == (2, True)
    assert listing(tmp_path) == before
    write(tmp_path, scan={"replicas": 3})
    before = listing(tmp_path)
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "version 0.0.9" in ended.stderr
    assert listing(tmp_path) == before


def test_growth_under_way_is_not_thrown_away(tmp_path: Path) -> None:
    """The smaller namelist, whose results are there, does not discard a journal of the larger."""
    write(tmp_path)
    complete(tmp_path)
    results = (tmp_path / "out.h5").read_bytes()
    write(tmp_path, scan={"replicas": 300})
    process = start("case.nml", folder=tmp_path)
    assert wait_for((tmp_path / "out.h5.tasks/rank_0").exists, process)
    process.kill()
    process.communicate()
    assert (tmp_path / "out.h5").read_bytes() == results
    write(tmp_path)
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert "&scan replicas: was 300, is 2" in ended.stderr
    assert (tmp_path / "out.h5.tasks/rank_0").exists()


WIDTHS = {"channel2_width": "0.01, 0.1", "replicas": 16}
ASKED = {"chi_replica_error": 0.003, "largest_replicas": 50}


@pytest.fixture(scope="module")
def precise(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the results of one run to a precision."""
    folder = tmp_path_factory.mktemp("precise")
    write(folder, scan=WIDTHS, precision=ASKED)
    complete(folder)
    return folder / "out.h5"


def test_first_replicas_tell_how_many_there_are(precise: Path) -> None:
    """With Student's factor; no more than allowed. The stated error is that of all replicas."""
    with h5py.File(precise) as file:
        chi, status = file["chi"][()], file["task_status"][()]
        stated, points = file["chi_replica_error"][()], file["point_status"][()]
    given = np.count_nonzero(status == 0, axis=1)
    scatter = student.ppf(norm.cdf(1), 15) * np.std(chi[:, :16], axis=1, ddof=1)
    needed = np.maximum(16, np.ceil((scatter / 0.003) ** 2))
    np.testing.assert_array_equal(given, np.minimum(needed, 50))
    np.testing.assert_array_equal(points, needed > 50)
    errors = np.nanstd(chi, axis=1, ddof=1) / np.sqrt(given)
    np.testing.assert_allclose(stated, errors, rtol=1e-9)
    assert set(np.unique(status)) == {0, 3}
    assert np.isnan(chi[status == 3]).all()


@pytest.mark.parametrize("ranks", [2, 3])
def test_precision_is_the_same_on_any_ranks(tmp_path: Path, precise: Path, ranks: int) -> None:
    """It is decided from complete results alone."""
    write(tmp_path, scan=WIDTHS, precision=ASKED)
    complete(tmp_path, ranks)
    assert_same(tmp_path / "out.h5", precise)


def test_precision_may_be_asked_for_later(tmp_path: Path, precise: Path) -> None:
    """From none over a coarser one to the finer: the bits of one run."""
    write(tmp_path, scan=WIDTHS)
    complete(tmp_path)
    write(tmp_path, scan=WIDTHS, precision={"chi_replica_error": 0.004, "largest_replicas": 40})
    complete(tmp_path, 2)
    write(tmp_path, scan=WIDTHS, precision=ASKED)
    complete(tmp_path)
    assert_same(tmp_path / "out.h5", precise)


def test_a_partial_file_of_all_that_a_precision_needs_is_replaced(
    tmp_path: Path, precise: Path
) -> None:
    """It has fewer tasks than the plan: those that nobody asks for."""
    shutil.copytree(precise.parent, tmp_path, dirs_exist_ok=True)
    for _ in range(2):
        ended = run("--partial", "case.nml", folder=tmp_path)
        assert ended.returncode == 0, ended.stderr


def test_all_replicas_may_be_asked_for_after_a_precision(tmp_path: Path, precise: Path) -> None:
    """Without a precision every replica is asked for: that only adds. Fewer are refused."""
    write(tmp_path / "grown", scan=WIDTHS)
    shutil.copy(precise, tmp_path / "grown/out.h5")
    ended = run("case.nml", folder=tmp_path / "grown")
    assert ended.returncode == 2
    assert "&precision chi_replica_error: was 0.003, is not given" in ended.stderr
    all_replicas = {**WIDTHS, "replicas": 50}
    write(tmp_path / "grown", scan=all_replicas)
    assert "going on: " in complete(tmp_path / "grown")
    write(tmp_path / "whole", scan=all_replicas)
    complete(tmp_path / "whole")
    assert_same(tmp_path / "grown/out.h5", tmp_path / "whole/out.h5")


def test_what_points_may_still_ask_for_is_told_where_a_run_goes_on(tmp_path: Path) -> None:
    """Of one whose first replicas are not complete."""
    write(tmp_path, scan={**WIDTHS, "channel2_width": "0.01"})
    complete(tmp_path)
    write(tmp_path, scan=WIDTHS, precision={"chi_replica_error": 1.0, "largest_replicas": 50})
    words = "going on: 16 of 32 tasks are finished, and up to 34 more as the first replicas tell"
    assert words in run("--check", "case.nml", folder=tmp_path).stdout
    assert words in run("case.nml", folder=tmp_path).stdout


@pytest.mark.parametrize("more", [None, 0.012])
def test_there_is_no_room_for_replicas_that_nobody_asks_for(
    tmp_path: Path, more: float | None
) -> None:
    """Series and states are as large as those that are there, and read as if all had been kept."""
    kept = {"series_interval": 0.5, "snapshot_times": "0, 20", "final_state": ".true."}
    sizes = []
    for allowed in (50, 1000):
        folder = tmp_path / str(allowed)
        asked = {"chi_replica_error": 0.02, "largest_replicas": allowed}
        for error in (0.02, more) if more else (0.02,):
            write(folder, scan=WIDTHS, precision=asked | {"chi_replica_error": error}, output=kept)
            complete(folder)
        with h5py.File(folder / "out.h5") as file:
            names = ["series/urn1_number", "series/flow1_12", "snapshots/x", "final/uy"]
            sizes.append(sum(file[name].id.get_storage_size() for name in names))
            most = np.max(np.flatnonzero((file["task_status"][()] == 0).any(axis=0))) + 1
            assert 16 <= most < 50
            found = {name: file[name][:, :50] for name in names}
            for name in names:
                assert file[name].shape[:2] == (2, allowed)
                last = file[name][:, -1]
                assert (np.isnan(last) if last.dtype.kind == "f" else last == -1).all()
            assert file["series/urn1_number"].shape[2] == 401
        if allowed == 50:
            few = found
    for name in few:
        np.testing.assert_array_equal(found[name], few[name])
    assert sizes[1] < 2 * sizes[0]


def test_stopped_on_the_way_to_a_precision(tmp_path: Path, precise: Path) -> None:
    """Signals at any moment leave the same replicas and the same bits."""
    write(tmp_path, scan=WIDTHS, precision=ASKED)
    for delay in (0.02, 0.04, 0.06, 0.08, 0.1):
        process = start("case.nml", folder=tmp_path)
        time.sleep(delay)
        process.kill()
        process.communicate()
    complete(tmp_path)
    assert_same(tmp_path / "out.h5", precise)


def test_a_closed_channel_has_no_error_to_be_reached(tmp_path: Path) -> None:
    for name, asked, status in (("polarised_current", 0.01, 0), ("chi", 1e-4, 1), ("chi", 0.5, 0)):
        write(tmp_path, run={"duration": 20}, scan={"channel2_width": 0.0, "replicas": 16},
              precision={f"{name}_replica_error": asked, "largest_replicas": 16})  # fmt: skip
        (tmp_path / "out.h5").unlink(missing_ok=True)
        said = complete(tmp_path)
        assert ("asks for more than largest_replicas" in said) is bool(status)
        with h5py.File(tmp_path / "out.h5") as file:
            assert file["point_status"][()].tolist() == [status]


@pytest.fixture(scope="module")
def bistable(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Give the results of a circuit that starts between two states that last, and what it said."""
    folder = tmp_path_factory.mktemp("bistable")
    write(
        folder,
        particles={"number": 1000, "urn1_fraction": 0.8},
        run={"duration": 8000, "transient_duration": 7000},
        scan={"channel2_width": "0.005, 0.1", "replicas": 16},
        precision={"chi_replica_error": 0.05, "largest_replicas": 20},
    )
    return folder / "out.h5", complete(folder)


def test_a_point_in_two_states_is_listed_and_has_no_mean(bistable: tuple[Path, str]) -> None:
    """With both of its states; the other point of the scan has its mean."""
    path, said = bistable
    with h5py.File(path) as file:
        chi = file["chi"][0][file["task_status"][0] == 0]
        assert file["point_status"][()].tolist() == [2, 0]
        assert np.isnan(file["chi_replica_error"][()]).tolist() == [True, False]
    low, high = chi[chi < 0.5], chi[chi > 0.5]
    assert low.max() < 0.2
    assert high.min() > 0.9
    assert chi.size == 16  # no more than the first
    assert "replicas fall into two states, points (from 0): 0\n" in said
    states = re.search(r" 16   two states: chi = (\S+) in (\d+), chi = (\S+) in (\d+)\n", said)
    assert [int(states[2]), int(states[4])] == [low.size, high.size]
    np.testing.assert_allclose([float(states[1]), float(states[3])], [low.mean(), high.mean()],
                               atol=6e-6)  # fmt: skip


def test_python_does_not_average_two_states(bistable: tuple[Path, str]) -> None:
    """Nor does it miss tasks that nobody asked for."""
    results = by_point(open_results(bistable[0]))
    assert np.isnan(means(results, "chi")[0]).tolist() == [True, False]
    assert remark(results) == ""
    assert not any("no results" in text for text in warnings(results))
    assert "1 of 2 points the replicas fall into two states" in explanations(results)[0]
    data = postproc.open_results(bistable[0])
    count = np.count_nonzero(data["task_status"] == 0)
    assert data.attrs["tasks"] == f"{count} of {count} tasks are complete"


def test_check_says_what_a_precision_may_cost(tmp_path: Path, precise: Path) -> None:
    """What is known to be needed, what may come, and what will if points are alike."""
    ask = {"scan": WIDTHS, "precision": ASKED}

    def said(*words: str) -> str:
        return run("--check", *words, "case.nml", folder=tmp_path).stdout

    fresh = "finished:   0 tasks; to be done: 32, and up to 68 more as the first replicas tell"
    write(tmp_path, **ask)
    assert fresh in said()
    assert re.search(r"time: +about \S+ s on 1 rank; at most \S+ s\n", said())
    (tmp_path / "out.h5").write_bytes(precise.read_bytes())
    with h5py.File(precise) as file:
        done = np.count_nonzero(file["task_status"][()] == 0)
    assert f"finished:   {done} tasks; to be done: 0\n" in said()
    assert fresh in said("--overwrite")
    write(tmp_path, scan={**WIDTHS, "channel2_width": "0.01, 0.03, 0.1"}, precision=ASKED)
    assert f"finished:   {done} tasks; to be done: 16, and up to 34 more" in said()
    assert re.search(r" rank; \S+ s if the other points get as many replicas .*; at most", said())
    write(tmp_path, scan=WIDTHS, precision={**ASKED, "chi_replica_error": 0.002})
    assert f"finished:   {done} tasks; to be done: " in said()


def test_coarser_precision_is_refused(tmp_path: Path, precise: Path) -> None:
    """As fewer replicas are."""
    (tmp_path / "out.h5").write_bytes(precise.read_bytes())
    for keys in ({"chi_replica_error": 0.004}, {"largest_replicas": 49}):
        write(tmp_path, scan=WIDTHS, precision={**ASKED, **keys})
        ended = run("case.nml", folder=tmp_path)
        assert ended.returncode == 2
        assert f"&precision {next(iter(keys))}: was " in ended.stderr


@pytest.mark.parametrize(
    ("replicas", "precision", "named"),
    [
        (16, {"chi_replica_error": 0}, "&precision chi_replica_error = 0"),
        (16, {"polarised_current_replica_error": -1}, "polarised_current_replica_error = -1"),
        (15, {"chi_replica_error": 0.1}, "&scan replicas = 15; allowed: from 16 up"),
        (16, {"chi_replica_error": 0.1, "largest_replicas": 15}, "largest_replicas = 15; allowed"),
        (16, {"largest_replicas": 20}, "largest_replicas is given without a precision"),
        (16, {"chi_replica_error": 0.1, "largest_replicas": 6_000_000}, "&precision largest_repl"),
    ],
)
def test_precision_that_makes_no_sense_is_refused(
    tmp_path: Path, replicas: int, precision: dict[str, Any], named: str
) -> None:
    """One message that names the key."""
    write(tmp_path, scan={"replicas": replicas}, precision=precision)
    before = listing(tmp_path)
    ended = run("case.nml", folder=tmp_path)
    assert ended.returncode == 2
    assert named in ended.stderr
    assert listing(tmp_path) == before


def test_one_urn_has_no_precision(tmp_path: Path) -> None:
    """Its chi is not known, and there is no channel 2."""
    for key in ("chi_replica_error", "polarised_current_replica_error"):
        scan = {"channel2_width": None, "replicas": 16}
        write(tmp_path, table={"shape": "'urn'"}, scan=scan, precision={key: 0.1})
        ended = run("case.nml", folder=tmp_path)
        assert ended.returncode == 2
        assert f"&precision {key} = 0.1; allowed: nothing" in ended.stderr


def test_tasks_say_when_and_where_they_ran(tmp_path: Path) -> None:
    """So do those of before, after the file has grown; the program says what it was made of."""
    write(tmp_path)
    complete(tmp_path)
    with h5py.File(tmp_path / "out.h5") as file:
        before = file["provenance/ended"][()]
        assert (file["provenance/begun"][()] <= before).all()
    write(tmp_path, scan={"replicas": 3})
    complete(tmp_path)
    versioned = run("--version", folder=tmp_path).stdout
    with h5py.File(tmp_path / "out.h5") as file:
        np.testing.assert_array_equal(file["provenance/ended"][:, :2], before)
        assert (file["provenance/ended"][:, 2] > before.max()).all()
        about = file["provenance"].attrs
        hosts = about["hosts"].splitlines()
        assert about["command_line"].endswith("case.nml")
        assert about["begun"] <= about["ended"] == file.attrs["created"]
        assert (file["provenance/host"][()] < len(hosts)).all()
        assert all("(" in host for host in hosts)
        for name in ("compiler", "compiler_options", "mpi_library", "hdf5_library", "gsl_library"):
            assert f"{name}: {file.attrs[name]}\n" in versioned

"""The example jobs under a real Slurm of two nodes: stopped, queued again, and the same bits."""

from __future__ import annotations

import functools
import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from attack.scene import workshop
from support import cluster_packages, program
from support.slurm import Slurm

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ROOT = program.ROOT
LACKING = cluster_packages.lacking()
pytestmark = [pytest.mark.full, pytest.mark.skipif(bool(LACKING), reason=LACKING)]
MPI = [
    "openmpi",
    pytest.param("mpich", marks=pytest.mark.skipif(
        not shutil.which("mpirun.mpich"), reason="MPICH is not installed")),
]  # fmt: skip
# Collisions of a task: about a second. Ranks that are to hear a signal stand still until it comes.
SHORT = 40_000_000
# Of a busy machine, seconds.
PATIENCE = 240.0
EXAMPLES = ["slurm.sh", "slurm_mpirun.sh"]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slurm]:
    """Start the cluster once."""
    with Slurm(tmp_path_factory.mktemp("s"), [tmp_path_factory.getbasetemp(), ROOT]) as slurm:
        yield slurm


@pytest.fixture
def slurm(cluster: Slurm) -> Iterator[Slurm]:
    """Give the cluster; a test that fails leaves nothing to the next."""
    yield cluster
    release(cluster)


def built(mpi: str) -> Path:
    """Give the program of an MPI; that of MPICH is built first."""
    if mpi == "openmpi":
        return program.PROGRAM
    program.make("build", "MPI=mpich", "MPIFC=mpifort.mpich")
    return ROOT / "build/mpich/bin/battery"


def checkout(folder: Path, mpi: str, collisions: int, seed: int = 1) -> Path:
    """Make what an example expects of its folder: the program, and small cases for its namelists.

    Its MPI's mpirun is the first of that name.
    """
    (folder / "build/bin").mkdir(parents=True)
    (folder / "build/bin/battery").symlink_to(built(mpi))
    (folder / "bin").mkdir()
    mpirun = folder / "bin/mpirun"
    path = shutil.which(f"mpirun.{mpi}") or "/usr/bin/mpirun"
    mpirun.write_text(f'#!/bin/sh\nexec {path} "$@"\n')
    mpirun.chmod(0o755)
    (folder / "namelists").mkdir()
    for name in ("phase_diagram", "paper_a", "paper_b"):
        text = program.namelist(
            particles={"number": 100, "seed": seed}, gate={"threshold": 3},
            run={"collisions": collisions}, scan={"replicas": 2},
            output={"file": f"'{name}.h5'"}, limits={"checkpoint_minutes": 0.0005},
        )  # fmt: skip
        (folder / f"namelists/{name}.nml").write_text(text)
    return folder


def submitted(slurm: Slurm, script: str, folder: Path, *options: str) -> str:
    """Submit an example as it is; what a site must change is said to sbatch."""
    return slurm.submit(
        ROOT / "namelists" / script, "--nodes=2", "--ntasks=2", "--output=%x-%A-%a.log", *options,
        f"--export=ALL,PATH={folder}/bin:/usr/bin:/bin,OMPI_ALLOW_RUN_AS_ROOT=1,"
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1",
        folder=folder,
    )  # fmt: skip


def log(folder: Path) -> str:
    """Give what jobs have printed."""
    return "\n".join(file.read_text(errors="replace") for file in folder.glob("*.log"))


def assert_ended_well(
    slurm: Slurm, job: str, folder: Path, name: str, *, again: bool = True
) -> None:
    """Wait for a job's end, queued again or not; its file has the bits of an undisturbed run."""
    found = slurm.end_of(job, PATIENCE)
    if found["JobState"] != "COMPLETED" or (int(found["Restarts"]) > 0) != again:
        pytest.fail("\n".join([*(f"{key}={value}" for key, value in found.items()), log(folder)]))
    assert_undisturbed(folder, name)


@functools.cache
def undisturbed(text: str) -> Path:
    """Give the results of a namelist on one rank that nothing disturbs."""
    folder = Path(tempfile.mkdtemp(dir=workshop()))
    (folder / "case.nml").write_text(text)
    subprocess.run([program.PROGRAM, "--quiet", "case.nml"], cwd=folder, env=program.ALONE,
                   timeout=PATIENCE, check=True)  # fmt: skip
    return next(folder.glob("*.h5"))


def assert_undisturbed(folder: Path, name: str) -> None:
    """Compare a results file with that of a run that nothing disturbed; nothing else is left."""
    assert not list(folder.glob(f"{name}.h5.*")), log(folder)
    calm = undisturbed(next((folder / "namelists").rglob(f"{name}.nml")).read_text())
    left, right = program.contents(folder / f"{name}.h5"), program.contents(calm)
    of_the_build = {"/@mpi_library", "/@compiler_options", "/@git_commit"}
    assert left.keys() == right.keys()
    assert {key for key in left if left[key] != right[key]} <= of_the_build


def wait_for(condition: Callable[[], bool], folder: Path) -> None:
    """Wait until something is so of jobs in that folder."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, log(folder)
        time.sleep(0.05)


def halted(folder: Path, *names: str) -> list[int]:
    """Stop both ranks of each run that has saved a state; give their process numbers.

    None if a run was too fast for that, so that all its tasks are complete.
    """
    found: set[int] = set()

    def begun(name: str) -> bool:
        return any((folder / f"{name}.h5.tasks").glob("task_*"))

    def is_over(name: str) -> bool:
        return (folder / f"{name}.h5").exists()

    def all_stand_still_or_one_is_over() -> bool:
        there = [name for name in names if begun(name)]
        for one in filter(program.is_program, program.descendants(os.getpid())):
            words = command_line(one)
            if words.startswith(f"{folder} ") and any(f"/{name}.nml" in words for name in there):
                found.add(one)
        program.send(list(found), signal.SIGSTOP)
        still = len(found) == 2 * len(names) and all(state(one) == "T" for one in found)
        return still or any(map(is_over, names))

    wait_for(all_stand_still_or_one_is_over, folder)
    return list(found) if all(begun(name) and not is_over(name) for name in names) else []


def start_and_halt(
    slurm: Slurm,
    place: Path,
    mpi: str,
    script: str,
    *options: str,
    names: tuple[str, ...] = ("phase_diagram",),
) -> tuple[Path, str, list[int]]:
    """Submit an example in a new folder and halt its runs in their midst.

    On a busy machine a run may be over before it is seen; then longer ones are submitted.
    """  # fmt: skip
    for collisions in (SHORT, 10 * SHORT, 100 * SHORT):
        folder = checkout(place / str(collisions), mpi, collisions)
        job = submitted(slurm, script, folder, *options)
        if ranks := halted(folder, *names):
            return folder, job, ranks
        release(slurm)
    pytest.fail(f"{script}: over before it could be halted\n{log(folder)}")


def release(slurm: Slurm) -> None:
    """Cancel all jobs, and let every rank go on, so that nothing holds the nodes."""
    slurm.ask("scancel", "--user=root")
    ranks = [one for one in program.descendants(os.getpid()) if program.is_program(one)]
    program.send(ranks, signal.SIGCONT)
    slurm.wait_until_idle()


def go_on(ranks: list[int], folder: Path) -> None:
    """Let ranks go on as soon as all have been told to stop (scancel itself lets them go on)."""

    def told(rank: int) -> bool:
        sent = (program.has_been_sent(rank, one) for one in (signal.SIGUSR1, signal.SIGTERM))
        return state(rank) != "T" or any(sent)

    wait_for(lambda: all(map(told, ranks)), folder)
    program.send(ranks, signal.SIGCONT)


def command_line(process: int) -> str:
    """Give the folder and the words of a process; none if it is gone."""
    try:
        folder = Path(f"/proc/{process}/cwd").readlink()
    except OSError:
        return ""
    return f"{folder} " + " ".join(program.words_of(Path(f"/proc/{process}/cmdline")))


def state(process: int) -> str:
    """Give the system's letter for what a process does; X, dead, if it is gone."""
    words = program.words_of(Path(f"/proc/{process}/status"))
    return words[words.index("State:") + 1] if "State:" in words else "X"


def test_a_time_limit_is_no_end(slurm: Slurm, tmp_path: Path) -> None:
    """Slurm's own signal before the limit: state saved, queued again, complete in the end.

    Slurm looks every half minute which jobs are near their limits.
    """
    folders, jobs, ranks = {}, {}, {}
    for script in EXAMPLES:
        to = "B:" if "mpirun" in script else ""
        folders[script], jobs[script], ranks[script] = start_and_halt(
            slurm, tmp_path / script, "openmpi", script, f"--signal={to}USR1@50"
        )

    def limit(script: str, minutes: int) -> None:
        slurm.ask("scontrol", "update", f"JobId={jobs[script]}", f"TimeLimit={minutes}")

    for script in EXAMPLES:
        limit(script, 1)
    for script, folder in folders.items():
        go_on(ranks[script], folder)
        # Once is enough.
        limit(script, 60)
    for script, folder in folders.items():
        assert_ended_well(slurm, jobs[script], folder, "phase_diagram")


@pytest.mark.parametrize("mpi", MPI)
@pytest.mark.parametrize("script", EXAMPLES)
def test_a_job_that_is_told_to_stop_goes_on(
    slurm: Slurm, tmp_path: Path, script: str, mpi: str
) -> None:
    """The signal, sent by hand, to whom each example has it sent."""
    folder, job, ranks = start_and_halt(slurm, tmp_path, mpi, script)
    slurm.ask("scancel", *(["--batch"] if "mpirun" in script else []), "--signal=USR1", job)
    go_on(ranks, folder)
    assert_ended_well(slurm, job, folder, "phase_diagram")


@pytest.mark.parametrize("mpi", MPI)
def test_an_element_of_an_array_goes_on_alone(slurm: Slurm, tmp_path: Path, mpi: str) -> None:
    """The last element's job has the array's number; one that was complete before stays so."""
    folder, job, ranks = start_and_halt(
        slurm, tmp_path, mpi, "slurm_array.sh", "--array=0-1", names=("paper_a", "paper_b")
    )
    of_the_last = [one for one in ranks if "/paper_b.nml" in command_line(one)]
    program.send([one for one in ranks if one not in of_the_last], signal.SIGCONT)
    assert_ended_well(slurm, f"{job}_0", folder, "paper_a", again=False)
    assert slurm.about(f"{job}_1")["JobId"] == job
    slurm.ask("scancel", "--signal=USR1", f"{job}_1")
    go_on(of_the_last, folder)
    assert_ended_well(slurm, f"{job}_1", folder, "paper_b")
    assert_ended_well(slurm, f"{job}_0", folder, "paper_a", again=False)


@pytest.mark.parametrize("script", EXAMPLES)
def test_a_cancelled_job_goes_on_when_it_is_submitted_again(
    slurm: Slurm, tmp_path: Path, script: str
) -> None:
    """Scancel saves the states under srun; the output is free for the next job in any case."""
    folder, job, ranks = start_and_halt(slurm, tmp_path, "openmpi", script)
    slurm.ask("scancel", job)
    go_on(ranks, folder)
    assert slurm.end_of(job, PATIENCE)["JobState"] == "CANCELLED"
    slurm.wait_until_idle()
    if "mpirun" not in script:
        assert list((folder / "phase_diagram.h5.tasks").glob("task_*")), log(folder)
    assert_ended_well(slurm, submitted(slurm, script, folder), folder, "phase_diagram", again=False)


@pytest.mark.parametrize("mpi", MPI[1:])
def test_programs_of_one_rank_are_told_what_to_type(slurm: Slurm, tmp_path: Path, mpi: str) -> None:
    """MPICH under srun without its PMI: one computes, the others name srun and the way out."""
    folder = checkout(tmp_path, mpi, 100 * SHORT)
    start = ["srun", "--mpi=none", "--nodes=2", "--ntasks=3"]
    program_itself, namelist = "build/bin/battery", "namelists/phase_diagram.nml"
    run = slurm.nodes["head"].start(*start, program_itself, "--quiet", namelist, cwd=folder,
        env=slurm.environment, stderr=(folder / "job.log").open("w"))  # fmt: skip
    advice = ("; srun has started 3 programs of one rank each, not one run of 3 ranks: choose what "
              "MPICH Version: ")  # fmt: skip
    wait_for(lambda: log(folder).count(advice) == 2, folder)
    assert "`srun --mpi=list`, such as `srun --mpi=pmix` (Open MPI) or" in log(folder)
    for line in log(folder).splitlines():
        if advice in line:
            assert "phase_diagram.h5: another run has locked it, on node" in line
    # Words that write nothing, and outputs of their own: nothing to complain of.
    for k in range(3):
        text = (folder / "namelists/paper_a.nml").read_text()
        text = text.replace(str(100 * SHORT), str(SHORT // 10)).replace("paper_a.h5", f"{k}.h5")
        (folder / f"{k}.nml").write_text(text)
    words = ["--version", "--help", "--schema", f"--check {namelist}", "$SLURM_PROCID.nml"]
    slurm.ask(*start, "sh", "-c", " && ".join(f"{program_itself} {one}" for one in words),
              folder=folder)  # fmt: skip
    slurm.ask("scancel", "--user=root")
    run.wait(timeout=PATIENCE)

"""Ranks on several machines: namespaces with a name, an address and a network of their own."""

from __future__ import annotations

import signal
import subprocess
import time
from typing import TYPE_CHECKING

import h5py
import pytest
from attack import nodes as attack
from attack.common import trials
from attack.scene import undisturbed, write
from support import cluster_packages, program
from support.nodes import PATIENCE, Nodes

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LACKING = cluster_packages.lacking()
pytestmark = [pytest.mark.full, pytest.mark.skipif(bool(LACKING), reason=LACKING)]
HOSTS = ["--host", "node1:1,node2:1"]


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Nodes]:
    """Make two machines and one that has the files."""
    with Nodes(["node1", "node2", "files"], [tmp_path, program.ROOT]) as nodes:
        yield nodes


def start(machines: Nodes, folder: Path, **settings: str) -> subprocess.CompletedProcess[str]:
    """Run the case of a folder with a rank on each machine."""
    environment = {**attack.SETTINGS, **settings}
    agent = machines.agent(folder.parent / "agent", env=environment)
    words = ["mpirun", "--mca", "plm_rsh_agent", str(agent), *HOSTS, str(program.PROGRAM)]
    return machines["node1"].run(*words, "--quiet", "case.nml", cwd=folder, env=environment)


def test_ranks_on_two_machines_give_the_same_bits(machines: Nodes, tmp_path: Path) -> None:
    """Each of them has done some of the tasks."""
    folder = tmp_path / "case"
    write(folder, run={"collisions": attack.COLLISIONS})
    ended = start(machines, folder)
    assert ended.returncode == 0, ended.stderr
    program.assert_same(folder / "out.h5", undisturbed(collisions=attack.COLLISIONS))
    with h5py.File(folder / "out.h5") as file:
        hosts = file["provenance"].attrs["hosts"]
    assert all(f"node{k} (" in str(hosts) for k in (1, 2)), hosts


def test_an_mpi_that_cannot_do_it_is_named(machines: Nodes, tmp_path: Path) -> None:
    """Where the ranks' MPI has no one-sided operations between machines; nothing hangs."""
    folder = tmp_path / "case"
    write(folder)
    ended = start(machines, folder, OMPI_MCA_osc="sm")
    assert ended.returncode == 1, (ended.returncode, ended.stdout, ended.stderr)
    assert ended.stderr.count("battery: Open MPI v") == 1
    assert "refuses one-sided operations between these ranks" in ended.stderr
    assert not (folder / "out.h5.owner").exists()


def test_of_two_machines_that_start_at_once_one_has_the_output(
    machines: Nodes, tmp_path: Path
) -> None:
    """Also where neither sees the locks of the other."""
    write(tmp_path / "case", run={"collisions": 100 * attack.COLLISIONS})
    place = attack.mount(machines, tmp_path / "case")
    for _ in range(3):
        runs = [attack.start(machines[name], place) for name in ("node1", "node2")]
        lost: dict[int, subprocess.Popen[str]] = {}
        end = time.monotonic() + PATIENCE
        while not lost:
            assert time.monotonic() < end, "both run"
            lost = {k: run for k, run in enumerate(runs) if run.poll() is not None}
            time.sleep(0.01)
        ((k, run),) = lost.items()
        words = run.communicate(timeout=PATIENCE)[0]
        assert run.returncode == 2, words
        assert f"out.h5: another run has locked it, on node{2 - k}, process " in words
        other = program.descendants(runs[1 - k].pid)
        program.send(other, signal.SIGTERM)
        words = runs[1 - k].communicate(timeout=PATIENCE)[0]
        assert runs[1 - k].returncode == 3, words
        assert not (tmp_path / "case/out.h5.owner").exists()


def test_what_is_cut_off_does_no_harm() -> None:
    """A machine dies, or its network goes away and comes back (attack.nodes has more of this)."""
    outcome = trials("nodes", attack.campaign, 20261123, range(4))
    assert not outcome.findings, "\n".join(outcome.findings)

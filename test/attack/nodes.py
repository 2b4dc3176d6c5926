"""Several machines and one shared folder: a machine dies, its network goes away and comes back.

Each campaign makes three machines (`support/nodes.py`): two compute, one has the files. They reach
the folder as a local disk, or by sshfs, whose locks hold on one machine only, and which waits while
the network is away. `mpirun` starts ranks on both machines by an agent of a few lines.
Then one of them dies or is cut off, and a user at the other one goes on: first as if nothing had
happened, which is refused while the owner's file is that of the other machine; then with that file
removed. What was cut off comes back and writes. In the end the results must be the bits of an
undisturbed run. Only root may do this.
"""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

from support.nodes import Node, Nodes
from support.program import ENVIRONMENT, PROGRAM, ROOT, descendants, send, wait_for

from .common import PATIENCE, Outcome, command_line, unlike
from .scene import undisturbed, write

# Of a task.
COLLISIONS = 20_000_000
SFTP = "/usr/lib/openssh/sftp-server"
# Open MPI 4 of Debian has no other one-sided operations between machines.
SETTINGS = {**ENVIRONMENT, "OMPI_MCA_osc": "^ucx"}


def mount(nodes: Nodes, folder: Path) -> Path:
    """Let the machines reach a folder through the network, and give its name there."""
    nodes["files"].serve(2222, SFTP)
    place = Path("/mnt/shared")
    for name in ("node1", "node2"):
        mounted = nodes[name].run("sh", "-ec", f"mkdir {place} && sshfs -o directport=2222 "
                                  f"files:{folder} {place}")  # fmt: skip
        assert mounted.returncode == 0, mounted.stderr
    return place


def inside(place: Path, *words: str) -> list[str]:
    """Give a command that runs another one in a folder that only a machine can see."""
    return ["sh", "-c", f'cd {place} && exec "$@"', "sh", *words]


def start(node: Node, place: Path, *launcher: str) -> subprocess.Popen[str]:
    """Start the case on a machine, alone or by a launcher."""
    return node.start(
        *inside(place, *launcher, str(PROGRAM), "--quiet", "case.nml"), env=SETTINGS,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip


def attempt(node: Node, place: Path) -> tuple[int, str]:
    """Run the case on a machine alone; give exit code and words."""
    process = start(node, place)
    try:
        words, _ = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        send(descendants(process.pid), signal.SIGKILL)
        return -1, f"hung: {process.communicate()[0]}"
    return process.returncode, words


def stop(process: subprocess.Popen[str]) -> None:
    """Tell an mpirun to end, behind the command that has entered its machine; kill what stays."""
    send(descendants(process.pid)[:1], signal.SIGTERM)
    try:
        process.communicate(timeout=10.0)
    except subprocess.TimeoutExpired:
        send(descendants(process.pid), signal.SIGKILL)
        process.communicate()


def disturb(nodes: Nodes, what: str) -> None:
    """Do to the machine of rank 0, or to the other one, what is to happen."""
    if what == "first dies":
        nodes["node1"].die()
    elif what == "second dies":
        nodes["node2"].die()
    else:
        nodes.cut("node1")


def disturbed(
    nodes: Nodes, folder: Path, place: Path, what: str, choice: random.Random, outcome: Outcome
) -> None:
    """Start it, disturb it, and go on; the machines see the folder at another place."""
    agent = nodes.agent(folder.parent / "agent", env=SETTINGS)
    run = start(nodes["node1"], place, "mpirun", "--mca", "plm_rsh_agent", str(agent), "--host",
                "node1:1,node2:1")  # fmt: skip
    if not wait_for((folder / "out.h5.tasks/plan").exists, run):
        outcome.findings.append("it does not start")
        return
    time.sleep(choice.uniform(0.0, 0.6))
    disturb(nodes, what)
    # The machine of the owner is there in one case only.
    here = nodes["node1" if what == "second dies" else "node2"]
    if what == "second dies":
        stop(run)
    owned = (folder / "out.h5.owner").exists()
    code, words = attempt(here, place)
    # A run that is cut off from the other machine alone may still have ended well.
    ended = what == "first is cut off" and place == folder and code == 0
    if here is nodes["node2"] and owned and not ended:
        if code != 2 or "on node1, process " not in words or "remove " not in words:
            outcome.findings.append(f"not refused, exit {code}: {words}")
        (folder / "out.h5.owner").unlink(missing_ok=True)
        code, words = attempt(here, place)
    if code != 0:
        outcome.findings.append(f"at last exit {code}: {words}")
    if what == "first is cut off":
        nodes.mend("node1")
        time.sleep(choice.uniform(0.0, 5.0))
        stop(run)
    for name in ("node1", "node2"):
        nodes[name].die()


def campaign(folder: Path, choice: random.Random) -> Outcome:
    """Disturb one run on two machines once; what goes on must be right in the end."""
    outcome = Outcome()
    what = choice.choice(["first dies", "second dies", "first is cut off"])
    networked = choice.random() < 0.5
    about = f"{what}, {'sshfs' if networked else 'one disk'}"
    write(folder, run={"collisions": COLLISIONS})
    with Nodes(["node1", "node2", "files"], [folder.parent, ROOT]) as nodes:
        place = mount(nodes, folder) if networked else folder
        disturbed(nodes, folder, place, what, choice, outcome)
    if wrong := unlike(folder / "out.h5", undisturbed("excursion", collisions=COLLISIONS)):
        outcome.findings.append(f"{about}: the results file {wrong}")
    left = sorted(path.name for path in folder.iterdir())
    if not outcome.findings and left != ["case.nml", "out.h5"]:
        outcome.findings.append(f"{about}: left behind: {left}")
    return outcome


if __name__ == "__main__":
    sys.exit(command_line("nodes", campaign, __doc__ or ""))

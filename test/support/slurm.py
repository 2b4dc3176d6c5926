"""A Slurm of this test's own: a head and two nodes, each a machine of `nodes`.

Its daemons run in the foreground of those machines, without systemd and without control groups, and
end with them. Its files are in a folder of its own; nothing of a Slurm of this machine is used but
the programs.
"""

from __future__ import annotations

import os
import subprocess
import time
from typing import TYPE_CHECKING

from .cluster_packages import where
from .nodes import PATIENCE, Nodes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path
    from types import TracebackType

NAMES = ("node1", "node2")
# Processors that a node says it has, whatever it has: jobs share what there is.
PROCESSORS = 16
CONFIGURATION = """
ClusterName=battery
SlurmctldHost=head
SlurmUser=root
AuthType=auth/munge
# A job that is queued again waits until its credentials of before are over.
AuthInfo=socket={folder}/munge.socket,cred_expire=5
CryptoType=crypto/munge
StateSaveLocation={folder}/state
SlurmctldPidFile={folder}/slurmctld.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdSpoolDir={folder}/%n
SlurmdPidFile={folder}/%n.pid
SlurmdLogFile={folder}/%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=2,batch_sched_delay=0,sched_min_interval=0
KillWait=30
# A signal before the limit may be late on a busy machine; then it still comes.
OverTimeLimit=5
ReturnToService=2
SlurmdParameters=config_overrides
NodeName={nodes} CPUs={processors} State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


class Slurm:
    """A cluster under way; as a context, it is gone at its end.

    Parameters
    ----------
    folder : for its files, with a short path (that of a socket may have 107 signs).
    shared : other folders that its nodes see even if they are in /tmp.
    """

    def __init__(self, folder: Path, shared: Sequence[Path]) -> None:
        self.folder = folder
        configuration = folder / "slurm.conf"
        configuration.write_text(CONFIGURATION.format(
            folder=folder, nodes=",".join(NAMES), processors=PROCESSORS))  # fmt: skip
        (folder / "cgroup.conf").write_text("IgnoreSystemd=yes\n")
        key = folder / "munge.key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o400)
        (folder / "state").mkdir()
        self.environment = {**os.environ, "SLURM_CONF": str(configuration)}
        self.nodes = Nodes(["head", *NAMES], [folder, *shared])
        try:
            self._start_daemons()
        except BaseException:
            self.nodes.__exit__(None, None, None)
            raise

    def _start_daemons(self) -> None:
        names = ("socket", "pid-file", "log-file", "seed-file", "key-file")
        files = [f"--{name}={self.folder}/munge.{name.removesuffix('-file')}" for name in names]
        self._daemon("head", "munged", "--foreground", "--force", *files)
        self._await((self.folder / "munge.socket").exists, "munge")
        self._daemon("head", "slurmctld", "-D")
        for name in NAMES:
            (self.folder / name).mkdir()
            self._daemon(name, "slurmd", "-D", "-N", name)
        self.wait_until_idle()

    def __enter__(self) -> Slurm:
        """Give the cluster."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        """End it with its machines."""
        self.nodes.__exit__(kind, error, trace)

    def _daemon(self, node: str, program: str, *words: str) -> None:
        with (self.folder / f"{program}-{node}.out").open("w") as out:
            self.nodes[node].start(where(program) or program, *words, env=self.environment,
                                   stdin=subprocess.DEVNULL, stdout=out, stderr=out)  # fmt: skip

    def _await(self, condition: Callable[[], bool], what: str, patience: float = PATIENCE) -> None:
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() > end:
                logs = [file.read_text(errors="replace")[-1500:] for file in
                        [*self.folder.glob("*.log"), *self.folder.glob("*.out")]]  # fmt: skip
                raise TimeoutError(f"{what}: not there after {patience:.0f} s\n" + "\n".join(logs))
            time.sleep(0.1)

    def ask(self, *words: str, folder: Path | None = None) -> str:
        """Give what a command of Slurm prints on the head."""
        ended = self.nodes["head"].run(*words, env=self.environment, cwd=folder)
        assert ended.returncode == 0, f"{words}: {ended.stdout}{ended.stderr}"
        return ended.stdout.strip()

    def state_of_nodes(self) -> str:
        """Give the state of all nodes, if they have the same."""
        ended = self.nodes["head"].run("sinfo", "-h", "-o", "%T", env=self.environment)
        return ended.stdout.strip()

    def wait_until_idle(self) -> None:
        """Wait until no node has a job."""
        self._await(lambda: self.state_of_nodes() == "idle", "idle nodes")

    def submit(self, script: Path, *options: str, folder: Path) -> str:
        """Submit a job from a folder; give its number."""
        return self.ask("sbatch", "--parsable", *options, str(script), folder=folder)

    def about(self, job: str) -> dict[str, str]:
        """Give what Slurm knows of a job or an element of an array."""
        words = self.ask("scontrol", "show", "job", "--oneliner", job).split()
        return dict(word.partition("=")[::2] for word in words)

    def end_of(self, job: str, patience: float) -> dict[str, str]:
        """Wait until a job is over; one that was queued again is not."""
        over = {"COMPLETED", "FAILED", "CANCELLED", "TIMEOUT", "NODE_FAIL", "OUT_OF_MEMORY"}
        self._await(lambda: self.about(job)["JobState"] in over, f"the end of job {job}", patience)
        return self.about(job)

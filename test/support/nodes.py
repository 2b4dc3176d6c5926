"""Machines within this machine: namespaces with a name, an address and processes of their own.

All see the same files, but for a /tmp of their own; folders in it may be shared. They are joined by
a network of their own, which nothing else can see. The first process of each ends when this Python
does, however that ends, and takes with it all that it has started: no process, mount or device is
left. Only root may make them.
"""

from __future__ import annotations

import select
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .cluster_packages import SPACES

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

NETWORK = "10.77.0"
# Seconds for a command, on a busy machine; one that lasts longer hangs.
PATIENCE = 120.0
# What a machine does before it is there: it can still reach processes of this machine as /host/PID.
FIRST_PROCESS = """
hostname "$1"
mount --make-rprivate /
mount -t tmpfs tmpfs /mnt
mkdir /mnt/host
mount --rbind /proc /mnt/host
mount -t proc proc /proc
mkdir /mnt/tmp
mount -t tmpfs tmpfs /mnt/tmp
shift
for folder; do
  mkdir -p "/mnt$folder"
  mount --bind "$folder" "/mnt$folder"
done
mount --rbind /mnt/tmp /tmp
mount -t tmpfs tmpfs /dev/shm
ip link set lo up
echo ready
# A shell that waits also takes leave of processes whose parents are gone; slurmd waits for that.
cat
exit 0
"""
# Runs a command for whoever connects: each connection is its input and output.
SERVER = """
import socket, subprocess, sys
server = socket.create_server(("", int(sys.argv[1])))
while True:
    one, _ = server.accept()
    subprocess.Popen(sys.argv[2:], stdin=one, stdout=one, stderr=one, start_new_session=True)
    one.close()
"""
# What mpirun calls with the name of a machine and a command, in place of ssh.
AGENT = """#!/bin/bash
exec 3<>"/dev/tcp/$1/514"
shift
echo "$*" >&3
exec cat <&3
"""


class Node:
    """One machine, from its start to its death."""

    def __init__(self, name: str, address: str, shared: Sequence[Path]) -> None:
        self.name, self.address = name, address
        words = ["unshare", *(f"--{one}" for one in SPACES), "--fork", "--kill-child",
                 "sh", "-ec", FIRST_PROCESS, "sh", name,
                 *(str(one) for one in shared if str(one).startswith("/tmp/"))]  # fmt: skip
        self.outside = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        assert self.outside.stdout
        assert select.select([self.outside.stdout], [], [], PATIENCE)[0], f"{name} is not ready"
        assert self.outside.stdout.readline() == "ready\n", f"{name} cannot be made"
        children = Path(f"/proc/{self.outside.pid}/task/{self.outside.pid}/children")
        self.first = int(children.read_text(encoding="utf-8"))

    def command(self, *words: str) -> list[str]:
        """Give a command that runs another one there, in the present folder."""
        spaces = [f"--{one}=/proc/{self.first}/ns/{file}" for one, file in SPACES.items()]
        return ["nsenter", *spaces, "--wd=.", *words]

    def run(self, *words: str, **more: Any) -> subprocess.CompletedProcess[str]:  # noqa: ANN401
        """Run a command there to its end."""
        try:
            return subprocess.run(self.command(*words), capture_output=True, text=True,
                                  check=False, timeout=PATIENCE, **more)  # fmt: skip
        except subprocess.TimeoutExpired as error:
            raise TimeoutError(f"{error}: {error.stdout!r} {error.stderr!r}") from error

    def start(self, *words: str, **more: Any) -> subprocess.Popen[str]:  # noqa: ANN401
        """Start a command there."""
        return subprocess.Popen(self.command(*words), text=True, start_new_session=True, **more)

    def serve(self, port: int, *words: str, **more: Any) -> None:  # noqa: ANN401
        """Let it run a command for each connection to that port."""
        self.start(sys.executable, "-c", SERVER, str(port), *words, **more)
        end = time.monotonic() + 10.0
        while self.run("bash", "-c", f"exec 3<>/dev/tcp/localhost/{port}").returncode:
            assert time.monotonic() < end, f"{self.name} does not listen"
            time.sleep(0.05)

    def die(self) -> None:
        """End all its processes at once, as when the power fails: the first reads its last."""
        if self.outside.poll() is None:
            self.outside.communicate(timeout=PATIENCE)


class Nodes:
    """Machines on one network; as a context, they are gone at its end.

    Parameters
    ----------
    names : theirs.
    shared : folders that all see even if they are in /tmp.
    """

    def __init__(self, names: Sequence[str], shared: Sequence[Path]) -> None:
        self.shared = shared
        self.switch = Node("switch", "", shared)
        self.nodes: dict[str, Node] = {}
        self._switch("ip", "link", "add", "bridge", "type", "bridge")
        self._switch("ip", "link", "set", "bridge", "up")
        for name in names:
            self.add(name)

    def __enter__(self) -> Nodes:
        """Give the machines."""
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None,
        _trace: TracebackType | None,
    ) -> None:  # fmt: skip
        """End them all."""
        for node in [*self.nodes.values(), self.switch]:
            node.die()

    def __getitem__(self, name: str) -> Node:
        """Give the machine of a name."""
        return self.nodes[name]

    def _switch(self, *words: str) -> None:
        ended = self.switch.run(*words)
        assert ended.returncode == 0, ended.stderr

    def add(self, name: str) -> Node:
        """Make a machine, or make one anew that has died."""
        place = list(self.nodes).index(name) if name in self.nodes else len(self.nodes)
        node = self.nodes[name] = Node(name, f"{NETWORK}.{place + 1}", self.shared)
        cable = f"to-{name}"
        # The end of a cable goes with its machine, but not at once.
        self.switch.run("ip", "link", "delete", cable)
        self._switch("ip", "link", "add", cable, "type", "veth", "peer", "name", "eth0", "netns",
                     f"/mnt/host/{node.first}/ns/net")  # fmt: skip
        self._switch("ip", "link", "set", cable, "master", "bridge", "up")
        for words in (["address", "add", f"{node.address}/24", "dev", "eth0"],
                      ["link", "set", "eth0", "up"]):  # fmt: skip
            ended = node.run("ip", *words)
            assert ended.returncode == 0, ended.stderr
        self._name_all()
        return node

    def agent(self, file: Path, **more: Any) -> Path:  # noqa: ANN401
        """Write what mpirun calls to start a command on a machine, and let all listen to it."""
        file.write_text(AGENT)
        file.chmod(0o755)
        for node in self.nodes.values():
            node.serve(514, "sh", "-c", 'read -r line; eval "$line"', **more)
        return file

    def _name_all(self) -> None:
        """Let all know all names, and not those of this machine."""
        lines = [f"{node.address} {node.name}" for node in self.nodes.values()]
        text = "\n".join(["127.0.0.1 localhost", *lines])
        for node in self.nodes.values():
            node.run("sh", "-ec", 'printf "%s\\n" "$1" > /mnt/hosts; '
                     "mountpoint -q /etc/hosts || mount --bind /mnt/hosts /etc/hosts",
                     "sh", text)  # fmt: skip

    def cut(self, name: str) -> None:
        """Pull the cable of a machine."""
        self._switch("ip", "link", "set", f"to-{name}", "down")

    def mend(self, name: str) -> None:
        """Put it back."""
        self._switch("ip", "link", "set", f"to-{name}", "up")

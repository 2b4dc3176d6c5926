"""Machines within this machine: namespaces with a name, an address and processes of their own.

All see the same files. They are joined by a network of their own, which nothing else can see. The
first process of each ends when this Python does, however that ends, and takes with it all that it
has started: no process, mount or device is left. Only root may make them.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

NETWORK = "10.77.0"
# What a machine does before it is there: it can still reach processes of this machine as /host/PID.
FIRST_PROCESS = """
hostname "$1"
mount --make-rprivate /
mount -t tmpfs tmpfs /mnt
mkdir /mnt/host
mount --rbind /proc /mnt/host
mount -t proc proc /proc
ip link set lo up
echo ready
exec cat
"""
SPACES = {"net": "net", "uts": "uts", "mount": "mnt", "ipc": "ipc", "pid": "pid"}


def possible() -> bool:
    """Tell whether machines can be made here."""
    if os.geteuid() != 0 or not all(map(shutil.which, ("ip", "unshare", "nsenter"))):
        return False
    words = ["unshare", *(f"--{one}" for one in SPACES), "--fork", "--kill-child", "sh", "-c",
             "mount -t proc proc /proc && ip link add one type veth peer name other"]  # fmt: skip
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


class Node:
    """One machine, from its start to its death."""

    def __init__(self, name: str, address: str) -> None:
        self.name, self.address = name, address
        words = ["unshare", *(f"--{one}" for one in SPACES), "--fork", "--kill-child",
                 "sh", "-ec", FIRST_PROCESS, "sh", name]  # fmt: skip
        self.outside = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        assert self.outside.stdout
        assert self.outside.stdout.readline() == "ready\n", f"{name} cannot be made"
        children = Path(f"/proc/{self.outside.pid}/task/{self.outside.pid}/children")
        self.first = int(children.read_text(encoding="utf-8"))

    def command(self, *words: str, proc: str = "/proc") -> list[str]:
        """Give a command that runs another one there, in the present folder."""
        spaces = [f"--{one}={proc}/{self.first}/ns/{file}" for one, file in SPACES.items()]
        return ["nsenter", *spaces, "--wd=.", *words]

    def run(self, *words: str, **more: Any) -> subprocess.CompletedProcess[str]:
        """Run a command there to its end."""
        return subprocess.run(
            self.command(*words), capture_output=True, text=True, check=False, **more
        )

    def start(self, *words: str, **more: Any) -> subprocess.Popen[str]:
        """Start a command there."""
        return subprocess.Popen(self.command(*words), text=True, start_new_session=True, **more)

    def die(self) -> None:
        """End all its processes at once, as when the power fails."""
        self.outside.kill()
        self.outside.communicate()
        end = time.monotonic() + 10.0
        while Path(f"/proc/{self.first}").exists() and time.monotonic() < end:
            time.sleep(0.01)


class Nodes:
    """Machines on one network; as a context, they are gone at its end."""

    def __init__(self, names: Sequence[str]) -> None:
        self.switch = Node("switch", "")
        self.nodes: dict[str, Node] = {}
        self._switch("ip", "link", "add", "bridge", "type", "bridge")
        self._switch("ip", "link", "set", "bridge", "up")
        for name in names:
            self.add(name)

    def __enter__(self) -> Nodes:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None,
        _trace: TracebackType | None,
    ) -> None:  # fmt: skip
        for node in [*self.nodes.values(), self.switch]:
            node.die()

    def __getitem__(self, name: str) -> Node:
        return self.nodes[name]

    def _switch(self, *words: str) -> None:
        ended = self.switch.run(*words)
        assert ended.returncode == 0, ended.stderr

    def add(self, name: str) -> Node:
        """Make a machine, or make one anew that has died."""
        place = list(self.nodes).index(name) if name in self.nodes else len(self.nodes)
        node = self.nodes[name] = Node(name, f"{NETWORK}.{place + 1}")
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

    def _name_all(self) -> None:
        """Let all know all names, and not those of this machine."""
        lines = ["127.0.0.1 localhost", *(f"{one.address} {one.name}" for one in self.nodes.values())]
        text = "\n".join(lines)
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

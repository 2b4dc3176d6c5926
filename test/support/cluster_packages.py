"""What the tests of clusters need; run as a program, this names what is not there.

Nothing of it is needed to build the program, nor by `make test`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

# Packages of Debian, and what shows that they are there.
NEEDS = {
    "slurm-wlm": ("slurmctld", "slurmd", "sbatch", "srun", "scontrol", "scancel", "sinfo"),
    "munge": ("munged",),
    "iproute2": ("ip",),
    "util-linux": ("unshare", "nsenter"),
    "sshfs": ("sshfs",),
    "openssh-sftp-server": ("/usr/lib/openssh/sftp-server",),
}
# Of namespaces; `unshare` and `nsenter` have options of these names.
SPACES = {"net": "net", "uts": "uts", "mount": "mnt", "ipc": "ipc", "pid": "pid"}


def where(program: str) -> str | None:
    """Find a program; daemons may stand where only root looks."""
    return shutil.which(program, path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")


def lacking() -> str:
    """Say why there can be no cluster within this machine; empty: there can be one."""
    missing = [package for package, programs in NEEDS.items() if not all(map(where, programs))]
    if missing:
        return f"these packages are missing: {' '.join(missing)}"
    if os.geteuid() != 0:
        return "only root may make machines within this machine"
    words = ["unshare", *(f"--{one}" for one in SPACES), "--fork", "--kill-child", "sh", "-c",
             "mount -t proc proc /proc && ip link add one type veth peer name other"]  # fmt: skip
    if subprocess.run(words, capture_output=True, check=False).returncode:
        return "no namespaces can be made here, as in a container without rights"
    if not Path("/dev/fuse").exists():
        return "there is no /dev/fuse, as in a container without devices"
    return ""


if __name__ == "__main__":
    sys.exit(f"make cluster: {reason}" if (reason := lacking()) else 0)

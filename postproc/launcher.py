"""What the launchers of MPI are told, and which of the words after a run are theirs.

Open MPI 5 has another launcher than Open MPI 4, with names of its own for the same settings; MPICH
needs none of them. The Makefile has those that a `make` target needs.
"""

from __future__ import annotations

import re

# As root (in containers), and with more ranks than cores.
LAUNCHER = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}
# Ranks of several runs side by side share cores: none is tied to one, and who waits must not spin.
SHARED_CORES = {
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "PRTE_MCA_hwloc_default_binding_policy": "none",
}
# For the program without mpirun: a daemon of Open MPI 4 beside it would double the time of a start,
# and without one, starts side by side would remove the folder that another is about to use. No
# mpirun may see these: it cannot do without its folders.
ALONE = {
    "OMPI_MCA_ess_singleton_isolated": "1",
    "OMPI_MCA_orte_create_session_dirs": "0",
}

# A warning of Open MPI 5 wherever hosts have no network: each rank writes it in parts, which stand
# anywhere in a line where ranks write at once.
_WARNING = re.compile(
    r"\[[^][\n]*\]\[\[\d+,\d+\],\d+\]\[[^][\n]*:mca_btl_tcp_proc_create_interface_graph\] ?"
    r"|Unable to find reachable pairing between local and remote interfaces"
)
# A block between two rules; or a line that begins with [host:process], or with a launcher's name.
_NOISE = re.compile(
    r"^([-=])\1{29,}\n(?:.*\n)*?\1{30,}\n"
    r"|^\[[^\n]*\n"
    r"|^(?:mpirun|mpiexec|prterun|prted|orted|srun|slurmstepd)\b[^\n]*\n",
    re.MULTILINE,
)


def program_words(errors: str) -> str:
    """Return what the program itself printed on standard error, among a launcher's words.

    Where nothing else was printed, the launcher's words are all there is to say.
    """
    text = errors.rstrip("\n") + "\n"
    words = _NOISE.sub("", _WARNING.sub("", text))
    return "\n".join(line for line in words.splitlines() if line.strip()) or text.strip()

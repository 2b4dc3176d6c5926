"""Settings for the launchers of MPI, and their lines in the output of a run.

Open MPI 5 has another launcher than Open MPI 4, with other names for the same settings; MPICH needs
none of them. The Makefile has those that a `make` target needs.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

# As root (in containers), and with more ranks than cores.
LAUNCHER = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}
# Ranks of several simultaneous runs share cores: they are not bound, and waiting ranks must not
# spin.
SHARED_CORES = {
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "PRTE_MCA_hwloc_default_binding_policy": "none",
}
# For the program without mpirun: a daemon of Open MPI 4 would double the time of a start, and
# without one, simultaneous starts would remove each other's folders. mpirun must not have these
# settings: it needs its folders.
ALONE = {
    "OMPI_MCA_ess_singleton_isolated": "1",
    "OMPI_MCA_orte_create_session_dirs": "0",
}

# What launchers tell the ranks that they start: a program with these variables is a rank of that
# job. Settings of users are not among them: other OMPI_MCA_* and PRTE_MCA_*, OMPI_CC, SLURM_JOB_*.
_RANK_OF_A_JOB = re.compile(
    r"OMPI_(COMM_WORLD_\w+|UNIVERSE_SIZE|NUM_APP_CTX|FIRST_RANKS|APP_CTX_NUM_PROCS|FILE_LOCATION"
    r"|COMMAND|ARGV|PARENT_\w+)"
    r"|OMPI_MCA_(ess|ess_base_\w+|pmix|initial_wdir"
    r"|orte_(ess_\w+|\w+_uri|app_num|num_nodes|num_restarts|bound_at_launch|launch"
    r"|precondition_transports|top_session_dir|jobfam_session_dir))"
    r"|PMIX_(?!MCA_|INSTALL_PREFIX)\w+"
    r"|PRTE_(?!MCA_|PREFIX|INSTALL_PREFIX|ALLOW_RUN_AS_ROOT)\w+|PRTE_MCA_(ess_base|prte_ess)_\w+"
    r"|PMI2?_\w+|HYDI_\w+|MPI_LOCALN?RANK(ID|S)"
    r"|SLURM_(STEP\w*|PROCID|LOCALID|NODEID|TASK_PID|GTIDS|SRUN_COMM_\w+|LAUNCH_NODE_IPADDR)"
    r"|FLUX_(JOB_\w+|TASK_\w+|KVS_NAMESPACE|PMI_LIBRARY_PATH)|JSM_\w+|ALPS_APP_\w+"
    r"|PALS_(AP\w+|RANKID|LOCAL_\w+|NODEID|FD|SPOOL_DIR)"
)
# Options of Open MPI's mpirun that it exports to its ranks: where they are placed, how it prints.
_OPTIONS_OF_MPIRUN = re.compile(
    r"OMPI_MCA_(rmaps_(?!base_oversubscribe)\w+"
    r"|orte_(rankfile|default_hostfile|(xml|output|display|debug)_\w+|(tag|timestamp)_output"
    r"|execute_quiet|leave_session_attached|max_restarts))"
)

# A warning of Open MPI 5 on hosts without a network: each rank writes it in parts, which are mixed
# within lines if ranks write simultaneously.
_WARNING = re.compile(
    r"\[[^][\n]*\]\[\[\d+,\d+\],\d+\]\[[^][\n]*:mca_btl_tcp_proc_create_interface_graph\] ?"
    r"|Unable to find reachable pairing between local and remote interfaces"
)
# A block between two rules, or a line that begins with [host:process], with a launcher's name, or
# with three stars, as the errors of Open MPI do; what MPICH says of a rank that a signal ended.
_NOISE = re.compile(
    r"^([-=*])\1{29,}\n(?:.*\n)*?\1{30,}\n"
    r"|^(?:\[|\*\*\* )[^\n]*\n"
    r"|^(?:YOUR APPLICATION TERMINATED|This typically refers to|Please see the FAQ)[^\n]*\n"
    r"|^(?:mpirun|mpiexec|prterun|prted|orted|srun|slurmstepd)\b[^\n]*\n",
    re.MULTILINE,
)


def own_environment() -> dict[str, str]:
    """Return the environment in which a program is a job of its own.

    Python may itself be a rank, under `mpirun` or `srun`: the variables of that job are left out.
    Open MPI 4 crashes without HOME where the machine does not know the user, as in containers.
    """
    try:
        home = str(Path.home())
    except RuntimeError:
        home = os.sep
    left_out = [_RANK_OF_A_JOB]
    if "OMPI_COMM_WORLD_SIZE" in os.environ:  # else the user has set them
        left_out.append(_OPTIONS_OF_MPIRUN)
    own = {name: one for name, one in os.environ.items()
           if not any(pattern.fullmatch(name) for pattern in left_out)}  # fmt: skip
    return {"HOME": home, **own}


def program_words(errors: str) -> str:
    """Return what the program itself printed on standard error, without a launcher's lines.

    If nothing else was printed, the launcher's lines are returned.
    """
    text = errors.rstrip("\n") + "\n"
    words = _NOISE.sub("", _WARNING.sub("", text))
    return "\n".join(line for line in words.splitlines() if line.strip()) or text.strip()

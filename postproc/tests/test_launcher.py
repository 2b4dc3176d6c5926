"""The program's own words are found among those of a launcher."""

from __future__ import annotations

import pytest

from postproc.launcher import LAUNCHER, own_environment, program_words

OWN = "case.nml, line 3: threshold = -1: must be 0 or more\ncase.nml: [particles] is no group"
RULE = "-" * 74
# As Open MPI 4.1 and 5.0, Slurm 22.05 and MPICH 4.0 print them.
PLACE = "[vm][[26710,1],%d][../opal/btl_tcp_proc.c:266:mca_btl_tcp_proc_create_interface_graph] "
WARNING = "Unable to find reachable pairing between local and remote interfaces"
NOISE = {
    "warning of a rank": f"{PLACE % 0}{WARNING}\n",
    "warnings of ranks at once": f"{PLACE % 1}{PLACE % 0}{WARNING}{WARNING}\n\n"
    f"{WARNING}{PLACE % 1}\n{WARNING}\n",
    "word of a daemon": "[vm:00417] 1 more process has sent help message help-mpi.txt / no btl\n",
    "block": f"{RULE}\nWARNING: There was an error initializing a device.\n\n"
    f"  Local host: vm\n{RULE}\n",
    "exit code": f"{RULE}\nmpirun detected that processes exited with non-zero status,\n"
    f"thus causing the job to be terminated.\n\n  Exit code:    2\n{RULE}\n",
    "srun": "srun: error: node1: task 0: Exited with exit code 2\n",
    "error of MPI": "*** An error occurred in MPI_Init\n*** on a NULL communicator\n",
    "stars": f"\n{'*' * 58}\n\nmpirun does not support recursive calls\n\n{'*' * 58}\n",
    "signal": "YOUR APPLICATION TERMINATED WITH THE EXIT STRING: Killed (signal 9)\n"
    "This typically refers to a problem with your application.\n",
    "hydra": f"\n{'=' * 79}\n=   BAD TERMINATION OF ONE OF YOUR PROCESSES\n{'=' * 79}\n",
}


@pytest.mark.parametrize("noise", NOISE.values(), ids=NOISE.keys())
def test_a_message_is_found_before_and_after_noise(noise: str) -> None:
    assert program_words(f"{noise}{OWN}\n{noise}") == OWN


@pytest.mark.parametrize("part", [PLACE % 0, WARNING])
def test_a_message_is_found_behind_a_part_of_a_warning(part: str) -> None:
    assert program_words(f"{part}{OWN}\n{WARNING}\n") == OWN


def test_all_noise_at_once() -> None:
    everything = "".join(NOISE.values())
    assert program_words(f"{everything}{OWN}\n{everything}") == OWN


def test_where_there_is_nothing_else_a_launcher_is_heard() -> None:
    assert program_words(NOISE["block"]) == NOISE["block"].strip()
    assert program_words("") == ""


def test_a_program_is_a_job_of_its_own_with_the_settings_of_its_user(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Variables as Open MPI 4.1 and 5.0, MPICH 4.0 and Slurm 22.05 set them for a rank."""
    users = {*LAUNCHER, "OMPI_MCA_btl", "OMPI_MCA_orte_tmpdir_base", "PMIX_MCA_gds", "OMPI_CC"}
    users |= {"SLURM_JOB_ID", "SLURM_JOB_NODELIST", "PRTE_MCA_ras_base_verbose", "HYDRA_IFACE"}
    job = {"OMPI_COMM_WORLD_SIZE", "OMPI_MCA_ess", "OMPI_MCA_orte_hnp_uri", "OMPI_MCA_pmix"}
    job |= {"PMIX_RANK", "PMIX_NAMESPACE", "PRTE_LAUNCHED", "PMI_FD", "PMI_RANK", "MPI_LOCALRANKID"}
    job |= {"HYDI_CONTROL_FD", "SLURM_STEP_ID", "SLURM_STEPID", "SLURM_PROCID"}
    job |= {"FLUX_JOB_ID", "FLUX_TASK_RANK", "JSM_JSRUN_PORT", "ALPS_APP_ID", "PALS_RANKID"}
    options = {"OMPI_MCA_rmaps_base_mapping_policy", "OMPI_MCA_rmaps_ppr_n_pernode"}
    options |= {"OMPI_MCA_orte_rankfile", "OMPI_MCA_orte_xml_output", "OMPI_MCA_orte_tag_output"}
    options |= {"OMPI_MCA_rmaps_base_cpus_per_rank", "OMPI_MCA_orte_default_hostfile"}
    for name in users | job | options:
        monkeypatch.setenv(name, "1")
    kept = own_environment().keys()
    assert users <= kept
    assert not (job | options) & kept
    monkeypatch.delenv("OMPI_COMM_WORLD_SIZE")  # as in the batch step of Slurm
    assert users | options <= own_environment().keys()

#!/bin/bash
#SBATCH --job-name=battery
#SBATCH --ntasks=64
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
# Two minutes before the limit every rank is told to save its state, by the signal that loses
# nothing; so does &limits wall_minutes. SIGTERM under mpirun leaves ranks one second only, unless
# it is called with --mca odls_base_sigkill_timeout 60.
#SBATCH --signal=USR1@120

# An mpirun of Open MPI in place of srun may outlive its ranks (docs/reliability.md), so it needs an
# end: timeout --preserve-status -s USR1 -k 120 238m mpirun build/bin/battery ...
# Exit code 3: stopped early, state saved. The job goes back into the queue and goes on.
srun build/bin/battery namelists/phase_diagram.nml
code=$?
if [ "$code" -eq 3 ]; then
  scontrol requeue "$SLURM_JOB_ID"
fi
exit "$code"

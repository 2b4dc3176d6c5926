#!/bin/bash
# As slurm.sh, where srun does not fit the MPI: mpirun starts the ranks.
#
# A site must change: tasks (as many as the plan has, at most), time, and what it asks for besides:
##SBATCH --partition=NAME
##SBATCH --account=NAME
#SBATCH --job-name=battery
#SBATCH --ntasks=64
#SBATCH --time=04:00:00
# Without the B: only what srun has started hears the signal: here it goes to this script, which
# passes it on to mpirun, and that to all ranks.
#SBATCH --signal=B:USR1@120
#SBATCH --requeue
#SBATCH --open-mode=append

# The modules that the program was built with, such as:
# module load gcc openmpi hdf5 gsl
# Open MPI 4 as Debian and Ubuntu configure it lacks what ranks of several nodes need on Ethernet. A
# site with InfiniBand and an Open MPI of its own needs no such line.
export OMPI_MCA_osc=^ucx
program=build/bin/battery
namelist=${1:-namelists/phase_diagram.nml}
# Where mpirun does not learn from Slurm how many ranks and which nodes: mpirun -n "$SLURM_NTASKS".
mpirun "$program" "$namelist" &
run=$!
stopped=no
trap 'stopped=yes; kill -USR1 "$run"' USR1
wait "$run"
code=$?
# A signal ends the first wait, and not the run.
if [ "$stopped" = yes ]; then
  wait "$run"
  code=$?
fi
# Exit code 3: stopped early, states saved. MPICH's mpirun may say 0 then.
if [ "$stopped" = yes ] && [ "$code" -eq 0 ] || [ "$code" -eq 3 ]; then
  scontrol requeue "$SLURM_JOB_ID"
fi
exit "$code"

#!/bin/bash
# One run of battery under Slurm, from the folder of the checkout: sbatch namelists/slurm.sh FILE.nml
#
# A site must change: tasks (as many as the plan has, at most), time, and what it asks for besides:
##SBATCH --partition=NAME
##SBATCH --account=NAME
#SBATCH --job-name=battery
#SBATCH --ntasks=64
#SBATCH --time=04:00:00
# Two minutes before that limit srun tells every rank to save its state. Then the job goes back into
# the queue and goes on. So does one whose node has failed.
#SBATCH --signal=USR1@120
#SBATCH --requeue
#SBATCH --open-mode=append

# The modules that the program was built with, such as:
# module load gcc openmpi hdf5 gsl
# Open MPI 4 as Debian and Ubuntu configure it lacks what ranks of several nodes need on Ethernet. A
# site with InfiniBand and an Open MPI of its own needs no such line.
export OMPI_MCA_osc=^ucx
# Its ranks under srun may crash at their start, about one start in a hundred on busy nodes, before
# this program has done anything; not with this.
export PMIX_MCA_gds=hash
program=build/bin/battery
namelist=${1:-namelists/phase_diagram.nml}

# By which interface srun tells ranks of each other; srun --mpi=list shows what a site has.
case $("$program" --version) in
  *'Open MPI'*) pmi=pmix ;;
  *) pmi=pmi2 ;;
esac
srun --mpi="$pmi" "$program" "$namelist"
code=$?
# Exit code 3: stopped early, states saved.
if [ "$code" -eq 3 ]; then
  scontrol requeue "$SLURM_JOB_ID"
fi
exit "$code"

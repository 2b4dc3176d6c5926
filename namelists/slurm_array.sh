#!/bin/bash
# Several namelists, each a run and a job of its own: element k takes the k-th of a folder.
#
# One output has one owner: elements with one namelist would be refused but for one. So each element
# has a namelist with an output file of its own. Replicas and points of one namelist need no array:
# the ranks of slurm.sh share them, and merge them into one file.
#
# A site must change: how many namelists there are, tasks (as many as a plan has, at most), time,
# and what it asks for besides:
##SBATCH --partition=NAME
##SBATCH --account=NAME
#SBATCH --array=0-6
#SBATCH --job-name=battery
#SBATCH --ntasks=16
#SBATCH --time=04:00:00
# As in slurm.sh.
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
namelists=(namelists/paper_*.nml)

case $("$program" --version) in
  *'Open MPI'*) pmi=pmix ;;
  *) pmi=pmi2 ;;
esac
srun --mpi="$pmi" "$program" "${namelists[SLURM_ARRAY_TASK_ID]}"
code=$?
if [ "$code" -eq 3 ]; then
  # This element alone: the number of the last element's job is that of the whole array.
  scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID"
fi
exit "$code"

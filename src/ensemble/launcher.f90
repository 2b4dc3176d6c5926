!> What started this program, by the environment that it was given: srun and the mpirun of one MPI
!> start a program of another MPI as many programs of one rank each, none of which knows the others.
module battery_launcher
  use battery_communicator, only: communicator_type, mpi_library
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: launcher_hint

  !> How a launcher says how many it has started, and what it is called. Slurm's own PMI sets
  !> PMI_SIZE as well, so Slurm comes first.
  character(len=*), parameter :: variables(*) = [character(len=20) :: 'SLURM_STEP_NUM_TASKS', &
    'OMPI_COMM_WORLD_SIZE', 'PMI_SIZE']
  character(len=*), parameter :: launchers(*) = [character(len=22) :: 'srun', &
    'the mpirun of Open MPI', 'the mpirun of MPICH']

contains

  !> What to type where several programs of one rank were started in place of several ranks; empty
  !> where they were not.
  function launcher_hint(communicator) result(hint)
    type(communicator_type), intent(in) :: communicator
    character(len=:), allocatable :: hint
    character(len=12) :: value
    integer :: k, programs, status

    hint = ''
    if (communicator%size > 1) return
    do k = 1, size(variables)
      call get_environment_variable(trim(variables(k)), value, status=status)
      if (status /= 0) cycle
      read (value, '(i12)', iostat=status) programs
      if (status /= 0) cycle
      if (programs > 1) exit
    end do
    if (k > size(variables)) return
    hint = '; '//trim(launchers(k))//' has started '//to_text(programs)//' programs of one rank ' &
      //'each, not one run of '//to_text(programs)//' ranks: '
    if (k == 1) then
      hint = hint//'choose what '//mpi_library()//' understands from `srun --mpi=list`, such as ' &
        //'`srun --mpi=pmix` (Open MPI) or `srun --mpi=pmi2` (MPICH), or use its own mpirun'
    else
      hint = hint//'use the mpirun of '//mpi_library()
    end if
    hint = hint//'; programs that are meant to run apart need output files of their own'
  end function launcher_hint

end module battery_launcher

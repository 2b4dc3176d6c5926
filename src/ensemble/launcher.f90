!> The launcher that started this program, from the environment: srun, or the mpirun of another MPI
!> library, may start several independent programs of one rank each in place of several ranks.
module battery_launcher
  use battery_communicator, only: communicator_type, mpi_library
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: launcher_hint

  !> Environment variable in which a launcher stores the number of processes, and the name of the
  !> launcher. Slurm's own PMI sets PMI_SIZE as well, so Slurm comes first.
  character(len=*), parameter :: variables(*) = [character(len=20) :: 'SLURM_STEP_NUM_TASKS', &
    'OMPI_COMM_WORLD_SIZE', 'PMI_SIZE']
  character(len=*), parameter :: launchers(*) = [character(len=22) :: 'srun', &
    'the mpirun of Open MPI', 'the mpirun of MPICH']

contains

  !> Advice for the user if several programs of one rank were started in place of several ranks;
  !> empty if not.
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

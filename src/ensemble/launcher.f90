!> How the ranks of a run were started. Before any of them writes, all must have the same command
!> line and the same folder of the output. And srun, or the mpirun of another MPI library, may start
!> several independent programs of one rank each in place of several ranks.
module battery_launcher
  use battery_clocks, only: wall_seconds, sleep_for
  use battery_communicator, only: communicator_type, share_error, share_text, sleep_until_all, &
    mpi_library
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_kinds, only: dp
  use battery_process, only: host_name
  use battery_lock_file, only: lock_type, is_lock_visible
  use battery_signals, only: stop_requested, set_stop_error
  use battery_text, only: string_type, to_text, join
  implicit none (type, external)
  private
  public :: check_command_lines, check_output_folder, launcher_hint

  !> Seconds after which a file made on one machine must be visible on another; seconds between two
  !> checks.
  real(dp), parameter :: patience = 5.0_dp, pause = 0.05_dp

  !> Environment variable in which a launcher stores the number of processes, and the name of the
  !> launcher. Slurm's own PMI sets PMI_SIZE as well, so Slurm comes first.
  character(len=*), parameter :: variables(*) = [character(len=20) :: 'SLURM_STEP_NUM_TASKS', &
    'OMPI_COMM_WORLD_SIZE', 'PMI_SIZE']
  character(len=*), parameter :: launchers(*) = [character(len=22) :: 'srun', &
    'the mpirun of Open MPI', 'the mpirun of MPICH']

contains

  !> Checks that all ranks have the same command line: otherwise they would do different things and
  !> wait for each other for ever. Collective.
  subroutine check_command_lines(communicator, words, error)
    type(communicator_type), intent(in) :: communicator
    !> Command line of this rank, word by word.
    type(string_type), intent(in) :: words(:)
    !> The command lines differ; the same error on all ranks, code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: mine, first, mine_shown, first_shown

    ! Words have no null characters: with one after each word, different lists give different texts.
    mine = join(words, achar(0))//repeat(achar(0), min(1, size(words)))
    first = mine
    call share_text(communicator, first, 0)
    mine_shown = trim(join(words, ' '))
    first_shown = mine_shown
    call share_text(communicator, first_shown, 0)
    if (len(mine) /= len(first) .or. mine /= first) call fatal_error(error, 'battery: rank ' &
      //to_text(communicator%rank)//' was started with another command line ('//mine_shown &
      //') than rank 0 ('//first_shown//'); allowed: one command line for all ranks', &
      exit_bad_input)
    call share_error(communicator, error)
  end subroutine check_command_lines

  !> Checks that every rank sees, by its own path, the lock file of rank 0: a rank that was started
  !> in another folder would write into another run's journal. Numbers of devices and inodes cannot
  !> be compared, since they differ between machines. Collective.
  subroutine check_output_folder(communicator, lock, file, error)
    type(communicator_type), intent(in) :: communicator
    !> Lock of rank 0.
    type(lock_type), intent(in) :: lock
    !> Path of the results file.
    character(len=*), intent(in) :: file
    !> The folders differ, or a signal has stopped the run; the same error on all ranks.
    type(error_type), allocatable, intent(out) :: error
    real(dp) :: began

    if (communicator%size == 1) return
    began = wall_seconds()
    do while (.not. (is_lock_visible(lock) .or. allocated(error)))
      if (stop_requested()) then
        call set_stop_error(error)
      else if (wall_seconds() - began > patience) then
        call fatal_error(error, file//': rank '//to_text(communicator%rank)//', on '//host_name() &
          //', does not see the folder that rank 0 writes to; start all ranks in one folder that ' &
          //'they share', exit_bad_input)
      else
        call sleep_for(pause)
      end if
    end do
    ! Some rank may have waited for the lock file.
    call sleep_until_all(communicator)
    call share_error(communicator, error)
  end subroutine check_output_folder

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

!> Checks that all ranks of a run have the same command line and the same folder of the output,
!> before any of them writes.
module battery_agreement
  use battery_clocks, only: wall_seconds, sleep_for
  use battery_communicator, only: communicator_type, share_error, share_text, sleep_until_all
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_kinds, only: dp
  use battery_process, only: host_name
  use battery_lock_file, only: lock_type, is_lock_visible
  use battery_signals, only: stop_requested, set_stop_error
  use battery_text, only: string_type, to_text, join
  implicit none (type, external)
  private
  public :: check_command_lines, check_output_folder

  !> Seconds after which a file made on one machine must be visible on another; seconds between two
  !> checks.
  real(dp), parameter :: patience = 5.0_dp, pause = 0.05_dp

contains

  !> Checks that all ranks have the same command line: otherwise they would do different things and
  !> wait for each other for ever. Collective.
  subroutine check_command_lines(communicator, words, error)
    type(communicator_type), intent(in) :: communicator
    !> Command line of this rank, word by word.
    type(string_type), intent(in) :: words(:)
    !> The command lines differ; the same error on all ranks, code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: mine, first

    ! Words have no null characters: with one after each word, different lists give different texts.
    mine = join(words, achar(0))//repeat(achar(0), min(1, size(words)))
    first = mine
    call share_text(communicator, first, 0)
    if (len(mine) /= len(first) .or. mine /= first) call fatal_error(error, 'battery: rank ' &
      //to_text(communicator%rank)//' was started with another command line (' &
      //command_line_of(mine)//') than rank 0 ('//command_line_of(first)// &
      '); allowed: one command line for all ranks', exit_bad_input)
    call share_error(communicator, error)
  end subroutine check_command_lines

  !> A list of words as typed on a command line.
  pure function command_line_of(list) result(text)
    !> Words, with a null character after each.
    character(len=*), intent(in) :: list
    character(len=:), allocatable :: text
    integer :: at

    text = list
    do at = 1, len(text)
      if (text(at:at) == achar(0)) text(at:at) = ' '
    end do
    text = trim(text)
  end function command_line_of

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

end module battery_agreement

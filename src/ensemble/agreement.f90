!> What all ranks of a run must have in common before any of them writes: the command line, and the
!> folder of the output.
module battery_agreement
  use battery_clocks, only: wall_seconds, sleep_for
  use battery_communicator, only: communicator_type, share_error, share_text
  use battery_error, only: error_type, fatal_error, exit_bad_input
  use battery_kinds, only: dp
  use battery_machine, only: host_name
  use battery_lock_file, only: lock_type, create_marker, remove_marker, is_marker_visible
  use battery_signals, only: stop_requested, set_stop_error
  use battery_text, only: string_type, to_text, join
  implicit none (type, external)
  private
  public :: check_command_lines, check_output_folder

  !> Seconds that a file system may take to show to one machine what another has made, and between
  !> two looks.
  real(dp), parameter :: patience = 5.0_dp, pause = 0.05_dp

contains

  !> Ranks with other words would do other things, and wait for one another for ever. Collective.
  subroutine check_command_lines(communicator, words, error)
    type(communicator_type), intent(in) :: communicator
    !> Command line of this rank, word by word.
    type(string_type), intent(in) :: words(:)
    !> The same on all ranks; code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: mine, first

    ! No word has a null sign in it: with one behind each, no two lists give the same text.
    mine = join(words, achar(0))//repeat(achar(0), min(1, size(words)))
    first = mine
    call share_text(communicator, first, 0)
    if (len(mine) /= len(first) .or. mine /= first) call fatal_error(error, 'battery: rank ' &
      //to_text(communicator%rank)//' was started with another command line (' &
      //shown(mine)//') than rank 0 ('//shown(first)// &
      '); allowed: one command line for all ranks', exit_bad_input)
    call share_error(communicator, error)
  end subroutine check_command_lines

  !> A list of words as it would be typed.
  pure function shown(list) result(text)
    !> Texts, with a null character behind each.
    character(len=*), intent(in) :: list
    character(len=:), allocatable :: text
    integer :: at

    text = list
    do at = 1, len(text)
      if (text(at:at) == achar(0)) text(at:at) = ' '
    end do
    text = trim(text)
  end function shown

  !> Every rank must see, by its own path, what rank 0 makes beside the output: a rank that was
  !> started in another folder would write into another run's journal. Numbers of devices and inodes
  !> tell nothing, since they differ between machines. Collective.
  subroutine check_output_folder(communicator, lock, file, error)
    type(communicator_type), intent(in) :: communicator
    !> Lock of rank 0.
    type(lock_type), intent(in) :: lock
    !> The output.
    character(len=*), intent(in) :: file
    !> The same on all ranks; code `exit_bad_input`, or that of a run that a signal has stopped.
    type(error_type), allocatable, intent(out) :: error
    type(error_type), allocatable :: trouble
    real(dp) :: began

    if (communicator%size == 1) return
    if (communicator%rank == 0) call create_marker(lock, error)
    call share_error(communicator, error)
    if (allocated(error)) return
    began = wall_seconds()
    do while (.not. (is_marker_visible(lock) .or. allocated(error)))
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
    call share_error(communicator, error)
    if (communicator%rank == 0) call remove_marker(lock, trouble)
    call share_error(communicator, trouble)
    if (allocated(trouble) .and. .not. allocated(error)) call move_alloc(trouble, error)
  end subroutine check_output_folder

end module battery_agreement

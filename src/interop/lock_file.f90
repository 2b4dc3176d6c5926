!> Lock file of an output: `FILE.h5.owner`, next to the output, has the machine, the process and the
!> start time of the run that owns the output, and is locked while that process exists.
!>
!> The run that creates the file owns the output. If no process of this machine holds the lock, the
!> owner has ended, and the next run takes over at once. Whether an owner on another machine has
!> ended cannot be known: it may be cut off from the network, and write again when it is
!> reconnected. So no output is ever taken over from another machine; a user who knows that the
!> owner has ended removes the file. The same holds on this machine if the file system has no locks.
!>
!> Ranks may write after their rank 0 has ended, and so may a run whose lock file was removed. Three
!> measures ensure that two runs never write to one file:
!>
!> - each rank reads the lock file before it writes (`is_lock_lost`);
!> - the ranks of two launches of the program never write to the same rank file;
!> - files are replaced, not overwritten.
module battery_lock_file
  use, intrinsic :: iso_c_binding, only: c_int, c_char, c_null_char
  use battery_c_shapes, only: number_of_path_and_text
  use battery_kinds, only: dp
  use battery_error, only: error_type, fatal_error, exit_bad_input, exit_failure, exit_stopped_early
  use battery_files, only: is_disk_error, find_files
  use battery_paths, only: system_message, folder_of
  use battery_clocks, only: wall_seconds, sleep_for
  use battery_signals, only: stop_requested
  use battery_process, only: process_number, host_name
  use battery_text, only: string_type, to_text
  implicit none (type, external)
  private
  public :: lock_type, acquire_lock, release_lock, is_lock_lost
  public :: check_lock, is_lock_visible

  !> Outcomes of an attempt to lock, as in `lock_file.c`.
  integer(c_int), parameter :: taken = 0, held = 1, unknown = 2, again = 3, not_a_file = 5

  !> Bytes of the longest text of an owner, which includes the name of its machine.
  integer, parameter :: longest_text = 256

  !> Seconds to wait for the end of another owner, and between two attempts.
  real(dp), parameter :: default_patience = 5.0_dp, pause = 0.05_dp

  !> Attempts that may fail for another reason before it is reported.
  integer, parameter :: most_failures = 3

  !> Lock of an output: held by this process, or known to a rank whose rank 0 holds it.
  type :: lock_type
    !> Path of the lock file, and its text while this run owns the output; not allocated: no lock.
    character(len=:), allocatable :: path, text
    !> Descriptor of the open lock file, on rank 0 alone; below 0: it is not open.
    integer(c_int), private :: descriptor = -1
    !> Whether the system refuses to make the lock file, as on a full disk.
    logical :: is_refused = .false.
  end type lock_type

  procedure(number_of_path_and_text), bind(c, name='battery_read_owner') :: c_read_owner

  interface
    integer(c_int) function c_own(path, text, holder, capacity, descriptor) &
        bind(c, name='battery_own')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*), text(*)
      integer(c_int), value, intent(in) :: capacity
      character(kind=c_char), intent(inout) :: holder(capacity)
      integer(c_int), intent(inout) :: descriptor
    end function c_own

    subroutine c_disown(path, descriptor) bind(c, name='battery_disown')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value, intent(in) :: descriptor
    end subroutine c_disown
  end interface

contains

  !> Makes this process the owner of the output `file`. If another run owns it, waits some time for
  !> the end of that run, and takes over from an ended run of this machine.
  subroutine acquire_lock(lock, file, error, patience, text, hint)
    type(lock_type), intent(out) :: lock
    character(len=*), intent(in) :: file
    !> Another run owns the output (code `exit_bad_input`), or a signal came (`exit_stopped_early`).
    type(error_type), allocatable, intent(out) :: error
    !> Seconds to wait, `default_patience` if absent.
    real(dp), intent(in), optional :: patience
    !> Text of the lock file, `owner_text` if absent.
    character(len=*), intent(in), optional :: text
    !> Advice that is added to the message if another run owns the output.
    character(len=*), intent(in), optional :: hint
    character(len=longest_text) :: holder
    real(dp) :: last_attempt
    character(len=:), allocatable :: reason
    type(string_type), allocatable :: seen(:)
    integer(c_int) :: outcome
    integer :: failures
    logical :: disk_failed

    failures = 0
    last_attempt = wall_seconds() + default_patience
    if (present(patience)) last_attempt = last_attempt - default_patience + patience
    lock%path = file//'.owner'
    lock%text = owner_text()
    if (present(text)) lock%text = text
    do
      outcome = c_own(lock%path//c_null_char, lock%text//c_null_char, holder, &
        longest_text, lock%descriptor)
      select case (outcome)
      case (taken)
        ! sshfs remembers what a file was for 20 s, and asks anew where the folder has changed: the
        ! lock file is new in it.
        call find_files(folder_of(file), '*', seen, error)
        if (allocated(error)) deallocate (error)
        return
      case (held, unknown)
        if (wall_seconds() > last_attempt) then
          call fatal_error(error, file//': '//owner_phrase(holder)//remedy_text(outcome == held, &
            lock%path), exit_bad_input)
          if (present(hint)) error%message = error%message//hint
          return
        end if
      case (again)
        ! The file of an ended run was removed.
        if (words_of(holder) /= '') cycle
      case (not_a_file)
        call fatal_error(error, lock%path//': is not a file that a run has left; remove it, ' &
          //'or name another output file', exit_bad_input)
        return
      case default
        ! On a network disk another run that takes the lock at this moment may look like this. The
        ! number of the error is read before anything else may change it.
        disk_failed = is_disk_error()
        reason = system_message()
        failures = failures + 1
        if (failures > most_failures .or. disk_failed) then
          lock%is_refused = .true.
          call fatal_error(error, lock%path//': cannot be written: '//reason, &
            merge(exit_failure, exit_bad_input, disk_failed))
          return
        end if
      end select
      if (stop_requested()) then
        call fatal_error(error, 'stopped while it waited: '//owner_phrase(holder), &
          exit_stopped_early)
        return
      end if
      call sleep_for(pause)
    end do
  end subroutine acquire_lock

  !> Releases the lock; does nothing if there is none.
  subroutine release_lock(lock)
    type(lock_type), intent(inout) :: lock

    if (lock%descriptor >= 0) call c_disown(lock%path//c_null_char, lock%descriptor)
    lock%descriptor = -1
  end subroutine release_lock

  !> Whether another run owns the output now, so that nothing may be written any more. If the lock
  !> file is missing, this is unknown, and the result is false.
  logical function is_lock_lost(lock) result(yes)
    type(lock_type), intent(in) :: lock
    character(len=:), allocatable :: now

    yes = .false.
    if (.not. allocated(lock%path)) return
    now = text_now(lock)
    yes = now /= '' .and. now /= lock%text
  end function is_lock_lost

  !> Whether this rank sees the lock file of its rank 0: then both have the same folder.
  logical function is_lock_visible(lock) result(yes)
    type(lock_type), intent(in) :: lock

    yes = text_now(lock) == lock%text
  end function is_lock_visible

  !> Text of the lock file now; empty if it is missing.
  function text_now(lock) result(text)
    type(lock_type), intent(in) :: lock
    character(len=:), allocatable :: text
    character(len=longest_text) :: now
    integer :: length

    length = c_read_owner(lock%path//c_null_char, now, longest_text)
    text = now(:length)
  end function text_now

  !> An error if this run has lost the lock of its output: then a rank must write nothing.
  subroutine check_lock(lock, error)
    type(lock_type), intent(in) :: lock
    !> Another run has taken over the lock.
    type(error_type), allocatable, intent(out) :: error

    if (is_lock_lost(lock)) call fatal_error(error, lock%path &
      //': another run has taken over; this one, '//lock%text//', ends')
  end subroutine check_lock

  !> Text of a lock file: machine, process, time.
  function owner_text() result(text)
    character(len=:), allocatable :: text
    character(len=8) :: date
    character(len=10) :: time

    call date_and_time(date, time)
    text = host_name()//' '//to_text(process_number())//' '//date(:4)//'-'//date(5:6)//'-' &
      //date(7:)//' '//time(:2)//':'//time(3:4)//':'//time(5:)
  end function owner_text

  !> Text that C wrote, up to its null character.
  pure function words_of(holder) result(words)
    character(len=*), intent(in) :: holder
    character(len=:), allocatable :: words

    words = holder(:max(0, index(holder, c_null_char) - 1))
  end function words_of

  !> Text for the owner of an output and its start time.
  pure function owner_phrase(holder) result(words)
    character(len=*), intent(in) :: holder
    character(len=:), allocatable :: words
    character(len=:), allocatable :: rest
    integer :: blank

    words = 'another run has locked it'
    rest = words_of(holder)
    blank = index(rest, ' ')
    if (blank == 0) return
    words = words//', on '//rest(:blank - 1)
    rest = rest(blank + 1:)
    blank = index(rest, ' ')
    if (blank > 0) words = words//', process '//rest(:blank - 1)//', since '//rest(blank + 1:)
  end function owner_phrase

  !> Advice for the user about a lock that another run holds.
  function remedy_text(lives, path) result(words)
    !> Whether the other run is known to exist.
    logical, intent(in) :: lives
    !> Path of the lock file.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: words

    words = '; wait for its end, or stop it'
    if (.not. lives) words = words//'; whether it still runs cannot be known on ' &
      //host_name()//': if it has ended for certain, remove '//path
  end function remedy_text

end module battery_lock_file

!> Signals that ask the program to stop (SIGTERM, SIGINT, SIGUSR1), and its clocks.
!>
!> The first signal only sets a flag, which the program looks at between windows; a later one ends
!> the program at once. Signals within half a second of the first count as that one: `timeout` and
!> some batch systems send each signal to the process and to its group.
module battery_signals
  use, intrinsic :: iso_c_binding, only: c_int, c_intptr_t, c_char, c_null_char, &
    c_funptr, c_null_funptr, c_funloc
  use, intrinsic :: iso_fortran_env, only: output_unit, error_unit
  use battery_kinds, only: dp, int64
  implicit none (type, external)
  private
  public :: watch_signals, stop_signal, stop_requested, clear_stop_request
  public :: wall_seconds, cpu_seconds, rest, leave, is_terminal, process_number

  !> Numbers of the signals on Linux.
  integer(c_int), parameter :: signal_interrupt = 2, signal_user1 = 10, signal_terminate = 15, &
    signal_file_size = 25

  !> Signals that come in so short a time are one, in seconds.
  real(dp), parameter :: same_signal = 0.5_dp

  !> The signal that came, 0 if none did, and when.
  integer(c_int), volatile :: received = 0
  real(dp), volatile :: received_at = 0.0_dp

  interface
    function c_signal(number, handler) result(old) bind(c, name='signal')
      import :: c_int, c_funptr
      implicit none (type, external)
      integer(c_int), value, intent(in) :: number
      type(c_funptr), value, intent(in) :: handler
      type(c_funptr) :: old
    end function c_signal

    subroutine c_leave(status) bind(c, name='_exit')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: status
    end subroutine c_leave

    subroutine c_exit(status) bind(c, name='exit')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: status
    end subroutine c_exit

    function c_isatty(descriptor) result(yes) bind(c, name='isatty')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: descriptor
      integer(c_int) :: yes
    end function c_isatty

    function c_getppid() result(number) bind(c, name='getppid')
      import :: c_int
      implicit none (type, external)
      integer(c_int) :: number
    end function c_getppid

    function c_open(path, flags) result(descriptor) bind(c, name='open')
      import :: c_int, c_char
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value, intent(in) :: flags
      integer(c_int) :: descriptor
    end function c_open

    function c_close(descriptor) result(status) bind(c, name='close')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: descriptor
      integer(c_int) :: status
    end function c_close

    function c_usleep(microseconds) result(status) bind(c, name='usleep')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: microseconds
      integer(c_int) :: status
    end function c_usleep

    function c_getpid() result(number) bind(c, name='getpid')
      import :: c_int
      implicit none (type, external)
      integer(c_int) :: number
    end function c_getpid
  end interface

contains

  !> From now on, the three signals ask for a stop instead of ending the program, and a file that
  !> grows beyond the size allowed is an error of the write.
  subroutine watch_signals()
    !> The handler that ignores (SIG_IGN).
    integer(c_intptr_t), parameter :: ignore = 1
    type(c_funptr) :: old

    old = c_signal(signal_interrupt, c_funloc(receive))
    old = c_signal(signal_user1, c_funloc(receive))
    old = c_signal(signal_terminate, c_funloc(receive))
    old = c_signal(signal_file_size, transfer(ignore, c_null_funptr))
  end subroutine watch_signals

  !> Called by the system when a signal comes: notes it, or leaves at once with 128 + its number.
  subroutine receive(number) bind(c)
    integer(c_int), value, intent(in) :: number

    if (received == 0) then
      received_at = wall_seconds()
      received = number
    else if (wall_seconds() - received_at > same_signal) then
      call c_leave(128_c_int + number)
    end if
  end subroutine receive

  !> Whether a signal has asked for a stop.
  function stop_requested() result(requested)
    logical :: requested

    requested = received /= 0
  end function stop_requested

  !> Name of the signal that has asked for a stop; empty if none has.
  function stop_signal() result(name)
    character(len=:), allocatable :: name

    select case (received)
    case (0)
      name = ''
    case (signal_interrupt)
      name = 'SIGINT'
    case (signal_user1)
      name = 'SIGUSR1'
    case default
      name = 'SIGTERM'
    end select
  end function stop_signal

  !> Forgets that a signal came; for tests.
  subroutine clear_stop_request()
    received = 0
  end subroutine clear_stop_request

  !> Seconds on a clock that never goes back; differences mean something, the value does not.
  function wall_seconds() result(seconds)
    real(dp) :: seconds
    integer(int64) :: ticks, rate

    call system_clock(ticks, rate)
    seconds = real(ticks, dp)/real(rate, dp)
  end function wall_seconds

  !> Seconds of processor time that this process has used.
  function cpu_seconds() result(seconds)
    real(dp) :: seconds

    call cpu_time(seconds)
  end function cpu_seconds

  !> Ends the program with an exit code, without the word `STOP` that Fortran prints.
  subroutine leave(exit_code)
    integer, intent(in) :: exit_code

    flush (output_unit)
    flush (error_unit)
    call c_exit(int(exit_code, c_int))
  end subroutine leave

  !> Leaves the processor to others for a while, up to a second; a signal may end it early.
  subroutine rest(seconds)
    real(dp), intent(in) :: seconds
    integer(c_int) :: status

    status = c_usleep(int(1.0e6_dp*min(seconds, 0.99_dp), c_int))
  end subroutine rest

  !> Whether standard output is a terminal. A rank that mpirun has started writes to a terminal of
  !> mpirun's own making, whatever mpirun itself writes to; then mpirun's output is what counts.
  function is_terminal() result(terminal)
    logical :: terminal
    integer(c_int), parameter :: standard_output = 1, write_only = 1, no_control = 256
    integer(c_int) :: descriptor, status
    character(len=32) :: path
    integer :: length

    terminal = c_isatty(standard_output) == 1
    call get_environment_variable('OMPI_COMM_WORLD_RANK', length=length)
    if (length == 0 .or. .not. terminal) return
    write (path, '(a, i0, a)') '/proc/', c_getppid(), '/fd/1'
    descriptor = c_open(trim(path)//c_null_char, write_only + no_control)
    if (descriptor < 0) return
    terminal = c_isatty(descriptor) == 1
    status = c_close(descriptor)
  end function is_terminal

  !> Number of this process.
  function process_number() result(number)
    integer :: number

    number = int(c_getpid())
  end function process_number

end module battery_signals

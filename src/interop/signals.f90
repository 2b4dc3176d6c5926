!> Requests to stop the program: the signals of `names`, and a time limit. SIGHUP is one of them
!> unless it was ignored when the program started (`nohup`).
!>
!> The first signal only sets a flag, which all long operations check; a later one ends the program
!> at once. Signals within half a second after the first are ignored: `timeout` and some batch
!> systems send each signal to the process and to its group. SIGHUP and SIGXCPU, which systems
!> repeat, never end it.
module battery_signals
  use battery_c_shapes, only: action, returns_number
  use battery_kinds, only: dp
  use battery_clocks, only: wall_seconds
  use battery_error, only: error_type, fatal_error, exit_stopped_early
  implicit none (type, external)
  private
  public :: watch_signals, stop_requested, request_stop_after, set_stop_error, signals_watch, &
    signal_received

  !> Names of the signals, in the order of the list in signals.c.
  character(len=*), parameter :: names(6) = ['SIGINT ', 'SIGUSR1', 'SIGTERM', 'SIGUSR2', &
    'SIGXCPU', 'SIGHUP ']

  !> Time of the call of `watch_signals`, and time limit, on the clock of `wall_seconds`.
  real(dp) :: began = 0.0_dp, deadline = huge(1.0_dp)

  ! `signals_watch` also serves to set the handlers again after a library has changed them: unlike
  ! `watch_signals`, it does not move the start of the time limit.
  procedure(action), bind(c) :: signals_watch
  procedure(returns_number), bind(c) :: signals_received

contains

  !> Sets the handlers: from now on the signals request a stop instead of ending the program,
  !> and a file beyond its size limit, or a closed pipe, is an error of the write instead of a
  !> signal. Time limits count from this call.
  subroutine watch_signals()
    began = wall_seconds()
    call signals_watch()
  end subroutine watch_signals

  !> Requests a stop after a number of seconds since `watch_signals`.
  subroutine request_stop_after(seconds)
    !> Time since the call of `watch_signals`.
    real(dp), intent(in) :: seconds

    deadline = began + seconds
  end subroutine request_stop_after

  !> Whether a signal has requested a stop.
  logical function signal_received()
    signal_received = signals_received() /= 0
  end function signal_received

  !> Whether a signal or the time limit has requested a stop.
  logical function stop_requested() result(requested)

    requested = signal_received()
    if (.not. requested .and. deadline < huge(1.0_dp)) requested = wall_seconds() >= deadline
  end function stop_requested

  !> Sets the error of a run that is stopped before it has anything to save.
  subroutine set_stop_error(error)
    !> Code `exit_stopped_early`; its message names the signal or the time limit.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: reason
    integer :: which

    which = signals_received()
    reason = '&limits wall_minutes'
    if (which > 0) reason = trim(names(which))
    call fatal_error(error, 'stopped by '//reason//'; nothing was written', exit_stopped_early)
  end subroutine set_stop_error

end module battery_signals

!> Clocks, and waiting.
module battery_clocks
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use battery_c_shapes, only: number_of_text
  use battery_kinds, only: dp, int64
  implicit none (type, external)
  private
  public :: wall_seconds, cpu_seconds, utc_seconds, utc_now, sleep_for

  procedure(number_of_text), bind(c, name='battery_utc') :: c_utc

  interface
    !> The time of day, UTC: seconds since the beginning of 1970.
    real(c_double) function utc_seconds() bind(c, name='battery_utc_seconds')
      import :: c_double
      implicit none (type, external)
    end function utc_seconds

    integer(c_int) function c_usleep(microseconds) bind(c, name='usleep')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: microseconds
    end function c_usleep
  end interface

contains

  !> Seconds on a monotonic clock with an arbitrary origin.
  real(dp) function wall_seconds() result(seconds)
    integer(int64) :: ticks, rate

    call system_clock(ticks, rate)
    seconds = real(ticks, dp)/real(rate, dp)
  end function wall_seconds

  !> Seconds of processor time that this process has used.
  real(dp) function cpu_seconds() result(seconds)

    call cpu_time(seconds)
  end function cpu_seconds

  !> The time of day, UTC: 2026-01-31T23:59:59Z.
  function utc_now() result(text)
    character(len=20) :: text
    character(len=len(text) + 1) :: ended
    integer(c_int) :: length

    length = c_utc(ended, len(ended, c_int))
    text = ended(:length)
  end function utc_now

  !> Sleeps for up to a second; a signal may end the sleep early.
  subroutine sleep_for(seconds)
    !> Time to sleep; more than 0.99 s counts as 0.99 s.
    real(dp), intent(in) :: seconds
    integer(c_int) :: status

    status = c_usleep(int(1.0e6_dp*min(seconds, 0.99_dp), c_int))
  end subroutine sleep_for

end module battery_clocks

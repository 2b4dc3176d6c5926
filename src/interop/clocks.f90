!> Clocks, and waiting.
module battery_clocks
  use, intrinsic :: iso_c_binding, only: c_int, c_char
  use battery_kinds, only: dp, int64
  implicit none (type, external)
  private
  public :: wall_seconds, cpu_seconds, utc_now, rest

  interface
    function c_usleep(microseconds) result(status) bind(c, name='usleep')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: microseconds
      integer(c_int) :: status
    end function c_usleep

    subroutine c_utc(text, room) bind(c, name='battery_utc')
      import :: c_char, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: room
      character(kind=c_char), intent(out) :: text(room)
    end subroutine c_utc
  end interface

contains

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

  !> The time of day, UTC: 2026-01-31T23:59:59Z.
  function utc_now() result(text)
    character(len=20) :: text
    character(len=len(text) + 1) :: ended

    call c_utc(ended, len(ended, c_int))
    text = ended(:len(text))
  end function utc_now

  !> Leaves the processor to others for a while, up to a second; a signal may end it early.
  subroutine rest(seconds)
    !> At most 0.99 of them count.
    real(dp), intent(in) :: seconds
    integer(c_int) :: status

    status = c_usleep(int(1.0e6_dp*min(seconds, 0.99_dp), c_int))
  end subroutine rest

end module battery_clocks

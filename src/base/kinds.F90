!> Number kinds of the whole program.
!>
!> `wp` is the precision of the physics. It is chosen when the program is built
!> (`-DBATTERY_REAL32`, `-DBATTERY_REAL128`; otherwise real64). Files and messages between ranks
!> stay in real64 (`dp`).
module battery_kinds
  use, intrinsic :: iso_fortran_env, only: int8, int16, int32, int64, real32, real64, real128
  implicit none (type, external)
  private
  public :: wp, dp, int8, int16, int32, int64, angle_kind, bits_kind, pi

#if defined(BATTERY_REAL32)
  integer, parameter :: wp = real32
#elif defined(BATTERY_REAL128)
  integer, parameter :: wp = real128
#else
  integer, parameter :: wp = real64
#endif

  !> Kind of results in files and messages.
  integer, parameter :: dp = real64

  !> Integers that hold an angle as a fraction of a turn, with more bits than `wp` has.
  integer, parameter :: angle_kind = selected_int_kind(merge(36, 18, precision(1.0_wp) > 18))

  !> Integers that have as many bits as `wp`.
  integer, parameter :: bits_kind = selected_int_kind(merge(9, merge(18, 38, &
    storage_size(1.0_wp) == 64), storage_size(1.0_wp) == 32))

  real(wp), parameter :: pi = 3.1415926535897932384626433832795028842_wp

end module battery_kinds

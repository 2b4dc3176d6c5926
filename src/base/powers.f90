!> Powers of two next to a number: exact, so that lengths scaled by a power of two give the same
!> bits.
module battery_powers
  use battery_kinds, only: wp
  implicit none (type, external)
  private
  public :: power_below, power_above

contains

  !> The largest power of two that is at most `number`, which is above 0.
  elemental real(wp) function power_below(number) result(power)
    real(wp), intent(in) :: number

    power = scale(1.0_wp, exponent(number) - 1)
  end function power_below

  !> The smallest power of two that is at least `number`, which is above 0.
  elemental real(wp) function power_above(number) result(power)
    real(wp), intent(in) :: number

    power = power_below(number)
    if (power < number) power = 2.0_wp*power
  end function power_above

end module battery_powers

!> Bounds of the lengths and times that can be computed with.
!>
!> Coordinates and clocks have a resolution of the longest length times `epsilon`. So every other
!> length must be many such steps long. The unit is free, as long as no power of a length that is
!> computed anywhere overflows or underflows.
module battery_bounds
  use battery_kinds, only: wp, int64, pi
  use battery_table, only: table_type, area, perimeter
  implicit none (type, external)
  private
  public :: can_count_hits

  !> Least ratio of any length to the longest: 4096 steps of the coordinates.
  real(wp), parameter, public :: finest = 4096.0_wp*epsilon(1.0_wp)

  !> Greatest length: its fourth power, and one over that, are finite.
  real(wp), parameter, public :: greatest_radius = 2.0_wp**(maxexponent(1.0_wp)/4)

  !> Wall hits must be countable even for passages through an urn with this many times the mean
  !> number of hits.
  real(wp), parameter :: longest_passage = 64.0_wp

contains

  !> Whether the wall hits of `number` particles in the time `duration` (0: not known), including
  !> those of passages that have not ended, are fewer than the largest integer.
  pure logical function can_count_hits(table, number, duration) result(can)
    type(table_type), intent(in) :: table
    integer, intent(in) :: number
    real(wp), intent(in) :: duration
    real(wp) :: passage

    passage = maxval(table%urn%perimeter)/sum(table%channel%width)
    can = real(number, wp)*(longest_passage*passage + duration*(perimeter(table)/(pi &
      *area(table)))) < real(huge(1_int64), wp)
  end function can_count_hits

end module battery_bounds

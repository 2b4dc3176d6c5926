!> Bounds of the lengths and times that can be computed with.
!>
!> Coordinates and clocks have a resolution of the longest length times `epsilon`. So every other
!> length must be many such steps long. The unit is free, as long as no power of a length that is
!> computed anywhere overflows or underflows.
module battery_bounds
  use battery_kinds, only: wp, int64, pi
  use battery_text, only: to_text
  use battery_table, only: table_type, area, perimeter, longest_run
  implicit none (type, external)
  private
  public :: bounds_text, can_count_hits, of_powers, of_lengths, of_widths, of_times, &
    of_clocks

  !> Least ratio of any length to the longest: 4096 steps of the coordinates.
  real(wp), parameter, public :: finest = 4096.0_wp*epsilon(1.0_wp)

  !> Greatest length: its fourth power, and one over that, are finite.
  real(wp), parameter, public :: greatest_radius = 2.0_wp**(maxexponent(1.0_wp)/4)

  !> Wall hits must be countable even for passages through an urn with this many times the mean
  !> number of hits.
  real(wp), parameter :: longest_passage = 64.0_wp

  !> Reasons for bounds; their texts are made only when they are needed, since there may be millions
  !> of points.
  integer, parameter :: of_powers = 1, of_lengths = 2, of_widths = 3, of_times = 4, of_clocks = 5

contains

  !> Text for messages: the bounds, and the reason for them.
  pure function bounds_text(least, most, reason) result(text)
    !> Least and greatest value of a number, and the reason.
    real(wp), intent(in) :: least, most
    integer, intent(in) :: reason
    character(len=:), allocatable :: text

    select case (reason)
    case (of_lengths)
      text = 'so that '//to_text(finest) &
        //' of the longest of urn_radius and the channels'' lengths is no longer than the shortest'
    case (of_widths)
      text = 'which are '//to_text(finest) &
        //' of the longest length of the table, and 2 urn_radius less that share of urn_radius'
    case (of_times)
      text = 'which are '//to_text(finest)//' of the longest length of the table, and ' &
        //to_text(longest_run)//' urn_radius'
    case (of_clocks)
      text = 'which is '//to_text(longest_run)//' urn_radius'
    case default
      text = 'whose fourth powers are finite'
    end select
    text = 'from '//to_text(least)//' to '//to_text(most)//', '//text
  end function bounds_text

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

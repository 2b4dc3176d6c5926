!> What lengths and times can be computed with: how far apart they may be.
!>
!> Coordinates and clocks are as sharp as the longest length is, times `epsilon`. So every other
!> length must be many such steps long. The scale as a whole is free, as long as no power of a
!> length that is formed anywhere leaves the range of numbers.
module battery_bounds
  use battery_kinds, only: wp, int64, pi
  use battery_text, only: to_text
  use battery_table, only: table_type, area, perimeter, longest_run
  implicit none (type, external)
  private
  public :: bounds_type, radius_bounds, length_bounds, width_bounds, time_bounds, clock_bounds
  public :: whole_of, complaint, can_count_hits

  !> The least share of the longest length that another may be: 4096 steps of the coordinates.
  real(wp), parameter :: finest = 4096.0_wp*epsilon(1.0_wp)

  !> Fourth powers of lengths up to here, and one over them, are numbers.
  real(wp), parameter :: greatest_radius = 2.0_wp**(maxexponent(1.0_wp)/4)

  !> Visits in which an urn is hit this many times as often as in the mean are counted, too.
  real(wp), parameter :: longest_visit = 64.0_wp

  !> What bounds follow from; the words are made only when they are needed, since there may be
  !> millions of points.
  integer, parameter :: of_powers = 1, of_lengths = 2, of_widths = 3, of_times = 4, of_clocks = 5

  !> What a number may be.
  type :: bounds_type
    real(wp) :: least = 0.0_wp, most = 0.0_wp
    integer :: reason = of_powers
  end type bounds_type

contains

  !> Bounds of the radius of an urn.
  pure function radius_bounds() result(bounds)
    type(bounds_type) :: bounds

    bounds = bounds_type(1.0_wp/greatest_radius, greatest_radius, of_powers)
  end function radius_bounds

  !> Bounds of the length of a channel beside an urn, and beside the other channel, `other` long
  !> (0: closed).
  pure function length_bounds(radius, other) result(bounds)
    !> Of the urn; both in the unit of length.
    real(wp), intent(in) :: radius, other
    type(bounds_type) :: bounds

    bounds = bounds_type(finest*max(radius, other), radius/finest, of_lengths)
  end function length_bounds

  !> Bounds of the width of a channel, on a table whose longest other length is `longest`. Close
  !> to the diameter the arcs and the area that are left lose their digits in the same way.
  pure function width_bounds(radius, longest) result(bounds)
    !> Of the urn; both in the unit of length.
    real(wp), intent(in) :: radius, longest
    type(bounds_type) :: bounds

    bounds = bounds_type(finest*longest, (2.0_wp - finest)*radius, of_widths)
  end function width_bounds

  !> Bounds of a length of time on a table whose longest length is `longest`.
  pure function time_bounds(radius, longest) result(bounds)
    !> Of the urn; both in the unit of length.
    real(wp), intent(in) :: radius, longest
    type(bounds_type) :: bounds

    bounds = bounds_type(finest*longest, longest_run*radius, of_times)
  end function time_bounds

  !> Bounds of a time that the clock shows.
  pure function clock_bounds(radius) result(bounds)
    !> Of the urn, in the unit of length.
    real(wp), intent(in) :: radius
    type(bounds_type) :: bounds

    bounds = bounds_type(0.0_wp, longest_run*radius, of_clocks)
  end function clock_bounds

  !> The longest time below `whole` that what is left after it can be told from nothing.
  elemental function whole_of(whole) result(part)
    real(wp), intent(in) :: whole
    real(wp) :: part

    part = (1.0_wp - finest)*whole
  end function whole_of

  !> What is allowed instead of `value`; empty if it is within its bounds.
  pure function complaint(value, bounds) result(allowed)
    real(wp), intent(in) :: value
    type(bounds_type), intent(in) :: bounds
    character(len=:), allocatable :: allowed

    allowed = ''
    if (value >= bounds%least .and. value <= bounds%most) return
    allowed = 'from '//to_text(bounds%least)//' to '//to_text(bounds%most)//', ' &
      //reason_text(bounds%reason)
  end function complaint

  !> What bounds follow from, in words.
  pure function reason_text(reason) result(text)
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
      text = 'whose powers are still numbers'
    end select
  end function reason_text

  !> Whether the wall hits of `number` particles in the time `duration` (0: not known), those of the
  !> visits under way included, are fewer than a whole number can count.
  pure function can_count_hits(table, number, duration) result(can)
    type(table_type), intent(in) :: table
    integer, intent(in) :: number
    real(wp), intent(in) :: duration
    logical :: can
    real(wp) :: visit

    visit = maxval(table%urn%perimeter)/sum(table%channel%width)
    can = real(number, wp)*(longest_visit*visit + duration*(perimeter(table)/(pi*area(table)))) &
      < real(huge(1_int64), wp)
  end function can_count_hits

end module battery_bounds

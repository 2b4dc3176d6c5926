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
  public :: bounds_type, bounds_text, can_count_hits, of_powers, of_lengths, of_widths, of_times, &
    of_clocks

  !> The least share of the longest length that another may be: 4096 steps of the coordinates.
  real(wp), parameter, public :: finest = 4096.0_wp*epsilon(1.0_wp)

  !> Fourth powers of lengths up to here, and one over them, are numbers.
  real(wp), parameter, public :: greatest_radius = 2.0_wp**(maxexponent(1.0_wp)/4)

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

  !> What bounds allow, and what they follow from.
  pure function bounds_text(bounds) result(text)
    type(bounds_type), intent(in) :: bounds
    character(len=:), allocatable :: text

    select case (bounds%reason)
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
    text = 'from '//to_text(bounds%least)//' to '//to_text(bounds%most)//', '//text
  end function bounds_text

  !> Whether the wall hits of `number` particles in the time `duration` (0: not known), those of the
  !> visits under way included, are fewer than a whole number can count.
  pure logical function can_count_hits(table, number, duration) result(can)
    type(table_type), intent(in) :: table
    integer, intent(in) :: number
    real(wp), intent(in) :: duration
    real(wp) :: visit

    visit = maxval(table%urn%perimeter)/sum(table%channel%width)
    can = real(number, wp)*(longest_visit*visit + duration*(perimeter(table)/(pi*area(table)))) &
      < real(huge(1_int64), wp)
  end function can_count_hits

end module battery_bounds

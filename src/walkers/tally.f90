!> What walkers are seen to do within a time: entries, crossings, and how many are in half 2.
module battery_tally
  use battery_kinds, only: wp, int64
  implicit none (type, external)
  private
  public :: tally_type, new_tally, add_entry, add_turned, add_crossing
  public :: entry_rate, turned_rate, crossing_rate, half2_mean

  !> Sums over all copies of the circuit.
  type :: tally_type
    private
    !> Measured is what happens after `from`, up to `to`.
    real(wp) :: from = 0.0_wp, to = 0.0_wp
    integer :: copies = 1
    !> Entries and turned back by gate, crossings by (side they come from, channel).
    integer(int64) :: entries(2) = 0, turned(2) = 0, crossings(2, 2) = 0
    !> Integral of the number in half 2.
    real(wp) :: half2_sum = 0.0_wp
  end type tally_type

contains

  !> Nothing has been seen yet.
  pure function new_tally(from, to, copies, second) result(tally)
    !> Times since the start: measured is what happens after `from`, up to `to`.
    real(wp), intent(in) :: from, to
    !> How many copies of the circuit there are, and how many start in half 2 of any.
    integer, intent(in) :: copies, second
    type(tally_type) :: tally

    tally%from = from
    tally%to = to
    tally%copies = copies
    tally%half2_sum = (to - from)*real(second, wp)
  end function new_tally

  !> One enters the gate of an urn.
  pure subroutine add_entry(tally, side, time)
    type(tally_type), intent(inout) :: tally
    !> 1 or 2.
    integer, intent(in) :: side
    !> Since the start.
    real(wp), intent(in) :: time

    if (seen(tally, time)) tally%entries(side) = tally%entries(side) + 1
  end subroutine add_entry

  !> The gate of an urn turns back so many.
  pure subroutine add_turned(tally, side, time, number)
    type(tally_type), intent(inout) :: tally
    !> 1 or 2; how many.
    integer, intent(in) :: side, number
    !> Since the start.
    real(wp), intent(in) :: time

    if (seen(tally, time)) tally%turned(side) = tally%turned(side) + number
  end subroutine add_turned

  !> One crosses the line of a channel.
  pure subroutine add_crossing(tally, side, channel, time)
    type(tally_type), intent(inout) :: tally
    !> The side it comes from, 1 or 2; `gated` or `ungated`.
    integer, intent(in) :: side, channel
    !> Since the start; it may lie ahead.
    real(wp), intent(in) :: time
    real(wp) :: rest

    rest = tally%to - min(max(time, tally%from), tally%to)
    tally%half2_sum = tally%half2_sum + merge(rest, -rest, side == 1)
    if (seen(tally, time)) tally%crossings(side, channel) = tally%crossings(side, channel) + 1
  end subroutine add_crossing

  !> Whether what happens then is measured.
  pure function seen(tally, time)
    type(tally_type), intent(in) :: tally
    real(wp), intent(in) :: time
    logical :: seen

    seen = time > tally%from .and. time <= tally%to
  end function seen

  !> Entries into the gate of each urn, per unit time and copy.
  pure function entry_rate(tally) result(rate)
    type(tally_type), intent(in) :: tally
    real(wp) :: rate(2)

    rate = real(tally%entries, wp)/measured_time(tally)
  end function entry_rate

  !> Walkers that each gate turned back, per unit time and copy.
  pure function turned_rate(tally) result(rate)
    type(tally_type), intent(in) :: tally
    real(wp) :: rate(2)

    rate = real(tally%turned, wp)/measured_time(tally)
  end function turned_rate

  !> Crossings by (side they come from, channel), per unit time and copy.
  pure function crossing_rate(tally) result(rate)
    type(tally_type), intent(in) :: tally
    real(wp) :: rate(2, 2)

    rate = real(tally%crossings, wp)/measured_time(tally)
  end function crossing_rate

  !> Mean number in half 2 of a copy, once all of the time measured has been lived.
  pure function half2_mean(tally) result(number)
    type(tally_type), intent(in) :: tally
    real(wp) :: number

    number = tally%half2_sum/measured_time(tally)
  end function half2_mean

  !> Time measured, times the copies.
  pure function measured_time(tally) result(time)
    type(tally_type), intent(in) :: tally
    real(wp) :: time

    time = (tally%to - tally%from)*real(tally%copies, wp)
  end function measured_time

end module battery_tally

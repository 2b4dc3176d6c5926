!> What walkers are seen to do within a time: entries, crossings, and how many are in half 2.
!>
!> What has a polarity is told in blocks of time as well, for that may turn round.
module battery_tally
  use battery_kinds, only: wp, int64
  use battery_table, only: ungated
  implicit none (type, external)
  private
  public :: tally_type, new_tally, add_entry, add_reversed, add_crossing
  public :: entry_rate, reversed_rate, crossing_rate, half2_mean, fuller_mean, polarised_current

  !> Length of a block of time, about.
  real(wp), parameter :: about = 100.0_wp

  !> Sums over all copies of the circuit.
  type :: tally_type
    private
    !> Measured is what happens after `from`, up to `to`.
    real(wp) :: from = 0.0_wp, to = 0.0_wp
    integer :: copies = 1
    !> Entries and turned back by gate, crossings by (side they come from, channel).
    integer(int64) :: entries(2) = 0, reversed(2) = 0, crossings(2, 2) = 0
    !> Integral of the number in half 2.
    real(wp) :: half2_sum = 0.0_wp
    !> How many start in half 2, and how long a block is.
    integer :: second = 0
    real(wp) :: block = 0.0_wp
    !> By block: change of the number in half 2 and its integral up to the block's end, crossings of
    !> channel 2 from half 2 to 1 less those back.
    integer, allocatable :: change(:), returned(:)
    real(wp), allocatable :: changed(:)
  end type tally_type

contains

  !> Nothing has been seen yet.
  pure function new_tally(from, to, copies, second) result(tally)
    !> Times since the start: measured is what happens after `from`, up to `to`.
    real(wp), intent(in) :: from, to
    !> How many copies of the circuit there are, and how many start in half 2 of any.
    integer, intent(in) :: copies, second
    type(tally_type) :: tally
    integer :: blocks

    blocks = max(1, nint((to - from)/about))
    tally%from = from
    tally%to = to
    tally%copies = copies
    tally%half2_sum = (to - from)*real(second, wp)
    tally%second = second
    tally%block = (to - from)/real(blocks, wp)
    allocate (tally%change(blocks), tally%returned(blocks), source=0)
    allocate (tally%changed(blocks), source=0.0_wp)
  end function new_tally

  !> One enters the gate of an urn.
  pure subroutine add_entry(tally, urn, time)
    type(tally_type), intent(inout) :: tally
    !> 1 or 2.
    integer, intent(in) :: urn
    !> Since the start.
    real(wp), intent(in) :: time

    if (is_measured(tally, time)) tally%entries(urn) = tally%entries(urn) + 1
  end subroutine add_entry

  !> The gate of an urn turns back so many.
  pure subroutine add_reversed(tally, urn, time, number)
    type(tally_type), intent(inout) :: tally
    !> 1 or 2; how many.
    integer, intent(in) :: urn, number
    !> Since the start.
    real(wp), intent(in) :: time

    if (is_measured(tally, time)) tally%reversed(urn) = tally%reversed(urn) + number
  end subroutine add_reversed

  !> One crosses the line of a channel.
  pure subroutine add_crossing(tally, urn, channel, time)
    type(tally_type), intent(inout) :: tally
    !> The side it comes from, 1 or 2; `gated` or `ungated`.
    integer, intent(in) :: urn, channel
    !> Since the start; it may lie ahead.
    real(wp), intent(in) :: time
    real(wp) :: at, rest
    integer :: k, gain

    at = min(max(time, tally%from), tally%to)
    rest = tally%to - at
    tally%half2_sum = tally%half2_sum + merge(rest, -rest, urn == 1)
    gain = merge(1, -1, urn == 1)
    k = min(int((at - tally%from)/tally%block) + 1, size(tally%change))
    tally%change(k) = tally%change(k) + gain
    rest = tally%from + real(k, wp)*tally%block - at
    tally%changed(k) = tally%changed(k) + real(gain, wp)*rest
    if (.not. is_measured(tally, time)) return
    tally%crossings(urn, channel) = tally%crossings(urn, channel) + 1
    if (channel == ungated) tally%returned(k) = tally%returned(k) - gain
  end subroutine add_crossing

  !> Whether what happens then is measured.
  pure function is_measured(tally, time)
    type(tally_type), intent(in) :: tally
    real(wp), intent(in) :: time
    logical :: is_measured

    is_measured = time > tally%from .and. time <= tally%to
  end function is_measured

  !> Entries into the gate of each urn, per unit time and copy.
  pure function entry_rate(tally) result(rate)
    type(tally_type), intent(in) :: tally
    real(wp) :: rate(2)

    rate = real(tally%entries, wp)/measured_time(tally)
  end function entry_rate

  !> Walkers that each gate turned back, per unit time and copy.
  pure function reversed_rate(tally) result(rate)
    type(tally_type), intent(in) :: tally
    real(wp) :: rate(2)

    rate = real(tally%reversed, wp)/measured_time(tally)
  end function reversed_rate

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

  !> Mean number in half 2 less half of all, in all copies, by block.
  pure function excess_in_half2(tally, number) result(more)
    type(tally_type), intent(in) :: tally
    !> In a copy, N.
    integer, intent(in) :: number
    real(wp), allocatable :: more(:)
    real(wp) :: half
    integer :: k, level

    allocate (more(size(tally%change)))
    half = 0.5_wp*real(number*tally%copies, wp)
    level = tally%second
    do k = 1, size(more)
      more(k) = real(level, wp) - half + tally%changed(k)/tally%block
      level = level + tally%change(k)
    end do
  end function excess_in_half2

  !> Mean number in the fuller half of a copy, whichever that is in a block of time.
  pure function fuller_mean(tally, number) result(fuller)
    type(tally_type), intent(in) :: tally
    !> In a copy, N.
    integer, intent(in) :: number
    real(wp) :: fuller, more(size(tally%change))

    more = excess_in_half2(tally, number)
    fuller = 0.5_wp*real(number, wp) + sum(abs(more))/real(size(more)*tally%copies, wp)
  end function fuller_mean

  !> Net current of channel 2 from the fuller half to the other, per unit time and copy.
  pure function polarised_current(tally, number) result(current)
    type(tally_type), intent(in) :: tally
    !> In a copy, N.
    integer, intent(in) :: number
    real(wp) :: current

    current = sum(real(tally%returned, wp)*sign(1.0_wp, excess_in_half2(tally, &
      number)))/measured_time(tally)
  end function polarised_current

  !> Time measured, times the copies.
  pure function measured_time(tally) result(time)
    type(tally_type), intent(in) :: tally
    real(wp) :: time

    time = (tally%to - tally%from)*real(tally%copies, wp)
  end function measured_time

end module battery_tally

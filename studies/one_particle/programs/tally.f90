!> Counts of entries, particles reversed and crossings of walkers within a time interval, and the
!> time integral of the number in half 2.
!>
!> Quantities whose sign depends on the polarity are summed over blocks of time too, since the
!> polarity may change.
module battery_tally
  use battery_kinds, only: wp, int64
  use battery_table, only: channel2
  implicit none (type, external)
  private
  public :: tally_type, new_tally, add_count, add_crossing, averages
  public :: entered, reversed, half2, fuller, polarised_current, averages_size

  !> Approximate length of a block of time.
  real(wp), parameter :: block_duration = 100.0_wp
  !> Places in the counts, to which the urn is added, 1 or 2: crossings of channel 1 from the urn,
  !> and two places later of channel 2; entries and particles reversed by the gate of the urn.
  integer, parameter :: crossed = 0, entered = 4, reversed = 6
  !> Places in the averages behind the counts: mean number in half 2; in the half that is fuller at
  !> the time; net current of channel 2 from there.
  integer, parameter :: half2 = 9, fuller = 10, polarised_current = 11, averages_size = 11

  !> Counts and integrals, summed over all copies of the circuit.
  type :: tally_type
    private
    !> Start and end of the interval that is measured.
    real(wp) :: from = 0.0_wp, to = 0.0_wp
    integer :: copies = 1
    integer(int64) :: counts(8) = 0
    !> Time integral of the number in half 2.
    real(wp) :: half2_sum = 0.0_wp
    !> Number in half 2 at the start; length of a block.
    integer :: in_half2 = 0
    real(wp) :: block = 0.0_wp
    !> By block: change of the number in half 2; crossings of channel 2 from half 2 to 1 minus those
    !> from half 1 to 2; time integral over the block of the change since its start.
    integer, allocatable :: change(:), net_crossings(:)
    real(wp), allocatable :: change_integral(:)
  end type tally_type

contains

  !> An empty tally.
  pure function new_tally(from, to, copies, in_half2) result(tally)
    !> Interval that is measured, in time since the start; it includes `to`, not `from`.
    real(wp), intent(in) :: from, to
    !> Number of copies of the circuit; number of walkers that start in half 2, over all copies.
    integer, intent(in) :: copies, in_half2
    type(tally_type) :: tally
    integer :: blocks

    blocks = max(1, nint((to - from)/block_duration))
    tally%from = from
    tally%to = to
    tally%copies = copies
    tally%half2_sum = (to - from)*real(in_half2, wp)
    tally%in_half2 = in_half2
    tally%block = (to - from)/real(blocks, wp)
    allocate (tally%change(blocks), tally%net_crossings(blocks), source=0)
    allocate (tally%change_integral(blocks), source=0.0_wp)
  end function new_tally

  !> Adds `number` to the count at a place.
  pure subroutine add_count(tally, place, time, number)
    type(tally_type), intent(inout) :: tally
    integer, intent(in) :: place, number
    !> Time since the start.
    real(wp), intent(in) :: time

    if (time > tally%from .and. time <= tally%to) &
      tally%counts(place) = tally%counts(place) + number
  end subroutine add_count

  !> Adds a crossing of the middle line of a channel.
  pure subroutine add_crossing(tally, urn, channel, time)
    type(tally_type), intent(inout) :: tally
    !> Urn that the walker comes from, 1 or 2; channel, `channel1` or `channel2`.
    integer, intent(in) :: urn, channel
    !> Time since the start; it may be later than the present time.
    real(wp), intent(in) :: time
    real(wp) :: clipped_time, remaining
    integer :: k, gain

    clipped_time = min(max(time, tally%from), tally%to)
    gain = merge(1, -1, urn == 1)
    tally%half2_sum = tally%half2_sum + real(gain, wp)*(tally%to - clipped_time)
    k = min(int((clipped_time - tally%from)/tally%block) + 1, size(tally%change))
    tally%change(k) = tally%change(k) + gain
    remaining = tally%from + real(k, wp)*tally%block - clipped_time
    tally%change_integral(k) = tally%change_integral(k) + real(gain, wp)*remaining
    call add_count(tally, crossed + merge(2, 0, channel == channel2) + urn, time, 1)
    if (channel == channel2 .and. time > tally%from .and. time <= tally%to) &
      tally%net_crossings(k) = tally%net_crossings(k) - gain
  end subroutine add_crossing

  !> Counts per unit time, and the other averages, of a copy. Valid once all crossings of the
  !> interval have been added.
  pure function averages(tally, number) result(found)
    type(tally_type), intent(in) :: tally
    !> Walkers of a copy, N.
    integer, intent(in) :: number
    real(wp) :: found(averages_size)
    !> By block, summed over all copies: mean number in half 2 minus half of all walkers.
    real(wp) :: excess(size(tally%change)), half, time
    integer :: k, level

    half = 0.5_wp*real(number*tally%copies, wp)
    level = tally%in_half2
    do k = 1, size(excess)
      excess(k) = real(level, wp) - half + tally%change_integral(k)/tally%block
      level = level + tally%change(k)
    end do
    time = (tally%to - tally%from)*real(tally%copies, wp)
    found(:8) = real(tally%counts, wp)/time
    found(half2) = tally%half2_sum/time
    found(fuller) = 0.5_wp*real(number, wp) + sum(abs(excess))/real(size(excess)*tally%copies, wp)
    found(polarised_current) = sum(real(tally%net_crossings, wp)*sign(1.0_wp, excess))/time
  end function averages

end module battery_tally

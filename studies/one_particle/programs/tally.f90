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
  public :: tally_type, new_tally, add_entry, add_reversed, add_crossing
  public :: entry_rate, reversed_rate, crossing_rate, half2_mean, fuller_mean, polarised_current

  !> Approximate length of a block of time.
  real(wp), parameter :: block_duration = 100.0_wp

  !> Counts and integrals, summed over all copies of the circuit.
  type :: tally_type
    private
    !> Start and end of the interval that is measured.
    real(wp) :: from = 0.0_wp, to = 0.0_wp
    integer :: copies = 1
    !> Entries and particles reversed, by gate; crossings by (urn before it, channel).
    integer(int64) :: entries(2) = 0, reversed(2) = 0, crossings(2, 2) = 0
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

  !> Adds an entry into the gate of an urn.
  pure subroutine add_entry(tally, urn, time)
    type(tally_type), intent(inout) :: tally
    !> The urn, 1 or 2.
    integer, intent(in) :: urn
    !> Time since the start.
    real(wp), intent(in) :: time

    if (is_measured(tally, time)) tally%entries(urn) = tally%entries(urn) + 1
  end subroutine add_entry

  !> Adds particles that the gate of an urn reverses.
  pure subroutine add_reversed(tally, urn, time, number)
    type(tally_type), intent(inout) :: tally
    !> The urn, 1 or 2; number of particles.
    integer, intent(in) :: urn, number
    !> Time since the start.
    real(wp), intent(in) :: time

    if (is_measured(tally, time)) tally%reversed(urn) = tally%reversed(urn) + number
  end subroutine add_reversed

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
    remaining = tally%to - clipped_time
    tally%half2_sum = tally%half2_sum + merge(remaining, -remaining, urn == 1)
    gain = merge(1, -1, urn == 1)
    k = min(int((clipped_time - tally%from)/tally%block) + 1, size(tally%change))
    tally%change(k) = tally%change(k) + gain
    remaining = tally%from + real(k, wp)*tally%block - clipped_time
    tally%change_integral(k) = tally%change_integral(k) + real(gain, wp)*remaining
    if (.not. is_measured(tally, time)) return
    tally%crossings(urn, channel) = tally%crossings(urn, channel) + 1
    if (channel == channel2) tally%net_crossings(k) = tally%net_crossings(k) - gain
  end subroutine add_crossing

  !> Whether a time lies in the interval that is measured.
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

  !> Particles reversed by each gate, per unit time and copy.
  pure function reversed_rate(tally) result(rate)
    type(tally_type), intent(in) :: tally
    real(wp) :: rate(2)

    rate = real(tally%reversed, wp)/measured_time(tally)
  end function reversed_rate

  !> Crossings by (urn before it, channel), per unit time and copy.
  pure function crossing_rate(tally) result(rate)
    type(tally_type), intent(in) :: tally
    real(wp) :: rate(2, 2)

    rate = real(tally%crossings, wp)/measured_time(tally)
  end function crossing_rate

  !> Mean number in half 2 of a copy, over the interval. Valid once all crossings of the interval
  !> have been added.
  pure function half2_mean(tally) result(number)
    type(tally_type), intent(in) :: tally
    real(wp) :: number

    number = tally%half2_sum/measured_time(tally)
  end function half2_mean

  !> Mean number in half 2 minus half of all walkers, by block; summed over all copies.
  pure function excess_in_half2(tally, number) result(excess)
    type(tally_type), intent(in) :: tally
    !> Walkers of a copy, N.
    integer, intent(in) :: number
    real(wp), allocatable :: excess(:)
    real(wp) :: half
    integer :: k, level

    allocate (excess(size(tally%change)))
    half = 0.5_wp*real(number*tally%copies, wp)
    level = tally%in_half2
    do k = 1, size(excess)
      excess(k) = real(level, wp) - half + tally%change_integral(k)/tally%block
      level = level + tally%change(k)
    end do
  end function excess_in_half2

  !> Mean number in the fuller half of a copy; the fuller half is determined in each block.
  pure function fuller_mean(tally, number) result(fuller)
    type(tally_type), intent(in) :: tally
    !> Walkers of a copy, N.
    integer, intent(in) :: number
    real(wp) :: fuller, excess(size(tally%change))

    excess = excess_in_half2(tally, number)
    fuller = 0.5_wp*real(number, wp) + sum(abs(excess))/real(size(excess)*tally%copies, wp)
  end function fuller_mean

  !> Net current through channel 2 from the fuller half to the other, per unit time and copy.
  pure function polarised_current(tally, number) result(current)
    type(tally_type), intent(in) :: tally
    !> Walkers of a copy, N.
    integer, intent(in) :: number
    real(wp) :: current

    current = sum(real(tally%net_crossings, wp)*sign(1.0_wp, excess_in_half2(tally, &
      number)))/measured_time(tally)
  end function polarised_current

  !> Length of the interval times the number of copies.
  pure function measured_time(tally) result(time)
    type(tally_type), intent(in) :: tally
    real(wp) :: time

    time = (tally%to - tally%from)*real(tally%copies, wp)
  end function measured_time

end module battery_tally

!> The threshold gate: the particles that it counts, the events at which it reverses, the particles
!> that it reverses, and the order of events at one instant.
!>
!> **The rule** (PRE 103, 032119, Sec. II). A gate is the half of channel 1 that belongs to its urn.
!> It counts the particles that are inside and head for the other gate: from their entry until they
!> cross the middle line. When entries make the count exceed the threshold, all counted particles
!> are reversed, those that enter at that instant included; then none is counted. Only an entry can
!> make a gate reverse. Particles from the other gate, and those on their way out, are neither
!> counted nor affected.
!>
!> **One instant.** Crossings of the middle line come before entries, that of gate 1 first, and all
!> entries of one gate count before the gate decides. So no result depends on the order of particles
!> in memory.
!>
!> The counted particles are queued by the time at which they will reach the middle line. Engines
!> call the gate at entries and crossings, one by one (`enter_gate`, `must_reverse`,
!> `uncount_first`), or with all entries of a window (`apply_rule_to_window`). The rule is here,
!> with one exception: an engine that calls one by one decides which entries are of one instant.
!> `more_entries_follow` of `serial_window.f90` does so before it obeys `must_reverse`; engines that
!> go from wall to wall ask `decide_reversal` when the time has changed.
module battery_gate
  use battery_kinds, only: wp, int64
  use battery_queue, only: queue_type, empty_queue, push, push_all, pop, pop_due, remove_particle, &
    rebase_queue, serialize_queue
  use battery_archive, only: archive_type
  use battery_visits, only: visits_type
  implicit none (type, external)
  private
  public :: gate_type, new_gate, enter_gate, clear_new_entries, must_reverse
  public :: has_undecided_entries, decide_reversal, uncount_all
  public :: number_inside, counted_particle, next_crossing_time, first_crossing_time
  public :: gate_crossed_first, uncount_first, uncount_particle, rebase_gate, serialize_gate
  public :: gate_window_type, crossing_list_type, reserve_gate_window, apply_rule_to_window

  !> The gate of one urn: its threshold, and the particles that it counts.
  type :: gate_type
    !> The gate reverses when it counts more particles than this.
    integer :: threshold = 0
    !> Whether a particle has entered since the gate last decided.
    logical :: entered = .false.
    !> The counted particles, queued by the time at which each will reach the middle line.
    type(queue_type), private :: counted
  end type gate_type

  !> The entries into one gate in one window, and the reversals that follow from them
  !> (`apply_rule_to_window`). Arrays may be longer than their counts.
  type :: gate_window_type
    !> Number of reversals.
    integer :: reversals = 0
    !> For each reversal, the entry that it follows.
    integer, allocatable :: last_entry(:)
    !> For each reversal, the number of particles reversed.
    integer, allocatable :: reversed(:)
    !> Work space: time at which each particle would cross the middle line.
    real(wp), allocatable :: time(:)
    !> Work space: particles counted before that would cross in the window, then those that enter,
    !> in order.
    integer, allocatable :: particle(:)
  end type gate_window_type

  !> Crossings of the lines in one window. Arrays may be longer than the count.
  type :: crossing_list_type
    integer :: count = 0
    real(wp), allocatable :: time(:)
    !> An integer to order those of one time by; of the gates the particle.
    integer, allocatable :: order(:)
  end type crossing_list_type

contains

  !> A gate that counts no particle.
  pure subroutine new_gate(gate, threshold)
    type(gate_type), intent(inout) :: gate
    !> Threshold, 0 or more.
    integer, intent(in) :: threshold

    gate%threshold = threshold
    gate%entered = .false.
    call empty_queue(gate%counted)
  end subroutine new_gate

  !> Counts a particle that enters from the urn.
  pure subroutine enter_gate(gate, crossing_time, particle)
    type(gate_type), intent(inout) :: gate
    !> Time at which the particle will reach the middle line, on the clock of the engine.
    real(wp), intent(in) :: crossing_time
    !> Particle index, 1 ... N.
    integer, intent(in) :: particle

    call push(gate%counted, crossing_time, particle)
    gate%entered = .true.
  end subroutine enter_gate

  !> Called once, after the initial state is loaded: the particles counted so far started inside.
  !> They count, but only a later entry can make the gate reverse.
  elemental subroutine clear_new_entries(gate)
    type(gate_type), intent(inout) :: gate

    gate%entered = .false.
  end subroutine clear_new_entries

  !> Number of counted particles.
  elemental function number_inside(gate) result(number)
    type(gate_type), intent(in) :: gate
    integer :: number

    number = gate%counted%count
  end function number_inside

  !> A counted particle.
  elemental function counted_particle(gate, place) result(particle)
    type(gate_type), intent(in) :: gate
    !> From 1 to `number_inside`, in no order.
    integer, intent(in) :: place
    integer :: particle

    particle = gate%counted%particle(place)
  end function counted_particle

  !> Time at which the earliest counted particle reaches the middle line; huge if none is counted.
  elemental function next_crossing_time(gate) result(time)
    type(gate_type), intent(in) :: gate
    real(wp) :: time

    time = gate%counted%next
  end function next_crossing_time

  !> Earliest pending crossing over both gates.
  pure function first_crossing_time(gate) result(time)
    type(gate_type), intent(in) :: gate(2)
    real(wp) :: time

    time = min(gate(1)%counted%next, gate(2)%counted%next)
  end function first_crossing_time

  !> Whether the gate reverses if no other particle enters at this instant.
  pure function must_reverse(gate)
    type(gate_type), intent(in) :: gate
    logical :: must_reverse

    must_reverse = gate%counted%count > most_inside(gate)
  end function must_reverse

  !> Largest count that does not make the gate reverse.
  pure function most_inside(gate) result(greatest_count)
    type(gate_type), intent(in) :: gate
    integer :: greatest_count

    greatest_count = gate%threshold
  end function most_inside

  !> Whether any particle has entered a gate since the gates last decided.
  pure function has_undecided_entries(gate)
    type(gate_type), intent(in) :: gate(2)
    logical :: has_undecided_entries

    has_undecided_entries = gate(1)%entered .or. gate(2)%entered
  end function has_undecided_entries

  !> Decides, at the end of an instant, whether the gate reverses.
  pure subroutine decide_reversal(gate, reverses)
    type(gate_type), intent(inout) :: gate
    !> Whether all counted particles (`counted_particle`) are to be reversed.
    logical, intent(out) :: reverses

    reverses = gate%entered .and. must_reverse(gate)
    gate%entered = .false.
  end subroutine decide_reversal

  !> The gate whose earliest crossing of the middle line comes first.
  pure function gate_crossed_first(gate) result(urn)
    type(gate_type), intent(in) :: gate(2)
    integer :: urn

    urn = merge(1, 2, gate(1)%counted%next <= gate(2)%counted%next)
  end function gate_crossed_first

  !> Removes the particle that crosses the middle line first from the count of its gate.
  pure subroutine uncount_first(gate, particle)
    type(gate_type), intent(inout) :: gate
    !> Index of the particle removed.
    integer, intent(out) :: particle

    call pop(gate%counted, particle)
  end subroutine uncount_first

  !> Removes a particle from the count of its gate, since it crosses the middle line.
  pure subroutine uncount_particle(gate, particle)
    type(gate_type), intent(inout) :: gate
    !> Particle index, 1 ... N.
    integer, intent(in) :: particle

    call remove_particle(gate%counted, particle)
  end subroutine uncount_particle

  !> Removes all counted particles from the count of a gate, since they have been reversed.
  pure subroutine uncount_all(gate)
    type(gate_type), intent(inout) :: gate

    call empty_queue(gate%counted)
    gate%entered = .false.
  end subroutine uncount_all

  !> Allocates the arrays for the entries of a window and the particles counted before.
  subroutine reserve_gate_window(gate_window, number)
    type(gate_window_type), intent(inout) :: gate_window
    !> Largest number of entries and counted particles together.
    integer, intent(in) :: number
    integer :: capacity

    if (allocated(gate_window%particle)) then
      if (size(gate_window%particle) >= number) return
      deallocate (gate_window%last_entry, gate_window%reversed, gate_window%time, &
        gate_window%particle)
    end if
    capacity = max(64, 2*number)
    allocate (gate_window%last_entry(capacity), gate_window%reversed(capacity), &
      gate_window%time(capacity), gate_window%particle(capacity))
  end subroutine reserve_gate_window

  !> Applies the rule to a batch of entries and to all crossings before `until`, which is after the
  !> last entry. The result is that of single entries and crossings, but particles reversed and
  !> particles that cross are listed in no order.
  pure subroutine apply_rule_to_window(gate, gate_window, entries, entry_time, crossing_time, &
    entering_particle, until, visits, crossings)
    type(gate_type), intent(inout) :: gate
    type(gate_window_type), intent(inout) :: gate_window
    !> Number of entries.
    integer, intent(in) :: entries
    !> Time of each entry, ascending, and time at which its particle would reach the middle line,
    !> which is later; all times on the clock of the engine.
    real(wp), intent(in) :: entry_time(entries), crossing_time(entries)
    !> Particle of each entry.
    integer, intent(in) :: entering_particle(entries)
    real(wp), intent(in) :: until
    !> A visit is added for each particle reversed: particle and time of reversal.
    type(visits_type), intent(inout) :: visits
    !> Crossings of the middle line are added.
    type(crossing_list_type), intent(inout) :: crossings
    integer :: crossing_soon, still_inside

    gate_window%reversals = 0
    gate%entered = .false.
    associate (counted => gate%counted)
      if (entries == 0 .and. counted%next >= until) return
      call pop_due(counted, until, crossing_soon, gate_window%time, gate_window%particle)
      gate_window%time(crossing_soon + 1:crossing_soon + entries) = crossing_time
      gate_window%particle(crossing_soon + 1:crossing_soon + entries) = entering_particle
      call apply_rule(most_inside(gate), counted%count, crossing_soon, entries, entry_time, until, &
        gate_window%time, gate_window%particle, counted%particle, gate_window%reversals, &
        gate_window%last_entry, gate_window%reversed, visits%count, visits%particle, &
        visits%reversal_time, crossings%count, crossings%order, crossings%time, still_inside)
      if (gate_window%reversals > 0) call empty_queue(counted)
      call push_all(counted, still_inside, gate_window%time, gate_window%particle)
    end associate
  end subroutine apply_rule_to_window

  !> Applies the rule to a batch of entries, by counting. `time` is the time at which each particle
  !> would cross: first the `crossing_soon` particles counted before, then those that enter, in
  !> order. `crossing_later` other counted particles, which are not in these arrays, cross after
  !> `until`. On exit the first `still_inside` of `time` and `particle` are the particles still
  !> inside.
  !>
  !> An entry adds at most one to the count: if `inside` are counted at an entry, the gate cannot
  !> reverse before the (greatest_count + 1 - inside)-th entry after it. The entries in between are
  !> skipped. At an entry that is examined, the particles inside are counted by a loop without
  !> branches.
  pure subroutine apply_rule(greatest_count, crossing_later, crossing_soon, entries, entry_time, &
    until, time, particle, later_particle, reversals, last_entry, reversed, reversed_count, &
    reversed_particle, reversed_at, crossed, crossing_particle, crossed_at, still_inside)
    integer, intent(in) :: greatest_count, crossing_later, crossing_soon, entries
    real(wp), intent(in) :: entry_time(entries), until
    real(wp), intent(inout) :: time(crossing_soon + entries)
    integer, intent(inout) :: particle(crossing_soon + entries)
    integer, intent(in), contiguous :: later_particle(:)
    integer, intent(inout) :: reversals
    integer, intent(inout), contiguous :: last_entry(:), reversed(:)
    integer, intent(inout) :: reversed_count, crossed
    integer, intent(inout), contiguous :: reversed_particle(:), crossing_particle(:)
    real(wp), intent(inout), contiguous :: reversed_at(:), crossed_at(:)
    integer, intent(out) :: still_inside
    integer :: limit, others, first, last, k, inside

    limit = min(greatest_count, shiftr(huge(1), 1))
    others = crossing_later
    first = 1
    k = max(1, limit + 1 - crossing_soon - others)
    do while (k <= entries)
      last = crossing_soon + k
      inside = others + count_after(last - first + 1, time(first:last), entry_time(k))
      if (inside <= limit) then
        k = k + limit + 1 - inside
        cycle
      end if
      ! All entries at this instant count before the gate decides.
      do while (k < entries)
        if (entry_time(k + 1) > entry_time(k)) exit
        k = k + 1
      end do
      last = crossing_soon + k
      reversals = reversals + 1
      last_entry(reversals) = k
      reversed(reversals) = reversed_count
      reversed_particle(reversed_count + 1:reversed_count + others) = later_particle(:others)
      reversed_at(reversed_count + 1:reversed_count + others) = entry_time(k)
      reversed_count = reversed_count + others
      call split_at_reversal(last - first + 1, time(first:last), particle(first:last), &
        entry_time(k), reversed_count, reversed_particle, reversed_at, crossed, crossing_particle, &
        crossed_at)
      reversed(reversals) = reversed_count - reversed(reversals)
      others = 0
      first = last + 1
      k = k + max(limit, 0) + 1
    end do
    still_inside = 0
    do k = first, crossing_soon + entries
      crossing_particle(crossed + 1) = particle(k)
      crossed_at(crossed + 1) = time(k)
      crossed = crossed + merge(1, 0, time(k) < until)
      particle(still_inside + 1) = particle(k)
      time(still_inside + 1) = time(k)
      still_inside = still_inside + merge(0, 1, time(k) < until)
    end do
  end subroutine apply_rule

  !> Number of times after `instant`.
  pure function count_after(n, time, instant) result(after)
    integer, intent(in) :: n
    real(wp), intent(in) :: time(n), instant
    integer :: after

    after = int(count(time > instant, kind=int64))
  end function count_after

  !> Splits the particles counted up to a reversal into those that have crossed before it and those
  !> that it reverses.
  pure subroutine split_at_reversal(n, time, particle, instant, reversed_count, reversed_particle, &
    reversed_at, crossed, crossing_particle, crossed_at)
    integer, intent(in) :: n
    real(wp), intent(in) :: time(n), instant
    integer, intent(in) :: particle(n)
    integer, intent(inout) :: reversed_count, crossed
    integer, intent(inout), contiguous :: reversed_particle(:), crossing_particle(:)
    real(wp), intent(inout), contiguous :: reversed_at(:), crossed_at(:)
    integer :: k

    do k = 1, n
      reversed_particle(reversed_count + 1) = particle(k)
      reversed_at(reversed_count + 1) = instant
      reversed_count = reversed_count + merge(1, 0, time(k) > instant)
      crossing_particle(crossed + 1) = particle(k)
      crossed_at(crossed + 1) = time(k)
      crossed = crossed + merge(0, 1, time(k) > instant)
    end do
  end subroutine split_at_reversal

  !> Subtracts `shift` from all times.
  pure subroutine rebase_gate(gate, shift)
    type(gate_type), intent(inout) :: gate
    real(wp), intent(in) :: shift

    call rebase_queue(gate%counted, shift)
  end subroutine rebase_gate

  !> Saves or restores the counted particles; the threshold is part of the setup.
  pure subroutine serialize_gate(gate, archive)
    type(gate_type), intent(inout) :: gate
    type(archive_type), intent(inout) :: archive

    call archive%serialize('entered', gate%entered)
    call serialize_queue(gate%counted, archive)
  end subroutine serialize_gate

end module battery_gate

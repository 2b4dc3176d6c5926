!> The threshold gate: who is counted, when it turns, whom it turns, what happens at one instant.
!>
!> **The rule** (paper, Sec. II; `physics.md` made exact). A gate counts the particles that are
!> inside and head for the other gate: from their entry until they cross the middle line. When
!> entries make the count exceed the threshold, all those counted turn back, the entrants of that
!> instant too; then nobody is counted. Only an entry can make a gate turn. Particles from the other
!> gate, and those on their way out, are not counted and not touched.
!>
!> **One instant.** Crossings of the middle line come before entries, that of gate 1 first, and all
!> entries of one gate count before the gate decides: so the order of particles in memory is nowhere
!> to be seen.
!>
!> Those counted stand in a queue by the time at which they will reach the middle line. Engines ask
!> the gate at entries and crossings, one by one (`enter_gate`, `must_reverse`, `uncount_first`), or
!> send a whole stretch of entries through (`admit_entries`); no engine knows the rule.
module battery_gate
  use battery_kinds, only: wp, int64
  use battery_queue, only: queue_type, empty_queue, push, push_all, pop, pop_due, remove, &
    rebase_queue, serialize_queue
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: gate_type, new_gate, enter_gate, forget_entries, must_reverse, has_undecided_entries, &
    decide_reversal, uncount_all
  public :: number_inside, counted_particle, next_crossing_time, first_crossing_time
  public :: gate_crossed_first, uncount_first, uncount_particle, rebase_gate, serialize_gate
  public :: stretch_type, reserve_stretch, admit_entries

  !> The gate of one side: its rule, and whom it counts.
  type :: gate_type
    !> More than so many turn.
    integer :: threshold = 0
    !> Whether somebody has entered since the gate last decided.
    logical :: entered = .false.
    !> Those counted, by when each will reach the middle line.
    type(queue_type), private :: counted
  end type gate_type

  !> What a stretch of entries into one gate leads to (`admit_entries`). Arrays may be longer than
  !> their counts say.
  type :: stretch_type
    !> How often the gate turned; after which entry, and how many it turned back.
    integer :: reversals = 0
    integer, allocatable :: last_entry(:), reversed(:)
    !> Work space: those counted before and the entrants, in turn; when each crosses.
    real(wp), allocatable :: time(:)
    integer, allocatable :: who(:)
  end type stretch_type

contains

  !> A gate that counts nobody yet.
  pure subroutine new_gate(gate, threshold)
    type(gate_type), intent(inout) :: gate
    !> How many it lets head for the other gate at a time, 0 or more.
    integer, intent(in) :: threshold

    gate%threshold = threshold
    gate%entered = .false.
    call empty_queue(gate%counted)
  end subroutine new_gate

  !> A particle enters from the urn.
  pure subroutine enter_gate(gate, crossing_time, particle)
    type(gate_type), intent(inout) :: gate
    !> When it will reach the middle line, on the clock of the engine.
    real(wp), intent(in) :: crossing_time
    !> Its number, from 1.
    integer, intent(in) :: particle

    call push(gate%counted, crossing_time, particle)
    gate%entered = .true.
  end subroutine enter_gate

  !> Who has been counted so far was inside from the start and heads for the middle line: that is no
  !> entry.
  elemental subroutine forget_entries(gate)
    type(gate_type), intent(inout) :: gate

    gate%entered = .false.
  end subroutine forget_entries

  !> How many are counted.
  elemental function number_inside(gate) result(number)
    type(gate_type), intent(in) :: gate
    integer :: number

    number = gate%counted%count
  end function number_inside

  !> One of those counted.
  elemental function counted_particle(gate, place) result(particle)
    type(gate_type), intent(in) :: gate
    !> From 1 to `number_inside`, in no order.
    integer, intent(in) :: place
    integer :: particle

    particle = gate%counted%who(place)
  end function counted_particle

  !> When the first of those counted reaches the middle line; huge if nobody is counted.
  elemental function next_crossing_time(gate) result(time)
    type(gate_type), intent(in) :: gate
    real(wp) :: time

    time = gate%counted%next
  end function next_crossing_time

  !> The same for both gates: whoever is first.
  pure function first_crossing_time(gate) result(time)
    type(gate_type), intent(in) :: gate(2)
    real(wp) :: time

    time = min(gate(1)%counted%next, gate(2)%counted%next)
  end function first_crossing_time

  !> Whether the gate turns if nobody else enters at this instant.
  pure function must_reverse(gate)
    type(gate_type), intent(in) :: gate
    logical :: must_reverse

    must_reverse = gate%counted%count > most_inside(gate)
  end function must_reverse

  !> So many may be counted at most; one more, and the gate turns.
  pure function most_inside(gate) result(most)
    type(gate_type), intent(in) :: gate
    integer :: most

    most = gate%threshold
  end function most_inside

  !> Whether any gate has something to decide when the instant is over.
  pure function has_undecided_entries(gate)
    type(gate_type), intent(in) :: gate(2)
    logical :: has_undecided_entries

    has_undecided_entries = gate(1)%entered .or. gate(2)%entered
  end function has_undecided_entries

  !> The instant is over: whether the gate turns back those counted, all of `counted_particle`.
  pure subroutine decide_reversal(gate, turns)
    type(gate_type), intent(inout) :: gate
    !> Whether all those counted are to be turned back.
    logical, intent(out) :: turns

    turns = gate%entered .and. must_reverse(gate)
    gate%entered = .false.
  end subroutine decide_reversal

  !> Which of the two gates is first to have somebody cross the middle line.
  pure function gate_crossed_first(gate) result(side)
    type(gate_type), intent(in) :: gate(2)
    integer :: side

    side = merge(1, 2, gate(1)%counted%next <= gate(2)%counted%next)
  end function gate_crossed_first

  !> The first of those counted crosses the middle line.
  pure subroutine uncount_first(gate, particle)
    type(gate_type), intent(inout) :: gate
    !> Who that is; not counted any more.
    integer, intent(out) :: particle

    call pop(gate%counted, particle)
  end subroutine uncount_first

  !> This particle, which is counted, crosses the middle line.
  pure subroutine uncount_particle(gate, particle)
    type(gate_type), intent(inout) :: gate
    !> Its number; not counted any more.
    integer, intent(in) :: particle

    call remove(gate%counted, particle)
  end subroutine uncount_particle

  !> All those counted have been turned back.
  pure subroutine uncount_all(gate)
    type(gate_type), intent(inout) :: gate

    call empty_queue(gate%counted)
    gate%entered = .false.
  end subroutine uncount_all

  !> Makes room for so many: entries, and those counted before them.
  subroutine reserve_stretch(stretch, number)
    type(stretch_type), intent(inout) :: stretch
    !> How many there will be at most.
    integer, intent(in) :: number
    integer :: room

    if (allocated(stretch%who)) then
      if (size(stretch%who) >= number) return
      deallocate (stretch%last_entry, stretch%reversed, stretch%time, stretch%who)
    end if
    room = max(64, 2*number)
    allocate (stretch%last_entry(room), stretch%reversed(room), stretch%time(room), &
      stretch%who(room))
  end subroutine reserve_stretch

  !> A whole stretch of entries, and all crossings before `until`, which is after the last entry.
  !> The same as one by one; but those who leave, turned back or across the middle line, are told in
  !> no order.
  pure subroutine admit_entries(gate, stretch, entries, entry_time, crossing_time, entrant, until, &
    leaving, leaver, turned_at, crossed, crosser, crossed_at)
    type(gate_type), intent(inout) :: gate
    type(stretch_type), intent(inout) :: stretch
    !> How many enter.
    integer, intent(in) :: entries
    !> When each enters, in order, and when it would reach the middle line, which is later; on the
    !> clock of the engine, as all times here.
    real(wp), intent(in) :: entry_time(entries), crossing_time(entries)
    !> Who it is.
    integer, intent(in) :: entrant(entries)
    real(wp), intent(in) :: until
    !> So many are in the list; those turned back are added.
    integer, intent(inout) :: leaving
    !> Who was turned back,
    integer, intent(inout), contiguous :: leaver(:)
    !> and when.
    real(wp), intent(inout), contiguous :: turned_at(:)
    !> So many are in the list; those who cross are added.
    integer, intent(inout) :: crossed
    !> Who crossed,
    integer, intent(inout), contiguous :: crosser(:)
    !> and when.
    real(wp), intent(inout), contiguous :: crossed_at(:)
    integer :: held, rest

    stretch%reversals = 0
    gate%entered = .false.
    associate (counted => gate%counted)
      if (entries == 0 .and. counted%next >= until) return
      call pop_due(counted, until, held, stretch%time, stretch%who)
      stretch%time(held + 1:held + entries) = crossing_time
      stretch%who(held + 1:held + entries) = entrant
      call apply_rule(most_inside(gate), counted%count, held, entries, entry_time, until, &
        stretch%time, stretch%who, counted%who, stretch%reversals, stretch%last_entry, &
        stretch%reversed, leaving, leaver, turned_at, crossed, crosser, crossed_at, rest)
      if (stretch%reversals > 0) call empty_queue(counted)
      call push_all(counted, rest, stretch%time, stretch%who)
    end associate
  end subroutine admit_entries

  !> The rule for a stretch of entries, by counting. Of `held` from before and the entrants in turn,
  !> `time` is when each will cross; `staying` more cross after `until`. Those who are left inside
  !> at the end are the first `rest` of `time` and `who`.
  !>
  !> One entry adds one to the count at most: while `inside` are counted at an entry, the gate
  !> cannot turn before the (most + 1 - inside)-th after it. So only few are looked at, and of
  !> those the count is a loop without branches.
  pure subroutine apply_rule(most, staying, held, entries, entry_time, until, time, who, &
    stayer, reversals, last_entry, reversed, leaving, leaver, turned_at, crossed, crosser, &
    crossed_at, rest)
    integer, intent(in) :: most, staying, held, entries
    real(wp), intent(in) :: entry_time(entries), until
    real(wp), intent(inout) :: time(held + entries)
    integer, intent(inout) :: who(held + entries)
    integer, intent(in), contiguous :: stayer(:)
    integer, intent(inout) :: reversals
    integer, intent(inout), contiguous :: last_entry(:), reversed(:)
    integer, intent(inout) :: leaving, crossed
    integer, intent(inout), contiguous :: leaver(:), crosser(:)
    real(wp), intent(inout), contiguous :: turned_at(:), crossed_at(:)
    integer, intent(out) :: rest
    integer :: limit, others, first, last, k, inside

    limit = min(most, shiftr(huge(1), 1))
    others = staying
    first = 1
    k = max(1, limit + 1 - held - others)
    do while (k <= entries)
      last = held + k
      inside = others + count_after(last - first + 1, time(first:last), entry_time(k))
      if (inside <= limit) then
        k = k + limit + 1 - inside
        cycle
      end if
      ! All who enter at this instant count before the gate decides.
      do while (k < entries)
        if (entry_time(k + 1) > entry_time(k)) exit
        k = k + 1
      end do
      last = held + k
      reversals = reversals + 1
      last_entry(reversals) = k
      reversed(reversals) = leaving
      leaver(leaving + 1:leaving + others) = stayer(:others)
      turned_at(leaving + 1:leaving + others) = entry_time(k)
      leaving = leaving + others
      call split_at_reversal(last - first + 1, time(first:last), who(first:last), entry_time(k), &
        leaving, leaver, turned_at, crossed, crosser, crossed_at)
      reversed(reversals) = leaving - reversed(reversals)
      others = 0
      first = last + 1
      k = k + max(limit, 0) + 1
    end do
    rest = 0
    do k = first, held + entries
      crosser(crossed + 1) = who(k)
      crossed_at(crossed + 1) = time(k)
      crossed = crossed + merge(1, 0, time(k) < until)
      who(rest + 1) = who(k)
      time(rest + 1) = time(k)
      rest = rest + merge(0, 1, time(k) < until)
    end do
  end subroutine apply_rule

  !> How many of the times are after `instant`.
  pure function count_after(n, time, instant) result(after)
    integer, intent(in) :: n
    real(wp), intent(in) :: time(n), instant
    integer :: after

    after = int(count(time > instant, kind=int64))
  end function count_after

  !> The gate turns at this `instant`: who has crossed by then, and who is turned back.
  pure subroutine split_at_reversal(n, time, who, instant, leaving, leaver, turned_at, crossed, &
    crosser, crossed_at)
    integer, intent(in) :: n
    real(wp), intent(in) :: time(n), instant
    integer, intent(in) :: who(n)
    integer, intent(inout) :: leaving, crossed
    integer, intent(inout), contiguous :: leaver(:), crosser(:)
    real(wp), intent(inout), contiguous :: turned_at(:), crossed_at(:)
    integer :: k

    do k = 1, n
      leaver(leaving + 1) = who(k)
      turned_at(leaving + 1) = instant
      leaving = leaving + merge(1, 0, time(k) > instant)
      crosser(crossed + 1) = who(k)
      crossed_at(crossed + 1) = time(k)
      crossed = crossed + merge(0, 1, time(k) > instant)
    end do
  end subroutine split_at_reversal

  !> The clock is set back by `shift`.
  pure subroutine rebase_gate(gate, shift)
    type(gate_type), intent(inout) :: gate
    real(wp), intent(in) :: shift

    call rebase_queue(gate%counted, shift)
  end subroutine rebase_gate

  !> Who is counted, through a stream; the threshold belongs to what is simulated.
  pure subroutine serialize_gate(gate, archive)
    type(gate_type), intent(inout) :: gate
    type(archive_type), intent(inout) :: archive

    call archive%serialize('entered', gate%entered)
    call serialize_queue(gate%counted, archive)
  end subroutine serialize_gate

end module battery_gate

!> The events of one window of the engine `excursion`: who enters which gate, who crosses a line.
module battery_batch_window
  use battery_kinds, only: wp, int8
  use battery_table, only: gated, ungated
  use battery_gate, only: stretch_type, reserve_stretch
  use battery_ordering, only: sort_by_time
  use battery_calendar, only: flight_type
  use battery_flight, only: middle_time, to_gate, counted_in_gate
  use battery_event_record, only: event_record_type, record_crossing, record_event, &
    record_reversal, crossing_of, event_entry
  implicit none (type, external)
  private
  public :: window_type, reserve_batch_window, partition_events, sort_crossings, &
    decode_crossing_order, record_crossings, record_logged_events

  !> Where events are dealt out to: the gates of urn 1 and 2, and the periodic line.
  integer, parameter, public :: periodic_line = 3

  !> Bits of a ticket that tell who crosses: more than 2e8 particles cannot be asked for.
  integer, parameter :: particle_bits = 28

  !> What happens in a window, dealt out.
  type :: window_type
    !> How many were dealt out to each; when each is due, when it would cross the middle line, whose
    !> it is: (place, gate 1, gate 2, periodic line).
    integer :: partition_count(3) = 0
    real(wp), allocatable :: due(:, :), middle(:, :)
    integer, allocatable :: particle(:, :)
    !> What the entries into each gate led to.
    type(stretch_type) :: stretch(2)
    !> Crossings of all lines: when, and the ticket that says who crosses which. A gate knows of one
    !> line only: it tells who, which is a ticket of gate 1, until `sort_crossings`.
    integer :: crossings = 0
    real(wp), allocatable :: crossing_time(:)
    integer, allocatable :: crossing_order(:)
  end type window_type

contains

  !> Makes room for so many events, and for those that gates count.
  subroutine reserve_batch_window(window, events, counted)
    type(window_type), intent(inout) :: window
    !> How many there will be.
    integer, intent(in) :: events
    !> By gate 1 and by gate 2.
    integer, intent(in) :: counted(2)
    integer :: side, room

    do side = 1, 2
      call reserve_stretch(window%stretch(side), events + counted(side))
    end do
    window%crossings = 0
    room = events + sum(counted)
    if (allocated(window%crossing_order)) then
      if (size(window%crossing_order) >= room) return
      deallocate (window%due, window%middle, window%particle, window%crossing_time, &
        window%crossing_order)
    end if
    room = max(64, 2*room)
    allocate (window%due(room, 3), window%middle(room, 3), window%particle(room, 3), &
      window%crossing_time(room), window%crossing_order(room))
  end subroutine reserve_batch_window

  !> Deals out the events that are due: those who enter a gate are inside from now on. Without
  !> branches: with many particles each flight is a line of memory, and many of them are to be on
  !> their way at a time.
  pure subroutine partition_events(number, flight, events, due_time, who, room, partition_count, &
    due, middle, particle)
    !> How many particles and events there are.
    integer, intent(in) :: number, events
    type(flight_type), intent(inout) :: flight(number)
    !> Events in the order of time: when each is due,
    real(wp), intent(in) :: due_time(events)
    !> and whose it is.
    integer, intent(in) :: who(events)
    !> As in `window_type`, where `partition_count`, `due`, `middle` and `particle` are explained.
    integer, intent(in) :: room
    !> How many went where.
    integer, intent(out) :: partition_count(3)
    !> When each is due, and when it is at the middle line.
    real(wp), intent(inout) :: due(room, 3), middle(room, 3)
    !> Who it is.
    integer, intent(inout) :: particle(room, 3)
    integer :: k, i, place, line
    logical :: enters

    partition_count = 0
    do k = 1, events
      i = who(k)
      enters = flight(i)%heading == to_gate
      line = merge(int(flight(i)%urn), periodic_line, enters)
      flight(i)%heading = merge(counted_in_gate, flight(i)%heading, enters)
      place = partition_count(line) + 1
      partition_count(line) = place
      due(place, line) = due_time(k)
      middle(place, line) = middle_time(due_time(k), flight(i)%through)
      particle(place, line) = i
    end do
  end subroutine partition_events

  !> Puts the crossings of all lines into order: by time, at one time those of gate 1, of gate 2, of
  !> the periodic line, then by number. The first are those who crossed from the gates.
  pure subroutine sort_crossings(window, from_gate1, from_gate2)
    type(window_type), intent(inout) :: window
    !> How many crossed from each gate.
    integer, intent(in) :: from_gate1, from_gate2
    integer :: crossed, returned

    crossed = from_gate1 + from_gate2
    returned = window%partition_count(periodic_line)
    window%crossing_order(from_gate1 + 1:crossed) = crossing_order_of(2, &
      window%crossing_order(from_gate1 + 1:crossed))
    window%crossing_time(crossed + 1:crossed + returned) = window%due(:returned, periodic_line)
    window%crossing_order(crossed + 1:crossed + returned) = crossing_order_of(periodic_line, &
      window%particle(:returned, periodic_line))
    window%crossings = crossed + returned
    call sort_by_time(window%crossings, window%crossing_time, window%crossing_order)
  end subroutine sort_crossings

  !> A crossing in one number, which is read without a branch: nobody can guess which line is next.
  !> At one time the lesser number comes first. For gate 1 it is the particle's.
  elemental function crossing_order_of(line, particle) result(crossing_order)
    !> Gate 1 or 2, or `periodic_line`; who crosses.
    integer, intent(in) :: line, particle
    integer :: crossing_order

    crossing_order = shiftl(line - 1, particle_bits) + particle
  end function crossing_order_of

  !> The other way round: the line of a ticket.
  elemental function line_of_crossing(crossing_order) result(line)
    !> As `crossing_order_of` gives it.
    integer, intent(in) :: crossing_order
    integer :: line

    line = 1 + shiftr(crossing_order, particle_bits)
  end function line_of_crossing

  !> Who crosses which line, from which side.
  pure subroutine decode_crossing_order(number, flight, crossing_order, particle, urn, channel)
    !> Of all particles.
    integer, intent(in) :: number
    type(flight_type), intent(in) :: flight(number)
    !> As in `window_type`.
    integer, intent(in) :: crossing_order
    !> Who; the urn it comes from, and the channel.
    integer, intent(out) :: particle, urn, channel

    particle = ibits(crossing_order, 0, particle_bits)
    channel = merge(ungated, gated, line_of_crossing(crossing_order) == periodic_line)
    ! Whoever has crossed from a gate is told to be in its urn until it is sent on.
    urn = flight(particle)%urn
  end subroutine decode_crossing_order

  !> Tells a history of the crossings; there is room for them.
  pure subroutine record_crossings(window, number, flight, began, event_record)
    type(window_type), intent(in) :: window
    !> Of all particles.
    integer, intent(in) :: number
    type(flight_type), intent(in) :: flight(number)
    !> When the window began.
    real(wp), intent(in) :: began
    type(event_record_type), intent(inout) :: event_record
    integer :: k, particle, from, channel

    do k = 1, window%crossings
      call decode_crossing_order(number, flight, window%crossing_order(k), particle, from, channel)
      event_record%crossing_time(k) = window%crossing_time(k) - began
      event_record%crossing(k) = int(crossing_of(from, channel), int8)
    end do
    event_record%crossings = window%crossings
  end subroutine record_crossings

  !> Tells a history what happened, with the event log.
  subroutine record_logged_events(window, number, flight, began, events, due_time, who, &
    event_record)
    type(window_type), intent(in) :: window
    !> Of all particles, and of the events.
    integer, intent(in) :: number, events
    type(flight_type), intent(in) :: flight(number)
    !> When the window began.
    real(wp), intent(in) :: began
    !> As they were dealt out: when each is due,
    real(wp), intent(in) :: due_time(events)
    !> and whose it is.
    integer, intent(in) :: who(events)
    type(event_record_type), intent(inout) :: event_record
    integer :: k, next, urn, entered(2), reversed(2)

    next = 1
    entered = 0
    reversed = 0
    do k = 1, events
      ! Of the same instant, crossings of the middle line come first.
      do while (next <= window%crossings)
        if (window%crossing_time(next) > due_time(k)) exit
        if (window%crossing_time(next) >= due_time(k) &
          .and. line_of_crossing(window%crossing_order(next)) == periodic_line) exit
        call record_next_crossing()
      end do
      if (flight(who(k))%heading /= counted_in_gate) then
        call record_next_crossing()
        cycle
      end if
      urn = flight(who(k))%urn
      call record_event(event_record, due_time(k) - began, event_entry, urn, who(k))
      entered(urn) = entered(urn) + 1
      associate (stretch => window%stretch(urn))
        if (reversed(urn) == stretch%reversals) cycle
        if (stretch%last_entry(reversed(urn) + 1) > entered(urn)) cycle
        reversed(urn) = reversed(urn) + 1
        call record_reversal(event_record, due_time(k) - began, urn, &
          stretch%reversed(reversed(urn)))
      end associate
    end do
    do while (next <= window%crossings)
      call record_next_crossing()
    end do

  contains

    subroutine record_next_crossing()
      integer :: particle, from, channel

      call decode_crossing_order(number, flight, window%crossing_order(next), particle, from, &
        channel)
      call record_crossing(event_record, window%crossing_time(next) - began, &
        crossing_of(from, channel), particle)
      next = next + 1
    end subroutine record_next_crossing

  end subroutine record_logged_events

end module battery_batch_window

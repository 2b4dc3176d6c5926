!> A window with many events of the engine `excursion`, processed as arrays: partitioned by gate and
!> line, passed through each gate at once (`apply_rule_to_window`), crossings sorted afterwards.
module battery_batch_window
  use battery_kinds, only: wp, int8, int64
  use battery_table, only: channel1, channel2
  use battery_gate, only: gate_type, gate_window_type, crossing_list_type, reserve_gate_window, &
    apply_rule_to_window, number_inside
  use battery_ordering, only: sort_by_time
  use battery_calendar, only: calendar_type
  use battery_flight, only: flight_type, middle_time, never, to_gate, counted_in_gate
  use battery_visits, only: visits_type
  use battery_event_record, only: event_record_type, record_crossing, record_event, &
    record_reversal, crossing_of, event_entry
  implicit none (type, external)
  private
  public :: batch_window_type, run_batch_window

  !> Parts that events are assigned to: gate 1, gate 2, and the periodic line.
  integer, parameter :: periodic_line = 3

  !> Bits of a `crossing_order` that hold the particle: no plan has more than 2e8 particles.
  integer, parameter :: particle_bits = 28

  !> The events of a window by part. Arrays are longer than their counts.
  type :: batch_window_type
    !> Number of events of each part; as (event, part): time of each event, time at which its
    !> particle would reach the middle line, and the particle.
    integer :: partition_count(3) = 0
    real(wp), allocatable :: due(:, :), middle(:, :)
    integer, allocatable :: particle(:, :)
    !> For each gate, the entries of the window and the reversals that follow from them.
    type(gate_window_type) :: gate_window(2)
    !> Crossings of all lines; `order` encodes line and particle (`crossing_order_of`). The gates
    !> write the particle alone, which is that of the first line; `sort_crossings` adds the line to
    !> the others.
    type(crossing_list_type) :: crossings
  end type batch_window_type

contains

  !> Processes the first `events` sorted events and all middle-line crossings before `window_end`:
  !> partitions them by gate, applies the rule of each gate, sorts the crossings, and adds the
  !> visits that begin to the batch. The gates are independent within a window.
  subroutine run_batch_window(window, gate, urn_across, number, flight, calendar, events, &
    window_start, window_end, visits, event_record, computed_hits)
    !> Work space.
    type(batch_window_type), intent(inout) :: window
    type(gate_type), intent(inout) :: gate(2)
    !> Urn on the far side of a line, by the urn that a particle comes from; number of particles.
    integer, intent(in) :: urn_across(2), number
    type(flight_type), intent(inout) :: flight(number)
    type(calendar_type), intent(in) :: calendar
    !> Number of sorted events of the calendar that belong to the window.
    integer, intent(in) :: events
    !> Start and end of the window.
    real(wp), intent(in) :: window_start, window_end
    type(visits_type), intent(inout) :: visits
    type(event_record_type), intent(inout) :: event_record
    !> Wall hits of all visits; increased by hits on the end wall of a single urn.
    integer(int64), intent(inout) :: computed_hits
    integer :: urn, before, from_gate(2)

    call reserve_batch_window(window, events, number_inside(gate))
    associate (v => visits, w => window, due => calendar%due_time, particle => calendar%particle)
      call partition_events(number, flight, events, due, particle, size(w%crossings%order), &
        w%partition_count, w%due, w%middle, w%particle)
      do urn = 1, 2
        before = v%count
        call apply_rule_to_window(gate(urn), w%gate_window(urn), w%partition_count(urn), w%due(:, &
          urn), w%middle(:, urn), w%particle(:, urn), window_end, v, w%crossings)
        v%urn(before + 1:v%count) = urn
        v%channel(before + 1:v%count) = channel1
        from_gate(urn) = w%crossings%count - sum(from_gate(:urn - 1))
        if (urn_across(urn) == urn) computed_hits = computed_hits + from_gate(urn)
      end do
      call sort_crossings(w, from_gate(1), from_gate(2))
      if (event_record%logging) then
        call record_logged_events(w, number, flight, window_start, events, due, particle, &
          event_record)
      else
        event_record%reversals = w%gate_window%reversals
        event_record%bounce_backs = v%count
        event_record%crossings = w%crossings%count
        call record_crossings(w%crossings%count, w%crossings%time, w%crossings%order, number, &
          flight, window_start, event_record%crossing_time, event_record%crossing)
      end if
      before = v%count + 1
      v%count = v%count + w%crossings%count
      call add_crossing_visits(w%crossings%count, w%crossings%order, urn_across, number, flight, &
        v%particle(before:v%count), v%urn(before:v%count), v%channel(before:v%count), &
        v%reversal_time(before:v%count))
    end associate
  end subroutine run_batch_window

  !> Makes the arrays large enough for `events` events and `counted` particles in the gates; they
  !> never shrink.
  subroutine reserve_batch_window(window, events, counted)
    type(batch_window_type), intent(inout) :: window
    !> Events of the window.
    integer, intent(in) :: events
    !> Particles counted by gate 1 and by gate 2.
    integer, intent(in) :: counted(2)
    integer :: urn, capacity

    do urn = 1, 2
      call reserve_gate_window(window%gate_window(urn), events + counted(urn))
    end do
    window%crossings%count = 0
    capacity = events + sum(counted)
    if (allocated(window%crossings%order)) then
      if (size(window%crossings%order) >= capacity) return
      deallocate (window%due, window%middle, window%particle, window%crossings%time, &
        window%crossings%order)
    end if
    capacity = max(64, 2*capacity)
    allocate (window%due(capacity, 3), window%middle(capacity, 3), window%particle(capacity, 3), &
      window%crossings%time(capacity), window%crossings%order(capacity))
  end subroutine reserve_batch_window

  !> Assigns the due events to gates and line; particles that enter a gate are inside from now on.
  !> The loop has no branches: with many particles each flight is a cache miss, and many loads must
  !> be pending at a time.
  pure subroutine partition_events(number, flight, events, due_time, due_particle, capacity, &
    partition_count, due, middle, particle)
    !> Number of particles; number of events.
    integer, intent(in) :: number, events
    type(flight_type), intent(inout) :: flight(number)
    !> Time of each event, ascending.
    real(wp), intent(in) :: due_time(events)
    !> Particle of each event.
    integer, intent(in) :: due_particle(events)
    !> Leading extent of the arrays, which are explained at `batch_window_type`.
    integer, intent(in) :: capacity
    !> Number of events of each part.
    integer, intent(out) :: partition_count(3)
    !> Time of each event, and time at which its particle would reach the middle line.
    real(wp), intent(inout) :: due(capacity, 3), middle(capacity, 3)
    !> Particle of each event.
    integer, intent(inout) :: particle(capacity, 3)
    integer :: k, i, place, line
    logical :: enters

    partition_count = 0
    do k = 1, events
      i = due_particle(k)
      enters = flight(i)%next_event == to_gate
      line = merge(int(flight(i)%urn), periodic_line, enters)
      flight(i)%next_event = merge(counted_in_gate, flight(i)%next_event, enters)
      place = partition_count(line) + 1
      partition_count(line) = place
      due(place, line) = due_time(k)
      middle(place, line) = middle_time(due_time(k), flight(i)%through)
      particle(place, line) = i
    end do
  end subroutine partition_events

  !> Sorts the crossings of all lines: by time, at one time gate 1, gate 2, periodic line, then by
  !> particle. On entry those from the gates come first, gate 1 before gate 2.
  pure subroutine sort_crossings(window, from_gate1, from_gate2)
    type(batch_window_type), intent(inout) :: window
    !> Crossings of the middle line from each gate.
    integer, intent(in) :: from_gate1, from_gate2
    integer :: crossed, periodic

    crossed = from_gate1 + from_gate2
    periodic = window%partition_count(periodic_line)
    window%crossings%order(from_gate1 + 1:crossed) = crossing_order_of(2, &
      window%crossings%order(from_gate1 + 1:crossed))
    window%crossings%time(crossed + 1:crossed + periodic) = window%due(:periodic, periodic_line)
    window%crossings%order(crossed + 1:crossed + periodic) = crossing_order_of(periodic_line, &
      window%particle(:periodic, periodic_line))
    window%crossings%count = crossed + periodic
    call sort_by_time(window%crossings%count, window%crossings%time, window%crossings%order)
  end subroutine sort_crossings

  !> Encodes a crossing in one integer, which is decoded without a branch. At one time the lesser
  !> integer comes first. For gate 1 it is the particle itself.
  elemental function crossing_order_of(line, particle) result(crossing_order)
    !> Gate 1 or 2, or `periodic_line`; the particle that crosses.
    integer, intent(in) :: line, particle
    integer :: crossing_order

    crossing_order = shiftl(line - 1, particle_bits) + particle
  end function crossing_order_of

  !> Decodes the line of a crossing.
  elemental function line_of_crossing(crossing_order) result(line)
    !> As encoded by `crossing_order_of`.
    integer, intent(in) :: crossing_order
    integer :: line

    line = 1 + shiftr(crossing_order, particle_bits)
  end function line_of_crossing

  !> Decodes a crossing: its particle, the urn that it comes from, and the channel.
  pure subroutine decode_crossing_order(number, flight, crossing_order, particle, urn, channel)
    !> Number of particles, and their flights.
    integer, intent(in) :: number
    type(flight_type), intent(in) :: flight(number)
    !> As encoded by `crossing_order_of`.
    integer, intent(in) :: crossing_order
    !> Particle, urn it comes from (1 or 2), and channel.
    integer, intent(out) :: particle, urn, channel

    particle = ibits(crossing_order, 0, particle_bits)
    channel = merge(channel2, channel1, line_of_crossing(crossing_order) == periodic_line)
    ! A flight keeps the urn it left until the next flight is stored.
    urn = flight(particle)%urn
  end subroutine decode_crossing_order

  !> Lists times and kinds of the crossings in the format of an event record.
  pure subroutine record_crossings(crossings, crossing_time, crossing_order, number, flight, &
    window_start, recorded_time, recorded)
    !> Number of crossings.
    integer, intent(in) :: crossings
    !> As in `batch_window_type`.
    real(wp), intent(in) :: crossing_time(crossings)
    integer, intent(in) :: crossing_order(crossings)
    !> Number of particles, and their flights.
    integer, intent(in) :: number
    type(flight_type), intent(in) :: flight(number)
    !> Start of the window.
    real(wp), intent(in) :: window_start
    !> Of each crossing, as in `event_record_type`.
    real(wp), intent(out) :: recorded_time(crossings)
    integer(int8), intent(out) :: recorded(crossings)
    integer :: k, particle, from, channel

    do k = 1, crossings
      call decode_crossing_order(number, flight, crossing_order(k), particle, from, channel)
      recorded_time(k) = crossing_time(k) - window_start
      recorded(k) = int(crossing_of(from, channel), int8)
    end do
  end subroutine record_crossings

  !> Describes a visit, straight to the urn across the line, for each particle that has crossed one.
  pure subroutine add_crossing_visits(crossings, crossing_order, urn_across, number, flight, &
    particle, urn, channel, reversal_time)
    !> Number of crossings.
    integer, intent(in) :: crossings
    !> As in `batch_window_type`.
    integer, intent(in) :: crossing_order(crossings)
    !> Urn on the far side of a line, by the urn that a particle comes from; number of particles.
    integer, intent(in) :: urn_across(2), number
    type(flight_type), intent(in) :: flight(number)
    !> Of each visit, as in `visits_type`.
    integer, intent(out) :: particle(crossings), urn(crossings)
    integer(int64), intent(out) :: channel(crossings)
    real(wp), intent(out) :: reversal_time(crossings)
    integer :: k, from, crossed

    do k = 1, crossings
      call decode_crossing_order(number, flight, crossing_order(k), particle(k), from, crossed)
      urn(k) = urn_across(from)
      channel(k) = crossed
      reversal_time(k) = never
    end do
  end subroutine add_crossing_visits

  !> Writes all events of the window to the event record, with the event log.
  subroutine record_logged_events(window, number, flight, window_start, events, due_time, &
    due_particle, event_record)
    type(batch_window_type), intent(in) :: window
    !> Number of particles, number of events, and the flights.
    integer, intent(in) :: number, events
    type(flight_type), intent(in) :: flight(number)
    !> Start of the window.
    real(wp), intent(in) :: window_start
    !> Time of each event, as given to `partition_events`.
    real(wp), intent(in) :: due_time(events)
    !> Particle of each event.
    integer, intent(in) :: due_particle(events)
    type(event_record_type), intent(inout) :: event_record
    integer :: k, next, urn, entered(2), reversed(2)

    next = 1
    entered = 0
    reversed = 0
    do k = 1, events
      ! At one time, crossings of the middle line come before other events.
      do while (next <= window%crossings%count)
        if (window%crossings%time(next) > due_time(k)) exit
        if (window%crossings%time(next) >= due_time(k) &
          .and. line_of_crossing(window%crossings%order(next)) == periodic_line) exit
        call record_next_crossing()
      end do
      if (flight(due_particle(k))%next_event /= counted_in_gate) then
        call record_next_crossing()
        cycle
      end if
      urn = flight(due_particle(k))%urn
      call record_event(event_record, due_time(k) - window_start, event_entry, urn, due_particle(k))
      entered(urn) = entered(urn) + 1
      associate (gate_window => window%gate_window(urn))
        if (reversed(urn) == gate_window%reversals) cycle
        if (gate_window%last_entry(reversed(urn) + 1) > entered(urn)) cycle
        reversed(urn) = reversed(urn) + 1
        call record_reversal(event_record, due_time(k) - window_start, urn, &
          gate_window%reversed(reversed(urn)))
      end associate
    end do
    do while (next <= window%crossings%count)
      call record_next_crossing()
    end do

  contains

    !> Records the next of the sorted crossings.
    subroutine record_next_crossing()
      integer :: particle, from, channel

      call decode_crossing_order(number, flight, window%crossings%order(next), particle, from, &
        channel)
      call record_crossing(event_record, window%crossings%time(next) - window_start, &
        crossing_of(from, channel), particle)
      next = next + 1
    end subroutine record_next_crossing

  end subroutine record_logged_events

end module battery_batch_window

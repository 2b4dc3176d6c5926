!> A window with few events of the engine `excursion`, processed one by one: the arrays of
!> `battery_batch_window` would cost more than they save.
module battery_serial_window
  use battery_kinds, only: wp, int64
  use battery_table, only: channel1, channel2
  use battery_gate, only: gate_type, enter_gate, must_reverse, gate_crossed_first, uncount_first, &
    uncount_all, number_inside, counted_particle, next_crossing_time, first_crossing_time
  use battery_calendar, only: calendar_type
  use battery_flight, only: flight_type, middle_time, never, to_gate, counted_in_gate
  use battery_visits, only: visits_type
  use battery_event_record, only: event_record_type, record_crossing, record_event, &
    record_reversal, crossing_of, event_entry
  implicit none (type, external)
  private
  public :: run_serial_window

  !> Windows are processed one by one if their events and the particles that the gates count at
  !> their start are at most this many together: each counted particle is one more in a queue, which
  !> `run_batch_window` looks at only once.
  integer, parameter, public :: longest_serial_window = 20

contains

  !> Processes a window no longer than `longest_serial_window`, one event at a time;
  !> `run_batch_window` has the longer ones. Processes the first `events` events and all middle-line
  !> crossings before `window_end`; adds the visits that they begin.
  subroutine run_serial_window(gate, urn_across, flight, calendar, events, window_start, &
    window_end, visits, event_record, computed_hits)
    type(gate_type), intent(inout) :: gate(2)
    !> Urn on the far side of a line, by the urn that a particle comes from.
    integer, intent(in) :: urn_across(2)
    type(flight_type), intent(inout) :: flight(:)
    type(calendar_type), intent(in) :: calendar
    !> Number of sorted events of the calendar that belong to the window.
    integer, intent(in) :: events
    !> Start and end of the window.
    real(wp), intent(in) :: window_start, window_end
    type(visits_type), intent(inout) :: visits
    type(event_record_type), intent(inout) :: event_record
    !> Wall hits of all visits; increased by hits on the end wall of a single urn.
    integer(int64), intent(inout) :: computed_hits
    real(wp) :: now
    integer :: event, i, urn

    do event = 1, events
      i = calendar%particle(event)
      now = calendar%due_time(event)
      do while (first_crossing_time(gate) <= now)
        call cross_middle_line(gate, urn_across, window_start, visits, event_record, computed_hits)
      end do
      urn = flight(i)%urn
      if (flight(i)%next_event == to_gate) then
        flight(i)%next_event = counted_in_gate
        call enter_gate(gate(urn), middle_time(now, flight(i)%through), i)
        if (event_record%logging) call record_event(event_record, now - window_start, &
          event_entry, urn, i)
        if (must_reverse(gate(urn))) then
          if (.not. more_entries_follow(events, calendar, flight, event)) &
            call reverse_gate(gate(urn), urn, now, window_start, visits, event_record)
        end if
      else
        call record_crossing(event_record, now - window_start, crossing_of(urn, channel2), i)
        call add_visit(visits, i, urn_across(urn), channel2)
      end if
    end do
    do while (first_crossing_time(gate) < window_end)
      call cross_middle_line(gate, urn_across, window_start, visits, event_record, computed_hits)
    end do
  end subroutine run_serial_window

  !> Whether another particle enters the same gate at exactly the time of the event `event`.
  pure function more_entries_follow(events, calendar, flight, event) result(more)
    integer, intent(in) :: events, event
    type(calendar_type), intent(in) :: calendar
    type(flight_type), intent(in) :: flight(:)
    logical :: more
    integer :: later_event, i

    more = .false.
    do later_event = event + 1, events
      if (calendar%due_time(later_event) > calendar%due_time(event)) exit
      i = calendar%particle(later_event)
      more = flight(i)%next_event == to_gate &
        .and. flight(i)%urn == flight(calendar%particle(event))%urn
      if (more) exit
    end do
  end function more_entries_follow

  !> Reverses a gate: adds a visit, back to its urn, for every counted particle. The way out takes
  !> as long as the way in.
  subroutine reverse_gate(gate, urn, time, window_start, visits, event_record)
    type(gate_type), intent(inout) :: gate
    integer, intent(in) :: urn
    real(wp), intent(in) :: time, window_start
    type(visits_type), intent(inout) :: visits
    type(event_record_type), intent(inout) :: event_record
    integer :: k

    call record_reversal(event_record, time - window_start, urn, number_inside(gate))
    do k = 1, number_inside(gate)
      call add_visit(visits, counted_particle(gate, k), urn, channel1)
      visits%reversal_time(visits%count) = time
    end do
    call uncount_all(gate)
  end subroutine reverse_gate

  !> Processes the earliest pending crossing of the middle line (of a single urn: hit of the end
  !> wall), and adds the visit that follows.
  subroutine cross_middle_line(gate, urn_across, window_start, visits, event_record, computed_hits)
    type(gate_type), intent(inout) :: gate(2)
    integer, intent(in) :: urn_across(2)
    real(wp), intent(in) :: window_start
    type(visits_type), intent(inout) :: visits
    type(event_record_type), intent(inout) :: event_record
    integer(int64), intent(inout) :: computed_hits
    real(wp) :: time
    integer :: urn, i

    urn = gate_crossed_first(gate)
    time = next_crossing_time(gate(urn))
    call uncount_first(gate(urn), i)
    call record_crossing(event_record, time - window_start, crossing_of(urn, channel1), i)
    if (urn_across(urn) == urn) computed_hits = computed_hits + 1
    call add_visit(visits, i, urn_across(urn), channel1)
  end subroutine cross_middle_line

  !> Adds a visit to `urn`, straight through `channel`, to the batch.
  pure subroutine add_visit(visits, i, urn, channel)
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: i, urn, channel
    integer :: count

    count = visits%count + 1
    visits%count = count
    visits%particle(count) = i
    visits%urn(count) = urn
    visits%channel(count) = channel
    visits%reversal_time(count) = never
  end subroutine add_visit

end module battery_serial_window

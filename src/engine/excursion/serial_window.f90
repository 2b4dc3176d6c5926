!> A window of few events of the engine `excursion`, one after the other: then making lists of them,
!> as `battery_batch_window` does, costs more than it saves.
module battery_serial_window
  use battery_kinds, only: wp, int64
  use battery_table, only: gated, ungated
  use battery_gate, only: gate_type, enter_gate, must_reverse, gate_crossed_first, uncount_first, &
    uncount_all, number_inside, counted_particle, next_crossing_time, first_crossing_time
  use battery_calendar, only: calendar_type, flight_type
  use battery_flight, only: middle_time, never, to_gate, counted_in_gate
  use battery_visits, only: visits_type
  use battery_event_record, only: event_record_type, record_crossing, record_event, &
    record_reversal, crossing_of, event_entry
  implicit none (type, external)
  private
  public :: run_serial_window

  !> Windows of up to so many events are walked through so.
  integer, parameter, public :: longest_serial_window = 8

contains

  !> All events before `ends`, and the crossings of the middle line; adds the visits they begin.
  subroutine run_serial_window(gate, beyond, flight, calendar, events, began, ends, visits, &
    event_record, end_wall_hits)
    type(gate_type), intent(inout) :: gate(2)
    !> Where one is that has crossed a line from each side.
    integer, intent(in) :: beyond(2)
    type(flight_type), intent(inout) :: flight(:)
    type(calendar_type), intent(in) :: calendar
    !> So many of its sorted events.
    integer, intent(in) :: events
    !> The window.
    real(wp), intent(in) :: began, ends
    type(visits_type), intent(inout) :: visits
    type(event_record_type), intent(inout) :: event_record
    !> Grows by the hits of the end wall of a single urn.
    integer(int64), intent(inout) :: end_wall_hits
    real(wp) :: now
    integer :: at, i, urn

    do at = 1, events
      i = calendar%particle(at)
      now = calendar%due_time(at)
      do while (first_crossing_time(gate) <= now)
        call cross_middle_line(gate, beyond, began, visits, event_record, end_wall_hits)
      end do
      urn = flight(i)%urn
      if (flight(i)%heading == to_gate) then
        flight(i)%heading = counted_in_gate
        call enter_gate(gate(urn), middle_time(now, flight(i)%through), i)
        if (event_record%logging) call record_event(event_record, now - began, event_entry, urn, i)
        if (must_reverse(gate(urn))) then
          if (.not. more_enter_now(events, calendar, flight, at)) &
            call reverse_gate(gate(urn), urn, now, began, visits, event_record)
        end if
      else
        call record_crossing(event_record, now - began, crossing_of(urn, ungated), i)
        call add_visit(visits, i, beyond(urn), ungated)
      end if
    end do
    do while (first_crossing_time(gate) < ends)
      call cross_middle_line(gate, beyond, began, visits, event_record, end_wall_hits)
    end do
  end subroutine run_serial_window

  !> Whether another particle enters the same gate at the very same time as the event `at`.
  pure function more_enter_now(events, calendar, flight, at) result(more)
    integer, intent(in) :: events, at
    type(calendar_type), intent(in) :: calendar
    type(flight_type), intent(in) :: flight(:)
    logical :: more
    integer :: other, i

    more = .false.
    do other = at + 1, events
      if (calendar%due_time(other) > calendar%due_time(at)) exit
      i = calendar%particle(other)
      more = flight(i)%heading == to_gate .and. flight(i)%urn == flight(calendar%particle(at))%urn
      if (more) exit
    end do
  end function more_enter_now

  !> A gate reverses: all counted go back to their urn, as long as they have been in the channel.
  subroutine reverse_gate(gate, urn, time, began, visits, event_record)
    type(gate_type), intent(inout) :: gate
    integer, intent(in) :: urn
    real(wp), intent(in) :: time, began
    type(visits_type), intent(inout) :: visits
    type(event_record_type), intent(inout) :: event_record
    integer :: k

    call record_reversal(event_record, time - began, urn, number_inside(gate))
    do k = 1, number_inside(gate)
      call add_visit(visits, counted_particle(gate, k), urn, gated)
      visits%turned(visits%count) = time
    end do
    call uncount_all(gate)
  end subroutine reverse_gate

  !> The next particle of channel 1 crosses its middle line, or hits the end wall there.
  subroutine cross_middle_line(gate, beyond, began, visits, event_record, end_wall_hits)
    type(gate_type), intent(inout) :: gate(2)
    integer, intent(in) :: beyond(2)
    real(wp), intent(in) :: began
    type(visits_type), intent(inout) :: visits
    type(event_record_type), intent(inout) :: event_record
    integer(int64), intent(inout) :: end_wall_hits
    real(wp) :: time
    integer :: urn, i

    urn = gate_crossed_first(gate)
    time = next_crossing_time(gate(urn))
    call uncount_first(gate(urn), i)
    call record_crossing(event_record, time - began, crossing_of(urn, gated), i)
    if (beyond(urn) == urn) end_wall_hits = end_wall_hits + 1
    call add_visit(visits, i, beyond(urn), gated)
  end subroutine cross_middle_line

  !> Puts a particle into the batch: it goes straight to `urn` through `channel`.
  pure subroutine add_visit(visits, i, urn, channel)
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: i, urn, channel
    integer :: count

    count = visits%count + 1
    visits%count = count
    visits%particle(count) = i
    visits%urn(count) = urn
    visits%channel(count) = channel
    visits%turned(count) = never
  end subroutine add_visit

end module battery_serial_window

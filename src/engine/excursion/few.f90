!> A window of few events of the engine `excursion`, one after the other: then making lists of them,
!> as `battery_window` does, costs more than it saves.
module battery_few
  use battery_kinds, only: wp, int64
  use battery_table, only: gated, ungated
  use battery_gate, only: gate_type, enter, must_turn, first_to_cross, cross_first, turned_back
  use battery_calendar, only: flight_type
  use battery_flight, only: middle_time, never, to_gate, in_gate
  use battery_visits, only: visits_type
  use battery_history, only: history_type, record_crossing, record_event, record_reversal, &
    crossing_of, event_entry
  implicit none (type, external)
  private
  public :: walk_few

  !> Windows of up to so many events are walked through so.
  integer, parameter, public :: few = 8

contains

  !> All events before `ends`, and the crossings of the middle line; adds the visits they begin.
  subroutine walk_few(gate, beyond, number, flight, events, due_time, particle, began, ends, &
    visits, history, end_wall_hits)
    type(gate_type), intent(inout) :: gate(2)
    !> Where one is that has crossed a line from each side.
    integer, intent(in) :: beyond(2)
    !> How many particles and events there are.
    integer, intent(in) :: number, events
    type(flight_type), intent(inout) :: flight(number)
    !> Events in the order of time: when each is due,
    real(wp), intent(in) :: due_time(events)
    !> and whose it is.
    integer, intent(in) :: particle(events)
    !> The window.
    real(wp), intent(in) :: began, ends
    type(visits_type), intent(inout) :: visits
    type(history_type), intent(inout) :: history
    !> Grows by the hits of the end wall of a single urn.
    integer(int64), intent(inout) :: end_wall_hits
    integer :: at, i, urn

    do at = 1, events
      i = particle(at)
      do while (min(gate(1)%counted%next, gate(2)%counted%next) <= due_time(at))
        call cross_middle(gate, beyond, began, visits, history, end_wall_hits)
      end do
      urn = flight(i)%urn
      if (flight(i)%heading == to_gate) then
        flight(i)%heading = in_gate
        call enter(gate(urn), middle_time(due_time(at), flight(i)%through), i)
        if (history%logging) call record_event(history, due_time(at) - began, event_entry, urn, i)
        if (must_turn(gate(urn))) then
          if (.not. more_enter_now(events, due_time, particle, number, flight, at)) &
            call reverse(gate(urn), urn, due_time(at), began, visits, history)
        end if
      else
        call record_crossing(history, due_time(at) - began, crossing_of(urn, ungated), i)
        call send(visits, i, beyond(urn), ungated)
      end if
    end do
    do while (min(gate(1)%counted%next, gate(2)%counted%next) < ends)
      call cross_middle(gate, beyond, began, visits, history, end_wall_hits)
    end do
  end subroutine walk_few

  !> Whether another particle enters the same gate at the very same time as the event `at`.
  pure function more_enter_now(events, due_time, particle, number, flight, at) result(more)
    integer, intent(in) :: events, particle(events), number, at
    real(wp), intent(in) :: due_time(events)
    type(flight_type), intent(in) :: flight(number)
    logical :: more
    integer :: other, i

    more = .false.
    do other = at + 1, events
      if (due_time(other) > due_time(at)) exit
      i = particle(other)
      more = flight(i)%heading == to_gate .and. flight(i)%urn == flight(particle(at))%urn
      if (more) exit
    end do
  end function more_enter_now

  !> A gate reverses: all counted go back to their urn, as long as they have been in the channel.
  subroutine reverse(gate, urn, time, began, visits, history)
    type(gate_type), intent(inout) :: gate
    integer, intent(in) :: urn
    real(wp), intent(in) :: time, began
    type(visits_type), intent(inout) :: visits
    type(history_type), intent(inout) :: history
    integer :: k

    call record_reversal(history, time - began, urn, gate%counted%count)
    do k = 1, gate%counted%count
      call send(visits, gate%counted%who(k), urn, gated)
      visits%turned(visits%count) = time
    end do
    call turned_back(gate)
  end subroutine reverse

  !> The next particle of channel 1 crosses its middle line, or hits the end wall there.
  subroutine cross_middle(gate, beyond, began, visits, history, end_wall_hits)
    type(gate_type), intent(inout) :: gate(2)
    integer, intent(in) :: beyond(2)
    real(wp), intent(in) :: began
    type(visits_type), intent(inout) :: visits
    type(history_type), intent(inout) :: history
    integer(int64), intent(inout) :: end_wall_hits
    real(wp) :: time
    integer :: urn, i

    urn = first_to_cross(gate)
    time = gate(urn)%counted%next
    call cross_first(gate(urn), i)
    call record_crossing(history, time - began, crossing_of(urn, gated), i)
    if (beyond(urn) == urn) end_wall_hits = end_wall_hits + 1
    call send(visits, i, beyond(urn), gated)
  end subroutine cross_middle

  !> Puts a particle into the batch: it goes straight to `urn` through `channel`.
  pure subroutine send(visits, i, urn, channel)
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: i, urn, channel
    integer :: count

    count = visits%count + 1
    visits%count = count
    visits%particle(count) = i
    visits%urn(count) = urn
    visits%channel(count) = channel
    visits%turned(count) = never
  end subroutine send

end module battery_few

!> The initial state of a particle of the engine `excursion`: its position and velocity become a
!> flight, or a visit that ends in one.
module battery_initial_flight
  use, intrinsic :: iso_c_binding, only: c_loc, c_size_t
  use battery_kinds, only: wp, int16, int64
  use battery_table, only: table_type, passage_type, passage_at, gated, no_channel
  use battery_calendar, only: flight_type, idle_flight
  use battery_memory, only: prefer_large_pages
  use battery_flight, only: to_return, counted_in_gate, parked_in_channel, partial_visit, never
  use battery_urn, only: first_impact
  use battery_visits, only: visits_type
  implicit none (type, external)
  private
  public :: make_initial_flight, allocate_flights, date_back_flight

contains

  !> Allocates the flights, in large memory pages: before they are written to.
  subroutine allocate_flights(flight, number)
    type(flight_type), allocatable, target, intent(out) :: flight(:)
    !> Number of particles.
    integer, intent(in) :: number

    allocate (flight(number))
    call prefer_large_pages(c_loc(flight), int(number, c_size_t)*storage_size(flight)/8)
    flight = idle_flight
  end subroutine allocate_flights

  !> Loads particle `i` at (x, y) with velocity (ux, uy) in the frame of the table. If it is in a
  !> channel and heads for the far end, its flight is dated back to the entrance of the channel, and
  !> `hits` is reduced by the wall hits that it did not have. If it is in an urn, or on its way back
  !> to one, a visit is added. Each call takes either particles in channels or particles in urns,
  !> and ignores the others.
  subroutine make_initial_flight(table, i, x, y, ux, uy, from_channels, flight, visits, hits)
    type(table_type), intent(in) :: table
    integer, intent(in) :: i
    !> Position, a length, and velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> Whether particles in channels are taken; else those in urns.
    logical, intent(in) :: from_channels
    type(flight_type), intent(inout) :: flight
    !> Visits to the urn of its side.
    type(visits_type), intent(inout) :: visits
    integer(int64), intent(inout) :: hits
    type(passage_type) :: passage

    passage = passage_at(table, x, y, ux, uy)
    if (from_channels .eqv. passage%channel == no_channel) return
    if (from_channels) flight%urn = int(passage%urn, int16)
    if (passage%endless) then
      flight%next_event = parked_in_channel
      flight%y = y
      flight%u_axial = abs(ux)
      flight%u_lateral = uy
    else if (passage%inward) then
      flight%next_event = merge(counted_in_gate, to_return, passage%channel == gated)
      flight%time = passage%time
      flight%y = passage%height
      flight%u_axial = abs(ux)
      flight%through = table%channel(passage%channel)%length/abs(ux)
      flight%u_lateral = passage%reflected*uy
      hits = hits - int(passage%hits, int64)
    else
      associate (urn => table%urn(passage%urn), at => visits%count + 1)
        visits%particle(at) = i
        visits%urn(at) = passage%urn
        visits%time(at) = 0.0_wp
        visits%turned(at) = never
        visits%y(at) = y
        visits%u_lateral(at) = uy
        ! In an urn: in the frame of the urn. In a channel: as `cross_channels` expects it.
        visits%hits(at) = 0.0_wp
        visits%x(at) = urn%centre - abs(x)
        visits%passage(at) = passage%time
        visits%u_axial(at) = merge(abs(ux), urn%axis_sign*ux, from_channels)
        if (from_channels) visits%channel(at) = passage%channel
        visits%count = at
      end associate
    end if
  end subroutine make_initial_flight

  !> Flight of a particle before its first visit, which `make_initial_flight` has added: it has just
  !> entered the channel where it was, or is about to have its first impact in the urn. That is the
  !> stored start of a long visit.
  subroutine date_back_flight(table, x, y, ux, uy, flight, hits)
    type(table_type), intent(in) :: table
    !> Its initial position, a length, and velocity, of length 1, in the frame of the table.
    real(wp), intent(in) :: x, y, ux, uy
    type(flight_type), intent(inout) :: flight
    !> Wall hits of the visit; out: from the first impact on, if it was in an urn.
    real(wp), intent(inout) :: hits
    type(passage_type) :: passage
    integer(int64) :: before

    passage = passage_at(table, x, y, ux, uy)
    if (passage%channel == no_channel) then
      associate (urn => table%urn(passage%urn))
        call first_impact(urn, urn%centre - abs(x), y, urn%axis_sign*ux, uy, flight%y, &
          flight%u_axial, flight%u_lateral, flight%time, before)
      end associate
      flight%next_event = partial_visit
      hits = hits - real(before, wp)
    else
      flight%next_event = merge(counted_in_gate, to_return, passage%channel == gated)
      flight%time = 0.0_wp
      flight%y = y
      flight%u_axial = abs(ux)
      flight%u_lateral = uy
      flight%through = passage%time
    end if
  end subroutine date_back_flight

end module battery_initial_flight

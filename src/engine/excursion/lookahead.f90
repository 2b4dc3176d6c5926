!> Visits that the engine `excursion` computes before they begin.
!>
!> With few particles or tiny openings a window has one visit, too few to fill the vector lanes. A
!> particle that is not turned back in its channel meets no other, so its visit follows from its
!> flight. The visits of the next events are therefore computed together, as if no gate reversed;
!> the visit of a particle that a gate does turn back is computed again.
module battery_lookahead
  use battery_kinds, only: wp, int32, int64
  use battery_calendar, only: flight_type
  use battery_channel, only: gated, ungated
  use battery_chamber, only: cross_channels
  use battery_flight, only: load_flights, never, to_gate
  use battery_urn, only: urn_type, compute_visits
  use battery_visits, only: visits_type, reserve_visits
  implicit none (type, external)
  private
  public :: lookahead_pays, take_computed_visits

  !> Visits computed ahead in one batch, besides those that begin now.
  integer, parameter :: most_lookahead_visits = 16
  !> Lookahead pays where a window has fewer events than this on average.
  real(wp), parameter :: most_events = 0.5_wp

contains

  !> Whether it pays to compute visits ahead.
  pure function lookahead_pays(events, threshold)
    !> Mean number of events in a window.
    real(wp), intent(in) :: events
    !> Thresholds of both gates: a gate of threshold 0 turns all particles back.
    integer, intent(in) :: threshold(2)
    logical :: lookahead_pays

    lookahead_pays = events < most_events .and. all(threshold > 0)
  end function lookahead_pays

  !> Fills in the visits that begin: copies those that were computed ahead, else computes them
  !> together with those of the next events.
  subroutine take_computed_visits(urn, number, flight, coming, next, visits, ahead, computed_hits)
    type(urn_type), intent(in) :: urn
    !> Number of particles; number of pending events in order.
    integer, intent(in) :: number, coming
    type(flight_type), intent(inout) :: flight(number)
    !> Their particles.
    integer, intent(in) :: next(coming)
    !> In: particle, channel and time of reversal, as `run_serial_window` leaves them. Out: as
    !> `compute_visits` leaves them.
    type(visits_type), intent(inout) :: visits
    !> Visits computed ahead.
    type(visits_type), intent(inout) :: ahead
    !> Increased by the wall hits of the visits.
    integer(int64), intent(inout) :: computed_hits
    integer :: j, at

    do j = 1, visits%count
      if (visits%turned(j) < never .or. .not. is_computed(visits%particle(j))) then
        call compute_lookahead_visits(urn, number, flight, coming, next, visits, ahead)
        exit
      end if
    end do
    do j = 1, visits%count
      at = flight(visits%particle(j))%lookahead_slot
      flight(visits%particle(j))%lookahead_slot = 0
      visits%channel(j) = ahead%channel(at)
      visits%time(j) = ahead%time(at)
      visits%length(j) = ahead%length(at)
      visits%y(j) = ahead%y(at)
      visits%u_axial(j) = ahead%u_axial(at)
      visits%u_lateral(j) = ahead%u_lateral(at)
      visits%through(j) = ahead%through(at)
      visits%hits(j) = ahead%hits(at)
      visits%many(j) = j
      computed_hits = computed_hits + int(ahead%hits(at), int64)
    end do
    visits%many_count = visits%count

  contains

    !> The flight holds the slot of its visit among those computed ahead; the slot may have been
    !> reused since.
    pure function is_computed(i)
      integer, intent(in) :: i
      logical :: is_computed

      is_computed = flight(i)%lookahead_slot > 0 .and. flight(i)%lookahead_slot <= ahead%count
      if (is_computed) is_computed = ahead%particle(flight(i)%lookahead_slot) == i
    end function is_computed

  end subroutine take_computed_visits

  !> Computes the visits that begin, and those that will begin if no gate turns the next particles
  !> back.
  subroutine compute_lookahead_visits(urn, number, flight, coming, next, visits, ahead)
    type(urn_type), intent(in) :: urn
    integer, intent(in) :: number, coming, next(coming)
    type(flight_type), intent(inout) :: flight(number)
    type(visits_type), intent(in) :: visits
    type(visits_type), intent(inout) :: ahead
    integer :: n, k

    n = visits%count
    call reserve_visits(ahead, n + most_lookahead_visits)
    ahead%particle(:n) = visits%particle(:n)
    ahead%channel(:n) = visits%channel(:n)
    ahead%turned(:n) = visits%turned(:n)
    do k = 1, min(coming, most_lookahead_visits)
      ahead%particle(n + k) = next(k)
      ahead%channel(n + k) = merge(gated, ungated, flight(next(k))%next_event == to_gate)
      ahead%turned(n + k) = never
    end do
    n = n + min(coming, most_lookahead_visits)
    ahead%count = n
    do k = 1, n
      flight(ahead%particle(k))%lookahead_slot = int(k, int32)
    end do
    call load_flights(number, flight, n, ahead%particle, ahead%turned, ahead%passage, ahead%time, &
      ahead%y, ahead%u_axial, ahead%u_lateral)
    call cross_channels(urn, ahead)
    call compute_visits(urn, ahead)
  end subroutine compute_lookahead_visits

end module battery_lookahead

!> Visits that the engine `excursion` computes before they begin.
!>
!> With few particles, or tiny openings, a window has one visit, which would have to wait for itself
!> all the way. But who goes straight through its channel meets nobody: its visit follows from its
!> flight. So those of the next events are computed together, as if no gate were to turn; of those
!> that a gate does turn back the visit is computed again.
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

  !> So many visits are computed at a time at most, but for those that begin.
  integer, parameter :: most_lookahead_visits = 16
  !> Windows have less than so many events on average where looking ahead pays.
  real(wp), parameter :: most_events = 0.5_wp

contains

  !> Whether it pays to look ahead.
  pure function lookahead_pays(events, threshold)
    !> How many events a window has on average.
    real(wp), intent(in) :: events
    !> Of both gates: one that turns everybody leaves nothing to be foreseen.
    integer, intent(in) :: threshold(2)
    logical :: lookahead_pays

    lookahead_pays = events < most_events .and. all(threshold > 0)
  end function lookahead_pays

  !> Visits that begin: those foreseen, or computed now, with those that will begin next.
  subroutine take_computed_visits(urn, number, flight, coming, next, visits, ahead, computed_hits)
    type(urn_type), intent(in) :: urn
    !> How many particles there are, and how many events come next.
    integer, intent(in) :: number, coming
    type(flight_type), intent(inout) :: flight(number)
    !> Whose the next events are.
    integer, intent(in) :: next(coming)
    !> In: who, where to and when turned back, as `run_serial_window` leaves it. Out: as out of
    !> `compute_visits`.
    type(visits_type), intent(inout) :: visits
    !> Those foreseen.
    type(visits_type), intent(inout) :: ahead
    !> Grows by the wall hits of the visits.
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

    !> Whoever was foreseen says where; that may have been overwritten.
    pure function is_computed(i)
      integer, intent(in) :: i
      logical :: is_computed

      is_computed = flight(i)%lookahead_slot > 0 .and. flight(i)%lookahead_slot <= ahead%count
      if (is_computed) is_computed = ahead%particle(flight(i)%lookahead_slot) == i
    end function is_computed

  end subroutine take_computed_visits

  !> Computes the visits that begin, and those that will begin if the next go straight.
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
      ahead%channel(n + k) = merge(gated, ungated, flight(next(k))%heading == to_gate)
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

!> Visits that the engine `excursion` computes before they begin.
!>
!> With few particles, or tiny openings, a window has one visit, which would have to wait for itself
!> all the way. But who goes straight through its channel meets nobody: its visit follows from its
!> flight. So those of the next events are computed together, as if no gate were to turn; of those
!> that a gate does turn back the visit is computed again.
module battery_foresight
  use battery_kinds, only: wp, int32, int64
  use battery_calendar, only: flight_type
  use battery_channel, only: gated, ungated
  use battery_chamber, only: leave_channels
  use battery_flight, only: gather, never, to_gate
  use battery_urn, only: urn_type, cross
  use battery_visits, only: visits_type, reserve_visits
  implicit none (type, external)
  private
  public :: pays, recall

  !> So many visits are computed at a time at most, but for those that begin.
  integer, parameter :: farthest = 16
  !> Windows have less than so many events on average where looking ahead pays.
  real(wp), parameter :: most_events = 0.5_wp

contains

  !> Whether it pays to look ahead.
  pure function pays(events, threshold)
    !> How many events a window has on average.
    real(wp), intent(in) :: events
    !> Of both gates: one that turns everybody leaves nothing to be foreseen.
    integer, intent(in) :: threshold(2)
    logical :: pays

    pays = events < most_events .and. all(threshold > 0)
  end function pays

  !> Visits that begin: those foreseen, or computed now, with those that will begin next.
  subroutine recall(urn, number, flight, coming, next, visits, ahead, known_hits)
    type(urn_type), intent(in) :: urn
    !> How many particles there are, and how many events come next.
    integer, intent(in) :: number, coming
    type(flight_type), intent(inout) :: flight(number)
    !> Whose the next events are.
    integer, intent(in) :: next(coming)
    !> In: who, where to and when turned back, as `walk_few` leaves it. Out: as out of `cross`.
    type(visits_type), intent(inout) :: visits
    !> Those foreseen.
    type(visits_type), intent(inout) :: ahead
    !> Grows by the wall hits of the visits.
    integer(int64), intent(inout) :: known_hits
    integer :: j, at

    do j = 1, visits%count
      if (visits%turned(j) < never .or. .not. is_foreseen(visits%particle(j))) then
        call foresee(urn, number, flight, coming, next, visits, ahead)
        exit
      end if
    end do
    do j = 1, visits%count
      at = flight(visits%particle(j))%foreseen
      flight(visits%particle(j))%foreseen = 0
      visits%channel(j) = ahead%channel(at)
      visits%time(j) = ahead%time(at)
      visits%length(j) = ahead%length(at)
      visits%y(j) = ahead%y(at)
      visits%along(j) = ahead%along(at)
      visits%across(j) = ahead%across(at)
      visits%through(j) = ahead%through(at)
      visits%hits(j) = ahead%hits(at)
      visits%many(j) = j
      known_hits = known_hits + int(ahead%hits(at), int64)
    end do
    visits%many_count = visits%count

  contains

    !> Whoever was foreseen says where; that may have been overwritten.
    pure function is_foreseen(i)
      integer, intent(in) :: i
      logical :: is_foreseen

      is_foreseen = flight(i)%foreseen > 0 .and. flight(i)%foreseen <= ahead%count
      if (is_foreseen) is_foreseen = ahead%particle(flight(i)%foreseen) == i
    end function is_foreseen

  end subroutine recall

  !> Computes the visits that begin, and those that will begin if the next go straight.
  subroutine foresee(urn, number, flight, coming, next, visits, ahead)
    type(urn_type), intent(in) :: urn
    integer, intent(in) :: number, coming, next(coming)
    type(flight_type), intent(inout) :: flight(number)
    type(visits_type), intent(in) :: visits
    type(visits_type), intent(inout) :: ahead
    integer :: n, k

    n = visits%count
    call reserve_visits(ahead, n + farthest)
    ahead%particle(:n) = visits%particle(:n)
    ahead%channel(:n) = visits%channel(:n)
    ahead%turned(:n) = visits%turned(:n)
    do k = 1, min(coming, farthest)
      ahead%particle(n + k) = next(k)
      ahead%channel(n + k) = merge(gated, ungated, flight(next(k))%heading == to_gate)
      ahead%turned(n + k) = never
    end do
    n = n + min(coming, farthest)
    ahead%count = n
    do k = 1, n
      flight(ahead%particle(k))%foreseen = int(k, int32)
    end do
    call gather(number, flight, n, ahead%particle, ahead%turned, ahead%passage, ahead%time, &
      ahead%y, ahead%along, ahead%across)
    call leave_channels(urn, ahead)
    call cross(urn, ahead)
  end subroutine foresee

end module battery_foresight

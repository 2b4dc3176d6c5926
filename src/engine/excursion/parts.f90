!> Visits that the engine `excursion` knows in part.
!>
!> Some visits have so many wall hits that they are not computed in one go (`goes_on`). Such a
!> particle has an event of its own, at which the next part is computed. It is due half the part
!> before its end: so what comes after that end is no sooner than the lookahead.
module battery_parts
  use battery_kinds, only: wp, int64
  use battery_calendar, only: flight_type
  use battery_flight, only: in_parts, never
  use battery_long_visits, only: long_visits_type, keep_beginnings, land
  use battery_urn, only: urn_type, cross, place_in_visit
  use battery_visits, only: visits_type, reserve_visits, goes_on
  implicit none (type, external)
  private
  public :: set_apart, compute_parts

contains

  !> Takes those who only go on with a visit out of the events that are due.
  subroutine set_apart(number, flight, due_time, particle, events, others, other_time, other)
    !> How many particles there are.
    integer, intent(in) :: number
    type(flight_type), intent(in) :: flight(number)
    !> Events in the order of time: when each is due.
    real(wp), intent(inout) :: due_time(:)
    !> Whose they are, and how many: before, and after.
    integer, intent(inout) :: particle(:), events
    !> How many were taken out.
    integer, intent(out) :: others
    !> When these are due.
    real(wp), allocatable, intent(out) :: other_time(:)
    !> Whose they are.
    integer, allocatable, intent(out) :: other(:)
    logical :: apart(events)

    apart = flight(particle(:events))%heading == in_parts
    others = count(apart)
    other_time = pack(due_time(:events), apart)
    other = pack(particle(:events), apart)
    events = events - others
    due_time(:events) = pack(due_time(:events + others), .not. apart)
    particle(:events) = pack(particle(:events + others), .not. apart)
  end subroutine set_apart

  !> The next parts of visits to one of the urns; they count from when they were due.
  subroutine compute_parts(urn, side, number, flight, others, other_time, other, visits, &
    long_visits, known_hits)
    type(urn_type), intent(in) :: urn
    !> 1 or 2.
    integer, intent(in) :: side, number
    type(flight_type), intent(inout) :: flight(number)
    !> As `set_apart` gives them, for both urns.
    integer, intent(in) :: others, other(others)
    !> When they are due.
    real(wp), intent(in) :: other_time(others)
    !> Out: those of this urn, and when each has its next event.
    type(visits_type), intent(inout) :: visits
    !> Learns how each part begins.
    type(long_visits_type), intent(inout) :: long_visits
    !> Grows by the wall hits of the parts.
    integer(int64), intent(inout) :: known_hits
    real(wp) :: position(2), velocity(2), rest(others)
    integer(int64) :: hits
    integer :: k, j

    call reserve_visits(visits, others)
    do k = 1, others
      associate (flown => flight(other(k)))
        if (flown%urn /= side) cycle
        j = visits%count + 1
        visits%count = j
        call place_in_visit(urn, int(goes_on), flown%y, flown%along, flown%across, 0.0_wp, &
          position, velocity, hits)
        visits%particle(j) = other(k)
        visits%urn(j) = side
        visits%time(j) = other_time(k)
        visits%x(j) = position(1)
        visits%y(j) = position(2)
        visits%along(j) = velocity(1)
        visits%across(j) = velocity(2)
        visits%hits(j) = 0.0_wp
        visits%turned(j) = never
        rest(j) = flown%time - other_time(k)
      end associate
    end do
    associate (v => visits, n => visits%count)
      if (n == 0) return
      call cross(urn, v)
      known_hits = known_hits + v%all_hits
      v%length(:n) = v%length(:n) + rest(:n)
      v%many_count = n
      v%many(:n) = [(k, k=1, n)]
      call keep_beginnings(long_visits, number, flight, v)
      call land(number, flight, n, v%particle, v%urn, v%channel, v%time, v%length, v%y, v%along, &
        v%across, v%through)
    end associate
  end subroutine compute_parts

end module battery_parts

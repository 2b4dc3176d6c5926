!> Visits that the engine `excursion` computes in parts.
!>
!> A visit with very many wall hits is truncated (`truncated` of `battery_visits`). Its particle
!> then has an event at which the next part is computed, due half a part before the end of the part.
!> Half a part is at least the lookahead: so when that event is processed, the particle has no other
!> event within the lookahead.
module battery_partial_visits
  use battery_kinds, only: wp, int64
  use battery_flight, only: flight_type, partial_visit, never, store_flights
  use battery_long_visits, only: long_visits_type, store_visit_starts
  use battery_passage_starts, only: store_passage_starts
  use battery_urn, only: urn_type, compute_passages, locate_in_passage
  use battery_visits, only: visits_type, reserve_visits, truncated
  implicit none (type, external)
  private
  public :: split_off_partial_visits, compute_partial_visits

contains

  !> Removes the events at which the next part of a truncated visit is computed from those that are
  !> due.
  subroutine split_off_partial_visits(number, flight, due_time, particle, events, resumed_count, &
    resumed_time, resumed)
    !> Number of particles.
    integer, intent(in) :: number
    type(flight_type), intent(in) :: flight(number)
    !> Times of the events, ascending.
    real(wp), intent(inout) :: due_time(:)
    !> Particles of the events; number of events, before and after.
    integer, intent(inout) :: particle(:), events
    !> Number of events removed.
    integer, intent(out) :: resumed_count
    !> Times of the events removed.
    real(wp), allocatable, intent(out) :: resumed_time(:)
    !> Particles of the events removed.
    integer, allocatable, intent(out) :: resumed(:)
    logical :: apart(events)

    apart = flight(particle(:events))%next_event == partial_visit
    resumed_count = count(apart)
    resumed_time = pack(due_time(:events), apart)
    resumed = pack(particle(:events), apart)
    events = events - resumed_count
    due_time(:events) = pack(due_time(:events + resumed_count), .not. apart)
    particle(:events) = pack(particle(:events + resumed_count), .not. apart)
  end subroutine split_off_partial_visits

  !> Computes the next part of each visit to one urn, from the time at which it is due.
  subroutine compute_partial_visits(urn, urn_index, number, flight, resumed_count, resumed_time, &
    resumed, visits, long_visits, passage_starts, computed_hits)
    type(urn_type), intent(in) :: urn
    !> The urn, 1 or 2; number of particles.
    integer, intent(in) :: urn_index, number
    type(flight_type), intent(inout) :: flight(number)
    !> Particles of both urns, from `split_off_partial_visits`.
    integer, intent(in) :: resumed_count, resumed(resumed_count)
    !> When each is due.
    real(wp), intent(in) :: resumed_time(resumed_count)
    !> Out: the visits of this urn, with the time of the next event of each particle.
    type(visits_type), intent(inout) :: visits
    !> Updated with the start of each part.
    type(long_visits_type), intent(inout) :: long_visits
    !> Updated with the start of each part, at which its passage is computed.
    real(wp), intent(inout) :: passage_starts(:, :)
    !> Increased by the wall hits of the parts.
    integer(int64), intent(inout) :: computed_hits
    real(wp) :: position(2), velocity(2), rest(resumed_count)
    integer(int64) :: hits
    integer :: k, j

    call reserve_visits(visits, resumed_count)
    do k = 1, resumed_count
      associate (flown => flight(resumed(k)))
        if (flown%urn /= urn_index) cycle
        j = visits%count + 1
        visits%count = j
        call locate_in_passage(urn, int(truncated), flown%y, flown%u_axial, flown%u_lateral, &
          0.0_wp, position, velocity, hits)
        visits%particle(j) = resumed(k)
        visits%urn(j) = urn_index
        visits%time(j) = resumed_time(k)
        visits%x(j) = position(1)
        visits%y(j) = position(2)
        visits%u_axial(j) = velocity(1)
        visits%u_lateral(j) = velocity(2)
        visits%hits(j) = 0.0_wp
        visits%reversal_time(j) = never
        rest(j) = flown%time - resumed_time(k)
      end associate
    end do
    associate (v => visits, n => visits%count)
      if (n == 0) return
      v%time(:n) = v%time(:n) + rest(:n)
      call store_passage_starts(passage_starts, v, n)
      v%time(:n) = v%time(:n) - rest(:n)
      call compute_passages(urn, v)
      computed_hits = computed_hits + v%all_hits
      v%length(:n) = v%length(:n) + rest(:n)
      v%many_hits_count = n
      v%many_hits_index(:n) = [(k, k=1, n)]
      call store_visit_starts(long_visits, number, flight, v)
      call store_flights(number, flight, n, v%particle, v%urn, v%channel, v%time, v%length, v%y, &
        v%u_axial, v%u_lateral, v%through)
    end associate
  end subroutine compute_partial_visits

end module battery_partial_visits

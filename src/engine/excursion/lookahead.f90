!> Visits that the engine `excursion` computes before they begin.
!>
!> With few particles or tiny openings a window has one visit, too few to fill the vector lanes. A
!> particle that is not turned back in its channel interacts with no other, so its visit follows
!> from its flight. Together with a visit that begins, the visits after the next pending events are
!> therefore computed too, as if no gate reversed. (The module is named after this; the *lookahead*
!> of the maintainer's guide is a time.) Visits computed ahead are stored until they begin; the
!> visit of a particle that a gate does turn back is computed again.
module battery_lookahead
  use battery_kinds, only: wp, int32, int64
  use battery_calendar, only: flight_type
  use battery_channel, only: gated, ungated
  use battery_chamber, only: cross_channels
  use battery_flight, only: load_flights, never, partial_visit, to_gate
  use battery_urn, only: urn_type, compute_visits
  use battery_visits, only: visits_type
  implicit none (type, external)
  private
  public :: lookahead_type, lookahead_pays, compute_with_lookahead

  !> Largest number of visits computed ahead in one batch, besides those that begin now.
  integer, parameter, public :: most_lookahead_visits = 16
  !> Number of visits computed ahead that are stored.
  integer, parameter :: slots = 64
  !> Computing ahead pays where a window has fewer events than this on average.
  real(wp), parameter :: most_events = 1.0_wp

  !> A visit computed ahead: its particle, and what `compute_visits` yields of it.
  type :: computed_visit_type
    integer :: particle = 0
    integer(int64) :: channel = 0
    real(wp) :: time = 0.0_wp, length = 0.0_wp, y = 0.0_wp, u_axial = 0.0_wp, u_lateral = 0.0_wp, &
      through = 0.0_wp, hits = 0.0_wp
  end type computed_visit_type

  !> Visits computed ahead: a new one takes the place of the oldest.
  type :: lookahead_type
    private
    type(computed_visit_type) :: visit(slots)
    !> Slot written last.
    integer :: last = 0
  end type lookahead_type

contains

  !> Whether it pays to compute visits ahead.
  pure function lookahead_pays(number, events, threshold)
    !> Number of particles: one alone has no visit to be computed with another.
    integer, intent(in) :: number
    !> Mean number of events in a window.
    real(wp), intent(in) :: events
    !> Thresholds of both gates: a gate of threshold 0 turns all particles back.
    integer, intent(in) :: threshold(2)
    logical :: lookahead_pays

    lookahead_pays = number > 1 .and. events < most_events .and. all(threshold > 0)
  end function lookahead_pays

  !> Copies the visits that begin from those computed ahead, if all of them were. Else computes
  !> them, together with the visits of the next events, which are stored.
  subroutine compute_with_lookahead(urn, number, flight, coming, next, visits, ahead, computed_hits)
    type(urn_type), intent(in) :: urn
    !> Number of particles; number of pending events in order.
    integer, intent(in) :: number, coming
    type(flight_type), intent(inout) :: flight(number)
    !> Particle of each pending event.
    integer, intent(in) :: next(coming)
    !> In: particle, channel and time of reversal, as `run_serial_window` leaves them; allocated for
    !> `most_lookahead_visits` more. Out: as `compute_visits` leaves them.
    type(visits_type), intent(inout) :: visits
    !> Visits computed ahead.
    type(lookahead_type), intent(inout) :: ahead
    !> Increased by the wall hits of the visits.
    integer(int64), intent(inout) :: computed_hits
    integer :: begun, j, k
    logical :: all_computed

    begun = visits%count
    all_computed = .true.
    do j = 1, begun
      all_computed = all_computed .and. .not. visits%turned(j) < never &
        .and. is_computed(flight(visits%particle(j)), visits%particle(j), ahead)
    end do
    if (all_computed) then
      do j = 1, begun
        associate (one => ahead%visit(flight(visits%particle(j))%lookahead_slot))
          visits%channel(j) = one%channel
          visits%time(j) = one%time
          visits%length(j) = one%length
          visits%y(j) = one%y
          visits%u_axial(j) = one%u_axial
          visits%u_lateral(j) = one%u_lateral
          visits%through(j) = one%through
          visits%hits(j) = one%hits
          computed_hits = computed_hits + int(one%hits, int64)
        end associate
      end do
    else
      do k = 1, min(coming, most_lookahead_visits)
        associate (i => next(k))
          if (is_computed(flight(i), i, ahead) .or. flight(i)%next_event == partial_visit) cycle
          j = visits%count + 1
          visits%count = j
          visits%particle(j) = i
          visits%channel(j) = merge(gated, ungated, flight(i)%next_event == to_gate)
          visits%turned(j) = never
        end associate
      end do
      call load_flights(number, flight, visits%count, visits%particle, visits%turned, &
        visits%passage, visits%time, visits%y, visits%u_axial, visits%u_lateral)
      call cross_channels(urn, visits)
      call compute_visits(urn, visits)
      computed_hits = computed_hits + visits%all_hits
      do j = begun + 1, visits%count
        ahead%last = modulo(ahead%last, slots) + 1
        ahead%visit(ahead%last) = computed_visit_type(visits%particle(j), visits%channel(j), &
          visits%time(j), visits%length(j), visits%y(j), visits%u_axial(j), visits%u_lateral(j), &
          visits%through(j), visits%hits(j))
        flight(visits%particle(j))%lookahead_slot = int(ahead%last, int32)
        computed_hits = computed_hits - int(visits%hits(j), int64)
      end do
      visits%count = begun
    end if
    visits%many_count = begun
    do j = 1, begun
      visits%many(j) = j
      flight(visits%particle(j))%lookahead_slot = 0
    end do
  end subroutine compute_with_lookahead

  !> Whether the next visit of particle `i` is computed: the flight holds its slot among those
  !> computed ahead, which may have been overwritten since.
  pure function is_computed(flight, i, ahead)
    !> Its flight.
    type(flight_type), intent(in) :: flight
    integer, intent(in) :: i
    type(lookahead_type), intent(in) :: ahead
    logical :: is_computed

    is_computed = flight%lookahead_slot > 0
    if (is_computed) is_computed = ahead%visit(flight%lookahead_slot)%particle == i
  end function is_computed

end module battery_lookahead

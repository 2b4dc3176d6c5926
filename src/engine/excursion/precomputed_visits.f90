!> Visits that the engine `excursion` computes before they begin.
!>
!> With few particles or tiny openings a window has one visit, too few to fill the vector lanes. A
!> particle that is not reversed in its channel interacts with no other, so its visit follows
!> from its flight. Together with a visit that begins, the visits after the next pending events are
!> therefore computed too, as if no gate reversed. These precomputed visits are stored until they
!> begin; the visit of a particle that a gate does reverse is computed again.
module battery_precomputed_visits
  use battery_kinds, only: wp, int32, int64
  use battery_channel, only: channel1, channel2
  use battery_urn_shape, only: cross_channels
  use battery_flight, only: flight_type, load_flights, never, partial_visit, to_gate
  use battery_passage_starts, only: store_passage_starts
  use battery_urn, only: urn_type, compute_passages
  use battery_visits, only: visits_type, many_hits
  implicit none (type, external)
  private
  public :: precomputed_visits_type, precomputing_pays, take_or_compute_visits

  !> Largest number of visits precomputed in one batch, besides those that begin now.
  integer, parameter, public :: most_precomputed_visits = 16
  !> Number of precomputed visits that are stored.
  integer, parameter :: slots = 64
  !> Precomputing pays where a window has fewer events than this on average.
  real(wp), parameter :: most_events = 1.0_wp

  !> A precomputed visit: its particle, and what `compute_passages` yields of it.
  type :: precomputed_visit_type
    integer :: particle = 0
    !> Whether it is on the list `untraceable_index`.
    logical :: is_untraceable = .false.
    integer(int64) :: channel = 0
    real(wp) :: time = 0.0_wp, length = 0.0_wp, y = 0.0_wp, u_axial = 0.0_wp, u_lateral = 0.0_wp, &
      through = 0.0_wp, hits = 0.0_wp
  end type precomputed_visit_type

  !> Precomputed visits: a new one takes the place of the oldest.
  type :: precomputed_visits_type
    private
    type(precomputed_visit_type) :: visit(slots)
    !> Starts of their passages through a polygon: x, y, u_x, u_y.
    real(wp) :: start(4, slots) = 0.0_wp
    !> Slot written last.
    integer :: last = 0
  end type precomputed_visits_type

contains

  !> Whether it pays to compute visits before they begin.
  pure function precomputing_pays(number, events, threshold)
    !> Number of particles: one alone has no visit to be computed with another.
    integer, intent(in) :: number
    !> Mean number of events in a window.
    real(wp), intent(in) :: events
    !> Thresholds of both gates: a gate of threshold 0 reverses all particles.
    integer, intent(in) :: threshold(2)
    logical :: precomputing_pays

    precomputing_pays = number > 1 .and. events < most_events .and. all(threshold > 0)
  end function precomputing_pays

  !> Copies the visits that begin from the precomputed ones, if all of them are there. Else computes
  !> them, together with the visits of the next events, which are stored.
  subroutine take_or_compute_visits(urn, number, flight, pending, pending_particle, visits, &
    precomputed, passage_starts, computed_hits)
    type(urn_type), intent(in) :: urn
    !> Number of particles; number of pending events in order.
    integer, intent(in) :: number, pending
    type(flight_type), intent(inout) :: flight(number)
    !> Particle of each pending event.
    integer, intent(in) :: pending_particle(pending)
    !> In: particle, channel and time of reversal, as `run_serial_window` leaves them; allocated for
    !> `most_precomputed_visits` more. Out: as `compute_passages` leaves them.
    type(visits_type), intent(inout) :: visits
    !> Precomputed visits.
    type(precomputed_visits_type), intent(inout) :: precomputed
    !> Updated with the starts of the passages of the visits.
    real(wp), allocatable, intent(inout) :: passage_starts(:, :)
    !> Increased by the wall hits of the visits.
    integer(int64), intent(inout) :: computed_hits
    integer :: started, j, k
    logical :: all_computed

    started = visits%count
    all_computed = .true.
    do j = 1, started
      all_computed = all_computed .and. .not. visits%reversal_time(j) < never &
        .and. is_computed(flight(visits%particle(j)), visits%particle(j), precomputed)
    end do
    if (all_computed) then
      do j = 1, started
        associate (slot => flight(visits%particle(j))%precomputed_slot, &
          known => precomputed%visit(flight(visits%particle(j))%precomputed_slot))
          visits%channel(j) = known%channel
          visits%time(j) = known%time
          visits%length(j) = known%length
          visits%y(j) = known%y
          visits%u_axial(j) = known%u_axial
          visits%u_lateral(j) = known%u_lateral
          visits%through(j) = known%through
          visits%hits(j) = known%hits
          if (known%is_untraceable) then
            visits%untraceable_count = visits%untraceable_count + 1
            visits%untraceable_index(visits%untraceable_count) = j
          end if
          computed_hits = computed_hits + int(known%hits, int64)
          if (urn%truncates_passages) passage_starts(:, visits%particle(j)) = &
            [precomputed%start(:, slot), known%time]
        end associate
      end do
    else
      do k = 1, min(pending, most_precomputed_visits)
        associate (i => pending_particle(k))
          if (is_computed(flight(i), i, precomputed) &
            .or. flight(i)%next_event == partial_visit) cycle
          j = visits%count + 1
          visits%count = j
          visits%particle(j) = i
          visits%channel(j) = merge(channel1, channel2, flight(i)%next_event == to_gate)
          visits%reversal_time(j) = never
        end associate
      end do
      call load_flights(number, flight, visits%count, visits%particle, visits%reversal_time, &
        visits%passage, visits%time, visits%y, visits%u_axial, visits%u_lateral)
      call cross_channels(urn, visits)
      if (urn%truncates_passages) then
        call store_passage_starts(passage_starts, visits, started)
        do j = started + 1, visits%count
          precomputed%start(:, slot_after(precomputed%last + j - started - 1)) = [visits%x(j), &
            visits%y(j), visits%u_axial(j), visits%u_lateral(j)]
        end do
      end if
      call compute_passages(urn, visits)
      computed_hits = computed_hits + visits%all_hits
      do j = started + 1, visits%count
        precomputed%last = slot_after(precomputed%last)
        precomputed%visit(precomputed%last) = precomputed_visit_type(visits%particle(j), &
          .false., visits%channel(j), visits%time(j), visits%length(j), visits%y(j), &
          visits%u_axial(j), visits%u_lateral(j), visits%through(j), visits%hits(j))
        flight(visits%particle(j))%precomputed_slot = int(precomputed%last, int32)
        computed_hits = computed_hits - int(visits%hits(j), int64)
      end do
      visits%count = started
      if (visits%untraceable_count > 0) call mark_untraceable(visits, flight, precomputed)
    end if
    visits%many_hits_count = 0
    do j = 1, started
      if (visits%hits(j) >= many_hits .or. visits%channel(j) < channel1) then
        visits%many_hits_count = visits%many_hits_count + 1
        visits%many_hits_index(visits%many_hits_count) = j
      end if
      flight(visits%particle(j))%precomputed_slot = 0
    end do
  end subroutine take_or_compute_visits

  !> Marks those of the visits just stored that cannot be traced back to their start, and takes them
  !> off the list of the visits that begin now.
  pure subroutine mark_untraceable(visits, flight, precomputed)
    type(visits_type), intent(inout) :: visits
    type(flight_type), intent(in) :: flight(:)
    type(precomputed_visits_type), intent(inout) :: precomputed
    integer :: j, k, kept

    kept = 0
    do k = 1, visits%untraceable_count
      j = visits%untraceable_index(k)
      if (j > visits%count) then
        precomputed%visit(flight(visits%particle(j))%precomputed_slot)%is_untraceable = .true.
      else
        kept = kept + 1
        visits%untraceable_index(kept) = j
      end if
    end do
    visits%untraceable_count = kept
  end subroutine mark_untraceable

  !> Slot that is written after a given one.
  elemental integer function slot_after(slot)
    integer, intent(in) :: slot

    slot_after = modulo(slot, slots) + 1
  end function slot_after

  !> Whether the next visit of particle `i` is precomputed. Its flight holds the slot of that visit;
  !> the slot may have been overwritten since.
  pure function is_computed(flight, i, precomputed)
    !> Its flight.
    type(flight_type), intent(in) :: flight
    integer, intent(in) :: i
    type(precomputed_visits_type), intent(in) :: precomputed
    logical :: is_computed

    is_computed = flight%precomputed_slot > 0
    if (is_computed) is_computed = precomputed%visit(flight%precomputed_slot)%particle == i
  end function is_computed

end module battery_precomputed_visits

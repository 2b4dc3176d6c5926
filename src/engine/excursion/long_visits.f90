!> Starts of the long visits of the engine `excursion`.
!>
!> A flight holds the end of a visit. Tracing back from there adds a rounding error for each unit of
!> length, and a visit may be 1e13 long. So the start of a visit is stored if the visit is long,
!> never ends, or is truncated; while a particle is nearer to the start of its visit than to its
!> end, it is located forwards from the start.
!>
!> An entry is a copy of the previous flight: a few words are copied, nothing is computed. It is
!> valid as long as the flight of its particle belongs to a long visit; invalid ones are dropped
!> when the store is full.
module battery_long_visits
  use battery_kinds, only: wp, int16, int32, int64
  use battery_calendar, only: flight_type
  use battery_channel, only: fold_into_channel, gated, ungated, facing, no_channel
  use battery_flight, only: never, to_gate, to_return, parked_in_urn, partial_visit, &
    trace_back_into_channel
  use battery_archive, only: archive_type
  use battery_urn, only: urn_type, locate_in_visit, locate_after
  use battery_visits, only: visits_type
  implicit none (type, external)
  private
  public :: long_visits_type, new_long_visits, is_long_visit, store_visit_starts, &
    is_nearer_start, locate_from_start, rebase_long_visits, serialize_long_visits

  !> A visit is long from this many times the reach of its urn on: tracing back through half of a
  !> shorter one loses no more than some 1e-13. A visit with fewer than `many_hits` = 112 hits is
  !> never long: it is at most 112 straight pieces, each of at most twice the reach.
  real(wp), parameter :: long = 256.0_wp

  !> The start of a visit, in one cache line.
  type :: entry_type
    !> As in the previous flight. `next_event` `counted_in_gate` or `to_return`: the particle's
    !> entry into the channel before the urn. `partial_visit`: an impact in the urn, described as
    !> `visits_type` describes one of a particle that never leaves.
    real(wp) :: time = 0.0_wp, y = 0.0_wp, u_axial = 0.0_wp, u_lateral = 0.0_wp, through = 0.0_wp
    !> Time at which a gate turned the particle back in the channel, or `never`.
    real(wp) :: turned = never
    !> Wall hits in the channel and in the urn; for an impact in the urn: wall hits since then.
    real(wp) :: hits = 0.0_wp
    integer(int32) :: particle = 0
    integer(int16) :: next_event = 0
  end type entry_type

  !> The entries, and the index from particles to entries.
  type :: long_visits_type
    !> Visits longer than this are long.
    real(wp) :: least = huge(1.0_wp)
    !> Number of particles, number of entries, size of the store.
    integer, private :: number = 0, count = 0, capacity = 0
    type(entry_type), allocatable, private :: entry(:)
    !> Entry of each particle, or 0; not allocated before there is an entry.
    integer(int32), allocatable, private :: place(:)
  end type long_visits_type

contains

  !> Sets up an empty store.
  pure subroutine new_long_visits(visits, number, reach)
    !> Empty.
    type(long_visits_type), intent(out) :: visits
    !> Number of particles.
    integer, intent(in) :: number
    !> Largest reach of the urns, a length.
    real(wp), intent(in) :: reach

    visits%number = number
    visits%least = long*reach
    allocate (visits%entry(0))
  end subroutine new_long_visits

  !> Whether a visit is long, from what `compute_visits` yields.
  elemental function is_long_visit(least, channel, length) result(yes)
    !> Of `long_visits_type`.
    real(wp), intent(in) :: least
    !> Channel that the particle goes to, `no_channel` or `truncated`.
    integer(int64), intent(in) :: channel
    !> Length of the visit.
    real(wp), intent(in) :: length
    logical :: yes

    yes = length > least .or. channel < gated
  end function is_long_visit

  !> Whether the visit before this flight is long.
  elemental function has_long_visit(visits, flight) result(yes)
    type(long_visits_type), intent(in) :: visits
    type(flight_type), intent(in) :: flight
    logical :: yes

    select case (flight%next_event)
    case (parked_in_urn, partial_visit)
      yes = .true.
    case (to_gate, to_return)
      yes = flight%length > visits%least
    case default
      yes = .false.
    end select
  end function has_long_visit

  !> Stores the starts of the long visits of a batch, before `store_flights` overwrites the flights.
  pure subroutine store_visit_starts(visits, number, flight, batch)
    !> Updated with the starts of the long visits of the batch.
    type(long_visits_type), intent(inout) :: visits
    !> Number of particles.
    integer, intent(in) :: number
    !> Flights before those of the batch are stored.
    type(flight_type), intent(in) :: flight(number)
    !> Visits of the batch, computed; `turned` is the time at which a gate turned a particle back
    !> before, or `never`.
    type(visits_type), intent(in) :: batch
    integer :: i, j, k

    do k = 1, batch%many_count
      j = batch%many(k)
      if (.not. is_long_visit(visits%least, batch%channel(j), batch%length(j))) cycle
      ! Allocates for the whole batch, before its first start is stored: a start that has just been
      ! stored still belongs to an old flight, so a later call would drop it as finished.
      if (visits%count + batch%many_count - k >= visits%capacity) call grow_entries(visits, &
        flight, batch%many_count - k + 1)
      i = batch%particle(j)
      call store_visit_start(visits, i, flight(i), batch%turned(j), batch%hits(j))
    end do
  end subroutine store_visit_starts

  !> Stores the start of a long visit before its flight is overwritten; the store is not full.
  pure subroutine store_visit_start(visits, particle, flight, turned, hits)
    type(long_visits_type), intent(inout) :: visits
    !> Its particle.
    integer, intent(in) :: particle
    !> The previous flight.
    type(flight_type), intent(in) :: flight
    !> Time at which a gate turned the particle back, or `never`; wall hits in channel and urn.
    real(wp), intent(in) :: turned, hits
    integer :: at

    at = visits%place(particle)
    if (at == 0) then
      at = visits%count + 1
      visits%count = at
      visits%place(particle) = int(at, int32)
      visits%entry(at)%particle = int(particle, int32)
    end if
    associate (entry => visits%entry(at))
      entry%time = flight%time
      entry%y = flight%y
      entry%u_axial = flight%u_axial
      entry%u_lateral = flight%u_lateral
      entry%through = flight%through
      entry%turned = turned
      entry%hits = hits
      entry%next_event = flight%next_event
    end associate
  end subroutine store_visit_start

  !> Drops invalid entries; enlarges the store if it is still half full.
  pure subroutine grow_entries(visits, flight, more)
    type(long_visits_type), intent(inout) :: visits
    type(flight_type), intent(in) :: flight(:)
    !> Number of entries to be added.
    integer, intent(in) :: more
    type(entry_type), allocatable :: entry(:)

    call drop_finished_entries(visits, flight)
    if (2*(visits%count + more) <= size(visits%entry)) return
    ! No particle has two entries.
    allocate (entry(min(max(64, 2*(visits%count + more)), visits%number + more)))
    entry(:visits%count) = visits%entry(:visits%count)
    call move_alloc(entry, visits%entry)
    visits%capacity = size(visits%entry)
    if (.not. allocated(visits%place)) allocate (visits%place(visits%number), source=0_int32)
  end subroutine grow_entries

  !> Drops the entries of visits that are over.
  pure subroutine drop_finished_entries(visits, flight)
    type(long_visits_type), intent(inout) :: visits
    type(flight_type), intent(in) :: flight(:)
    integer :: at, kept, i

    kept = 0
    do at = 1, visits%count
      i = visits%entry(at)%particle
      visits%place(i) = 0
      if (.not. has_long_visit(visits, flight(i))) cycle
      kept = kept + 1
      visits%entry(kept) = visits%entry(at)
      visits%place(i) = int(kept, int32)
    end do
    visits%count = kept
  end subroutine drop_finished_entries

  !> Whether a particle is to be located forwards: it has an entry, and the start of its visit is
  !> nearer than the end.
  pure function is_nearer_start(visits, flight, now) result(yes)
    !> The store.
    type(long_visits_type), intent(in) :: visits
    type(flight_type), intent(in) :: flight
    !> On the clock of the flight.
    real(wp), intent(in) :: now
    logical :: yes

    yes = has_long_visit(visits, flight)
    if (yes .and. flight%next_event /= parked_in_urn) yes = flight%time - now > 0.5_wp*flight%length
  end function is_nearer_start

  !> Position and velocity of a particle at the time `now`, forwards from the start of its visit;
  !> `hits` as in `locate_particle`.
  pure subroutine locate_from_start(visits, urn, particle, now, position, velocity, hits)
    !> The store.
    type(long_visits_type), intent(in) :: visits
    type(urn_type), intent(in) :: urn
    !> Its index.
    integer, intent(in) :: particle
    !> On the clock of the flight.
    real(wp), intent(in) :: now
    !> x and y of each: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> A whole number of either sign.
    integer(int64), intent(out) :: hits
    real(wp) :: passage, reflected, passed, begins, x, y, ux, uy
    integer :: from

    associate (entry => visits%entry(visits%place(particle)))
      if (entry%next_event == partial_visit) then
        call locate_in_visit(urn, no_channel, entry%y, entry%u_axial, entry%u_lateral, now &
          - entry%time, position, velocity, hits)
      else
        from = merge(ungated, gated, entry%next_event == to_return)
        passage = merge(2.0_wp*(entry%turned - entry%time), entry%through, entry%turned < never)
        begins = entry%time + passage
        x = facing(from)*urn%chord(from)
        call fold_into_channel(entry%y + entry%u_lateral*passage, urn%width(from), y, reflected, &
          passed)
        ux = -facing(from)*entry%u_axial
        uy = reflected*entry%u_lateral
        if (now < begins) then
          position = [x, y]
          velocity = [ux, uy]
          hits = 0
          call trace_back_into_channel(urn, begins - now, position, velocity, hits)
        else
          call locate_after(urn, x, y, ux, uy, now - begins, position, velocity, hits)
        end if
        hits = hits + int(passed, int64)
      end if
      hits = hits - int(entry%hits, int64)
    end associate
  end subroutine locate_from_start

  !> Shifts all times back by one epoch.
  pure subroutine rebase_long_visits(visits, epoch)
    !> The store.
    type(long_visits_type), intent(inout) :: visits
    !> Its length.
    real(wp), intent(in) :: epoch

    associate (entry => visits%entry(:visits%count))
      entry%time = entry%time - epoch
      entry%turned = entry%turned - epoch
    end associate
  end subroutine rebase_long_visits

  !> Serialises the valid entries.
  pure subroutine serialize_long_visits(visits, flight, archive)
    !> The store; invalid entries are dropped.
    type(long_visits_type), intent(inout) :: visits
    type(flight_type), intent(in) :: flight(:)
    type(archive_type), intent(inout) :: archive
    integer(int32), allocatable :: particle(:)
    integer :: at

    if (.not. archive%reading) call drop_finished_entries(visits, flight)
    particle = visits%entry(:visits%count)%particle
    call archive%serialize_list('long_visits', particle)
    if (archive%failed()) return
    if (archive%reading) then
      visits%count = size(particle)
      visits%capacity = size(particle)
      visits%entry = [(entry_type(particle=particle(at)), at=1, size(particle))]
      allocate (visits%place(visits%number), source=0_int32)
      visits%place(particle) = [(int(at, int32), at=1, size(particle))]
    end if
    associate (entry => visits%entry(:visits%count))
      call archive%serialize('long_heading', entry%next_event)
      call archive%serialize('long_time', entry%time, 'long_y', entry%y, 'long_along', &
        entry%u_axial, 'long_across', entry%u_lateral, 'long_through', entry%through)
      call archive%serialize('long_turned', entry%turned, 'long_hits', entry%hits)
    end associate
  end subroutine serialize_long_visits

end module battery_long_visits

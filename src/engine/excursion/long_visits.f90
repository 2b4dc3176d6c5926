!> Starts of the long visits of the engine `excursion`.
!>
!> A flight holds the end of a visit. Tracing back from there adds a rounding error for each unit of
!> length, and a visit may be 1e13 long. So the start of a visit is stored if the visit is long,
!> never ends, or is truncated; while a particle is nearer to the start of its visit than to its
!> end, it is located forwards from the start. The start is stored too if it is a corner between a
!> channel and a disc, or lies on the arc: traced back to there, the particle may have come from the
!> channel, or from the urn. And it is stored if a slow particle enters a disc along the wall: the
!> rounding errors of many short chords grow with the time in the channel before them.
!>
!> A start is a copy of the previous flight: nothing is computed. It is valid as long as it belongs
!> to the visit before the flight of its particle; invalid ones are dropped when the store is full.
module battery_long_visits
  use battery_kinds, only: wp, int32, int64
  use battery_channel, only: fold_into_channel, channel1, channel2, facing, no_channel
  use battery_flight, only: flight_type, idle_flight, never, to_gate, to_periodic_line, &
    trapped_in_urn, partial_visit
  use battery_archive, only: archive_type
  use battery_urn, only: urn_type, locate_in_passage, locate_after
  use battery_visits, only: visits_type
  implicit none (type, external)
  private
  public :: long_visits_type, new_long_visits, is_long_visit, store_visit_starts, &
    is_nearer_start, locate_from_start, rebase_long_visits, serialize_long_visits

  !> A visit is long if its passage through the urn is longer than this many times the reach of the
  !> urn: tracing back through half of a shorter one loses no more than some 1e-13. A visit with
  !> fewer than `many_hits` = 112 hits is never long: it is at most 112 straight pieces, each of at
  !> most twice the reach.
  real(wp), parameter :: long = 256.0_wp

  !> Times differ by less, in units of the length of a long visit, if they are equal but for
  !> rounding.
  real(wp), parameter :: same_time = 1.0e-11_wp

  !> The start of a visit.
  type :: visit_start_type
    !> The previous flight. `next_event` `counted_in_gate` or `to_periodic_line`: the particle's
    !> entry into the channel before the urn. `partial_visit`: an impact in the urn.
    type(flight_type) :: flight = idle_flight
    !> Time at which a gate reversed the particle in the channel, or `never`.
    real(wp) :: reversal_time = never
    !> Wall hits in the channel and in the urn; for an impact in the urn: wall hits since then.
    real(wp) :: hits = 0.0_wp
    integer(int32) :: particle = 0
  end type visit_start_type

  !> The starts, and the index from particles to starts.
  type :: long_visits_type
    !> Visits longer than this are long.
    real(wp) :: least = huge(1.0_wp)
    !> Number of particles, number of starts, size of the store.
    integer, private :: number = 0, count = 0, capacity = 0
    type(visit_start_type), allocatable, private :: visit_start(:)
    !> Index of the start of each particle's visit, or 0; not allocated before there is a start.
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
    allocate (visits%visit_start(0))
  end subroutine new_long_visits

  !> Whether a visit is long, from what `compute_passages` yields.
  elemental function is_long_visit(least, channel, length) result(yes)
    !> Of `long_visits_type`.
    real(wp), intent(in) :: least
    !> Channel that the particle goes to, `no_channel` or `truncated`.
    integer(int64), intent(in) :: channel
    !> Length of the passage through the urn.
    real(wp), intent(in) :: length
    logical :: yes

    yes = length > least .or. channel < channel1
  end function is_long_visit

  !> Whether the start of the visit before this flight is stored.
  pure function has_start(visits, particle, flight) result(yes)
    type(long_visits_type), intent(in) :: visits
    !> Its particle.
    integer, intent(in) :: particle
    type(flight_type), intent(in) :: flight
    logical :: yes

    select case (flight%next_event)
    case (trapped_in_urn, partial_visit)
      yes = .true.
    case (to_gate, to_periodic_line)
      yes = flight%length > visits%least
      if (yes .or. .not. allocated(visits%place)) return
      if (visits%place(particle) == 0) return
      ! The start of an earlier visit is before the end of that one.
      associate (visit_start => visits%visit_start(visits%place(particle)))
        yes = visit_start%flight%time + passage_before(visit_start) > flight%time - flight%length &
          - same_time*visits%least - 4.0_wp*epsilon(1.0_wp)*abs(flight%time)
      end associate
    case default
      yes = .false.
    end select
  end function has_start

  !> Time that the particle spends in the channel before the urn.
  pure function passage_before(visit_start) result(passage)
    type(visit_start_type), intent(in) :: visit_start
    real(wp) :: passage

    associate (flight => visit_start%flight)
      passage = merge(2.0_wp*(visit_start%reversal_time - flight%time), flight%through, &
        visit_start%reversal_time < never)
      if (flight%next_event == partial_visit) passage = 0.0_wp
    end associate
  end function passage_before

  !> Stores the starts of the visits of a batch that are long, or cannot be traced back, before
  !> `store_flights` overwrites the flights.
  pure subroutine store_visit_starts(visits, number, flight, batch)
    !> Updated with the starts.
    type(long_visits_type), intent(inout) :: visits
    !> Number of particles.
    integer, intent(in) :: number
    !> Flights before those of the batch are stored.
    type(flight_type), intent(in) :: flight(number)
    !> Visits of the batch, computed; `reversal_time` is the time at which a gate reversed a
    !> particle before, or `never`.
    type(visits_type), intent(in) :: batch
    integer :: i, j, k, listed

    listed = batch%many_hits_count + batch%untraceable_count
    do k = 1, listed
      if (k <= batch%untraceable_count) then
        j = batch%untraceable_index(k)
      else
        j = batch%many_hits_index(k - batch%untraceable_count)
        if (.not. is_long_visit(visits%least, batch%channel(j), batch%length(j))) cycle
      end if
      ! Allocates for the whole batch, before its first start is stored: a start that has just been
      ! stored still belongs to an old flight, so a later call would drop it as finished.
      if (visits%count + listed - k >= visits%capacity) &
        call grow_visit_starts(visits, flight, listed - k + 1)
      i = batch%particle(j)
      call store_visit_start(visits, i, flight(i), batch%reversal_time(j), batch%hits(j))
    end do
  end subroutine store_visit_starts

  !> Stores the start of a visit before its flight is overwritten; the store is not full.
  pure subroutine store_visit_start(visits, particle, flight, reversal_time, hits)
    type(long_visits_type), intent(inout) :: visits
    !> Its particle.
    integer, intent(in) :: particle
    !> The previous flight.
    type(flight_type), intent(in) :: flight
    !> Time at which a gate reversed the particle, or `never`; wall hits in channel and urn.
    real(wp), intent(in) :: reversal_time, hits
    integer :: at

    at = visits%place(particle)
    if (at == 0) then
      at = visits%count + 1
      visits%count = at
      visits%place(particle) = int(at, int32)
    end if
    associate (visit_start => visits%visit_start(at))
      visit_start%flight = flight
      visit_start%reversal_time = reversal_time
      visit_start%hits = hits
      visit_start%particle = int(particle, int32)
    end associate
  end subroutine store_visit_start

  !> Drops invalid starts; enlarges the store if it is still half full.
  pure subroutine grow_visit_starts(visits, flight, more)
    type(long_visits_type), intent(inout) :: visits
    type(flight_type), intent(in) :: flight(:)
    !> Number of starts to be added.
    integer, intent(in) :: more
    type(visit_start_type), allocatable :: visit_start(:)

    call drop_finished_starts(visits, flight)
    if (2*(visits%count + more) <= size(visits%visit_start)) return
    ! No particle has two starts.
    allocate (visit_start(min(max(64, 2*(visits%count + more)), visits%number + more)))
    visit_start(:visits%count) = visits%visit_start(:visits%count)
    call move_alloc(visit_start, visits%visit_start)
    visits%capacity = size(visits%visit_start)
    if (.not. allocated(visits%place)) allocate (visits%place(visits%number), source=0_int32)
  end subroutine grow_visit_starts

  !> Drops the starts of visits that are over.
  pure subroutine drop_finished_starts(visits, flight)
    type(long_visits_type), intent(inout) :: visits
    type(flight_type), intent(in) :: flight(:)
    integer :: at, kept, i
    logical :: valid

    kept = 0
    do at = 1, visits%count
      i = visits%visit_start(at)%particle
      valid = has_start(visits, i, flight(i))
      visits%place(i) = 0
      if (.not. valid) cycle
      kept = kept + 1
      visits%visit_start(kept) = visits%visit_start(at)
      visits%place(i) = int(kept, int32)
    end do
    visits%count = kept
  end subroutine drop_finished_starts

  !> Whether a particle is to be located forwards: the start of its visit is stored, and is nearer
  !> than the end.
  pure function is_nearer_start(visits, particle, flight, now) result(yes)
    !> The store.
    type(long_visits_type), intent(in) :: visits
    !> Its index.
    integer, intent(in) :: particle
    type(flight_type), intent(in) :: flight
    !> On the clock of the flight.
    real(wp), intent(in) :: now
    logical :: yes

    yes = has_start(visits, particle, flight)
    if (yes .and. flight%next_event /= trapped_in_urn) &
      yes = flight%time - now > 0.5_wp*flight%length
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

    associate (visit_start => visits%visit_start(visits%place(particle)), &
      flight => visits%visit_start(visits%place(particle))%flight)
      if (flight%next_event == partial_visit) then
        call locate_in_passage(urn, no_channel, flight%y, flight%u_axial, flight%u_lateral, now &
          - flight%time, position, velocity, hits)
      else
        from = merge(channel2, channel1, flight%next_event == to_periodic_line)
        passage = passage_before(visit_start)
        begins = flight%time + passage
        x = facing(from)*urn%chord(from)
        call fold_into_channel(flight%y + flight%u_lateral*passage, urn%width(from), y, &
          reflected, passed)
        ux = -facing(from)*flight%u_axial
        uy = reflected*flight%u_lateral
        if (now < begins) then
          call fold_into_channel(flight%y + flight%u_lateral*(now - flight%time), &
            urn%width(from), y, reflected, passed)
          ! However slow the particle is, it stays in this urn's half of the channel.
          x = facing(from)*(urn%chord(from) + min(flight%u_axial*(begins - now), &
            0.5_wp*urn%length(from)))
          position = [x, y]
          velocity = [ux, reflected*flight%u_lateral]
          hits = 0
        else
          call locate_after(urn, x, y, ux, uy, now - begins, position, velocity, hits)
        end if
        hits = hits + int(passed, int64)
      end if
      hits = hits - int(visit_start%hits, int64)
    end associate
  end subroutine locate_from_start

  !> Shifts all times back by one epoch.
  pure subroutine rebase_long_visits(visits, epoch)
    !> The store.
    type(long_visits_type), intent(inout) :: visits
    !> Its length.
    real(wp), intent(in) :: epoch

    associate (visit_start => visits%visit_start(:visits%count))
      visit_start%flight%time = visit_start%flight%time - epoch
      visit_start%reversal_time = visit_start%reversal_time - epoch
    end associate
  end subroutine rebase_long_visits

  !> Saves or restores the valid starts.
  pure subroutine serialize_long_visits(visits, flight, archive)
    !> The store; invalid starts are dropped.
    type(long_visits_type), intent(inout) :: visits
    type(flight_type), intent(in) :: flight(:)
    type(archive_type), intent(inout) :: archive
    integer :: at

    if (.not. archive%reading) call drop_finished_starts(visits, flight)
    call archive%serialize_size('long_visits', visits%count)
    if (archive%failed()) return
    if (archive%reading) then
      visits%capacity = visits%count
      visits%visit_start = [(visit_start_type(), at=1, visits%count)]
      allocate (visits%place(visits%number), source=0_int32)
    end if
    associate (visit_start => visits%visit_start(:visits%count))
      call archive%serialize('long_visits', visit_start%particle)
      if (archive%failed()) return
      if (archive%reading) visits%place(visit_start%particle) = [(int(at, int32), at=1, &
        visits%count)]
      associate (from => visit_start%flight)
        call archive%serialize('long_heading', from%next_event)
        call archive%serialize('long_time', from%time, 'long_y', from%y, 'long_along', &
          from%u_axial, 'long_across', from%u_lateral, 'long_through', from%through)
      end associate
      call archive%serialize('long_turned', visit_start%reversal_time, 'long_hits', &
        visit_start%hits)
    end associate
  end subroutine serialize_long_visits

end module battery_long_visits

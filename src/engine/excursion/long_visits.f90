!> Visits of the engine `excursion` become flights; of the long ones it is kept how they began.
!>
!> A flight tells how a visit ends, and going back from there costs digits: a rounding error for
!> each unit of length, of which a visit may have 1e13. So of a visit that is long, that never ends,
!> or of which only a part is known, it is kept how it began; while it is nearer to its beginning
!> than to its end, a particle is located forwards from there.
!>
!> What is kept is what the flight was before: a few words are copied, nothing is computed. An entry
!> is of use as long as the flight of its particle says that its visit is long; what is of no use
!> any more is thrown out where there is no room for more.
module battery_long_visits
  use battery_kinds, only: wp, int16, int32, int64
  use battery_calendar, only: flight_type
  use battery_channel, only: fold, gated, ungated, facing, no_channel
  use battery_flight, only: never, to_gate, to_return, parked_in_urn, partial_visit, &
    trace_back_into_channel
  use battery_archive, only: archive_type
  use battery_urn, only: urn_type, locate_in_visit, locate_after
  use battery_visits, only: visits_type, truncated
  implicit none (type, external)
  private
  public :: long_visits_type, new_long_visits, is_long_visit, keep_beginnings, &
    store_flights, is_nearer_start, locate_from_start, rebase_long_visits, serialize_long_visits

  !> A visit is long from so many times the reach of its urn on: going back through half of it costs
  !> no more than some 1e-13. One with fewer than `many_hits` hits has at most that many chords and
  !> one, of twice the reach: it is not long.
  real(wp), parameter :: long = 256.0_wp

  !> How a visit began: a line of the cache.
  type :: entry_type
    !> As the flight had it. Heading `counted_in_gate` or `to_return`: how the particle entered the
    !> channel before the urn. `partial_visit`: when it had an impact in the urn, with what
    !> `visits_type` tells of one that never leaves.
    real(wp) :: time = 0.0_wp, y = 0.0_wp, u_axial = 0.0_wp, u_lateral = 0.0_wp, through = 0.0_wp
    !> When a gate turned it back in the channel, or `never`.
    real(wp) :: turned = never
    !> Wall hits in that channel and of the whole visit; after an impact, those since then.
    real(wp) :: hits = 0.0_wp
    integer(int32) :: particle = 0
    integer(int16) :: heading = 0
  end type entry_type

  !> The entries, and which is whose.
  type :: long_visits_type
    !> Longer visits are long.
    real(wp) :: least = huge(1.0_wp)
    !> How many particles and entries there are, and how many there is room for.
    integer, private :: number = 0, count = 0, room = 0
    type(entry_type), allocatable, private :: entry(:)
    !> Where the entry of each particle is, or 0; not allocated before there is one.
    integer(int32), allocatable, private :: place(:)
  end type long_visits_type

contains

  !> Of so many particles no visit is known.
  pure subroutine new_long_visits(visits, number, reach)
    !> Empty.
    type(long_visits_type), intent(out) :: visits
    !> How many.
    integer, intent(in) :: number
    !> Of the urns, a length.
    real(wp), intent(in) :: reach

    visits%number = number
    visits%least = long*reach
    allocate (visits%entry(0))
  end subroutine new_long_visits

  !> Whether a visit is long, as it comes out of `cross`.
  elemental function is_long_visit(least, channel, length) result(yes)
    !> Of `long_visits_type`.
    real(wp), intent(in) :: least
    !> Where it leads to.
    integer(int64), intent(in) :: channel
    !> How long it is.
    real(wp), intent(in) :: length
    logical :: yes

    yes = length > least .or. channel < gated
  end function is_long_visit

  !> Whether the visit that a flight tells of is long.
  elemental function has_long_visit(visits, flight) result(yes)
    type(long_visits_type), intent(in) :: visits
    type(flight_type), intent(in) :: flight
    logical :: yes

    select case (flight%heading)
    case (parked_in_urn, partial_visit)
      yes = .true.
    case (to_gate, to_return)
      yes = flight%length > visits%least
    case default
      yes = .false.
    end select
  end function has_long_visit

  !> Keeps how the long visits of a batch began, before `store_flights` writes their flights.
  pure subroutine keep_beginnings(visits, number, flight, batch)
    !> Learns how they began.
    type(long_visits_type), intent(inout) :: visits
    !> How many particles there are.
    integer, intent(in) :: number
    !> As they still are.
    type(flight_type), intent(in) :: flight(number)
    !> As it comes out of `cross`; `turned` says when a gate turned each back before, or `never`.
    type(visits_type), intent(in) :: batch
    integer :: i, j, k

    do k = 1, batch%many_count
      j = batch%many(k)
      if (.not. is_long_visit(visits%least, batch%channel(j), batch%length(j))) cycle
      ! For all that are left: whose visit is kept already still has the flight of before.
      if (visits%count + batch%many_count - k >= visits%room) call grow_entries(visits, flight, &
        batch%many_count - k + 1)
      i = batch%particle(j)
      call store_visit_start(visits, i, flight(i), batch%turned(j), batch%hits(j))
    end do
  end subroutine keep_beginnings

  !> Writes down how each particle of a batch goes on; its `time` becomes that of its next event.
  pure subroutine store_flights(number, flight, n, particle, urn, channel, time, length, y, &
    u_axial, u_lateral, through)
    !> How many particles there are, and how many are in the batch.
    integer, intent(in) :: number, n
    type(flight_type), intent(inout) :: flight(number)
    !> Who is in the batch, and in which urn (1 or 2).
    integer, intent(in) :: particle(n), urn(n)
    !> The channel each goes to, or `no_channel`.
    integer(int64), intent(in) :: channel(n)
    !> Way through the urn, a length; height, |u_x| and u_y at its end; time in the channel beyond,
    !> from end to end. For `no_channel` as in `visits_type`.
    real(wp), intent(in) :: length(n), y(n), u_axial(n), u_lateral(n), through(n)
    !> In: when each visit begins. Out: huge if there is no event.
    real(wp), intent(inout) :: time(n)
    integer :: j, i
    real(wp) :: leaves

    do j = 1, n
      i = particle(j)
      leaves = time(j) + length(j)
      flight(i)%length = length(j)
      flight(i)%time = leaves
      flight(i)%y = y(j)
      flight(i)%u_axial = u_axial(j)
      flight(i)%u_lateral = u_lateral(j)
      flight(i)%through = through(j)
      flight(i)%urn = int(urn(j), int16)
      flight(i)%heading = to_gate
      time(j) = leaves
      if (channel(j) /= gated) then
        flight(i)%heading = merge(to_return, parked_in_urn, channel(j) == ungated)
        time(j) = merge(leaves + 0.5_wp*through(j), huge(1.0_wp), channel(j) == ungated)
        if (channel(j) == truncated) then
          ! Before its end, lest what comes then is due within the lookahead.
          flight(i)%heading = partial_visit
          time(j) = leaves - through(j)
        end if
      end if
      flight(i)%due = time(j)
    end do
  end subroutine store_flights

  !> Keeps how a long visit began, before its flight is written; there is room for it.
  pure subroutine store_visit_start(visits, particle, flight, turned, hits)
    type(long_visits_type), intent(inout) :: visits
    !> Who.
    integer, intent(in) :: particle
    !> As it still is.
    type(flight_type), intent(in) :: flight
    !> When a gate turned it back before, or `never`; wall hits, those in the channel before too.
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
      entry%heading = flight%heading
    end associate
  end subroutine store_visit_start

  !> Throws out what is of no use any more; if that leaves it half full, there will be more room.
  pure subroutine grow_entries(visits, flight, more)
    type(long_visits_type), intent(inout) :: visits
    type(flight_type), intent(in) :: flight(:)
    !> How many entries there is to be room for.
    integer, intent(in) :: more
    type(entry_type), allocatable :: entry(:)

    call drop_finished_entries(visits, flight)
    if (2*(visits%count + more) <= size(visits%entry)) return
    ! Nobody has two.
    allocate (entry(min(max(64, 2*(visits%count + more)), visits%number + more)))
    entry(:visits%count) = visits%entry(:visits%count)
    call move_alloc(entry, visits%entry)
    visits%room = size(visits%entry)
    if (.not. allocated(visits%place)) allocate (visits%place(visits%number), source=0_int32)
  end subroutine grow_entries

  !> Throws out the entries of visits that are over.
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

  !> Whether a particle is to be located forwards: there is an entry, and the end of its visit is
  !> farther than the beginning.
  pure function is_nearer_start(visits, flight, now) result(yes)
    !> All that are known.
    type(long_visits_type), intent(in) :: visits
    type(flight_type), intent(in) :: flight
    !> The time, on the clock of the flight.
    real(wp), intent(in) :: now
    logical :: yes

    yes = has_long_visit(visits, flight)
    if (yes .and. flight%heading /= parked_in_urn) yes = flight%time - now > 0.5_wp*flight%length
  end function is_nearer_start

  !> Where a particle is now that is located forwards, as `locate_particle` tells it.
  pure subroutine locate_from_start(visits, urn, particle, now, position, velocity, hits)
    !> All that are known.
    type(long_visits_type), intent(in) :: visits
    type(urn_type), intent(in) :: urn
    !> Who.
    integer, intent(in) :: particle
    !> The time, on the clock of the flight.
    real(wp), intent(in) :: now
    !> x and y of each: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Whole number of either sign.
    integer(int64), intent(out) :: hits
    real(wp) :: passage, reflected, passed, begins, x, y, ux, uy
    integer :: from

    associate (entry => visits%entry(visits%place(particle)))
      if (entry%heading == partial_visit) then
        call locate_in_visit(urn, no_channel, entry%y, entry%u_axial, entry%u_lateral, now &
          - entry%time, position, velocity, hits)
      else
        from = merge(ungated, gated, entry%heading == to_return)
        passage = merge(2.0_wp*(entry%turned - entry%time), entry%through, entry%turned < never)
        begins = entry%time + passage
        x = facing(from)*urn%chord(from)
        call fold(entry%y + entry%u_lateral*passage, urn%width(from), y, reflected, passed)
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

  !> Sets all times back by the length of a page.
  pure subroutine rebase_long_visits(visits, epoch)
    !> All that are known.
    type(long_visits_type), intent(inout) :: visits
    !> How long.
    real(wp), intent(in) :: epoch

    associate (entry => visits%entry(:visits%count))
      entry%time = entry%time - epoch
      entry%turned = entry%turned - epoch
    end associate
  end subroutine rebase_long_visits

  !> The entries that are of use, through a stream.
  pure subroutine serialize_long_visits(visits, flight, archive)
    !> All that are known; those that are over are thrown out.
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
      visits%room = size(particle)
      visits%entry = [(entry_type(particle=particle(at)), at=1, size(particle))]
      allocate (visits%place(visits%number), source=0_int32)
      visits%place(particle) = [(int(at, int32), at=1, size(particle))]
    end if
    associate (entry => visits%entry(:visits%count))
      call archive%serialize('long_heading', entry%heading)
      call archive%serialize('long_time', entry%time, 'long_y', entry%y, 'long_along', &
        entry%u_axial, 'long_across', entry%u_lateral, 'long_through', entry%through)
      call archive%serialize('long_turned', entry%turned, 'long_hits', entry%hits)
    end associate
  end subroutine serialize_long_visits

end module battery_long_visits

!> The state of a particle of the engine `excursion` between two of its events.
!>
!> A flight holds time, height and velocity of the particle's entry into its next channel, or into
!> the channel that it is in. It is made from an initial position (`make_initial_flight`), loaded
!> into a batch of visits and stored at their ends (`load_flights`, `store_flights`: kernels over
!> flat arrays, a flight being one cache line), and yields the position at any time between
!> (`locate_particle`). Earlier positions are computed backwards from it; for long visits the start
!> is stored as well (`battery_long_visits`).
module battery_flight
  use, intrinsic :: iso_c_binding, only: c_loc, c_size_t
  use battery_kinds, only: wp, int16, int32, int64
  use battery_channel, only: fold_into_channel, facing
  use battery_memory, only: prefer_large_pages
  use battery_table, only: table_type, passage_type, passage_at, enters_at_once, &
    height_off_wall, channel1, channel2, no_channel
  use battery_urn, only: urn_type, locate_in_passage, find_first_impact, meets_corner
  use battery_visits, only: visits_type, truncated
  implicit none (type, external)
  private
  public :: flight_type, idle_flight, new_flights, make_initial_flight, set_flight_to_visit_start, &
    load_flights, store_flights, locate_particle, locate_trapped_particle, &
    trace_back_into_channel, way_back_meets_corner, middle_time, never
  public :: to_gate, to_periodic_line, counted_in_gate, trapped_in_urn, trapped_in_channel, &
    partial_visit

  !> State of a particle between two of its events: its entry into a channel, or, if it is trapped
  !> in the urn or its visit is truncated, an impact there (below). A record fills one cache line:
  !> with many particles, the cost is that of reading one line per particle.
  type :: flight_type
    !> Time of the next event, for the calendar.
    real(wp) :: due
    !> Kind of that event; the urn that the particle leaves, 1 or 2.
    integer(int16) :: next_event, urn
    !> Slot of the next visit, if it is precomputed (`battery_precomputed_visits`); else 0.
    integer(int32) :: precomputed_slot
    !> Time, height, |u_x| and u_y at the entry into the next channel, or into the channel that the
    !> particle is in.
    real(wp) :: time, y, u_axial, u_lateral
    !> Time through the channel if no gate reverses, which is not used of a particle without such an
    !> entry, and length of the passage through the urn before it.
    real(wp) :: through, length
  end type flight_type

  !> A flight without an event. It is no default initialisation, since the memory pages of large
  !> arrays are chosen before the first write.
  type(flight_type), parameter :: idle_flight = flight_type(0.0_wp, 0_int16, 0_int16, 0_int32, &
    0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp)

  !> Next events of a flight (`next_event`):
  !> - `to_gate`, `to_periodic_line`: the next event is the entry into a gate, or the crossing of
  !>   the periodic line.
  !> - `counted_in_gate`: inside a gate, counted by it.
  !> - `trapped_in_urn`: never leaves; the flight holds one impact, as `visits_type` describes it,
  !>   and its time.
  !> - `trapped_in_channel`: never leaves; time, y and u_y hold, x is stored elsewhere.
  !> - `partial_visit`: as `trapped_in_urn`, until the next part of the visit is computed, at `due`.
  integer(int16), parameter :: to_gate = 1, to_periodic_line = 2, counted_in_gate = 3, &
    trapped_in_urn = 4, trapped_in_channel = 5, partial_visit = 6

  !> Time of reversal of a particle that no gate reverses.
  real(wp), parameter :: never = 0.25_wp*huge(1.0_wp)

contains

  !> Allocates the flights, without an event, in large memory pages.
  subroutine new_flights(flight, number)
    type(flight_type), allocatable, target, intent(out) :: flight(:)
    !> Number of particles.
    integer, intent(in) :: number

    allocate (flight(number))
    ! The system chooses the pages at the first write.
    call prefer_large_pages(c_loc(flight), int(number, c_size_t)*storage_size(flight)/8)
    flight = idle_flight
  end subroutine new_flights

  !> Loads particle `i` at (x, y) with velocity (ux, uy) in the frame of the table. Each call loads
  !> either particles in channels or particles in urns, and ignores the others. If the particle is
  !> in a channel and heads for the far end, its flight starts, in the past, at the entrance of
  !> the channel, and `hits` is reduced by the wall hits between the entrance and the initial
  !> position: they will be counted with the passage. If it is in an urn, or on its way back to one,
  !> a visit is added.
  subroutine make_initial_flight(table, i, x, y, ux, uy, from_channels, flight, visits, hits)
    type(table_type), intent(in) :: table
    integer, intent(in) :: i
    !> Position, a length, and velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> Whether particles in channels are loaded; else those in urns.
    logical, intent(in) :: from_channels
    type(flight_type), intent(inout) :: flight
    !> Batch of the visits to its urn.
    type(visits_type), intent(inout) :: visits
    integer(int64), intent(inout) :: hits
    type(passage_type) :: passage

    passage = passage_at(table, x, y, ux, uy)
    if (from_channels .eqv. passage%channel == no_channel) return
    if (from_channels) flight%urn = int(passage%urn, int16)
    if (enters_at_once(table, x, y, ux) .and. .not. from_channels) then
      ! At the instant 0, whatever the rounding of a passage through the urn.
      flight%urn = int(passage%urn, int16)
      flight%next_event = to_gate
      flight%y = height_off_wall(y, table%channel(channel1)%width)
      flight%u_axial = abs(ux)
      flight%u_lateral = uy
      flight%through = table%channel(channel1)%length/abs(ux)
    else if (passage%trapped) then
      flight%next_event = trapped_in_channel
      flight%y = y
      flight%u_axial = abs(ux)
      flight%u_lateral = uy
    else if (passage%moves_away) then
      flight%next_event = merge(counted_in_gate, to_periodic_line, passage%channel == channel1)
      flight%time = passage%time
      flight%y = passage%height
      flight%u_axial = abs(ux)
      flight%through = table%channel(passage%channel)%length/abs(ux)
      flight%u_lateral = passage%reflected*uy
      if (passage%channel /= channel1) flight%due = max(0.0_wp, flight%time + 0.5_wp*flight%through)
      hits = hits - int(passage%hits, int64)
    else
      associate (urn => table%urn(passage%urn), at => visits%count + 1)
        visits%particle(at) = i
        visits%urn(at) = passage%urn
        visits%time(at) = 0.0_wp
        visits%reversal_time(at) = never
        visits%y(at) = merge(passage%height, y, from_channels)
        visits%u_lateral(at) = uy
        ! In an urn: in the frame of the urn. In a channel: as `cross_channels` expects it.
        visits%hits(at) = 0.0_wp
        visits%x(at) = urn%centre - abs(x)
        visits%passage(at) = passage%time
        visits%u_axial(at) = merge(abs(ux), urn%axis_sign*ux, from_channels)
        if (from_channels) visits%channel(at) = passage%channel
        visits%count = at
      end associate
    end if
  end subroutine make_initial_flight

  !> Sets the flight of a particle that starts within a visit to the start of that visit, which
  !> `make_initial_flight` has added: in a channel, time 0 and the particle's own height and
  !> velocity, as if it entered the channel there; in an urn, an impact, the first of the visit if
  !> it has any, and the time of it. The start of a long visit is stored as such a flight.
  subroutine set_flight_to_visit_start(table, x, y, ux, uy, flight, hits)
    type(table_type), intent(in) :: table
    !> Its initial position, a length, and velocity, of length 1, in the frame of the table.
    real(wp), intent(in) :: x, y, ux, uy
    type(flight_type), intent(inout) :: flight
    !> Wall hits of the visit; out: those from that impact on, if the particle was in an urn.
    real(wp), intent(inout) :: hits
    type(passage_type) :: passage
    integer(int64) :: before

    passage = passage_at(table, x, y, ux, uy)
    if (passage%channel == no_channel) then
      associate (urn => table%urn(passage%urn))
        call find_first_impact(urn, urn%centre - abs(x), y, urn%axis_sign*ux, uy, flight%y, &
          flight%u_axial, flight%u_lateral, flight%time, before)
        hits = hits - real(before, wp)
        if (.not. (urn%truncates_passages .or. hits > 0.0_wp)) then
          ! That impact lies in the opening, after the end of the visit: the one before it instead.
          flight%y = flight%y - 2.0_wp*atan2(flight%u_axial, flight%u_lateral)
          flight%time = flight%time - 2.0_wp*urn%reach*flight%u_axial
          hits = hits + 1.0_wp
        end if
      end associate
      flight%next_event = partial_visit
    else
      flight%next_event = merge(counted_in_gate, to_periodic_line, passage%channel == channel1)
      flight%time = 0.0_wp
      flight%y = passage%height
      flight%u_axial = abs(ux)
      flight%u_lateral = uy
      flight%through = passage%time
    end if
  end subroutine set_flight_to_visit_start

  !> Time at which a particle that enters a gate reaches the middle line of channel 1: always after
  !> the entry, however short the channel.
  elemental function middle_time(enters, through) result(time)
    !> Time of the entry, 0 or more; duration of its passage through the whole channel.
    real(wp), intent(in) :: enters, through
    real(wp) :: time

    time = max(enters + 0.5_wp*through, enters*(1.0_wp + 2.0_wp*epsilon(1.0_wp)))
  end function middle_time

  !> Copies entry times, heights and velocities from the flights of the particles of a batch.
  pure subroutine load_flights(number, flight, n, particle, reversal_time, passage, time, y, &
    u_axial, u_lateral)
    !> Number of particles; size of the batch.
    integer, intent(in) :: number, n
    type(flight_type), intent(in) :: flight(number)
    !> Particle of each visit.
    integer, intent(in) :: particle(n)
    !> Time at which a gate reversed the particle, or `never`.
    real(wp), intent(in) :: reversal_time(n)
    !> Time spent in the channel; time, height and velocity at its entrance.
    real(wp), intent(out) :: passage(n), time(n), y(n), u_axial(n), u_lateral(n)
    integer :: j, i

    do j = 1, n
      i = particle(j)
      time(j) = flight(i)%time
      y(j) = flight(i)%y
      u_axial(j) = flight(i)%u_axial
      u_lateral(j) = flight(i)%u_lateral
      passage(j) = merge(2.0_wp*(reversal_time(j) - time(j)), flight(i)%through, &
        reversal_time(j) < never)
    end do
  end subroutine load_flights

  !> Stores the next flight of each particle of a batch; `time` becomes the time of the next event.
  pure subroutine store_flights(number, flight, n, particle, urn, channel, time, length, y, &
    u_axial, u_lateral, through)
    !> Number of particles; size of the batch.
    integer, intent(in) :: number, n
    type(flight_type), intent(inout) :: flight(number)
    !> Particle of each visit, and its urn (1 or 2).
    integer, intent(in) :: particle(n), urn(n)
    !> Channel that the particle goes to, or `no_channel`.
    integer(int64), intent(in) :: channel(n)
    !> Length of the passage through the urn; height, |u_x| and u_y at its end; time in the next
    !> channel, from end to end. For `no_channel` as in `visits_type`.
    real(wp), intent(in) :: length(n), y(n), u_axial(n), u_lateral(n), through(n)
    !> In: entry into the urn. Out: next event; huge if there is none.
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
      flight(i)%next_event = to_gate
      time(j) = leaves
      if (channel(j) /= channel1) then
        flight(i)%next_event = merge(to_periodic_line, trapped_in_urn, channel(j) == channel2)
        time(j) = merge(leaves + 0.5_wp*through(j), huge(1.0_wp), channel(j) == channel2)
        if (channel(j) == truncated) then
          ! Due before the end of the part, so that the next event is at least the lookahead later.
          flight(i)%next_event = partial_visit
          time(j) = leaves - through(j)
        end if
      end if
      flight(i)%due = time(j)
    end do
  end subroutine store_flights

  !> Position and velocity at the time `now` of a particle that is not trapped, in the frame of its
  !> urn, traced backwards from the end of its visit; and the `hits` to be added to `computed_hits`
  !> for it (negative: hits that are computed but still to come).
  pure subroutine locate_particle(urn, flight, now, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    type(flight_type), intent(in) :: flight
    !> On the clock of the flight.
    real(wp), intent(in) :: now
    !> x and y of each: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> A whole number of either sign.
    integer(int64), intent(out) :: hits
    real(wp) :: elapsed, reflected, passed
    integer :: channel

    elapsed = now - flight%time
    channel = merge(channel2, channel1, flight%next_event == to_periodic_line)
    if (flight%next_event == partial_visit) channel = no_channel
    if (channel /= no_channel .and. elapsed >= 0.0_wp) then
      call fold_into_channel(flight%y + flight%u_lateral*elapsed, urn%width(channel), position(2), &
        reflected, passed)
      position(1) = facing(channel)*(urn%chord(channel) + flight%u_axial*elapsed)
      velocity = [facing(channel)*flight%u_axial, reflected*flight%u_lateral]
      hits = int(passed, int64)
    else
      elapsed = -min(flight%time - now, flight%length)
      call locate_in_passage(urn, channel, flight%y, flight%u_axial, flight%u_lateral, elapsed, &
        position, velocity, hits)
      call trace_back_into_channel(urn, flight%time - now - flight%length, position, velocity, hits)
    end if
  end subroutine locate_particle

  !> Whether the way back of `locate_particle` meets a corner.
  pure function way_back_meets_corner(urn, flight, now) result(yes)
    type(urn_type), intent(in) :: urn
    type(flight_type), intent(in) :: flight
    !> On the clock of the flight.
    real(wp), intent(in) :: now
    logical :: yes
    integer :: channel

    channel = merge(channel2, channel1, flight%next_event == to_periodic_line)
    if (flight%next_event == partial_visit) channel = no_channel
    yes = channel == no_channel .or. now < flight%time
    if (yes) yes = meets_corner(urn, channel, flight%y, flight%u_axial, flight%u_lateral, &
      -min(flight%time - now, flight%length))
  end function way_back_meets_corner

  !> Moves a particle back from the start of its visit into the channel before it, if the visit
  !> starts only after the time `before`.
  pure subroutine trace_back_into_channel(urn, before, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    !> 0 or less: the visit has started.
    real(wp), intent(in) :: before
    !> In the frame of the urn: at the start of the visit in, now out.
    real(wp), intent(inout) :: position(2), velocity(2)
    !> Reduced by the hits in the channel that are still to come.
    integer(int64), intent(inout) :: hits
    real(wp) :: reflected, passed, height
    integer :: from

    if (before <= 0.0_wp) return
    from = merge(channel1, channel2, position(1) > 0.0_wp)
    ! At the end of an arc rounding finds a hit, before which the particle would leave the urn.
    if (facing(from)*velocity(1) > 0.0_wp) then
      velocity = velocity - 2.0_wp*dot_product(velocity, position)/dot_product(position, position) &
        *position
      hits = hits + 1_int64
    end if
    call fold_into_channel(position(2) - velocity(2)*before, urn%width(from), height, reflected, &
      passed)
    ! However slow the particle is, it stays in this urn's half of the channel.
    position(1) = facing(from)*(urn%chord(from) + min(abs(velocity(1))*before, &
      0.5_wp*urn%length(from)))
    position(2) = height
    velocity(2) = reflected*velocity(2)
    hits = hits - int(passed, int64)
  end subroutine trace_back_into_channel

  !> Position and velocity of a particle that is trapped in a channel, in the frame of the table.
  pure subroutine locate_trapped_particle(urn, flight, x, now, state, hits)
    type(urn_type), intent(in) :: urn
    type(flight_type), intent(in) :: flight
    !> Its x, which never changes; the time, on the clock of the flight.
    real(wp), intent(in) :: x, now
    !> x, y, u_x, u_y.
    real(wp), intent(out) :: state(4)
    !> Wall hits since it was loaded.
    integer(int64), intent(out) :: hits
    real(wp) :: height, reflected, passed
    integer :: channel

    channel = merge(channel1, channel2, abs(x) <= 0.5_wp*urn%length(channel1))
    call fold_into_channel(flight%y + flight%u_lateral*(now - flight%time), urn%width(channel), &
      height, reflected, passed)
    state = [x, height, 0.0_wp, reflected*flight%u_lateral]
    hits = int(passed, int64)
  end subroutine locate_trapped_particle

end module battery_flight

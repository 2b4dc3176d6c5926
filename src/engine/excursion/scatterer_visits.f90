!> Visits of the engine `excursion` on tables with discs in channel 2.
!>
!> There a particle may come back to its own urn, or cross the periodic line to and fro. So an urn
!> and its half of channel 2 are one region with two openings: the gate and the periodic line. A
!> visit starts at one of the openings, or at the initial position of a particle, and alternates
!> between the urn and its half of channel 2 until it ends at an opening. A flight to channel 2 ends
!> at the periodic line: its `through` is 0. A visit with too many hits is truncated in the channel
!> or in the urn (`partial_visit`) and continued later.
!>
!> Paths among discs diverge so fast that tracing them back does not lead to their start. So the
!> start of each visit is stored, in the frame of the urn or in that of its half of channel 2
!> (`battery_scatterers`), and a particle is located by computing its visit again from its start.
module battery_scatterer_visits
  use battery_kinds, only: wp, int8, int16, int32, int64
  use battery_channel, only: fold_into_channel, channel1, channel2
  use battery_flight, only: flight_type, to_gate, to_periodic_line, trapped_in_urn, partial_visit
  use battery_motion, only: motion_type, meets_line, meets_urn, meets_nothing, in_urn, in_channel2
  use battery_scatterers, only: longest_part
  use battery_half_channel_passages, only: compute_half_channel_passages
  use battery_archive, only: archive_type
  use battery_table, only: table_type
  use battery_urn, only: are_mirror_images, compute_passages, locate_in_passage, follow_passage
  use battery_visits, only: visits_type, reserve_visits, truncated
  implicit none (type, external)
  private
  public :: scatterer_visits_type, new_scatterer_visits, visit_start_at, reserve_scatterer_visits, &
    add_scatterer_visit, compute_scatterer_visits, store_scatterer_flights
  public :: locate_by_replay, serialize_visit_starts

  !> Next event of a visit that has not ended.
  integer(int16), parameter :: undetermined = 0

  !> A visit while it is computed.
  type :: scatterer_visit_type
    integer :: particle = 0
    !> State that it has reached; next event after its end; wall hits so far.
    type(motion_type) :: now
    integer(int16) :: next_event = undetermined
    integer(int64) :: hits = 0
    !> As in `flight_type`, once it has ended.
    real(wp) :: y = 0.0_wp, u_axial = 0.0_wp, u_lateral = 0.0_wp, through = 0.0_wp
  end type scatterer_visit_type

  !> Start of the present visit of each particle, and the batch of visits that are computed.
  type :: scatterer_visits_type
    type(motion_type), allocatable :: visit_start(:)
    integer :: count = 0
    type(scatterer_visit_type), allocatable :: visit(:)
    !> Work space: visits that have not ended; the batch in an urn; positions in the batch, motions
    !> and wall hits of those in a half of channel 2.
    integer, allocatable, private :: open(:), place(:)
    type(visits_type), private :: visits
    type(motion_type), allocatable, private :: motions(:)
    integer(int64), allocatable, private :: hits(:)
  end type scatterer_visits_type

contains

  !> Allocates the store, without visits.
  pure subroutine new_scatterer_visits(scatterer_visits, number)
    type(scatterer_visits_type), intent(out) :: scatterer_visits
    !> Number of particles.
    integer, intent(in) :: number

    allocate (scatterer_visits%visit_start(number), scatterer_visits%visit(0))
  end subroutine new_scatterer_visits

  !> The start of a visit.
  elemental function visit_start_at(time, urn, chamber, x, y, ux, uy) result(visit_start)
    !> On the clock of the epoch.
    real(wp), intent(in) :: time
    !> Index of the urn; `in_urn` or `in_channel2`.
    integer, intent(in) :: urn, chamber
    !> Position and velocity in the frame of that chamber: lengths, and a vector of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    type(motion_type) :: visit_start

    visit_start = motion_type(x, y, ux, uy, time, int(urn, int8), int(chamber, int8))
    ! Along a wall, as in `motion_at`.
    if (.not. abs(uy) > 0.0_wp) visit_start%uy = sign(0.0_wp, -y)
  end function visit_start_at

  !> Empties the batch, and allocates it for `capacity` visits if it is smaller.
  pure subroutine reserve_scatterer_visits(scatterer_visits, capacity)
    type(scatterer_visits_type), intent(inout) :: scatterer_visits
    integer, intent(in) :: capacity
    integer :: n

    scatterer_visits%count = 0
    if (size(scatterer_visits%visit) >= capacity) return
    deallocate (scatterer_visits%visit)
    if (allocated(scatterer_visits%open)) deallocate (scatterer_visits%open, &
      scatterer_visits%place, scatterer_visits%motions, scatterer_visits%hits)
    n = max(64, capacity + capacity/2)
    allocate (scatterer_visits%visit(n), scatterer_visits%open(n), scatterer_visits%place(n), &
      scatterer_visits%motions(n), scatterer_visits%hits(n))
  end subroutine reserve_scatterer_visits

  !> Adds a visit to the batch, which is large enough.
  pure subroutine add_scatterer_visit(scatterer_visits, particle, visit_start)
    type(scatterer_visits_type), intent(inout) :: scatterer_visits
    !> Its particle.
    integer, intent(in) :: particle
    !> Its start.
    type(motion_type), intent(in) :: visit_start

    scatterer_visits%count = scatterer_visits%count + 1
    scatterer_visits%visit(scatterer_visits%count) = scatterer_visit_type(particle=particle, &
      now=visit_start)
  end subroutine add_scatterer_visit

  !> Computes all visits of the batch to their ends, but not beyond the time `limit`.
  subroutine compute_scatterer_visits(scatterer_visits, table, limit)
    type(scatterer_visits_type), intent(inout) :: scatterer_visits
    type(table_type), intent(in) :: table
    !> On the clock of the epoch; a visit that has not ended by then stops there with
    !> `next_event` `undetermined`.
    real(wp), intent(in) :: limit
    integer :: urn, j, open, still_open

    open = scatterer_visits%count
    do j = 1, open
      scatterer_visits%open(j) = j
    end do
    do
      still_open = 0
      do j = 1, open
        scatterer_visits%open(still_open + 1) = scatterer_visits%open(j)
        associate (visit => scatterer_visits%visit(scatterer_visits%open(j)))
          if (visit%next_event == undetermined .and. visit%now%time < limit) &
            still_open = still_open + 1
        end associate
      end do
      open = still_open
      if (open == 0) exit
      ! Mirror-image urns share a batch.
      if (are_mirror_images(table%urn)) then
        call cross_urns(scatterer_visits, table, 1, 2, open, limit)
      else
        call cross_urns(scatterer_visits, table, 1, 1, open, limit)
        call cross_urns(scatterer_visits, table, 2, 2, open, limit)
      end if
      do urn = 1, 2
        call cross_half_channels(scatterer_visits, table, urn, open, limit)
      end do
    end do
  end subroutine compute_scatterer_visits

  !> Moves all visits that are in an urn to its openings.
  subroutine cross_urns(scatterer_visits, table, first, last, open, limit)
    type(scatterer_visits_type), intent(inout) :: scatterer_visits
    type(table_type), intent(in) :: table
    !> First and last urn.
    integer, intent(in) :: first, last
    !> Number of visits that have not ended.
    integer, intent(in) :: open
    real(wp), intent(in) :: limit
    integer :: j, k

    associate (v => scatterer_visits%visits)
      call reserve_visits(v, open)
      do k = 1, open
        j = scatterer_visits%open(k)
        associate (visit => scatterer_visits%visit(j))
          if (visit%now%chamber /= in_urn) cycle
          if (visit%now%urn < first .or. visit%now%urn > last) cycle
          v%count = v%count + 1
          v%particle(v%count) = j
          v%x(v%count) = visit%now%x
          v%y(v%count) = visit%now%y
          v%u_axial(v%count) = visit%now%ux
          v%u_lateral(v%count) = visit%now%uy
          v%hits(v%count) = 0.0_wp
        end associate
      end do
      if (v%count == 0) return
      call compute_passages(table%urn(first), v)
      do k = 1, v%count
        call end_urn_passage(table, v, k, limit, scatterer_visits%visit(v%particle(k)))
      end do
    end associate
  end subroutine cross_urns

  !> Continues or ends a visit at the end of its passage through an urn.
  subroutine end_urn_passage(table, v, k, limit, visit)
    type(table_type), intent(in) :: table
    type(visits_type), intent(in) :: v
    !> Its index in the batch.
    integer, intent(in) :: k
    real(wp), intent(in) :: limit
    type(scatterer_visit_type), intent(inout) :: visit
    real(wp) :: position(2), velocity(2), leaves, after, until, forwards
    integer(int64) :: later
    logical :: stays, truncated_now

    leaves = visit%now%time + v%length(k)
    visit%hits = visit%hits + int(v%hits(k), int64)
    stays = v%channel(k) /= channel1 .and. v%channel(k) /= channel2
    ! A truncated visit is continued from half a part before its end, so that what follows is no
    ! sooner than the lookahead.
    truncated_now = v%channel(k) == truncated .and. leaves < limit
    if (truncated_now .or. (limit < huge(1.0_wp) .and. (stays .or. leaves > limit))) then
      after = merge(-v%through(k), limit - leaves, truncated_now)
      until = merge(leaves - v%through(k), limit, truncated_now)
      ! Through a polygon forwards all the way: back from its end, rounding may lead to the other
      ! side of a corner.
      forwards = merge(1.0_wp, 0.5_wp, table%urn(visit%now%urn)%truncates_passages)
      if (until - visit%now%time < forwards*v%length(k) .or. (stays .and. .not. &
        table%urn(visit%now%urn)%truncates_passages)) then
        call follow_passage(table%urn(visit%now%urn), visit%now%x, visit%now%y, visit%now%ux, &
          visit%now%uy, until - visit%now%time, position, velocity, later)
        later = later - int(v%hits(k), int64)
      else
        call locate_in_passage(table%urn(visit%now%urn), int(v%channel(k)), v%y(k), v%u_axial(k), &
          v%u_lateral(k), after, position, velocity, later)
      end if
      visit%hits = visit%hits + later
      if (truncated_now) visit%next_event = partial_visit
      visit%now = visit_start_at(until, int(visit%now%urn), in_urn, position(1), position(2), &
        velocity(1), velocity(2))
    else if (v%channel(k) == channel2) then
      visit%now = visit_start_at(leaves, int(visit%now%urn), in_channel2, &
        table%half_channel2(visit%now%urn)%length, v%y(k), -v%u_axial(k), v%u_lateral(k))
    else
      visit%now%time = leaves
      visit%next_event = merge(trapped_in_urn, to_gate, stays)
      visit%y = v%y(k)
      visit%u_axial = v%u_axial(k)
      visit%u_lateral = v%u_lateral(k)
      visit%through = v%through(k)
    end if
  end subroutine end_urn_passage

  !> Moves all visits that are in one half of channel 2 to its ends.
  subroutine cross_half_channels(scatterer_visits, table, urn, open, limit)
    type(scatterer_visits_type), intent(inout) :: scatterer_visits
    type(table_type), intent(in) :: table
    integer, intent(in) :: urn
    !> Number of visits that had not ended before `cross_urns`.
    integer, intent(in) :: open
    real(wp), intent(in) :: limit
    integer :: j, k, n

    n = 0
    do k = 1, open
      j = scatterer_visits%open(k)
      associate (visit => scatterer_visits%visit(j))
        if (visit%now%chamber /= in_channel2 .or. visit%now%urn /= urn) cycle
        if (visit%next_event /= undetermined .or. visit%now%time >= limit) cycle
        n = n + 1
        scatterer_visits%place(n) = j
        scatterer_visits%motions(n) = visit%now
      end associate
    end do
    if (n == 0) return
    call compute_half_channel_passages(table%half_channel2(urn), limit, n, &
      scatterer_visits%motions, scatterer_visits%hits)
    do k = 1, n
      call end_half_channel_passage(table, scatterer_visits%motions(k), scatterer_visits%hits(k), &
        limit, scatterer_visits%visit(scatterer_visits%place(k)))
    end do
  end subroutine cross_half_channels

  !> Continues or ends a visit at the end of its passage through a half of channel 2.
  pure subroutine end_half_channel_passage(table, motion, hits, limit, visit)
    type(table_type), intent(in) :: table
    !> State at the end of the path, and the wall hits on it.
    type(motion_type), intent(in) :: motion
    integer(int64), intent(in) :: hits
    real(wp), intent(in) :: limit
    type(scatterer_visit_type), intent(inout) :: visit

    associate (half_channel => table%half_channel2(motion%urn), now => visit%now)
      visit%hits = visit%hits + hits
      now = motion
      now%y = sign(min(abs(motion%y), half_channel%half_width), motion%y)
      if (motion%next == meets_nothing) then
        now%time = limit
      else if (motion%next == meets_urn) then
        now%x = -table%urn(motion%urn)%chord(channel2)
        now%chamber = int(in_urn, int8)
        ! It may go to and fro between a disc and the wall of the urn for ever.
        if (visit%hits >= longest_part) visit%next_event = partial_visit
      else
        visit%next_event = merge(to_periodic_line, partial_visit, motion%next == meets_line)
        visit%y = now%y
        visit%u_axial = abs(motion%ux)
        visit%u_lateral = motion%uy
        visit%through = 0.0_wp
      end if
    end associate
  end subroutine end_half_channel_passage

  !> Stores the flights that the visits of the batch end in.
  pure subroutine store_scatterer_flights(scatterer_visits, flight, computed_hits)
    type(scatterer_visits_type), intent(in) :: scatterer_visits
    type(flight_type), intent(inout) :: flight(:)
    !> Increased by the wall hits of the visits.
    integer(int64), intent(inout) :: computed_hits
    integer :: j

    do j = 1, scatterer_visits%count
      associate (visit => scatterer_visits%visit(j), &
        next_flight => flight(scatterer_visits%visit(j)%particle))
        next_flight%next_event = visit%next_event
        next_flight%urn = visit%now%urn
        next_flight%time = visit%now%time
        next_flight%y = visit%y
        next_flight%u_axial = visit%u_axial
        next_flight%u_lateral = visit%u_lateral
        next_flight%through = visit%through
        next_flight%length = visit%now%time - scatterer_visits%visit_start(visit%particle)%time
        next_flight%due = merge(huge(1.0_wp), visit%now%time, visit%next_event == trapped_in_urn)
        computed_hits = computed_hits + visit%hits
      end associate
    end do
  end subroutine store_scatterer_flights

  !> State at the time `now` of a particle within its visit, or in the gate before it, in the frame
  !> of the table; and the `hits` to be added to `computed_hits` for it (negative: hits that are
  !> computed but still to come).
  subroutine locate_by_replay(table, visit_start, now, state, hits)
    type(table_type), intent(in) :: table
    !> Start of its visit.
    type(motion_type), intent(in) :: visit_start
    !> On the clock of the epoch.
    real(wp), intent(in) :: now
    !> x, y, u_x, u_y.
    real(wp), intent(out) :: state(4)
    !> Of either sign.
    integer(int64), intent(out) :: hits
    type(scatterer_visits_type) :: whole, part
    real(wp) :: before, reflected, passed
    type(motion_type) :: state_now

    call new_scatterer_visits(whole, 1)
    call reserve_scatterer_visits(whole, 1)
    call add_scatterer_visit(whole, 1, visit_start)
    part = whole
    call compute_scatterer_visits(whole, table, huge(1.0_wp))
    if (now > visit_start%time) call compute_scatterer_visits(part, table, now)
    state_now = part%visit(1)%now
    hits = part%visit(1)%hits - whole%visit(1)%hits
    associate (urn => table%urn(visit_start%urn))
      before = visit_start%time - now
      if (visit_start%chamber == in_urn .and. before > 0.0_wp) then
        call fold_into_channel(visit_start%y - visit_start%uy*before, urn%width(channel1), &
          state_now%y, reflected, passed)
        state_now%x = visit_start%x + min(abs(visit_start%ux)*before, 0.5_wp*urn%length(channel1))
        state_now%uy = reflected*visit_start%uy
        hits = hits - int(passed, int64)
      end if
      state = [urn%axis_sign*(state_now%x - merge(urn%periodic_line, urn%centre, &
        state_now%chamber == in_channel2)), state_now%y, urn%axis_sign*state_now%ux, state_now%uy]
    end associate
  end subroutine locate_by_replay

  !> Saves or restores the starts of all visits.
  subroutine serialize_visit_starts(scatterer_visits, urn, archive)
    type(scatterer_visits_type), intent(inout) :: scatterer_visits
    !> Urn that each particle belongs to.
    integer(int16), intent(in) :: urn(:)
    type(archive_type), intent(inout) :: archive
    integer(int32) :: chamber(size(urn))

    associate (visit_start => scatterer_visits%visit_start)
      visit_start%urn = int(urn, int8)
      chamber = visit_start%chamber
      call archive%serialize('leg_time', visit_start%time, 'leg_x', visit_start%x, 'leg_y', &
        visit_start%y, 'leg_ux', visit_start%ux, 'leg_uy', visit_start%uy)
      call archive%serialize('leg_chamber', chamber)
      visit_start%chamber = int(chamber, int8)
    end associate
  end subroutine serialize_visit_starts

end module battery_scatterer_visits

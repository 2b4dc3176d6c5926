!> Visits of the engine `excursion` on tables with discs in channel 2.
!>
!> There a particle may come back to its own urn, or cross the counted line to and fro. So each side
!> of the table is one chamber with two openings: the gate and the line. A visit starts at either,
!> or wherever a particle is at the start of the run, and alternates between the urn and its half of
!> channel 2 until it ends at either. A flight to channel 2 ends at the line: its `through` is 0. A
!> visit with too many hits is truncated in the channel or in the urn (`partial_visit`) and
!> continued later.
!>
!> Paths among discs diverge so fast that tracing them back leads elsewhere. So the start of each
!> visit is stored, in the frame of the urn or in that of its half of channel 2
!> (`battery_scatterers`), and a particle is located by computing its visit once more from there.
module battery_scattered_sides
  use battery_kinds, only: wp, int8, int16, int32, int64
  use battery_calendar, only: flight_type
  use battery_channel, only: fold, gated, ungated
  use battery_flight, only: to_gate, to_return, parked_in_urn, partial_visit
  use battery_motion, only: motion_type, meets_line, meets_urn, meets_nothing, in_urn, in_return
  use battery_scattered_visits, only: compute_half_channel_visits
  use battery_archive, only: archive_type
  use battery_table, only: table_type
  use battery_urn, only: are_mirror_images, compute_visits, locate_in_visit, locate_after
  use battery_visits, only: visits_type, reserve_visits, truncated
  implicit none (type, external)
  private
  public :: sides_type, new_sides, visit_start_at, reserve_side_visits, add_side_visit, &
    compute_side_visits, store_side_flights
  public :: locate_by_replay, serialize_visit_starts

  !> Heading of a visit that has not ended.
  integer(int16), parameter :: undetermined = 0

  !> A visit while it is computed.
  type :: side_visit_type
    integer :: particle = 0
    !> State it has reached; heading that it ends with, and wall hits so far.
    type(motion_type) :: now
    integer(int16) :: heading = undetermined
    integer(int64) :: hits = 0
    !> As in `flight_type`, once it has ended.
    real(wp) :: y = 0.0_wp, u_axial = 0.0_wp, u_lateral = 0.0_wp, through = 0.0_wp
  end type side_visit_type

  !> Start of the present visit of each particle, and the batch of visits that are computed.
  type :: sides_type
    type(motion_type), allocatable :: visit_start(:)
    integer :: count = 0
    type(side_visit_type), allocatable :: side_visit(:)
    !> Work space: visits that have not ended; the batch in an urn; positions in the batch, motions
    !> and wall hits of those in a half of channel 2.
    integer, allocatable, private :: open(:), place(:)
    type(visits_type), private :: visits
    type(motion_type), allocatable, private :: motions(:)
    integer(int64), allocatable, private :: hits(:)
  end type sides_type

contains

  !> Allocates the store; no visit is known.
  pure subroutine new_sides(sides, number)
    type(sides_type), intent(out) :: sides
    !> Number of particles.
    integer, intent(in) :: number

    allocate (sides%visit_start(number), sides%side_visit(0))
  end subroutine new_sides

  !> The start of a visit.
  elemental function visit_start_at(time, side, chamber, x, y, ux, uy) result(visit_start)
    !> On the clock of the epoch.
    real(wp), intent(in) :: time
    !> Side of the table; `in_urn` or `in_return`.
    integer, intent(in) :: side, chamber
    !> Position and velocity in the frame of that chamber: lengths, and a vector of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    type(motion_type) :: visit_start

    visit_start = motion_type(x, y, ux, uy, time, int(side, int8), int(chamber, int8))
  end function visit_start_at

  !> Empties the batch and makes room for `room` visits.
  pure subroutine reserve_side_visits(sides, room)
    type(sides_type), intent(inout) :: sides
    integer, intent(in) :: room
    integer :: n

    sides%count = 0
    if (size(sides%side_visit) >= room) return
    deallocate (sides%side_visit)
    if (allocated(sides%open)) deallocate (sides%open, sides%place, sides%motions, sides%hits)
    n = max(64, room + room/2)
    allocate (sides%side_visit(n), sides%open(n), sides%place(n), sides%motions(n), sides%hits(n))
  end subroutine reserve_side_visits

  !> Adds a visit to the batch; there is room for it.
  pure subroutine add_side_visit(sides, particle, visit_start, hits)
    type(sides_type), intent(inout) :: sides
    !> Its particle.
    integer, intent(in) :: particle
    !> Its start.
    type(motion_type), intent(in) :: visit_start
    !> Wall hits in the channel before.
    integer(int64), intent(in) :: hits

    sides%count = sides%count + 1
    sides%side_visit(sides%count) = side_visit_type(particle=particle, now=visit_start, hits=hits)
  end subroutine add_side_visit

  !> Computes all visits of the batch to their ends, but not beyond the time `limit`.
  subroutine compute_side_visits(sides, table, limit)
    type(sides_type), intent(inout) :: sides
    type(table_type), intent(in) :: table
    !> On the clock of the epoch; a visit that has not ended by then stops there with the heading
    !> `undetermined`.
    real(wp), intent(in) :: limit
    integer :: side, j, open, kept

    open = sides%count
    do j = 1, open
      sides%open(j) = j
    end do
    do
      kept = 0
      do j = 1, open
        sides%open(kept + 1) = sides%open(j)
        associate (at => sides%side_visit(sides%open(j)))
          if (at%heading == undetermined .and. at%now%time < limit) kept = kept + 1
        end associate
      end do
      open = kept
      if (open == 0) exit
      ! Mirror-image urns share a batch.
      if (are_mirror_images(table%urn)) then
        call cross_urn_of_side(sides, table, 1, 2, open, limit)
      else
        call cross_urn_of_side(sides, table, 1, 1, open, limit)
        call cross_urn_of_side(sides, table, 2, 2, open, limit)
      end if
      do side = 1, 2
        call cross_half_of_side(sides, table, side, open, limit)
      end do
    end do
  end subroutine compute_side_visits

  !> Moves all visits that are in an urn to its openings.
  subroutine cross_urn_of_side(sides, table, first, last, open, limit)
    type(sides_type), intent(inout) :: sides
    type(table_type), intent(in) :: table
    !> First and last side.
    integer, intent(in) :: first, last
    !> Number of visits that have not ended.
    integer, intent(in) :: open
    real(wp), intent(in) :: limit
    integer :: j, k

    associate (v => sides%visits)
      call reserve_visits(v, open)
      do k = 1, open
        j = sides%open(k)
        associate (at => sides%side_visit(j))
          if (at%now%chamber /= in_urn .or. at%now%side < first .or. at%now%side > last) cycle
          v%count = v%count + 1
          v%particle(v%count) = j
          v%x(v%count) = at%now%x
          v%y(v%count) = at%now%y
          v%u_axial(v%count) = at%now%ux
          v%u_lateral(v%count) = at%now%uy
          v%hits(v%count) = 0.0_wp
        end associate
      end do
      if (v%count == 0) return
      call compute_visits(table%urn(first), v)
      do k = 1, v%count
        call end_urn_passage(table, v, k, limit, sides%side_visit(v%particle(k)))
      end do
    end associate
  end subroutine cross_urn_of_side

  !> Continues or ends a visit at the end of its way through an urn.
  subroutine end_urn_passage(table, v, k, limit, at)
    type(table_type), intent(in) :: table
    type(visits_type), intent(in) :: v
    !> Its index in the batch.
    integer, intent(in) :: k
    real(wp), intent(in) :: limit
    type(side_visit_type), intent(inout) :: at
    real(wp) :: position(2), velocity(2), leaves, after, until
    integer(int64) :: later
    logical :: stays, goes_on_now

    leaves = at%now%time + v%length(k)
    at%hits = at%hits + int(v%hits(k), int64)
    stays = v%channel(k) /= gated .and. v%channel(k) /= ungated
    ! A truncated visit is continued from half a part before its end, so that what follows is no
    ! sooner than the lookahead.
    goes_on_now = v%channel(k) == truncated .and. leaves < limit
    if (goes_on_now .or. (limit < huge(1.0_wp) .and. (stays .or. leaves > limit))) then
      after = merge(-v%through(k), limit - leaves, goes_on_now)
      until = merge(leaves - v%through(k), limit, goes_on_now)
      if (stays .or. until - at%now%time < 0.5_wp*v%length(k)) then
        call locate_after(table%urn(at%now%side), at%now%x, at%now%y, at%now%ux, at%now%uy, &
          until - at%now%time, position, velocity, later)
        later = later - int(v%hits(k), int64)
      else
        call locate_in_visit(table%urn(at%now%side), int(v%channel(k)), v%y(k), v%u_axial(k), &
          v%u_lateral(k), after, position, velocity, later)
      end if
      at%hits = at%hits + later
      if (goes_on_now) at%heading = partial_visit
      at%now = visit_start_at(until, int(at%now%side), in_urn, position(1), position(2), &
        velocity(1), velocity(2))
    else if (v%channel(k) == ungated) then
      at%now = visit_start_at(leaves, int(at%now%side), in_return, &
        table%scattered(at%now%side)%length, v%y(k), -v%u_axial(k), v%u_lateral(k))
    else
      at%now%time = leaves
      at%heading = merge(parked_in_urn, to_gate, stays)
      at%y = v%y(k)
      at%u_axial = v%u_axial(k)
      at%u_lateral = v%u_lateral(k)
      at%through = v%through(k)
    end if
  end subroutine end_urn_passage

  !> Moves all visits that are in one half of channel 2 to its ends.
  subroutine cross_half_of_side(sides, table, side, open, limit)
    type(sides_type), intent(inout) :: sides
    type(table_type), intent(in) :: table
    integer, intent(in) :: side
    !> Number of visits that had not ended before `cross_urn_of_side`.
    integer, intent(in) :: open
    real(wp), intent(in) :: limit
    integer :: j, k, n

    n = 0
    do k = 1, open
      j = sides%open(k)
      associate (at => sides%side_visit(j))
        if (at%now%chamber /= in_return .or. at%now%side /= side) cycle
        if (at%heading /= undetermined .or. at%now%time >= limit) cycle
        n = n + 1
        sides%place(n) = j
        sides%motions(n) = at%now
      end associate
    end do
    if (n == 0) return
    call compute_half_channel_visits(table%scattered(side), limit, n, sides%motions, sides%hits)
    do k = 1, n
      call end_half_passage(table, sides%motions(k), sides%hits(k), limit, &
        sides%side_visit(sides%place(k)))
    end do
  end subroutine cross_half_of_side

  !> Continues or ends a visit at the end of its way through a half of channel 2.
  pure subroutine end_half_passage(table, motion, hits, limit, at)
    type(table_type), intent(in) :: table
    !> State at that end, and the wall hits on the way.
    type(motion_type), intent(in) :: motion
    integer(int64), intent(in) :: hits
    real(wp), intent(in) :: limit
    type(side_visit_type), intent(inout) :: at

    associate (half_channel => table%scattered(motion%side), now => at%now)
      at%hits = at%hits + hits
      now = motion
      now%y = sign(min(abs(motion%y), half_channel%half_width), motion%y)
      if (motion%next == meets_nothing) then
        now%time = limit
      else if (motion%next == meets_urn) then
        now%x = -table%urn(motion%side)%chord(ungated)
        now%chamber = int(in_urn, int8)
      else
        at%heading = merge(to_return, partial_visit, motion%next == meets_line)
        at%y = now%y
        at%u_axial = abs(motion%ux)
        at%u_lateral = motion%uy
        at%through = 0.0_wp
      end if
    end associate
  end subroutine end_half_passage

  !> Stores the flights that the visits of the batch end in.
  pure subroutine store_side_flights(sides, flight, computed_hits)
    type(sides_type), intent(in) :: sides
    type(flight_type), intent(inout) :: flight(:)
    !> Increased by the wall hits of the visits.
    integer(int64), intent(inout) :: computed_hits
    integer :: j

    do j = 1, sides%count
      associate (at => sides%side_visit(j), its => flight(sides%side_visit(j)%particle))
        its%heading = at%heading
        its%urn = at%now%side
        its%time = at%now%time
        its%y = at%y
        its%u_axial = at%u_axial
        its%u_lateral = at%u_lateral
        its%through = at%through
        its%length = at%now%time - sides%visit_start(at%particle)%time
        its%due = merge(huge(1.0_wp), at%now%time, at%heading == parked_in_urn)
        computed_hits = computed_hits + at%hits
      end associate
    end do
  end subroutine store_side_flights

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
    type(sides_type) :: whole, part
    real(wp) :: before, reflected, passed
    type(motion_type) :: here

    call new_sides(whole, 1)
    call reserve_side_visits(whole, 1)
    call add_side_visit(whole, 1, visit_start, 0_int64)
    part = whole
    call compute_side_visits(whole, table, huge(1.0_wp))
    if (now > visit_start%time) call compute_side_visits(part, table, now)
    here = part%side_visit(1)%now
    hits = part%side_visit(1)%hits - whole%side_visit(1)%hits
    associate (urn => table%urn(visit_start%side))
      before = visit_start%time - now
      if (visit_start%chamber == in_urn .and. before > 0.0_wp) then
        call fold(visit_start%y - visit_start%uy*before, urn%width(gated), here%y, reflected, &
          passed)
        here%x = visit_start%x + min(abs(visit_start%ux)*before, 0.5_wp*urn%length(gated))
        here%uy = reflected*visit_start%uy
        hits = hits - int(passed, int64)
      end if
      state = [urn%axis_sign*(here%x - merge(urn%periodic_line, urn%centre, here%chamber &
        == in_return)), here%y, urn%axis_sign*here%ux, here%uy]
    end associate
  end subroutine locate_by_replay

  !> Serialises the starts of all visits.
  subroutine serialize_visit_starts(sides, side, archive)
    type(sides_type), intent(inout) :: sides
    !> Side of the table that each particle is on.
    integer(int16), intent(in) :: side(:)
    type(archive_type), intent(inout) :: archive
    integer(int32) :: chamber(size(side))

    associate (visit_start => sides%visit_start)
      visit_start%side = int(side, int8)
      chamber = visit_start%chamber
      call archive%serialize('leg_time', visit_start%time, 'leg_x', visit_start%x, 'leg_y', &
        visit_start%y, 'leg_ux', visit_start%ux, 'leg_uy', visit_start%uy)
      call archive%serialize('leg_chamber', chamber)
      visit_start%chamber = int(chamber, int8)
    end associate
  end subroutine serialize_visit_starts

end module battery_scattered_sides

!> What the engine `excursion` does where discs stand in channel 2.
!>
!> There a particle may come back to its own urn, or cross the counted line to and fro. So a side of
!> the table is one chamber with two openings: the gate, and the line. A visit begins at either, or
!> wherever a particle was, and goes through the urn and its half of channel 2 by turns until it
!> ends at either. A flight to channel 2 ends at the line: its `through` is 0. A visit of too many
!> hits ends in the channel or in the urn (`in_parts`) and is gone on with.
!>
!> Paths among discs part so fast that going back along them leads elsewhere. So it is kept how each
!> visit began, in the frame of the urn or in that of its half of channel 2 (`battery_scatterers`);
!> where a particle is within it is found by flying it once more.
module battery_scattered_sides
  use battery_kinds, only: wp, int8, int16, int32, int64
  use battery_calendar, only: flight_type
  use battery_channel, only: fold, gated, ungated
  use battery_flight, only: to_gate, to_return, parked_in_urn, in_parts
  use battery_motion, only: motion_type, meets_line, meets_urn, meets_nothing, in_urn, in_return
  use battery_scattered_visits, only: cross_half
  use battery_stream, only: stream_type
  use battery_table, only: table_type
  use battery_urn, only: alike, cross, place_in_visit, place_after
  use battery_visits, only: visits_type, reserve_visits, goes_on
  implicit none (type, external)
  private
  public :: sides_type, new_sides, begins_at, reserve_travels, add_travel, travel, settle
  public :: replay, pass_begun

  !> Heading of a particle of which nothing is known yet.
  integer(int16), parameter :: open_end = 0

  !> How a visit goes on that is being flown.
  type :: travel_type
    integer :: particle = 0
    !> Where it has come to; what it ends with, and the wall hits until then.
    type(motion_type) :: now
    integer(int16) :: heading = open_end
    integer(int64) :: hits = 0
    !> As in `flight_type`, of one that has ended.
    real(wp) :: y = 0.0_wp, along = 0.0_wp, across = 0.0_wp, through = 0.0_wp
  end type travel_type

  !> How the present visit of each particle began, and those that are being flown.
  type :: sides_type
    type(motion_type), allocatable :: begun(:)
    integer :: count = 0
    type(travel_type), allocatable :: travel(:)
    !> Work space: who has not ended; those in an urn; those in a half of channel 2, which of the
    !> travels they are, and their wall hits.
    integer, allocatable, private :: open(:), place(:)
    type(visits_type), private :: visits
    type(motion_type), allocatable, private :: strays(:)
    integer(int64), allocatable, private :: hits(:)
  end type sides_type

contains

  !> Room for so many particles, none of which is known.
  pure subroutine new_sides(sides, number)
    type(sides_type), intent(out) :: sides
    !> How many.
    integer, intent(in) :: number

    allocate (sides%begun(number), sides%travel(0))
  end subroutine new_sides

  !> How a visit begins.
  elemental function begins_at(time, side, chamber, x, y, ux, uy) result(begun)
    !> When, on the clock of the page.
    real(wp), intent(in) :: time
    !> Side of the table; `in_urn` or `in_return`.
    integer, intent(in) :: side, chamber
    !> Place and velocity in the frame of that chamber: lengths, and a vector of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    type(motion_type) :: begun

    begun = motion_type(x, y, ux, uy, time, int(side, int8), int(chamber, int8))
  end function begins_at

  !> Makes room for `room` visits and empties the batch.
  pure subroutine reserve_travels(sides, room)
    type(sides_type), intent(inout) :: sides
    integer, intent(in) :: room
    integer :: n

    sides%count = 0
    if (size(sides%travel) >= room) return
    deallocate (sides%travel)
    if (allocated(sides%open)) deallocate (sides%open, sides%place, sides%strays, sides%hits)
    n = max(64, room + room/2)
    allocate (sides%travel(n), sides%open(n), sides%place(n), sides%strays(n), sides%hits(n))
  end subroutine reserve_travels

  !> One more visit; there is room for it.
  pure subroutine add_travel(sides, particle, begun, hits)
    type(sides_type), intent(inout) :: sides
    !> Who.
    integer, intent(in) :: particle
    !> How it begins.
    type(motion_type), intent(in) :: begun
    !> Wall hits in the channel before.
    integer(int64), intent(in) :: hits

    sides%count = sides%count + 1
    sides%travel(sides%count) = travel_type(particle=particle, now=begun, hits=hits)
  end subroutine add_travel

  !> Flies all visits of the batch to their ends, but not beyond the time `limit`.
  subroutine travel(sides, table, limit)
    type(sides_type), intent(inout) :: sides
    type(table_type), intent(in) :: table
    !> On the clock of the page; who has not ended then is there with the heading `open_end`.
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
        associate (at => sides%travel(sides%open(j)))
          if (at%heading == open_end .and. at%now%time < limit) kept = kept + 1
        end associate
      end do
      open = kept
      if (open == 0) exit
      ! Urns that are alike share a batch.
      if (alike(table%urn)) then
        call go_through_urn(sides, table, 1, 2, open, limit)
      else
        call go_through_urn(sides, table, 1, 1, open, limit)
        call go_through_urn(sides, table, 2, 2, open, limit)
      end if
      do side = 1, 2
        call go_through_half(sides, table, side, open, limit)
      end do
    end do
  end subroutine travel

  !> Those who are in the urn of a side, to its openings.
  subroutine go_through_urn(sides, table, first, last, open, limit)
    type(sides_type), intent(inout) :: sides
    type(table_type), intent(in) :: table
    !> Sides.
    integer, intent(in) :: first, last
    !> How many visits have not ended.
    integer, intent(in) :: open
    real(wp), intent(in) :: limit
    integer :: j, k

    associate (v => sides%visits)
      call reserve_visits(v, open)
      do k = 1, open
        j = sides%open(k)
        associate (at => sides%travel(j))
          if (at%now%chamber /= in_urn .or. at%now%side < first .or. at%now%side > last) cycle
          v%count = v%count + 1
          v%particle(v%count) = j
          v%x(v%count) = at%now%x
          v%y(v%count) = at%now%y
          v%along(v%count) = at%now%ux
          v%across(v%count) = at%now%uy
          v%hits(v%count) = 0.0_wp
        end associate
      end do
      if (v%count == 0) return
      call cross(table%urn(first), v)
      do k = 1, v%count
        call leave_urn(table, v, k, limit, sides%travel(v%particle(k)))
      end do
    end associate
  end subroutine go_through_urn

  !> What becomes of a visit at the end of its way through an urn.
  subroutine leave_urn(table, v, k, limit, at)
    type(table_type), intent(in) :: table
    type(visits_type), intent(in) :: v
    !> Its place in the batch.
    integer, intent(in) :: k
    real(wp), intent(in) :: limit
    type(travel_type), intent(inout) :: at
    real(wp) :: position(2), velocity(2), leaves, after, until
    integer(int64) :: later
    logical :: stays, goes_on_now

    leaves = at%now%time + v%length(k)
    at%hits = at%hits + int(v%hits(k), int64)
    stays = v%channel(k) /= gated .and. v%channel(k) /= ungated
    ! A long visit is gone on with from half its part, so that what comes after is no sooner than
    ! the lookahead.
    goes_on_now = v%channel(k) == goes_on .and. leaves < limit
    if (goes_on_now .or. (limit < huge(1.0_wp) .and. (stays .or. leaves > limit))) then
      after = merge(-v%through(k), limit - leaves, goes_on_now)
      until = merge(leaves - v%through(k), limit, goes_on_now)
      if (stays .or. until - at%now%time < 0.5_wp*v%length(k)) then
        call place_after(table%urn(at%now%side), at%now%x, at%now%y, at%now%ux, at%now%uy, &
          until - at%now%time, position, velocity, later)
        later = later - int(v%hits(k), int64)
      else
        call place_in_visit(table%urn(at%now%side), int(v%channel(k)), v%y(k), v%along(k), &
          v%across(k), after, position, velocity, later)
      end if
      at%hits = at%hits + later
      if (goes_on_now) at%heading = in_parts
      at%now = begins_at(until, int(at%now%side), in_urn, position(1), position(2), velocity(1), &
        velocity(2))
    else if (v%channel(k) == ungated) then
      at%now = begins_at(leaves, int(at%now%side), in_return, &
        table%scattered(at%now%side)%length, v%y(k), -v%along(k), v%across(k))
    else
      at%now%time = leaves
      at%heading = merge(parked_in_urn, to_gate, stays)
      at%y = v%y(k)
      at%along = v%along(k)
      at%across = v%across(k)
      at%through = v%through(k)
    end if
  end subroutine leave_urn

  !> Those who are in a half of channel 2, to its ends.
  subroutine go_through_half(sides, table, side, open, limit)
    type(sides_type), intent(inout) :: sides
    type(table_type), intent(in) :: table
    integer, intent(in) :: side
    !> How many visits have not ended, but for those that just have.
    integer, intent(in) :: open
    real(wp), intent(in) :: limit
    integer :: j, k, n

    n = 0
    do k = 1, open
      j = sides%open(k)
      associate (at => sides%travel(j))
        if (at%now%chamber /= in_return .or. at%now%side /= side) cycle
        if (at%heading /= open_end .or. at%now%time >= limit) cycle
        n = n + 1
        sides%place(n) = j
        sides%strays(n) = at%now
      end associate
    end do
    if (n == 0) return
    call cross_half(table%scattered(side), limit, n, sides%strays, sides%hits)
    do k = 1, n
      call leave_half(table, sides%strays(k), sides%hits(k), limit, sides%travel(sides%place(k)))
    end do
  end subroutine go_through_half

  !> What becomes of a visit at the end of its way through a half of channel 2.
  pure subroutine leave_half(table, stray, hits, limit, at)
    type(table_type), intent(in) :: table
    !> What it has come to, and the wall hits on the way.
    type(motion_type), intent(in) :: stray
    integer(int64), intent(in) :: hits
    real(wp), intent(in) :: limit
    type(travel_type), intent(inout) :: at

    associate (half => table%scattered(stray%side), now => at%now)
      at%hits = at%hits + hits
      now = stray
      now%y = sign(min(abs(stray%y), half%half_width), stray%y)
      if (stray%next == meets_nothing) then
        now%time = limit
      else if (stray%next == meets_urn) then
        now%x = -table%urn(stray%side)%chord(ungated)
        now%chamber = int(in_urn, int8)
      else
        at%heading = merge(to_return, in_parts, stray%next == meets_line)
        at%y = now%y
        at%along = abs(stray%ux)
        at%across = stray%uy
        at%through = 0.0_wp
      end if
    end associate
  end subroutine leave_half

  !> Writes down how the particles of a batch go on.
  pure subroutine settle(sides, flight, known_hits)
    type(sides_type), intent(in) :: sides
    type(flight_type), intent(inout) :: flight(:)
    !> Grows by the wall hits of the visits.
    integer(int64), intent(inout) :: known_hits
    integer :: j

    do j = 1, sides%count
      associate (at => sides%travel(j), its => flight(sides%travel(j)%particle))
        its%heading = at%heading
        its%urn = at%now%side
        its%time = at%now%time
        its%y = at%y
        its%along = at%along
        its%across = at%across
        its%through = at%through
        its%length = at%now%time - sides%begun(at%particle)%time
        its%due = merge(huge(1.0_wp), at%now%time, at%heading == parked_in_urn)
        known_hits = known_hits + at%hits
      end associate
    end do
  end subroutine settle

  !> Where a particle is now within its visit, or in the gate before that, in the frame of the
  !> table, and by how many wall hits `known_hits` is short for it (negative: so many are still to
  !> come).
  subroutine replay(table, begun, now, state, hits)
    type(table_type), intent(in) :: table
    !> How its visit began.
    type(motion_type), intent(in) :: begun
    !> The time, on the clock of the page.
    real(wp), intent(in) :: now
    !> x, y, u_x, u_y.
    real(wp), intent(out) :: state(4)
    !> Of either sign.
    integer(int64), intent(out) :: hits
    type(sides_type) :: whole, part
    real(wp) :: before, turned, passed
    type(motion_type) :: here

    call new_sides(whole, 1)
    call reserve_travels(whole, 1)
    call add_travel(whole, 1, begun, 0_int64)
    part = whole
    call travel(whole, table, huge(1.0_wp))
    if (now > begun%time) call travel(part, table, now)
    here = part%travel(1)%now
    hits = part%travel(1)%hits - whole%travel(1)%hits
    associate (urn => table%urn(begun%side))
      before = begun%time - now
      if (begun%chamber == in_urn .and. before > 0.0_wp) then
        call fold(begun%y - begun%uy*before, urn%width(gated), here%y, turned, passed)
        here%x = begun%x + min(abs(begun%ux)*before, 0.5_wp*urn%length(gated))
        here%uy = turned*begun%uy
        hits = hits - int(passed, int64)
      end if
      state = [urn%way*(here%x - merge(urn%periodic_line, urn%centre, here%chamber == in_return)), &
        here%y, urn%way*here%ux, here%uy]
    end associate
  end subroutine replay

  !> How the visits of all began, through a stream.
  subroutine pass_begun(sides, side, stream)
    type(sides_type), intent(inout) :: sides
    !> On which side of the table each is.
    integer(int16), intent(in) :: side(:)
    type(stream_type), intent(inout) :: stream
    integer(int32) :: chamber(size(side))

    associate (begun => sides%begun)
      begun%side = int(side, int8)
      chamber = begun%chamber
      call stream%pass('leg_time', begun%time, 'leg_x', begun%x, 'leg_y', begun%y, 'leg_ux', &
        begun%ux, 'leg_uy', begun%uy)
      call stream%pass('leg_chamber', chamber)
      begun%chamber = int(chamber, int8)
    end associate
  end subroutine pass_begun

end module battery_scattered_sides

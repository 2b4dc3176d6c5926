!> What the engine `excursion` does where discs stand in channel 2.
!>
!> There a particle may come back to its own urn, or cross the counted line to and fro. So a side of
!> the table is one chamber with two openings: the gate, and the line. A visit begins at either, or
!> wherever a particle was, and goes through the urn and its half of channel 2 by turns until it
!> ends at either. A flight to channel 2 ends at the line: its `through` is 0. A visit of too many
!> hits ends in the channel or in the urn (`in_parts`) and is gone on with.
!>
!> Paths among discs part so fast that going back along them leads elsewhere. So it is kept how each
!> visit began (`leg_type`); where a particle is within it is found by flying it once more.
module battery_among
  use battery_kinds, only: wp, int16, int32, int64
  use battery_calendar, only: flight_type
  use battery_channel, only: fold, gated, ungated
  use battery_flight, only: to_gate, to_return, parked_in_urn, in_parts
  use battery_motion, only: wall_kind, meets_line, meets_urn, meets_nothing, in_urn, in_return
  use battery_scattered_visits, only: strays_type, reserve_strays, cross_half
  use battery_stream, only: stream_type
  use battery_table, only: table_type
  use battery_urn, only: alike, cross, place_before, place_for_ever
  use battery_visits, only: visits_type, reserve_visits, goes_on
  implicit none (type, external)
  private
  public :: leg_type, among_type, new_among, reserve_travels, add_travel, travel, settle, replay
  public :: pass_legs

  !> Heading of a particle of which nothing is known yet.
  integer(int16), parameter :: open_end = 0

  !> Where a visit begins: when, place and velocity in the frame of the urn, or in that of its half
  !> of channel 2 (`battery_scatterers`).
  type :: leg_type
    real(wp) :: time = 0.0_wp, x = 0.0_wp, y = 0.0_wp, ux = 0.0_wp, uy = 0.0_wp
    !> `in_urn` or `in_return`.
    integer(int32) :: chamber = in_urn
  end type leg_type

  !> How a visit goes on that is being flown.
  type :: travel_type
    integer :: particle = 0, side = 0
    !> Where it has come to; what it ends with, and the wall hits until then.
    type(leg_type) :: now
    integer(int16) :: heading = open_end
    integer(int64) :: hits = 0
    !> As in `flight_type`, of one that has ended.
    real(wp) :: y = 0.0_wp, along = 0.0_wp, across = 0.0_wp, through = 0.0_wp
  end type travel_type

  !> How the present visit of each particle began, and those that are being flown.
  type :: among_type
    type(leg_type), allocatable :: leg(:)
    integer :: count = 0
    type(travel_type), allocatable :: travel(:)
    !> Work space: who has not ended, those in an urn, those in a half of channel 2.
    integer, allocatable, private :: open(:)
    type(visits_type), private :: visits
    type(strays_type), private :: strays
  end type among_type

contains

  !> Room for so many particles, none of which is known.
  pure subroutine new_among(among, number)
    type(among_type), intent(out) :: among
    !> How many.
    integer, intent(in) :: number

    allocate (among%leg(number))
    allocate (among%travel(0), among%open(0))
  end subroutine new_among

  !> Makes room for `room` visits and empties the batch.
  pure subroutine reserve_travels(among, room)
    type(among_type), intent(inout) :: among
    integer, intent(in) :: room

    among%count = 0
    if (size(among%travel) >= room) return
    deallocate (among%travel, among%open)
    allocate (among%travel(max(64, room + room/2)), among%open(max(64, room + room/2)))
  end subroutine reserve_travels

  !> One more visit; there is room for it.
  pure subroutine add_travel(among, particle, side, leg, hits)
    type(among_type), intent(inout) :: among
    !> Who, and on which side of the table.
    integer, intent(in) :: particle, side
    !> Where it begins.
    type(leg_type), intent(in) :: leg
    !> Wall hits in the channel before.
    integer(int64), intent(in) :: hits

    among%count = among%count + 1
    among%travel(among%count) = travel_type(particle=particle, side=side, now=leg, hits=hits)
  end subroutine add_travel

  !> Flies all visits of the batch to their ends, but not beyond the time `limit`.
  subroutine travel(among, table, limit)
    type(among_type), intent(inout) :: among
    type(table_type), intent(in) :: table
    !> On the clock of the page; who has not ended then is there with the heading `open_end`.
    real(wp), intent(in) :: limit
    integer :: side, j, open, kept

    open = among%count
    do j = 1, open
      among%open(j) = j
    end do
    do
      kept = 0
      do j = 1, open
        among%open(kept + 1) = among%open(j)
        associate (at => among%travel(among%open(j)))
          if (at%heading == open_end .and. at%now%time < limit) kept = kept + 1
        end associate
      end do
      open = kept
      if (open == 0) exit
      ! Urns that are alike share a batch.
      if (alike(table%urn)) then
        call go_through_urn(among, table, 1, 2, open, limit)
      else
        call go_through_urn(among, table, 1, 1, open, limit)
        call go_through_urn(among, table, 2, 2, open, limit)
      end if
      do side = 1, 2
        call go_through_half(among, table, side, open, limit)
      end do
    end do
  end subroutine travel

  !> Those who are in the urn of a side, to its openings.
  subroutine go_through_urn(among, table, first, last, open, limit)
    type(among_type), intent(inout) :: among
    type(table_type), intent(in) :: table
    !> Sides.
    integer, intent(in) :: first, last
    !> How many visits have not ended.
    integer, intent(in) :: open
    real(wp), intent(in) :: limit
    integer :: j, k

    associate (v => among%visits)
      call reserve_visits(v, open)
      do k = 1, open
        j = among%open(k)
        associate (at => among%travel(j))
          if (at%now%chamber /= in_urn .or. at%side < first .or. at%side > last) cycle
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
        call leave_urn(table, v, k, limit, among%travel(v%particle(k)))
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
    real(wp) :: position(2), velocity(2), leaves
    integer(int64) :: later
    logical :: stays

    leaves = at%now%time + v%length(k)
    at%hits = at%hits + int(v%hits(k), int64)
    stays = v%channel(k) /= gated .and. v%channel(k) /= ungated
    if (v%channel(k) == goes_on .and. leaves < limit) then
      ! Gone on with from half the part, so that what comes after is no sooner than the lookahead.
      call place_for_ever(table%urn(at%side), -v%through(k), v%y(k), v%along(k), v%across(k), &
        position, velocity, later)
      at%now = leg_type(leaves - v%through(k), position(1), position(2), velocity(1), velocity(2), &
        in_urn)
      at%heading = in_parts
      at%hits = at%hits + later
    else if (limit < huge(1.0_wp) .and. (stays .or. leaves > limit)) then
      if (stays) then
        call place_for_ever(table%urn(at%side), limit - leaves, v%y(k), v%along(k), v%across(k), &
          position, velocity, later)
        at%hits = at%hits + later
      else
        call place_before(table%urn(at%side), int(v%channel(k)), v%y(k), v%along(k), v%across(k), &
          leaves - limit, position, velocity, later)
        at%hits = at%hits - later
      end if
      at%now = leg_type(limit, position(1), position(2), velocity(1), velocity(2), in_urn)
    else if (v%channel(k) == ungated) then
      at%now = leg_type(leaves, table%scattered(at%side)%length, v%y(k), -v%along(k), &
        v%across(k), in_return)
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
  subroutine go_through_half(among, table, side, open, limit)
    type(among_type), intent(inout) :: among
    type(table_type), intent(in) :: table
    integer, intent(in) :: side
    !> How many visits have not ended, but for those that just have.
    integer, intent(in) :: open
    real(wp), intent(in) :: limit
    integer :: j, k, at_open

    associate (s => among%strays)
      call reserve_strays(s, open)
      do at_open = 1, open
        j = among%open(at_open)
        associate (at => among%travel(j))
          if (at%now%chamber /= in_return .or. at%side /= side) cycle
          if (at%heading /= open_end .or. at%now%time >= limit) cycle
          k = s%count + 1
          s%count = k
          s%particle(k) = j
          s%x(k) = at%now%x
          s%y(k) = at%now%y
          s%ux(k) = at%now%ux
          s%uy(k) = at%now%uy
          s%time(k) = limit - at%now%time
        end associate
      end do
      if (s%count == 0) return
      call cross_half(table%scattered(side), s)
      do k = 1, s%count
        call leave_half(table, s, k, limit, among%travel(s%particle(k)))
      end do
    end associate
  end subroutine go_through_half

  !> What becomes of a visit at the end of its way through a half of channel 2.
  pure subroutine leave_half(table, s, k, limit, at)
    type(table_type), intent(in) :: table
    type(strays_type), intent(in) :: s
    !> Its place in the batch.
    integer, intent(in) :: k
    real(wp), intent(in) :: limit
    type(travel_type), intent(inout) :: at
    real(wp) :: height
    integer(wall_kind) :: met

    associate (half => table%scattered(at%side), urn => table%urn(at%side))
      height = sign(min(abs(s%y(k)), half%half_width), s%y(k))
      at%hits = at%hits + int(s%hits(k), int64)
      at%now = leg_type(at%now%time + s%time(k), s%x(k), height, s%ux(k), s%uy(k), in_return)
      met = nint(s%met(k), wall_kind)
      if (met == meets_nothing) then
        at%now%time = limit
      else if (met == meets_urn) then
        at%now%x = -urn%chord(ungated)
        at%now%chamber = in_urn
      else
        at%heading = merge(to_return, in_parts, met == meets_line)
        at%y = height
        at%along = abs(s%ux(k))
        at%across = s%uy(k)
        at%through = 0.0_wp
      end if
    end associate
  end subroutine leave_half

  !> Writes down how the particles of a batch go on.
  pure subroutine settle(among, flight, known_hits)
    type(among_type), intent(in) :: among
    type(flight_type), intent(inout) :: flight(:)
    !> Grows by the wall hits of the visits.
    integer(int64), intent(inout) :: known_hits
    integer :: j

    do j = 1, among%count
      associate (at => among%travel(j), its => flight(among%travel(j)%particle))
        its%heading = at%heading
        its%urn = int(at%side, int16)
        its%time = at%now%time
        its%y = at%y
        its%along = at%along
        its%across = at%across
        its%through = at%through
        its%length = at%now%time - among%leg(at%particle)%time
        its%due = merge(huge(1.0_wp), at%now%time, at%heading == parked_in_urn)
        known_hits = known_hits + at%hits
      end associate
    end do
  end subroutine settle

  !> Where a particle is now within its visit, or in the gate before that, in the frame of the
  !> table, and by how many wall hits `known_hits` is short for it (negative: so many are still to
  !> come).
  subroutine replay(table, leg, side, now, state, hits)
    type(table_type), intent(in) :: table
    !> How its visit began.
    type(leg_type), intent(in) :: leg
    !> On which side of the table.
    integer, intent(in) :: side
    !> The time, on the clock of the page.
    real(wp), intent(in) :: now
    !> x, y, u_x, u_y.
    real(wp), intent(out) :: state(4)
    !> Of either sign.
    integer(int64), intent(out) :: hits
    type(among_type) :: whole, part
    real(wp) :: before, turned, passed
    type(leg_type) :: here

    call new_among(whole, 1)
    call reserve_travels(whole, 1)
    call add_travel(whole, 1, side, leg, 0_int64)
    part = whole
    call travel(whole, table, huge(1.0_wp))
    if (now > leg%time) call travel(part, table, now)
    here = part%travel(1)%now
    hits = part%travel(1)%hits - whole%travel(1)%hits
    associate (urn => table%urn(side))
      before = leg%time - now
      if (leg%chamber == in_urn .and. before > 0.0_wp) then
        call fold(leg%y - leg%uy*before, urn%width(gated), here%y, turned, passed)
        here%x = leg%x + min(abs(leg%ux)*before, 0.5_wp*urn%length(gated))
        here%uy = turned*leg%uy
        hits = hits - int(passed, int64)
      end if
      state = [urn%way*(here%x - merge(urn%periodic_line, urn%centre, here%chamber == in_return)), &
        here%y, urn%way*here%ux, here%uy]
    end associate
  end subroutine replay

  !> How the visits of all began, through a stream.
  subroutine pass_legs(among, stream)
    type(among_type), intent(inout) :: among
    type(stream_type), intent(inout) :: stream

    call stream%pass('leg_time', among%leg%time, 'leg_x', among%leg%x, 'leg_y', among%leg%y, &
      'leg_ux', among%leg%ux, 'leg_uy', among%leg%uy)
    call stream%pass('leg_chamber', among%leg%chamber)
  end subroutine pass_legs

end module battery_among

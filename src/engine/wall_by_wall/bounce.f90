!> One particle from event to event: what it meets next and when, and what that does to it.
!>
!> Direct geometry in the coordinates of the table: a line and a circle in an urn, a line and two
!> straight walls in a channel. Chords, the middle line and the periodic line are met like walls,
!> but do not reflect. What a particle can meet follows from the chamber it is in and from the
!> direction in which it moves, never from its distance to a wall: so nothing has to be nudged. It
!> is put exactly on what it meets; its speed is set back to 1 by a Newton step at each arc.
!>
!> In an urn, (qx, qy) is the position seen from the centre of the urn, with x turned over in urn 1,
!> so that channel 1 lies at -x and channel 2 at +x for both.
module battery_bounce
  use battery_kinds, only: wp, int8
  use battery_powers, only: power_above
  use battery_table, only: table_type, gated, ungated, in_urn, in_gate, in_return, side_at, &
    chamber_at, beyond, is_open, x_direction
  implicit none (type, external)
  private
  public :: walls_type, side_type, motion_type, new_walls, put_down, take_off, fly
  public :: hit_arc, hit_channel
  public :: enter_channel, leave_channel, cross_line, turn_back
  public :: heads_for_middle, time_to_middle, is_trapped
  public :: meets_arc, meets_wall, meets_gate, meets_return, meets_urn, meets_line, meets_nothing

  !> What a particle meets next: the arc of its urn, the wall of its channel, the chord where
  !> channel 1 or channel 2 begins, the chord where an urn begins, the line of its channel (the
  !> middle line or the periodic one), nothing at all.
  integer(int8), parameter :: meets_arc = 1_int8, meets_wall = 2_int8, meets_gate = 3_int8, &
    meets_return = 4_int8, meets_urn = 5_int8, meets_line = 6_int8, meets_nothing = 7_int8

  !> A velocity across or along a channel below this is as good as none: a division by it is huge,
  !> but does not overflow.
  real(wp), parameter :: slowest = sqrt(tiny(1.0_wp))

  !> What a flight through the urn of a side needs to know.
  type :: side_type
    !> 1 over the square of the radius of the urn; |x| of its centre, and the way along x to it.
    real(wp) :: curvature2 = 0.0_wp, centre = 0.0_wp, out = 0.0_wp
    !> Distances of the chords of the channels from the centre, and half widths of those.
    real(wp) :: chord(2) = 0.0_wp, half(2) = 0.0_wp
    !> Shortest flight that a clock within a page can tell from none.
    real(wp) :: shortest = 0.0_wp
  end type side_type

  !> What a motion needs to know of the table.
  type :: walls_type
    type(side_type) :: side(2)
    !> Squares of the radii of the urns; half widths of the channels.
    real(wp) :: radius2(2) = 0.0_wp, half(2) = 0.0_wp
    !> |x| where channel 1 ends, and, for each side, where channel 2 begins and ends.
    real(wp) :: gate_end = 0.0_wp, return_begin(2) = 0.0_wp, return_end(2) = 0.0_wp
    !> Where one is that has crossed a line from each side.
    integer(int8) :: beyond(2) = 0_int8
    !> A power of two, at least four times the longest flight. Clocks are re-based by it.
    real(wp) :: page = 0.0_wp
  end type walls_type

  !> Where a particle was at its last event, and how it has been moving since.
  type :: motion_type
    real(wp) :: x = 0.0_wp, y = 0.0_wp, ux = 0.0_wp, uy = 0.0_wp
    !> When that was.
    real(wp) :: time = 0.0_wp
    !> Side and chamber (`in_urn` ...) it is in, and what it meets next (`meets_arc` ...).
    integer(int8) :: side = 0_int8, chamber = 0_int8, next = 0_int8
  end type motion_type

contains

  !> What the motions on a table need to know of it.
  pure function new_walls(table) result(walls)
    type(table_type), intent(in) :: table
    type(walls_type) :: walls
    real(wp) :: longest
    integer :: side

    do side = 1, 2
      associate (urn => table%urn(side), w => walls%side(side))
        walls%radius2(side) = urn%radius**2
        w%curvature2 = 1.0_wp/walls%radius2(side)
        w%centre = urn%centre
        w%out = x_direction(side)
        w%chord = urn%chord
        w%half = 0.5_wp*table%channel%width
        walls%return_begin(side) = urn%centre + urn%chord(ungated)
        walls%return_end(side) = urn%periodic_line
      end associate
      walls%beyond(side) = int(beyond(table, side), int8)
    end do
    walls%half = 0.5_wp*table%channel%width
    walls%gate_end = 0.5_wp*table%channel(gated)%length
    longest = max(2.0_wp*maxval(table%urn%radius), maxval(hypot(table%channel%length, &
      table%channel%width), mask=is_open(table%channel)))
    walls%page = power_above(4.0_wp*longest)
    walls%side%shortest = epsilon(1.0_wp)*walls%page
  end function new_walls

  !> A particle at a place, with a velocity of length 1.
  pure function put_down(table, x, y, ux, uy) result(motion)
    type(table_type), intent(in) :: table
    !> In the frame of the table; lengths, and components of the velocity.
    real(wp), intent(in) :: x, y, ux, uy
    type(motion_type) :: motion

    motion = motion_type(x=x, y=y, ux=ux, uy=uy, side=int(side_at(table, x), int8), &
      chamber=int(chamber_at(table, x, y, huge(1.0_wp)), int8))
  end function put_down

  !> The first flight of a particle that was put down; `wait` is the time until it meets what it
  !> meets first.
  pure subroutine take_off(walls, motion, wait)
    type(walls_type), intent(in) :: walls
    type(motion_type), intent(inout) :: motion
    real(wp), intent(out) :: wait
    real(wp) :: qx, room

    if (motion%chamber /= in_urn) then
      call aim_in_channel(walls, motion, wait)
    else
      associate (w => walls%side(motion%side), out => x_direction(motion%side))
        qx = out*motion%x - w%centre
        room = max(walls%radius2(motion%side) - (qx**2 + motion%y**2), 0.0_wp)
        call aim_in_urn(w, motion, qx, out*motion%ux, room, wait)
      end associate
    end if
  end subroutine take_off

  !> Moves straight on for a while.
  elemental subroutine fly(motion, time)
    type(motion_type), intent(inout) :: motion
    !> How long.
    real(wp), intent(in) :: time

    motion%x = motion%x + motion%ux*time
    motion%y = motion%y + motion%uy*time
  end subroutine fly

  !> Reflection from the arc of an urn. From a point of the circle the flight to the next one lasts
  !> -2 q.u: no root, nothing to cancel.
  pure subroutine hit_arc(w, motion, wait)
    !> The side that the particle is on.
    type(side_type), intent(in) :: w
    type(motion_type), intent(inout) :: motion
    !> Time until it meets what it meets next; huge if that is nothing.
    real(wp), intent(out) :: wait
    real(wp) :: out, qx, qy, vx, vy, norm, outward, kick

    out = w%out
    qx = out*motion%x - w%centre
    qy = motion%y
    norm = 1.5_wp - 0.5_wp*w%curvature2*(qx**2 + qy**2)
    qx = norm*qx
    qy = norm*qy
    vx = out*motion%ux
    vy = motion%uy
    outward = qx*vx + qy*vy
    ! A grazing particle may move inwards already, by rounding; then the hit leaves it alone.
    kick = 2.0_wp*w%curvature2*max(outward, 0.0_wp)
    vx = vx - kick*qx
    vy = vy - kick*qy
    norm = 1.5_wp - 0.5_wp*(vx**2 + vy**2)
    vx = norm*vx
    vy = norm*vy
    wait = 2.0_wp*abs(outward)
    motion%x = out*(w%centre + qx)
    motion%y = qy
    motion%ux = out*vx
    motion%uy = vy
    if (wait < w%shortest) then
      ! Along the wall: chords too short for any clock. It would hit for ever at one instant.
      motion%next = meets_nothing
      wait = huge(1.0_wp)
    else
      call choose_opening(w, motion, qx, vx, qx + vx*wait, qy + vy*wait, wait)
    end if
  end subroutine hit_arc

  !> From a point inside an urn to the arc or to an opening; `room` is r**2 - q**2, which the caller
  !> may know better than by that difference.
  pure subroutine aim_in_urn(w, motion, qx, vx, room, wait)
    type(side_type), intent(in) :: w
    type(motion_type), intent(inout) :: motion
    real(wp), intent(in) :: qx, vx, room
    real(wp), intent(out) :: wait
    real(wp) :: outward, root

    outward = qx*vx + motion%y*motion%uy
    root = sqrt(outward**2 + room)
    if (outward > 0.0_wp) then
      wait = room/(root + outward)
    else
      wait = root - outward
    end if
    call choose_opening(w, motion, qx, vx, qx + vx*wait, motion%y + motion%uy*wait, wait)
  end subroutine aim_in_urn

  !> What is met in an urn by a particle that would be on the circle at (px, py) after `wait`. Only
  !> a point within an opening, its ends excluded, lets it out: a corner belongs to the urn.
  pure subroutine choose_opening(w, motion, qx, vx, px, py, wait)
    type(side_type), intent(in) :: w
    type(motion_type), intent(inout) :: motion
    real(wp), intent(in) :: qx, vx, px, py
    real(wp), intent(inout) :: wait

    motion%next = meets_arc
    if (abs(py) >= merge(w%half(gated), w%half(ungated), px < 0.0_wp)) return
    ! By rounding the point may seem to lie just inside of a corner though the way leads inwards.
    if (px < 0.0_wp .and. vx < 0.0_wp) then
      motion%next = meets_gate
      wait = min(max(qx + w%chord(gated), 0.0_wp)/max(-vx, slowest), wait)
    else if (px >= 0.0_wp .and. vx > 0.0_wp) then
      motion%next = meets_return
      wait = min(max(w%chord(ungated) - qx, 0.0_wp)/max(vx, slowest), wait)
    end if
  end subroutine choose_opening

  !> What is met in a channel. A wall met at the same time as a chord is met first: the corner
  !> belongs to the channel.
  pure subroutine aim_in_channel(walls, motion, wait)
    type(walls_type), intent(in) :: walls
    type(motion_type), intent(inout) :: motion
    real(wp), intent(out) :: wait
    real(wp) :: out, depth, distance, half, to_wall

    out = x_direction(motion%side)
    depth = out*motion%x
    motion%next = meets_line
    if (motion%chamber == in_gate) then
      half = walls%half(gated)
      distance = depth
      if (out*motion%ux >= 0.0_wp) then
        distance = walls%gate_end - depth
        motion%next = meets_urn
      end if
    else
      half = walls%half(ungated)
      distance = walls%return_end(motion%side) - depth
      if (out*motion%ux <= 0.0_wp) then
        distance = depth - walls%return_begin(motion%side)
        motion%next = meets_urn
      end if
    end if
    wait = max(distance, 0.0_wp)/max(abs(motion%ux), slowest)
    to_wall = max(half - sign(1.0_wp, motion%uy)*motion%y, 0.0_wp)/max(abs(motion%uy), slowest)
    if (to_wall <= wait) then
      wait = to_wall
      motion%next = meets_wall
    end if
  end subroutine aim_in_channel

  !> Reflection from the wall of a channel.
  pure subroutine hit_channel(walls, motion, wait)
    type(walls_type), intent(in) :: walls
    type(motion_type), intent(inout) :: motion
    !> Time until it meets what it meets next.
    real(wp), intent(out) :: wait

    motion%y = sign(half_width(walls, motion), motion%uy)
    motion%uy = -motion%uy
    call aim_in_channel(walls, motion, wait)
  end subroutine hit_channel

  !> From an urn through a chord into a gate or into channel 2, whichever was met.
  pure subroutine enter_channel(walls, motion, wait)
    type(walls_type), intent(in) :: walls
    type(motion_type), intent(inout) :: motion
    !> Time until it meets what it meets next.
    real(wp), intent(out) :: wait

    if (motion%next == meets_gate) then
      motion%x = x_direction(motion%side)*walls%gate_end
      motion%chamber = int(in_gate, int8)
    else
      motion%x = x_direction(motion%side)*walls%return_begin(motion%side)
      motion%chamber = int(in_return, int8)
    end if
    motion%y = within(motion%y, half_width(walls, motion))
    call aim_in_channel(walls, motion, wait)
  end subroutine enter_channel

  !> From a channel through a chord into an urn.
  pure subroutine leave_channel(walls, motion, wait)
    type(walls_type), intent(in) :: walls
    type(motion_type), intent(inout) :: motion
    !> Time until it meets what it meets next.
    real(wp), intent(out) :: wait
    real(wp) :: half, qx, room

    half = half_width(walls, motion)
    associate (w => walls%side(motion%side), out => x_direction(motion%side))
      if (motion%chamber == in_gate) then
        qx = -w%chord(gated)
        motion%x = out*walls%gate_end
      else
        qx = w%chord(ungated)
        motion%x = out*walls%return_begin(motion%side)
      end if
      motion%chamber = int(in_urn, int8)
      motion%y = within(motion%y, half)
      ! On a chord, r**2 - q**2 is a product that stays exact however narrow the channel is.
      room = (half - abs(motion%y))*(half + abs(motion%y))
      call aim_in_urn(w, motion, qx, out*motion%ux, room, wait)
    end associate
  end subroutine leave_channel

  !> Over the line of a channel: the middle line, the periodic line, from one end of the table to
  !> the other, or back from a line that is an end wall.
  pure subroutine cross_line(walls, motion, wait)
    type(walls_type), intent(in) :: walls
    type(motion_type), intent(inout) :: motion
    !> Time until it meets what it meets next.
    real(wp), intent(out) :: wait
    integer(int8) :: to

    to = walls%beyond(motion%side)
    if (to == motion%side) motion%ux = -motion%ux
    motion%side = to
    motion%x = 0.0_wp
    if (motion%chamber == in_return) motion%x = x_direction(to)*walls%return_end(to)
    motion%y = within(motion%y, half_width(walls, motion))
    call aim_in_channel(walls, motion, wait)
  end subroutine cross_line

  !> A gate turns the particle back; it has been moved to where it is now.
  pure subroutine turn_back(walls, motion, wait)
    type(walls_type), intent(in) :: walls
    type(motion_type), intent(inout) :: motion
    !> Time until it meets what it meets next.
    real(wp), intent(out) :: wait

    motion%ux = -motion%ux
    motion%y = within(motion%y, walls%half(gated))
    call aim_in_channel(walls, motion, wait)
  end subroutine turn_back

  !> Whether a particle in channel 1 is on its way to the other gate. Whoever is came from the urn
  !> and was not turned back.
  elemental function heads_for_middle(motion) result(heads)
    type(motion_type), intent(in) :: motion
    logical :: heads

    heads = motion%chamber == in_gate .and. x_direction(motion%side)*motion%ux < 0.0_wp
  end function heads_for_middle

  !> How long a particle of channel 1 that heads for the middle line takes to it.
  elemental function time_to_middle(motion) result(time)
    type(motion_type), intent(in) :: motion
    real(wp) :: time

    time = abs(motion%x)/max(abs(motion%ux), slowest)
  end function time_to_middle

  !> Whether a particle can never leave where it is: across a channel, or along an arc.
  elemental function is_trapped(motion) result(trapped)
    type(motion_type), intent(in) :: motion
    logical :: trapped

    trapped = motion%next == meets_nothing &
      .or. (motion%chamber /= in_urn .and. .not. abs(motion%ux) > 0.0_wp)
  end function is_trapped

  !> Half width of the channel that a particle is in.
  elemental function half_width(walls, motion) result(half)
    type(walls_type), intent(in) :: walls
    type(motion_type), intent(in) :: motion
    real(wp) :: half

    half = merge(walls%half(gated), walls%half(ungated), motion%chamber == in_gate)
  end function half_width

  !> y, but not beyond the walls.
  elemental function within(y, half) result(height)
    real(wp), intent(in) :: y, half
    real(wp) :: height

    height = sign(min(abs(y), half), y)
  end function within

end module battery_bounce

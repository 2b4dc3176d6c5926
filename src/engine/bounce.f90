!> One particle from event to event: what it meets next and when, and what that does to it.
!>
!> Direct geometry in the coordinates of the table: a line and a circle in an urn, a line and two
!> straight walls in a channel. Chords, the middle line and the periodic line are met like walls,
!> but do not reflect. What a particle can meet follows from the region it is in and from the
!> direction in which it moves, never from its distance to a wall: so nothing has to be nudged. It
!> is put exactly on what it meets; its speed is set back to 1 by a Newton step at each arc.
!>
!> In an urn, (qx, qy) is the position seen from the centre of the urn, with x turned over in urn 1,
!> so that channel 1 lies at -x and channel 2 at +x for both.
module battery_bounce
  use battery_kinds, only: wp, int8
  use battery_powers, only: power_above
  use battery_table, only: table_type, shape_urn, region_at, urn_one, urn_two, gate_one, gate_two, &
    return_one, return_two
  implicit none (type, external)
  private
  public :: walls_type, flight_type, new_walls, take_off, fly, hit_arc, hit_channel
  public :: enter_channel, leave_channel, cross_middle_line, cross_periodic_line, reverse
  public :: heads_for_middle, on_side_one, is_trapped
  public :: meets_arc, meets_wall, meets_gate, meets_return, meets_urn, meets_middle
  public :: meets_period, meets_nothing

  !> What a particle meets next: the arc of its urn, the wall of its channel, the chord where
  !> channel 1 or channel 2 begins, the chord where an urn begins, the middle of channel 1 (the end
  !> wall of `shape_urn`), the periodic line, nothing at all.
  integer(int8), parameter :: meets_arc = 1_int8, meets_wall = 2_int8, meets_gate = 3_int8, &
    meets_return = 4_int8, meets_urn = 5_int8, meets_middle = 6_int8, meets_period = 7_int8, &
    meets_nothing = 8_int8

  !> A velocity across or along a channel below this is as good as none: a division by it is huge,
  !> but does not overflow.
  real(wp), parameter :: slowest = sqrt(tiny(1.0_wp))

  !> What a flight needs to know of the table.
  type :: walls_type
    !> Square of the radius of an urn, and 1 over it; distance of its centre from the origin.
    real(wp) :: radius2 = 0.0_wp, curvature2 = 0.0_wp, centre = 0.0_wp
    !> Half widths of the channels, and distances of their chords from the centre.
    real(wp) :: half1 = 0.0_wp, half2 = 0.0_wp, chord1 = 0.0_wp, chord2 = 0.0_wp
    !> |x| where channel 1 ends, and where channel 2 begins and ends.
    real(wp) :: gate_end = 0.0_wp, return_begin = 0.0_wp, return_end = 0.0_wp
    !> Whether the middle line of channel 1 is a wall.
    logical :: end_wall = .false.
    !> A power of two, at least four times the longest flight. Clocks are re-based by it.
    real(wp) :: page = 0.0_wp
    !> Shortest flight that a clock within a page can tell from none.
    real(wp) :: shortest = 0.0_wp
  end type walls_type

  !> Where a particle was at its last event, and how it has been moving since.
  type :: flight_type
    real(wp) :: x = 0.0_wp, y = 0.0_wp, ux = 0.0_wp, uy = 0.0_wp
    !> When that was.
    real(wp) :: time = 0.0_wp
    !> Region (`urn_one` ...) and what it meets next (`meets_arc` ...).
    integer(int8) :: region = 0_int8, next = 0_int8
  end type flight_type

contains

  pure function new_walls(table) result(walls)
    type(table_type), intent(in) :: table
    type(walls_type) :: walls
    real(wp) :: longest

    walls%radius2 = table%urn_radius**2
    walls%curvature2 = 1.0_wp/walls%radius2
    walls%centre = table%urn_centre
    walls%half1 = 0.5_wp*table%channel1_width
    walls%half2 = 0.5_wp*table%channel2_width
    walls%chord1 = table%chord1_distance
    walls%chord2 = table%chord2_distance
    walls%gate_end = 0.5_wp*table%channel1_length
    walls%return_begin = table%urn_centre + table%chord2_distance
    walls%return_end = table%periodic_line
    walls%end_wall = table%shape == shape_urn
    longest = max(2.0_wp*table%urn_radius, hypot(table%channel1_length, table%channel1_width))
    if (table%channel2_width > 0.0_wp) longest = max(longest, hypot(table%channel2_length, &
      table%channel2_width))
    walls%page = power_above(4.0_wp*longest)
    walls%shortest = epsilon(1.0_wp)*walls%page
  end function new_walls

  !> The first flight of a particle whose position and velocity are set; `wait` is the time until it
  !> meets what it meets first.
  pure subroutine take_off(table, walls, flight, wait)
    type(table_type), intent(in) :: table
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(out) :: wait
    real(wp) :: side, qx, room

    flight%region = int(region_at(table, flight%x, flight%y, huge(1.0_wp)), int8)
    if (walls%end_wall .and. flight%region == gate_two) flight%region = int(gate_one, int8)
    if (flight%region > urn_two) then
      call aim_in_channel(walls, flight, wait)
    else
      side = side_of(flight)
      qx = side*flight%x - walls%centre
      room = max(walls%radius2 - (qx**2 + flight%y**2), 0.0_wp)
      call aim_in_urn(walls, flight, qx, side*flight%ux, room, wait)
    end if
  end subroutine take_off

  !> Moves straight on for a while.
  elemental subroutine fly(flight, time)
    type(flight_type), intent(inout) :: flight
    real(wp), intent(in) :: time

    flight%x = flight%x + flight%ux*time
    flight%y = flight%y + flight%uy*time
  end subroutine fly

  !> Reflection from the arc of an urn. From a point of the circle the flight to the next one lasts
  !> -2 q.u: no root, nothing to cancel.
  pure subroutine hit_arc(walls, flight, wait)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(out) :: wait
    real(wp) :: side, qx, qy, vx, vy, norm, outward, kick

    side = side_of(flight)
    qx = side*flight%x - walls%centre
    qy = flight%y
    norm = 1.5_wp - 0.5_wp*walls%curvature2*(qx**2 + qy**2)
    qx = norm*qx
    qy = norm*qy
    vx = side*flight%ux
    vy = flight%uy
    outward = qx*vx + qy*vy
    ! A grazing particle may move inwards already, by rounding; then the hit leaves it alone.
    kick = 2.0_wp*walls%curvature2*max(outward, 0.0_wp)
    vx = vx - kick*qx
    vy = vy - kick*qy
    norm = 1.5_wp - 0.5_wp*(vx**2 + vy**2)
    vx = norm*vx
    vy = norm*vy
    wait = 2.0_wp*abs(outward)
    flight%x = side*(walls%centre + qx)
    flight%y = qy
    flight%ux = side*vx
    flight%uy = vy
    if (wait < walls%shortest) then
      ! Along the wall: chords too short for any clock. It would hit for ever at one instant.
      flight%next = meets_nothing
      wait = huge(1.0_wp)
    else
      call choose_opening(walls, flight, qx, vx, qx + vx*wait, qy + vy*wait, wait)
    end if
  end subroutine hit_arc

  !> From a point inside an urn to the arc or to an opening; `room` is r**2 - q**2, which the caller
  !> may know better than by that difference.
  pure subroutine aim_in_urn(walls, flight, qx, vx, room, wait)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(in) :: qx, vx, room
    real(wp), intent(out) :: wait
    real(wp) :: outward, root

    outward = qx*vx + flight%y*flight%uy
    root = sqrt(outward**2 + room)
    if (outward > 0.0_wp) then
      wait = room/(root + outward)
    else
      wait = root - outward
    end if
    call choose_opening(walls, flight, qx, vx, qx + vx*wait, flight%y + flight%uy*wait, wait)
  end subroutine aim_in_urn

  !> What is met in an urn by a particle that would be on the circle at (px, py) after `wait`. Only
  !> a point within an opening, its ends excluded, lets it out: a corner belongs to the urn.
  pure subroutine choose_opening(walls, flight, qx, vx, px, py, wait)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(in) :: qx, vx, px, py
    real(wp), intent(inout) :: wait

    flight%next = meets_arc
    if (abs(py) >= merge(walls%half1, walls%half2, px < 0.0_wp)) return
    ! By rounding the point may seem to lie just inside of a corner though the way leads inwards.
    if (px < 0.0_wp .and. vx < 0.0_wp) then
      flight%next = meets_gate
      wait = min(max(qx + walls%chord1, 0.0_wp)/max(-vx, slowest), wait)
    else if (px >= 0.0_wp .and. vx > 0.0_wp) then
      flight%next = meets_return
      wait = min(max(walls%chord2 - qx, 0.0_wp)/max(vx, slowest), wait)
    end if
  end subroutine choose_opening

  !> What is met in a channel. A wall met at the same time as a chord is met first: the corner
  !> belongs to the channel.
  pure subroutine aim_in_channel(walls, flight, wait)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(out) :: wait
    real(wp) :: side, depth, distance, half, to_wall

    side = side_of(flight)
    depth = side*flight%x
    if (flight%region <= gate_two) then
      half = walls%half1
      if (heads_for_middle(flight)) then
        distance = depth
        flight%next = meets_middle
      else
        distance = walls%gate_end - depth
        flight%next = meets_urn
      end if
    else
      half = walls%half2
      if (side*flight%ux > 0.0_wp) then
        distance = walls%return_end - depth
        flight%next = meets_period
      else
        distance = depth - walls%return_begin
        flight%next = meets_urn
      end if
    end if
    wait = max(distance, 0.0_wp)/max(abs(flight%ux), slowest)
    to_wall = max(half - sign(1.0_wp, flight%uy)*flight%y, 0.0_wp)/max(abs(flight%uy), slowest)
    if (to_wall <= wait) then
      wait = to_wall
      flight%next = meets_wall
    end if
  end subroutine aim_in_channel

  !> Reflection from the wall of a channel.
  pure subroutine hit_channel(walls, flight, wait)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(out) :: wait

    flight%y = sign(half_width(walls, flight), flight%uy)
    flight%uy = -flight%uy
    call aim_in_channel(walls, flight, wait)
  end subroutine hit_channel

  !> From an urn through a chord into a gate or into channel 2, whichever was met.
  pure subroutine enter_channel(walls, flight, wait)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(out) :: wait

    if (flight%next == meets_gate) then
      flight%x = side_of(flight)*walls%gate_end
      flight%region = flight%region + int(gate_one - urn_one, int8)
    else
      flight%x = side_of(flight)*walls%return_begin
      flight%region = flight%region + int(return_one - urn_one, int8)
    end if
    flight%y = within(flight%y, half_width(walls, flight))
    call aim_in_channel(walls, flight, wait)
  end subroutine enter_channel

  !> From a channel through a chord into an urn.
  pure subroutine leave_channel(walls, flight, wait)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(out) :: wait
    real(wp) :: side, half, qx, room

    half = half_width(walls, flight)
    side = side_of(flight)
    if (flight%region <= gate_two) then
      qx = -walls%chord1
      flight%x = side*walls%gate_end
      flight%region = flight%region - int(gate_one - urn_one, int8)
    else
      qx = walls%chord2
      flight%x = side*walls%return_begin
      flight%region = flight%region - int(return_one - urn_one, int8)
    end if
    flight%y = within(flight%y, half)
    ! On a chord, r**2 - q**2 is a product that stays exact however narrow the channel is.
    room = (half - abs(flight%y))*(half + abs(flight%y))
    call aim_in_urn(walls, flight, qx, side*flight%ux, room, wait)
  end subroutine leave_channel

  !> Over the middle of channel 1, or back from the end wall.
  pure subroutine cross_middle_line(walls, flight, wait)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(out) :: wait

    flight%x = 0.0_wp
    flight%y = within(flight%y, walls%half1)
    if (walls%end_wall) then
      flight%ux = -flight%ux
    else
      flight%region = int(gate_one + gate_two, int8) - flight%region
    end if
    call aim_in_channel(walls, flight, wait)
  end subroutine cross_middle_line

  !> Over the periodic line, from one end of the table to the other.
  pure subroutine cross_periodic_line(walls, flight, wait)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(out) :: wait

    flight%region = int(return_one + return_two, int8) - flight%region
    flight%x = side_of(flight)*walls%return_end
    flight%y = within(flight%y, walls%half2)
    call aim_in_channel(walls, flight, wait)
  end subroutine cross_periodic_line

  !> A gate turns the particle back; it has been moved to where it is now.
  pure subroutine reverse(walls, flight, wait)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(inout) :: flight
    real(wp), intent(out) :: wait

    flight%ux = -flight%ux
    flight%y = within(flight%y, walls%half1)
    call aim_in_channel(walls, flight, wait)
  end subroutine reverse

  !> Whether a particle in channel 1 is on its way to the other gate. Whoever is came from the urn
  !> and was not turned back: those are the ones a gate counts.
  elemental function heads_for_middle(flight) result(heads)
    type(flight_type), intent(in) :: flight
    logical :: heads

    heads = (flight%region == gate_one .and. flight%ux > 0.0_wp) &
      .or. (flight%region == gate_two .and. flight%ux < 0.0_wp)
  end function heads_for_middle

  !> Whether a particle is in urn 1, its gate or its half of channel 2.
  elemental function on_side_one(flight) result(is_one)
    type(flight_type), intent(in) :: flight
    logical :: is_one

    is_one = btest(flight%region, 0)
  end function on_side_one

  !> Whether a particle can never leave where it is: across a channel, or along an arc.
  elemental function is_trapped(flight) result(trapped)
    type(flight_type), intent(in) :: flight
    logical :: trapped

    trapped = flight%next == meets_nothing &
      .or. (flight%region > urn_two .and. .not. abs(flight%ux) > 0.0_wp)
  end function is_trapped

  !> -1 on the side of urn 1, where x < 0, and 1 on the side of urn 2.
  elemental function side_of(flight) result(side)
    type(flight_type), intent(in) :: flight
    real(wp) :: side

    side = merge(-1.0_wp, 1.0_wp, on_side_one(flight))
  end function side_of

  elemental function half_width(walls, flight) result(half)
    type(walls_type), intent(in) :: walls
    type(flight_type), intent(in) :: flight
    real(wp) :: half

    half = merge(walls%half1, walls%half2, flight%region <= gate_two)
  end function half_width

  !> y, but not beyond the walls.
  elemental function within(y, half) result(height)
    real(wp), intent(in) :: y, half
    real(wp) :: height

    height = sign(min(abs(y), half), y)
  end function within

end module battery_bounce

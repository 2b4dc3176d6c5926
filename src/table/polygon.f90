!> Urn of polygonal shape: its geometry, and the motion from side to side. Its openings are in two
!> upright sides: those that the x axis crosses last, on the right for channel 1 and on the left for
!> channel 2.
!>
!> **Frame.** The origin lies midway between the two upright sides; it may lie outside the polygon.
!> If channel 2 is closed, the leftmost point takes the place of the left side, as the chord of a
!> closed channel is one radius away in a disc.
!>
!> **From side to side.** A corner lies to the right or to the left of a path, never on both sides:
!> a path ends at the nearest side that goes from its right to its left. So a path through a corner
!> hits a side too, and no particle escapes. A particle is placed exactly on the side that it hits;
!> each hit sets its speed to 1 by a Newton step.
!>
!> Periodic orbits are recognised, and passages truncated, by `boundary_state_type`. Batches of
!> passages: `polygon_passages.f90`.
module battery_polygon
  use battery_kinds, only: wp, int64
  use battery_channel, only: channel_type, channel1, channel2, no_channel, facing, is_open
  use battery_urn_shape, only: urn_shape_type, polygon_type, set_openings
  use battery_motion, only: meets_gate, meets_channel2, meets_nothing, meets_wall, wall_kind, &
    least_across
  use battery_corners, only: enclosed_area, reversed_corners, next_corner, distance_to_side, &
    is_on_side, side_distance, side_on_axis
  implicit none (type, external)
  private
  public :: urn_shape_type, polygon_type, new_polygon, is_in_polygon, try_point_in_polygon, &
    nearest_side
  public :: find_next_wall_in_polygon, reflect_in_polygon, reflect_overshoot_in_polygon, &
    locate_in_polygon, find_first_impact_in_polygon
  public :: find_next_side_robustly, reflect_from_side, boundary_state_type, state_on_side, &
    has_returned, add_compensated

  !> Bound on the rounding error of a position on a side, in units of the table.
  real(wp), parameter :: rounding = 64.0_wp*epsilon(1.0_wp)

  !> Sides that lean by less than this, in units of the polygon, count as upright.
  real(wp), parameter, public :: upright = 2.0_wp**13*epsilon(1.0_wp)

  !> A path that passes a corner, or the end of an opening, within this distance, in units of the
  !> reach, meets it: rounding errors of earlier hits may have decided on which side it passes.
  real(wp), parameter :: near = sqrt(epsilon(1.0_wp))

  !> Boundary states that differ by less than this, relative to the outline and to 1, are the same.
  real(wp), parameter :: same_state = 4096.0_wp*epsilon(1.0_wp)

  !> Longest period that is searched for, in wall hits.
  integer, parameter, public :: longest_period = 10000

  !> State right after a hit: arc length along the outline, and velocity.
  type :: boundary_state_type
    real(wp) :: arc_length = 0.0_wp, ux = 0.0_wp, uy = 0.0_wp
  end type boundary_state_type

contains

  !> Polygon with openings; clockwise corners are reversed. If the axis crosses no upright side, or
  !> an opening is wider than its side, it does not fit.
  pure function new_polygon(corners, channel) result(urn)
    !> Columns (x, y), at least 3; the origin may be anywhere on the axis.
    real(wp), intent(in) :: corners(:, :)
    !> Channels at its openings.
    type(channel_type), intent(in) :: channel(2)
    type(urn_shape_type) :: urn
    real(wp) :: corner(2, size(corners, 2)), ends(2)
    integer :: k, n

    n = size(corners, 2)
    corner = corners
    if (enclosed_area(corner) < 0.0_wp) corner = reversed_corners(corner)
    call set_openings(urn, channel)
    urn%polygon%sides = n
    urn%polygon%side = [side_on_axis(corner, 1.0_wp), side_on_axis(corner, -1.0_wp)]
    ends = [maxval(corner(1, :)), minval(corner(1, :))]
    ! The side of a closed channel is a wall like the others.
    where (.not. is_open(channel)) urn%polygon%side = 0
    do k = 1, 2
      if (urn%polygon%side(k) > 0) ends(k) = corner(1, urn%polygon%side(k))
    end do
    urn%polygon%x = [corner(1, :), corner(1, 1)] - 0.5_wp*sum(ends)
    urn%polygon%y = [corner(2, :), corner(2, 1)]
    urn%chord = 0.5_wp*(ends(channel1) - ends(channel2))
    do k = 1, 2
      if (urn%polygon%side(k) == 0) cycle
      if (abs(urn%polygon%x(urn%polygon%side(k) + 1) - urn%polygon%x(urn%polygon%side(k))) &
        > upright*maxval(abs(urn%polygon%x))) cycle
      ! Exactly upright, however the corners were rounded.
      urn%polygon%x(urn%polygon%side(k):urn%polygon%side(k) + 1) = facing(k)*urn%chord(k)
      if (urn%polygon%side(k) == n) urn%polygon%x(1) = urn%polygon%x(n + 1)
      if (urn%polygon%side(k) == 1) urn%polygon%x(n + 1) = urn%polygon%x(1)
    end do
    call measure_outline(urn)
    call measure_openings(urn)
  end function new_polygon

  !> Derives lengths, normals and area from the corners.
  pure subroutine measure_outline(urn)
    type(urn_shape_type), intent(inout) :: urn
    real(wp), allocatable :: along_x(:), along_y(:)
    integer :: n, k

    n = urn%polygon%sides
    along_x = urn%polygon%x(2:) - urn%polygon%x(:n)
    along_y = urn%polygon%y(2:) - urn%polygon%y(:n)
    urn%polygon%length_of = max(hypot(along_x, along_y), tiny(1.0_wp))
    urn%polygon%normal_x = along_y/urn%polygon%length_of
    urn%polygon%normal_y = -along_x/urn%polygon%length_of
    urn%polygon%offset = urn%polygon%normal_x*urn%polygon%x(:n) + &
      urn%polygon%normal_y*urn%polygon%y(:n)
    allocate (urn%polygon%arc_start(n), urn%polygon%half_opening(n))
    urn%polygon%half_opening = -1.0_wp
    urn%polygon%outline_length = 0.0_wp
    urn%polygon%convex = .true.
    do k = 1, n
      urn%polygon%arc_start(k) = urn%polygon%outline_length
      urn%polygon%outline_length = urn%polygon%outline_length + urn%polygon%length_of(k)
      urn%polygon%convex = urn%polygon%convex .and. along_x(k)*along_y(next_corner(k, n)) &
        - along_y(k)*along_x(next_corner(k, n)) >= 0.0_wp
    end do
    urn%area = enclosed_area(reshape([urn%polygon%x(:n), urn%polygon%y(:n)], [2, n], order=[2, 1]))
    urn%perimeter = urn%polygon%outline_length - sum(urn%width)
    urn%truncates_passages = .true.
    urn%overhangs = maxval(urn%polygon%x) > urn%chord(channel1) .or. &
      maxval(-urn%polygon%x) > urn%chord(channel2)
    urn%reach = maxval(hypot(urn%polygon%x, urn%polygon%y))
    urn%polygon%tolerance = rounding*(urn%reach + urn%chord(channel1) + urn%length(channel1))
    call find_clearance(urn)
  end subroutine measure_outline

  !> Computes the distance from the origin to the walls, if the origin is inside, and the longest
  !> step. Twice the area over the length of the outline is the inradius of a regular polygon.
  pure subroutine find_clearance(urn)
    type(urn_shape_type), intent(inout) :: urn
    integer :: j, k, n

    n = urn%polygon%sides
    urn%clear = 0.0_wp
    if (is_in_polygon(urn%polygon, 0.0_wp, 0.0_wp, 0.0_wp)) &
      urn%clear = minval(distances_to_sides(urn%polygon, 0.0_wp, 0.0_wp))
    urn%longest_step = 2.0_wp*urn%area/urn%polygon%outline_length
    if (urn%polygon%convex) return
    do k = 1, n
      do j = k + 2, n
        if (k == 1 .and. j == n) cycle
        urn%longest_step = min(urn%longest_step, side_distance(corner_of(k), &
          corner_of(k + 1), corner_of(j), corner_of(j + 1)))
      end do
    end do

  contains

    !> Coordinates of a corner.
    pure function corner_of(at) result(corner)
      integer, intent(in) :: at
      real(wp) :: corner(2)

      corner = [urn%polygon%x(at), urn%polygon%y(at)]
    end function corner_of

  end subroutine find_clearance

  !> Determines whether the openings fit, and their depths. A path that returns to an opening was
  !> reflected by a side that faces it: its length is at least twice the distance of the nearest
  !> such side. A path from one opening to the other is at least as long as the distance of the
  !> chords.
  pure subroutine measure_openings(urn)
    type(urn_shape_type), intent(inout) :: urn
    real(wp) :: a(2), b(2)
    integer :: channel, k, j

    urn%fits = .true.
    urn%depth = 0.0_wp
    do channel = channel1, channel2
      k = urn%polygon%side(channel)
      if (.not. urn%width(channel) > 0.0_wp) cycle
      if (k == 0) then
        urn%fits = .false.
        cycle
      end if
      urn%polygon%half_opening(k) = urn%half_width(channel)
      if (abs(urn%polygon%normal_y(k)) > 0.0_wp .or. min(abs(urn%polygon%y(k)), &
        abs(urn%polygon%y(k + 1))) <= urn%half_width(channel)) urn%fits = .false.
      a = [urn%polygon%x(k), urn%half_width(channel)]
      b = [urn%polygon%x(k), -urn%half_width(channel)]
      urn%depth(channel) = huge(1.0_wp)
      do j = 1, urn%polygon%sides
        if (urn%polygon%normal_x(j)*facing(channel) < 0.0_wp) urn%depth(channel) = &
          min(urn%depth(channel), side_distance([urn%polygon%x(j), urn%polygon%y(j)], &
          [urn%polygon%x(j + 1), urn%polygon%y(j + 1)], a, b))
      end do
    end do
    if (all(urn%width > 0.0_wp)) urn%depth = min(urn%depth, urn%chord)
  end subroutine measure_openings

  !> Distance from a point to each side.
  pure function distances_to_sides(polygon, x, y) result(distance)
    type(polygon_type), intent(in) :: polygon
    !> Position in the frame of the polygon, lengths.
    real(wp), intent(in) :: x, y
    real(wp) :: distance(polygon%sides)
    integer :: k

    distance = [(distance_to_side(x, y, [polygon%x(k), polygon%y(k)], [polygon%x(k + 1), &
      polygon%y(k + 1)]), k=1, polygon%sides)]
  end function distances_to_sides

  !> Whether a point is inside, on a side, or at most `tolerance` outside.
  pure function is_in_polygon(polygon, x, y, tolerance) result(inside)
    type(polygon_type), intent(in) :: polygon
    !> Position in the frame of the polygon, and a distance: lengths.
    real(wp), intent(in) :: x, y, tolerance
    logical :: inside
    integer :: k

    inside = .false.
    do k = 1, polygon%sides
      if (is_on_side(x, y, [polygon%x(k), polygon%y(k)], [polygon%x(k + 1), polygon%y(k + 1)])) &
        then
        inside = .true.
        return
      end if
      if ((polygon%y(k) > y) .eqv. (polygon%y(k + 1) > y)) cycle
      if (x < polygon%x(k) + (polygon%x(k + 1) - polygon%x(k))*((y - polygon%y(k)) &
        /(polygon%y(k + 1) - polygon%y(k)))) inside = .not. inside
    end do
    if (.not. inside) inside = any(distances_to_sides(polygon, x, y) <= tolerance)
  end function is_in_polygon

  !> Trial point from two numbers `across` and `up`, uniform in [0, 1]: uniform in the polygon, if
  !> `inside`.
  pure subroutine try_point_in_polygon(polygon, across, up, x, y, inside)
    type(polygon_type), intent(in) :: polygon
    real(wp), intent(in) :: across, up
    !> Position in the frame of the polygon, lengths.
    real(wp), intent(out) :: x, y
    logical, intent(out) :: inside

    associate (left => minval(polygon%x), below => minval(polygon%y))
      x = left + (maxval(polygon%x) - left)*across
      y = below + (maxval(polygon%y) - below)*up
    end associate
    inside = is_in_polygon(polygon, x, y, 0.0_wp)
  end subroutine try_point_in_polygon

  !> Side that is nearest to a point.
  pure function nearest_side(polygon, x, y) result(nearest)
    type(polygon_type), intent(in) :: polygon
    !> Position in the frame of the polygon, lengths.
    real(wp), intent(in) :: x, y
    integer :: nearest

    nearest = minloc(distances_to_sides(polygon, x, y), 1)
  end function nearest_side

  !> Finds the side that a particle hits next, and the time `wait` until then. A particle on the
  !> side `from` (0: on none) does not hit that side. Where a path runs nearly along a side,
  !> rounding moves the place where it crosses it: then only that it does so between its corners is
  !> certain. A time beyond them would put the side behind the particle, which then would hit
  !> nothing, or put the hit outside. A path that enters a polygon before it leaves does not start
  !> inside: rounding in a re-entrant corner has put the particle outside, and no side is found, or
  !> it would cross what lies between two parts of the urn.
  pure subroutine find_next_side(polygon, from, x, y, ux, uy, side, wait)
    type(polygon_type), intent(in) :: polygon
    integer, intent(in) :: from
    !> Position and velocity in the frame of the polygon.
    real(wp), intent(in) :: x, y, ux, uy
    !> 0 if no side is found, which only rounding can cause.
    integer, intent(out) :: side
    real(wp), intent(out) :: wait
    !> Sine of the angle below which a path runs nearly along a side.
    real(wp), parameter :: shallow = 2.0_wp**(-6)
    real(wp), parameter :: golden = 0.5_wp*(sqrt(5.0_wp) - 1.0_wp)
    real(wp) :: before, after, time, enters, first, second
    logical :: inside
    integer :: k

    side = 0
    wait = huge(1.0_wp)
    enters = huge(1.0_wp)
    after = ux*(polygon%y(1) - y) - uy*(polygon%x(1) - x)
    do k = 1, polygon%sides
      before = after
      after = ux*(polygon%y(k + 1) - y) - uy*(polygon%x(k + 1) - x)
      if (before >= 0.0_wp) then
        if (after >= 0.0_wp .or. polygon%convex) cycle
      else if (after < 0.0_wp .or. k == from) then
        cycle
      end if
      time = polygon%length_of(k)*((polygon%x(k) - x)*polygon%normal_x(k) &
        + (polygon%y(k) - y)*polygon%normal_y(k))/(after - before)
      if (abs(after - before) < shallow*polygon%length_of(k)) then
        first = ux*(polygon%x(k) - x) + uy*(polygon%y(k) - y)
        second = ux*(polygon%x(k + 1) - x) + uy*(polygon%y(k + 1) - y)
        time = min(max(time, min(first, second)), max(first, second))
      end if
      if (before >= 0.0_wp) then
        if (time > polygon%tolerance) enters = min(enters, time)
        cycle
      end if
      if (time >= wait) cycle
      if (time < -polygon%tolerance) then
        ! Skip a side behind the particle, unless only rounding has put it there.
        if (distance_to_side(x, y, [polygon%x(k), polygon%y(k)], [polygon%x(k + 1), &
          polygon%y(k + 1)]) > polygon%tolerance) cycle
      end if
      side = k
      wait = time
    end do
    wait = max(wait, 0.0_wp)
    if (side == 0 .or. enters > wait + polygon%tolerance) return
    ! The path enters before it leaves, or where it does: it may run outside from corner to corner.
    ! Asked at two places that divide it by the golden ratio: halfway there may be a corner as well.
    inside = enters >= wait - polygon%tolerance
    do k = 1, 2
      if (inside) inside = is_in_polygon(polygon, x + golden**k*wait*ux, y + golden**k*wait*uy, &
        polygon%tolerance)
    end do
    if (.not. inside) side = 0
  end subroutine find_next_side

  !> As `find_next_side`, but also for a particle that moves along a side, or that rounding has put
  !> beyond one: then the path starts slightly farther inside, away from the sides that the particle
  !> touches. From the side `from` (0: none), at (`x`, `y`) with velocity (`ux`, `uy`), to the
  !> `side` that the particle hits (0: none) after the time `wait`.
  pure subroutine find_next_side_robustly(polygon, from, x, y, ux, uy, side, wait)
    type(polygon_type), intent(in) :: polygon
    integer, intent(in) :: from
    real(wp), intent(in) :: x, y, ux, uy
    integer, intent(out) :: side
    real(wp), intent(out) :: wait
    real(wp) :: inwards, shift_x, shift_y
    integer :: tries

    call find_next_side(polygon, from, x, y, ux, uy, side, wait)
    if (side > 0) return
    inwards = polygon%tolerance
    do tries = 1, 8
      ! A block, so that no array is allocated where a side is found at once. In `synchronous` each
      ! event moves all particles: after many of them rounding has put one far beyond its side.
      block
        logical :: touches(polygon%sides)

        touches = distances_to_sides(polygon, x, y) <= 2.0_wp*inwards
        if (from > 0) touches(from) = .true.
        shift_x = -sum(polygon%normal_x, touches)
        shift_y = -sum(polygon%normal_y, touches)
      end block
      call find_next_side(polygon, 0, x + inwards*shift_x, y + inwards*shift_y, ux, uy, side, wait)
      if (side > 0) return
      inwards = 4.0_wp*inwards
    end do
  end subroutine find_next_side_robustly

  !> Places a particle at (`x`, `y`) on the side number `side`, and reflects its velocity (`ux`,
  !> `uy`), which is upright after that if it is so up to rounding.
  pure subroutine reflect_from_side(polygon, side, x, y, ux, uy)
    type(polygon_type), intent(in) :: polygon
    integer, intent(in) :: side
    real(wp), intent(inout) :: x, y, ux, uy
    real(wp) :: beyond, outward, norm

    associate (nx => polygon%normal_x(side), ny => polygon%normal_y(side))
      beyond = (x - polygon%x(side))*nx + (y - polygon%y(side))*ny
      x = x - beyond*nx
      y = y - beyond*ny
      outward = max(ux*nx + uy*ny, 0.0_wp)
      ux = ux - 2.0_wp*outward*nx
      uy = uy - 2.0_wp*outward*ny
    end associate
    norm = 1.5_wp - 0.5_wp*(ux**2 + uy**2)
    ux = norm*ux
    uy = norm*uy
    ! Who runs along an opening passes over it: within a channel it would never come to an end.
    if (abs(ux) <= least_across) ux = 0.0_wp
  end subroutine reflect_from_side

  !> Finds the wall or opening `next` that a particle in the polygon, or at an opening, reaches, and
  !> the time `wait` until then.
  pure subroutine find_next_wall_in_polygon(polygon, from, x, y, ux, uy, next, wait)
    type(polygon_type), intent(in) :: polygon
    !> Channel on whose chord the particle is, or `no_channel`.
    integer, intent(in) :: from
    !> Position and velocity in the frame of the polygon.
    real(wp), intent(in) :: x, y, ux, uy
    integer(wall_kind), intent(out) :: next
    real(wp), intent(out) :: wait
    integer :: side

    side = 0
    if (from /= no_channel) side = polygon%side(from)
    call find_next_wall_from_side(polygon, side, x, y, ux, uy, next, wait)
  end subroutine find_next_wall_in_polygon

  !> As `find_next_wall_in_polygon`, for a particle on the side `from`. It leaves only through a
  !> point strictly within an opening: a corner belongs to the urn.
  pure subroutine find_next_wall_from_side(polygon, from, x, y, ux, uy, next, wait)
    type(polygon_type), intent(in) :: polygon
    integer, intent(in) :: from
    real(wp), intent(in) :: x, y, ux, uy
    integer(wall_kind), intent(out) :: next
    real(wp), intent(out) :: wait
    integer :: side

    call find_next_side_robustly(polygon, from, x, y, ux, uy, side, wait)
    if (side == 0) then
      next = meets_nothing
      wait = huge(1.0_wp)
    else if (abs(y + uy*wait) < polygon%half_opening(side)) then
      next = merge(meets_gate, meets_channel2, side == polygon%side(channel1))
    else
      next = int(side, wall_kind)
    end if
  end subroutine find_next_wall_from_side

  !> Reflects a particle at the side `next`; finds the wall or opening that it reaches `next`, and
  !> the time `wait` until then.
  pure subroutine reflect_in_polygon(polygon, x, y, ux, uy, next, wait)
    type(polygon_type), intent(in) :: polygon
    !> Position and velocity in the frame of the polygon.
    real(wp), intent(inout) :: x, y, ux, uy
    integer(wall_kind), intent(inout) :: next
    real(wp), intent(out) :: wait
    integer :: side

    side = int(next)
    call reflect_from_side(polygon, side, x, y, ux, uy)
    call find_next_wall_from_side(polygon, side, x, y, ux, uy, next, wait)
  end subroutine reflect_in_polygon

  !> If a step has moved a particle beyond a side (`was_beyond`), mirrors its position in that side
  !> and reflects its velocity there; repeats this if it is then beyond another side.
  pure subroutine reflect_overshoot_in_polygon(polygon, x, y, ux, uy, was_beyond)
    type(polygon_type), intent(in) :: polygon
    !> Position and velocity in the frame of the polygon.
    real(wp), intent(inout) :: x, y, ux, uy
    logical, intent(out) :: was_beyond
    integer, parameter :: most_sides = 16
    real(wp) :: beyond
    integer :: side, tries

    was_beyond = .false.
    do tries = 1, most_sides
      if (is_in_polygon(polygon, x, y, 0.0_wp)) return
      was_beyond = .true.
      side = last_crossed_side(polygon, x, y, ux, uy)
      ! Beyond a corner, of two sides the one that it moves out of.
      if (side == 0) side = minloc(distances_to_sides(polygon, x, y) - polygon%tolerance &
        *(ux*polygon%normal_x + uy*polygon%normal_y), 1)
      beyond = (x - polygon%x(side))*polygon%normal_x(side) &
        + (y - polygon%y(side))*polygon%normal_y(side)
      call reflect_from_side(polygon, side, x, y, ux, uy)
      x = x - beyond*polygon%normal_x(side)
      y = y - beyond*polygon%normal_y(side)
    end do
    ! The corner is too narrow for the step: put the particle on the nearest side.
    side = nearest_side(polygon, x, y)
    call locate_on_outline(polygon, polygon%arc_start(side) &
      + distance_along_side(polygon, side, x, y), side, x, y)
  end subroutine reflect_overshoot_in_polygon

  !> Side through which a particle left the polygon that a time step has moved out of it: where its
  !> straight path, followed backwards, comes to the polygon; 0 if it does not.
  pure function last_crossed_side(polygon, x, y, ux, uy) result(side)
    type(polygon_type), intent(in) :: polygon
    !> Position and velocity in the frame of the polygon.
    real(wp), intent(in) :: x, y, ux, uy
    integer :: side
    real(wp) :: before, after, time, latest
    integer :: k

    side = 0
    latest = -huge(1.0_wp)
    after = ux*(polygon%y(1) - y) - uy*(polygon%x(1) - x)
    do k = 1, polygon%sides
      before = after
      after = ux*(polygon%y(k + 1) - y) - uy*(polygon%x(k + 1) - x)
      if (before >= 0.0_wp .or. after < 0.0_wp) cycle
      time = polygon%length_of(k)*((polygon%x(k) - x)*polygon%normal_x(k) &
        + (polygon%y(k) - y)*polygon%normal_y(k))/(after - before)
      if (time > polygon%tolerance .or. time <= latest) cycle
      side = k
      latest = time
    end do
  end function last_crossed_side

  !> Distance along a side from its first corner to the projection of a point, between 0 and its
  !> length.
  pure function distance_along_side(polygon, side, x, y) result(along)
    type(polygon_type), intent(in) :: polygon
    integer, intent(in) :: side
    real(wp), intent(in) :: x, y
    real(wp) :: along

    along = (y - polygon%y(side))*polygon%normal_x(side) &
      - (x - polygon%x(side))*polygon%normal_y(side)
    along = min(max(along, 0.0_wp), polygon%length_of(side))
  end function distance_along_side

  !> Boundary state of a particle at (`x`, `y`) on the side number `side` with velocity (`ux`,
  !> `uy`).
  pure function state_on_side(polygon, side, x, y, ux, uy) result(state)
    type(polygon_type), intent(in) :: polygon
    integer, intent(in) :: side
    real(wp), intent(in) :: x, y, ux, uy
    type(boundary_state_type) :: state

    state = boundary_state_type(polygon%arc_start(side) + distance_along_side(polygon, side, x, &
      y), ux, uy)
    ! The end of a side does not belong to the next side.
    if (side < polygon%sides) state%arc_length = min(state%arc_length, &
      nearest(polygon%arc_start(side + 1), -1.0_wp))
  end function state_on_side

  !> Side and position at an arc length along the outline.
  pure subroutine locate_on_outline(polygon, arc_length, side, x, y)
    type(polygon_type), intent(in) :: polygon
    real(wp), intent(in) :: arc_length
    integer, intent(out) :: side
    real(wp), intent(out) :: x, y
    real(wp) :: along

    side = max(count(polygon%arc_start <= arc_length), 1)
    along = min(arc_length - polygon%arc_start(side), polygon%length_of(side))
    x = polygon%x(side) - along*polygon%normal_y(side)
    y = polygon%y(side) + along*polygon%normal_x(side)
  end subroutine locate_on_outline

  !> Whether a boundary state is the same as the one `before`, up to rounding.
  pure function has_returned(polygon, state, before) result(same)
    type(polygon_type), intent(in) :: polygon
    !> Boundary state: place along the outline, and velocity.
    type(boundary_state_type), intent(in) :: state, before
    logical :: same

    same = max(abs(state%ux - before%ux), abs(state%uy - before%uy), &
      abs(state%arc_length - before%arc_length)/polygon%outline_length) <= same_state
  end function has_returned

  !> Moves a particle from side to side for the time `rest`, or until it reaches an opening; then
  !> `rest` is the time left. At the time of a hit it has not been reflected; if it flies `back`, it
  !> has: then time forwards it has not.
  pure subroutine continue_flight(urn, back, side, x, y, ux, uy, rest, hits, meets_corner)
    type(urn_shape_type), intent(in) :: urn
    !> Whether the velocity has been reversed.
    logical, intent(in) :: back
    !> Side that the particle is on, or 0.
    integer, intent(inout) :: side
    real(wp), intent(inout) :: x, y, ux, uy, rest
    !> Wall hits within that time.
    integer(int64), intent(out) :: hits
    !> Set if the path meets a corner.
    logical, intent(inout) :: meets_corner
    integer, parameter :: most_at_once = 10000
    integer(wall_kind) :: next
    real(wp) :: wait, lost
    integer :: at_once

    hits = 0
    lost = 0.0_wp
    at_once = 0
    do
      call find_next_wall_from_side(urn%polygon, side, x, y, ux, uy, next, wait)
      meets_corner = meets_corner .or. passes_corner(urn, x, y, ux, uy, min(wait, rest))
      x = x + ux*min(wait, rest)
      y = y + uy*min(wait, rest)
      ! A particle that rounding keeps in a corner stays there.
      at_once = merge(0, at_once + 1, wait > urn%polygon%tolerance)
      if (wait > rest .or. next < meets_wall .or. at_once > most_at_once) exit
      if (wait >= rest .and. .not. back) exit
      call add_compensated(-wait, rest, lost)
      side = int(next)
      call reflect_from_side(urn%polygon, side, x, y, ux, uy)
      hits = hits + 1
    end do
  end subroutine continue_flight

  !> Adds a step to a sum of many, whose rounding errors `lost` has (Kahan's summation): equal steps
  !> would all be rounded in one direction.
  elemental subroutine add_compensated(step, total, lost)
    real(wp), intent(in) :: step
    real(wp), intent(inout) :: total, lost
    real(wp) :: added, before

    added = step + lost
    before = total
    total = before + added
    lost = added - (total - before)
  end subroutine add_compensated

  !> Whether a straight path of a given length passes a corner or the end of an opening, or ends at
  !> one, within the distance `near`.
  pure function passes_corner(urn, x, y, ux, uy, length) result(passes)
    type(urn_shape_type), intent(in) :: urn
    real(wp), intent(in) :: x, y, ux, uy, length
    logical :: passes
    integer :: k

    passes = .false.
    do k = 1, urn%polygon%sides
      passes = passes .or. is_near(urn%polygon%x(k), urn%polygon%y(k))
    end do
    do k = channel1, channel2
      if (urn%polygon%side(k) == 0) cycle
      passes = passes .or. is_near(facing(k)*urn%chord(k), urn%half_width(k)) &
        .or. is_near(facing(k)*urn%chord(k), -urn%half_width(k))
    end do

  contains

    !> Whether the path comes near a point.
    pure logical function is_near(at_x, at_y)
      real(wp), intent(in) :: at_x, at_y
      real(wp) :: ahead, zone

      zone = near*urn%reach
      is_near = abs(ux*(at_y - y) - uy*(at_x - x)) <= zone
      if (.not. is_near) return
      ahead = ux*(at_x - x) + uy*(at_y - y)
      is_near = -zone <= ahead .and. ahead <= length + zone
    end function is_near

  end function passes_corner

  !> First impact of a particle that is in the polygon; openings count as wall.
  pure subroutine find_first_impact_in_polygon(polygon, x, y, ux, uy, arc_length, u_axial, &
    u_lateral, wait, before)
    type(polygon_type), intent(in) :: polygon
    !> Position and velocity in the frame of the polygon: lengths, and a vector of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> Boundary state after the impact: arc length, u_x, u_y; time until the impact.
    real(wp), intent(out) :: arc_length, u_axial, u_lateral, wait
    !> Wall hits until then that `locate_in_polygon` does not count: the impact itself.
    integer(int64), intent(out) :: before
    type(boundary_state_type) :: state
    real(wp) :: norm, px, py
    integer :: side

    norm = 1.5_wp - 0.5_wp*(ux**2 + uy**2)
    u_axial = norm*ux
    u_lateral = norm*uy
    call find_next_side_robustly(polygon, 0, x, y, u_axial, u_lateral, side, wait)
    before = 0
    if (side > 0) then
      px = x + u_axial*wait
      py = y + u_lateral*wait
      call reflect_from_side(polygon, side, px, py, u_axial, u_lateral)
      state = state_on_side(polygon, side, px, py, u_axial, u_lateral)
      before = 1
    else
      ! No side is found: the particle stays where it is.
      wait = 0.0_wp
      state = state_on_side(polygon, nearest_side(polygon, x, y), x, y, u_axial, u_lateral)
    end if
    arc_length = state%arc_length
  end subroutine find_first_impact_in_polygon

  !> Position of a particle in the polygon at a time relative to a boundary state, or to the end of
  !> its passage. Which side a path through a corner hits is decided by rounding: computed back, or
  !> with other rounding errors than in `compute_passages`, it may turn to another side there. So a
  !> path that meets a corner is not to be believed; `follow_passage` yields the one that was taken.
  pure subroutine locate_in_polygon(urn, channel, y, u_axial, u_lateral, since, position, &
    velocity, hits, meets_corner)
    type(urn_shape_type), intent(in) :: urn
    !> Channel through which the passage ends; any other value: it does not end.
    integer, intent(in) :: channel
    !> Height (a length), |u_x| and u_y at the side of that channel; else a boundary state: arc
    !> length, u_x and u_y.
    real(wp), intent(in) :: y, u_axial, u_lateral
    !> Time since the boundary state or the end of the passage; below 0: time until then.
    real(wp), intent(in) :: since
    !> x and y of each: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Wall hits since then; below 0: minus the number of hits until then, that of the boundary
    !> state included.
    integer(int64), intent(out) :: hits
    !> Whether the path in between meets a corner or the end of an opening.
    logical, intent(out) :: meets_corner
    real(wp), parameter :: long = 1000.0_wp
    real(wp) :: rest, period
    integer(int64) :: hits_each, periods
    integer :: side
    logical :: leaves

    meets_corner = .false.
    leaves = channel == channel1 .or. channel == channel2
    if (leaves) then
      side = urn%polygon%side(channel)
      position = [facing(channel)*urn%chord(channel), y]
      velocity = [facing(channel)*u_axial, u_lateral]
    else
      call locate_on_outline(urn%polygon, y, side, position(1), position(2))
      velocity = [u_axial, u_lateral]
    end if
    if (leaves .or. since < 0.0_wp) then
      velocity = -velocity
      if (.not. leaves) call reflect_from_side(urn%polygon, side, position(1), position(2), &
        velocity(1), velocity(2))
      rest = -since
      call continue_flight(urn, .true., side, position(1), position(2), velocity(1), &
        velocity(2), rest, hits, meets_corner)
      velocity = -velocity
      hits = -hits - merge(0, 1, leaves)
    else
      period = huge(1.0_wp)
      hits_each = 0
      if (since > long*urn%reach) call find_period(urn, boundary_state_type(y, u_axial, &
        u_lateral), period, hits_each, meets_corner)
      periods = int(since/period, int64)
      rest = max(since - real(periods, wp)*period, 0.0_wp)
      call continue_flight(urn, .false., side, position(1), position(2), velocity(1), &
        velocity(2), rest, hits, meets_corner)
      hits = hits + periods*hits_each
    end if
  end subroutine locate_in_polygon

  !> Finds time and hits after which a boundary state recurs; huge and 0 if it does not within
  !> `longest_period` hits.
  pure subroutine find_period(urn, state, period, hits, meets_corner)
    type(urn_shape_type), intent(in) :: urn
    type(boundary_state_type), intent(in) :: state
    real(wp), intent(out) :: period
    integer(int64), intent(out) :: hits
    !> Set if the path meets a corner.
    logical, intent(inout) :: meets_corner
    integer(wall_kind) :: next
    real(wp) :: x, y, ux, uy, wait
    integer :: side

    ux = state%ux
    uy = state%uy
    call locate_on_outline(urn%polygon, state%arc_length, side, x, y)
    period = 0.0_wp
    do hits = 1, longest_period
      call find_next_wall_from_side(urn%polygon, side, x, y, ux, uy, next, wait)
      if (next < meets_wall) exit
      meets_corner = meets_corner .or. passes_corner(urn, x, y, ux, uy, wait)
      x = x + ux*wait
      y = y + uy*wait
      period = period + wait
      side = int(next)
      call reflect_from_side(urn%polygon, side, x, y, ux, uy)
      if (has_returned(urn%polygon, state_on_side(urn%polygon, side, x, y, ux, uy), state) .and. &
        period > urn%polygon%tolerance) return
    end do
    period = huge(1.0_wp)
    hits = 0
  end subroutine find_period

end module battery_polygon

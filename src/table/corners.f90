!> Geometry of a list of corners, from which polygons are checked and made.
!>
!> Corners are columns (x, y), in order along the outline; side k goes from corner k to the next
!> one, the last side back to the first corner. If they run counterclockwise, the inside is on the
!> left of each side.
module battery_corners
  use battery_kinds, only: wp, pi
  implicit none (type, external)
  private
  public :: most_corners, regular_corners, enclosed_area, is_nearly_rational, reversed_corners, &
    next_corner, distance_to_side, is_on_side, sides_meet, side_distance, side_on_axis

  !> Largest number of corners of a polygon.
  integer, parameter :: most_corners = 1000

contains

  !> Corners of a regular polygon about the origin, with two upright sides that the x axis crosses.
  pure function regular_corners(sides, radius) result(corner)
    !> Number of sides: even, at least 4.
    integer, intent(in) :: sides
    !> Distance from the origin to a corner, a length.
    real(wp), intent(in) :: radius
    real(wp) :: corner(2, sides)
    real(wp) :: angle
    integer :: k, half_count

    ! The upper half of the corners, counterclockwise from the right to the left; those on the left
    ! are exact mirror images of those on the right, and the lower half of those of the upper half.
    half_count = sides/2
    do k = 1, (half_count + 1)/2
      angle = pi*real(2*k - 1, wp)/real(sides, wp)
      corner(:, k) = radius*[cos(angle), sin(angle)]
      if (2*k - 1 == half_count) corner(1, k) = 0.0_wp
    end do
    do k = 1, half_count/2
      corner(:, half_count + 1 - k) = [-corner(1, k), corner(2, k)]
    end do
    do k = 1, half_count
      corner(:, sides + 1 - k) = [corner(1, k), -corner(2, k)]
    end do
    ! The upright side on the right goes from the last corner to the first.
  end function regular_corners

  !> Area of a polygon; negative if its corners run clockwise.
  pure function enclosed_area(corner) result(area)
    !> Corners, (x, y) in columns.
    real(wp), intent(in) :: corner(:, :)
    real(wp) :: area
    integer :: k

    area = 0.0_wp
    do k = 2, size(corner, 2) - 1
      area = area + 0.5_wp*cross_product(corner(:, k) - corner(:, 1), &
        corner(:, k + 1) - corner(:, 1))
    end do
  end function enclosed_area

  !> Whether a polygon is rational, so that a particle in it has only 2n directions, or nearly so:
  !> all its sides are at multiples of pi/n within the rounding of typed digits, or, of few
  !> directions, the root mean square of their deviations is below a thirtieth of pi/n. Turns at
  !> sides that are nearly parallel cancel, so that directions then relax very slowly. Runs in
  !> squares with one side tilted stated errors that were too small up to 5 degrees.
  pure logical function is_nearly_rational(corner)
    !> Corners, (x, y) in columns.
    real(wp), intent(in) :: corner(:, :)
    !> Largest n, and largest n of few directions; tolerance for the angle of a side.
    integer, parameter :: most_parts = 120, few_parts = 6
    real(wp), parameter :: tolerance = 1.0e-6_wp, nearest_share = 1.0_wp/30.0_wp
    real(wp), dimension(size(corner, 2)) :: angle, length, deviation
    real(wp) :: side(2), part
    integer :: k, n

    do k = 1, size(corner, 2)
      side = corner(:, next_corner(k, size(corner, 2))) - corner(:, k)
      angle(k) = atan2(side(2), side(1))
      length(k) = hypot(side(1), side(2))
    end do
    is_nearly_rational = .true.
    do n = 1, most_parts
      part = pi/real(n, wp)
      deviation = angle - anint(angle/part)*part
      if (all(abs(deviation) < tolerance)) return
      if (n <= few_parts .and. sum(length*deviation**2) < sum(length)*(nearest_share*part)**2) &
        return
    end do
    is_nearly_rational = .false.
  end function is_nearly_rational

  !> The same polygon with its corners in the opposite order; the first one stays the first.
  pure function reversed_corners(corner) result(reversed)
    !> Corners, (x, y) in columns.
    real(wp), intent(in) :: corner(:, :)
    real(wp) :: reversed(size(corner, 1), size(corner, 2))

    reversed = corner(:, size(corner, 2):1:-1)
    reversed = cshift(reversed, -1, dim=2)
  end function reversed_corners

  !> Index of the corner after corner `k`.
  elemental function next_corner(k, count) result(next)
    !> Index of a corner, and number of corners.
    integer, intent(in) :: k, count
    integer :: next

    next = merge(1, k + 1, k == count)
  end function next_corner

  !> Side that the x axis crosses last on the right (`way` = 1) or on the left (-1); 0 if it crosses
  !> none, or goes through a corner.
  pure function side_on_axis(corner, way) result(side)
    !> Corners, (x, y) in columns; 1: on the right, -1: on the left.
    real(wp), intent(in) :: corner(:, :), way
    integer :: side
    real(wp) :: farthest, x, a(2), b(2)
    integer :: k

    side = 0
    farthest = -huge(1.0_wp)
    do k = 1, size(corner, 2)
      a = corner(:, k)
      b = corner(:, next_corner(k, size(corner, 2)))
      if (min(a(2), b(2)) > 0.0_wp .or. max(a(2), b(2)) < 0.0_wp) cycle
      x = max(way*a(1), way*b(1))
      if (abs(b(2) - a(2)) > 0.0_wp) x = way*(a(1) - (b(1) - a(1))*(a(2)/(b(2) - a(2))))
      if (x < farthest) cycle
      farthest = x
      side = merge(k, 0, a(2)*b(2) < 0.0_wp)
    end do
  end function side_on_axis

  !> Distance of a point from the side between the corners a and b.
  pure function distance_to_side(x, y, a, b) result(distance)
    !> Coordinates: lengths.
    real(wp), intent(in) :: x, y, a(2), b(2)
    real(wp) :: distance
    real(wp) :: share, along(2)

    along = b - a
    share = dot_product([x, y] - a, along)/max(dot_product(along, along), tiny(1.0_wp))
    share = min(max(share, 0.0_wp), 1.0_wp)
    distance = hypot(x - a(1) - share*along(1), y - a(2) - share*along(2))
  end function distance_to_side

  !> Whether a point is exactly on the side between the corners a and b. On an upright or a level
  !> side that needs no rounding; the distance of such a point may come out above 0.
  pure function is_on_side(x, y, a, b) result(on_side)
    !> Coordinates: lengths.
    real(wp), intent(in) :: x, y, a(2), b(2)
    logical :: on_side

    on_side = min(a(1), b(1)) <= x .and. x <= max(a(1), b(1)) .and. min(a(2), b(2)) <= y .and. &
      y <= max(a(2), b(2))
    if (on_side) on_side = .not. abs(cross_product(b - a, [x, y] - a)) > 0.0_wp
  end function is_on_side

  !> Whether the sides a-b and c-d have a point in common.
  pure function sides_meet(a, b, c, d) result(meet)
    !> Ends of the sides: lengths.
    real(wp), intent(in) :: a(2), b(2), c(2), d(2)
    logical :: meet
    real(wp) :: side_c, side_d, side_a, side_b

    meet = .false.
    if (max(a(1), b(1)) < min(c(1), d(1)) .or. max(c(1), d(1)) < min(a(1), b(1))) return
    if (max(a(2), b(2)) < min(c(2), d(2)) .or. max(c(2), d(2)) < min(a(2), b(2))) return
    side_c = cross_product(b - a, c - a)
    side_d = cross_product(b - a, d - a)
    side_a = cross_product(d - c, a - c)
    side_b = cross_product(d - c, b - c)
    meet = min(side_c, side_d) <= 0.0_wp .and. max(side_c, side_d) >= 0.0_wp .and. &
      min(side_a, side_b) <= 0.0_wp .and. max(side_a, side_b) >= 0.0_wp
  end function sides_meet

  !> Distance between the sides a-b and c-d.
  pure function side_distance(a, b, c, d) result(distance)
    !> Ends of the sides: lengths.
    real(wp), intent(in) :: a(2), b(2), c(2), d(2)
    real(wp) :: distance

    distance = 0.0_wp
    if (sides_meet(a, b, c, d)) return
    distance = min(distance_to_side(a(1), a(2), c, d), distance_to_side(b(1), b(2), c, d), &
      distance_to_side(c(1), c(2), a, b), distance_to_side(d(1), d(2), a, b))
  end function side_distance

  !> Cross product of two vectors: positive if b points to the left of a.
  pure function cross_product(a, b) result(product)
    real(wp), intent(in) :: a(2), b(2)
    real(wp) :: product

    product = a(1)*b(2) - a(2)*b(1)
  end function cross_product

end module battery_corners

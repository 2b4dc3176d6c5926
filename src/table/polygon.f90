!> A simple polygon, with openings in two upright sides: those that the axis crosses last, on the
!> right for channel 1 and on the left for channel 2.
!>
!> Frame: the origin lies in the middle between the two upright sides. Where channel 2 is closed no
!> side on the left need be upright, and what reaches farthest to the left stands for it. So it is
!> with the disc, whose chord there is its radius away. The origin may lie outside of the polygon.
!>
!> From wall to wall: `polygon_walls.f90`; whole visits: `polygon_visits.f90`.
module battery_polygon
  use battery_kinds, only: wp
  use battery_channel, only: channel_type, gated, ungated, facing, is_open
  use battery_chamber, only: chamber_type, set_openings
  use battery_corners, only: enclosed_area, reversed_corners, next_corner, distance_to_side, &
    side_distance, side_on_axis
  implicit none (type, external)
  private
  public :: polygon_type, new_polygon, is_in_polygon, try_point_in_polygon, nearest_side

  !> What rounding may leave of a place on a side, in units of the table.
  real(wp), parameter :: rounding = 64.0_wp*epsilon(1.0_wp)

  !> Sides that lean less than this, in units of the polygon, are meant to be upright.
  real(wp), parameter, public :: upright = 2.0_wp**13*epsilon(1.0_wp)

  !> What a visit to a polygon needs to know. Side k goes from corner k to corner k + 1.
  type, extends(chamber_type) :: polygon_type
    integer :: sides = 0
    !> Corners, the first again at the end.
    real(wp), allocatable :: x(:), y(:)
    !> Outward normal of each side, of length 1, its distance from the origin along that, its
    !> length, and how far round the polygon it begins.
    real(wp), allocatable :: normal_x(:), normal_y(:), offset(:), length_of(:), arc_start(:)
    !> Half the width of the opening in a side; -1: it has none.
    real(wp), allocatable :: half_opening(:)
    !> The sides with the openings, and how far it is round the polygon.
    integer :: side(2) = 0
    real(wp) :: outline_length = 0.0_wp
    !> Whether no way meets more than one side.
    logical :: convex = .false.
    !> Lengths below this may be rounding.
    real(wp) :: sharp = 0.0_wp
  end type polygon_type

contains

  !> A polygon with openings; one that runs clockwise is turned round. Where no upright side is on
  !> the axis, or it has no room for an opening, it does not fit.
  pure function new_polygon(corners, channel) result(polygon)
    !> Columns (x, y), at least 3, in a frame that may begin anywhere on the axis.
    real(wp), intent(in) :: corners(:, :)
    !> The channels at its openings.
    type(channel_type), intent(in) :: channel(2)
    type(polygon_type) :: polygon
    real(wp) :: corner(2, size(corners, 2)), ends(2)
    integer :: k, n

    n = size(corners, 2)
    corner = corners
    if (enclosed_area(corner) < 0.0_wp) corner = reversed_corners(corner)
    call set_openings(polygon, channel)
    polygon%sides = n
    polygon%side = [side_on_axis(corner, 1.0_wp), side_on_axis(corner, -1.0_wp)]
    ends = [maxval(corner(1, :)), minval(corner(1, :))]
    ! Where a channel is closed, its side is a wall like the others.
    where (.not. is_open(channel)) polygon%side = 0
    do k = 1, 2
      if (polygon%side(k) > 0) ends(k) = corner(1, polygon%side(k))
    end do
    polygon%x = [corner(1, :), corner(1, 1)] - 0.5_wp*sum(ends)
    polygon%y = [corner(2, :), corner(2, 1)]
    polygon%chord = 0.5_wp*(ends(gated) - ends(ungated))
    do k = 1, 2
      if (polygon%side(k) == 0) cycle
      if (abs(polygon%x(polygon%side(k) + 1) - polygon%x(polygon%side(k))) &
        > upright*maxval(abs(polygon%x))) cycle
      ! To the last digit, however the corners were rounded.
      polygon%x(polygon%side(k):polygon%side(k) + 1) = facing(k)*polygon%chord(k)
      if (polygon%side(k) == n) polygon%x(1) = polygon%x(n + 1)
      if (polygon%side(k) == 1) polygon%x(n + 1) = polygon%x(1)
    end do
    call measure_outline(polygon)
    call measure_openings(polygon)
  end function new_polygon

  !> What follows from the corners.
  pure subroutine measure_outline(polygon)
    type(polygon_type), intent(inout) :: polygon
    real(wp), allocatable :: along_x(:), along_y(:)
    integer :: n, k

    n = polygon%sides
    along_x = polygon%x(2:) - polygon%x(:n)
    along_y = polygon%y(2:) - polygon%y(:n)
    polygon%length_of = max(hypot(along_x, along_y), tiny(1.0_wp))
    polygon%normal_x = along_y/polygon%length_of
    polygon%normal_y = -along_x/polygon%length_of
    polygon%offset = polygon%normal_x*polygon%x(:n) + polygon%normal_y*polygon%y(:n)
    allocate (polygon%arc_start(n), polygon%half_opening(n))
    polygon%half_opening = -1.0_wp
    polygon%outline_length = 0.0_wp
    polygon%convex = .true.
    do k = 1, n
      polygon%arc_start(k) = polygon%outline_length
      polygon%outline_length = polygon%outline_length + polygon%length_of(k)
      polygon%convex = polygon%convex .and. along_x(k)*along_y(next_corner(k, n)) &
        - along_y(k)*along_x(next_corner(k, n)) >= 0.0_wp
    end do
    polygon%area = enclosed_area(reshape([polygon%x(:n), polygon%y(:n)], [2, n], order=[2, 1]))
    polygon%perimeter = polygon%outline_length - sum(polygon%width)
    polygon%truncates_visits = .true.
    polygon%overhangs = maxval(polygon%x) > polygon%chord(gated) .or. &
      maxval(-polygon%x) > polygon%chord(ungated)
    polygon%reach = maxval(hypot(polygon%x, polygon%y))
    polygon%sharp = rounding*(polygon%reach + polygon%chord(gated) + polygon%length(gated))
    call find_clearance(polygon)
  end subroutine measure_outline

  !> How far the origin is from the walls, if it lies inside; how long a step may be. Twice the area
  !> over the way round is the radius of the circle inscribed in a regular polygon.
  pure subroutine find_clearance(polygon)
    type(polygon_type), intent(inout) :: polygon
    integer :: j, k, n

    n = polygon%sides
    polygon%clear = 0.0_wp
    if (is_in_polygon(polygon, 0.0_wp, 0.0_wp, 0.0_wp)) &
      polygon%clear = distance_to_walls(polygon, 0.0_wp, 0.0_wp)
    polygon%longest_step = 2.0_wp*polygon%area/polygon%outline_length
    if (polygon%convex) return
    do k = 1, n
      do j = k + 2, n
        if (k == 1 .and. j == n) cycle
        polygon%longest_step = min(polygon%longest_step, side_distance(corner_of(k), &
          corner_of(k + 1), corner_of(j), corner_of(j + 1)))
      end do
    end do

  contains

    pure function corner_of(at) result(corner)
      integer, intent(in) :: at
      real(wp) :: corner(2)

      corner = [polygon%x(at), polygon%y(at)]
    end function corner_of

  end subroutine find_clearance

  !> Whether the openings fit, and how far it is through the polygon. A way that comes back to an
  !> opening must be sent back by a wall that looks there: it is at least twice as long as the way
  !> to the nearest of these. One that goes through is at least as long as the chords are apart.
  pure subroutine measure_openings(polygon)
    type(polygon_type), intent(inout) :: polygon
    real(wp) :: a(2), b(2)
    integer :: channel, k, j

    polygon%fits = .true.
    polygon%depth = 0.0_wp
    do channel = gated, ungated
      k = polygon%side(channel)
      if (.not. polygon%width(channel) > 0.0_wp) cycle
      if (k == 0) then
        polygon%fits = .false.
        cycle
      end if
      polygon%half_opening(k) = polygon%half_width(channel)
      if (abs(polygon%normal_y(k)) > 0.0_wp .or. min(abs(polygon%y(k)), abs(polygon%y(k + 1))) &
        <= polygon%half_width(channel)) polygon%fits = .false.
      a = [polygon%x(k), polygon%half_width(channel)]
      b = [polygon%x(k), -polygon%half_width(channel)]
      polygon%depth(channel) = huge(1.0_wp)
      do j = 1, polygon%sides
        if (polygon%normal_x(j)*facing(channel) < 0.0_wp) polygon%depth(channel) = &
          min(polygon%depth(channel), side_distance([polygon%x(j), polygon%y(j)], &
          [polygon%x(j + 1), polygon%y(j + 1)], a, b))
      end do
    end do
    if (all(polygon%width > 0.0_wp)) polygon%depth = min(polygon%depth, polygon%chord)
  end subroutine measure_openings

  !> How far it is from a point to the nearest side.
  pure function distance_to_walls(polygon, x, y) result(distance)
    type(polygon_type), intent(in) :: polygon
    real(wp), intent(in) :: x, y
    real(wp) :: distance
    integer :: k

    distance = huge(1.0_wp)
    do k = 1, polygon%sides
      distance = min(distance, distance_to_side(x, y, [polygon%x(k), polygon%y(k)], &
        [polygon%x(k + 1), polygon%y(k + 1)]))
    end do
  end function distance_to_walls

  !> Whether a point is inside, on a side, or no farther than `tolerance` from one.
  pure function is_in_polygon(polygon, x, y, tolerance) result(inside)
    type(polygon_type), intent(in) :: polygon
    !> In the frame of the polygon, lengths.
    real(wp), intent(in) :: x, y, tolerance
    logical :: inside
    integer :: k

    inside = .false.
    do k = 1, polygon%sides
      if ((polygon%y(k) > y) .eqv. (polygon%y(k + 1) > y)) cycle
      if (x < polygon%x(k) + (polygon%x(k + 1) - polygon%x(k))*((y - polygon%y(k)) &
        /(polygon%y(k + 1) - polygon%y(k)))) inside = .not. inside
    end do
    if (.not. inside) inside = distance_to_walls(polygon, x, y) <= tolerance
  end function is_in_polygon

  !> A point from two numbers `across` and `up` uniform in [0, 1]: uniform where it is `inside`.
  pure subroutine try_point_in_polygon(polygon, across, up, x, y, inside)
    type(polygon_type), intent(in) :: polygon
    real(wp), intent(in) :: across, up
    !> In the frame of the polygon, lengths.
    real(wp), intent(out) :: x, y
    logical, intent(out) :: inside

    associate (left => minval(polygon%x), below => minval(polygon%y))
      x = left + (maxval(polygon%x) - left)*across
      y = below + (maxval(polygon%y) - below)*up
    end associate
    inside = is_in_polygon(polygon, x, y, 0.0_wp)
  end subroutine try_point_in_polygon

  !> The side that a point is nearest to.
  pure function nearest_side(polygon, x, y) result(nearest)
    type(polygon_type), intent(in) :: polygon
    !> In the frame of the polygon, lengths.
    real(wp), intent(in) :: x, y
    integer :: nearest
    real(wp) :: least, distance
    integer :: k

    nearest = 1
    least = huge(1.0_wp)
    do k = 1, polygon%sides
      distance = distance_to_side(x, y, [polygon%x(k), polygon%y(k)], &
        [polygon%x(k + 1), polygon%y(k + 1)])
      if (distance >= least) cycle
      least = distance
      nearest = k
    end do
  end function nearest_side

end module battery_polygon

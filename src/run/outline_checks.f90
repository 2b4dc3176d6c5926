!> Checks of urns that are polygons: the keys, the corners, and whether a polygon, its openings and
!> the channels fit together.
module battery_outline_checks
  use battery_kinds, only: wp
  use battery_bounds, only: finest, greatest_radius
  use battery_channel, only: facing, is_open
  use battery_corners, only: enclosed_area, reversed_corners, next_corner, distance_to_side, &
    sides_meet, side_distance, side_on_axis
  use battery_polygon, only: upright
  use battery_keys, only: key_radius, key_width, corner_keys
  use battery_plan, only: plan_type, point_type, refuse_value, refuse_key, is_scanned, corners_of
  use battery_settings, only: is_refused
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: check_outlines, check_outline_at, has_outline, has_valid_outlines

  !> The shortest side, and the narrowest gap between sides, in units of the width. A particle in a
  !> gap hits a wall each time that it has crossed it: 4e6 hits in a passage through a narrower one.
  real(wp), parameter :: narrowest = 1.0e-6_wp

contains

  !> Whether any urn is given by its corners.
  pure function has_outline(plan)
    type(plan_type), intent(in) :: plan
    logical :: has_outline

    has_outline = allocated(plan%outline(1)%corner) .or. allocated(plan%outline(2)%corner)
  end function has_outline

  !> Whether the outlines of the urns, if they are polygons, have no problem: neither one of the
  !> plan, nor values that were refused when they were parsed.
  pure function has_valid_outlines(plan)
    type(plan_type), intent(in) :: plan
    logical :: has_valid_outlines
    integer :: at

    associate (all => plan%settings%all)
      has_valid_outlines = .not. any(all%given .and. .not. all%known .and. (all%key%name &
        == 'urn_shape' .or. all%key%name == 'urn_sides' .or. all%key%name == corner_keys(1) .or. &
        all%key%name == corner_keys(2)))
    end associate
    do at = 1, size(plan%problems)
      if (index(plan%problems(at)%key, 'urn_') == 1 .or. index(plan%problems(at)%key, 'urn2_') &
        == 1) has_valid_outlines = .false.
    end do
  end function has_valid_outlines

  !> Checks the combination of keys, and each polygon. The order of clockwise corners is reversed;
  !> urn 2 becomes the mirror image of urn 1 if it has no corners of its own. The radius of an urn
  !> is half its extent.
  subroutine check_outlines(plan)
    type(plan_type), intent(inout) :: plan
    integer :: before, urn

    before = size(plan%problems)
    call check_keys(plan)
    if (.not. has_outline(plan) .or. size(plan%problems) > before) return
    do urn = 1, 2
      if (allocated(plan%outline(urn)%corner)) call check_outline(plan, urn)
    end do
    ! If the corners of urn 1 alone were refused when they were parsed, there are none.
    if (size(plan%problems) > before .or. .not. allocated(plan%outline(1)%corner)) return
    if (.not. allocated(plan%outline(2)%corner)) plan%outline(2) = plan%outline(1)
    do urn = 1, 2
      plan%base%of(key_radius)%real(urn) = 0.5_wp*extent_of(plan%outline(urn)%corner)
    end do
  end subroutine check_outlines

  !> Checks which keys are given together.
  subroutine check_keys(plan)
    type(plan_type), intent(inout) :: plan
    character(len=*), parameter :: polygons = 'nothing, since urn_shape is ''disc'''
    integer :: urn

    if (is_refused(plan%settings, 'urn_shape')) return
    if (plan%urn_shape == 'disc') then
      if (plan%urn_sides > 0) call refuse_value(plan, 'urn_sides', to_text(plan%urn_sides), &
        polygons)
      do urn = 1, 2
        if (allocated(plan%outline(urn)%corner)) &
          call refuse_key(plan, trim(corner_keys(urn)), 'is given', polygons)
      end do
      return
    end if
    if (plan%urn_sides > 0) then
      if (modulo(plan%urn_sides, 2) /= 0) call refuse_value(plan, 'urn_sides', &
        to_text(plan%urn_sides), 'even numbers, for an upright side on either side')
      if (has_outline(plan)) call refuse_key(plan, 'urn_sides', 'is given beside corners', &
        'urn_sides with urn_radius, or urn_vertices')
    else if (.not. allocated(plan%outline(1)%corner) .and. has_valid_outlines(plan)) then
      call refuse_value(plan, 'urn_shape', '''polygon''', &
        'with urn_vertices or urn_sides beside it')
    end if
    if (plan%shape == 'urn' .and. allocated(plan%outline(2)%corner)) call refuse_key(plan, &
      'urn2_vertices', 'is given', 'nothing, since the shape ''urn'' has one urn')
    if (.not. has_outline(plan)) return
    if (is_scanned(plan, 'urn_radius')) call refuse_key(plan, 'urn_radius', &
      'is scanned beside urn_vertices', 'urn_sides, of which urn_radius is the size')
    if (is_scanned(plan, 'urn_radius2')) call refuse_key(plan, 'urn_radius2', &
      'is scanned beside urn_vertices', 'urn_sides, of which urn_radius is the size')
  end subroutine check_keys

  !> Checks the corners of one urn.
  subroutine check_outline(plan, urn)
    type(plan_type), intent(inout) :: plan
    integer, intent(in) :: urn
    character(len=:), allocatable :: key
    real(wp) :: extent
    integer :: before, k, n

    before = size(plan%problems)
    key = trim(corner_keys(urn))
    associate (corner => plan%outline(urn)%corner)
      n = size(corner, 2)
      if (n < 3) then
        call refuse_key(plan, key, 'has '//to_text(n)//merge(' corner ', ' corners', n == 1), &
          'three corners or more')
        return
      end if
      extent = extent_of(corner)
      if (maxval(abs(corner)) > greatest_radius .or. extent < 1.0_wp/greatest_radius) then
        call refuse_key(plan, key, 'is '//to_text(extent)//' wide, and reaches to ' &
          //to_text(maxval(abs(corner))), 'numbers whose fourth powers are finite')
        return
      end if
      do k = 1, n
        if (norm2(corner(:, next_corner(k, n)) - corner(:, k)) < narrowest*extent) call &
          refuse_key(plan, key, 'has '//side_text(k, n)//', which has no length', 'sides from ' &
          //to_text(narrowest*extent)//' on, which is '//to_text(narrowest)//' of its width')
      end do
      if (size(plan%problems) > before) return
      call check_gaps(plan, key, corner, narrowest*extent)
      if (size(plan%problems) > before) return
      plan%outline(urn)%was_clockwise = enclosed_area(corner) < 0.0_wp
    end associate
    if (plan%outline(urn)%was_clockwise) &
      plan%outline(urn)%corner = reversed_corners(plan%outline(urn)%corner)
    call check_axis(plan, urn)
  end subroutine check_outline

  !> Checks that sides are apart except at the corner that they share: a side that touches another,
  !> or runs back along it, is refused whatever its slope. The first such side is reported.
  subroutine check_gaps(plan, key, corner, least)
    type(plan_type), intent(inout) :: plan
    character(len=*), intent(in) :: key
    real(wp), intent(in) :: corner(:, :)
    !> Least distance of two sides: a length.
    real(wp), intent(in) :: least
    integer :: j, k, n

    n = size(corner, 2)
    do k = 1, n
      do j = k + 1, n
        if (gap_between(k, j) >= least) cycle
        call refuse_key(plan, key, 'has '//side_text(k, n)//', which meets '//side_text(j, n), &
          'sides that are '//to_text(least)//' apart, which is '//to_text(narrowest) &
          //' of its width, but for the corner that they share')
        return
      end do
    end do

  contains

    !> Distance of two sides; of adjacent sides, the distance of the far end of each to the other.
    pure real(wp) function gap_between(k, j) result(gap)
      integer, intent(in) :: k, j
      real(wp) :: before(2), shared(2), after(2)
      integer :: first

      if (next_corner(k, n) == j .or. next_corner(j, n) == k) then
        first = merge(k, j, next_corner(k, n) == j)
        before = corner(:, first)
        shared = corner(:, next_corner(first, n))
        after = corner(:, next_corner(next_corner(first, n), n))
        gap = min(distance_to_side(before(1), before(2), shared, after), &
          distance_to_side(after(1), after(2), before, shared))
      else
        gap = side_distance(corner(:, k), corner(:, next_corner(k, n)), corner(:, j), &
          corner(:, next_corner(j, n)))
      end if
    end function gap_between

  end subroutine check_gaps

  !> Checks that the outermost sides that the axis crosses are upright if a channel begins there.
  subroutine check_axis(plan, urn)
    type(plan_type), intent(inout) :: plan
    integer, intent(in) :: urn
    character(len=:), allocatable :: what
    integer :: channel, side, n

    associate (corner => plan%outline(urn)%corner)
      n = size(corner, 2)
      do channel = 1, merge(1, 2, plan%shape == 'urn')
        ! A channel whose width is scanned may be open at some points.
        if (.not. (plan%base%of(key_width(channel))%real(1) > 0.0_wp .or. is_scanned(plan, &
          'channel'//to_text(channel)//'_width'))) cycle
        side = side_on_axis(corner, facing(channel))
        if (side == 0) then
          what = 'has a corner on the axis y = 0 or no side there'
        else if (abs(corner(1, next_corner(side, n)) - corner(1, side)) <= upright &
          *maxval(abs(corner(1, :)))) then
          cycle
        else
          what = 'has '//side_text(side, n)//', which is not upright'
        end if
        call refuse_key(plan, trim(corner_keys(urn)), what//', where channel '//to_text(channel) &
          //' is to begin', 'an upright side that the axis y = 0 crosses farthest to the ' &
          //trim(merge('right', 'left ', channel == 1)))
      end do
    end associate
  end subroutine check_axis

  !> Checks that urns and channels of a point of the scan fit together: openings must be narrower
  !> than their sides, and no polygon may extend into a channel. Adds what is wrong to the problems
  !> of the plan.
  subroutine check_outline_at(plan, point)
    type(plan_type), intent(inout) :: plan
    type(point_type), intent(in) :: point
    character(len=:), allocatable :: key
    real(wp) :: widest
    integer :: urn, channel, side, n

    if (plan%urn_shape /= 'polygon') return
    do urn = 1, merge(1, 2, plan%shape == 'urn')
      key = trim(corner_keys(urn))
      if (urn == 2 .and. .not. urns_differ(plan, point)) cycle
      associate (corner => corners_of(plan, point, urn))
        n = size(corner, 2)
        do channel = 1, merge(1, 2, plan%shape == 'urn')
          if (.not. is_open(point%channel(channel))) cycle
          side = side_on_axis(corner, facing(channel))
          if (side == 0) cycle
          widest = 2.0_wp*min(abs(corner(2, side)), abs(corner(2, next_corner(side, n))))
          if (point%channel(channel)%width > widest*(1.0_wp - finest)) call refuse_value(plan, &
            'channel'//to_text(channel)//'_width', to_text(point%channel(channel)%width), &
            'below '//to_text(widest)//', which fits into '//side_text(side, n)//' of urn ' &
            //to_text(urn))
          call check_reach(plan, point, key, corner, channel, side)
        end do
      end associate
    end do
  end subroutine check_outline_at

  !> Whether urn 2 is not the mirror image of urn 1.
  pure function urns_differ(plan, point) result(other)
    type(plan_type), intent(in) :: plan
    type(point_type), intent(in) :: point
    logical :: other

    other = any(shape(corners_of(plan, point, 1)) /= shape(corners_of(plan, point, 2)))
    if (.not. other) other = any(abs(corners_of(plan, point, 1) - corners_of(plan, point, 2)) &
      > 0.0_wp)
  end function urns_differ

  !> Checks that the part of a polygon beyond its opening stays beside the channel, and does not
  !> reach the channel's middle. Of the corners the farthest is reported, of the sides the first in
  !> the channel.
  subroutine check_reach(plan, point, key, corner, channel, side)
    type(plan_type), intent(inout) :: plan
    type(point_type), intent(in) :: point
    character(len=*), intent(in) :: key
    real(wp), intent(in) :: corner(:, :)
    integer, intent(in) :: channel, side
    real(wp) :: beyond, half, a(2), b(2)
    integer :: farthest, k, n

    n = size(corner, 2)
    half = 0.5_wp*point%channel(channel)%width
    beyond = 0.5_wp*point%channel(channel)%length
    farthest = maxloc(facing(channel)*corner(1, :), dim=1)
    a = relative_corner(farthest)
    if (a(1) > beyond*(1.0_wp - finest)) call refuse_key(plan, key, 'has corner ' &
      //to_text(farthest)//', which is '//to_text(a(1))//' beyond the beginning of channel ' &
      //to_text(channel), 'short of its middle, which is '//to_text(beyond)//' beyond')
    do k = 1, n
      if (k == side) cycle
      a = relative_corner(k)
      b = relative_corner(next_corner(k, n))
      if (max(a(1), b(1)) <= 0.0_wp) cycle
      if (sides_meet(a, b, [0.0_wp, half], [beyond, half]) .or. sides_meet(a, b, [0.0_wp, -half], &
        [beyond, -half]) .or. (abs(a(2)) <= half .and. a(1) >= 0.0_wp .and. a(1) <= beyond)) then
        call refuse_key(plan, key, 'has '//side_text(k, n)//', which lies in channel ' &
          //to_text(channel), 'sides beside the channel')
        return
      end if
    end do

  contains

    !> A corner relative to the beginning of the channel, with x pointing into the channel.
    pure function relative_corner(k)
      integer, intent(in) :: k
      real(wp) :: relative_corner(2)

      relative_corner = [facing(channel)*(corner(1, k) - corner(1, side)), corner(2, k)]
    end function relative_corner

  end subroutine check_reach

  !> The greater of width and height.
  pure function extent_of(corner) result(extent)
    real(wp), intent(in) :: corner(:, :)
    real(wp) :: extent

    extent = maxval(maxval(corner, dim=2) - minval(corner, dim=2))
  end function extent_of

  !> Text for a side: the corners at its ends.
  pure function side_text(side, sides) result(text)
    integer, intent(in) :: side, sides
    character(len=:), allocatable :: text

    text = 'the side from corner '//to_text(side)//' to '//to_text(next_corner(side, sides))
  end function side_text

end module battery_outline_checks

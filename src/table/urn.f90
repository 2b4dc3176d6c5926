!> The urns, of any shape: the list of shapes, and what each of them is asked for.
!>
!> A shape is a type that extends `chamber_type`, and these procedures in the frame of the urn; a
!> new one is a file, a component of `urn_type`, and a `case` in each procedure here. The shape is
!> asked for where the work is done, by a number, so that nothing is called through a pointer.
module battery_urn
  use battery_kinds, only: wp, int64
  use battery_channel, only: channel_type, no_channel
  use battery_chamber, only: chamber_type
  use battery_disc, only: disc_type, new_disc, is_in_disc, try_point, place_in_disc, &
    first_impact_in_disc, aim_in_disc, hit_disc, put_back_in_disc
  use battery_disc_visits, only: cross_discs
  use battery_motion, only: wall_kind
  use battery_polygon, only: polygon_type, new_polygon, is_in_polygon, try_point_in_polygon
  use battery_polygon_visits, only: cross_polygons
  use battery_polygon_walls, only: place_in_polygon, first_impact_in_polygon, &
    aim_in_polygon, hit_polygon, put_back_in_polygon
  use battery_visits, only: visits_type
  implicit none (type, external)
  private
  public :: urn_type, shape_disc, shape_polygon, give_form, alike, holds, try_place, cross, &
    place_in_visit, first_impact, place_after, aim, hit, put_back

  !> The shapes.
  integer, parameter :: shape_disc = 1, shape_polygon = 2

  !> An urn of the table: lengths.
  type, extends(chamber_type) :: urn_type
    !> What it is to be: its shape, the radius of a disc or of a regular polygon, and the corners of
    !> a polygon, (x, y) in columns.
    integer :: shape = shape_disc
    real(wp) :: radius = 1.0_wp
    real(wp), allocatable :: corner(:, :)
    !> What follows from that, for its shape.
    type(disc_type) :: disc
    type(polygon_type) :: polygon
    !> Where it is: |x| of its origin, and of the periodic line at the end of this side's half of
    !> channel 2; |x| where each channel begins; the way along x that its own x axis points.
    real(wp) :: centre = 0.0_wp, periodic_line = 0.0_wp, begins(2) = 0.0_wp, way = 1.0_wp
    !> Shortest flight that a clock can tell from none.
    real(wp) :: shortest = 0.0_wp
  end type urn_type

  interface urn_type
    module procedure :: urn_of_radius
  end interface urn_type

contains

  !> A disc. A constructor of the type itself would want all components that have no default.
  elemental function urn_of_radius(radius) result(urn)
    !> A length.
    real(wp), intent(in) :: radius
    type(urn_type) :: urn

    urn%radius = radius
  end function urn_of_radius

  !> Finds out all that follows from shape and channels.
  pure subroutine give_form(urn, channel)
    !> Its shape is known.
    type(urn_type), intent(inout) :: urn
    !> By `gated` and `ungated`.
    type(channel_type), intent(in) :: channel(2)

    select case (urn%shape)
    case (shape_polygon)
      urn%polygon = new_polygon(urn%corner, channel)
      urn%chamber_type = urn%polygon%chamber_type
    case default
      urn%disc = new_disc(urn%radius, channel)
      urn%chamber_type = urn%disc%chamber_type
    end select
  end subroutine give_form

  !> Whether two urns are mirror images of each other, so that one batch of visits serves both.
  pure function alike(urn)
    type(urn_type), intent(in) :: urn(2)
    logical :: alike

    alike = urn(1)%shape == urn(2)%shape .and. .not. abs(urn(1)%radius - urn(2)%radius) > 0.0_wp
    if (.not. alike .or. urn(1)%shape /= shape_polygon) return
    alike = size(urn(1)%corner, 2) == size(urn(2)%corner, 2)
    if (alike) alike = .not. any(abs(urn(1)%corner - urn(2)%corner) > 0.0_wp)
  end function alike

  !> Whether a point that is in no channel is inside, or no farther than `tolerance` outside.
  elemental function holds(urn, x, y, tolerance) result(inside)
    type(urn_type), intent(in) :: urn
    !> In the frame of the urn, lengths.
    real(wp), intent(in) :: x, y, tolerance
    logical :: inside

    select case (urn%shape)
    case (shape_polygon)
      inside = is_in_polygon(urn%polygon, x, y, tolerance)
    case default
      inside = is_in_disc(urn%disc, x, y, tolerance)
    end select
  end function holds

  !> A point of the table from two numbers `across` and `up` uniform in [0, 1]; uniform in the urn
  !> where `inside`.
  pure subroutine try_place(urn, across, up, x, y, inside)
    type(urn_type), intent(in) :: urn
    real(wp), intent(in) :: across, up
    !> In the frame of the table, lengths.
    real(wp), intent(out) :: x, y
    logical, intent(out) :: inside

    select case (urn%shape)
    case (shape_polygon)
      call try_point_in_polygon(urn%polygon, across, up, x, y, inside)
    case default
      call try_point(urn%disc, across, up, x, y, inside)
    end select
    x = urn%way*(x - urn%centre)
  end subroutine try_place

  !> Whole visits of a batch: what they need and what they yield is told at `visits_type`.
  subroutine cross(urn, visits)
    type(urn_type), intent(in) :: urn
    type(visits_type), intent(inout) :: visits

    select case (urn%shape)
    case (shape_polygon)
      call cross_polygons(urn%polygon, visits)
    case default
      call cross_discs(urn%disc, visits)
    end select
  end subroutine cross

  !> The first impact of a particle that is in the urn, also if an opening is there: what
  !> `place_in_visit` wants to know of one that never leaves.
  pure subroutine first_impact(urn, x, y, ux, uy, at, along, across, wait, before)
    type(urn_type), intent(in) :: urn
    !> Place and velocity in the frame of the urn: lengths, and a vector of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> What `visits_type` has as y, `along` and `across` then; the time until then.
    real(wp), intent(out) :: at, along, across, wait
    !> Wall hits that `place_in_visit` does not count from there on.
    integer(int64), intent(out) :: before

    select case (urn%shape)
    case (shape_polygon)
      call first_impact_in_polygon(urn%polygon, x, y, ux, uy, at, along, across, wait, before)
    case default
      call first_impact_in_disc(urn%disc, x, y, ux, uy, at, along, across, wait, before)
    end select
  end subroutine first_impact

  !> Where a particle is some time after it was somewhere in the urn; it has not left.
  pure subroutine place_after(urn, x, y, ux, uy, elapsed, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    !> Where it was: lengths, and a vector of length 1, in the frame of the urn.
    real(wp), intent(in) :: x, y, ux, uy
    !> The time since then.
    real(wp), intent(in) :: elapsed
    !> x and y of each.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Of walls since then.
    integer(int64), intent(out) :: hits
    real(wp) :: at, along, across, wait
    integer(int64) :: before

    call first_impact(urn, x, y, ux, uy, at, along, across, wait, before)
    call place_in_visit(urn, no_channel, at, along, across, elapsed - wait, position, velocity, &
      hits)
    hits = hits + before
  end subroutine place_after

  !> Where a particle is at a time from what is known of an impact, or of the end of its visit.
  pure subroutine place_in_visit(urn, channel, y, along, across, since, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    !> The channel it leaves through then; `no_channel` or `goes_on`.
    integer, intent(in) :: channel
    !> Height, |u_x| and u_y there, or what `visits_type` has instead.
    real(wp), intent(in) :: y, along, across
    !> The time since then; below 0: until then. Who leaves has not left yet.
    real(wp), intent(in) :: since
    !> x and y of each in the frame of the urn: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Of walls since then; below 0: so many are still to come.
    integer(int64), intent(out) :: hits

    select case (urn%shape)
    case (shape_polygon)
      call place_in_polygon(urn%polygon, channel, y, along, across, since, position, velocity, hits)
    case default
      call place_in_disc(urn%disc, channel, y, along, across, since, position, velocity, hits)
    end select
  end subroutine place_in_visit

  !> What a particle meets first that is inside, or at an opening: `next`, after the time `wait`.
  pure subroutine aim(urn, from, x, y, ux, uy, next, wait)
    type(urn_type), intent(in) :: urn
    !> The channel on whose chord it is, or `no_channel`.
    integer, intent(in) :: from
    !> Place and velocity in the frame of the urn.
    real(wp), intent(in) :: x, y, ux, uy
    integer(wall_kind), intent(out) :: next
    real(wp), intent(out) :: wait

    select case (urn%shape)
    case (shape_polygon)
      call aim_in_polygon(urn%polygon, from, x, y, ux, uy, next, wait)
    case default
      call aim_in_disc(urn%disc, from, x, y, ux, uy, next, wait)
    end select
  end subroutine aim

  !> Reflection from the wall `next`; then what is met `next`, after the time `wait`.
  pure subroutine hit(urn, x, y, ux, uy, next, wait)
    type(urn_type), intent(in) :: urn
    !> Place and velocity in the frame of the urn.
    real(wp), intent(inout) :: x, y, ux, uy
    integer(wall_kind), intent(inout) :: next
    real(wp), intent(out) :: wait

    select case (urn%shape)
    case (shape_polygon)
      call hit_polygon(urn%polygon, x, y, ux, uy, next, wait)
    case default
      call hit_disc(urn%disc, urn%shortest, x, y, ux, uy, next, wait)
    end select
  end subroutine hit

  !> Mirrors a particle in the wall that it is beyond, and reflects its velocity there, if it
  !> `was_beyond` one.
  pure subroutine put_back(urn, x, y, ux, uy, was_beyond)
    type(urn_type), intent(in) :: urn
    !> Place and velocity in the frame of the urn.
    real(wp), intent(inout) :: x, y, ux, uy
    logical, intent(out) :: was_beyond

    select case (urn%shape)
    case (shape_polygon)
      call put_back_in_polygon(urn%polygon, x, y, ux, uy, was_beyond)
    case default
      call put_back_in_disc(urn%disc, x, y, ux, uy, was_beyond)
    end select
  end subroutine put_back

end module battery_urn

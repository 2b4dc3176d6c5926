!> Urns: the list of their shapes, and the dispatch to each of them.
!>
!> A shape is a component of `urn_shape_type`, with the procedures below in the frame of the urn. A
!> new shape is a file, such a component, and a `case` in each procedure here.
!> Dispatch is by an integer, once a batch or once a wall, never through a pointer.
module battery_urn
  use battery_kinds, only: wp, int64
  use battery_channel, only: channel_type, no_channel
  use battery_urn_shape, only: urn_shape_type
  use battery_disc, only: new_disc, is_in_disc, try_point_in_disc, locate_in_disc, &
    find_first_impact_in_disc, find_next_wall_in_disc, reflect_in_disc, reflect_overshoot_in_disc
  use battery_disc_passages, only: compute_disc_passages
  use battery_motion, only: wall_kind
  use battery_polygon, only: new_polygon, is_in_polygon, try_point_in_polygon, &
    locate_in_polygon, find_first_impact_in_polygon, find_next_wall_in_polygon, &
    reflect_in_polygon, reflect_overshoot_in_polygon
  use battery_polygon_passages, only: compute_polygon_passages, follow_polygon_passage
  use battery_visits, only: visits_type
  implicit none (type, external)
  private
  public :: urn_type, shape_polygon, derive_shape, are_mirror_images, contains_point, &
    try_random_point, compute_passages, locate_in_passage, find_first_impact, locate_after, &
    follow_passage, meets_corner, find_next_wall, reflect_at_wall, reflect_overshoot

  !> The shapes.
  integer, parameter :: shape_disc = 1, shape_polygon = 2

  !> An urn of the table.
  type, extends(urn_shape_type) :: urn_type
    !> As specified by the user: shape, radius of a disc or of a regular polygon, corners of a
    !> polygon as (x, y) in columns. The geometry is derived from these.
    integer :: shape = shape_disc
    real(wp) :: radius = 1.0_wp
    real(wp), allocatable :: corner(:, :)
    !> Position in the table: |x| of its origin, and of the periodic line at the end of its half of
    !> channel 2; |x| at which each channel starts; direction of its x axis along that of the table,
    !> 1 or -1.
    real(wp) :: centre = 0.0_wp, periodic_line = 0.0_wp, channel_start(2) = 0.0_wp, axis_sign = &
      1.0_wp
    !> Shortest time between two hits that a clock can resolve.
    real(wp) :: clock_resolution = 0.0_wp
  end type urn_type

  interface urn_type
    module procedure :: urn_of_radius
  end interface urn_type

contains

  !> An urn with the shape of a disc. The default constructor would require all components that have
  !> no default.
  elemental function urn_of_radius(radius) result(urn)
    !> Radius, a length.
    real(wp), intent(in) :: radius
    type(urn_type) :: urn

    urn%radius = radius
  end function urn_of_radius

  !> Derives the geometry from shape and channels.
  pure subroutine derive_shape(urn, channel)
    !> An urn whose shape is set.
    type(urn_type), intent(inout) :: urn
    !> Channels by `channel1` and `channel2`.
    type(channel_type), intent(in) :: channel(2)

    select case (urn%shape)
    case (shape_polygon)
      urn%urn_shape_type = new_polygon(urn%corner, channel)
    case default
      urn%urn_shape_type = new_disc(urn%radius, channel)
    end select
  end subroutine derive_shape

  !> Whether two urns are mirror images of each other, so that one batch of visits serves both.
  pure function are_mirror_images(urn)
    type(urn_type), intent(in) :: urn(2)
    logical :: are_mirror_images

    are_mirror_images = urn(1)%shape == urn(2)%shape .and. .not. abs(urn(1)%radius &
      - urn(2)%radius) > 0.0_wp
    if (.not. are_mirror_images .or. urn(1)%shape /= shape_polygon) return
    are_mirror_images = size(urn(1)%corner, 2) == size(urn(2)%corner, 2)
    if (are_mirror_images) are_mirror_images = .not. any(abs(urn(1)%corner - urn(2)%corner) &
      > 0.0_wp)
  end function are_mirror_images

  !> Whether a point that is in no channel is inside, or at most `tolerance` outside.
  elemental function contains_point(urn, x, y, tolerance) result(inside)
    type(urn_type), intent(in) :: urn
    !> Position in the frame of the urn, and a distance: lengths.
    real(wp), intent(in) :: x, y, tolerance
    logical :: inside

    select case (urn%shape)
    case (shape_polygon)
      inside = is_in_polygon(urn%polygon, x, y, tolerance)
    case default
      inside = is_in_disc(urn%urn_shape_type, x, y, tolerance)
    end select
  end function contains_point

  !> Trial point in the frame of the table, from two numbers `across` and `up` uniform in [0, 1]:
  !> uniform in the urn, if `inside`.
  pure subroutine try_random_point(urn, across, up, x, y, inside)
    type(urn_type), intent(in) :: urn
    real(wp), intent(in) :: across, up
    !> Position in the frame of the table, lengths.
    real(wp), intent(out) :: x, y
    logical, intent(out) :: inside

    select case (urn%shape)
    case (shape_polygon)
      call try_point_in_polygon(urn%polygon, across, up, x, y, inside)
    case default
      call try_point_in_disc(urn%urn_shape_type, across, up, x, y, inside)
    end select
    x = urn%axis_sign*(x - urn%centre)
  end subroutine try_random_point

  !> Computes the passages through the urn of a batch of visits that `cross_channels` has taken to
  !> the urn; input and output are explained at `visits_type`.
  subroutine compute_passages(urn, visits)
    type(urn_type), intent(in) :: urn
    type(visits_type), intent(inout) :: visits

    select case (urn%shape)
    case (shape_polygon)
      call compute_polygon_passages(urn%urn_shape_type, visits)
    case default
      call compute_disc_passages(urn%urn_shape_type, visits)
    end select
  end subroutine compute_passages

  !> Finds the first impact of a particle in the urn, openings counted as wall, in the form that
  !> `locate_in_passage` expects for a passage that never ends.
  pure subroutine find_first_impact(urn, x, y, ux, uy, at, u_axial, u_lateral, wait, before)
    type(urn_type), intent(in) :: urn
    !> Position and velocity in the frame of the urn: lengths, and a vector of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> y, `u_axial` and `u_lateral` of `visits_type` at that impact; the time until then.
    real(wp), intent(out) :: at, u_axial, u_lateral, wait
    !> Wall hits until the impact that `locate_in_passage` does not count.
    integer(int64), intent(out) :: before

    select case (urn%shape)
    case (shape_polygon)
      call find_first_impact_in_polygon(urn%polygon, x, y, ux, uy, at, u_axial, u_lateral, wait, &
        before)
    case default
      call find_first_impact_in_disc(urn%urn_shape_type, x, y, ux, uy, at, u_axial, u_lateral, wait)
      ! `locate_in_disc` counts the impact itself.
      before = 0
    end select
  end subroutine find_first_impact

  !> Position of a particle at the time `elapsed` after a given state in the urn, which it has not
  !> left since.
  pure subroutine locate_after(urn, x, y, ux, uy, elapsed, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    !> The given state in the frame of the urn: lengths, and a vector of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> Time since then.
    real(wp), intent(in) :: elapsed
    !> x and y of each.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Wall hits since then.
    integer(int64), intent(out) :: hits
    real(wp) :: at, u_axial, u_lateral, wait
    integer(int64) :: before

    call find_first_impact(urn, x, y, ux, uy, at, u_axial, u_lateral, wait, before)
    call locate_in_passage(urn, no_channel, at, u_axial, u_lateral, elapsed - wait, position, &
      velocity, hits)
    hits = hits + before
  end subroutine locate_after

  !> As `locate_after`, from the start of a passage, on the path that `compute_passages` takes: by
  !> the same operations, so that it passes each corner on the same side. After the end of the
  !> passage the particle stays there, and `hits` is the number of hits of the whole passage.
  subroutine follow_passage(urn, x, y, ux, uy, elapsed, position, velocity, hits)
    type(urn_type), intent(in) :: urn
    !> Start of the passage in the frame of the urn: lengths, and a vector of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> Time since then.
    real(wp), intent(in) :: elapsed
    !> x and y of each.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Wall hits since then.
    integer(int64), intent(out) :: hits

    select case (urn%shape)
    case (shape_polygon)
      call follow_polygon_passage(urn%urn_shape_type, x, y, ux, uy, elapsed, position, velocity, &
        hits)
    case default
      call locate_after(urn, x, y, ux, uy, elapsed, position, velocity, hits)
    end select
  end subroutine follow_passage

  !> Position of a particle in the urn at a time relative to an impact, or to the end of its
  !> passage.
  pure subroutine locate_in_passage(urn, channel, y, u_axial, u_lateral, since, position, &
    velocity, hits)
    type(urn_type), intent(in) :: urn
    !> Channel to which the passage leads; `no_channel` or `truncated`.
    integer, intent(in) :: channel
    !> Height, |u_x| and u_y at the chord, or the description of an impact (`visits_type`).
    real(wp), intent(in) :: y, u_axial, u_lateral
    !> Time since the impact or the end of the passage; below 0: time until then. The particle has
    !> not left the urn.
    real(wp), intent(in) :: since
    !> x and y of each in the frame of the urn: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Wall hits since then; below 0: minus the number of hits until then.
    integer(int64), intent(out) :: hits
    logical :: passes_corner

    select case (urn%shape)
    case (shape_polygon)
      call locate_in_polygon(urn%urn_shape_type, channel, y, u_axial, u_lateral, since, position, &
        velocity, hits, passes_corner)
    case default
      call locate_in_disc(urn%urn_shape_type, channel, y, u_axial, u_lateral, since, position, &
        velocity, hits)
    end select
  end subroutine locate_in_passage

  !> Whether the path of `locate_in_passage`, with the same arguments, meets a corner of a polygon,
  !> so that it may not be the one that was taken.
  pure function meets_corner(urn, channel, y, u_axial, u_lateral, since)
    type(urn_type), intent(in) :: urn
    !> As in `locate_in_passage`.
    integer, intent(in) :: channel
    real(wp), intent(in) :: y, u_axial, u_lateral, since
    logical :: meets_corner
    real(wp) :: position(2), velocity(2)
    integer(int64) :: hits

    meets_corner = .false.
    if (urn%shape == shape_polygon) call locate_in_polygon(urn%urn_shape_type, channel, y, &
      u_axial, u_lateral, since, position, velocity, hits, meets_corner)
  end function meets_corner

  !> Finds the wall or opening `next` that a particle in the urn, or at an opening, reaches first,
  !> and the time `wait` until then.
  pure subroutine find_next_wall(urn, from, x, y, ux, uy, next, wait)
    type(urn_type), intent(in) :: urn
    !> Channel on whose chord the particle is, or `no_channel`.
    integer, intent(in) :: from
    !> Position and velocity in the frame of the urn.
    real(wp), intent(in) :: x, y, ux, uy
    integer(wall_kind), intent(out) :: next
    real(wp), intent(out) :: wait

    select case (urn%shape)
    case (shape_polygon)
      call find_next_wall_in_polygon(urn%polygon, from, x, y, ux, uy, next, wait)
    case default
      call find_next_wall_in_disc(urn%urn_shape_type, from, x, y, ux, uy, next, wait)
    end select
  end subroutine find_next_wall

  !> Reflects a particle at the wall `next`; finds the wall or opening that it reaches then, the new
  !> `next`, and the time `wait` until then.
  pure subroutine reflect_at_wall(urn, x, y, ux, uy, next, wait)
    type(urn_type), intent(in) :: urn
    !> Position and velocity in the frame of the urn.
    real(wp), intent(inout) :: x, y, ux, uy
    integer(wall_kind), intent(inout) :: next
    real(wp), intent(out) :: wait

    select case (urn%shape)
    case (shape_polygon)
      call reflect_in_polygon(urn%polygon, x, y, ux, uy, next, wait)
    case default
      call reflect_in_disc(urn%urn_shape_type, urn%clock_resolution, x, y, ux, uy, next, wait)
    end select
  end subroutine reflect_at_wall

  !> If a particle is beyond a wall (`was_beyond`), mirrors its position in the wall and reflects
  !> its velocity.
  pure subroutine reflect_overshoot(urn, x, y, ux, uy, was_beyond)
    type(urn_type), intent(in) :: urn
    !> Position and velocity in the frame of the urn.
    real(wp), intent(inout) :: x, y, ux, uy
    logical, intent(out) :: was_beyond

    select case (urn%shape)
    case (shape_polygon)
      call reflect_overshoot_in_polygon(urn%polygon, x, y, ux, uy, was_beyond)
    case default
      call reflect_overshoot_in_disc(urn%urn_shape_type, x, y, ux, uy, was_beyond)
    end select
  end subroutine reflect_overshoot

end module battery_urn

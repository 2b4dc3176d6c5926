!> The shape of an urn: the quantities that every shape provides, and the passage of a
!> batch of visits through the straight channels before the openings.
!>
!> Particles do not interact in an urn. A passage through it is a pure function from entry (opening,
!> position, direction) to exit (opening, position, direction, duration, hits). Each shape computes
!> it in its own way: the disc by rotation and search, others from wall to wall. `battery_urn`
!> dispatches the procedures of the shapes.
!>
!> Frame of either urn: the origin lies between the openings, channel 1 at +x, channel 2 at -x (urn
!> 2 is mirrored). A channel starts at a chord perpendicular to the axis.
module battery_urn_shape
  use battery_kinds, only: wp, int64, angle_kind, pi
  use battery_channel, only: channel_type, channel1, channel2, fold_into_channel
  use battery_motion, only: least_across
  use battery_visits, only: visits_type, group_size
  implicit none (type, external)
  private
  public :: urn_shape_type, disc_type, polygon_type, set_openings, mean_urn_passage, cross_channels

  !> What only a disc has. Its radius is the reach of its urn.
  type :: disc_type
    !> 1/radius**2.
    real(wp) :: curvature2 = 1.0_wp
    !> Half widths of the openings in units of the radius; half the angles of their arcs, as
    !> integers.
    real(wp) :: half_opening(2) = 0.0_wp
    integer(angle_kind) :: angle(2) = 0
    !> Whether passages are first computed by stepping from impact to impact.
    logical :: stepping_pays = .true.
  end type disc_type

  !> What only a polygon has. Side k goes from corner k to corner k + 1.
  type :: polygon_type
    integer :: sides = 0
    !> Corners; the first is repeated at the end.
    real(wp), allocatable :: x(:), y(:)
    !> By side: outward normal, of length 1; distance from the origin along it; length; arc length
    !> along the outline at which the side starts.
    real(wp), allocatable :: normal_x(:), normal_y(:), offset(:), length_of(:), arc_start(:)
    !> Half the width of the opening in a side; -1 if it has none.
    real(wp), allocatable :: half_opening(:)
    !> Sides with the openings of channel 1 and 2 (0: none); length of the outline.
    integer :: side(2) = 0
    real(wp) :: outline_length = 0.0_wp
    !> Whether the polygon is convex: a path out of it crosses one side only.
    logical :: convex = .false.
    !> Lengths below this may be rounding errors.
    real(wp) :: tolerance = 0.0_wp
  end type polygon_type

  !> What every shape provides; lengths in the unit of the table.
  type :: urn_shape_type
    !> By channel: distance of its chord from the origin, its width, half its width, its length.
    real(wp), dimension(2) :: chord = 0.0_wp, width = 0.0_wp, half_width = 0.0_wp, length = 0.0_wp
    !> Whether the openings fit; whether the urn extends beside or over a channel.
    logical :: fits = .false., overhangs = .false.
    !> Area, and length of the walls without the openings.
    real(wp) :: area = 0.0_wp, perimeter = 0.0_wp
    !> Greatest distance of a point of the urn from the origin. Points between the chords whose
    !> distance from the origin is at most `clear` are inside; 0 if the origin is outside.
    real(wp) :: reach = 0.0_wp, clear = 0.0_wp
    !> A time step below this is small compared with the urn, and leads across no wall from one part
    !> of the urn into another.
    real(wp) :: longest_step = 0.0_wp
    !> A passage through the urn is at least as long as the depths of its two openings together,
    !> which may be the same opening.
    real(wp) :: depth(2) = 0.0_wp
    !> Who moves through an opening with a component across it not above this runs along it.
    real(wp) :: least_across = least_across
    !> Whether passages with very many hits are truncated (`truncated` of `battery_visits`).
    logical :: truncates_passages = .false.
    !> What only its shape has; the other is not set.
    type(disc_type) :: disc
    type(polygon_type) :: polygon
  end type urn_shape_type

contains

  !> Sets the channels at the openings.
  pure subroutine set_openings(shape, channel)
    class(urn_shape_type), intent(inout) :: shape
    !> Channels by `channel1` and `channel2`.
    type(channel_type), intent(in) :: channel(2)

    shape%width = channel%width
    shape%half_width = 0.5_wp*channel%width
    shape%length = channel%length
  end subroutine set_openings

  !> Mean length of the passages through an urn that particles enter uniformly through its openings.
  pure function mean_urn_passage(shape) result(time)
    class(urn_shape_type), intent(in) :: shape
    real(wp) :: time

    time = pi*shape%area/(shape%width(channel1) + shape%width(channel2))
  end function mean_urn_passage

  !> Moves a batch of visits from the entrance of their channel to its end at the urn: an
  !> unfolded channel is crossed in one step, see `fold_into_channel`.
  subroutine cross_channels(shape, visits)
    class(urn_shape_type), intent(in) :: shape
    type(visits_type), intent(inout) :: visits

    call cross_straight_channels(group_size*((visits%count + group_size - 1)/group_size), &
      visits%time, visits%passage, visits%channel, visits%x, visits%y, visits%u_axial, &
      visits%u_lateral, visits%hits)

  contains

    !> Kernel over flat arrays, padded to whole groups; without branches, so that it is vectorised.
    pure subroutine cross_straight_channels(n, time, passage, channel, x, y, u_axial, u_lateral, &
      hits)
      integer, intent(in) :: n
      integer(int64), intent(in) :: channel(n)
      real(wp), intent(in) :: passage(n)
      real(wp), intent(inout) :: time(n), x(n), y(n), u_axial(n), u_lateral(n), hits(n)
      real(wp) :: width, unfolded, reflected, passed
      real(wp) :: width1, width2, chord1, chord2
      integer :: j

      width1 = shape%width(channel1)
      width2 = shape%width(channel2)
      chord1 = shape%chord(channel1)
      chord2 = shape%chord(channel2)
      do j = 1, n
        width = merge(width1, width2, channel(j) == channel1)
        unfolded = y(j) + u_lateral(j)*passage(j)
        call fold_into_channel(unfolded, width, y(j), reflected, passed)
        u_lateral(j) = reflected*u_lateral(j)
        time(j) = time(j) + passage(j)
        x(j) = merge(chord1, -chord2, channel(j) == channel1)
        u_axial(j) = merge(-u_axial(j), u_axial(j), channel(j) == channel1)
        hits(j) = passed
      end do
    end subroutine cross_straight_channels

  end subroutine cross_channels

end module battery_urn_shape

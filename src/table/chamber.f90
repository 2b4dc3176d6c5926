!> A chamber: what a visit is asked of, and in which a particle is alone.
!>
!> An urn of any shape, with the straight half channels before its openings. A visit is a pure
!> function: in at an opening, at a place, in a direction; out at an opening, at a place, in a
!> direction, after a time and a number of wall hits. How a shape finds it is its own: the disc by
!> rotation and by search, others from wall to wall. Here is what all shapes tell of themselves, in
!> numbers; what they do is asked through `battery_urn`.
!>
!> Frame of an urn on either side: the origin lies between the openings, channel 1 at +x, channel 2
!> at -x (urn 2 is mirrored). Where a channel begins, a chord stands upright across the axis.
module battery_chamber
  use battery_kinds, only: wp, int64, pi
  use battery_channel, only: channel_type, gated, ungated, fold
  use battery_visits, only: visits_type, together
  implicit none (type, external)
  private
  public :: chamber_type, set_openings, mean_visit, cross_channels

  !> What every shape tells of itself; lengths in the unit of the table.
  type :: chamber_type
    !> Of each channel: the distance of its chord from the origin, its width, half of that, and its
    !> length.
    real(wp), dimension(2) :: chord = 0.0_wp, width = 0.0_wp, half_width = 0.0_wp, length = 0.0_wp
    !> Whether there is room for the openings; whether it reaches over a channel, beside that.
    logical :: fits = .false., overhangs = .false.
    !> Area, and length of the walls that the openings leave.
    real(wp) :: area = 0.0_wp, perimeter = 0.0_wp
    !> Nothing of it is farther from the origin than `reach`. What lies between the chords and no
    !> farther from the origin than `clear` is inside; 0: the origin is not.
    real(wp) :: reach = 0.0_wp, clear = 0.0_wp
    !> A step that is shorter is small beside the urn, and leads through no wall between two of its
    !> parts.
    real(wp) :: longest_step = 0.0_wp
    !> No way through the urn is shorter than the depths of its two openings together, which may be
    !> one and the same.
    real(wp) :: depth(2) = 0.0_wp
    !> Whether long visits are handed on in parts (`truncated` of `battery_visits`).
    logical :: truncates_visits = .false.
  end type chamber_type

contains

  !> The channels at the openings.
  pure subroutine set_openings(chamber, channel)
    class(chamber_type), intent(inout) :: chamber
    !> By `gated` and `ungated`.
    type(channel_type), intent(in) :: channel(2)

    chamber%width = channel%width
    chamber%half_width = 0.5_wp*channel%width
    chamber%length = channel%length
  end subroutine set_openings

  !> Mean length of a visit to an urn that is entered evenly through its openings.
  pure function mean_visit(chamber) result(time)
    class(chamber_type), intent(in) :: chamber
    real(wp) :: time

    time = pi*chamber%area/(chamber%width(gated) + chamber%width(ungated))
  end function mean_visit

  !> From the entrance of a channel to its exit into the urn: unfolded, a straight channel is one
  !> fold.
  subroutine cross_channels(chamber, visits)
    class(chamber_type), intent(in) :: chamber
    type(visits_type), intent(inout) :: visits

    call cross_straight_channels(together*((visits%count + together - 1)/together), visits%time, &
      visits%passage, visits%channel, visits%x, visits%y, visits%u_axial, visits%u_lateral, &
      visits%hits)

  contains

    pure subroutine cross_straight_channels(n, time, passage, channel, x, y, u_axial, u_lateral, &
      hits)
      integer, intent(in) :: n
      integer(int64), intent(in) :: channel(n)
      real(wp), intent(in) :: passage(n)
      real(wp), intent(inout) :: time(n), x(n), y(n), u_axial(n), u_lateral(n), hits(n)
      real(wp) :: width, unfolded, reflected, passed
      real(wp) :: width1, width2, chord1, chord2
      integer :: j

      width1 = chamber%width(gated)
      width2 = chamber%width(ungated)
      chord1 = chamber%chord(gated)
      chord2 = chamber%chord(ungated)
      do j = 1, n
        width = merge(width1, width2, channel(j) == gated)
        unfolded = y(j) + u_lateral(j)*passage(j)
        call fold(unfolded, width, y(j), reflected, passed)
        u_lateral(j) = reflected*u_lateral(j)
        time(j) = time(j) + passage(j)
        x(j) = merge(chord1, -chord2, channel(j) == gated)
        u_axial(j) = merge(-u_axial(j), u_axial(j), channel(j) == gated)
        hits(j) = passed
      end do
    end subroutine cross_straight_channels

  end subroutine cross_channels

end module battery_chamber

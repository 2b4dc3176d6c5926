!> A chamber: what a visit is asked of, and in which a particle is alone.
!>
!> An urn of any shape, with the straight half channels before its openings. A visit is a pure
!> function: in at an opening, at a place, in a direction; out at an opening, at a place, in a
!> direction, after a time and a number of wall hits. How a kind of chamber finds it is its own: the
!> disc by rotation and by search, others from wall to wall. Visits are computed in batches, and the
!> kind is asked once a batch, never once a particle.
!>
!> Local frame of an urn on either side: the centre is the origin, channel 1 lies at +x, channel 2
!> at -x (urn 2 is mirrored).
module battery_chamber
  use battery_kinds, only: wp, int64
  use battery_table, only: table_type, gated, ungated
  use battery_visits, only: visits_type, together
  use battery_channel, only: fold
  implicit none (type, external)
  private
  public :: chamber_type, prepare_openings, leave_channels

  !> What every kind of chamber has and does; lengths in the unit of the table.
  type, abstract :: chamber_type
    !> Of each channel: the distance of its chord from the centre, its width and its length.
    real(wp) :: chord(2) = 0.0_wp, width(2) = 0.0_wp, length(2) = 0.0_wp
  contains
    !> Whole visits of a batch: from the chord where the urn begins to that where it ends.
    procedure(cross_interface), deferred :: cross
    !> Where within a visit a particle is.
    procedure(before_interface), deferred :: place_before
    !> Where a particle is that never leaves.
    procedure(endless_interface), deferred :: place_endless
  end type chamber_type

  abstract interface
    !> From the point (x, y) with velocity (along, across) in the local frame through the urn.
    !> `hits` grows by the wall hits; `all_hits` is their sum.
    subroutine cross_interface(self, visits)
      import :: chamber_type, visits_type
      implicit none (type, external)
      class(chamber_type), intent(in) :: self
      type(visits_type), intent(inout) :: visits
    end subroutine cross_interface

    !> A length `before` ahead of leaving the urn through `channel`, at the height y with |u_x| =
    !> along and u_y = across; how many walls it hits in between.
    pure subroutine before_interface(self, channel, y, along, across, before, position, velocity, &
        hits)
      import :: chamber_type, wp, int64
      implicit none (type, external)
      class(chamber_type), intent(in) :: self
      integer, intent(in) :: channel
      real(wp), intent(in) :: y, along, across, before
      real(wp), intent(out) :: position(2), velocity(2)
      integer(int64), intent(out) :: hits
    end subroutine before_interface

    !> `elapsed` after an impact at `angle` with this cosine and sine of the incidence; how many
    !> walls it has hit since, the first included.
    pure subroutine endless_interface(self, elapsed, angle, cosine, sine, position, velocity, hits)
      import :: chamber_type, wp, int64
      implicit none (type, external)
      class(chamber_type), intent(in) :: self
      real(wp), intent(in) :: elapsed, angle, cosine, sine
      real(wp), intent(out) :: position(2), velocity(2)
      integer(int64), intent(out) :: hits
    end subroutine endless_interface
  end interface

contains

  !> The openings of the urn of a side of the table.
  pure subroutine prepare_openings(chamber, table, side)
    class(chamber_type), intent(inout) :: chamber
    type(table_type), intent(in) :: table
    !> 1 or 2.
    integer, intent(in) :: side

    chamber%chord = table%urn(side)%chord
    chamber%width = table%channel%width
    chamber%length = table%channel%length
  end subroutine prepare_openings

  !> From the entrance of a channel to its exit into the urn: unfolded, a straight channel is one
  !> fold.
  subroutine leave_channels(chamber, visits)
    class(chamber_type), intent(in) :: chamber
    type(visits_type), intent(inout) :: visits

    call leave(together*((visits%count + together - 1)/together), visits%time, visits%passage, &
      visits%channel, visits%x, visits%y, visits%along, visits%across, visits%hits)

  contains

    pure subroutine leave(n, time, passage, channel, x, y, along, across, hits)
      integer, intent(in) :: n
      integer(int64), intent(in) :: channel(n)
      real(wp), intent(in) :: passage(n)
      real(wp), intent(inout) :: time(n), x(n), y(n), along(n), across(n), hits(n)
      real(wp) :: width, unfolded, turned, passed
      real(wp) :: width1, width2, chord1, chord2
      integer :: j

      width1 = chamber%width(gated)
      width2 = chamber%width(ungated)
      chord1 = chamber%chord(gated)
      chord2 = chamber%chord(ungated)
      do j = 1, n
        width = merge(width1, width2, channel(j) == gated)
        unfolded = y(j) + across(j)*passage(j)
        call fold(unfolded, width, y(j), turned, passed)
        across(j) = turned*across(j)
        time(j) = time(j) + passage(j)
        x(j) = merge(chord1, -chord2, channel(j) == gated)
        along(j) = merge(-along(j), along(j), channel(j) == gated)
        hits(j) = passed
      end do
    end subroutine leave

  end subroutine leave_channels

end module battery_chamber

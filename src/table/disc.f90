!> Visits to an urn: many particles at once, each alone, from the way out of a channel to the way
!> into the next.
!>
!> Local frame of either urn: the centre is the origin, channel 1 lies at +x, channel 2 at -x (urn 2
!> is mirrored). With the incidence of a particle, s = sin and c = cos of its angle to the normal,
!> the points of impact are p_1 = u (c - i s), p_(n+1) = z p_n with z = (s - c)(s + c) + 2 i s c, as
!> complex numbers of modulus 1 in units of the radius, and the velocity before the impact at p is
!> (c + i s) p. The first point of impact within an opening ends the visit; the way back from there
!> to the chord is one division.
!>
!> How visits are computed: `disc_visits.f90`.
module battery_disc
  use battery_kinds, only: wp, int64, angle_kind, pi
  use battery_table, only: table_type, gated, ungated
  use battery_rotation, only: to_turn
  use battery_chamber, only: chamber_type, prepare_openings
  use battery_visits, only: visits_type
  implicit none (type, external)
  private
  public :: disc_type, new_disc, cross_urns, position_before

  !> With fewer expected particles leaving per impact than this, stepping does not pay.
  real(wp), parameter :: march_worthwhile = 0.01_wp

  !> What a visit to a disc needs to know.
  type, extends(chamber_type) :: disc_type
    real(wp) :: radius = 1.0_wp
    !> Half widths of the openings in units of the radius, and half their angles.
    real(wp) :: half(2) = 0.0_wp
    integer(angle_kind) :: angle(2) = 0
    !> Whether stepping from impact to impact pays.
    logical :: step_first = .true.
  contains
    procedure :: cross => cross_urns
    procedure :: place_before => position_before
    procedure :: place_endless
  end type disc_type

  interface
    !> Whole visits of a batch: what they need and what they yield is told at `visits_type`.
    module subroutine cross_urns(self, visits)
      implicit none (type, external)
      class(disc_type), intent(in) :: self
      type(visits_type), intent(inout) :: visits
    end subroutine cross_urns
  end interface

contains

  !> The urn of a side of the table.
  pure function new_disc(table, side) result(disc)
    type(table_type), intent(in) :: table
    !> 1 or 2.
    integer, intent(in) :: side
    type(disc_type) :: disc

    call prepare_openings(disc, table, side)
    disc%radius = table%urn(side)%radius
    disc%half = 0.5_wp*disc%width/disc%radius
    disc%angle = to_turn(asin(disc%half))
    disc%step_first = sum(disc%half) > march_worthwhile*pi
  end function new_disc

  !> Where a particle is, in the local frame, a length `before` ahead of leaving an urn, if it was
  !> in the urn all that time, and how many walls it hits in between.
  pure subroutine position_before(self, channel, y, along, across, before, position, velocity, &
    hits)
    class(disc_type), intent(in) :: self
    !> The channel it leaves through, at the height y, with |u_x| and u_y.
    integer, intent(in) :: channel
    !> Height and `before` are lengths; the velocity, of length 1, is that at the chord.
    real(wp), intent(in) :: y, along, across, before
    !> x and y of each: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> How many, 0 or more.
    integer(int64), intent(out) :: hits
    real(wp) :: x, ux, s, c, ahead, turn, rest
    complex(wp) :: impact, incidence

    x = merge(self%chord(gated), -self%chord(ungated), channel == gated)
    ux = merge(along, -along, channel == gated)
    s = (x*across - y*ux)/self%radius
    c = sqrt(max((1.0_wp - s)*(1.0_wp + s), 0.0_wp))
    ! The impact in the opening, which does not happen, is `ahead` of the chord.
    ahead = self%radius*c - (x*ux + y*across)
    incidence = cmplx(c, s, wp)
    impact = cmplx(ux, across, wp)*conjg(incidence)
    if (c > 0.0_wp) then
      hits = int((before + ahead)/(2.0_wp*self%radius*c), int64)
    else
      hits = 0
    end if
    ! Within its chord even where the length is so great that rounding is longer than a chord.
    rest = before + ahead - 2.0_wp*self%radius*c*real(hits, wp)
    rest = min(max(rest, 0.0_wp), 2.0_wp*self%radius*c)
    turn = atan2(2.0_wp*s*c, (s - c)*(s + c))
    turn = -modulo(real(hits, wp)*turn, 2.0_wp*pi)
    impact = impact*cmplx(cos(turn), sin(turn), wp)
    impact = impact/abs(impact)
    velocity = [real(incidence*impact, wp), aimag(incidence*impact)]
    position = self%radius*[real(impact, wp), aimag(impact)] - rest*velocity
  end subroutine position_before

  !> For ever along a regular star; without length of its chords, along the wall.
  pure subroutine place_endless(self, elapsed, angle, cosine, sine, position, velocity, hits)
    class(disc_type), intent(in) :: self
    !> Time since an impact, which lies at this angle (radians, from the x axis of the local frame);
    !> cosine and sine of the incidence.
    real(wp), intent(in) :: elapsed, angle, cosine, sine
    !> x and y of each in the local frame: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Wall hits since that impact, itself included; less than 0: so many come before it.
    integer(int64), intent(out) :: hits
    real(wp) :: step, turned, rest
    complex(wp) :: impact

    step = 2.0_wp*self%radius*cosine
    hits = 0
    if (step > 0.0_wp) hits = floor(elapsed/step, int64)
    rest = elapsed - real(hits, wp)*step
    turned = angle + modulo(real(hits, wp)*2.0_wp*acos(sine), 2.0_wp*pi)
    if (.not. step > 0.0_wp) then
      ! A chord without length: the particle glides along the wall.
      turned = angle + sine*rest/self%radius
      rest = 0.0_wp
    end if
    impact = cmplx(cos(turned), sin(turned), wp)
    velocity = [real(impact*cmplx(-cosine, sine, wp), wp), aimag(impact*cmplx(-cosine, sine, wp))]
    position = self%radius*[real(impact, wp), aimag(impact)] + rest*velocity
    hits = hits + 1
  end subroutine place_endless

end module battery_disc

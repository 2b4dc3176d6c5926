!> The disc, less the segments that the chords of its openings cut off.
!>
!> **Whole visits**, many particles at once, each alone, from the way out of a channel to the way
!> into the next. The centre is the origin of the frame. With the incidence of a particle, s = sin
!> and c = cos of its angle to the normal, the points of impact are p_1 = u (c - i s), p_(n+1) =
!> z p_n with z = (s - c)(s + c) + 2 i s c, as complex numbers of modulus 1 in units of the radius,
!> and the velocity before the impact at p is (c + i s) p. The first point of impact within an
!> opening ends the visit; the way back from there to the chord is one division.
!>
!> How visits are computed: `disc_visits.f90`.
!>
!> **From wall to wall**: a line and a circle. A particle is put exactly on what it meets; its speed
!> is set back to 1 by a Newton step at each hit.
module battery_disc
  use battery_kinds, only: wp, int64, angle_kind, pi
  use battery_channel, only: channel_type, gated, ungated, no_opening => no_channel
  use battery_chamber, only: chamber_type, set_openings
  use battery_motion, only: meets_wall, meets_gate, meets_return, meets_nothing, slowest, wall_kind
  use battery_rotation, only: to_turn
  implicit none (type, external)
  private
  public :: disc_type, new_disc, is_in_disc, try_point_in_disc, locate_in_disc
  public :: first_impact_in_disc, sharp_incidence
  public :: next_wall_in_disc, reflect_in_disc, reflect_overshoot_in_disc

  !> Incidences with a smaller cosine are computed anew, to all their digits.
  real(wp), parameter, public :: grazing_cosine = 1.0e-3_wp

  !> With fewer expected particles leaving per impact than this, stepping does not pay.
  real(wp), parameter :: least_exit_share = 0.01_wp

  !> What a visit to a disc needs to know.
  type, extends(chamber_type) :: disc_type
    !> Radius, and 1 over its square.
    real(wp) :: radius = 1.0_wp, curvature2 = 1.0_wp
    !> Half widths of the openings in units of the radius, and half their angles.
    real(wp) :: half_opening(2) = 0.0_wp
    integer(angle_kind) :: angle(2) = 0
    !> Whether stepping from impact to impact pays.
    logical :: stepping_pays = .true.
  end type disc_type

contains

  !> A disc with openings. The way back to an opening: its points of impact go round the circle in
  !> one sense, by at most half a turn each, so one of them lies in the far half of the disc; there
  !> and back is at least twice the distance of the chord.
  pure function new_disc(radius, channel) result(disc)
    !> A length.
    real(wp), intent(in) :: radius
    !> The channels at its openings.
    type(channel_type), intent(in) :: channel(2)
    type(disc_type) :: disc
    real(wp) :: angle(2)

    call set_openings(disc, channel)
    disc%radius = radius
    disc%curvature2 = 1.0_wp/radius**2
    disc%half_opening = disc%half_width/radius
    disc%fits = all(disc%width < 2.0_wp*radius)
    ! Factored, so that it stays exact as the width goes to the diameter.
    disc%chord = sqrt((radius - disc%half_width)*(radius + disc%half_width))
    angle = asin(disc%half_opening)
    disc%angle = to_turn(angle)
    disc%stepping_pays = sum(disc%half_opening) > least_exit_share*pi
    disc%area = pi*radius**2 - segment_area(gated) - segment_area(ungated)
    disc%perimeter = radius*(2.0_wp*pi - 2.0_wp*angle(gated) - 2.0_wp*angle(ungated))
    disc%reach = radius
    disc%clear = radius
    disc%longest_step = radius
    disc%depth = disc%chord

  contains

    !> What the chord of a channel cuts off.
    pure function segment_area(of) result(area)
      integer, intent(in) :: of
      real(wp) :: area

      area = radius**2*angle(of) - disc%half_width(of)*disc%chord(of)
    end function segment_area

  end function new_disc

  !> Whether a point is inside, or no farther than `tolerance` outside.
  elemental function is_in_disc(disc, x, y, tolerance) result(inside)
    type(disc_type), intent(in) :: disc
    !> In the frame of the disc, lengths.
    real(wp), intent(in) :: x, y, tolerance
    logical :: inside

    inside = hypot(x, y) <= disc%radius + tolerance
  end function is_in_disc

  !> A point from two numbers `across` and `up` uniform in [0, 1]: uniform in the disc, between the
  !> chords, where it is `inside`, which is so more than two times in five. Between near chords it
  !> is looked for there alone.
  pure subroutine try_point_in_disc(disc, across, up, x, y, inside)
    type(disc_type), intent(in) :: disc
    real(wp), intent(in) :: across, up
    !> In the frame of the disc, lengths.
    real(wp), intent(out) :: x, y
    logical, intent(out) :: inside

    associate (radius => disc%radius, lower => -disc%chord(ungated), upper => disc%chord(gated))
      if (upper - lower < radius) then
        x = lower + (upper - lower)*across
      else
        x = radius*(2.0_wp*across - 1.0_wp)
      end if
      y = radius*(2.0_wp*up - 1.0_wp)
      inside = x**2 + y**2 < radius**2 .and. lower < x .and. x < upper
    end associate
  end subroutine try_point_in_disc

  !> The first impact of a particle that is in the disc, also if an opening is there.
  pure subroutine first_impact_in_disc(disc, x, y, ux, uy, angle, cosine, sine, wait, before)
    type(disc_type), intent(in) :: disc
    !> Place, lengths, and velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> Its angle (radians, from the x axis), cosine and sine of the incidence; the time until then.
    real(wp), intent(out) :: angle, cosine, sine, wait
    !> Wall hits that `locate_in_disc` does not count from there on: none.
    integer(int64), intent(out) :: before

    sine = (x*uy - y*ux)/disc%radius
    cosine = sqrt(max((1.0_wp - sine)*(1.0_wp + sine), 0.0_wp))
    if (cosine < grazing_cosine) call sharp_incidence(disc, x, y, ux, uy, cosine, sine)
    angle = atan2(uy*cosine - ux*sine, ux*cosine + uy*sine)
    wait = disc%radius*cosine - (x*ux + y*uy)
    before = 0
  end subroutine first_impact_in_disc

  !> A grazing incidence to all its digits: from the depth below the circle and the way along it.
  pure subroutine sharp_incidence(disc, x, y, ux, uy, cosine, sine)
    type(disc_type), intent(in) :: disc
    !> Place, lengths, and velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> Cosine and sine; left as they are where they have their digits.
    real(wp), intent(inout) :: cosine, sine
    real(wp) :: px, py, half_opening, room, c

    px = x/disc%radius
    py = y/disc%radius
    half_opening = merge(disc%half_opening(gated), disc%half_opening(ungated), px > 0.0_wp)
    ! On a chord the depth is known without the cancellation.
    if (abs(x - merge(disc%chord(gated), -disc%chord(ungated), px > 0.0_wp)) > 0.0_wp) then
      room = (1.0_wp - abs(py))*(1.0_wp + abs(py)) - px**2
    else
      room = (half_opening - abs(py))*(half_opening + abs(py))
    end if
    c = sqrt(max(room, 0.0_wp) + (px*ux + py*uy)**2)
    if (.not. c < grazing_cosine) return
    cosine = c
    sine = sign(sqrt((1.0_wp - c)*(1.0_wp + c)), sine)
  end subroutine sharp_incidence

  !> Where a particle is at a time from what is known of an impact, or of the end of its visit: it
  !> is in the disc.
  pure subroutine locate_in_disc(disc, channel, y, u_axial, u_lateral, since, position, velocity, &
    hits)
    type(disc_type), intent(in) :: disc
    !> The channel it leaves through, or one that is none: never.
    integer, intent(in) :: channel
    !> Height (a length), |u_x| and u_y at the chord of that channel. Of one that never leaves the
    !> angle of an impact (radians, from the x axis), cosine and sine of the incidence.
    real(wp), intent(in) :: y, u_axial, u_lateral
    !> The time since then; below 0: until then.
    real(wp), intent(in) :: since
    !> x and y of each: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Of walls since then, an impact itself included; below 0: so many come before.
    integer(int64), intent(out) :: hits

    if (channel == gated .or. channel == ungated) then
      call trace_back_from_exit(disc, channel, y, u_axial, u_lateral, -since, position, velocity, &
        hits)
      hits = -hits
    else
      call trace_along_chords(disc, since, y, u_axial, u_lateral, position, velocity, hits)
    end if
  end subroutine locate_in_disc

  !> A length `before` ahead of leaving through a channel: how many `hits` come in between.
  pure subroutine trace_back_from_exit(disc, channel, y, u_axial, u_lateral, before, position, &
    velocity, hits)
    type(disc_type), intent(in) :: disc
    integer, intent(in) :: channel
    real(wp), intent(in) :: y, u_axial, u_lateral, before
    real(wp), intent(out) :: position(2), velocity(2)
    integer(int64), intent(out) :: hits
    real(wp) :: x, ux, s, c, ahead, rotation, rest
    complex(wp) :: impact, incidence

    x = merge(disc%chord(gated), -disc%chord(ungated), channel == gated)
    ux = merge(u_axial, -u_axial, channel == gated)
    s = (x*u_lateral - y*ux)/disc%radius
    c = sqrt(max((1.0_wp - s)*(1.0_wp + s), 0.0_wp))
    ! The impact in the opening, which does not happen, is `ahead` of the chord.
    ahead = disc%radius*c - (x*ux + y*u_lateral)
    incidence = cmplx(c, s, wp)
    impact = cmplx(ux, u_lateral, wp)*conjg(incidence)
    if (c > 0.0_wp) then
      hits = int((before + ahead)/(2.0_wp*disc%radius*c), int64)
    else
      hits = 0
    end if
    ! Within its chord even where the length is so great that rounding is longer than a chord.
    rest = before + ahead - 2.0_wp*disc%radius*c*real(hits, wp)
    rest = min(max(rest, 0.0_wp), 2.0_wp*disc%radius*c)
    rotation = atan2(2.0_wp*s*c, (s - c)*(s + c))
    rotation = -modulo(real(hits, wp)*rotation, 2.0_wp*pi)
    impact = impact*cmplx(cos(rotation), sin(rotation), wp)
    impact = impact/abs(impact)
    velocity = [real(incidence*impact, wp), aimag(incidence*impact)]
    position = disc%radius*[real(impact, wp), aimag(impact)] - rest*velocity
  end subroutine trace_back_from_exit

  !> Forwards from an impact, or back along the chord that leads to it, along a star; without length
  !> of its chords, along the wall.
  pure subroutine trace_along_chords(disc, elapsed, angle, cosine, sine, position, velocity, hits)
    type(disc_type), intent(in) :: disc
    real(wp), intent(in) :: elapsed, angle, cosine, sine
    real(wp), intent(out) :: position(2), velocity(2)
    integer(int64), intent(out) :: hits
    real(wp) :: step, impact_angle, rest
    complex(wp) :: impact

    step = 2.0_wp*disc%radius*cosine
    hits = 0
    ! Not before the impact before, whose chord leads to this one: rounding may have it otherwise.
    if (step > 0.0_wp) hits = max(floor(elapsed/step, int64), -1_int64)
    rest = elapsed - real(hits, wp)*step
    impact_angle = angle + modulo(real(hits, wp)*2.0_wp*atan2(cosine, sine), 2.0_wp*pi)
    if (.not. step > 0.0_wp) then
      ! A chord without length: the particle glides along the wall.
      impact_angle = angle + sine*rest/disc%radius
      rest = 0.0_wp
    end if
    impact = cmplx(cos(impact_angle), sin(impact_angle), wp)
    velocity = [real(impact*cmplx(-cosine, sine, wp), wp), aimag(impact*cmplx(-cosine, sine, wp))]
    position = disc%radius*[real(impact, wp), aimag(impact)] + rest*velocity
    hits = hits + 1
  end subroutine trace_along_chords

  !> What a particle meets first that is inside, or at an opening, and after which time: `wait`.
  pure subroutine next_wall_in_disc(disc, from, x, y, ux, uy, next, wait)
    type(disc_type), intent(in) :: disc
    !> The channel on whose chord it is, or `no_channel`.
    integer, intent(in) :: from
    !> Lengths, and the velocity, in the frame of the disc.
    real(wp), intent(in) :: x, y, ux, uy
    !> What it meets.
    integer(wall_kind), intent(out) :: next
    real(wp), intent(out) :: wait
    real(wp) :: outward, root, room

    if (from == no_opening) then
      room = max(disc%radius**2 - (x**2 + y**2), 0.0_wp)
    else
      ! On a chord, r**2 - q**2 is a product that stays exact however narrow the channel is.
      room = (disc%half_width(from) - abs(y))*(disc%half_width(from) + abs(y))
    end if
    outward = x*ux + y*uy
    root = sqrt(outward**2 + room)
    if (outward > 0.0_wp) then
      wait = room/(root + outward)
    else
      wait = root - outward
    end if
    call choose_opening(disc, x, ux, x + ux*wait, y + uy*wait, next, wait)
  end subroutine next_wall_in_disc

  !> Reflection from the arc, and the time `wait` until it meets what is next; huge if that is
  !> nothing. From a point of the circle the flight to the next one lasts -2 q.u: no root, nothing
  !> to cancel.
  pure subroutine reflect_in_disc(disc, shortest, x, y, ux, uy, next, wait)
    type(disc_type), intent(in) :: disc
    !> Shortest flight that a clock can tell from none.
    real(wp), intent(in) :: shortest
    !> Place and velocity in the frame of the disc.
    real(wp), intent(inout) :: x, y, ux, uy
    !> What it meets next.
    integer(wall_kind), intent(out) :: next
    real(wp), intent(out) :: wait
    real(wp) :: norm, outward, kick

    norm = 1.5_wp - 0.5_wp*disc%curvature2*(x**2 + y**2)
    x = norm*x
    y = norm*y
    outward = x*ux + y*uy
    ! A grazing particle may move inwards already, by rounding; then the hit leaves it alone.
    kick = 2.0_wp*disc%curvature2*max(outward, 0.0_wp)
    ux = ux - kick*x
    uy = uy - kick*y
    norm = 1.5_wp - 0.5_wp*(ux**2 + uy**2)
    ux = norm*ux
    uy = norm*uy
    wait = 2.0_wp*abs(outward)
    if (wait < shortest) then
      ! Along the wall: chords too short for any clock. It would hit for ever at one instant.
      next = meets_nothing
      wait = huge(1.0_wp)
    else
      call choose_opening(disc, x, ux, x + ux*wait, y + uy*wait, next, wait)
    end if
  end subroutine reflect_in_disc

  !> What is met by a particle that would be on the circle at (px, py) after `wait`. Only a point
  !> within an opening, its ends excluded, lets it out: a corner belongs to the urn.
  pure subroutine choose_opening(disc, x, ux, px, py, next, wait)
    type(disc_type), intent(in) :: disc
    real(wp), intent(in) :: x, ux, px, py
    integer(wall_kind), intent(out) :: next
    real(wp), intent(inout) :: wait

    next = meets_wall
    if (abs(py) >= merge(disc%half_width(gated), disc%half_width(ungated), px > 0.0_wp)) return
    ! By rounding the point may seem to lie just inside of a corner though the way leads inwards.
    if (px > 0.0_wp .and. ux > 0.0_wp) then
      next = meets_gate
      wait = min(max(disc%chord(gated) - x, 0.0_wp)/max(ux, slowest), wait)
    else if (px <= 0.0_wp .and. ux < 0.0_wp) then
      next = meets_return
      wait = min(max(x + disc%chord(ungated), 0.0_wp)/max(-ux, slowest), wait)
    end if
  end subroutine choose_opening

  !> A particle that a step has taken beyond the arc (it `was_beyond`) is mirrored in the circle,
  !> along the ray from the centre, and its velocity is reflected there.
  pure subroutine reflect_overshoot_in_disc(disc, x, y, ux, uy, was_beyond)
    type(disc_type), intent(in) :: disc
    !> Place and velocity in the frame of the disc.
    real(wp), intent(inout) :: x, y, ux, uy
    logical, intent(out) :: was_beyond
    real(wp) :: distance, outward, factor

    was_beyond = x**2 + y**2 > disc%radius**2
    if (.not. was_beyond) return
    distance = hypot(x, y)
    ! In a segment beyond a chord it may have come out of the channel into the wall.
    outward = max((x*ux + y*uy)/distance, 0.0_wp)
    ux = ux - 2.0_wp*outward*x/distance
    uy = uy - 2.0_wp*outward*y/distance
    factor = 1.5_wp - 0.5_wp*(ux**2 + uy**2)
    ux = factor*ux
    uy = factor*uy
    factor = 2.0_wp*disc%radius/distance - 1.0_wp
    x = factor*x
    y = factor*y
  end subroutine reflect_overshoot_in_disc

end module battery_disc

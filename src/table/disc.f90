!> Disc-shaped urn, less the segments that the chords of its openings cut off: its geometry, and the
!> motion from wall to wall.
!>
!> **Frame.** The centre is the origin, the radius is the `reach` of the urn. With s and c the sine
!> and cosine of a particle's incidence (the angle between its velocity and the normal), its impacts
!> are p_1 = u (c - i s) and p_(n+1) = z p_n with z = (s - c)(s + c) + 2 i s c: complex numbers of
!> modulus 1, in units of the radius. The velocity before the impact at p is (c + i s) p. The first
!> impact within an opening ends a passage; from there the chord is found backwards, by one
!> division. Batches of passages: `disc_passages.f90`.
!>
!> **From wall to wall** the intersections of a line and a circle are computed. A particle is placed
!> exactly on the wall or chord that it reaches; each hit sets its speed to 1 by a Newton step.
module battery_disc
  use battery_kinds, only: wp, int64, pi
  use battery_channel, only: channel_type, is_open, channel1, channel2, no_opening => no_channel
  use battery_urn_shape, only: urn_shape_type, set_openings
  use battery_motion, only: meets_wall, meets_gate, meets_channel2, meets_nothing, slowest, &
    least_across, wall_kind
  use battery_rotation, only: to_turn
  implicit none (type, external)
  private
  public :: urn_shape_type, new_disc, is_in_disc, try_point_in_disc, locate_in_disc
  public :: find_first_impact_in_disc, recompute_grazing_incidence
  public :: find_next_wall_in_disc, reflect_in_disc, reflect_overshoot_in_disc

  !> Incidences with a smaller cosine are recomputed to full precision.
  real(wp), parameter, public :: grazing_cosine = 1.0e-3_wp

  !> If the expected share of particles that leave at an impact is below this, stepping from impact
  !> to impact does not pay.
  real(wp), parameter :: least_exit_share = 0.01_wp

contains

  !> Makes a disc with openings. `depth` is the distance of the chord from the centre: impacts
  !> follow each other round the circle in one sense, by at most half a turn each, so on a path from
  !> an opening back to it one impact lies in the far half of the disc, and the path is at least
  !> twice as long as that distance.
  pure function new_disc(radius, channel) result(urn)
    !> Radius, a length.
    real(wp), intent(in) :: radius
    !> Channels at its openings.
    type(channel_type), intent(in) :: channel(2)
    type(urn_shape_type) :: urn
    real(wp) :: angle(2)

    call set_openings(urn, channel)
    urn%disc%curvature2 = 1.0_wp/radius**2
    urn%disc%half_opening = urn%half_width/radius
    urn%fits = all(urn%width < 2.0_wp*radius)
    ! As a product, exact even when the width approaches the diameter.
    urn%chord = sqrt((radius - urn%half_width)*(radius + urn%half_width))
    angle = asin(urn%disc%half_opening)
    urn%disc%angle = to_turn(angle)
    urn%disc%stepping_pays = sum(urn%disc%half_opening) > least_exit_share*pi
    urn%area = pi*radius**2 - segment_area(channel1) - segment_area(channel2)
    urn%perimeter = radius*(2.0_wp*pi - 2.0_wp*angle(channel1) - 2.0_wp*angle(channel2))
    urn%reach = radius
    urn%least_across = least_across*max(1.0_wp, maxval(channel%length, is_open(channel))/radius)
    urn%clear = radius
    urn%longest_step = radius
    urn%depth = urn%chord

  contains

    !> Area of the segment that the chord of a channel cuts off.
    pure function segment_area(of) result(area)
      integer, intent(in) :: of
      real(wp) :: area

      area = radius**2*angle(of) - urn%half_width(of)*urn%chord(of)
    end function segment_area

  end function new_disc

  !> Whether a point is inside the disc, or at most `tolerance` outside.
  elemental function is_in_disc(urn, x, y, tolerance) result(inside)
    type(urn_shape_type), intent(in) :: urn
    !> Position in the frame of the disc, and a distance: lengths.
    real(wp), intent(in) :: x, y, tolerance
    logical :: inside

    inside = hypot(x, y) <= urn%reach + tolerance
  end function is_in_disc

  !> Trial point from two numbers `across` and `up`, uniform in [0, 1]: uniform in the disc between
  !> the chords, if `inside`. It is inside in more than two of five trials: if the chords are close
  !> to each other, trial points lie between them.
  pure subroutine try_point_in_disc(urn, across, up, x, y, inside)
    type(urn_shape_type), intent(in) :: urn
    real(wp), intent(in) :: across, up
    !> Position in the frame of the disc, lengths.
    real(wp), intent(out) :: x, y
    logical, intent(out) :: inside

    associate (radius => urn%reach, lower => -urn%chord(channel2), upper => urn%chord(channel1))
      if (upper - lower < radius) then
        x = lower + (upper - lower)*across
      else
        x = radius*(2.0_wp*across - 1.0_wp)
      end if
      y = radius*(2.0_wp*up - 1.0_wp)
      inside = x**2 + y**2 < radius**2 .and. lower < x .and. x < upper
    end associate
  end subroutine try_point_in_disc

  !> First impact of a particle that is in the disc; openings count as wall.
  pure subroutine find_first_impact_in_disc(urn, x, y, ux, uy, angle, cosine, sine, wait)
    type(urn_shape_type), intent(in) :: urn
    !> Position, lengths, and velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> Angle of the impact (radians, from the x axis), cosine and sine of the incidence; time until
    !> the impact.
    real(wp), intent(out) :: angle, cosine, sine, wait

    sine = (x*uy - y*ux)/urn%reach
    cosine = sqrt(max((1.0_wp - sine)*(1.0_wp + sine), 0.0_wp))
    if (cosine < grazing_cosine) call recompute_grazing_incidence(urn, x, y, ux, uy, cosine, sine)
    angle = atan2(uy*cosine - ux*sine, ux*cosine + uy*sine)
    wait = urn%reach*cosine - (x*ux + y*uy)
  end subroutine find_first_impact_in_disc

  !> Recomputes a grazing incidence to full precision, from the depth below the circle and the
  !> velocity component along the radius.
  pure subroutine recompute_grazing_incidence(urn, x, y, ux, uy, cosine, sine)
    type(urn_shape_type), intent(in) :: urn
    !> Position, lengths, and velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    !> Cosine and sine; unchanged if the incidence is not grazing.
    real(wp), intent(inout) :: cosine, sine
    real(wp) :: px, py, half_opening, depth2, c

    px = x/urn%reach
    py = y/urn%reach
    half_opening = merge(urn%half_width(channel1), urn%half_width(channel2), px > 0.0_wp)/urn%reach
    ! On a chord the depth is a product, without cancellation.
    if (abs(x - merge(urn%chord(channel1), -urn%chord(channel2), px > 0.0_wp)) > 0.0_wp) then
      depth2 = (1.0_wp - abs(py))*(1.0_wp + abs(py)) - px**2
    else
      depth2 = (half_opening - abs(py))*(half_opening + abs(py))
    end if
    c = sqrt(max(depth2, 0.0_wp) + (px*ux + py*uy)**2)
    if (.not. c < grazing_cosine) return
    cosine = c
    sine = sign(sqrt((1.0_wp - c)*(1.0_wp + c)), sine)
  end subroutine recompute_grazing_incidence

  !> Position of a particle in the disc at a time relative to an impact, or to the end of its
  !> passage.
  pure subroutine locate_in_disc(urn, channel, y, u_axial, u_lateral, since, position, velocity, &
    hits)
    type(urn_shape_type), intent(in) :: urn
    !> Channel through which the passage ends; any other value: it never ends.
    integer, intent(in) :: channel
    !> Height (a length), |u_x| and u_y at the chord of that channel. For a passage that never ends:
    !> angle of an impact (radians, from the x axis), cosine and sine of the incidence.
    real(wp), intent(in) :: y, u_axial, u_lateral
    !> Time since the impact or the end of the passage; below 0: time until then.
    real(wp), intent(in) :: since
    !> x and y of each: lengths, and a vector of length 1.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Wall hits since then, the impact itself included; below 0: minus the number of hits until
    !> then.
    integer(int64), intent(out) :: hits

    if (channel == channel1 .or. channel == channel2) then
      call trace_back_from_exit(urn, channel, y, u_axial, u_lateral, -since, position, velocity, &
        hits)
      hits = -hits
    else
      call trace_along_chords(urn, since, y, u_axial, u_lateral, position, velocity, hits)
    end if
  end subroutine locate_in_disc

  !> Position at the length `before` ahead of the end of a passage, and the `hits` in between.
  pure subroutine trace_back_from_exit(urn, channel, y, u_axial, u_lateral, before, position, &
    velocity, hits)
    type(urn_shape_type), intent(in) :: urn
    integer, intent(in) :: channel
    real(wp), intent(in) :: y, u_axial, u_lateral, before
    real(wp), intent(out) :: position(2), velocity(2)
    integer(int64), intent(out) :: hits
    real(wp) :: x, ux, s, c, ahead, rotation, rest
    complex(wp) :: impact, incidence

    x = merge(urn%chord(channel1), -urn%chord(channel2), channel == channel1)
    ux = merge(u_axial, -u_axial, channel == channel1)
    s = (x*u_lateral - y*ux)/urn%reach
    c = sqrt(max((1.0_wp - s)*(1.0_wp + s), 0.0_wp))
    ! The virtual impact in the opening lies `ahead` of the chord.
    ahead = urn%reach*c - (x*ux + y*u_lateral)
    incidence = cmplx(c, s, wp)
    impact = cmplx(ux, u_lateral, wp)*conjg(incidence)
    if (c > 0.0_wp) then
      hits = int((before + ahead)/(2.0_wp*urn%reach*c), int64)
      ! Within the chord even if `before` is so long that its rounding error exceeds a chord.
      rest = before + ahead - 2.0_wp*urn%reach*c*real(hits, wp)
      rest = min(max(rest, 0.0_wp), 2.0_wp*urn%reach*c)
      rotation = atan2(2.0_wp*s*c, (s - c)*(s + c))
      rotation = -modulo(real(hits, wp)*rotation, 2.0_wp*pi)
    else
      ! Chords without length: the particle has glided along the wall.
      hits = 0
      rest = 0.0_wp
      rotation = -(before + ahead)*s/urn%reach
    end if
    impact = impact*cmplx(cos(rotation), sin(rotation), wp)
    impact = impact/abs(impact)
    velocity = [real(incidence*impact, wp), aimag(incidence*impact)]
    position = urn%reach*[real(impact, wp), aimag(impact)] - rest*velocity
  end subroutine trace_back_from_exit

  !> Follows the chords of a star-shaped path forwards from an impact, or back along the chord that
  !> leads to it; along the wall if the chords have no length.
  pure subroutine trace_along_chords(urn, elapsed, angle, cosine, sine, position, velocity, hits)
    type(urn_shape_type), intent(in) :: urn
    real(wp), intent(in) :: elapsed, angle, cosine, sine
    real(wp), intent(out) :: position(2), velocity(2)
    integer(int64), intent(out) :: hits
    real(wp) :: step, impact_angle, rest
    complex(wp) :: impact

    step = 2.0_wp*urn%reach*cosine
    hits = 0
    ! Despite rounding, at most one impact back, to the start of the chord that leads to this one.
    if (step > 0.0_wp) hits = max(floor(elapsed/step, int64), -1_int64)
    rest = elapsed - real(hits, wp)*step
    impact_angle = angle + modulo(real(hits, wp)*2.0_wp*atan2(cosine, sine), 2.0_wp*pi)
    if (.not. step > 0.0_wp) then
      ! Chords without length: the particle glides along the wall.
      impact_angle = angle + sine*rest/urn%reach
      rest = 0.0_wp
    end if
    impact = cmplx(cos(impact_angle), sin(impact_angle), wp)
    velocity = [real(impact*cmplx(-cosine, sine, wp), wp), aimag(impact*cmplx(-cosine, sine, wp))]
    position = urn%reach*[real(impact, wp), aimag(impact)] + rest*velocity
    hits = hits + 1
  end subroutine trace_along_chords

  !> Finds the wall or opening that a particle in the disc, or at an opening, reaches next, and the
  !> time `wait` until then.
  pure subroutine find_next_wall_in_disc(urn, from, x, y, ux, uy, next, wait)
    type(urn_shape_type), intent(in) :: urn
    !> Channel on whose chord the particle is, or `no_channel`.
    integer, intent(in) :: from
    !> Position, lengths, and velocity, in the frame of the disc.
    real(wp), intent(in) :: x, y, ux, uy
    !> Wall or opening, as in `motion_type`.
    integer(wall_kind), intent(out) :: next
    real(wp), intent(out) :: wait
    real(wp) :: outward, root, depth2

    if (from == no_opening) then
      depth2 = max(urn%reach**2 - (x**2 + y**2), 0.0_wp)
    else
      ! On a chord, r**2 - q**2 is a product, exact however narrow the channel is.
      depth2 = (urn%half_width(from) - abs(y))*(urn%half_width(from) + abs(y))
    end if
    outward = x*ux + y*uy
    root = sqrt(outward**2 + depth2)
    if (outward > 0.0_wp) then
      wait = depth2/(root + outward)
    else
      wait = root - outward
    end if
    call choose_opening(urn, x, ux, x + ux*wait, y + uy*wait, next, wait)
  end subroutine find_next_wall_in_disc

  !> Reflects a particle at the arc; finds the wall or opening that it reaches next, and the time
  !> `wait` until then (huge if there is none). From a point q of the circle the path to the next
  !> impact has the length -2 q.u: no root, and no cancellation.
  pure subroutine reflect_in_disc(urn, clock_resolution, x, y, ux, uy, next, wait)
    type(urn_shape_type), intent(in) :: urn
    !> Shortest time between two impacts that a clock can resolve.
    real(wp), intent(in) :: clock_resolution
    !> Position and velocity in the frame of the disc.
    real(wp), intent(inout) :: x, y, ux, uy
    !> Next wall or opening, as in `motion_type`.
    integer(wall_kind), intent(out) :: next
    real(wp), intent(out) :: wait
    real(wp) :: norm, outward, kick

    norm = 1.5_wp - 0.5_wp*urn%disc%curvature2*(x**2 + y**2)
    x = norm*x
    y = norm*y
    outward = x*ux + y*uy
    ! By rounding, a grazing particle may move inwards already; then its velocity does not change.
    kick = 2.0_wp*urn%disc%curvature2*max(outward, 0.0_wp)
    ux = ux - kick*x
    uy = uy - kick*y
    norm = 1.5_wp - 0.5_wp*(ux**2 + uy**2)
    ux = norm*ux
    uy = norm*uy
    wait = 2.0_wp*abs(outward)
    if (wait < clock_resolution) then
      ! Motion along the wall: a clock does not resolve the chords, so one instant would have
      ! infinitely many hits.
      next = meets_nothing
      wait = huge(1.0_wp)
    else
      call choose_opening(urn, x, ux, x + ux*wait, y + uy*wait, next, wait)
    end if
  end subroutine reflect_in_disc

  !> Chooses between wall and openings for a particle that would reach the circle at (px, py) after
  !> the time `wait`. It leaves only through a point strictly within an opening: a corner belongs to
  !> the urn.
  pure subroutine choose_opening(urn, x, ux, px, py, next, wait)
    type(urn_shape_type), intent(in) :: urn
    real(wp), intent(in) :: x, ux, px, py
    integer(wall_kind), intent(out) :: next
    real(wp), intent(inout) :: wait

    next = meets_wall
    if (abs(py) >= merge(urn%half_width(channel1), urn%half_width(channel2), px > 0.0_wp)) return
    ! By rounding, the point may seem to lie just inside a corner though the velocity points
    ! inwards, or along the chord.
    if (px > 0.0_wp .and. ux > urn%least_across) then
      next = meets_gate
      wait = min(max(urn%chord(channel1) - x, 0.0_wp)/max(ux, slowest), wait)
    else if (px <= 0.0_wp .and. ux < -urn%least_across) then
      next = meets_channel2
      wait = min(max(x + urn%chord(channel2), 0.0_wp)/max(-ux, slowest), wait)
    end if
  end subroutine choose_opening

  !> If a step has moved a particle beyond the arc (`was_beyond`), mirrors its position in the
  !> circle, along the radius, and reflects its velocity there.
  pure subroutine reflect_overshoot_in_disc(urn, x, y, ux, uy, was_beyond)
    type(urn_shape_type), intent(in) :: urn
    !> Position and velocity in the frame of the disc.
    real(wp), intent(inout) :: x, y, ux, uy
    logical, intent(out) :: was_beyond
    real(wp) :: distance, outward, factor

    was_beyond = x**2 + y**2 > urn%reach**2
    if (.not. was_beyond) return
    distance = hypot(x, y)
    ! In a segment beyond a chord, the particle may have come out of the channel into the wall.
    outward = max((x*ux + y*uy)/distance, 0.0_wp)
    ux = ux - 2.0_wp*outward*x/distance
    uy = uy - 2.0_wp*outward*y/distance
    factor = 1.5_wp - 0.5_wp*(ux**2 + uy**2)
    ux = factor*ux
    uy = factor*uy
    factor = 2.0_wp*urn%reach/distance - 1.0_wp
    x = factor*x
    y = factor*y
  end subroutine reflect_overshoot_in_disc

end module battery_disc

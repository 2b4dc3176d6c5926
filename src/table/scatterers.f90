!> Half of channel 2 with fixed discs in it (`scatterers`): the next wall or disc of a particle, and
!> its reflection from a disc.
!>
!> **Frame.** x runs from the periodic line at 0 to the urn at `length`, y as in the table; the half
!> of urn 2 is mirrored. A disc across the line is a wall of both halves; one that reaches over a
!> wall of the channel is cut off there.
!>
!> A particle is placed exactly on the disc that it hits; its velocity is rotated by an angle that
!> follows from the distance at which its path passes the centre of the disc. A root is subtracted
!> from a number of similar size only in the time until the hit.
module battery_scatterers
  use battery_kinds, only: wp, pi
  use battery_channel, only: channel_type
  use battery_motion, only: wall_kind, slowest, meets_urn, meets_line, meets_channel_wall
  implicit none (type, external)
  private
  public :: scattered_half_channel_type, new_scattered_half_channel, &
    find_next_wall_in_half_channel, reflect_in_half_channel, is_in_scatterer
  public :: measure_scatterers, narrowest_gap, detect_periodic_path

  !> Hits after which a passage through a half channel is truncated; a state that has not recurred
  !> within as many more never will.
  integer, parameter, public :: longest_part = 10000

  !> Half of a channel with discs. Those of a channel without discs are not used.
  type :: scattered_half_channel_type
    integer :: count = 0
    !> Distance from the line to the urn, and from the axis to the walls.
    real(wp) :: length = 0.0_wp, half_width = 0.0_wp
    !> Bound on the rounding error of a distance: a disc whose centre is not farther ahead than this
    !> is not hit. Else a path that grazes a disc could hit it again and again at one place.
    real(wp) :: resolution = 0.0_wp
    !> Centres of the discs in the frame of the half channel, and their radii.
    real(wp), allocatable :: x(:), y(:), radius(:)
  end type scattered_half_channel_type

contains

  !> Makes the half of the channel on the side `along` of the line: 1, or -1 for the half of urn 2.
  !> Discs that do not reach into it are left out, but one is kept if all would be: kernels look up
  !> a disc for each particle, also for one that hits none.
  pure function new_scattered_half_channel(channel, scatterers, along) result(half_channel)
    type(channel_type), intent(in) :: channel
    !> (z, y, radius) of each disc.
    real(wp), intent(in) :: scatterers(:, :)
    real(wp), intent(in) :: along
    type(scattered_half_channel_type) :: half_channel
    logical :: here(size(scatterers, 2))

    here = along*scatterers(1, :) + scatterers(3, :) > 0.0_wp
    if (.not. any(here)) here(1:1) = .true.
    half_channel%count = count(here)
    half_channel%length = 0.5_wp*channel%length
    half_channel%half_width = 0.5_wp*channel%width
    half_channel%x = along*pack(scatterers(1, :), here)
    half_channel%y = pack(scatterers(2, :), here)
    half_channel%radius = pack(scatterers(3, :), here)
    half_channel%resolution = 16.0_wp*epsilon(1.0_wp)*(half_channel%length + channel%width &
      + maxval(half_channel%radius))
  end function new_scattered_half_channel

  !> Finds what a particle reaches next: the wall, the line, the urn, or the disc with that number.
  pure subroutine find_next_wall_in_half_channel(half_channel, x, y, ux, uy, next, wait)
    !> Half channel that the particle is in.
    type(scattered_half_channel_type), intent(in) :: half_channel
    !> Position and velocity in the frame of the half channel.
    real(wp), intent(in) :: x, y, ux, uy
    !> As in `motion_type`.
    integer(wall_kind), intent(out) :: next
    !> Time until the particle reaches it.
    real(wp), intent(out) :: wait
    real(wp) :: to_wall, dx, dy, beside, half_chord2, ahead, time(half_channel%count)
    integer :: k

    next = meets_line
    wait = max(x, 0.0_wp)/max(-ux, slowest)
    if (ux >= 0.0_wp) then
      next = meets_urn
      wait = max(half_channel%length - x, 0.0_wp)/max(ux, slowest)
    end if
    to_wall = max(half_channel%half_width - sign(1.0_wp, uy)*y, 0.0_wp)/max(abs(uy), slowest)
    if (to_wall <= wait) then
      next = meets_channel_wall
      wait = to_wall
    end if
    do k = 1, half_channel%count
      dx = half_channel%x(k) - x
      dy = half_channel%y(k) - y
      ahead = dx*ux + dy*uy
      beside = abs(dx*uy - dy*ux)
      half_chord2 = (half_channel%radius(k) - beside)*(half_channel%radius(k) + beside)
      ! By rounding, a particle may be in a disc: it hits the disc now, unless it moves away.
      time(k) = merge(max(ahead - sqrt(max(half_chord2, 0.0_wp)), 0.0_wp), huge(1.0_wp), &
        half_chord2 > 0.0_wp .and. ahead > half_channel%resolution)
    end do
    do k = 1, half_channel%count
      if (time(k) >= wait) cycle
      wait = time(k)
      next = int(k, wall_kind)
    end do
  end subroutine find_next_wall_in_half_channel

  !> Reflects a particle at the wall of the channel, or at a disc, that it has reached.
  pure subroutine reflect_in_half_channel(half_channel, wall, x, y, ux, uy)
    !> Half channel that the particle is in.
    type(scattered_half_channel_type), intent(in) :: half_channel
    !> `meets_channel_wall`, or the number of a disc.
    integer, intent(in) :: wall
    !> Position and velocity in the frame of the half channel.
    real(wp), intent(inout) :: x, y, ux, uy
    real(wp) :: dx, dy, sine, cosine, along, across, norm, radius

    if (wall <= 0) then
      y = sign(half_channel%half_width, uy)
      uy = -uy
      return
    end if
    radius = half_channel%radius(wall)
    dx = half_channel%x(wall) - x
    dy = half_channel%y(wall) - y
    ! Sine and cosine of the incidence.
    sine = max(-1.0_wp, min((dx*uy - dy*ux)/radius, 1.0_wp))
    cosine = sqrt((1.0_wp - sine)*(1.0_wp + sine))
    x = half_channel%x(wall) - radius*(cosine*ux + sine*uy)
    y = half_channel%y(wall) - radius*(cosine*uy - sine*ux)
    along = (sine - cosine)*(sine + cosine)
    across = 2.0_wp*sine*cosine
    dx = along*ux - across*uy
    dy = along*uy + across*ux
    ! Newton step: keeps the speed from drifting.
    norm = 1.5_wp - 0.5_wp*(dx**2 + dy**2)
    ux = norm*dx
    uy = norm*dy
  end subroutine reflect_in_half_channel

  !> Whether the state after the next hit recurs exactly before the particle leaves the half
  !> channel: then it never leaves.
  pure subroutine detect_periodic_path(half_channel, x, y, ux, uy, yes)
    !> Half channel that the particle is in.
    type(scattered_half_channel_type), intent(in) :: half_channel
    !> Position and velocity in the frame of the half channel.
    real(wp), intent(in) :: x, y, ux, uy
    !> Whether the state recurs.
    logical, intent(out) :: yes
    real(wp) :: now(4), mark(4), wait
    integer(wall_kind) :: wall
    integer :: hit

    yes = .false.
    now = [x, y, ux, uy]
    do hit = 0, longest_part
      if (hit == 1) mark = now
      call find_next_wall_in_half_channel(half_channel, now(1), now(2), now(3), now(4), wall, wait)
      if (wall < meets_channel_wall) return
      now(:2) = now(:2) + wait*now(3:)
      call reflect_in_half_channel(half_channel, int(wall), now(1), now(2), now(3), now(4))
      if (hit > 0) yes = .not. any(abs(now - mark) > 0.0_wp)
      if (yes) return
    end do
  end subroutine detect_periodic_path

  !> Whether a point is farther inside a disc than `tolerance`.
  pure function is_in_scatterer(half_channel, x, y, tolerance) result(inside)
    !> Half channel that contains the point.
    type(scattered_half_channel_type), intent(in) :: half_channel
    !> Position in the frame of the half channel, and a distance: lengths.
    real(wp), intent(in) :: x, y
    real(wp), intent(in) :: tolerance
    logical :: inside

    inside = .false.
    if (half_channel%count > 0) inside = any(hypot(half_channel%x - x, half_channel%y - y) &
      < half_channel%radius - tolerance)
  end function is_in_scatterer

  !> Computes the area of a channel that the discs cover; and the length of their walls in the
  !> channel, less that of the channel walls that they cover.
  pure subroutine measure_scatterers(channel, scatterers, area, added)
    type(channel_type), intent(in) :: channel
    !> (z, y, radius) of each disc.
    real(wp), intent(in) :: scatterers(:, :)
    !> An area and a length.
    real(wp), intent(out) :: area, added

    associate (h => 0.5_wp*channel%width, y => scatterers(2, :), r => scatterers(3, :))
      area = sum(pi*r**2 - cut_part(.true., r, h - y) - cut_part(.true., r, h + y))
      added = sum(2.0_wp*pi*r - cut_part(.false., r, h - y) - cut_part(.false., r, h + y))
    end associate

  contains

    !> Part of a disc beyond a line at a distance from its centre: its area, or the length of its
    !> arc and of the line within the disc.
    elemental real(wp) function cut_part(as_area, radius, distance)
      logical, intent(in) :: as_area
      real(wp), intent(in) :: radius, distance
      real(wp) :: cosine, sine

      cosine = max(-1.0_wp, min(distance/radius, 1.0_wp))
      sine = sqrt((1.0_wp - cosine)*(1.0_wp + cosine))
      if (as_area) then
        cut_part = radius**2*(acos(cosine) - cosine*sine)
      else
        cut_part = 2.0_wp*radius*(acos(cosine) + sine)
      end if
    end function cut_part

  end subroutine measure_scatterers

  !> Smallest gap between two discs or between the walls: only within short times are hits closer
  !> together than that.
  pure function narrowest_gap(channel, scatterers) result(gap)
    type(channel_type), intent(in) :: channel
    !> (z, y, radius) of each disc.
    real(wp), intent(in) :: scatterers(:, :)
    real(wp) :: gap
    integer :: k

    gap = channel%width
    do k = 2, size(scatterers, 2)
      gap = min(gap, minval(hypot(scatterers(1, :k - 1) - scatterers(1, k), &
        scatterers(2, :k - 1) - scatterers(2, k)) - scatterers(3, :k - 1) - scatterers(3, k)))
    end do
  end function narrowest_gap

end module battery_scatterers

!> Kernel: passages through half of channel 2 with discs in it, computed in batches, from wall to
!> wall.
!>
!> `lanes` particles are processed together, from one wall to the next, in loops that have no
!> branches and are vectorised. When a particle has reached the line or the urn, its lane loads the
!> next passage of the batch. The result of a passage does not depend on the others of the batch.
module battery_half_channel_passages
  use battery_kinds, only: wp, int64
  use battery_motion, only: motion_type, wall_kind, slowest, meets_nothing, meets_urn, meets_line, &
    meets_channel_wall
  use battery_scatterers, only: scattered_half_channel_type, longest_part
  implicit none (type, external)
  private
  public :: compute_half_channel_passages

  !> Particles processed together.
  integer, parameter :: lanes = 8

  !> State of the particles in the lanes.
  type :: lanes_type
    !> Passage of each lane, an index in the batch; 0: the lane idles.
    integer :: passage(lanes) = 0
    real(wp), dimension(lanes) :: x = 0.0_wp, y = 0.0_wp, ux = 1.0_wp, uy = 0.0_wp
    real(wp), dimension(lanes) :: time = 0.0_wp, until = 0.0_wp, delay = 0.0_wp, hits = 0.0_wp
    !> Kind of the next wall or line of each particle (`wall_kind` of `battery_motion`), as a real;
    !> centre and radius if it is a disc.
    real(wp), dimension(lanes) :: next_wall = 0.0_wp, hit_disc_x = 0.0_wp, hit_disc_y = 0.0_wp, &
      hit_disc_radius = 0.0_wp
  end type lanes_type

contains

  !> Computes the passages of a batch, `count` of them, each from its start to the line or the urn.
  subroutine compute_half_channel_passages(half_channel, limit, count, motion, hits)
    !> Half channel that the particles are in.
    type(scattered_half_channel_type), intent(in) :: half_channel
    !> Time at which a passage stops at the latest.
    real(wp), intent(in) :: limit
    integer, intent(in) :: count
    !> States in the frame of the half channel (`battery_scatterers`). In: start of each passage.
    !> Out: its end; `next` is the line or the urn, `meets_nothing` if it ended at the time limit,
    !> or a wall if it ended after `longest_part` hits.
    type(motion_type), intent(inout) :: motion(count)
    !> Wall hits of each passage.
    integer(int64), intent(out) :: hits(count)
    type(lanes_type) :: now
    integer :: lane, next, flying

    next = 0
    flying = 0
    do lane = 1, lanes
      call load_lane(lane)
    end do
    do while (flying > 0)
      call find_end_or_wall(half_channel%length, half_channel%half_width, now%x, now%y, now%ux, &
        now%uy, now%next_wall, now%delay)
      call find_nearest_disc(half_channel%count, half_channel%x, half_channel%y, &
        half_channel%radius, half_channel%resolution, now%x, now%y, now%ux, now%uy, now%next_wall, &
        now%delay)
      call advance_lanes(now%until, now%x, now%y, now%ux, now%uy, now%next_wall, now%delay, &
        now%time, now%hits)
      call look_up_discs(half_channel%count, half_channel%x, half_channel%y, half_channel%radius, &
        now%next_wall, now%hit_disc_x, now%hit_disc_y, now%hit_disc_radius)
      call reflect_lanes(half_channel%half_width, now%hit_disc_x, now%hit_disc_y, &
        now%hit_disc_radius, now%x, now%y, now%ux, now%uy, now%next_wall)
      do lane = 1, lanes
        if (now%passage(lane) == 0) cycle
        if (now%next_wall(lane) >= real(meets_channel_wall, wp) &
          .and. now%hits(lane) < longest_part) cycle
        call store_lane(lane)
        call load_lane(lane)
      end do
    end do

  contains

    !> Stores the result of a lane.
    subroutine store_lane(lane)
      integer, intent(in) :: lane

      associate (j => now%passage(lane))
        motion(j) = motion_type(now%x(lane), now%y(lane), now%ux(lane), now%uy(lane), &
          motion(j)%time + now%time(lane), motion(j)%urn, motion(j)%chamber, &
          nint(now%next_wall(lane), wall_kind))
        hits(j) = int(now%hits(lane), int64)
      end associate
      flying = flying - 1
    end subroutine store_lane

    !> Loads the next passage of the batch into a lane; if there is none, the lane idles.
    subroutine load_lane(lane)
      integer, intent(in) :: lane

      now%passage(lane) = 0
      if (next == count) return
      next = next + 1
      flying = flying + 1
      now%passage(lane) = next
      associate (begins => motion(next))
        now%x(lane) = begins%x
        now%y(lane) = begins%y
        now%ux(lane) = begins%ux
        now%uy(lane) = begins%uy
        now%until(lane) = limit - begins%time
      end associate
      now%time(lane) = 0.0_wp
      now%hits(lane) = 0.0_wp
    end subroutine load_lane

  end subroutine compute_half_channel_passages

  !> Finds what each particle reaches next in a half channel without discs: the channel wall, or the
  !> end (line or urn) that it moves towards; `next_wall` is its kind, `delay` the time until then.
  pure subroutine find_end_or_wall(length, half_width, x, y, ux, uy, next_wall, delay)
    real(wp), intent(in) :: length, half_width
    real(wp), dimension(lanes), intent(in) :: x, y, ux, uy
    real(wp), dimension(lanes), intent(out) :: next_wall, delay
    real(wp) :: speed, ahead, at_end, px, py, v, way(lanes), to_wall(lanes)
    integer :: j

    ! One loop for each quantity: a condition that is tested twice in one loop would become a
    ! branch.
    !GCC$ unroll 1
    do j = 1, lanes
      v = ux(j)
      speed = abs(v)
      ahead = merge(1.0_wp, 0.0_wp, v >= 0.0_wp)
      px = ahead*length - (2.0_wp*ahead - 1.0_wp)*x(j)
      way(j) = merge(px, 0.0_wp, px > 0.0_wp)/merge(speed, slowest, speed > slowest)
    end do
    !GCC$ unroll 1
    do j = 1, lanes
      py = y(j)
      v = uy(j)
      speed = abs(v)
      ! Of a particle that glides along a wall the sign of zero tells that it was reflected there.
      py = half_width - sign(1.0_wp, v)*py
      to_wall(j) = merge(py, 0.0_wp, py > 0.0_wp)/merge(speed, slowest, speed > slowest)
    end do
    !GCC$ unroll 1
    do j = 1, lanes
      at_end = merge(real(meets_urn, wp), real(meets_line, wp), ux(j) >= 0.0_wp)
      next_wall(j) = merge(real(meets_channel_wall, wp), at_end, to_wall(j) <= way(j))
    end do
    !GCC$ unroll 1
    do j = 1, lanes
      delay(j) = merge(to_wall(j), way(j), to_wall(j) <= way(j))
    end do
  end subroutine find_end_or_wall

  !> Replaces the end or wall by a disc, if the particle hits one before.
  pure subroutine find_nearest_disc(count, disc_x, disc_y, radius, resolution, x, y, ux, uy, &
    next_wall, delay)
    integer, intent(in) :: count
    real(wp), dimension(count), intent(in) :: disc_x, disc_y, radius
    real(wp), intent(in) :: resolution
    real(wp), dimension(lanes), intent(in) :: x, y, ux, uy
    real(wp), dimension(lanes), intent(inout) :: next_wall, delay
    real(wp) :: dx, dy, ahead, beside, half_chord2, time, this, before, best, wall_before
    integer :: k, j

    do k = 1, count
      this = k
      !GCC$ unroll 1
      do j = 1, lanes
        dx = disc_x(k) - x(j)
        dy = disc_y(k) - y(j)
        ahead = dx*ux(j) + dy*uy(j)
        beside = abs(dx*uy(j) - dy*ux(j))
        half_chord2 = (radius(k) - beside)*(radius(k) + beside)
        time = ahead - sqrt(max(half_chord2, 0.0_wp))
        time = merge(time, huge(1.0_wp), half_chord2 > 0.0_wp)
        time = merge(time, huge(1.0_wp), ahead > resolution)
        ! In this form the compiler keeps both in registers from disc to disc.
        before = delay(j)
        wall_before = next_wall(j)
        best = min(time, before)
        next_wall(j) = merge(this, wall_before, best < before)
        delay(j) = best
      end do
    end do
    ! By rounding, a particle may be in a disc: it hits the disc now, unless it moves away.
    !GCC$ unroll 1
    do j = 1, lanes
      delay(j) = max(delay(j), 0.0_wp)
    end do
  end subroutine find_nearest_disc

  !> Moves each particle straight to its next wall or end, or until its time limit.
  pure subroutine advance_lanes(until, x, y, ux, uy, next_wall, delay, time, hits)
    real(wp), dimension(lanes), intent(in) :: until, ux, uy
    real(wp), dimension(lanes), intent(inout) :: x, y, next_wall, delay, time, hits
    logical :: over
    integer :: j

    !GCC$ unroll 1
    do j = 1, lanes
      over = time(j) + delay(j) > until(j)
      next_wall(j) = merge(real(meets_nothing, wp), next_wall(j), over)
      delay(j) = merge(until(j) - time(j), delay(j), over)
      time(j) = time(j) + delay(j)
      x(j) = x(j) + ux(j)*delay(j)
      y(j) = y(j) + uy(j)*delay(j)
      hits(j) = hits(j) + merge(1.0_wp, 0.0_wp, next_wall(j) >= real(meets_channel_wall, wp))
    end do
  end subroutine advance_lanes

  !> Looks up centre and radius of the disc that each particle hits; of any disc if it hits none.
  pure subroutine look_up_discs(count, disc_x, disc_y, radius, next_wall, hit_disc_x, hit_disc_y, &
    hit_disc_radius)
    integer, intent(in) :: count
    real(wp), dimension(count), intent(in) :: disc_x, disc_y, radius
    real(wp), intent(in) :: next_wall(lanes)
    real(wp), dimension(lanes), intent(out) :: hit_disc_x, hit_disc_y, hit_disc_radius
    integer :: j, k

    do j = 1, lanes
      k = max(int(next_wall(j)), 1)
      hit_disc_x(j) = disc_x(k)
      hit_disc_y(j) = disc_y(k)
      hit_disc_radius(j) = radius(k)
    end do
  end subroutine look_up_discs

  !> Reflects each particle as `reflect_in_half_channel` does; a particle at the line or the urn
  !> keeps its velocity.
  pure subroutine reflect_lanes(half_width, hit_disc_x, hit_disc_y, hit_disc_radius, x, y, ux, &
    uy, next_wall)
    real(wp), intent(in) :: half_width
    real(wp), dimension(lanes), intent(in) :: hit_disc_x, hit_disc_y, hit_disc_radius
    real(wp), dimension(lanes), intent(inout) :: x, y, ux, uy
    real(wp), intent(in) :: next_wall(lanes)
    real(wp) :: dx, dy, sine, cosine, along, across, norm, vx, vy, wx, wy
    logical :: at_disc, at_wall
    integer :: j

    !GCC$ unroll 1
    do j = 1, lanes
      at_disc = next_wall(j) > real(meets_channel_wall, wp)
      at_wall = .not. abs(next_wall(j) - real(meets_channel_wall, wp)) > 0.0_wp
      wx = ux(j)
      wy = uy(j)
      dx = hit_disc_x(j) - x(j)
      dy = hit_disc_y(j) - y(j)
      sine = (dx*wy - dy*wx)/hit_disc_radius(j)
      sine = merge(sine, 1.0_wp, sine < 1.0_wp)
      sine = merge(sine, -1.0_wp, sine > -1.0_wp)
      cosine = sqrt((1.0_wp - sine)*(1.0_wp + sine))
      along = (sine - cosine)*(sine + cosine)
      across = 2.0_wp*sine*cosine
      vx = along*wx - across*wy
      vy = along*wy + across*wx
      norm = 1.5_wp - 0.5_wp*(vx**2 + vy**2)
      dx = hit_disc_x(j) - hit_disc_radius(j)*(cosine*wx + sine*wy)
      dy = hit_disc_y(j) - hit_disc_radius(j)*(cosine*wy - sine*wx)
      x(j) = merge(dx, x(j), at_disc)
      y(j) = merge(dy, merge(sign(half_width, wy), y(j), at_wall), at_disc)
      ux(j) = merge(norm*vx, wx, at_disc)
      uy(j) = merge(norm*vy, merge(-wy, wy, at_wall), at_disc)
    end do
  end subroutine reflect_lanes

end module battery_half_channel_passages

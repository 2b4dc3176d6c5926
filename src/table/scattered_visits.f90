!> Whole visits to half of channel 2 where discs stand in it, in batches: from wall to wall.
!>
!> `lanes` particles fly side by side, each alone, one flight of each at a time, without branches. A
!> lane whose particle has come to the line or to the urn takes the next one of the batch. So the
!> result of a particle does not depend on who else is in its batch.
module battery_scattered_visits
  use battery_kinds, only: wp, int64
  use battery_motion, only: slowest, meets_nothing, meets_urn, meets_line, meets_channel_wall
  use battery_scatterers, only: scattered_half_type, longest_part
  implicit none (type, external)
  private
  public :: strays_type, reserve_strays, cross_half

  !> Particles that the kernel flies side by side.
  integer, parameter :: lanes = 8

  !> A batch of visits to a half, in its frame (`battery_scatterers`), one entry a particle.
  type :: strays_type
    integer :: count = 0
    !> Who.
    integer, allocatable :: particle(:)
    !> Place and velocity: lengths, and a vector of length 1.
    real(wp), allocatable :: x(:), y(:), ux(:), uy(:)
    !> The disc that it stands at, or 0.
    integer(int64), allocatable :: on(:)
    !> In: how long it is flown at most. Out: how long it was.
    real(wp), allocatable :: time(:)
    !> Out: wall hits, a whole number; and what the visit ended with, the line or the urn as
    !> `motion_type` has them, `meets_nothing` if its time was up, or a wall after `longest_part`
    !> hits.
    real(wp), allocatable :: hits(:)
    integer(int64), allocatable :: met(:)
  end type strays_type

  !> What flies in the lanes.
  type :: lanes_type
    integer :: who(lanes) = 0
    real(wp), dimension(lanes) :: x = 0.0_wp, y = 0.0_wp, ux = 1.0_wp, uy = 0.0_wp
    real(wp), dimension(lanes) :: time = 0.0_wp, until = 0.0_wp, wait = 0.0_wp, hits = 0.0_wp
    integer(int64), dimension(lanes) :: on = 0, met = 0
  end type lanes_type

contains

  !> Makes room for `room` visits and empties the batch.
  pure subroutine reserve_strays(strays, room)
    type(strays_type), intent(inout) :: strays
    integer, intent(in) :: room
    integer :: n

    strays%count = 0
    if (allocated(strays%x)) then
      if (size(strays%x) >= room) return
    end if
    n = max(64, room + room/2)
    strays = strays_type()
    allocate (strays%x(n), strays%y(n), strays%ux(n), strays%uy(n), strays%time(n), &
      strays%hits(n), source=0.0_wp)
    allocate (strays%particle(n), source=0)
    allocate (strays%on(n), strays%met(n), source=0_int64)
  end subroutine reserve_strays

  !> All visits of a batch.
  subroutine cross_half(half, strays)
    type(scattered_half_type), intent(in) :: half
    type(strays_type), intent(inout) :: strays
    type(lanes_type) :: now
    integer :: lane, next, flying

    next = 0
    flying = 0
    do lane = 1, lanes
      call take_next(lane)
    end do
    do while (flying > 0)
      call aim_ahead(half%length, half%half_width, now%x, now%y, now%ux, now%uy, now%met, now%wait)
      call aim_at_discs(half%count, half%x, half%y, half%radius, now%x, now%y, now%ux, now%uy, &
        now%on, now%met, now%wait)
      call fly_on(now%until, now%x, now%y, now%ux, now%uy, now%met, now%wait, now%time, now%hits)
      call bounce_off(half%count, half%half_width, half%x, half%y, half%radius, now%x, now%y, &
        now%ux, now%uy, now%on, now%met)
      do lane = 1, lanes
        if (now%who(lane) == 0) cycle
        if (now%met(lane) >= meets_channel_wall .and. now%hits(lane) < longest_part) cycle
        call put_down(lane)
        call take_next(lane)
      end do
    end do

  contains

    !> The result of a lane.
    subroutine put_down(lane)
      integer, intent(in) :: lane

      associate (j => now%who(lane))
        strays%x(j) = now%x(lane)
        strays%y(j) = now%y(lane)
        strays%ux(j) = now%ux(lane)
        strays%uy(j) = now%uy(lane)
        strays%on(j) = now%on(lane)
        strays%time(j) = now%time(lane)
        strays%hits(j) = now%hits(lane)
        strays%met(j) = now%met(lane)
      end associate
      flying = flying - 1
    end subroutine put_down

    !> The next of the batch into a lane, if there is one; else the lane idles.
    subroutine take_next(lane)
      integer, intent(in) :: lane

      now%who(lane) = 0
      if (next == strays%count) return
      next = next + 1
      flying = flying + 1
      now%who(lane) = next
      now%x(lane) = strays%x(next)
      now%y(lane) = strays%y(next)
      now%ux(lane) = strays%ux(next)
      now%uy(lane) = strays%uy(next)
      now%on(lane) = strays%on(next)
      now%until(lane) = strays%time(next)
      now%time(lane) = 0.0_wp
      now%hits(lane) = 0.0_wp
    end subroutine take_next

  end subroutine cross_half

  !> The end of the half that a particle flies to, or the wall if that is sooner.
  pure subroutine aim_ahead(length, half_width, x, y, ux, uy, met, wait)
    real(wp), intent(in) :: length, half_width
    real(wp), dimension(lanes), intent(in) :: x, y, ux, uy
    integer(int64), intent(out) :: met(lanes)
    real(wp), intent(out) :: wait(lanes)
    real(wp) :: way, speed, to_wall
    integer :: j

    do j = 1, lanes
      way = merge(length - x(j), x(j), ux(j) >= 0.0_wp)
      speed = abs(ux(j))
      way = merge(way, 0.0_wp, way > 0.0_wp)/merge(speed, slowest, speed > slowest)
      met(j) = merge(int(meets_urn, int64), int(meets_line, int64), ux(j) >= 0.0_wp)
      speed = abs(uy(j))
      to_wall = half_width - merge(y(j), -y(j), uy(j) >= 0.0_wp)
      to_wall = merge(to_wall, 0.0_wp, to_wall > 0.0_wp)/merge(speed, slowest, speed > slowest)
      met(j) = merge(int(meets_channel_wall, int64), met(j), to_wall <= way)
      wait(j) = merge(to_wall, way, to_wall <= way)
    end do
  end subroutine aim_ahead

  !> A disc instead, if one is met before; nobody meets the same one twice in a row.
  pure subroutine aim_at_discs(count, disc_x, disc_y, radius, x, y, ux, uy, on, met, wait)
    integer, intent(in) :: count
    real(wp), dimension(count), intent(in) :: disc_x, disc_y, radius
    real(wp), dimension(lanes), intent(in) :: x, y, ux, uy
    integer(int64), intent(in) :: on(lanes)
    integer(int64), intent(inout) :: met(lanes)
    real(wp), intent(inout) :: wait(lanes)
    real(wp) :: dx, dy, ahead, beside, room, time
    integer :: k, j
    integer(int64) :: this
    logical :: sooner

    do k = 1, count
      this = k
      do j = 1, lanes
        dx = disc_x(k) - x(j)
        dy = disc_y(k) - y(j)
        ahead = dx*ux(j) + dy*uy(j)
        beside = abs(dx*uy(j) - dy*ux(j))
        room = (radius(k) - beside)*(radius(k) + beside)
        time = ahead - sqrt(merge(room, 0.0_wp, room > 0.0_wp))
        ! Who is in a disc by rounding meets it now, if it does not fly away from it.
        time = merge(time, 0.0_wp, time > 0.0_wp)
        sooner = room > 0.0_wp .and. ahead > 0.0_wp .and. time <= wait(j) .and. on(j) /= this
        wait(j) = merge(time, wait(j), sooner)
        met(j) = merge(this, met(j), sooner)
      end do
    end do
  end subroutine aim_at_discs

  !> Straight on to what is met, or until time is up.
  pure subroutine fly_on(until, x, y, ux, uy, met, wait, time, hits)
    real(wp), intent(in) :: until(lanes)
    real(wp), dimension(lanes), intent(in) :: ux, uy
    integer(int64), intent(inout) :: met(lanes)
    real(wp), dimension(lanes), intent(inout) :: x, y, wait, time, hits
    logical :: over
    integer :: j

    do j = 1, lanes
      over = time(j) + wait(j) > until(j)
      met(j) = merge(int(meets_nothing, int64), met(j), over)
      wait(j) = merge(until(j) - time(j), wait(j), over)
      time(j) = time(j) + wait(j)
      x(j) = x(j) + ux(j)*wait(j)
      y(j) = y(j) + uy(j)*wait(j)
      hits(j) = hits(j) + merge(1.0_wp, 0.0_wp, met(j) >= meets_channel_wall)
    end do
  end subroutine fly_on

  !> Reflection, as in `hit_among`; whoever met the line or the urn goes on as it flew.
  pure subroutine bounce_off(count, half_width, disc_x, disc_y, radius, x, y, ux, uy, on, met)
    integer, intent(in) :: count
    real(wp), intent(in) :: half_width
    real(wp), dimension(count), intent(in) :: disc_x, disc_y, radius
    real(wp), dimension(lanes), intent(inout) :: x, y, ux, uy
    integer(int64), intent(out) :: on(lanes)
    integer(int64), intent(in) :: met(lanes)
    real(wp) :: dx, dy, sine, cosine, along, across, norm, vx, vy
    integer(int64) :: k
    logical :: at_disc, at_wall
    integer :: j

    do j = 1, lanes
      at_disc = met(j) > meets_channel_wall
      at_wall = met(j) == meets_channel_wall
      k = merge(met(j), 1_int64, at_disc)
      dx = disc_x(k) - x(j)
      dy = disc_y(k) - y(j)
      sine = (dx*uy(j) - dy*ux(j))/radius(k)
      sine = merge(sine, 1.0_wp, sine < 1.0_wp)
      sine = merge(sine, -1.0_wp, sine > -1.0_wp)
      cosine = sqrt((1.0_wp - sine)*(1.0_wp + sine))
      along = (sine - cosine)*(sine + cosine)
      across = 2.0_wp*sine*cosine
      vx = along*ux(j) - across*uy(j)
      vy = along*uy(j) + across*ux(j)
      norm = 1.5_wp - 0.5_wp*(vx**2 + vy**2)
      x(j) = merge(disc_x(k) - radius(k)*(cosine*ux(j) + sine*uy(j)), x(j), at_disc)
      y(j) = merge(disc_y(k) - radius(k)*(cosine*uy(j) - sine*ux(j)), merge(sign(half_width, &
        uy(j)), y(j), at_wall), at_disc)
      ux(j) = merge(norm*vx, ux(j), at_disc)
      uy(j) = merge(norm*vy, merge(-uy(j), uy(j), at_wall), at_disc)
      on(j) = merge(met(j), 0_int64, at_disc)
    end do
  end subroutine bounce_off

end module battery_scattered_visits

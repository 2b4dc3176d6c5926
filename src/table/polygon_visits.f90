!> Whole visits to a polygon, in batches, from side to side.
!>
!> Particles are treated in blocks, all of a block at one side after the other: the loops over a
!> block have no branches and become vector instructions. Who has found an opening stands still.
!> Between two marches the particles that still fly close ranks.
!>
!> A visit that has not ended after `most_hits` is looked at alone. If its state comes back it never
!> ends; else it is handed on: the visit has a part that is known, and goes on from there later.
module battery_polygon_visits
  use battery_kinds, only: wp, int64
  use battery_channel, only: gated, ungated
  use battery_motion, only: slowest
  use battery_polygon, only: polygon_type, nearest_side
  use battery_polygon_walls, only: state_type, state_on, came_back, surely_next_side, reflect, &
    longest_period
  use battery_visits, only: visits_type, together, no_channel, goes_on
  implicit none (type, external)
  private
  public :: cross_polygons

  !> Hits of a march, and marches after which a visit is looked at alone.
  integer, parameter :: march_hits = 4, most_marches = 2500

  !> Particles of a block.
  integer, parameter :: lanes = 64

  !> A part of a visit is at least so long, in the reach of the polygon: longer than any lookahead.
  !> So many hits have it, whatever its length.
  real(wp), parameter :: least_part = 16.0_wp
  integer, parameter :: most_part_hits = 1000000

contains

  !> From (x, y) with velocity (along, across) through the polygon; `hits` grows, `all_hits` is its
  !> sum.
  subroutine cross_polygons(polygon, visits)
    type(polygon_type), intent(in) :: polygon
    type(visits_type), intent(inout) :: visits
    integer :: active, n, j, round

    active = visits%count
    n = together*((active + together - 1)/together)
    call enter(n, visits%x, visits%y, visits%along, visits%across, visits%px, visits%py, &
      visits%zx, visits%zy, visits%steps, visits%first, visits%c, visits%slot)
    do round = 1, most_marches
      if (active == 0) exit
      n = together*((active + together - 1)/together)
      ! Who fills up the last group has left.
      visits%c(active + 1:n) = 0.0_wp
      call march(polygon, n, visits%px, visits%py, visits%zx, visits%zy, visits%steps, &
        visits%first, visits%c)
      call close_ranks(polygon, active, visits)
    end do
    do j = 1, active
      call finish_alone(polygon, visits, j)
    end do
    visits%all_hits = sum(int(visits%hits(:visits%count), int64))
  end subroutine cross_polygons

  !> Places, velocities of length 1, and who flies.
  pure subroutine enter(n, x, y, along, across, px, py, ux, uy, hits, length, flies, slot)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n), y(n), along(n), across(n)
    real(wp), intent(out) :: px(n), py(n), ux(n), uy(n), hits(n), length(n), flies(n)
    integer, intent(out) :: slot(n)
    real(wp) :: norm
    integer :: j

    do j = 1, n
      px(j) = x(j)
      py(j) = y(j)
      norm = 1.5_wp - 0.5_wp*(along(j)**2 + across(j)**2)
      ux(j) = norm*along(j)
      uy(j) = norm*across(j)
      hits(j) = 0.0_wp
      length(j) = 0.0_wp
      flies(j) = 1.0_wp
      slot(j) = j
    end do
  end subroutine enter

  !> `march_hits` hits of each particle that flies.
  pure subroutine march(polygon, n, px, py, ux, uy, hits, length, flies)
    type(polygon_type), intent(in) :: polygon
    integer, intent(in) :: n
    real(wp), intent(inout) :: px(n), py(n), ux(n), uy(n), hits(n), length(n)
    !> 1, or 0: it has left.
    real(wp), intent(inout) :: flies(n)
    real(wp), dimension(lanes) :: normal_x, normal_y, offset, open_half, soonest
    integer :: first, last, count, hit

    do first = 1, n, lanes
      last = min(first + lanes - 1, n)
      count = last - first + 1
      do hit = 1, march_hits
        if (polygon%convex) then
          call find_only_side(polygon%sides, polygon%x, polygon%y, polygon%normal_x, &
            polygon%normal_y, polygon%offset, polygon%open_half, count, px(first), py(first), &
            ux(first), uy(first), normal_x, normal_y, offset, open_half)
        else
          call find_nearest_side(polygon%sides, polygon%x, polygon%y, polygon%normal_x, &
            polygon%normal_y, polygon%offset, polygon%open_half, polygon%sharp, count, px(first), &
            py(first), ux(first), uy(first), normal_x, normal_y, offset, open_half, soonest)
        end if
        call bounce(count, normal_x, normal_y, offset, open_half, px(first), py(first), &
          ux(first), uy(first), hits(first), length(first), flies(first))
      end do
    end do
  end subroutine march

  !> The side that each of a block meets, where that is the only one that a way leads out of; if
  !> rounding hides it, none, with a normal of no length.
  pure subroutine find_only_side(sides, x, y, side_x, side_y, side_offset, side_half, n, px, py, &
    ux, uy, normal_x, normal_y, offset, open_half)
    integer, intent(in) :: sides, n
    real(wp), intent(in) :: x(sides + 1), y(sides + 1), side_x(sides), side_y(sides), &
      side_offset(sides), side_half(sides)
    real(wp), intent(in) :: px(n), py(n), ux(n), uy(n)
    real(wp), intent(out) :: normal_x(n), normal_y(n), offset(n), open_half(n)
    real(wp) :: before(lanes), after, ahead(lanes)
    logical :: met
    integer :: k, j

    do j = 1, n
      ahead(j) = ux(j)*py(j) - uy(j)*px(j)
      before(j) = ux(j)*y(1) - uy(j)*x(1) - ahead(j)
      normal_x(j) = 0.0_wp
      normal_y(j) = 0.0_wp
      offset(j) = 0.0_wp
      open_half(j) = -1.0_wp
    end do
    do k = 1, sides
      do j = 1, n
        after = ux(j)*y(k + 1) - uy(j)*x(k + 1) - ahead(j)
        met = before(j) < 0.0_wp .and. after >= 0.0_wp
        normal_x(j) = merge(side_x(k), normal_x(j), met)
        normal_y(j) = merge(side_y(k), normal_y(j), met)
        offset(j) = merge(side_offset(k), offset(j), met)
        open_half(j) = merge(side_half(k), open_half(j), met)
        before(j) = after
      end do
    end do
  end subroutine find_only_side

  !> The same where a way may lead out more than once: the nearest.
  pure subroutine find_nearest_side(sides, x, y, side_x, side_y, side_offset, side_half, sharp, n, &
    px, py, ux, uy, normal_x, normal_y, offset, open_half, soonest)
    integer, intent(in) :: sides, n
    real(wp), intent(in) :: x(sides + 1), y(sides + 1), side_x(sides), side_y(sides), &
      side_offset(sides), side_half(sides), sharp
    real(wp), intent(in) :: px(n), py(n), ux(n), uy(n)
    real(wp), intent(out) :: normal_x(n), normal_y(n), offset(n), open_half(n), soonest(n)
    real(wp) :: before(lanes), after, ahead(lanes), outward, time
    logical :: met
    integer :: k, j

    do j = 1, n
      ahead(j) = ux(j)*py(j) - uy(j)*px(j)
      before(j) = ux(j)*y(1) - uy(j)*x(1) - ahead(j)
      normal_x(j) = 0.0_wp
      normal_y(j) = 0.0_wp
      offset(j) = 0.0_wp
      open_half(j) = -1.0_wp
      soonest(j) = huge(1.0_wp)
    end do
    do k = 1, sides
      do j = 1, n
        after = ux(j)*y(k + 1) - uy(j)*x(k + 1) - ahead(j)
        outward = side_x(k)*ux(j) + side_y(k)*uy(j)
        time = (side_offset(k) - side_x(k)*px(j) - side_y(k)*py(j))/max(outward, slowest)
        met = before(j) < 0.0_wp .and. after >= 0.0_wp .and. outward > 0.0_wp .and. &
          time >= -sharp .and. time < soonest(j)
        soonest(j) = merge(time, soonest(j), met)
        normal_x(j) = merge(side_x(k), normal_x(j), met)
        normal_y(j) = merge(side_y(k), normal_y(j), met)
        offset(j) = merge(side_offset(k), offset(j), met)
        open_half(j) = merge(side_half(k), open_half(j), met)
        before(j) = after
      end do
    end do
  end subroutine find_nearest_side

  !> Moves each of a block to the side that it meets, and turns it there, unless that lets it out.
  !> Who meets none stays where it is.
  pure subroutine bounce(n, normal_x, normal_y, offset, open_half, px, py, ux, uy, hits, length, &
    flies)
    integer, intent(in) :: n
    real(wp), intent(in) :: normal_x(n), normal_y(n), offset(n), open_half(n)
    real(wp), intent(inout) :: px(n), py(n), ux(n), uy(n), hits(n), length(n), flies(n)
    real(wp) :: outward, wait, norm, moves, out, turns, vx, vy
    integer :: j

    do j = 1, n
      outward = normal_x(j)*ux(j) + normal_y(j)*uy(j)
      ! Where rounding denies that the side lies ahead, none is met.
      moves = merge(flies(j), 0.0_wp, outward > 0.0_wp)
      wait = moves*max((offset(j) - normal_x(j)*px(j) - normal_y(j)*py(j)) &
        /max(outward, slowest), 0.0_wp)
      length(j) = length(j) + wait
      px(j) = px(j) + ux(j)*wait
      py(j) = py(j) + uy(j)*wait
      out = merge(moves, 0.0_wp, abs(py(j)) < open_half(j))
      flies(j) = flies(j) - out
      turns = moves - out
      hits(j) = hits(j) + turns
      vx = ux(j) - 2.0_wp*turns*outward*normal_x(j)
      vy = uy(j) - 2.0_wp*turns*outward*normal_y(j)
      norm = 1.5_wp - 0.5_wp*(vx**2 + vy**2)
      ux(j) = norm*vx
      uy(j) = norm*vy
    end do
  end subroutine bounce

  !> Who has left hands in how; the others close ranks.
  pure subroutine close_ranks(polygon, active, visits)
    type(polygon_type), intent(in) :: polygon
    integer, intent(inout) :: active
    type(visits_type), intent(inout) :: visits
    integer :: j, kept

    kept = 0
    do j = 1, active
      if (visits%c(j) > 0.0_wp) then
        kept = kept + 1
        visits%px(kept) = visits%px(j)
        visits%py(kept) = visits%py(j)
        visits%zx(kept) = visits%zx(j)
        visits%zy(kept) = visits%zy(j)
        visits%steps(kept) = visits%steps(j)
        visits%first(kept) = visits%first(j)
        visits%slot(kept) = visits%slot(j)
        visits%c(kept) = 1.0_wp
      else
        call leave(polygon, visits, j)
      end if
    end do
    active = kept
  end subroutine close_ranks

  !> One of the ranks stands in an opening, with a velocity that leads out.
  pure subroutine leave(polygon, visits, j)
    type(polygon_type), intent(in) :: polygon
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: j
    integer :: mine, channel

    mine = visits%slot(j)
    channel = merge(gated, ungated, visits%zx(j) > 0.0_wp)
    visits%channel(mine) = channel
    visits%x(mine) = visits%px(j)
    visits%y(mine) = visits%py(j)
    visits%along(mine) = max(abs(visits%zx(j)), slowest)
    visits%across(mine) = visits%zy(j)
    visits%length(mine) = visits%first(j)
    visits%through(mine) = polygon%length(channel)/visits%along(mine)
    visits%hits(mine) = visits%hits(mine) + visits%steps(j)
  end subroutine leave

  !> A visit of very many hits, side by side, until it ends, its state comes back, or it has flown a
  !> part of its way. A period is looked for that is as long as it is from a state on: that after
  !> 1, 2, 4 ... hits.
  pure subroutine finish_alone(polygon, visits, j)
    type(polygon_type), intent(in) :: polygon
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: j
    type(state_type) :: state, kept
    real(wp) :: wait
    integer :: hits, keep, side
    logical :: same

    associate (x => visits%px(j), y => visits%py(j), ux => visits%zx(j), uy => visits%zy(j), &
      length => visits%first(j))
      side = 0
      keep = 1
      same = .false.
      do hits = 1, most_part_hits
        call surely_next_side(polygon, (side), x, y, ux, uy, side, wait)
        ! No way leads on: as good as one that comes back.
        same = side == 0
        if (same) then
          state = state_on(polygon, nearest_side(polygon, x, y), x, y, ux, uy)
          exit
        end if
        x = x + ux*wait
        y = y + uy*wait
        length = length + wait
        if (abs(y) < polygon%open_half(side)) then
          call leave(polygon, visits, j)
          return
        end if
        call reflect(polygon, side, x, y, ux, uy)
        visits%steps(j) = visits%steps(j) + 1.0_wp
        state = state_on(polygon, side, x, y, ux, uy)
        if (hits > 1) same = came_back(polygon, state, kept)
        if (same) exit
        if (hits >= longest_period .and. length >= least_part*polygon%reach) exit
        if (hits == keep) then
          kept = state
          keep = 2*keep
        end if
      end do
      call hand_on(visits, j, state, merge(no_channel, goes_on, same .or. hits > most_part_hits))
    end associate
  end subroutine finish_alone

  !> A visit that is not at its end, and perhaps never will be.
  pure subroutine hand_on(visits, j, state, channel)
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: j
    type(state_type), intent(in) :: state
    integer(int64), intent(in) :: channel
    integer :: mine

    mine = visits%slot(j)
    visits%channel(mine) = channel
    visits%y(mine) = state%round
    visits%along(mine) = state%ux
    visits%across(mine) = state%uy
    visits%length(mine) = visits%first(j)
    ! When it has to be gone on with, before its end.
    visits%through(mine) = 0.5_wp*visits%first(j)
    visits%hits(mine) = visits%hits(mine) + visits%steps(j)
  end subroutine hand_on

end module battery_polygon_visits

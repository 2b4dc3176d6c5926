!> Kernel: passages through a polygon, the urn part of visits, computed in batches, from side to
!> side.
!>
!> Arrays are those of `visits_type`, one element a visit. They are processed in blocks of `lanes`
!> visits, one or three sides at a time for all visits of a block: these loops have no branches and
!> are vectorised. A particle that has reached an opening stays there. Every `march_hits` hits the
!> visits that have not ended are moved to the front of the arrays (`compact_active`).
!>
!> A visit that has not ended after `most_marches` rounds is finished alone, and, at once, one whose
!> path runs nearly along a side: there the time of the hit must be bounded by the corners. If the
!> boundary state of a visit recurs, it never ends; else it is truncated, to be continued later.
module battery_polygon_passages
  use battery_kinds, only: wp, int64
  use battery_channel, only: channel1, channel2
  use battery_motion, only: slowest, least_across
  use battery_polygon, only: urn_shape_type, polygon_type, nearest_side, boundary_state_type, &
    state_on_side, has_returned, find_next_side_robustly, reflect_from_side, longest_period, &
    add_compensated
  use battery_visits, only: visits_type, group_size, no_channel, truncated, many_hits, &
    longest_hits_time
  implicit none (type, external)
  private
  public :: compute_polygon_passages, follow_polygon_passage

  !> Hits between two compactions, and rounds after which a visit is finished alone.
  integer, parameter :: march_hits = 4, most_marches = 2500

  !> Visits of a block, and sides that `find_only_side` tests in one pass.
  integer, parameter :: lanes = 64, at_once = 3

  !> A part of a truncated visit is at least `least_part` long, in units of the reach: longer than
  !> any lookahead. Sides are so far apart (`outline_checks`) that it has fewer hits than
  !> `most_part_hits`; a particle with more is stuck.
  real(wp), parameter :: least_part = 16.0_wp
  integer, parameter :: most_part_hits = 100000000

  !> Cosine of the angle to the normal up to which a path runs nearly along a side: beyond it the
  !> hit is right within 1e-12 of the reach.
  real(wp), parameter :: grazing = 2.0_wp**(-12)

contains

  !> Computes the passages of a batch of visits through the polygon; input and output are explained
  !> at `visits_type`.
  subroutine compute_polygon_passages(urn, visits)
    type(urn_shape_type), intent(in) :: urn
    type(visits_type), intent(inout) :: visits
    real(wp) :: corner(2, 0:padded(urn%polygon)), side(4, padded(urn%polygon))
    integer :: active, n, j, round

    call list_sides(urn%polygon, padded(urn%polygon), corner, side)
    visits%many_hits_count = 0
    visits%untraceable_count = 0
    active = visits%count
    n = group_size*((active + group_size - 1)/group_size)
    call load_visits(n, visits%x, visits%y, visits%u_axial, visits%u_lateral, visits%px, &
      visits%py, visits%zx, visits%zy, visits%steps, visits%first, visits%s, visits%c, visits%slot)
    do round = 1, most_marches
      if (active == 0) exit
      n = group_size*((active + group_size - 1)/group_size)
      ! Padding lanes of the last group: visits that have ended.
      visits%c(active + 1:n) = 0.0_wp
      call step_hits(urn, march_hits, size(side, 2), corner, side, n, visits%px, visits%py, &
        visits%zx, visits%zy, visits%steps, visits%first, visits%s, visits%c)
      call compact_active(urn, real(march_hits*round, wp), active, visits)
    end do
    do j = 1, active
      call finish_alone(urn, visits, j)
    end do
    visits%all_hits = sum(int(visits%hits(:visits%count), int64))
  end subroutine compute_polygon_passages

  !> Copies the start of each visit: position, velocity set to length 1; no visit has ended.
  pure subroutine load_visits(n, x, y, along, across, px, py, ux, uy, hits, length, lost, flies, &
    slot)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n), y(n), along(n), across(n)
    real(wp), intent(out) :: px(n), py(n), ux(n), uy(n), hits(n), length(n), lost(n), flies(n)
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
      lost(j) = 0.0_wp
      flies(j) = 1.0_wp
      slot(j) = j
    end do
  end subroutine load_visits

  !> Moves each particle that has not left through `most_hits` hits.
  pure subroutine step_hits(urn, most_hits, sides, corner, side, n, px, py, ux, uy, hits, &
    length, lost, flies)
    type(urn_shape_type), intent(in) :: urn
    integer, intent(in) :: most_hits, sides, n
    !> As `list_sides` makes them.
    real(wp), intent(in) :: corner(2, 0:sides), side(4, sides)
    real(wp), intent(inout) :: px(n), py(n), ux(n), uy(n), hits(n)
    !> Length of the path, as a sum of two: the second has what rounding took from the first, always
    !> in one direction where all steps are equal.
    real(wp), intent(inout) :: length(n), lost(n)
    !> 1 until the visit ends, then 0.
    real(wp), intent(inout) :: flies(n)
    real(wp), dimension(lanes) :: normal_x, normal_y, offset, half_opening, added
    real(wp) :: half_openings(2)
    integer :: first, last, count, hit

    half_openings = merge(urn%half_width, -1.0_wp, urn%polygon%side > 0)
    do first = 1, n, lanes
      last = min(first + lanes - 1, n)
      count = last - first + 1
      added = 0.0_wp
      do hit = 1, most_hits
        if (urn%polygon%convex) then
          call find_only_side(sides, corner, side, half_openings(channel1), &
            half_openings(channel2), count, px(first), py(first), ux(first), uy(first), normal_x, &
            normal_y, offset, half_opening)
        else
          call find_nearest_side(urn%polygon%sides, corner, side, urn%polygon%tolerance, count, &
            px(first), py(first), ux(first), uy(first), normal_x, normal_y, offset, half_opening)
        end if
        call reflect_visits(count, normal_x, normal_y, offset, half_opening, px(first), py(first), &
          ux(first), uy(first), hits(first), added, flies(first))
      end do
      call add_compensated(added(:count), length(first:last), lost(first:last))
      call normalise_speeds(count, ux(first), uy(first))
    end do
  end subroutine step_hits

  !> Number of sides, padded to whole passes of `find_only_side`.
  pure integer function padded(polygon)
    type(polygon_type), intent(in) :: polygon

    padded = at_once*((polygon%sides + at_once - 1)/at_once)
  end function padded

  !> Lists the corners, the last one first; of each side the normal, the distance from the origin
  !> and half its opening. Padded with sides of length 0, which no path hits.
  pure subroutine list_sides(polygon, n, corner, side)
    type(polygon_type), intent(in) :: polygon
    integer, intent(in) :: n
    real(wp), intent(out) :: corner(2, 0:n), side(4, n)
    integer :: k

    corner(1, :) = polygon%x(1)
    corner(2, :) = polygon%y(1)
    side = 0.0_wp
    do k = 1, polygon%sides
      corner(:, k) = [polygon%x(k + 1), polygon%y(k + 1)]
      side(:, k) = [polygon%normal_x(k), polygon%normal_y(k), polygon%offset(k), &
        polygon%half_opening(k)]
    end do
  end subroutine list_sides

  !> Finds the side that each particle of a block hits in a convex polygon: the only side that its
  !> path leaves through; no side, and a normal of length 0, if rounding hides it. Unrolled by hand
  !> for `at_once` sides, with the particles in registers; with products with 1 or 0, since the
  !> compiler turns a selection into a branch.
  pure subroutine find_only_side(sides, corner, side, half_opening1, half_opening2, n, px, py, ux, &
    uy, normal_x, normal_y, offset, half_opening)
    integer, intent(in) :: sides, n
    !> As `list_sides` makes them; half the openings on the right and on the left.
    real(wp), intent(in) :: corner(2, 0:sides), side(4, sides), half_opening1, half_opening2
    real(wp), intent(in) :: px(n), py(n), ux(n), uy(n)
    real(wp), intent(out) :: normal_x(n), normal_y(n), offset(n), half_opening(n)
    real(wp) :: before(lanes), ahead(lanes), c(2, at_once), s(4, at_once)
    real(wp) :: was, first, second, third, met1, met2, met3
    integer :: k, j

    call begin_side_search(n, corner(1, 0), corner(2, 0), px, py, ux, uy, normal_x, normal_y, &
      offset, half_opening, before, ahead)
    do k = 1, sides, at_once
      c = corner(:, k:k + at_once - 1)
      s = side(:, k:k + at_once - 1)
      do j = 1, n
        was = before(j)
        first = ux(j)*c(2, 1) - uy(j)*c(1, 1) - ahead(j)
        second = ux(j)*c(2, 2) - uy(j)*c(1, 2) - ahead(j)
        third = ux(j)*c(2, 3) - uy(j)*c(1, 3) - ahead(j)
        met1 = merge(1.0_wp, 0.0_wp, was < 0.0_wp .and. first >= 0.0_wp)
        met2 = merge(1.0_wp, 0.0_wp, first < 0.0_wp .and. second >= 0.0_wp)
        met3 = merge(1.0_wp, 0.0_wp, second < 0.0_wp .and. third >= 0.0_wp)
        normal_x(j) = normal_x(j) + met1*s(1, 1) + met2*s(1, 2) + met3*s(1, 3)
        normal_y(j) = normal_y(j) + met1*s(2, 1) + met2*s(2, 2) + met3*s(2, 3)
        offset(j) = offset(j) + met1*s(3, 1) + met2*s(3, 2) + met3*s(3, 3)
        before(j) = third
      end do
    end do
    do j = 1, n
      ! By rounding, a path may leave through two sides, or through none: then no side is found.
      met1 = merge(1.0_wp, 0.0_wp, abs(normal_x(j)**2 + normal_y(j)**2 - 1.0_wp) < 0.5_wp)
      normal_x(j) = met1*normal_x(j)
      normal_y(j) = met1*normal_y(j)
      ! Only the sides with openings are upright on the axis.
      half_opening(j) = merge(merge(half_opening1, half_opening2, ux(j) > 0.0_wp), -1.0_wp, .not. &
        abs(normal_y(j)) > 0.0_wp)
    end do
  end subroutine find_only_side

  !> As `find_only_side`, in any polygon: finds the nearest of the sides that a path leaves through.
  !> If the path enters through another one before, or where it leaves, rounding in a corner may
  !> have put the particle outside: no side is found, or it would cross what lies between two parts
  !> of the urn.
  pure subroutine find_nearest_side(sides, corner, side, tolerance, n, px, py, ux, uy, normal_x, &
    normal_y, offset, half_opening)
    integer, intent(in) :: sides, n
    !> As `list_sides` makes them; bound on rounding errors, a length.
    real(wp), intent(in) :: corner(2, 0:sides), side(4, sides), tolerance
    real(wp), intent(in) :: px(n), py(n), ux(n), uy(n)
    real(wp), intent(out) :: normal_x(n), normal_y(n), offset(n), half_opening(n)
    real(wp) :: before(lanes), ahead(lanes), soonest(lanes), &
      enters(lanes)
    real(wp) :: was, after, x, y, nx, ny, distance, opening, outward, time, met, kept, least, far
    integer :: k, j

    call begin_side_search(n, corner(1, 0), corner(2, 0), px, py, ux, uy, normal_x, normal_y, &
      offset, half_opening, before, ahead)
    far = 1.0_wp/slowest
    soonest(:n) = far
    enters(:n) = far
    least = -tolerance
    do k = 1, sides
      x = corner(1, k)
      y = corner(2, k)
      nx = side(1, k)
      ny = side(2, k)
      distance = side(3, k)
      opening = side(4, k)
      do j = 1, n
        was = before(j)
        after = ux(j)*y - uy(j)*x - ahead(j)
        outward = nx*ux(j) + ny*uy(j)
        time = (distance - nx*px(j) - ny*py(j))/sign(max(abs(outward), slowest), outward)
        met = merge(1.0_wp, 0.0_wp, was < 0.0_wp .and. after >= 0.0_wp .and. outward > 0.0_wp &
          .and. time >= least .and. time < soonest(j))
        kept = 1.0_wp - met
        normal_x(j) = met*nx + kept*normal_x(j)
        normal_y(j) = met*ny + kept*normal_y(j)
        offset(j) = met*distance + kept*offset(j)
        half_opening(j) = met*opening + kept*half_opening(j)
        soonest(j) = min(met*time + kept*far, soonest(j))
        met = merge(1.0_wp, 0.0_wp, was >= 0.0_wp .and. after < 0.0_wp .and. time > tolerance)
        enters(j) = min(met*time + (1.0_wp - met)*far, enters(j))
        before(j) = after
      end do
    end do
    do j = 1, n
      met = merge(1.0_wp, 0.0_wp, enters(j) > soonest(j) + tolerance)
      normal_x(j) = met*normal_x(j)
      normal_y(j) = met*normal_y(j)
    end do
  end subroutine find_nearest_side

  !> Sets up the search before the first side.
  pure subroutine begin_side_search(n, x, y, px, py, ux, uy, normal_x, normal_y, offset, &
    half_opening, before, ahead)
    integer, intent(in) :: n
    !> First corner.
    real(wp), intent(in) :: x, y
    real(wp), intent(in) :: px(n), py(n), ux(n), uy(n)
    real(wp), intent(out) :: normal_x(n), normal_y(n), offset(n), half_opening(n)
    !> Cross product of the velocity with the vector to that corner, and the part of it that does
    !> not depend on the corner.
    real(wp), intent(out) :: before(n), ahead(n)
    integer :: j

    do j = 1, n
      ahead(j) = ux(j)*py(j) - uy(j)*px(j)
      before(j) = ux(j)*y - uy(j)*x - ahead(j)
      normal_x(j) = 0.0_wp
      normal_y(j) = 0.0_wp
      offset(j) = 0.0_wp
      half_opening(j) = -1.0_wp
    end do
  end subroutine begin_side_search

  !> Moves each particle of a block to the side that it hits, and reflects it there unless it is in
  !> an opening. A particle for which no side was found does not move. Nor does one that runs
  !> nearly along its side: rounding could put its hit beyond the corner at the end of the side;
  !> `continue_alone` bounds the time of the hit by the corners.
  pure subroutine reflect_visits(n, normal_x, normal_y, offset, half_opening, px, py, ux, uy, &
    hits, length, flies)
    integer, intent(in) :: n
    real(wp), intent(in) :: normal_x(n), normal_y(n), offset(n), half_opening(n)
    !> `length` increases by that of the step.
    real(wp), intent(inout) :: px(n), py(n), ux(n), uy(n), hits(n), length(n), flies(n)
    real(wp) :: outward, wait, moves, out, bounces, kick
    integer :: j

    do j = 1, n
      outward = normal_x(j)*ux(j) + normal_y(j)*uy(j)
      moves = merge(flies(j), 0.0_wp, outward > grazing)
      wait = moves*max((offset(j) - normal_x(j)*px(j) - normal_y(j)*py(j)) &
        /max(outward, slowest), 0.0_wp)
      length(j) = length(j) + wait
      px(j) = px(j) + ux(j)*wait
      py(j) = py(j) + uy(j)*wait
      out = merge(moves, 0.0_wp, abs(py(j)) < half_opening(j))
      flies(j) = flies(j) - out
      bounces = moves - out
      hits(j) = hits(j) + bounces
      kick = 2.0_wp*bounces*outward
      ux(j) = ux(j) - kick*normal_x(j)
      uy(j) = uy(j) - kick*normal_y(j)
    end do
  end subroutine reflect_visits

  !> Sets all speeds back to 1 by a Newton step.
  pure subroutine normalise_speeds(n, ux, uy)
    integer, intent(in) :: n
    real(wp), intent(inout) :: ux(n), uy(n)
    real(wp) :: norm
    integer :: j

    do j = 1, n
      norm = 1.5_wp - 0.5_wp*(ux(j)**2 + uy(j)**2)
      ux(j) = norm*ux(j)
      uy(j) = norm*uy(j)
    end do
  end subroutine normalise_speeds

  !> Stores the visits that have ended, finishes those that did not move to the next side, and
  !> compacts the arrays to the others.
  pure subroutine compact_active(urn, hits, active, visits)
    type(urn_shape_type), intent(in) :: urn
    !> Number of hits of a visit that is active and has always moved.
    real(wp), intent(in) :: hits
    integer, intent(inout) :: active
    type(visits_type), intent(inout) :: visits
    integer :: j, kept

    kept = 0
    do j = 1, active
      if (visits%c(j) > 0.0_wp .and. visits%steps(j) < hits) then
        call finish_alone(urn, visits, j)
      else if (visits%c(j) > 0.0_wp) then
        kept = kept + 1
        visits%px(kept) = visits%px(j)
        visits%py(kept) = visits%py(j)
        visits%zx(kept) = visits%zx(j)
        visits%zy(kept) = visits%zy(j)
        visits%steps(kept) = visits%steps(j)
        visits%first(kept) = visits%first(j)
        visits%s(kept) = visits%s(j)
        visits%slot(kept) = visits%slot(j)
        visits%c(kept) = 1.0_wp
      else
        call store_exit(urn, visits, j)
      end if
    end do
    active = kept
  end subroutine compact_active

  !> Computes the rest of a visit that has not ended.
  pure subroutine finish_alone(urn, visits, j)
    type(urn_shape_type), intent(in) :: urn
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: j
    type(boundary_state_type) :: state
    integer(int64) :: ending

    call continue_alone(urn, huge(1.0_wp), visits%px(j), visits%py(j), visits%zx(j), &
      visits%zy(j), visits%first(j), visits%s(j), visits%steps(j), state, ending)
    if (ending == channel1) then
      call store_exit(urn, visits, j)
    else
      call store_truncated(visits, j, state, ending)
    end if
  end subroutine finish_alone

  !> Stores the end of a visit: the particle is in an opening, with a velocity that points outwards,
  !> and inside the walls of the channel, also where rounding has put it on one.
  pure subroutine store_exit(urn, visits, j)
    type(urn_shape_type), intent(in) :: urn
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: j
    integer :: mine, channel

    mine = visits%slot(j)
    channel = merge(channel1, channel2, visits%zx(j) > 0.0_wp)
    visits%channel(mine) = channel
    visits%x(mine) = visits%px(j)
    visits%y(mine) = sign(min(abs(visits%py(j)), (0.5_wp - epsilon(1.0_wp)) &
      *urn%width(channel)), visits%py(j))
    visits%u_axial(mine) = max(abs(visits%zx(j)), slowest)
    visits%u_lateral(mine) = visits%zy(j)
    visits%length(mine) = visits%first(j) + visits%s(j)
    visits%through(mine) = urn%length(channel)/visits%u_axial(mine)
    visits%hits(mine) = visits%hits(mine) + visits%steps(j)
    if (visits%steps(j) >= many_hits) call list_visit_with_many_hits(visits, mine)
    if (visits%steps(j)*max(visits%passage(mine), urn%reach) <= longest_hits_time &
      *urn%reach) return
    visits%untraceable_count = visits%untraceable_count + 1
    visits%untraceable_index(visits%untraceable_count) = mine
  end subroutine store_exit

  !> Lists a visit that has ended or was truncated, so that its start is stored if the visit is long
  !> (`store_visit_starts`).
  pure subroutine list_visit_with_many_hits(visits, which)
    type(visits_type), intent(inout) :: visits
    !> Its index in the batch.
    integer, intent(in) :: which

    visits%many_hits_count = visits%many_hits_count + 1
    visits%many_hits_index(visits%many_hits_count) = which
  end subroutine list_visit_with_many_hits

  !> Moves a particle from side to side until it reaches an opening, its boundary state recurs, or a
  !> part is complete; at most until its path is `longest` long. The states after 1, 2, 4, ... hits
  !> are stored; each is compared with those that follow it until the next one is stored.
  pure subroutine continue_alone(urn, longest, x, y, ux, uy, length, lost, steps, state, ending)
    type(urn_shape_type), intent(in) :: urn
    real(wp), intent(in) :: longest
    real(wp), intent(inout) :: x, y, ux, uy
    !> Length of the path, a sum of two, and number of hits, those before included.
    real(wp), intent(inout) :: length, lost, steps
    !> State after the last hit.
    type(boundary_state_type), intent(out) :: state
    !> `channel1` if the particle reaches any opening, `no_channel` if the state recurs, else
    !> `truncated`.
    integer(int64), intent(out) :: ending
    type(boundary_state_type) :: kept
    real(wp) :: wait, kept_length
    integer :: hits, keep, side
    logical :: same

    side = 0
    keep = 1
    kept_length = length
    same = .false.
    ending = truncated
    ! As `reflect_from_side` leaves who runs along an opening.
    if (abs(ux) <= least_across) ux = 0.0_wp
    do hits = 1, most_part_hits
      call find_next_side_robustly(urn%polygon, (side), x, y, ux, uy, side, wait)
      ! No side is found: treated as an orbit that recurs.
      same = side == 0
      if (same) then
        state = state_on_side(urn%polygon, nearest_side(urn%polygon, x, y), x, y, ux, uy)
        exit
      end if
      if (length + wait >= longest) then
        wait = max(longest - length - lost, 0.0_wp)
        x = x + ux*wait
        y = y + uy*wait
        return
      end if
      x = x + ux*wait
      y = y + uy*wait
      call add_compensated(wait, length, lost)
      if (abs(y) < urn%polygon%half_opening(side)) then
        ending = channel1
        return
      end if
      call reflect_from_side(urn%polygon, side, x, y, ux, uy)
      steps = steps + 1.0_wp
      state = state_on_side(urn%polygon, side, x, y, ux, uy)
      ! Two hits in one corner, along one of its sides, are no way back.
      if (hits > 1 .and. length - kept_length > urn%polygon%tolerance) same = &
        has_returned(urn%polygon, state, kept)
      if (same) exit
      if (hits >= longest_period .and. length >= least_part*urn%reach) exit
      if (hits == keep) then
        kept = state
        kept_length = length
        keep = 2*keep
      end if
    end do
    if (same .or. hits > most_part_hits) ending = no_channel
  end subroutine continue_alone

  !> Position of a particle at the time `elapsed` after the start of its passage, on the path that
  !> `compute_polygon_passages` takes. Rounding decides on which side a path passes a corner that it
  !> hits exactly: so this computes the same hits, by the same operations, with this particle in all
  !> lanes. At the time of a hit the particle has not been reflected.
  subroutine follow_polygon_passage(urn, x, y, ux, uy, elapsed, position, velocity, hits)
    type(urn_shape_type), intent(in) :: urn
    !> Start of the passage, and the time since then.
    real(wp), intent(in) :: x, y, ux, uy, elapsed
    !> x and y of each: lengths, and a vector of length 1; those at the end, if that is sooner.
    real(wp), intent(out) :: position(2), velocity(2)
    !> Wall hits since the start.
    integer(int64), intent(out) :: hits
    !> x, y, u_x, u_y, hits, length as a sum of two, and whether it flies, of each lane.
    real(wp) :: lane(group_size, 8), before(group_size, 8)
    real(wp) :: corner(2, 0:padded(urn%polygon)), side(4, padded(urn%polygon))
    type(boundary_state_type) :: state
    integer(int64) :: ending
    integer :: round, hit, slot(group_size)

    before(:, 1:4) = spread([x, y, ux, uy], 1, group_size)
    call load_visits(group_size, before(:, 1), before(:, 2), before(:, 3), before(:, 4), &
      lane(:, 1), lane(:, 2), lane(:, 3), lane(:, 4), lane(:, 5), lane(:, 6), lane(:, 7), &
      lane(:, 8), slot)
    call list_sides(urn%polygon, size(side, 2), corner, side)
    do round = 1, most_marches
      before = lane
      call step_hits(urn, march_hits, size(side, 2), corner, side, group_size, lane(:, 1), &
        lane(:, 2), lane(:, 3), lane(:, 4), lane(:, 5), lane(:, 6), lane(:, 7), lane(:, 8))
      if (lane(1, 6) >= elapsed .or. .not. lane(1, 8) > 0.0_wp .or. lane(1, 5) &
        < march_hits*round) exit
    end do
    if (lane(1, 6) >= elapsed) then
      ! By the same call with fewer hits, since other code would round otherwise.
      do hit = march_hits - 1, 0, -1
        lane = before
        call step_hits(urn, hit, size(side, 2), corner, side, group_size, lane(:, 1), &
          lane(:, 2), lane(:, 3), lane(:, 4), lane(:, 5), lane(:, 6), lane(:, 7), lane(:, 8))
        if (lane(1, 6) < elapsed) exit
      end do
      lane(1, 1:2) = lane(1, 1:2) + lane(1, 3:4)*max(elapsed - lane(1, 6) - lane(1, 7), 0.0_wp)
    else if (lane(1, 8) > 0.0_wp) then
      call continue_alone(urn, elapsed, lane(1, 1), lane(1, 2), lane(1, 3), lane(1, 4), &
        lane(1, 6), lane(1, 7), lane(1, 5), state, ending)
    end if
    position = lane(1, 1:2)
    velocity = lane(1, 3:4)
    hits = int(lane(1, 5), int64)
  end subroutine follow_polygon_passage

  !> Stores a visit that has not ended: truncated, or one that never ends.
  pure subroutine store_truncated(visits, j, state, channel)
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: j
    type(boundary_state_type), intent(in) :: state
    integer(int64), intent(in) :: channel
    integer :: mine

    mine = visits%slot(j)
    visits%channel(mine) = channel
    visits%y(mine) = state%arc_length
    visits%u_axial(mine) = state%ux
    visits%u_lateral(mine) = state%uy
    visits%length(mine) = visits%first(j) + visits%s(j)
    ! Time before its end at which the next part is due.
    visits%through(mine) = 0.5_wp*visits%first(j)
    visits%hits(mine) = visits%hits(mine) + visits%steps(j)
    call list_visit_with_many_hits(visits, mine)
  end subroutine store_truncated

end module battery_polygon_passages

!> Kernel: passages through a disc, the urn part of visits, computed in batches.
!>
!> Arrays are those of `visits_type`, one element a visit, padded to groups of `group_size`. Loops
!> over the visits have no branches and are vectorised: `step_impacts` computes `march_steps`
!> impacts of each particle, and a particle that has reached an opening stays there. Between two
!> calls the visits that have not ended are moved to the front of the arrays (`compact_active`). A
!> visit that has not ended after `march_rounds` rounds, or any visit if the openings are tiny, goes
!> to `find_opening`, which takes O(log) operations for any number of impacts.
module battery_disc_passages
  use battery_kinds, only: wp, int64, angle_kind
  use battery_channel, only: channel1, channel2
  use battery_disc, only: urn_shape_type, recompute_grazing_incidence, grazing_cosine
  use battery_rotation, only: turn_of_vector, unit_vector, full_turn
  use battery_opening_search, only: find_opening
  use battery_visits, only: visits_type, group_size, no_channel, many_hits, &
    longest_time, longest_hits_time
  implicit none (type, external)
  private
  public :: compute_disc_passages

  !> Impacts that `step_impacts` computes of each particle.
  integer, parameter :: march_steps = 8
  !> Rounds after which the opening is found by a search instead.
  integer, parameter :: march_rounds = nint(many_hits)/march_steps - 2
  !> Number of rounds in which few visits end: the arrays are compacted after every second call.
  integer, parameter :: early_rounds = 2

  !> A passage starts on the wall if its start is not further from the circle, along the path, than
  !> this, in units of the radius, over the square of the cosine of incidence: some times the
  !> rounding error of a path traced back to there, whose chords have the length of that cosine.
  real(wp), parameter :: wall_margin = 1.0e-12_wp

  !> Chords longer than this, in units of the radius, lose digits as those of this length do: there
  !> may be up to `many_hits` of them.
  real(wp), parameter :: short = 1.0_wp/30.0_wp

  !> Openings are narrow if together they are smaller than this, in units of the radius: visits have
  !> some thousand hits.
  real(wp), parameter :: narrow = 5.0e-3_wp

  !> An opening is nearly as wide as the urn if its chord is nearer to the centre than this, in
  !> units of the radius.
  real(wp), parameter :: near_centre = 0.1_wp

  !> Below this component across, rounding moves the end of a visit visibly along its path.
  real(wp), parameter :: nearly_along = 1.0e-3_wp

contains

  !> Computes the passages of a batch of visits through the disc: from position and velocity at the
  !> chord where each enters to those at the chord where it leaves. Sets the next channel, the
  !> length of the passage, the time through the next channel and the hits as well (see
  !> `visits_type`).
  subroutine compute_disc_passages(urn, visits)
    type(urn_shape_type), intent(in) :: urn
    type(visits_type), intent(inout) :: visits
    integer :: n, n_active, j, active, round
    logical :: uncommon

    n = group_size*((visits%count + group_size - 1)/group_size)
    visits%all_hits = 0
    visits%many_hits_count = 0
    visits%untraceable_count = 0
    if (n == 0) return
    call find_first_impacts(n, 1.0_wp/urn%reach, visits%x, visits%y, visits%u_axial, &
      visits%u_lateral, visits%passage, visits%c, visits%s, visits%px, visits%py, visits%zx, &
      visits%zy, visits%steps, visits%first, uncommon)
    if (uncommon) then
      call recompute_grazing_incidences(urn, visits)
      call list_untraceable(urn, visits)
    end if
    active = visits%count
    call number_slots(active, visits%slot)
    if (urn%disc%stepping_pays) then
      visits%px(active + 1:n) = 1.0_wp
      visits%py(active + 1:n) = 0.0_wp
      do round = 1, march_rounds
        n_active = group_size*((active + group_size - 1)/group_size)
        call step_impacts(urn%disc%half_opening(channel1), urn%disc%half_opening(channel2), &
          n_active, visits%px, visits%py, visits%zx, visits%zy, visits%steps)
        if (round <= early_rounds) call step_impacts(urn%disc%half_opening(channel1), &
          urn%disc%half_opening(channel2), n_active, visits%px, visits%py, visits%zx, visits%zy, &
          visits%steps)
        call compact_active(urn%disc%half_opening(channel1), urn%disc%half_opening(channel2), &
          active, visits%slot, visits%px, visits%py, visits%zx, visits%zy, visits%steps, &
          visits%hit_x, visits%hit_y, visits%impacts)
        if (active == 0) exit
      end do
    end if
    do j = 1, active
      visits%many_hits_index(j) = visits%slot(j)
      call search_opening(urn, visits, visits%slot(j), visits%px(j), visits%py(j), visits%zx(j), &
        visits%zy(j), visits%steps(j))
    end do
    visits%many_hits_count = active
    if (sum(urn%disc%half_opening) < narrow) call list_many_chords(urn%reach, visits)
    call find_exits(n, urn, visits%c, visits%s, visits%hit_x, visits%hit_y, visits%impacts, &
      visits%first, visits%channel, visits%x, visits%y, visits%u_axial, visits%u_lateral, &
      visits%length, visits%through)
    if (.not. all_passages_end(visits%count, urn%least_across, visits%u_axial, &
      visits%impacts)) then
      do j = 1, visits%count
        if (visits%u_axial(j) > urn%least_across .and. visits%impacts(j) >= 0.0_wp) cycle
        call repair_passage(urn, visits, j)
        if (any(visits%many_hits_index(:visits%many_hits_count) == j)) cycle
        visits%many_hits_count = visits%many_hits_count + 1
        visits%many_hits_index(visits%many_hits_count) = j
      end do
    end if
    call sum_hits(n, visits%count, visits%hits, visits%impacts, visits%all_hits)
  end subroutine compute_disc_passages

  !> Numbers the slots 1, 2, ...
  pure subroutine number_slots(n, slot)
    integer, intent(in) :: n
    integer, intent(out) :: slot(n)
    integer :: j

    do j = 1, n
      slot(j) = j
    end do
  end subroutine number_slots

  !> Whether each visit ended in an opening, with a velocity that points outwards.
  pure function all_passages_end(n, least, u_axial, impacts)
    integer, intent(in) :: n
    real(wp), intent(in) :: least, u_axial(n), impacts(n)
    logical :: all_passages_end
    integer :: j, left

    left = 0
    do j = 1, n
      left = left + merge(1, 0, u_axial(j) > least .and. impacts(j) >= 0.0_wp)
    end do
    all_passages_end = left == n
  end function all_passages_end

  !> Adds the impacts to the wall hits, and sums all hits, in `group_size` lanes so that the sum is
  !> vectorised.
  pure subroutine sum_hits(n, count, hits, impacts, all_hits)
    integer, intent(in) :: n, count
    real(wp), intent(inout) :: hits(n)
    real(wp), intent(in) :: impacts(n)
    integer(int64), intent(out) :: all_hits
    real(wp) :: total(group_size)
    integer :: j, lane

    hits = hits + impacts
    hits(count + 1:) = 0.0_wp
    total = 0.0_wp
    do j = 1, n, group_size
      do lane = 1, group_size
        total(lane) = total(lane) + hits(j + lane - 1)
      end do
    end do
    ! A visit may have more hits than a real can count one by one.
    if (sum(total) < 2.0_wp**digits(1.0_wp)) then
      all_hits = int(sum(total), int64)
    else
      all_hits = sum(int(hits(:count), int64))
    end if
  end subroutine sum_hits

  !> Computes incidence, first impact, rotation from impact to impact, and length until the first
  !> impact.
  pure subroutine find_first_impacts(n, curvature, x, y, ux, uy, passage, c, s, px, py, zx, zy, &
    steps, first, uncommon)
    integer, intent(in) :: n
    real(wp), intent(in) :: curvature, x(n), y(n), ux(n), uy(n), passage(n)
    real(wp), intent(out) :: c(n), s(n), px(n), py(n), zx(n), zy(n), steps(n), first(n)
    !> Whether a cosine is so small that it has lost digits in 1 - s**2, or a passage may start on
    !> the wall, or cannot be traced back into the channel.
    logical, intent(out) :: uncommon
    real(wp) :: sine, cosine, outward, radial, near, per_time
    integer :: j
    integer(int64) :: low

    low = 0
    near = wall_margin/curvature
    per_time = curvature/longest_time
    do j = 1, n
      sine = (x(j)*uy(j) - y(j)*ux(j))*curvature
      cosine = sqrt(max((1.0_wp - sine)*(1.0_wp + sine), 0.0_wp))
      px(j) = ux(j)*cosine + uy(j)*sine
      py(j) = uy(j)*cosine - ux(j)*sine
      zx(j) = (sine - cosine)*(sine + cosine)
      zy(j) = 2.0_wp*sine*cosine
      outward = x(j)*ux(j) + y(j)*uy(j)
      radial = cosine/curvature
      first(j) = radial - outward
      c(j) = cosine
      s(j) = sine
      steps(j) = 0.0_wp
      low = low + merge(1_int64, 0_int64, cosine < grazing_cosine .or. cosine**2*(radial &
        - abs(outward)) < near .or. cosine*min(cosine, short) < per_time*passage(j))
    end do
    uncommon = low > 0
  end subroutine find_first_impacts

  !> Recomputes cosine and sine of the angle of incidence, where it is grazing, to full precision.
  pure subroutine recompute_grazing_incidences(urn, visits)
    type(urn_shape_type), intent(in) :: urn
    type(visits_type), intent(inout) :: visits
    real(wp) :: ux, uy, c, s
    integer :: j

    do j = 1, visits%count
      if (.not. visits%c(j) < grazing_cosine) cycle
      ux = visits%u_axial(j)
      uy = visits%u_lateral(j)
      c = visits%c(j)
      s = visits%s(j)
      call recompute_grazing_incidence(urn, visits%x(j), visits%y(j), ux, uy, c, s)
      visits%c(j) = c
      visits%s(j) = s
      visits%px(j) = ux*c + uy*s
      visits%py(j) = uy*c - ux*s
      visits%zx(j) = (s - c)*(s + c)
      visits%zy(j) = 2.0_wp*s*c
      visits%first(j) = urn%reach*c - (visits%x(j)*ux + visits%y(j)*uy)
    end do
  end subroutine recompute_grazing_incidences

  !> Lists the passages that cannot be traced back to their start: those before which a slow
  !> particle is in the channel, and those that start on the wall, or at the end of a chord and so
  !> on the circle too, where rounding would decide whether the particle was reflected. One that has
  !> glided along the wall of its channel may fly to the corner opposite, which belongs to the urn:
  !> its first impact must not lie in that opening by rounding.
  pure subroutine list_untraceable(urn, visits)
    type(urn_shape_type), intent(in) :: urn
    type(visits_type), intent(inout) :: visits
    real(wp) :: half_width, distance
    integer :: j, from

    do j = 1, visits%count
      from = merge(channel1, channel2, visits%x(j) > 0.0_wp)
      half_width = urn%half_width(from)
      distance = min(visits%first(j), 2.0_wp*urn%reach*visits%c(j) - visits%first(j))
      ! Within a tiny opening the circle is so near everywhere; but there a reflection would come
      ! from the channel (`trace_back_into_channel`).
      if (max(distance, 0.25_wp*(half_width - abs(visits%y(j))))*visits%c(j)**2 &
        > wall_margin*urn%reach .and. visits%passage(j) < longest_time*urn%reach &
        *visits%c(j)*min(visits%c(j), short)) cycle
      visits%untraceable_count = visits%untraceable_count + 1
      visits%untraceable_index(visits%untraceable_count) = j
      if (abs(visits%u_lateral(j)) > 0.0_wp .or. abs(abs(visits%y(j)) - half_width) &
        > wall_margin*urn%reach) cycle
      visits%py(j) = sign((1.0_wp + 2.0_wp*epsilon(1.0_wp))*(half_width/urn%reach), visits%py(j))
    end do
  end subroutine list_untraceable

  !> Lists the passages with many hits that cannot be traced back since their chords are short, or
  !> the particle was in the channel for long.
  pure subroutine list_many_chords(radius, visits)
    real(wp), intent(in) :: radius
    type(visits_type), intent(inout) :: visits
    integer :: k, j

    do k = 1, visits%many_hits_count
      j = visits%many_hits_index(k)
      if (visits%impacts(j)*max(visits%passage(j), radius) <= longest_hits_time*radius &
        *visits%c(j)) cycle
      if (any(visits%untraceable_index(:visits%untraceable_count) == j)) cycle
      visits%untraceable_count = visits%untraceable_count + 1
      visits%untraceable_index(visits%untraceable_count) = j
    end do
  end subroutine list_many_chords

  !> Computes `march_steps` impacts of each particle; one whose impact lies in an opening stays
  !> there. All impacts are computed first, as if there were no opening; then the first that lies in
  !> an opening is selected, from the last one backwards, so that no step waits for a comparison.
  !> Without branches: the loop over the particles is vectorised.
  pure subroutine step_impacts(half_opening1, half_opening2, n, px, py, zx, zy, steps)
    real(wp), intent(in) :: half_opening1, half_opening2
    integer, intent(in) :: n
    real(wp), intent(inout) :: px(n), py(n), steps(n)
    real(wp), intent(in) :: zx(n), zy(n)
    real(wp) :: h1, h2, c, s, c2, s2, taken
    real(wp) :: x0, x1, x2, x3, x4, x5, x6, x7, x8, y0, y1, y2, y3, y4, y5, y6, y7, y8
    integer :: j

    ! Copies in registers: a load through a pointer would stay conditional, and need a branch.
    h1 = half_opening1
    h2 = half_opening2
    ! Unrolled by hand: the compiler does not vectorise a loop that contains a loop.
    do j = 1, n
      x0 = px(j)
      y0 = py(j)
      c = zx(j)
      s = zy(j)
      ! Two impacts at a time: half the dependent operations.
      c2 = (c - s)*(c + s)
      s2 = 2.0_wp*c*s
      call rotate_impact(c, s, x0, y0, x1, y1)
      call rotate_impact(c2, s2, x0, y0, x2, y2)
      call rotate_impact(c2, s2, x1, y1, x3, y3)
      call rotate_impact(c2, s2, x2, y2, x4, y4)
      call rotate_impact(c2, s2, x3, y3, x5, y5)
      call rotate_impact(c2, s2, x4, y4, x6, y6)
      call rotate_impact(c2, s2, x5, y5, x7, y7)
      call rotate_impact(c2, s2, x6, y6, x8, y8)
      taken = real(march_steps, wp)
      call choose_impact(h1, h2, 7.0_wp, x7, y7, x8, y8, taken)
      call choose_impact(h1, h2, 6.0_wp, x6, y6, x8, y8, taken)
      call choose_impact(h1, h2, 5.0_wp, x5, y5, x8, y8, taken)
      call choose_impact(h1, h2, 4.0_wp, x4, y4, x8, y8, taken)
      call choose_impact(h1, h2, 3.0_wp, x3, y3, x8, y8, taken)
      call choose_impact(h1, h2, 2.0_wp, x2, y2, x8, y8, taken)
      call choose_impact(h1, h2, 1.0_wp, x1, y1, x8, y8, taken)
      call choose_impact(h1, h2, 0.0_wp, x0, y0, x8, y8, taken)
      px(j) = x8
      py(j) = y8
      steps(j) = steps(j) + taken
    end do
  end subroutine step_impacts

  !> Rotates the point of an impact on the unit circle, (x, y) in the frame of the disc, by the
  !> angle between two impacts, given by its `cosine` and `sine`, to the next impact.
  elemental subroutine rotate_impact(cosine, sine, x, y, next_x, next_y)
    real(wp), intent(in) :: cosine, sine, x, y
    real(wp), intent(out) :: next_x, next_y

    next_x = x*cosine - y*sine
    next_y = x*sine + y*cosine
  end subroutine rotate_impact

  !> Selects the impact (x, y), which follows `before` others, if it lies in an opening.
  elemental subroutine choose_impact(half_opening1, half_opening2, before, x, y, first_x, first_y, &
    taken)
    real(wp), intent(in) :: half_opening1, half_opening2, before, x, y
    real(wp), intent(inout) :: first_x, first_y, taken
    logical :: open

    open = abs(y) < merge(half_opening1, half_opening2, x > 0.0_wp)
    first_x = merge(x, first_x, open)
    first_y = merge(y, first_y, open)
    taken = merge(before, taken, open)
  end subroutine choose_impact

  !> Stores the present impact of each particle, and compacts the arrays to the visits that have not
  !> ended, without branches.
  pure subroutine compact_active(half_opening1, half_opening2, active, slot, px, py, zx, zy, &
    steps, hit_x, hit_y, impacts)
    real(wp), intent(in) :: half_opening1, half_opening2
    integer, intent(inout) :: active
    integer, intent(inout) :: slot(*)
    real(wp), intent(inout) :: px(*), py(*), zx(*), zy(*), steps(*)
    real(wp), intent(inout) :: hit_x(*), hit_y(*), impacts(*)
    integer :: j, kept, mine
    real(wp) :: x, y, taken, h1, h2

    h1 = half_opening1
    h2 = half_opening2
    kept = 0
    do j = 1, active
      x = px(j)
      y = py(j)
      taken = steps(j)
      mine = slot(j)
      hit_x(mine) = x
      hit_y(mine) = y
      impacts(mine) = taken
      px(kept + 1) = x
      py(kept + 1) = y
      zx(kept + 1) = zx(j)
      zy(kept + 1) = zy(j)
      steps(kept + 1) = taken
      slot(kept + 1) = mine
      kept = kept + merge(1, 0, abs(y) >= merge(h1, h2, x > 0.0_wp))
    end do
    active = kept
    ! Padding lanes of the last group: impacts that lie in an opening.
    do j = kept + 1, kept + group_size - 1
      px(j) = 1.0_wp
      py(j) = 0.0_wp
    end do
  end subroutine compact_active

  !> Finds the first impact in an opening, from the impact (px, py) on, without stepping.
  pure subroutine search_opening(urn, visits, mine, px, py, zx, zy, steps)
    type(urn_shape_type), intent(in) :: urn
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: mine
    real(wp), intent(in) :: px, py, zx, zy, steps
    integer(angle_kind) :: start, step, total, landing
    logical :: found, first_side
    real(wp) :: x, y

    step = turn_of_vector(zx, zy)
    ! The virtual impact before the entry: in the opening through which the particle entered.
    start = modulo(turn_of_vector(px*zx + py*zy, py*zx - px*zy) + step, full_turn)
    call find_opening(urn%disc%angle(channel1), urn%disc%angle(channel2), start, step, total, &
      landing, first_side, found)
    if (found) then
      call unit_vector(landing, x, y)
      visits%hit_x(mine) = merge(x, -x, first_side)
      visits%hit_y(mine) = merge(y, -y, first_side)
      visits%impacts(mine) = steps + real(total, wp)
    else
      visits%hit_x(mine) = px
      visits%hit_y(mine) = py
      visits%impacts(mine) = -1.0_wp - steps
    end if
  end subroutine search_opening

  !> Traces each visit back from its impact in an opening to the chord: to a point inside the walls
  !> of the channel, or a passage that begins there would be taken for one that has hit a wall.
  pure subroutine find_exits(n, urn, c, s, hit_x, hit_y, impacts, first, channel, x, y, u_axial, &
    u_lateral, length, through)
    integer, intent(in) :: n
    type(urn_shape_type), intent(in) :: urn
    real(wp), intent(in) :: c(n), s(n), hit_x(n), hit_y(n), impacts(n), first(n)
    integer(int64), intent(out) :: channel(n)
    real(wp), intent(out) :: x(n), y(n), u_axial(n), u_lateral(n), length(n), through(n)
    real(wp) :: norm, qx, qy, ux, uy, back, half_opening, chord, direction, height, forward
    real(wp) :: radius, inside, half_opening1, half_opening2, chord1, chord2, length1, length2
    integer :: j

    radius = urn%reach
    inside = (1.0_wp - 2.0_wp*epsilon(1.0_wp))*radius
    half_opening1 = urn%disc%half_opening(channel1)
    half_opening2 = urn%disc%half_opening(channel2)
    chord1 = urn%chord(channel1)
    chord2 = urn%chord(channel2)
    length1 = urn%length(channel1)
    length2 = urn%length(channel2)
    do j = 1, n
      norm = 1.5_wp - 0.5_wp*(hit_x(j)**2 + hit_y(j)**2)
      qx = hit_x(j)*norm
      qy = hit_y(j)*norm
      direction = merge(1.0_wp, -1.0_wp, qx > 0.0_wp)
      half_opening = merge(half_opening1, half_opening2, qx > 0.0_wp)
      chord = merge(chord1, chord2, qx > 0.0_wp)
      ux = (c(j)*qx - s(j)*qy)*direction
      uy = c(j)*qy + s(j)*qx
      forward = merge(ux, 1.0_wp, ux > 0.0_wp)
      ! Equal to (|qx| r - chord)/u_x, without the cancellation that tiny openings would suffer
      ! from.
      back = (half_opening - abs(qy))*(half_opening + abs(qy))*radius**2 &
        /((abs(qx)*radius + chord)*forward)
      through(j) = merge(length1, length2, qx > 0.0_wp)/forward
      channel(j) = merge(int(channel1, int64), int(channel2, int64), qx > 0.0_wp)
      x(j) = direction*chord
      height = radius*qy - back*uy
      y(j) = sign(min(abs(height), half_opening*inside), height)
      u_axial(j) = ux
      u_lateral(j) = uy
      ! The bound on the height moved the end along the path; the time follows.
      back = back + merge((height - y(j))*uy, 0.0_wp, ux < nearly_along)
      length(j) = first(j) + 2.0_wp*radius*c(j)*impacts(j) - back
    end do
    if (min(chord1, chord2) < near_centre*radius) call find_wide_exits(n, urn, c, hit_x, hit_y, &
      impacts, first, y, u_axial, u_lateral, length)
  end subroutine find_exits

  !> Computes again where a visit leaves through an opening nearly as wide as the urn: with the
  !> distance from impact to chord as the difference that `find_exits` avoids.
  pure subroutine find_wide_exits(n, urn, c, hit_x, hit_y, impacts, first, y, u_axial, &
    u_lateral, length)
    integer, intent(in) :: n
    type(urn_shape_type), intent(in) :: urn
    real(wp), intent(in) :: c(n), hit_x(n), hit_y(n), impacts(n), first(n), u_axial(n), u_lateral(n)
    real(wp), intent(inout) :: y(n), length(n)
    real(wp) :: norm, back, height
    integer :: j, channel

    do j = 1, n
      channel = merge(channel1, channel2, hit_x(j) > 0.0_wp)
      if (urn%chord(channel) > near_centre*urn%reach) cycle
      norm = 1.5_wp - 0.5_wp*(hit_x(j)**2 + hit_y(j)**2)
      back = (abs(hit_x(j)*norm)*urn%reach - urn%chord(channel))/merge(u_axial(j), 1.0_wp, &
        u_axial(j) > 0.0_wp)
      height = urn%reach*hit_y(j)*norm - back*u_lateral(j)
      y(j) = sign(min(abs(height), (1.0_wp - 2.0_wp*epsilon(1.0_wp))*urn%half_width(channel)), &
        height)
      ! As above.
      back = back + merge((height - y(j))*u_lateral(j), 0.0_wp, u_axial(j) < nearly_along)
      length(j) = first(j) + 2.0_wp*urn%reach*c(j)*impacts(j) - back
    end do
  end subroutine find_wide_exits

  !> Repairs two rare results. If rounding took an impact beside a corner for one in the opening,
  !> the velocity points into the urn: the corner belongs to the urn, so the visit goes on. If no
  !> impact lies in an opening, the particle never leaves.
  pure subroutine repair_passage(urn, visits, j)
    type(urn_shape_type), intent(in) :: urn
    type(visits_type), intent(inout) :: visits
    integer, intent(in) :: j
    real(wp) :: zx, zy, x, y
    integer :: tries

    zx = (visits%s(j) - visits%c(j))*(visits%s(j) + visits%c(j))
    zy = 2.0_wp*visits%s(j)*visits%c(j)
    do tries = 1, 4
      if (visits%impacts(j) < 0.0_wp .or. visits%u_axial(j) > urn%least_across) exit
      x = visits%hit_x(j)*zx - visits%hit_y(j)*zy
      y = visits%hit_x(j)*zy + visits%hit_y(j)*zx
      call search_opening(urn, visits, j, x, y, zx, zy, visits%impacts(j) + 1.0_wp)
      call find_exits(1, urn, visits%c(j:j), visits%s(j:j), visits%hit_x(j:j), visits%hit_y(j:j), &
        visits%impacts(j:j), visits%first(j:j), visits%channel(j:j), visits%x(j:j), visits%y(j:j), &
        visits%u_axial(j:j), visits%u_lateral(j:j), visits%length(j:j), visits%through(j:j))
    end do
    if (visits%impacts(j) >= 0.0_wp .and. visits%u_axial(j) > urn%least_across) return
    if (visits%impacts(j) < 0.0_wp) visits%impacts(j) = -1.0_wp - visits%impacts(j)
    visits%channel(j) = no_channel
    visits%y(j) = atan2(visits%hit_y(j), visits%hit_x(j))
    visits%u_axial(j) = visits%c(j)
    visits%u_lateral(j) = visits%s(j)
    visits%length(j) = visits%first(j) + 2.0_wp*urn%reach*visits%c(j)*visits%impacts(j)
  end subroutine repair_passage

end module battery_disc_passages

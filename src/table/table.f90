!> The billiard table: two urns, channel 1 with the gates, and channel 2, which closes the circuit.
!>
!> **Coordinates.** The origin is the middle of channel 1, x runs along it, urn 1 lies at x < 0. A
!> channel is attached to an urn at the chord that is as long as the channel is wide. The unit of
!> length is free; the speed of a particle is 1, so times are lengths too. Source: Cirillo,
!> Colangeli, Richardson, Rondoni, PRE 103, 032119 (2021), Fig. model, eq. (eq000).
!>
!> **Indices.** Urns 1 and 2; channels 1 (`channel1`) and 2 (`channel2`); to each urn belong three
!> regions, called chambers: the urn, its half of channel 1 (the gate), and its half of channel 2.
!> The halves of a channel meet at a line: the middle line, and the periodic line. The single urn of
!> Fig. app1 is a table of one half: its middle line is a wall that leads back to it. Only
!> `battery_urn` knows the shape of an urn.
module battery_table
  use battery_kinds, only: wp, int64, pi
  use battery_powers, only: power_above
  use battery_channel, only: channel_type, is_open, fold_into_channel, channel1, channel2, &
    no_channel, facing
  use battery_urn_shape, only: mean_urn_passage
  use battery_corners, only: is_nearly_rational
  use battery_motion, only: outside, in_urn, in_gate, in_channel2, least_across
  use battery_scatterers, only: scattered_half_channel_type, new_scattered_half_channel, &
    is_in_scatterer, measure_scatterers
  use battery_urn, only: urn_type, shape_polygon, derive_shape, are_mirror_images, contains_point, &
    find_first_impact, try_random_point
  implicit none (type, external)
  private
  public :: table_type, urn_type, channel_type, new_table, shape_circuit, shape_urn
  public :: channel1, channel2, no_channel, outside, in_urn, in_gate, in_channel2
  public :: urn_at, x_on_side, enters_at_once, height_off_wall, chamber_at, moves_along_arc, &
    x_direction, is_open, are_mirror_images
  public :: passage_type, passage_at
  public :: area, perimeter, half_length, mean_urn_passage, shortest_excursion, try_random_point, &
    longest_run
  public :: relaxation_time, even_difference

  !> Shapes: the circuit of Fig. model, and the single urn with a gate and an end wall of Fig. app1.
  integer, parameter :: shape_circuit = 1, shape_urn = 2

  !> Longest run, in units of the reach of an urn: at longer times the clock would not resolve an
  !> urn.
  real(wp), parameter :: longest_run = 1.0e15_wp

  !> Longest passage of a channel, in units of the reach of an urn: the rounding error of a clock in
  !> a longer one would move a particle visibly across the channel.
  real(wp), parameter :: longest_passage = 1.0e12_wp

  !> Direction along x from the origin to each urn.
  real(wp), parameter :: x_direction(2) = [-1.0_wp, 1.0_wp]

  !> The whole table: urns by index, channels by `channel1` and `channel2`.
  type :: table_type
    !> Number of urns: 2, or 1 for the single urn.
    integer :: urn_count = 2
    !> For each urn, the urn across the lines of its channels: one array for the middle line and the
    !> periodic line. Of the single urn: itself, since its end wall reflects.
    integer :: urn_across(2) = [2, 1]
    type(urn_type) :: urn(2)
    type(channel_type) :: channel(2)
    !> Fixed discs in channel 2: (z, y, radius) of each, z along the channel from urn 2 over the
    !> line at 0 to urn 1. Half of the channel with the discs in it, by urn.
    real(wp), allocatable :: scatterers(:, :)
    type(scattered_half_channel_type) :: half_channel2(2)
    !> Whether there are such discs: channel 2 is open then.
    logical :: has_scatterers = .false.
    !> Length of an epoch: a power of two, at least four times the longest path from wall to wall.
    real(wp) :: epoch = 0.0_wp
  end type table_type

  !> Passage of a particle through a channel.
  type :: passage_type
    !> Urn and chamber that the particle is in; its channel, or `no_channel`: then the rest is not
    !> set.
    integer :: urn = 0, chamber = outside, channel = no_channel
    !> Channel along whose chord the particle moves, in the urn, or `no_channel`.
    integer :: chord = no_channel
    !> Whether the particle is trapped: too slow ever to reach an end; if not, whether it moves away
    !> from its urn, towards the line of the channel.
    logical :: trapped = .false., moves_away = .false.
    !> Time until the particle reaches its urn; below 0: minus the time since it left the urn.
    real(wp) :: time = 0.0_wp
    !> Height; if the particle moves away from its urn: at which it left the urn, -1 if u_y has
    !> changed its sign since, else 1, and wall hits since. A particle on a wall that moves away
    !> from it, or along it, has no hit there: its height is less by a rounding error.
    real(wp) :: height = 0.0_wp, reflected = 1.0_wp, hits = 0.0_wp
  end type passage_type

  !> A table from its urns and channels, or from lengths.
  interface new_table
    procedure new_table_of_urns, new_table_of_discs
  end interface new_table

contains

  !> Table whose urns are discs of the same radius.
  pure function new_table_of_discs(shape, urn_radius, channel1_width, channel1_length, &
      channel2_width, channel2_length) result(table)
    !> `shape_circuit` or `shape_urn`.
    integer, intent(in) :: shape
    real(wp), intent(in) :: urn_radius, channel1_width, channel1_length
    real(wp), intent(in) :: channel2_width, channel2_length
    type(table_type) :: table

    table = new_table_of_urns(shape, [urn_type(radius=urn_radius), urn_type(radius=urn_radius)], &
      [channel_type(channel1_width, channel1_length), &
      channel_type(channel2_width, channel2_length)])
  end function new_table_of_discs

  !> Table from its parts; the caller has checked their lengths (openings fit, lengths are
  !> positive). Shape `shape_urn` ignores channel 2 and urn 2.
  pure function new_table_of_urns(shape, urn, channel, scatterers) result(table)
    !> `shape_circuit` or `shape_urn`.
    integer, intent(in) :: shape
    !> Urns 1 and 2, with their shapes.
    type(urn_type), intent(in) :: urn(2)
    !> Channels; width 0 closes channel 2.
    type(channel_type), intent(in) :: channel(2)
    !> (z, y, radius) of each disc in channel 2; absent: there are none.
    real(wp), intent(in), optional :: scatterers(:, :)
    type(table_type) :: table
    integer :: urn_index

    table%channel = channel
    allocate (table%scatterers(3, 0))
    if (present(scatterers)) table%scatterers = scatterers
    if (shape == shape_urn) then
      table%urn_count = 1
      table%urn_across = [1, 2]
      table%channel(channel2)%width = 0.0_wp
    end if
    table%has_scatterers = size(table%scatterers) > 0 .and. is_open(table%channel(channel2))
    do urn_index = 1, 2
      table%urn(urn_index) = urn(min(urn_index, table%urn_count))
      call derive_shape(table%urn(urn_index), table%channel)
      associate (this_urn => table%urn(urn_index))
        this_urn%axis_sign = -x_direction(urn_index)
        this_urn%centre = 0.5_wp*channel(channel1)%length + this_urn%chord(channel1)
        this_urn%channel_start = [0.5_wp*channel(channel1)%length, &
          this_urn%centre + this_urn%chord(channel2)]
        this_urn%periodic_line = this_urn%channel_start(channel2) + 0.5_wp*channel(channel2)%length
      end associate
      if (table%has_scatterers) table%half_channel2(urn_index) = new_scattered_half_channel( &
        channel(channel2), table%scatterers, -x_direction(urn_index))
    end do
    table%epoch = power_above(4.0_wp*max(2.0_wp*maxval(table%urn%reach), &
      maxval(hypot(table%channel%length, table%channel%width), mask=is_open(table%channel))))
    table%urn%clock_resolution = epsilon(1.0_wp)*table%epoch
  end function new_table_of_urns

  !> Area |Q| of the whole table, open channels included.
  pure function area(table) result(total)
    type(table_type), intent(in) :: table
    real(wp) :: total, covered, added

    total = sum(table%urn(:table%urn_count)%area) + sum(0.5_wp*real(table%urn_count, &
      wp)*table%channel%length*table%channel%width)
    if (.not. table%has_scatterers) return
    call measure_scatterers(table%channel(channel2), table%scatterers, covered, added)
    total = total - covered
  end function area

  !> (N1 - N2)/N of equal densities in both urns and all channels, as if discs in channel 2 were in
  !> both halves of it.
  pure function even_difference(table) result(difference)
    type(table_type), intent(in) :: table
    real(wp) :: difference

    difference = (table%urn(1)%area - table%urn(table%urn_count)%area)/area(table)
  end function even_difference

  !> Length |dQ| of all walls, the end wall of the single urn included.
  pure function perimeter(table) result(length)
    type(table_type), intent(in) :: table
    real(wp) :: length, covered, added

    length = sum(table%urn(:table%urn_count)%perimeter) + real(table%urn_count, &
      wp)*sum(table%channel%length, mask=is_open(table%channel))
    if (table%urn_across(1) == 1) length = length + table%channel(channel1)%width
    if (.not. table%has_scatterers) return
    call measure_scatterers(table%channel(channel2), table%scatterers, covered, added)
    length = length + added
  end function perimeter

  !> |x| at the far end of the table, on the longer half.
  pure function half_length(table) result(length)
    type(table_type), intent(in) :: table
    real(wp) :: length

    length = maxval(table%urn%centre + table%urn%reach)
    if (is_open(table%channel(channel2))) length = maxval(table%urn%periodic_line)
  end function half_length

  !> Shortest time from any event of a particle (entry into a gate, crossing of the middle line,
  !> reversal, crossing of the periodic line) to its next entry into a gate or crossing of the
  !> periodic line: a lower bound, from the depths of the openings of either urn and half of channel
  !> 2. With discs in channel 2, only to its next entry into a gate.
  pure function shortest_excursion(table) result(time)
    type(table_type), intent(in) :: table
    real(wp) :: time

    associate (urn => table%urn(:table%urn_count), channel => table%channel(channel2))
      time = 2.0_wp*minval(urn%depth(channel1))
      if (table%has_scatterers) then
        time = min(time, minval(urn%depth(channel2) + urn%depth(channel1)))
      else if (is_open(channel)) then
        time = min(time, 2.0_wp*minval(urn%depth(channel2)) + channel%length)
      end if
    end associate
  end function shortest_excursion

  !> Time in which the directions of motion relax, estimated from above, the longest of three. In
  !> the larger urn, 25 r^4/w^3, with r the radius of a disc of the urn's area; in discs they relax
  !> in 19 r^4/w^3 (docs/theory.md): the 25 takes each passage as long as the mean one, but oblique
  !> particles are faster. It is kept, since no error should be given too early. Between wide
  !> openings, `turning_time`. In long channels, the mean time of a passage through both, pi/2 of
  !> their lengths.
  !>
  !> Huge if channel 1 is closed, or if all urns are polygons in which directions never relax, or
  !> too slowly: discs in channel 2 count for nothing, since in a narrow one they meet too few
  !> particles. Errors of a run shorter than ten times this are not estimated.
  pure function relaxation_time(table) result(time)
    type(table_type), intent(in) :: table
    real(wp) :: time, radius
    logical :: relaxes
    integer :: urn

    relaxes = .false.
    do urn = 1, table%urn_count
      if (.not. relaxes) relaxes = table%urn(urn)%shape /= shape_polygon
      if (.not. relaxes) relaxes = .not. is_nearly_rational(table%urn(urn)%corner)
    end do
    time = huge(1.0_wp)
    if (.not. (relaxes .and. is_open(table%channel(channel1)))) return
    radius = sqrt(maxval(table%urn(:table%urn_count)%area)/pi)
    time = max(25.0_wp*radius*(radius/table%channel(channel1)%width)**3, turning_time(table), &
      0.5_wp*pi*sum(table%channel%length, mask=is_open(table%channel)))
  end function relaxation_time

  !> Time in which particles between wide openings lose their sense of going round. A hit of a
  !> wall whose normal is tilted by t from the y axis turns the direction by 2t, and the mean of its
  !> cosine loses 2 sin(t)^2. A wall of length ds is hit in a time pi A/ds. Twice that, since
  !> particles near the axis meet walls less often: in runs the last of the memory decays 1.5 to 2.5
  !> times as slowly between discs with w = w' = 1.6 to 1.9.
  pure function turning_time(table) result(time)
    type(table_type), intent(in) :: table
    real(wp) :: time, tilt(2), lost
    integer :: urn

    lost = 0.0_wp
    do urn = 1, table%urn_count
      associate (this => table%urn(urn))
        if (this%shape == shape_polygon) then
          associate (sides => this%polygon)
            lost = lost + 2.0_wp*(sum(sides%length_of*sides%normal_x**2) - sum(this%width))
          end associate
        else
          ! From the openings to the top and the bottom.
          tilt = acos(0.5_wp*table%channel%width/this%radius)
          lost = lost + 2.0_wp*this%radius*sum(tilt - sin(tilt)*cos(tilt))
        end if
      end associate
    end do
    time = 2.0_wp*pi*area(table)/max(lost, epsilon(lost)*perimeter(table))
  end function turning_time

  !> Urn to whose half of the table a point belongs; the middle line belongs to urn 2, if there is
  !> one.
  elemental function urn_at(table, x) result(urn)
    type(table_type), intent(in) :: table
    !> Position in the frame of the table, a length.
    real(wp), intent(in) :: x
    integer :: urn

    urn = merge(1, table%urn_count, x < 0.0_wp)
  end function urn_at

  !> x of a particle at the end of a run, if rounding has put it beyond a line that it has not
  !> crossed yet, or has left it on one that it has: a run that goes on has each crossing once.
  elemental function x_on_side(table, urn, enters, is_counted, x, y, ux) result(kept)
    type(table_type), intent(in) :: table
    !> Urn to whose half the particle belongs.
    integer, intent(in) :: urn
    !> Whether its next event may be that it enters the gate of that urn; whether that gate counts
    !> it.
    logical, intent(in) :: enters, is_counted
    !> Position in the frame of the table, lengths; velocity along x.
    real(wp), intent(in) :: x, y, ux
    real(wp) :: kept, depth, towards

    associate (this => table%urn(urn))
      depth = x_direction(urn)*x
      towards = -x_direction(urn)*ux
      if (is_counted) then
        depth = min(max(depth, tiny(depth)), nearest(this%channel_start(channel1), -1.0_wp))
      else if (towards > 0.0_wp) then
        if (enters .and. abs(y) <= this%half_width(channel1)) &
          depth = max(depth, this%channel_start(channel1))
      else if (towards < 0.0_wp) then
        depth = max(depth, tiny(depth))
        if (abs(y) <= this%half_width(channel2)) depth = min(depth, this%periodic_line)
      end if
      kept = x_direction(urn)*depth
    end associate
  end function x_on_side

  !> Whether a particle in an urn is next to the chord of its gate and moves over it: where
  !> `before_crossing` has put one that is on the chord, and enters at the first instant.
  elemental logical function enters_at_once(table, x, y, ux) result(yes)
    type(table_type), intent(in) :: table
    !> Position in the frame of the table, lengths; velocity along x.
    real(wp), intent(in) :: x, y, ux

    associate (urn => table%urn(urn_at(table, x)))
      yes = x*ux < 0.0_wp .and. abs(ux) > urn%least_across .and. abs(y) &
        <= urn%half_width(channel1) .and. abs(x) > urn%channel_start(channel1) .and. &
        nearest(abs(x), -1.0_wp) <= urn%channel_start(channel1)
    end associate
  end function enters_at_once

  !> Chamber that contains the point (x, y); a point on a chord belongs to the channel. `tolerance`
  !> is the distance that a point may lie beyond a wall.
  pure function chamber_at(table, x, y, tolerance) result(chamber)
    type(table_type), intent(in) :: table
    !> Position in the frame of the table, and a distance: lengths.
    real(wp), intent(in) :: x, y, tolerance
    integer :: chamber
    real(wp) :: beside

    chamber = outside
    associate (urn => table%urn(urn_at(table, x)))
      if (abs(x) <= urn%channel_start(channel1)) then
        if (abs(y) <= urn%half_width(channel1) + tolerance) chamber = in_gate
      else if (is_open(table%channel(channel2)) &
        .and. abs(x) - urn%centre >= urn%chord(channel2)) then
        if (abs(y) <= urn%half_width(channel2) + tolerance .and. &
          abs(x) <= urn%periodic_line + tolerance) chamber = in_channel2
        if (is_in_scatterer(table%half_channel2(urn_at(table, x)), urn%periodic_line - abs(x), y, &
          tolerance)) chamber = outside
      else if (contains_point(urn, urn%centre - abs(x), y, tolerance)) then
        chamber = in_urn
      end if
      if (chamber /= in_urn) then
        ! Beside a channel or its end, the urn has the point if it is nearer than the channel: the
        ! wall of an opening ends at its chord, and an urn may extend over a channel.
        beside = abs(y) - urn%half_width(merge(channel1, channel2, abs(x) &
          <= urn%channel_start(channel1)))
        if (beside > 0.0_wp .and. contains_point(urn, urn%centre - abs(x), y, min(beside, &
          tolerance))) chamber = in_urn
      end if
    end associate
    if (table%urn_count == 1 .and. x > tolerance) chamber = outside
  end function chamber_at

  !> Whether a particle in a disc moves along its arc: it is so near, and its direction so close to
  !> the arc's, that rounding errors decide how soon it hits the wall, and how often.
  pure function moves_along_arc(table, x, y, ux, uy)
    type(table_type), intent(in) :: table
    !> Position in the frame of the table, lengths; velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    logical :: moves_along_arc
    real(wp), parameter :: least_cosine = 1.0e-7_wp
    real(wp) :: angle, cosine, sine, wait
    integer(int64) :: before

    associate (urn => table%urn(urn_at(table, x)))
      moves_along_arc = urn%shape /= shape_polygon .and. chamber_at(table, x, y, huge(1.0_wp)) &
        == in_urn
      if (.not. moves_along_arc) return
      call find_first_impact(urn, urn%centre - abs(x), y, urn%axis_sign*ux, uy, angle, cosine, &
        sine, wait, before)
      moves_along_arc = cosine < least_cosine
    end associate
  end function moves_along_arc

  !> Height of a particle in a channel of this width; just off the wall, if it is on it.
  elemental real(wp) function height_off_wall(y, width) result(height)
    real(wp), intent(in) :: y, width

    height = sign(min(abs(y), 0.5_wp*(1.0_wp - 2.0_wp*epsilon(y))*width), y)
  end function height_off_wall

  !> Passage of a particle that is in a channel: the time since it left its urn, or until it reaches
  !> it. A particle is trapped if its passage would take longer than `longest_passage`, or have more
  !> wall hits than an integer can count.
  pure function passage_at(table, x, y, ux, uy) result(passage)
    type(table_type), intent(in) :: table
    !> Position in the frame of the table, lengths; velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    type(passage_type) :: passage
    real(wp), parameter :: most_hits = 4.0e18_wp
    real(wp) :: depth, outward, height

    passage%urn = urn_at(table, x)
    passage%chamber = chamber_at(table, x, y, huge(1.0_wp))
    if (passage%chamber == in_urn) return
    passage%channel = merge(channel2, channel1, passage%chamber == in_channel2)
    associate (urn => table%urn(passage%urn), channel => table%channel(passage%channel))
      ! Distance beyond the chord, and velocity away from it.
      depth = urn%channel_start(channel1) - abs(x)
      if (passage%channel == channel2) depth = abs(x) - urn%centre - urn%chord(channel2)
      outward = facing(passage%channel)*urn%axis_sign*ux
      passage%trapped = .not. abs(ux)*min(longest_passage*urn%reach, &
        most_hits*channel%width) > channel%length
      ! Who moves along the chord is in the urn, also if the end of a run has put it beside it.
      if (depth <= least_across*max(abs(x), urn%reach) .and. outward <= urn%least_across .and. &
        (passage%trapped .or. abs(ux) <= urn%least_across)) then
        if (abs(ux) <= urn%least_across) passage%chord = passage%channel
        passage%trapped = .false.
        passage%chamber = in_urn
        passage%channel = no_channel
        return
      end if
      if (passage%trapped) return
      passage%time = -depth/outward
      passage%moves_away = outward > 0.0_wp
      height = y
      ! On the wall, its next hit is to come: also of who has just entered, and moves into the wall.
      if (abs(y) >= 0.5_wp*channel%width .and. (passage%moves_away .or. y*uy <= 0.0_wp)) &
        height = height_off_wall(y, channel%width)
      passage%height = height
      if (passage%moves_away) call fold_into_channel(height - uy*depth/outward, channel%width, &
        passage%height, passage%reflected, passage%hits)
    end associate
  end function passage_at

end module battery_table

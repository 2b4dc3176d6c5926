!> The billiard table: two circular urns, a gated channel and a channel that closes the circuit.
!>
!> Coordinates: the origin is the middle of channel 1, x runs along it, urn 1 lies at x < 0. A
!> channel is attached to an urn at the chord as long as the channel is wide. Lengths are free; the
!> speed of a particle is 1, so times are lengths too.
!> Source: Cirillo, Colangeli, Richardson, Rondoni, PRE 103, 032119 (2021), Fig. model, eq. (eq000).
module battery_table
  use battery_kinds, only: wp, pi
  implicit none (type, external)
  private
  public :: table_type, new_table, shape_circuit, shape_urn
  public :: area_of_urn, area, perimeter, arc_length, half_length, shortest_excursion
  public :: try_point, longest_run
  public :: region_at, outside, urn_one, urn_two, gate_one, gate_two, return_one, return_two

  !> Shapes: the circuit of Fig. model, and the single urn with a gate and an end wall of Fig. app1.
  integer, parameter :: shape_circuit = 1, shape_urn = 2

  !> Regions of the table: the urns, the gates, the halves of channel 2; `outside` is none of them.
  integer, parameter :: outside = 0, urn_one = 1, urn_two = 2, gate_one = 3, gate_two = 4, &
    return_one = 5, return_two = 6

  !> No run is longer, in radii of an urn: beyond, the clock would not resolve an urn.
  real(wp), parameter :: longest_run = 1.0e15_wp

  type :: table_type
    integer :: shape = shape_circuit
    real(wp) :: urn_radius = 1.0_wp
    real(wp) :: channel1_width = 0.3_wp
    real(wp) :: channel1_length = 1.0_wp
    real(wp) :: channel2_width = 0.01_wp
    real(wp) :: channel2_length = 1.0_wp
    !> Distances of the chords of channel 1 and 2 from the centre of an urn.
    real(wp) :: chord1_distance = 0.0_wp
    real(wp) :: chord2_distance = 0.0_wp
    !> x of the centre of urn 2; urn 1 is at minus that.
    real(wp) :: urn_centre = 0.0_wp
    !> x of the periodic line at the end of urn 2's half of channel 2; minus that for urn 1's.
    real(wp) :: periodic_line = 0.0_wp
  end type table_type

contains

  !> A table from its five lengths; the caller has checked them (0 < w < 2r, 0 <= w' < 2r, lengths
  !> positive). Shape `shape_urn` has no channel 2, whatever is asked for.
  pure function new_table(shape, urn_radius, channel1_width, channel1_length, channel2_width, &
      channel2_length) result(table)
    integer, intent(in) :: shape
    real(wp), intent(in) :: urn_radius, channel1_width, channel1_length
    real(wp), intent(in) :: channel2_width, channel2_length
    type(table_type) :: table

    table%shape = shape
    table%urn_radius = urn_radius
    table%channel1_width = channel1_width
    table%channel1_length = channel1_length
    table%channel2_width = merge(channel2_width, 0.0_wp, shape == shape_circuit)
    table%channel2_length = channel2_length
    table%chord1_distance = chord_distance(urn_radius, table%channel1_width)
    table%chord2_distance = chord_distance(urn_radius, table%channel2_width)
    table%urn_centre = 0.5_wp*channel1_length + table%chord1_distance
    table%periodic_line = table%urn_centre + table%chord2_distance + 0.5_wp*channel2_length
  end function new_table

  !> Distance of a chord of length `width` from the centre; factored, so that it stays exact as the
  !> width goes to the diameter.
  elemental function chord_distance(radius, width) result(distance)
    real(wp), intent(in) :: radius, width
    real(wp) :: distance

    distance = sqrt((radius - 0.5_wp*width)*(radius + 0.5_wp*width))
  end function chord_distance

  !> A of eq. (eq000): the disc less the segments cut off by the chords.
  pure function area_of_urn(table) result(urn_area)
    type(table_type), intent(in) :: table
    real(wp) :: urn_area

    urn_area = pi*table%urn_radius**2 - segment_area(table%channel1_width) &
      - segment_area(table%channel2_width)

  contains

    pure function segment_area(width) result(segment)
      real(wp), intent(in) :: width
      real(wp) :: segment

      segment = table%urn_radius**2*asin(0.5_wp*width/table%urn_radius) &
        - 0.5_wp*width*chord_distance(table%urn_radius, width)
    end function segment_area

  end function area_of_urn

  !> Area |Q| of the whole table, open channels included.
  pure function area(table) result(total)
    type(table_type), intent(in) :: table
    real(wp) :: total

    if (table%shape == shape_urn) then
      total = area_of_urn(table) + 0.5_wp*table%channel1_length*table%channel1_width
    else
      total = 2.0_wp*area_of_urn(table) + table%channel1_length*table%channel1_width &
        + table%channel2_length*table%channel2_width
    end if
  end function area

  !> Length of the arc of one urn that is left between the openings.
  pure function arc_length(table) result(length)
    type(table_type), intent(in) :: table
    real(wp) :: length

    length = table%urn_radius*(2.0_wp*pi &
      - 2.0_wp*asin(0.5_wp*table%channel1_width/table%urn_radius) &
      - 2.0_wp*asin(0.5_wp*table%channel2_width/table%urn_radius))
  end function arc_length

  !> Length |dQ| of all walls, the end wall of `shape_urn` included.
  pure function perimeter(table) result(length)
    type(table_type), intent(in) :: table
    real(wp) :: length

    if (table%shape == shape_urn) then
      length = arc_length(table) + table%channel1_length + table%channel1_width
    else
      length = 2.0_wp*arc_length(table) + 2.0_wp*table%channel1_length
      if (table%channel2_width > 0.0_wp) length = length + 2.0_wp*table%channel2_length
    end if
  end function perimeter

  !> |x| at the ends of the table.
  pure function half_length(table) result(length)
    type(table_type), intent(in) :: table
    real(wp) :: length

    length = table%urn_centre + table%urn_radius
    if (table%channel2_width > 0.0_wp) length = table%periodic_line
  end function half_length

  !> Shortest time from any event of a particle (it enters a gate, crosses the middle of channel 1,
  !> is turned back, or crosses the periodic line) to its next entry of a gate or crossing of the
  !> periodic line: a lower bound, from the straight way between the chords with half of channel 2,
  !> and from the way back to the same chord.
  pure function shortest_excursion(table) result(time)
    type(table_type), intent(in) :: table
    real(wp) :: time
    real(wp) :: back1, back2

    back1 = shortest_return(table%channel1_width)
    if (table%channel2_width > 0.0_wp) then
      back2 = shortest_return(table%channel2_width) + table%channel2_length
      time = table%chord1_distance + table%chord2_distance + 0.5_wp*table%channel2_length
      time = min(time, back1, back2)
    else
      time = back1
    end if

  contains

    !> The points of impact go round the circle in one sense, by at most half a turn each, so one of
    !> them lies in the far half of the urn: there and back is at least twice the chord's distance.
    pure function shortest_return(width) result(length)
      real(wp), intent(in) :: width
      real(wp) :: length

      length = 2.0_wp*chord_distance(table%urn_radius, width)
    end function shortest_return

  end function shortest_excursion

  !> A point about the centre of an urn whose chords lie at x = `lower` < 0 and `upper` > 0, from
  !> two numbers `across` and `up` uniform in [0, 1]: uniform in the urn where it is `inside`, which
  !> is so more than two times in five. Between near chords it is looked for there alone.
  pure subroutine try_point(radius, lower, upper, across, up, x, y, inside)
    real(wp), intent(in) :: radius, lower, upper, across, up
    real(wp), intent(out) :: x, y
    logical, intent(out) :: inside

    if (upper - lower < radius) then
      x = lower + (upper - lower)*across
    else
      x = radius*(2.0_wp*across - 1.0_wp)
    end if
    y = radius*(2.0_wp*up - 1.0_wp)
    inside = x**2 + y**2 < radius**2 .and. lower < x .and. x < upper
  end subroutine try_point

  !> Region that holds the point (x, y); a point on a chord belongs to the channel, one on the
  !> middle line to gate 2. `tolerance` is how far beyond a wall a point may lie.
  pure function region_at(table, x, y, tolerance) result(region)
    type(table_type), intent(in) :: table
    real(wp), intent(in) :: x, y, tolerance
    integer :: region
    real(wp) :: from_centre

    region = outside
    from_centre = abs(x) - table%urn_centre
    if (abs(x) <= 0.5_wp*table%channel1_length) then
      if (abs(y) <= 0.5_wp*table%channel1_width + tolerance) region = merge(gate_one, gate_two, &
        x < 0.0_wp)
    else if (table%channel2_width > 0.0_wp .and. from_centre >= table%chord2_distance) then
      if (abs(y) <= 0.5_wp*table%channel2_width + tolerance .and. &
        abs(x) <= table%periodic_line + tolerance) region = merge(return_one, return_two, &
        x < 0.0_wp)
    else
      if (hypot(from_centre, y) <= table%urn_radius + tolerance) &
        region = merge(urn_one, urn_two, x < 0.0_wp)
    end if
    if (table%shape == shape_urn .and. x > tolerance) region = outside
  end function region_at

end module battery_table

!> The billiard table: two circular urns, a gated channel and a channel that closes the circuit.
!>
!> Coordinates: the origin is the middle of channel 1, x runs along it, urn 1 lies at x < 0. A
!> channel is attached to an urn at the chord as long as the channel is wide. Lengths are free; the
!> speed of a particle is 1, so times are lengths too.
!> Source: Cirillo, Colangeli, Richardson, Rondoni, PRE 103, 032119 (2021), Fig. model, eq. (eq000).
!>
!> Everything is known by its index: the urns and sides 1 and 2, the channels 1 (gated) and 2, and
!> on each side three chambers: the urn, the gate (half of channel 1) and the half of channel 2.
!> The halves of a channel meet at its line: the middle line, and the periodic line. The single urn
!> of Fig. app1 is a table of one side: its middle line is a wall that leads back to it.
module battery_table
  use battery_kinds, only: wp, pi
  implicit none (type, external)
  private
  public :: table_type, urn_type, channel_type, new_table, shape_circuit, shape_urn
  public :: gated, ungated, outside, in_urn, in_gate, in_return
  public :: side_at, chamber_at, beyond, x_direction, is_open, alike
  public :: area_of_urn, area, perimeter, arc_length, half_length, mean_visit, shortest_excursion
  public :: try_point, longest_run

  !> Shapes: the circuit of Fig. model, and the single urn with a gate and an end wall of Fig. app1.
  integer, parameter :: shape_circuit = 1, shape_urn = 2

  !> No run is longer, in radii of an urn: beyond, the clock would not resolve an urn.
  real(wp), parameter :: longest_run = 1.0e15_wp

  !> The channels: that with the gates, and that which closes the circuit.
  integer, parameter :: gated = 1, ungated = 2

  !> Chambers of a side; `outside` is none of them.
  integer, parameter :: outside = 0, in_urn = 1, in_gate = 2, in_return = 3

  !> The way along x from the origin to each side.
  real(wp), parameter :: x_direction(2) = [-1.0_wp, 1.0_wp]

  !> An urn of the table: lengths.
  type :: urn_type
    real(wp) :: radius = 1.0_wp
    !> Distance of the chord of each channel from the centre.
    real(wp) :: chord(2) = 0.0_wp
    !> |x| of the centre, and of the periodic line at the end of this side's half of channel 2.
    real(wp) :: centre = 0.0_wp, periodic_line = 0.0_wp
  end type urn_type

  !> A channel of the table: lengths.
  type :: channel_type
    !> From wall to wall (0: closed), and from urn to urn, both halves together.
    real(wp) :: width = 0.0_wp, length = 1.0_wp
  end type channel_type

  !> The whole table: urns by side, channels by `gated` and `ungated`.
  type :: table_type
    !> How many sides there are: 2, or 1 for the single urn.
    integer :: sides = 2
    type(urn_type) :: urn(2)
    type(channel_type) :: channel(2)
  end type table_type

  !> A table from its lengths; the radius is one for both urns, or one for each.
  interface new_table
    procedure new_table_equal, new_table_unequal
  end interface new_table

contains

  !> Both urns have the same radius.
  pure function new_table_equal(shape, urn_radius, channel1_width, channel1_length, &
      channel2_width, channel2_length) result(table)
    integer, intent(in) :: shape
    real(wp), intent(in) :: urn_radius, channel1_width, channel1_length
    real(wp), intent(in) :: channel2_width, channel2_length
    type(table_type) :: table

    table = new_table_unequal(shape, [urn_radius, urn_radius], channel1_width, channel1_length, &
      channel2_width, channel2_length)
  end function new_table_equal

  !> A table from its lengths; the caller has checked them (0 < w < 2r, 0 <= w' < 2r for both radii,
  !> lengths positive). Shape `shape_urn` has no channel 2 and no urn 2, whatever is asked for.
  pure function new_table_unequal(shape, urn_radius, channel1_width, channel1_length, &
      channel2_width, channel2_length) result(table)
    !> `shape_circuit` or `shape_urn`.
    integer, intent(in) :: shape
    !> Radii of urn 1 and 2, a length.
    real(wp), intent(in) :: urn_radius(2)
    !> Widths and lengths of the channels; width 0 closes channel 2.
    real(wp), intent(in) :: channel1_width, channel1_length
    real(wp), intent(in) :: channel2_width, channel2_length
    type(table_type) :: table
    integer :: side

    table%sides = merge(2, 1, shape == shape_circuit)
    table%channel(gated) = channel_type(channel1_width, channel1_length)
    table%channel(ungated) = channel_type(merge(channel2_width, 0.0_wp, shape == shape_circuit), &
      channel2_length)
    do side = 1, 2
      associate (urn => table%urn(side))
        urn%radius = urn_radius(min(side, table%sides))
        urn%chord = chord_distance(urn%radius, table%channel%width)
        urn%centre = 0.5_wp*channel1_length + urn%chord(gated)
        urn%periodic_line = urn%centre + urn%chord(ungated) + 0.5_wp*channel2_length
      end associate
    end do
  end function new_table_unequal

  !> Distance of a chord of length `width` from the centre; factored, so that it stays exact as the
  !> width goes to the diameter.
  elemental function chord_distance(radius, width) result(distance)
    real(wp), intent(in) :: radius, width
    real(wp) :: distance

    distance = sqrt((radius - 0.5_wp*width)*(radius + 0.5_wp*width))
  end function chord_distance

  !> The side on which a particle goes on that crosses the line of a channel from `side`; the end
  !> wall of the single urn leads back.
  pure function beyond(table, side)
    type(table_type), intent(in) :: table
    integer, intent(in) :: side
    integer :: beyond

    beyond = merge(3 - side, side, table%sides == 2)
  end function beyond

  !> Whether a channel lets anybody through.
  elemental function is_open(channel)
    type(channel_type), intent(in) :: channel
    logical :: is_open

    is_open = channel%width > 0.0_wp
  end function is_open

  !> Whether the two urns are mirror images of each other, so that one chamber serves both.
  pure function alike(table)
    type(table_type), intent(in) :: table
    logical :: alike

    alike = .not. abs(table%urn(1)%radius - table%urn(2)%radius) > 0.0_wp
  end function alike

  !> A of eq. (eq000): the disc less the segments cut off by the chords.
  pure function area_of_urn(table, side) result(urn_area)
    type(table_type), intent(in) :: table
    !> 1 or 2.
    integer, intent(in) :: side
    real(wp) :: urn_area

    associate (radius => table%urn(side)%radius)
      urn_area = pi*radius**2 - segment_area(radius, table%channel(gated)%width) &
        - segment_area(radius, table%channel(ungated)%width)
    end associate
  end function area_of_urn

  !> What a chord of length `width` cuts off a disc.
  elemental function segment_area(radius, width) result(segment)
    real(wp), intent(in) :: radius, width
    real(wp) :: segment

    segment = radius**2*asin(0.5_wp*width/radius) - 0.5_wp*width*chord_distance(radius, width)
  end function segment_area

  !> Area |Q| of the whole table, open channels included.
  pure function area(table) result(total)
    type(table_type), intent(in) :: table
    real(wp) :: total

    associate (channel => table%channel)
      if (table%sides == 1) then
        total = area_of_urn(table, 1) + 0.5_wp*channel(gated)%length*channel(gated)%width
      else
        total = (area_of_urn(table, 1) + area_of_urn(table, 2)) &
          + channel(gated)%length*channel(gated)%width &
          + channel(ungated)%length*channel(ungated)%width
      end if
    end associate
  end function area

  !> Length of the arc of an urn that is left between the openings.
  pure function arc_length(table, side) result(length)
    type(table_type), intent(in) :: table
    !> 1 or 2.
    integer, intent(in) :: side
    real(wp) :: length

    associate (radius => table%urn(side)%radius)
      length = radius*(2.0_wp*pi - 2.0_wp*asin(0.5_wp*table%channel(gated)%width/radius) &
        - 2.0_wp*asin(0.5_wp*table%channel(ungated)%width/radius))
    end associate
  end function arc_length

  !> Length |dQ| of all walls, the end wall of the single urn included.
  pure function perimeter(table) result(length)
    type(table_type), intent(in) :: table
    real(wp) :: length

    associate (channel => table%channel)
      if (table%sides == 1) then
        length = arc_length(table, 1) + channel(gated)%length + channel(gated)%width
      else
        length = (arc_length(table, 1) + arc_length(table, 2)) + 2.0_wp*channel(gated)%length
        if (is_open(channel(ungated))) length = length + 2.0_wp*channel(ungated)%length
      end if
    end associate
  end function perimeter

  !> |x| at the far end of the table, on the side that is longer.
  pure function half_length(table) result(length)
    type(table_type), intent(in) :: table
    real(wp) :: length

    length = maxval(table%urn%centre + table%urn%radius)
    if (is_open(table%channel(ungated))) length = maxval(table%urn%periodic_line)
  end function half_length

  !> Mean length of a visit to an urn that is entered evenly through its openings.
  pure function mean_visit(table, side) result(time)
    type(table_type), intent(in) :: table
    !> 1 or 2.
    integer, intent(in) :: side
    real(wp) :: time

    time = pi*area_of_urn(table, side)/(table%channel(gated)%width + table%channel(ungated)%width)
  end function mean_visit

  !> Shortest time from any event of a particle (it enters a gate, crosses the middle of channel 1,
  !> is turned back, or crosses the periodic line) to its next entry of a gate or crossing of the
  !> periodic line: a lower bound, from the straight way between the chords with half of channel 2,
  !> and from the way back to the same chord, of either urn.
  !> The points of impact of a way back go round the circle in one sense, by at most half a turn
  !> each, so one of them lies in the far half of the urn: there and back is at least twice the
  !> chord's distance.
  pure function shortest_excursion(table) result(time)
    type(table_type), intent(in) :: table
    real(wp) :: time
    integer :: side

    time = huge(1.0_wp)
    do side = 1, table%sides
      associate (chord => table%urn(side)%chord, channel => table%channel(ungated))
        time = min(time, 2.0_wp*chord(gated))
        if (is_open(channel)) time = min(time, &
          chord(gated) + chord(ungated) + 0.5_wp*channel%length, &
          2.0_wp*chord(ungated) + channel%length)
      end associate
    end do
  end function shortest_excursion

  !> A point about the centre of an urn whose chords lie at x = `lower` < 0 and `upper` > 0, from
  !> two numbers `across` and `up` uniform in [0, 1]: uniform in the urn where it is `inside`, which
  !> is so more than two times in five. Between near chords it is looked for there alone.
  pure subroutine try_point(radius, lower, upper, across, up, x, y, inside)
    !> `radius`, `lower` and `upper` are lengths.
    real(wp), intent(in) :: radius, lower, upper, across, up
    !> The point, from the centre: lengths.
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

  !> The side of a point; the middle line belongs to side 2, if there is one.
  elemental function side_at(table, x) result(side)
    type(table_type), intent(in) :: table
    !> In the frame of the table, a length.
    real(wp), intent(in) :: x
    integer :: side

    side = merge(1, table%sides, x < 0.0_wp)
  end function side_at

  !> Chamber that holds the point (x, y); a point on a chord belongs to the channel. `tolerance` is
  !> how far beyond a wall a point may lie.
  pure function chamber_at(table, x, y, tolerance) result(chamber)
    type(table_type), intent(in) :: table
    !> In the frame of the table, lengths.
    real(wp), intent(in) :: x, y, tolerance
    integer :: chamber
    real(wp) :: from_centre

    chamber = outside
    associate (urn => table%urn(side_at(table, x)), channel => table%channel)
      from_centre = abs(x) - urn%centre
      if (abs(x) <= 0.5_wp*channel(gated)%length) then
        if (abs(y) <= 0.5_wp*channel(gated)%width + tolerance) chamber = in_gate
      else if (is_open(channel(ungated)) .and. from_centre >= urn%chord(ungated)) then
        if (abs(y) <= 0.5_wp*channel(ungated)%width + tolerance .and. &
          abs(x) <= urn%periodic_line + tolerance) chamber = in_return
      else
        if (hypot(from_centre, y) <= urn%radius + tolerance) chamber = in_urn
      end if
    end associate
    if (table%sides == 1 .and. x > tolerance) chamber = outside
  end function chamber_at

end module battery_table

!> The billiard table: two urns, a gated channel and a channel that closes the circuit.
!>
!> Coordinates: the origin is the middle of channel 1, x runs along it, urn 1 lies at x < 0. A
!> channel is attached to an urn at the chord as long as the channel is wide. Lengths are free; the
!> speed of a particle is 1, so times are lengths too.
!> Source: Cirillo, Colangeli, Richardson, Rondoni, PRE 103, 032119 (2021), Fig. model, eq. (eq000).
!>
!> Everything is known by its index: the urns and sides 1 and 2, the channels 1 (gated) and 2, and
!> on each side three chambers: the urn, the gate (half of channel 1) and the half of channel 2.
!> The halves of a channel meet at its line: the middle line, and the periodic line. The single urn
!> of Fig. app1 is a table of one side: its middle line is a wall that leads back to it. What shape
!> an urn has, only `battery_urn` asks.
module battery_table
  use battery_kinds, only: wp, pi
  use battery_powers, only: power_above
  use battery_channel, only: channel_type, is_open, fold_into_channel, gated, ungated, no_channel, &
    facing
  use battery_chamber, only: mean_visit
  use battery_corners, only: directions_stay
  use battery_motion, only: outside, in_urn, in_gate, in_return
  use battery_scatterers, only: scattered_half_channel_type, new_scattered_half_channel, &
    is_in_scatterer, measure_scatterers
  use battery_urn, only: urn_type, shape_polygon, derive_shape, are_mirror_images, contains_point, &
    try_random_point
  implicit none (type, external)
  private
  public :: table_type, urn_type, channel_type, new_table, shape_circuit, shape_urn
  public :: gated, ungated, no_channel, outside, in_urn, in_gate, in_return
  public :: urn_at, chamber_at, x_direction, is_open, are_mirror_images, passage_type, passage_at
  public :: area, perimeter, half_length, mean_visit, shortest_excursion, try_random_point, &
    longest_run
  public :: is_scattered, relaxation_time

  !> Shapes: the circuit of Fig. model, and the single urn with a gate and an end wall of Fig. app1.
  integer, parameter :: shape_circuit = 1, shape_urn = 2

  !> No run is longer, in the reach of an urn: beyond, the clock would not resolve an urn.
  real(wp), parameter :: longest_run = 1.0e15_wp

  !> The way along x from the origin to each side.
  real(wp), parameter :: x_direction(2) = [-1.0_wp, 1.0_wp]

  !> The whole table: urns by side, channels by `gated` and `ungated`.
  type :: table_type
    !> How many sides there are: 2, or 1 for the single urn.
    integer :: sides = 2
    !> The side on which a particle goes on that crosses the line of a channel from each side; the
    !> end wall of the single urn leads back.
    integer :: beyond(2) = [2, 1]
    type(urn_type) :: urn(2)
    type(channel_type) :: channel(2)
    !> Fixed discs in channel 2: (z, y, radius) of each, z along the channel from urn 2 over the
    !> line at 0 to urn 1; and each half of the channel with them, by side.
    real(wp), allocatable :: scatterers(:, :)
    type(scattered_half_channel_type) :: half_channel2(2)
    !> A power of two, at least four times the longest flight from wall to wall.
    real(wp) :: epoch = 0.0_wp
  end type table_type

  !> Where a particle stands on its way through a channel.
  type :: passage_type
    !> Side and chamber that it is in; the channel, or `no_channel`: then nothing else is known.
    integer :: urn = 0, chamber = outside, channel = no_channel
    !> Whether it is too slow to get anywhere, and if not, whether it goes to the line of the
    !> channel or to its urn.
    logical :: endless = .false., inward = .false.
    !> How long from now until it reaches its urn, or, below 0, since it came from there.
    real(wp) :: time = 0.0_wp
    !> Of one that goes inward: at which height it came from its urn, 1 or -1 as u_y has turned over
    !> since, and the wall hits since.
    real(wp) :: height = 0.0_wp, reflected = 1.0_wp, hits = 0.0_wp
  end type passage_type

  !> A table from its urns and channels, or from its lengths.
  interface new_table
    procedure new_table_of_urns, new_table_of_discs
  end interface new_table

contains

  !> Both urns are discs of the same radius.
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

  !> A table from its parts; the caller has checked their lengths (openings fit, lengths positive).
  !> Shape `shape_urn` has no channel 2 and no urn 2, whatever is asked for.
  pure function new_table_of_urns(shape, urn, channel, scatterers) result(table)
    !> `shape_circuit` or `shape_urn`.
    integer, intent(in) :: shape
    !> What the urns 1 and 2 are to be.
    type(urn_type), intent(in) :: urn(2)
    !> Width 0 closes channel 2.
    type(channel_type), intent(in) :: channel(2)
    !> (z, y, radius) of each disc in channel 2; absent: there are none.
    real(wp), intent(in), optional :: scatterers(:, :)
    type(table_type) :: table
    integer :: urn_index

    table%channel = channel
    allocate (table%scatterers(3, 0))
    if (present(scatterers)) table%scatterers = scatterers
    if (shape == shape_urn) then
      table%sides = 1
      table%beyond = [1, 2]
      table%channel(ungated)%width = 0.0_wp
    end if
    do urn_index = 1, 2
      table%urn(urn_index) = urn(min(urn_index, table%sides))
      call derive_shape(table%urn(urn_index), table%channel)
      associate (here => table%urn(urn_index))
        here%axis_sign = -x_direction(urn_index)
        here%centre = 0.5_wp*channel(gated)%length + here%chord(gated)
        here%channel_start = [0.5_wp*channel(gated)%length, here%centre + here%chord(ungated)]
        here%periodic_line = here%channel_start(ungated) + 0.5_wp*channel(ungated)%length
      end associate
      if (size(table%scatterers) > 0 .and. is_open(table%channel(ungated))) &
        table%half_channel2(urn_index) = new_scattered_half_channel(channel(ungated), &
        table%scatterers, -x_direction(urn_index))
    end do
    table%epoch = power_above(4.0_wp*max(2.0_wp*maxval(table%urn%reach), &
      maxval(hypot(table%channel%length, table%channel%width), mask=is_open(table%channel))))
    table%urn%shortest = epsilon(1.0_wp)*table%epoch
  end function new_table_of_urns

  !> Whether discs stand in channel 2.
  pure logical function is_scattered(table)
    type(table_type), intent(in) :: table

    is_scattered = table%half_channel2(1)%count > 0
  end function is_scattered

  !> Area |Q| of the whole table, open channels included.
  pure function area(table) result(total)
    type(table_type), intent(in) :: table
    real(wp) :: total, covered, added

    total = sum(table%urn(:table%sides)%area) + sum(0.5_wp*real(table%sides, wp) &
      *table%channel%length*table%channel%width)
    call measure_scatterers(table%channel(ungated), table%scatterers, covered, added)
    if (is_scattered(table)) total = total - covered
  end function area

  !> Length |dQ| of all walls, the end wall of the single urn included.
  pure function perimeter(table) result(length)
    type(table_type), intent(in) :: table
    real(wp) :: length, covered, added

    length = sum(table%urn(:table%sides)%perimeter) + real(table%sides, wp) &
      *sum(table%channel%length, mask=is_open(table%channel))
    if (table%beyond(1) == 1) length = length + table%channel(gated)%width
    call measure_scatterers(table%channel(ungated), table%scatterers, covered, added)
    if (is_scattered(table)) length = length + added
  end function perimeter

  !> |x| at the far end of the table, on the side that is longer.
  pure function half_length(table) result(length)
    type(table_type), intent(in) :: table
    real(wp) :: length

    length = maxval(table%urn%centre + table%urn%reach)
    if (is_open(table%channel(ungated))) length = maxval(table%urn%periodic_line)
  end function half_length

  !> Shortest time from any event of a particle (it enters a gate, crosses the middle of channel 1,
  !> is turned back, or crosses the periodic line) to its next entry of a gate or crossing of the
  !> periodic line: a lower bound, from the depths of the openings of either urn, and half of
  !> channel 2. Where discs stand in that, only to its next entry of a gate.
  pure function shortest_excursion(table) result(time)
    type(table_type), intent(in) :: table
    real(wp) :: time

    associate (urn => table%urn(:table%sides), channel => table%channel(ungated))
      time = 2.0_wp*minval(urn%depth(gated))
      if (is_scattered(table)) then
        time = min(time, minval(urn%depth(ungated) + urn%depth(gated)))
      else if (is_open(channel)) then
        time = min(time, 2.0_wp*minval(urn%depth(ungated)) + channel%length)
      end if
    end associate
  end function shortest_excursion

  !> Time in which the directions of flight relax in the larger urn, 25 r^4/w^3 in discs
  !> (docs/theory.md), r the radius of a disc of the urn's area; huge where channel 1 is closed, and
  !> where all walls are straight and particles keep a few directions for ever.
  pure function relaxation_time(table) result(time)
    type(table_type), intent(in) :: table
    real(wp) :: time, radius

    time = huge(1.0_wp)
    if (.not. is_open(table%channel(gated)) .or. keeps_directions(table)) return
    radius = sqrt(maxval(table%urn(:table%sides)%area)/pi)
    time = 25.0_wp*radius*(radius/table%channel(gated)%width)**3
  end function relaxation_time

  !> Whether all urns are polygons that leave a particle a few directions (both the same ones: each
  !> has an upright side and so has the other), and no discs stand in channel 2.
  pure logical function keeps_directions(table)
    type(table_type), intent(in) :: table
    integer :: urn

    keeps_directions = .not. is_scattered(table)
    do urn = 1, table%sides
      if (.not. keeps_directions) return
      keeps_directions = table%urn(urn)%shape == shape_polygon
      if (keeps_directions) keeps_directions = directions_stay(table%urn(urn)%corner)
    end do
  end function keeps_directions

  !> The side of a point; the middle line belongs to side 2, if there is one.
  elemental function urn_at(table, x) result(urn)
    type(table_type), intent(in) :: table
    !> In the frame of the table, a length.
    real(wp), intent(in) :: x
    integer :: urn

    urn = merge(1, table%sides, x < 0.0_wp)
  end function urn_at

  !> Chamber that holds the point (x, y); a point on a chord belongs to the channel. `tolerance` is
  !> how far beyond a wall a point may lie.
  pure function chamber_at(table, x, y, tolerance) result(chamber)
    type(table_type), intent(in) :: table
    !> In the frame of the table, lengths.
    real(wp), intent(in) :: x, y, tolerance
    integer :: chamber

    chamber = outside
    associate (urn => table%urn(urn_at(table, x)))
      if (abs(x) <= urn%channel_start(gated)) then
        if (abs(y) <= urn%half_width(gated) + tolerance) chamber = in_gate
      else if (is_open(table%channel(ungated)) .and. abs(x) - urn%centre >= urn%chord(ungated)) then
        if (abs(y) <= urn%half_width(ungated) + tolerance .and. &
          abs(x) <= urn%periodic_line + tolerance) chamber = in_return
        if (is_in_scatterer(table%half_channel2(urn_at(table, x)), urn%periodic_line - abs(x), y, &
          tolerance)) chamber = outside
      else if (contains_point(urn, urn%centre - abs(x), y, tolerance)) then
        chamber = in_urn
      end if
      if (urn%overhangs .and. chamber /= in_urn) then
        ! Beside a channel, or beyond its end, there may be urn.
        if (abs(y) > urn%half_width(merge(gated, ungated, abs(x) <= urn%channel_start(gated))) &
          .and. contains_point(urn, urn%centre - abs(x), y, 0.0_wp)) chamber = in_urn
        if (chamber == outside .and. contains_point(urn, urn%centre - abs(x), y, tolerance)) &
          chamber = in_urn
      end if
    end associate
    if (table%sides == 1 .and. x > tolerance) chamber = outside
  end function chamber_at

  !> Where a particle of a channel came from its urn, or when it gets there. Passages that are
  !> slower than any run is long, and those with more wall hits than an integer can count, are taken
  !> for endless.
  pure function passage_at(table, x, y, ux, uy) result(passage)
    type(table_type), intent(in) :: table
    !> Place in the frame of the table, lengths; velocity, of length 1.
    real(wp), intent(in) :: x, y, ux, uy
    type(passage_type) :: passage
    real(wp), parameter :: most_hits = 4.0e18_wp
    real(wp) :: depth, outward

    passage%urn = urn_at(table, x)
    passage%chamber = chamber_at(table, x, y, huge(1.0_wp))
    if (passage%chamber == in_urn) return
    passage%channel = merge(ungated, gated, passage%chamber == in_return)
    associate (urn => table%urn(passage%urn), channel => table%channel(passage%channel))
      passage%endless = .not. abs(ux)*min(longest_run*urn%reach, most_hits*channel%width) &
        > channel%length
      if (passage%endless) return
      ! How far it is beyond the chord, and how fast it goes on from there.
      depth = urn%channel_start(gated) - abs(x)
      if (passage%channel == ungated) depth = abs(x) - urn%centre - urn%chord(ungated)
      outward = facing(passage%channel)*urn%axis_sign*ux
      passage%time = -depth/outward
      passage%inward = outward > 0.0_wp
      if (passage%inward) call fold_into_channel(y - uy*depth/outward, channel%width, &
        passage%height, passage%reflected, passage%hits)
    end associate
  end function passage_at

end module battery_table

!> Shared by the tests of the physics: tables, particles at given places, portable random numbers.
module scenes
  use battery_kinds, only: wp, int64
  use battery_urn, only: shape_polygon
  use battery_corners, only: regular_corners
  use battery_table, only: table_type, urn_type, channel_type, new_table, shape_circuit, &
    chamber_at, outside, in_urn
  use battery_engine, only: particles_type
  use battery_visits, only: visits_type, reserve_visits
  implicit none (type, external)
  private
  public :: table_3_4_5, uneven_table, unequal_table, paper_table, polygon_urn, polygon_table
  public :: draw, enter_urn
  public :: scatter, pick, mirrored_x, mirrored_y, reversed, of_particles, one_particle
  public :: count_in_first, same_bits, facing, channel_of

  !> Polygons: regular ones; with angles that are no rational multiples of a turn; with parts that
  !> reach inwards and over a channel; and a triangle without a vertical side on the left: its side
  !> on the axis begins at the opening, and the origin lies outside the triangle.
  integer, parameter, public :: hexagon = 1, decagon = 2, crooked = 3, re_entrant = 4, square = 5, &
    wedge = 6

  !> Draws the next random number, or the next few.
  interface draw
    procedure draw_one, draw_many
  end interface draw

contains

  !> Table whose chord 1 is a side of a right triangle with the sides 3, 4 and 5 in units of r/5.
  pure function table_3_4_5() result(table)
    type(table_type) :: table

    table = new_table(shape_circuit, 1.25_wp, 1.5_wp, 1.0_wp, 0.0_wp, 1.0_wp)
  end function table_3_4_5

  !> Table with five different lengths.
  pure function uneven_table() result(table)
    type(table_type) :: table

    table = new_table(shape_circuit, 1.25_wp, 0.7_wp, 1.5_wp, 0.4_wp, 0.75_wp)
  end function uneven_table

  !> The same with urns of unequal radius.
  pure function unequal_table() result(table)
    type(table_type) :: table

    table = new_table(shape_circuit, [urn_type(radius=1.25_wp), urn_type(radius=0.75_wp)], &
      [channel_type(0.7_wp, 1.5_wp), channel_type(0.4_wp, 0.75_wp)])
  end function unequal_table

  !> Table of the paper's figures with w = 0.3 and w' = 0.01.
  pure function paper_table() result(table)
    type(table_type) :: table

    table = new_table(shape_circuit, 1.0_wp, 0.3_wp, 1.0_wp, 0.01_wp, 1.0_wp)
  end function paper_table

  !> One of the polygons, as an urn without openings.
  pure function polygon_urn(kind) result(urn)
    !> `hexagon`, `decagon`, ...
    integer, intent(in) :: kind
    type(urn_type) :: urn

    urn%shape = shape_polygon
    select case (kind)
    case (hexagon)
      urn%corner = regular_corners(6, 1.25_wp)
    case (decagon)
      urn%corner = regular_corners(10, 1.5_wp)
    case (square)
      urn%corner = regular_corners(4, sqrt(2.0_wp))
    case (crooked)
      urn%corner = reshape([0.9_wp, -0.5_wp, 0.9_wp, 0.6_wp, 0.1_wp, 1.1_wp, -0.95_wp, 0.55_wp, &
        -0.95_wp, -0.45_wp, -0.2_wp, -1.2_wp], [2, 6])
    case (wedge)
      urn%corner = reshape([-1.0_wp, -0.7_wp, 1.0_wp, -0.6_wp, 1.0_wp, 0.6_wp], [2, 3])
    case default
      urn%corner = reshape([1.0_wp, -0.6_wp, 1.0_wp, 0.6_wp, 1.4_wp, 0.7_wp, 1.3_wp, 1.2_wp, &
        -0.5_wp, 1.1_wp, -0.6_wp, 0.3_wp, -1.0_wp, 0.9_wp, -1.2_wp, 0.5_wp, -1.2_wp, -0.5_wp, &
        -0.3_wp, -1.0_wp, 0.2_wp, -0.4_wp, 0.7_wp, -1.1_wp], [2, 12])
    end select
  end function polygon_urn

  !> Uneven table with polygons as urns.
  pure function polygon_table(first, second) result(table)
    integer, intent(in) :: first, second
    type(table_type) :: table

    table = new_table(shape_circuit, [polygon_urn(first), polygon_urn(second)], &
      [channel_type(0.7_wp, 1.5_wp), channel_type(0.4_wp, 0.75_wp)])
  end function polygon_table

  !> Next number in (0, 1) with 53 bits, from two steps of the multiplicative generator of Park and
  !> Miller with the multiplier 48271. The state begins with any integer from 1 to 2147483646.
  subroutine draw_one(state, number)
    integer(int64), intent(inout) :: state
    real(wp), intent(out) :: number
    integer(int64), parameter :: modulus = 2147483647_int64
    integer(int64) :: high

    high = modulo(48271_int64*state, modulus)
    state = modulo(48271_int64*high, modulus)
    number = (real(high - 1, wp) + real(state, wp)/real(modulus, wp))/real(modulus - 1, wp)
  end subroutine draw_one

  subroutine draw_many(state, numbers)
    integer(int64), intent(inout) :: state
    real(wp), intent(out) :: numbers(:)
    integer :: i

    do i = 1, size(numbers)
      call draw_one(state, numbers(i))
    end do
  end subroutine draw_many

  !> Makes `number` visits that enter an urn by the cosine law, uniformly over its openings.
  subroutine enter_urn(urn, number, seed, visits)
    type(urn_type), intent(in) :: urn
    integer, intent(in) :: number, seed
    type(visits_type), intent(inout) :: visits
    integer(int64) :: state
    real(wp) :: a(2), place, sine
    integer :: i, from

    state = seed
    call reserve_visits(visits, number)
    visits%count = number
    do i = 1, number
      call draw(state, a)
      place = a(1)*sum(urn%width)
      from = merge(1, 2, place < urn%width(1))
      if (from == 2) place = place - urn%width(1)
      sine = 2.0_wp*a(2) - 1.0_wp
      visits%channel(i) = from
      visits%x(i) = (3 - 2*from)*urn%chord(from)
      visits%y(i) = place - urn%half_width(from)
      visits%u_axial(i) = (2*from - 3)*sqrt((1.0_wp - sine)*(1.0_wp + sine))
      visits%u_lateral(i) = sine
      visits%hits(i) = 0.0_wp
    end do
  end subroutine enter_urn

  !> Makes `number` particles with random directions, uniform in the table (`everywhere`) or in its
  !> urns.
  subroutine scatter(table, number, seed, everywhere, particles)
    type(table_type), intent(in) :: table
    integer, intent(in) :: number, seed
    logical, intent(in) :: everywhere
    type(particles_type), intent(out) :: particles
    integer(int64) :: state
    integer :: i, chamber
    real(wp) :: a, b, height

    state = 1 + modulo(7919_int64*int(seed, int64), 2147483646_int64)
    particles = of_particles(spread(0.0_wp, 1, number))
    height = maxval(table%urn%reach)
    do i = 1, number
      do
        call draw(state, a)
        call draw(state, b)
        particles%x(i) = (2.0_wp*a - 1.0_wp)*maxval(table%urn%periodic_line)
        particles%y(i) = (2.0_wp*b - 1.0_wp)*height
        chamber = chamber_at(table, particles%x(i), particles%y(i), 0.0_wp)
        if (everywhere .and. chamber /= outside) exit
        if (chamber == in_urn) exit
      end do
      call draw(state, a)
      a = 8.0_wp*atan(1.0_wp)*a
      particles%ux(i) = cos(a)
      particles%uy(i) = sin(a)
    end do
  end subroutine scatter

  !> Particles on the axis at x that move to the right; y, ux and uy can be changed afterwards.
  pure function of_particles(x) result(particles)
    real(wp), intent(in) :: x(:)
    type(particles_type) :: particles
    integer :: i

    particles%x = x
    particles%y = [(0.0_wp, i=1, size(x))]
    particles%ux = [(1.0_wp, i=1, size(x))]
    particles%uy = particles%y
  end function of_particles

  pure function one_particle(x, y, ux, uy) result(particles)
    real(wp), intent(in) :: x, y, ux, uy
    type(particles_type) :: particles

    particles%x = [x]
    particles%y = [y]
    particles%ux = [ux]
    particles%uy = [uy]
  end function one_particle

  !> The particles with the indices `order`, in that order.
  pure function pick(particles, order) result(picked)
    type(particles_type), intent(in) :: particles
    integer, intent(in) :: order(:)
    type(particles_type) :: picked

    picked%x = particles%x(order)
    picked%y = particles%y(order)
    picked%ux = particles%ux(order)
    picked%uy = particles%uy(order)
  end function pick

  pure function mirrored_x(particles) result(mirrored)
    type(particles_type), intent(in) :: particles
    type(particles_type) :: mirrored

    mirrored = particles
    mirrored%x = -particles%x
    mirrored%ux = -particles%ux
  end function mirrored_x

  pure function mirrored_y(particles) result(mirrored)
    type(particles_type), intent(in) :: particles
    type(particles_type) :: mirrored

    mirrored = particles
    mirrored%y = -particles%y
    mirrored%uy = -particles%uy
  end function mirrored_y

  !> The same positions with all velocities reversed.
  pure function reversed(particles) result(back)
    type(particles_type), intent(in) :: particles
    type(particles_type) :: back

    back = particles
    back%ux = -particles%ux
    back%uy = -particles%uy
  end function reversed

  !> N1: number of particles in the left half of the table.
  pure integer function count_in_first(particles)
    type(particles_type), intent(in) :: particles

    count_in_first = count(particles%x < 0.0_wp)
  end function count_in_first

  !> Whether two numbers agree in all bits, except for the sign of a zero.
  elemental logical function same_bits(a, b)
    real(wp), intent(in) :: a, b

    same_bits = a <= b .and. a >= b
  end function same_bits

  !> Direction along x to a channel, in the frame of an urn; 0 for none.
  elemental function facing(channel) result(direction)
    integer(int64), intent(in) :: channel
    real(wp) :: direction

    direction = merge(1.0_wp, merge(-1.0_wp, 0.0_wp, channel == 2), channel == 1)
  end function facing

  !> Channel in the direction 1 or -1 along x, in the frame of an urn.
  elemental function channel_of(direction) result(channel)
    real(wp), intent(in) :: direction
    integer(int64) :: channel

    channel = merge(1_int64, 2_int64, direction > 0.0_wp)
  end function channel_of

end module scenes

!> Tables on which the laws of all engines are tested: single urns, and circuits of equal and of
!> unequal urns with channel 2 open, closed or with discs in it. Urns are discs or polygons. Each
!> table has its mirror images.
module law_tables
  use battery_kinds, only: wp
  use battery_table, only: table_type, urn_type, channel_type, new_table, shape_circuit, shape_urn
  use battery_engine, only: engine_type, particles_type
  use battery_engines, only: new_engine
  use battery_error, only: error_type
  use scenes, only: polygon_urn, hexagon, decagon, crooked, re_entrant, square, wedge, mirrored_x, &
    mirrored_y
  implicit none (type, external)
  private
  public :: law_table, image_of, reason_unsupported

  !> The tables, in the order of the cases of `law_table`. Urns are discs in those up to `dense`.
  integer, parameter, public :: uneven = 1, unequal = 2, closed = 3, single = 4, paper = 5, &
    closed_small = 6, closed_wide = 7, dense = 8, discs = 9, touching_discs = 10, polygons = 11, &
    polygons_discs = 12, closed_wedge = 13, closed_crooked = 14, single_hexagon = 15, &
    single_wedge = 16, single_re_entrant = 17, hexagons = 18, decagon_crooked = 19, &
    re_entrant_square = 20
  integer, parameter, public :: tables = 20
  !> Beyond them: both channels almost as wide as the urns, or channel 1 within 1e-9.
  integer, parameter, public :: wide = 21, widest = 22

  !> Images of a table: the table itself, mirrored at its middle line, mirrored at its axis.
  integer, parameter, public :: as_it_is = 0, left_right = 1, up_down = 2

  !> z, y, radius of discs in channel 2; the first lies on the periodic line.
  real(wp), parameter :: three_discs(3, 3) = reshape([0.0_wp, 0.1_wp, 0.05_wp, 0.2_wp, -0.15_wp, &
    0.1_wp, -0.2_wp, 0.05_wp, 0.1_wp], [3, 3])

  !> Discs on the periodic line, across a wall, within 1e-9 of a wall, and apart.
  real(wp), parameter :: five_discs(3, 5) = reshape([0.03_wp, 0.02_wp, 0.07_wp, -0.2_wp, 0.19_wp, &
    0.06_wp, 0.18_wp, -0.1_wp + 1.0e-9_wp, 0.1_wp, -0.17_wp, -0.08_wp, 0.05_wp, 0.2_wp, 0.1_wp, &
    0.04_wp], [3, 5])

contains

  !> A table and thresholds for its gates.
  pure subroutine law_table(which, table, threshold, image)
    integer, intent(in) :: which
    type(table_type), intent(out) :: table
    integer, intent(out), optional :: threshold(2)
    !> One of the images, by default `as_it_is`. A single urn is on the left in all images.
    integer, intent(in), optional :: image
    type(urn_type) :: urn(2)
    type(channel_type) :: channel(2)
    real(wp), allocatable :: scatterers(:, :)
    integer :: most(2), shape

    shape = shape_circuit
    urn = [urn_type(radius=1.25_wp), urn_type(radius=1.25_wp)]
    channel = [channel_type(0.7_wp, 1.5_wp), channel_type(0.4_wp, 0.75_wp)]
    allocate (scatterers(3, 0))
    most = 3
    select case (which)
    case (unequal)
      urn(2)%radius = 0.75_wp
      most = [2, 5]
    case (closed)
      urn%radius = 1.0_wp
      channel = [channel_type(0.5_wp, 1.0_wp), channel_type(0.0_wp, 1.0_wp)]
    case (single)
      shape = shape_urn
    case (paper)
      urn%radius = 1.0_wp
      channel = [channel_type(0.3_wp, 1.0_wp), channel_type(0.01_wp, 1.0_wp)]
      most = 1
    case (closed_small)
      urn%radius = 0.8_wp
      channel = [channel_type(0.5_wp, 1.5_wp), channel_type(0.0_wp, 1.0_wp)]
    case (closed_wide)
      channel = [channel_type(1.5_wp, 1.0_wp), channel_type(0.0_wp, 1.0_wp)]
    case (wide)
      urn%radius = 1.0_wp
      channel = [channel_type(1.999_wp, 0.5_wp), channel_type(1.9_wp, 0.7_wp)]
    case (widest)
      urn%radius = 1.0_wp
      channel = [channel_type(2.0_wp - 1.0e-9_wp, 0.5_wp), channel_type(0.0_wp, 0.7_wp)]
    case (dense)
      urn%radius = 1.0_wp
      channel = [channel_type(1.2_wp, 3.0_wp), channel_type(0.1_wp, 0.1_wp)]
    case (discs)
      urn(2)%radius = 0.75_wp
      scatterers = three_discs
    case (touching_discs)
      urn(2)%radius = 0.75_wp
      channel(1)%width = 0.5_wp
      scatterers = five_discs
      most = 2
    case (polygons)
      urn = [polygon_urn(crooked), polygon_urn(re_entrant)]
      most = [2, 5]
    case (polygons_discs)
      urn = [polygon_urn(crooked), polygon_urn(re_entrant)]
      scatterers = three_discs
    case (closed_wedge)
      urn = [polygon_urn(wedge), polygon_urn(crooked)]
      channel(2)%width = 0.0_wp
      most = [2, 5]
    case (closed_crooked)
      urn = [polygon_urn(re_entrant), polygon_urn(wedge)]
      channel(2)%width = 0.0_wp
      most = [2, 5]
    case (single_hexagon, single_wedge, single_re_entrant)
      shape = shape_urn
      urn = polygon_urn(merge(hexagon, merge(wedge, re_entrant, which == single_wedge), &
        which == single_hexagon))
    case (hexagons)
      urn = polygon_urn(hexagon)
    case (decagon_crooked)
      urn = [polygon_urn(decagon), polygon_urn(crooked)]
    case (re_entrant_square)
      urn = [polygon_urn(re_entrant), polygon_urn(square)]
    case default
      continue
    end select
    if (present(image)) then
      if (image == left_right .and. shape == shape_circuit) then
        urn = urn([2, 1])
        most = most([2, 1])
        scatterers(1, :) = -scatterers(1, :)
      else if (image == up_down) then
        call turn_upside_down(urn(1))
        call turn_upside_down(urn(2))
        scatterers(2, :) = -scatterers(2, :)
      end if
    end if
    table = new_table(shape, urn, channel, scatterers)
    if (present(threshold)) threshold = most
  end subroutine law_table

  !> Corners of the mirror image, again counter-clockwise.
  pure subroutine turn_upside_down(urn)
    type(urn_type), intent(inout) :: urn

    if (.not. allocated(urn%corner)) return
    urn%corner = urn%corner(:, size(urn%corner, 2):1:-1)
    urn%corner(2, :) = -urn%corner(2, :)
  end subroutine turn_upside_down

  !> Particles in the mirror image of a table.
  pure function image_of(particles, image) result(mirrored)
    type(particles_type), intent(in) :: particles
    integer, intent(in) :: image
    type(particles_type) :: mirrored

    mirrored = particles
    if (image == left_right) mirrored = mirrored_x(particles)
    if (image == up_down) mirrored = mirrored_y(particles)
  end function image_of

  !> Whether an engine can simulate a table; with a step of 0.01, if it has one.
  function reason_unsupported(name, table)
    character(len=*), intent(in) :: name
    type(table_type), intent(in) :: table
    logical :: reason_unsupported
    class(engine_type), allocatable :: engine
    type(error_type), allocatable :: error

    call new_engine(trim(name), engine, error)
    engine%time_step = 0.01_wp
    reason_unsupported = engine%reason_unsupported(table) == ''
  end function reason_unsupported

end module law_tables

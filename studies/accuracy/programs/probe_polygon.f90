!> Urns that are polygons, for the probe of visits, and how close a path passes to a corner, over
!> the condition number of the position there: (length of the path + reach of the polygon)(1 + 2
!> wall hits), see `studies/common/visits.py`.
module battery_probe_polygon
  use battery_kinds, only: wp
  use battery_channel, only: channel_type, channel1, channel2, facing
  use battery_corners, only: distance_to_side
  use battery_polygon, only: urn_shape_type, find_next_side_robustly, reflect_from_side
  use battery_table, only: table_type, new_table, shape_circuit, urn_type
  use battery_urn, only: shape_polygon
  use battery_probe, only: rounded_to_bits, stop_with_message
  implicit none (type, external)
  private
  public :: polygon_table, least_corner_distance

contains

  !> A circuit of two polygons that are mirror images, with channels of length 1.
  function polygon_table(corners, bits, width) result(table)
    !> Corners as one word x1,y1,x2,y2,...
    character(len=*), intent(in) :: corners
    !> Bits to which they are rounded.
    integer, intent(in) :: bits
    !> By channel.
    real(wp), intent(in) :: width(2)
    type(table_type) :: table
    type(urn_type) :: urn
    real(wp), allocatable :: numbers(:)
    integer :: k, status

    allocate (numbers(1 + count([(corners(k:k) == ',', k=1, len(corners))])))
    read (corners, *, iostat=status) numbers
    if (status /= 0 .or. size(numbers) < 6 .or. modulo(size(numbers), 2) /= 0) &
      call stop_with_message('the urn is disc, or corners x1,y1,x2,y2,...')
    urn%shape = shape_polygon
    urn%corner = reshape(rounded_to_bits(numbers, bits), [2, size(numbers)/2])
    table = new_table(shape_circuit, [urn, urn], [channel_type(width(channel1), 1.0_wp), &
      channel_type(width(channel2), 1.0_wp)])
    if (.not. table%urn(1)%fits) call &
      stop_with_message('where the axis leaves the urn it must be '//'upright, and wide enough')
  end function polygon_table

  !> Least distance of the path of a passage from a corner or from the end of an opening, divided by
  !> the condition number of the position there.
  function least_corner_distance(urn, x, y, ux, uy, most_hits) result(distance)
    type(urn_shape_type), intent(in) :: urn
    !> Start of the passage, in the frame of the polygon.
    real(wp), intent(in) :: x, y, ux, uy
    !> The path is followed for at most this number of wall hits, and over the flight after them.
    integer, intent(in) :: most_hits
    real(wp) :: distance
    real(wp) :: position(2), next(2), velocity(2), wait, length
    integer :: side, hits

    position = [x, y]
    velocity = [ux, uy]
    side = 0
    length = 0.0_wp
    distance = huge(1.0_wp)
    do hits = 0, most_hits
      call find_next_side_robustly(urn%polygon, (side), position(1), position(2), velocity(1), &
        velocity(2), side, wait)
      if (side == 0) return
      next = position + wait*velocity
      length = length + wait
      distance = min(distance, distance_to_corners(urn, position, next)/((length &
        + urn%reach)*(1.0_wp + 2.0_wp*hits)))
      if (abs(next(2)) < urn%polygon%half_opening(side)) return
      position = next
      call reflect_from_side(urn%polygon, side, position(1), position(2), velocity(1), velocity(2))
    end do
  end function least_corner_distance

  !> Distance from a straight path to the nearest corner or end of an opening.
  pure function distance_to_corners(urn, path_start, path_end) result(distance)
    type(urn_shape_type), intent(in) :: urn
    !> Ends of the path, (x, y).
    real(wp), intent(in) :: path_start(2), path_end(2)
    real(wp) :: distance
    integer :: k, sign_y

    distance = huge(1.0_wp)
    do k = 1, urn%polygon%sides
      distance = min(distance, distance_to_side(urn%polygon%x(k), urn%polygon%y(k), path_start, &
        path_end))
    end do
    do k = 1, 2
      do sign_y = -1, 1, 2
        distance = min(distance, distance_to_side(facing(k)*urn%chord(k), &
          sign_y*urn%half_width(k), path_start, path_end))
      end do
    end do
  end function distance_to_corners

end module battery_probe_polygon

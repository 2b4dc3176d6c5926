!> Probe of single passages through an urn, called visits here: computes random ones in one
!> precision, for a comparison with the same ones in another (`studies/common/visits.py`).
module battery_probe_visits
  use battery_kinds, only: wp, dp, int64
  use battery_text, only: to_text
  use battery_table, only: table_type, channel1, channel2
  use battery_random, only: hashed_uniform
  use battery_sampling, only: entry_of
  use battery_urn, only: compute_passages, shape_polygon
  use battery_visits, only: visits_type, reserve_visits
  use battery_probe, only: argument, real_argument, integer_argument, rounded_to_bits, &
    paper_table, print_json_line, stop_with_message
  use battery_probe_polygon, only: polygon_table, least_corner_distance
  implicit none (type, external)
  private
  public :: visits_main

  !> Number of visits that are computed together.
  integer, parameter :: chunk = 4096
  !> Number of values of a visit in the file: opening (1, -1, or 0 if the visit was truncated), y,
  !> |u_x|, u_y, length, wall hits; opening and u_y of the entry; in polygons in quadruple precision
  !> the least distance from a corner over the condition number there, else 0.
  integer, parameter :: numbers = 9

contains

  !> `visits URN WIDTH1 WIDTH2 COUNT INPUT_BITS FILE`: computes visits whose starts are numbers of
  !> INPUT_BITS bits, and writes them to FILE. URN is `disc`, or the corners of a polygon as one
  !> word x1,y1,x2,y2,...
  subroutine visits_main()
    type(table_type) :: table
    real(dp), allocatable :: computed(:, :)
    real(wp) :: width(2)
    integer(int64) :: count, first, next, bytes
    integer :: bits, n, file, status

    bits = int(integer_argument(6))
    width = [rounded_to_bits(real_argument(3), bits), rounded_to_bits(real_argument(4), bits)]
    if (argument(2) == 'disc') then
      table = paper_table(width(1), width(2))
    else
      table = polygon_table(argument(2), bits, width)
    end if
    count = integer_argument(5)
    open (newunit=file, file=argument(7), access='stream', form='unformatted', status='replace')
    do first = 0, count - 1, chunk
      n = int(min(int(chunk, int64), count - first))
      allocate (computed(numbers, n))
      call compute_drawn_visits(table, first, n, bits, computed)
      write (file) computed
      deallocate (computed)
    end do
    ! Fortran's own `close` may not report that the last bytes could not be written.
    inquire (unit=file, pos=next)
    close (file, iostat=status)
    inquire (file=argument(7), size=bytes)
    if (status /= 0 .or. bytes /= next - 1) call stop_with_message('only '//to_text(bytes) &
      //' of '//to_text(next - 1)//' bytes are in '//argument(7)//': is the disk full?')
    call print_json_line('{"visits": '//to_text(count)//'}')
  end subroutine visits_main

  !> Computes the visits `first` + 1 ... `first` + n.
  subroutine compute_drawn_visits(table, first, n, bits, found)
    type(table_type), intent(in) :: table
    integer(int64), intent(in) :: first
    integer, intent(in) :: n, bits
    !> By visit: the values that are written to the file.
    real(dp), intent(out) :: found(numbers, n)
    type(visits_type) :: visits
    real(wp) :: x, y, ux, uy, corner
    integer(int64) :: channel
    integer :: j

    call reserve_visits(visits, n)
    visits%count = n
    do j = 1, n
      visits%particle(j) = j
      visits%urn(j) = 1
      visits%time(j) = 0.0_wp
      visits%passage(j) = 0.0_wp
      visits%hits(j) = 0.0_wp
      call draw_entrance(table, first + j, bits, visits%channel(j), visits%x(j), visits%y(j), &
        visits%u_axial(j), visits%u_lateral(j))
    end do
    call compute_passages(table%urn(1), visits)
    do j = 1, n
      call draw_entrance(table, first + j, bits, channel, x, y, ux, uy)
      corner = 0.0_wp
      if (table%urn(1)%shape == shape_polygon .and. storage_size(1.0_wp) == 128) &
        corner = least_corner_distance(table%urn(1)%urn_shape_type, x, y, ux, uy, &
          nint(visits%hits(j)))
      found(:, j) = real([opening_sign(visits%channel(j)), visits%y(j), visits%u_axial(j), &
        visits%u_lateral(j), visits%length(j), visits%hits(j), opening_sign(channel), uy, corner], &
        dp)
    end do
  end subroutine compute_drawn_visits

  !> Start of visit number `k`, in the frame of the urn.
  subroutine draw_entrance(table, k, bits, channel, x, y, ux, uy)
    type(table_type), intent(in) :: table
    integer(int64), intent(in) :: k
    integer, intent(in) :: bits
    integer(int64), intent(out) :: channel
    real(wp), intent(out) :: x, y, ux, uy

    call entry_of(table, 1, rounded_uniform(k, 1_int64, bits), rounded_uniform(k, 2_int64, bits), &
      channel, x, y, ux, uy)
  end subroutine draw_entrance

  !> Sign of the opening through which a visit ends, as in the file.
  elemental function opening_sign(channel) result(sign)
    integer(int64), intent(in) :: channel
    real(wp) :: sign

    sign = merge(1.0_wp, -1.0_wp, channel == channel1)
    if (channel /= channel1 .and. channel /= channel2) sign = 0.0_wp
  end function opening_sign

  !> A random number, uniform in (0, 1), that all precisions with more bits than `bits` represent
  !> exactly.
  elemental function rounded_uniform(visit, draw, bits) result(number)
    !> Number of the visit, and of the draw within it.
    integer(int64), intent(in) :: visit, draw
    integer, intent(in) :: bits
    real(wp) :: number

    number = (aint(hashed_uniform(visit, draw)*2.0_wp**bits) + 0.5_wp)*0.5_wp**bits
  end function rounded_uniform

end module battery_probe_visits

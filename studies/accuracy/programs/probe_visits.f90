!> Probe of single passages through an urn, called visits here: computes random ones in one
!> precision, and compares them with the same ones in another.
!>
!> The start of a visit determines its end, whose sensitivity grows with the length of the visit. To
!> first order, a change of the start by eps changes the direction at the end by K_u eps, the height
!> by K_y eps, and the length by K_l eps. The condition numbers are, with n the number of wall hits,
!> s and c the sine and cosine of the incidence, q and u position and direction at the end:
!>   K_u = 1 + 2 n/c,  K_y = (|q.u| K_u + r)/|u_x|,  K_l = 2 r (n |s|/c + 1) + r K_u + |u_y| K_y.
!> (`battery_probe_polygon` has those of polygons.) The errors of a visit divided by its condition
!> numbers are compared with the precision. Visits that end at another wall hit than the reference
!> are of two kinds: those that pass so close to a corner that a change of the start by
!> `corner_tolerance` rounding errors decides at which side of it they pass, and those that are
!> wrong.
module battery_probe_visits
  use battery_kinds, only: wp, dp, int64
  use battery_error, only: error_type
  use battery_file_text, only: close_written
  use battery_text, only: to_text
  use battery_table, only: table_type, channel1, channel2
  use battery_random, only: hashed_uniform
  use battery_sampling, only: entry_of
  use battery_urn, only: compute_passages, shape_polygon
  use battery_visits, only: visits_type, reserve_visits
  use battery_probe, only: argument, real_argument, integer_argument, rounded_to_bits, &
    precision_name, paper_table, print_json_line, stop_with_message, processor_seconds
  use battery_probe_polygon, only: polygon_table, polygon_conditions, polygon_tolerance, &
    least_corner_distance
  implicit none (type, external)
  private
  public :: visits_main

  !> Number of visits that are computed together.
  integer, parameter :: chunk = 4096
  !> Number of values of a visit in the file: opening (1, -1, or 0 if the visit was truncated), y,
  !> |u_x|, u_y, length, wall hits.
  integer, parameter :: numbers = 6
  !> Tolerance for a tie at a corner of a disc, in units of the change of the start.
  real(wp), parameter :: corner_tolerance = 8.0_wp
  !> Number of bins in the histogram of errors: each is a tenth of the decimal logarithm, from
  !> 10**-40 to 1.
  integer, parameter :: bins = 400

  !> Comparison of visits in two precisions.
  type :: comparison_type
    !> Number of visits: with the same end; with another end, near a corner; with another end,
    !> wrong; truncated in both precisions.
    integer(int64) :: same = 0, corner = 0, wrong = 0, truncated = 0
    !> Visits with another end: greatest distance from a corner, divided by the condition number of
    !> the position and by the precision.
    real(wp) :: farthest = 0.0_wp
    !> Visits with the same end: greatest error divided by its condition number; greatest condition
    !> number.
    real(wp) :: worst = 0.0_wp, condition = 0.0_wp
    !> The same greatest error for each of height, direction and length.
    real(wp) :: worst_errors(3) = 0.0_wp
    integer(int64) :: histogram(bins) = 0
  end type comparison_type

contains

  !> `visits URN WIDTH1 WIDTH2 COUNT INPUT_BITS FILE [OTHER]`: computes visits whose starts are
  !> numbers of INPUT_BITS bits, and writes them to FILE; prints a comparison with OTHER, the FILE
  !> of the same visits in another precision. URN is `disc`, or the corners of a polygon as one word
  !> x1,y1,x2,y2,...
  subroutine visits_main()
    type(table_type) :: table
    type(comparison_type) :: comparison
    real(dp), allocatable :: computed(:, :), other(:, :)
    real(dp) :: began, spent
    real(wp) :: unit_error, width(2)
    integer(int64) :: count, first
    integer :: bits, n, file, other_file
    logical :: comparing
    type(error_type), allocatable :: error

    bits = int(integer_argument(6))
    width = [rounded_to_bits(real_argument(3), bits), rounded_to_bits(real_argument(4), bits)]
    if (argument(2) == 'disc') then
      table = paper_table(width(1), width(2))
    else
      table = polygon_table(argument(2), bits, width)
    end if
    count = integer_argument(5)
    open (newunit=file, file=argument(7), access='stream', form='unformatted', status='replace')
    comparing = argument(8) /= ''
    if (comparing) open (newunit=other_file, file=argument(8), access='stream', &
      form='unformatted', status='old', action='read')
    unit_error = 0.5_wp**(bits + 1)
    spent = 0.0_dp
    do first = 0, count - 1, chunk
      n = int(min(int(chunk, int64), count - first))
      allocate (computed(numbers, n), other(numbers, n))
      began = processor_seconds()
      call compute_drawn_visits(table, first, n, bits, computed)
      spent = spent + (processor_seconds() - began)
      write (file) computed
      if (comparing) then
        read (other_file) other
        call compare_visits(table, first, bits, unit_error, computed, other, comparison)
      end if
      deallocate (computed, other)
    end do
    call close_written(file, argument(7), error)
    if (allocated(error)) call stop_with_message(error%message)
    call print_summary(comparison, count, bits, table, spent, comparing)
  end subroutine visits_main

  !> Computes the visits `first` + 1 ... `first` + n.
  subroutine compute_drawn_visits(table, first, n, bits, found)
    type(table_type), intent(in) :: table
    integer(int64), intent(in) :: first
    integer, intent(in) :: n, bits
    !> By visit: the values that are written to the file.
    real(dp), intent(out) :: found(numbers, n)
    type(visits_type) :: visits
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
      found(:, j) = real([opening_sign(visits%channel(j)), visits%y(j), &
        visits%u_axial(j), visits%u_lateral(j), visits%length(j), visits%hits(j)], dp)
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

  !> Adds visits to a comparison: `computed`, which is the reference, and `other`.
  subroutine compare_visits(table, first, bits, unit_error, computed, other, comparison)
    type(table_type), intent(in) :: table
    !> Number of the visit before the first of them.
    integer(int64), intent(in) :: first
    !> Bits of their starts.
    integer, intent(in) :: bits
    !> Change of the start: half a unit of its last bit.
    real(wp), intent(in) :: unit_error
    !> Values of the file, by (value, visit).
    real(dp), intent(in) :: computed(:, :), other(:, :)
    type(comparison_type), intent(inout) :: comparison
    real(wp) :: k(3), error(3), distance, tolerance
    integer :: j, bin
    logical :: same

    tolerance = merge(polygon_tolerance, corner_tolerance, table%urn(1)%shape == shape_polygon)
    do j = 1, size(computed, 2)
      if (nint(computed(1, j)) == 0 .and. nint(other(1, j)) == 0) then
        comparison%truncated = comparison%truncated + 1
        cycle
      end if
      same = nint(computed(1, j)) == nint(other(1, j)) &
        .and. nint(computed(6, j), int64) == nint(other(6, j), int64)
      if (same) then
        k = visit_conditions(table, computed(:, j))
        error = abs([real(computed(2, j), wp) - other(2, j), hypot(real(computed(3, j), wp) &
          - other(3, j), real(computed(4, j), wp) - other(4, j)), real(computed(5, j), wp) &
          - other(5, j)])/k
        if (.not. all(error < 1.0_wp)) call &
          stop_with_message('a visit is not a number, or wrong at all')
        comparison%same = comparison%same + 1
        comparison%worst_errors = max(comparison%worst_errors, error)
        comparison%worst = max(comparison%worst, maxval(error))
        comparison%condition = max(comparison%condition, maxval(k))
        bin = bins + floor(10.0_wp*log10(max(maxval(error), 1.0e-37_wp)))
        comparison%histogram(max(bin, 1)) = comparison%histogram(max(bin, 1)) + 1
      else
        distance = corner_distance(table, first + j, bits, computed(:, j), other(:, j))/unit_error
        comparison%farthest = max(comparison%farthest, distance)
        if (distance <= tolerance) then
          comparison%corner = comparison%corner + 1
        else
          comparison%wrong = comparison%wrong + 1
        end if
      end if
    end do
  end subroutine compare_visits

  !> Condition numbers of the height, the direction and the length at the end of a visit.
  function visit_conditions(table, visit) result(k)
    type(table_type), intent(in) :: table
    !> Values of the visit in the file.
    real(dp), intent(in) :: visit(numbers)
    real(wp) :: k(3)
    real(wp) :: x, y, ux, uy, s, c, n, radius

    if (table%urn(1)%shape == shape_polygon) then
      k = polygon_conditions(table%urn(1)%polygon, real(visit(5), wp), real(visit(6), wp), &
        real(visit(3), wp), real(visit(4), wp))
      return
    end if
    radius = table%urn(1)%radius
    x = merge(table%urn(1)%chord(1), -table%urn(1)%chord(2), visit(1) > 0.0_dp)
    y = visit(2)
    ux = visit(1)*visit(3)
    uy = visit(4)
    n = visit(6)
    s = (x*uy - y*ux)/radius
    c = max(sqrt(max((1.0_wp - s)*(1.0_wp + s), 0.0_wp)), epsilon(1.0_wp))
    k(2) = 1.0_wp + 2.0_wp*n/c
    k(1) = (abs(x*ux + y*uy)*k(2) + radius)/abs(ux)
    k(3) = 2.0_wp*radius*(n*abs(s)/c + 1.0_wp) + radius*k(2) + abs(uy)*k(1)
  end function visit_conditions

  !> Distance from a corner of the visit with fewer wall hits, divided by its condition number.
  function corner_distance(table, number, bits, computed, other) result(distance)
    type(table_type), intent(in) :: table
    !> Number of the visit; bits of its start; its values in both precisions.
    integer(int64), intent(in) :: number
    integer, intent(in) :: bits
    real(dp), intent(in) :: computed(numbers), other(numbers)
    real(wp) :: distance, k(3), x, y, ux, uy
    real(dp) :: first(numbers)
    integer(int64) :: channel

    if (table%urn(1)%shape == shape_polygon) then
      call draw_entrance(table, number, bits, channel, x, y, ux, uy)
      distance = least_corner_distance(table%urn(1)%polygon, x, y, ux, uy, nint(computed(6)))
      return
    end if
    first = computed
    if (other(6) < computed(6)) first = other
    k = visit_conditions(table, first)
    distance = (0.5_wp*merge(table%channel(1)%width, table%channel(2)%width, first(1) > 0.0_dp) &
      - abs(first(2)))/k(1)
  end function corner_distance

  !> Prints the line of the probe, with the comparison if there is one.
  subroutine print_summary(comparison, count, bits, table, spent, comparing)
    type(comparison_type), intent(in) :: comparison
    integer(int64), intent(in) :: count
    integer, intent(in) :: bits
    type(table_type), intent(in) :: table
    real(dp), intent(in) :: spent
    logical, intent(in) :: comparing
    character(len=:), allocatable :: text
    integer :: k

    text = '{"precision": "'//precision_name()//'", "visits": '//to_text(count)// &
      ', "input_bits": '//to_text(bits)//', "channel1_width": ' &
      //to_text(real(table%channel(1)%width, dp))//', "channel2_width": ' &
      //to_text(real(table%channel(2)%width, dp))//', "seconds_per_visit": '//to_text(spent/count)
    if (comparing) then
      text = text//', "same": '//to_text(comparison%same) &
        //', "corner": '//to_text(comparison%corner) &
        //', "wrong": '//to_text(comparison%wrong) &
        //', "handed_on": '//to_text(comparison%truncated) &
        //', "farthest": '//to_text(real(comparison%farthest, dp)) &
        //', "worst": '//to_text(real(comparison%worst, dp)) &
        //', "worst_place": '//to_text(real(comparison%worst_errors(1), dp)) &
        //', "worst_direction": '//to_text(real(comparison%worst_errors(2), dp)) &
        //', "worst_time": '//to_text(real(comparison%worst_errors(3), dp)) &
        //', "greatest_condition": '//to_text(real(comparison%condition, dp))//', "histogram": ['
      do k = 1, bins
        if (k > 1) text = text//','
        text = text//to_text(comparison%histogram(k))
      end do
      text = text//']'
    end if
    call print_json_line(text//'}')
  end subroutine print_summary

end module battery_probe_visits

!> Brute-force reference for tables with polygons: all walls as one list of straight pieces, and
!> each particle flown from piece to piece. Gates reverse nobody.
!>
!> On which side a path passes an end of a piece that it meets exactly is a convention of each
!> program and its rounding. So there the reference goes both ways, and yields all places that are
!> possible.
module reference_walls
  use battery_kinds, only: wp
  use battery_channel, only: facing
  use battery_table, only: table_type, x_direction
  implicit none (type, external)
  private
  public :: walls_type, new_walls, is_end, fly, most_ends

  !> A path that comes nearer to an end of a piece than `near` goes both ways, shifted by `aside`;
  !> at the next end by more, so that it goes both ways there too.
  real(wp), parameter :: near = 1.0e-8_wp, aside = 1.0e-13_wp, more = 8.0_wp

  !> A path that runs along walls goes both ways so often that it is given up.
  integer, parameter :: most_ends = 24

  !> Distance of a corner within which a path goes both ways only once.
  real(wp), parameter :: step = 1.0e-6_wp

  !> Least distance from the start to the first hit.
  real(wp), parameter :: off = 1.0e-7_wp

  !> Walls (x and y of either end, by piece), and x of the periodic line of either urn.
  type :: walls_type
    real(wp), allocatable :: piece(:, :)
    real(wp) :: line(2) = huge(1.0_wp)
  end type walls_type

contains

  !> The walls of a circuit with polygons.
  function new_walls(table) result(walls)
    type(table_type), intent(in) :: table
    type(walls_type) :: walls
    real(wp) :: way
    integer :: urn, k, channel

    allocate (walls%piece(4, 0))
    do urn = 1, 2
      way = x_direction(urn)
      associate (polygon => table%urn(urn)%polygon, here => table%urn(urn))
        walls%line(urn) = way*here%periodic_line
        do k = 1, polygon%sides
          channel = findloc(polygon%side, k, 1)
          if (channel == 0) then
            call add(polygon%x(k), polygon%y(k), polygon%x(k + 1), polygon%y(k + 1))
          else
            associate (edge => facing(channel)*here%half_width(channel))
              call add(polygon%x(k), polygon%y(k), polygon%x(k), -edge)
              call add(polygon%x(k), edge, polygon%x(k), polygon%y(k + 1))
            end associate
          end if
        end do
        do k = -1, 1, 2
          call add(here%centre, k*here%half_width(1), here%chord(1), k*here%half_width(1))
          if (polygon%side(2) > 0) call add(here%centre - here%periodic_line, &
            k*here%half_width(2), -here%chord(2), k*here%half_width(2))
        end do
      end associate
    end do

  contains

    !> Adds a piece, given in the frame of the urn.
    subroutine add(ax, ay, bx, by)
      real(wp), intent(in) :: ax, ay, bx, by

      associate (here => table%urn(urn))
        walls%piece = reshape([walls%piece, here%axis_sign*(ax - here%centre), ay, &
          here%axis_sign*(bx - here%centre), by], [4, size(walls%piece, 2) + 1])
      end associate
    end subroutine add

  end function new_walls

  !> Whether a point is an end of a piece.
  pure logical function is_end(walls, x, y)
    type(walls_type), intent(in) :: walls
    real(wp), intent(in) :: x, y

    is_end = any(hypot(walls%piece(1, :) - x, walls%piece(2, :) - y) <= near .or. &
      hypot(walls%piece(3, :) - x, walls%piece(4, :) - y) <= near)
  end function is_end

  !> All states (x, y, u_x, u_y, hits) in which a particle may be after a time. It starts inside, or
  !> on a wall and inwards.
  recursive subroutine fly(walls, state, time, ends)
    type(walls_type), intent(in) :: walls
    real(wp), intent(in) :: state(5), time
    !> Appended to.
    real(wp), allocatable, intent(inout) :: ends(:, :)

    ! Off the wall that it may start on.
    call continue_path(walls, [state(:2) + off*state(3:4), state(3:)], time - off, -1.0_wp, 0, &
      aside, ends)
  end subroutine fly

  !> As `fly`, from a path that went one way at a corner: for the distance `free` it does not go
  !> both ways again.
  recursive subroutine continue_path(walls, begin, time, free, last, shift, ends)
    type(walls_type), intent(in) :: walls
    real(wp), intent(in) :: begin(5), time, free, shift
    !> Piece that the particle is on, or 0.
    integer, intent(in) :: last
    real(wp), allocatable, intent(inout) :: ends(:, :)
    real(wp) :: now(5), rest, wait, until, meets, unforked
    integer :: hit, way, from

    if (size(ends, 2) >= most_ends) return
    now = begin
    rest = time
    from = last
    unforked = free
    do
      call next_piece(walls, now, from, hit, wait)
      until = min(wait, rest)
      meets = first_end(walls, now, unforked, until)
      if (meets <= until + near) then
        meets = min(max(meets, 0.0_wp), rest)
        call reflect_twice(walls, now, rest, meets, shift, ends)
        now(:2) = now(:2) + now(3:4)*(meets - step)
        do way = -1, 1, 2
          call continue_path(walls, [now(:2) + way*shift*[-now(4), now(3)], now(3:)], rest - meets &
            + step, 10.0_wp*step, 0, more*shift, ends)
        end do
        return
      end if
      now(:2) = now(:2) + now(3:4)*until
      unforked = unforked - until
      if (wait >= rest - near) ends = reshape([ends, now], [5, size(ends, 2) + 1])
      if (wait > rest + near) return
      rest = rest - wait
      call pass(walls, hit, now)
      from = max(hit, 0)
      if (rest <= near) ends = reshape([ends, now], [5, size(ends, 2) + 1])
      if (rest <= near) return
    end do
  end subroutine continue_path

  !> Continues a path from a corner at which both pieces have reflected the particle, one after the
  !> other: rounding may do that in a re-entrant corner too.
  recursive subroutine reflect_twice(walls, now, rest, meets, shift, ends)
    type(walls_type), intent(in) :: walls
    real(wp), intent(in) :: now(5), rest, meets, shift
    real(wp), allocatable, intent(inout) :: ends(:, :)
    real(wp) :: there(5), point(2)
    integer :: first, second

    point = now(:2) + meets*now(3:4)
    do first = 1, size(walls%piece, 2)
      do second = 1, size(walls%piece, 2)
        if (first == second .or. .not. (ends_at(first) .and. ends_at(second))) cycle
        there = [point, now(3:)]
        call pass(walls, first, there)
        call pass(walls, second, there)
        there(:2) = there(:2) + min(step, rest - meets)*there(3:4)
        call continue_path(walls, there, rest - meets - min(step, rest - meets), 10.0_wp*step, 0, &
          more*shift, ends)
      end do
    end do

  contains

    pure logical function ends_at(k)
      integer, intent(in) :: k

      ends_at = hypot(walls%piece(1, k) - point(1), walls%piece(2, k) - point(2)) <= 2.0_wp*near &
        .or. hypot(walls%piece(3, k) - point(1), walls%piece(4, k) - point(2)) <= 2.0_wp*near
    end function ends_at

  end subroutine reflect_twice

  !> Reflects a particle at a piece, or moves it over the periodic line (`hit` below 0: of that
  !> urn).
  subroutine pass(walls, hit, now)
    type(walls_type), intent(in) :: walls
    integer, intent(in) :: hit
    real(wp), intent(inout) :: now(5)
    real(wp) :: normal(2)

    if (hit < 0) then
      now(1) = walls%line(3 + hit)
      return
    end if
    associate (piece => walls%piece(:, hit))
      normal = [piece(4) - piece(2), piece(1) - piece(3)]/hypot(piece(3) - piece(1), piece(4) &
        - piece(2))
    end associate
    now(3:4) = now(3:4) - 2.0_wp*dot_product(now(3:4), normal)*normal
    now(5) = now(5) + 1.0_wp
  end subroutine pass

  !> Next piece or periodic line on a path, and the time until then.
  subroutine next_piece(walls, now, from, hit, wait)
    type(walls_type), intent(in) :: walls
    real(wp), intent(in) :: now(5)
    integer, intent(in) :: from
    integer, intent(out) :: hit
    real(wp), intent(out) :: wait
    real(wp) :: time, first, second
    integer :: k

    wait = huge(1.0_wp)
    hit = 0
    do k = 1, size(walls%piece, 2)
      if (k == from) cycle
      associate (a => walls%piece(:2, k) - now(:2), b => walls%piece(3:, k) - now(:2), &
        u => now(3:4))
        first = u(1)*a(2) - u(2)*a(1)
        second = u(1)*b(2) - u(2)*b(1)
        if (first*second > 0.0_wp .or. .not. abs(second - first) > 1.0e-14_wp) cycle
        time = (dot_product(u, a)*second - dot_product(u, b)*first)/(second - first)
      end associate
      if (time < -1.0e-13_wp .or. time >= wait) cycle
      wait = time
      hit = k
    end do
    do k = 1, 2
      time = (walls%line(k) - now(1))*now(3)
      if (time <= 1.0e-13_wp) cycle
      time = (walls%line(k) - now(1))/now(3)
      if (time >= wait) cycle
      wait = time
      hit = -k
    end do
    wait = max(wait, 0.0_wp)
  end subroutine next_piece

  !> Time at which a path first comes near an end of a piece, after `free` and up to `until`; else
  !> huge.
  function first_end(walls, now, free, until) result(meets)
    type(walls_type), intent(in) :: walls
    real(wp), intent(in) :: now(5), free, until
    real(wp) :: meets, ahead
    integer :: k, at

    meets = huge(1.0_wp)
    do k = 1, size(walls%piece, 2)
      do at = 1, 3, 2
        associate (a => walls%piece(at:at + 1, k) - now(:2), u => now(3:4))
          if (abs(u(1)*a(2) - u(2)*a(1)) > near) cycle
          ahead = dot_product(u, a)
        end associate
        if (ahead > max(free, -near) .and. ahead <= until + near) meets = min(meets, ahead)
      end do
    end do
  end function first_end

end module reference_walls

!> The first time a rotation of the circle enters an interval, in O(log) operations.
!>
!> Angles are integers: a full turn is `full_turn`, sums are exact modulo a turn, so an orbit of any
!> length is exact once its start and step have been rounded to the grid, which is finer than `wp`.
!>
!> The rotation by `step` exchanges two intervals of [0, L), L = a + b: x < b moves up by a, x >= b
!> moves down by b. Its first return map to a shorter interval that still holds the target exchanges
!> two intervals again; shortening as long as the target fits is Euclid's algorithm on (a, b), and
!> each move remembers how many steps of the rotation it stands for.
module battery_rotation
  use battery_kinds, only: wp, angle_kind, pi
  implicit none (type, external)
  private
  public :: full_turn, to_turn, from_turn, first_entry

  !> One turn; two bits are kept free so that sums of two angles do not overflow.
  integer(angle_kind), parameter :: full_turn = 2_angle_kind**(bit_size(1_angle_kind) - 4)

contains

  !> An angle in radians within (-2 pi, 2 pi), as an integer in [0, full_turn).
  elemental function to_turn(angle) result(turn)
    real(wp), intent(in) :: angle
    integer(angle_kind) :: turn

    turn = nint(angle/(2.0_wp*pi)*real(full_turn, wp), angle_kind)
    turn = modulo(turn, full_turn)
  end function to_turn

  !> An integer angle in (-full_turn, full_turn), in radians.
  elemental function from_turn(turn) result(angle)
    integer(angle_kind), intent(in) :: turn
    real(wp) :: angle

    angle = real(turn, wp)/real(full_turn, wp)*(2.0_wp*pi)
  end function from_turn

  !> Smallest `steps` >= 0 for which (start + steps*step) mod circle lies in [0, width], and where
  !> it lies then (`landing`). `found` is false if the orbit is periodic and never gets there.
  !> `circle` is `full_turn` if absent, and half of it where opposite points are the same. Expects
  !> 0 <= start, step < circle and 0 <= width < circle.
  pure subroutine first_entry(start, step, width, steps, landing, found, circle)
    integer(angle_kind), intent(in) :: start, step, width
    integer(angle_kind), intent(out) :: steps, landing
    logical, intent(out) :: found
    integer(angle_kind), intent(in), optional :: circle
    integer(angle_kind) :: x, up, down, up_cost, down_cost, moves

    x = start
    steps = 0
    up = step
    down = full_turn - step
    if (present(circle)) down = circle - step
    up_cost = 1
    down_cost = 1
    found = .true.
    do while (x > width)
      if (up == 0 .or. down == 0) then
        found = .false.
        exit
      else if (width >= down) then
        moves = (x - width + down - 1)/down
        x = x - moves*down
        steps = steps + moves*down_cost
      else if (width >= up) then
        if (x < down) then
          moves = (down - x + up - 1)/up
          x = x + moves*up
          steps = steps + moves*up_cost
        end if
        x = x - down
        steps = steps + down_cost
      else if (up > down) then
        moves = up/down
        up = up - moves*down
        up_cost = up_cost + moves*down_cost
        if (x >= up + down) then
          moves = (x - up)/down
          x = x - moves*down
          steps = steps + moves*down_cost
        end if
      else
        ! A point above the shortened interval comes down by the first of the lengths
        ! down, down - up, down - 2 up, ... that is not longer than its own height.
        moves = down/up
        if (x >= down - (moves - 1)*up) then
          block
            integer(angle_kind) :: shortened
            shortened = max(0_angle_kind, (down - x + up - 1)/up)
            x = x - (down - shortened*up)
            steps = steps + down_cost + shortened*up_cost
          end block
        end if
        down = down - moves*up
        down_cost = down_cost + moves*up_cost
      end if
    end do
    landing = x
  end subroutine first_entry

end module battery_rotation

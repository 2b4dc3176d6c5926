!> First time at which a rotation of the circle enters an arc, in O(log) operations.
!>
!> Angles are integers, with `full_turn` for a full turn: sums are exact modulo a turn, so an orbit
!> of any length is exact once its start and its step are rounded to the grid, which is finer than
!> `wp`.
!>
!> The rotation by `step` exchanges two intervals of [0, L), L = a + b: x < b moves up by a, x >= b
!> moves down by b. Its first-return map to a shorter interval that still contains the target
!> exchanges two intervals too. Shortening the interval as long as it contains the target is
!> Euclid's algorithm on (a, b); each move carries the number of rotation steps that it stands for.
module battery_rotation
  use battery_kinds, only: wp, angle_kind, pi
  implicit none (type, external)
  private
  public :: full_turn, to_turn, turn_of_vector, to_radians, unit_vector, first_step_into_arc

  !> One full turn; two bits are left free, so that the sum of two angles does not overflow.
  integer(angle_kind), parameter :: full_turn = 2_angle_kind**(bit_size(1_angle_kind) - 4)

contains

  !> An angle in radians, within (-2 pi, 2 pi), as an integer in [0, full_turn).
  elemental function to_turn(angle) result(turn)
    !> In radians.
    real(wp), intent(in) :: angle
    integer(angle_kind) :: turn
    real(wp), parameter :: per_radian = real(full_turn, wp)/(2.0_wp*pi)

    turn = modulo(int(angle*per_radian + sign(0.5_wp, angle), angle_kind), full_turn)
  end function to_turn

  !> Direction of the unit vector (x, y), in [0, full_turn). Near each axis the angle from that axis
  !> is computed, so that it is accurate to all digits.
  elemental function turn_of_vector(x, y) result(turn)
    !> Components of a vector of length 1.
    real(wp), intent(in) :: x, y
    integer(angle_kind) :: turn, rest
    integer(angle_kind), parameter :: quarter = full_turn/4
    logical :: level

    level = abs(y) <= abs(x)
    rest = to_turn(asin(min(abs(x), abs(y))))
    turn = merge(rest, quarter - rest, level)
    turn = merge(turn, 2*quarter - turn, x >= 0.0_wp)
    turn = modulo(merge(turn, -turn, y >= 0.0_wp), full_turn)
  end function turn_of_vector

  !> Cosine and sine of an integer angle in (-full_turn, full_turn).
  elemental subroutine unit_vector(turn, x, y)
    !> The angle.
    integer(angle_kind), intent(in) :: turn
    !> Its cosine and its sine.
    real(wp), intent(out) :: x, y
    real(wp) :: angle, square
    !> Below this angle the first terms of the power series suffice.
    real(wp), parameter :: small = (720.0_wp*epsilon(1.0_wp))**(1.0_wp/6.0_wp)

    angle = to_radians(turn)
    if (abs(angle) < small) then
      square = angle**2
      x = 1.0_wp - square*(0.5_wp - square/24.0_wp)
      y = angle*(1.0_wp - square*(1.0_wp/6.0_wp - square/120.0_wp))
    else
      x = cos(angle)
      y = sin(angle)
    end if
  end subroutine unit_vector

  !> An integer angle in (-full_turn, full_turn), in radians.
  elemental function to_radians(turn) result(angle)
    !> The angle.
    integer(angle_kind), intent(in) :: turn
    real(wp) :: angle

    angle = real(turn, wp)/real(full_turn, wp)*(2.0_wp*pi)
  end function to_radians

  !> Smallest `steps` >= 0 for which (start + steps*step) mod circle lies in the arc [0, width], and
  !> the angle there (`landing`). `found` is false if the orbit is periodic and never enters the
  !> arc. `circle` is `full_turn` if absent; half of it identifies opposite points. Expects 0 <=
  !> start, step < circle and 0 <= width < circle.
  pure subroutine first_step_into_arc(start, step, width, steps, landing, found, circle)
    !> Integer angles: start and step of the orbit, width of the arc.
    integer(angle_kind), intent(in) :: start, step, width
    integer(angle_kind), intent(out) :: steps, landing
    logical, intent(out) :: found
    integer(angle_kind), intent(in), optional :: circle
    integer(angle_kind) :: x, up, down, up_cost, down_cost, moves, quotient
    logical :: above

    x = start
    steps = 0
    up = step
    down = full_turn - step
    if (present(circle)) down = circle - step
    up_cost = 1
    down_cost = 1
    found = .true.
    do while (x > width)
      if (width >= min(up, down)) then
        call move_into_target(up, down, up_cost, down_cost, width, x, steps, found)
        exit
      end if
      ! Euclid's step and the move of the point are two independent divisions, and there is no
      ! branch to predict: this loop determines the cost of a visit between tiny openings.
      if (up > down) then
        quotient = up/down
        moves = max(0_angle_kind, quotient - (up - x + down - 1)/down)
        x = x - moves*down
        steps = steps + moves*down_cost
        up = up - quotient*down
        up_cost = up_cost + quotient*down_cost
      else
        ! A point above the shortened interval moves down by the first of the lengths down, down -
        ! up, down - 2 up, ... that does not exceed its height.
        quotient = down/up
        moves = (down - x + up - 1)/up
        above = moves < quotient
        x = x - merge(down - moves*up, 0_angle_kind, above)
        steps = steps + merge(down_cost + moves*up_cost, 0_angle_kind, above)
        down = down - quotient*up
        down_cost = down_cost + quotient*up_cost
      end if
    end do
    landing = x
  end subroutine first_step_into_arc

  !> Moves the point into the target, once one of the two moves is no longer than the target.
  pure subroutine move_into_target(up, down, up_cost, down_cost, width, x, steps, found)
    integer(angle_kind), intent(in) :: up, down, up_cost, down_cost, width
    integer(angle_kind), intent(inout) :: x, steps
    logical, intent(inout) :: found
    integer(angle_kind) :: moves

    if (up == 0 .or. down == 0) then
      found = .false.
      return
    end if
    if (width < down) then
      ! Only the move up is short enough: up to above `down`, then one move down into the target.
      moves = (max(down - x, 0_angle_kind) + up - 1)/up
      x = x + moves*up - down
      steps = steps + moves*up_cost + down_cost
    end if
    if (x <= width) return
    moves = (x - width + down - 1)/down
    x = x - moves*down
    steps = steps + moves*down_cost
  end subroutine move_into_target

end module battery_rotation

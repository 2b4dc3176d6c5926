!> Random numbers one by one, generated in blocks.
module battery_draws
  use battery_kinds, only: wp, int64
  use battery_random, only: random_type, new_random, draw_uniform
  implicit none (type, external)
  private
  public :: draws_type, new_draws, next_uniform

  !> Numbers generated at a time.
  integer, parameter :: drawn_together = 4096

  !> A generator, and the numbers generated last.
  type :: draws_type
    private
    type(random_type) :: random
    real(wp) :: number(drawn_together) = 0.0_wp
    integer :: used = drawn_together
  end type draws_type

contains

  !> A generator; the same seed gives the same numbers.
  pure function new_draws(seed) result(draws)
    !> Any 64 bits.
    integer(int64), intent(in) :: seed
    type(draws_type) :: draws

    draws%random = new_random(seed)
  end function new_draws

  !> The next number, uniform in (0, 1).
  function next_uniform(draws) result(number)
    type(draws_type), intent(inout) :: draws
    real(wp) :: number

    if (draws%used == drawn_together) then
      call draw_uniform(draws%random, drawn_together, draws%number)
      draws%used = 0
    end if
    draws%used = draws%used + 1
    number = draws%number(draws%used)
  end function next_uniform

end module battery_draws

!> Uniform random numbers, fetched one by one and generated in blocks.
module battery_draws
  use battery_kinds, only: wp, int64
  use battery_random, only: random_type, new_random, draw_uniform
  implicit none (type, external)
  private
  public :: draws_type, new_draws, next_uniform

  !> Number of random numbers that are generated together.
  integer, parameter :: block_size = 4096

  !> A generator, the block of numbers that it generated last, and how many of them are used.
  type :: draws_type
    private
    type(random_type) :: random
    real(wp) :: number(block_size) = 0.0_wp
    integer :: used = block_size
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

    if (draws%used == block_size) then
      call draw_uniform(draws%random, block_size, draws%number)
      draws%used = 0
    end if
    draws%used = draws%used + 1
    number = draws%number(draws%used)
  end function next_uniform

end module battery_draws

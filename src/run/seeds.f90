!> Seeds of the tasks of a run.
module battery_seeds
  use battery_kinds, only: int64
  implicit none (type, external)
  private
  public :: task_seed

contains

  !> Seed of a task, 0 to 2**32 - 1, from the base seed, the point and the replica alone.
  !>
  !> Point and replica are paired to one number (Cantor), mixed, combined with the mixed base seed,
  !> and mixed again. Each step but the pairing of numbers beyond 2**32 is one to one, so the
  !> seeds of one run all differ as long as point + replica stays below 92 000.
  pure function task_seed(base, point, replica) result(seed)
    integer(int64), intent(in) :: base
    integer, intent(in) :: point, replica
    integer(int64) :: seed
    integer(int64), parameter :: low = 4294967295_int64
    integer(int64) :: sum, pair

    sum = int(point, int64) + replica - 2
    pair = iand(sum*(sum + 1)/2 + replica, low)
    seed = mix(ieor(mix(pair), mix(ieor(iand(base, low), mix(shiftr(base, 32))))))
  end function task_seed

  !> Finaliser of MurmurHash3: one to one on 32 bits.
  pure function mix(number) result(mixed)
    integer(int64), intent(in) :: number
    integer(int64) :: mixed

    mixed = ieor(number, shiftr(number, 16))
    mixed = times(mixed, 2246822507_int64)
    mixed = ieor(mixed, shiftr(mixed, 13))
    mixed = times(mixed, 3266489909_int64)
    mixed = ieor(mixed, shiftr(mixed, 16))
  end function mix

  !> Product of two numbers of 32 bits, its low 32 bits, without overflow.
  pure function times(one, other) result(product_low)
    integer(int64), intent(in) :: one, other
    integer(int64) :: product_low
    integer(int64), parameter :: low = 4294967295_int64, half = 65535_int64

    product_low = iand(one*iand(other, half) &
      + shiftl(iand(one*shiftr(other, 16), half), 16), low)
  end function times

end module battery_seeds

!> Random numbers of the physics: xoshiro256+, several generators in parallel.
!>
!> D. Blackman, S. Vigna, "Scrambled linear pseudorandom number generators", ACM TOMS 47, 36 (2021),
!> https://doi.org/10.1145/3460772; the states are filled by SplitMix64 as its authors recommend.
!> The period is 2**256 - 1, so streams of different seeds, and the lanes of one, do not overlap. It
!> needs only shifts, sums and exclusive ors, and is vectorised over the lanes. The lowest of the 64
!> bits of a number, which are weak, are not used.
!>
!> Initial states are drawn from `battery_gsl`, one number at a time; these generators are for the
!> engine `reservoir`, which draws many at a time. Both stay, since seeds fix the bits of runs.
module battery_random
  use battery_kinds, only: wp, int64
  implicit none (type, external)
  private
  public :: random_type, lanes, new_random, draw_uniform, hashed_uniform, splitmix64

  !> Number of parallel generators; numbers are drawn in multiples of it.
  integer, parameter :: lanes = 8

  !> Bits of a number: with half a step added it is exact in `wp`, and neither 0 nor 1.
  integer, parameter :: bits = min(digits(1.0_wp), 53) - 1
  real(wp), parameter :: step = 0.5_wp**bits

  !> The odd number next to 2**64 over the golden ratio, as a signed integer.
  integer(int64), parameter :: golden = -7046029254386353131_int64

  !> State of a generator; a copy is an independent generator with the same state.
  type :: random_type
    integer(int64) :: state(lanes, 4) = 0
  end type random_type

contains

  !> Makes a generator; the same seed gives the same numbers.
  pure type(random_type) function new_random(seed) result(random)
    !> Seed: any 64 bits.
    integer(int64), intent(in) :: seed
    integer :: lane, word

    do word = 1, 4
      do lane = 1, lanes
        random%state(lane, word) = splitmix64(splitmix64(seed) + golden*(4*lane + word))
      end do
    end do
  end function new_random

  !> Fills `numbers`, whose size is a multiple of `lanes`, with numbers uniform in (0, 1).
  pure subroutine draw_uniform(random, n, numbers)
    type(random_type), intent(inout) :: random
    !> Number of random numbers: a multiple of `lanes`.
    integer, intent(in) :: n
    real(wp), intent(out) :: numbers(n)
    integer(int64) :: state(lanes, 4), s0, s1, s2, s3
    integer :: first, lane

    state = random%state
    do first = 0, n - lanes, lanes
      do lane = 1, lanes
        s0 = state(lane, 1)
        s1 = state(lane, 2)
        s2 = ieor(state(lane, 3), s0)
        s3 = ieor(state(lane, 4), s1)
        numbers(first + lane) = uniform(s0 + state(lane, 4))
        state(lane, 1) = ieor(s0, s3)
        state(lane, 2) = ieor(s1, s2)
        state(lane, 3) = ieor(s2, shiftl(s1, 17))
        state(lane, 4) = ior(shiftl(s3, 45), shiftr(s3, 19))
      end do
    end do
    random%state = state
  end subroutine draw_uniform

  !> A number uniform in (0, 1) as a hash of two integers, without a state.
  elemental real(wp) function hashed_uniform(key, count) result(number)
    !> Key of the sequence and index of the number in it: any 64 bits each.
    integer(int64), intent(in) :: key, count

    number = uniform(splitmix64(splitmix64(key) + golden*count))
  end function hashed_uniform

  !> The highest bits of a word as a number in (0, 1).
  elemental real(wp) function uniform(word) result(number)
    integer(int64), intent(in) :: word

    number = (real(shiftr(word, 64 - bits), wp) + 0.5_wp)*step
  end function uniform

  !> SplitMix64 without its counter: a bijection of 64 bits. Products wrap around.
  elemental integer(int64) function splitmix64(word) result(z)
    !> Word: any 64 bits.
    integer(int64), intent(in) :: word

    z = word
    z = ieor(z, shiftr(z, 30))*(-4658895280553007687_int64)
    z = ieor(z, shiftr(z, 27))*(-7723592293110705685_int64)
    z = ieor(z, shiftr(z, 31))
  end function splitmix64

end module battery_random

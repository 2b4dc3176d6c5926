!> Simulation of the renewal gate alone, to verify `renewal_closure`. Particles enter as a Poisson
!> process of rate nu, and each is counted for the time (l/2)/cos(theta), with theta from the cosine
!> law. An entry while T particles are counted makes the gate reverse, so that none is counted; this
!> ends a cycle. Reads a seed, then lines `load threshold entries`; writes lines `load threshold
!> cycles sum sum_of_squares`, the sums over cycles of the number of entries and of its square.
!> Lengths are in units of l/2, so the mean time tau is pi/2, and `load` is nu tau.
program renewal_gate
  use, intrinsic :: iso_fortran_env, only: int64, real64, input_unit, output_unit
  implicit none (type, external)
  !> Number of random numbers that are generated together.
  integer, parameter :: buffer_size = 4096
  real(real64), parameter :: half_pi = 1.57079632679489661923_real64
  real(real64) :: buffer(buffer_size), load, total, squares
  integer :: used, threshold, status, seed_size, seed
  integer(int64) :: entries, cycles

  call random_seed(size=seed_size)
  read (input_unit, *) seed
  call random_seed(put=spread(seed, 1, seed_size))
  used = buffer_size
  do
    read (input_unit, *, iostat=status) load, threshold, entries
    if (status /= 0) exit
    call simulate_cycles(load/half_pi, threshold, entries, cycles, total, squares)
    write (output_unit, '(es24.16,1x,i0,1x,i0,2(1x,es24.16))') &
      load, threshold, cycles, total, squares
    flush (output_unit)
  end do

contains

  !> Next random number, uniform in (0, 1].
  function uniform() result(number)
    real(real64) :: number

    if (used == buffer_size) then
      call random_number(buffer)
      used = 0
    end if
    used = used + 1
    number = 1.0_real64 - buffer(used)
  end function uniform

  !> Simulates complete cycles, each from the empty gate to its reversal.
  subroutine simulate_cycles(rate, threshold, entries, cycles, total, squares)
    !> Rate of entries nu; threshold T.
    real(real64), intent(in) :: rate
    integer, intent(in) :: threshold
    !> The first cycle that reaches this total number of entries is the last.
    integer(int64), intent(in) :: entries
    !> Number of cycles; sums over them of the number of entries and of its square.
    integer(int64), intent(out) :: cycles
    real(real64), intent(out) :: total, squares
    real(real64) :: exit_time(threshold + 1), clock
    integer :: inside, remaining, at
    integer(int64) :: count

    cycles = 0
    total = 0.0_real64
    squares = 0.0_real64
    do while (total < real(entries, real64))
      clock = 0.0_real64
      inside = 0
      count = 0
      do
        clock = clock - log(uniform())/rate
        count = count + 1
        remaining = 0
        do at = 1, inside
          exit_time(remaining + 1) = exit_time(at)
          remaining = remaining + merge(1, 0, exit_time(at) > clock)
        end do
        inside = remaining
        if (inside == threshold) exit
        inside = inside + 1
        exit_time(inside) = clock + 1.0_real64/sqrt(max(1.0_real64 - uniform()**2, tiny(clock)))
      end do
      cycles = cycles + 1
      total = total + real(count, real64)
      squares = squares + real(count, real64)**2
    end do
  end subroutine simulate_cycles

end program renewal_gate

!> Simulates the renewal gate alone: Poisson entries at rate nu, each inside for (l/2)/cos(theta),
!> by the cosine law; all are turned back by an entry that finds T inside. Reads a seed, then lines
!> `load threshold entries`; writes lines `load threshold cycles sum sum_of_squares`, the sums over
!> the entries of a cycle. Lengths are in units of l/2, so tau = pi/2. Checks `renewal_closure`.
program renewal_gate
  use, intrinsic :: iso_fortran_env, only: int64, real64, input_unit, output_unit
  implicit none (type, external)
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

  !> Next uniform number in (0, 1].
  function uniform() result(number)
    real(real64) :: number

    if (used == buffer_size) then
      call random_number(buffer)
      used = 0
    end if
    used = used + 1
    number = 1.0_real64 - buffer(used)
  end function uniform

  !> Simulates whole cycles, each from empty to the reversal, until about `entries` have come.
  subroutine simulate_cycles(rate, threshold, entries, cycles, total, squares)
    real(real64), intent(in) :: rate
    integer, intent(in) :: threshold
    integer(int64), intent(in) :: entries
    integer(int64), intent(out) :: cycles
    real(real64), intent(out) :: total, squares
    real(real64) :: leaves(threshold + 1), clock
    integer :: inside, kept, at
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
        kept = 0
        do at = 1, inside
          leaves(kept + 1) = leaves(at)
          kept = kept + merge(1, 0, leaves(at) > clock)
        end do
        inside = kept
        if (inside == threshold) exit
        inside = inside + 1
        leaves(inside) = clock + 1.0_real64/sqrt(max(1.0_real64 - uniform()**2, tiny(clock)))
      end do
      cycles = cycles + 1
      total = total + real(count, real64)
      squares = squares + real(count, real64)**2
    end do
  end subroutine simulate_cycles

end program renewal_gate

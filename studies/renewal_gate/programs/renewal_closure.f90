!> Share of the particles that pass a renewal gate, from moment equations (`renewal_equations`).
!> Reads lines `load threshold order cells time`, and writes lines `load threshold share survivors`:
!> `load` is the mean number inside without a threshold, `survivors` the probability that the gate
!> has not reversed until `time`. Lengths are in units of l/2. Called by `fit.py`, which fits the
!> results.
program renewal_closure
  use renewal_equations, only: wp, solve_gate
  use, intrinsic :: iso_fortran_env, only: input_unit, output_unit
  implicit none (type, external)
  real(wp), parameter :: half_pi = 1.57079632679489661923_wp
  integer :: threshold, order, cells, status
  real(wp) :: load, max_time, share, survivors
  do
    read (input_unit, *, iostat=status) load, threshold, order, cells, max_time
    if (status /= 0) exit
    call solve_gate(load/half_pi, threshold, order, cells, max_time, share, survivors)
    write (output_unit, '(es24.16,1x,i0,2(1x,es24.16))') load, threshold, share, survivors
    flush (output_unit)
  end do
end program renewal_closure

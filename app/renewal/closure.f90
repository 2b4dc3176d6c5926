!> Share of particles that renewal gates let through, without random numbers (`renewal_equations`).
!> Reads lines `load threshold order cells time`, writes lines `load threshold share survivors`,
!> lengths in units of l/2. Called by `postproc.renewal_fit`, which fits the results.
program renewal_closure
  use renewal_equations, only: wp, solve_gate
  use, intrinsic :: iso_fortran_env, only: input_unit, output_unit
  implicit none (type, external)
  real(wp), parameter :: half_pi = 1.57079632679489661923_wp
  integer :: threshold, order, cells, status
  real(wp) :: load, longest, share, left
  do
    read (input_unit, *, iostat=status) load, threshold, order, cells, longest
    if (status /= 0) exit
    call solve_gate(load/half_pi, threshold, order, cells, longest, share, left)
    write (output_unit, '(es24.16,1x,i0,2(1x,es24.16))') load, threshold, share, left
    flush (output_unit)
  end do
end program renewal_closure

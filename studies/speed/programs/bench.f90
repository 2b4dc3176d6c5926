!> The program `bench`: collisions and visits per second, all engines compared in one run.
!>
!> A case (engine, number, threshold, widths) is simulated for a fixed time on one core, after a
!> warm-up. Cases that are compared run in turn, in several rounds, so that a drift of the machine's
!> speed changes all rates alike; the tables give medians and the spread. Rates are per second of
!> processor time. `bench single ENGINE NUMBER THRESHOLD WIDTH1 WIDTH2 COLLISIONS` runs one case
!> once, for tools that count instructions; `bench memory ...` runs it too, and prints its peak
!> memory in kB.
program bench
  use, intrinsic :: iso_fortran_env, only: output_unit
  use battery_bench, only: bench_main
  implicit none (type, external)

  call bench_main(output_unit)
end program bench

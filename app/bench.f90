!> The program `bench`: collisions and visits a second, engine against engine, in one run.
!>
!> Each case is a scene (number, threshold, widths) that an engine simulates for a fixed time on one
!> core, after a warm-up. Cases that are compared run in turn, several rounds, so that a machine
!> whose speed drifts slows them alike; the tables give medians and the spread. Rates are a second
!> of processor time.
!> `bench single ENGINE NUMBER THRESHOLD WIDTH1 WIDTH2 COLLISIONS` just runs one case once, for
!> tools that count instructions; `bench memory ...` does, too, and gives its peak memory in kB.
program bench
  use, intrinsic :: iso_fortran_env, only: output_unit
  use battery_bench, only: bench_main
  implicit none (type, external)

  call bench_main(output_unit)
end program bench

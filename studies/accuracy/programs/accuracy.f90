!> The program `accuracy`: probes of the engines, in the precision it was built with.
!>
!> `make accuracy` builds the program in three precisions (real32, real64, real128). Each command
!> prints JSON, one object a line; `accuracy` without arguments lists the commands. Numbers are read
!> and written with all digits of the precision.
program accuracy
  use battery_probe, only: argument
  use battery_probe_trajectory, only: trajectory_main, reversal_main
  use battery_probe_lyapunov, only: lyapunov_main
  use battery_probe_visits, only: visits_main
  use battery_probe_stability, only: stability_main
  implicit none (type, external)

  select case (argument(1))
  case ('trajectory')
    call trajectory_main()
  case ('reversal')
    call reversal_main()
  case ('lyapunov')
    call lyapunov_main()
  case ('visits')
    call visits_main()
  case ('stability')
    call stability_main()
  case default
    print '(a)', 'usage: accuracy trajectory ENGINE STEP FILE NUMBER THRESHOLD TIME ...', &
      '       accuracy reversal ENGINE STEP FILE NUMBER TIME ...', &
      '       accuracy lyapunov WIDTH1 WIDTH2 NUMBER TIME [FILE]', &
      '       accuracy visits URN WIDTH1 WIDTH2 COUNT INPUT_BITS FILE', &
      '       accuracy stability ENGINE COLLISIONS SECONDS'
  end select
end program accuracy

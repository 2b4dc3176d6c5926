!> What a plan will do and cost, before it is run: tasks, parameters, time from a short calibration,
!> memory.
module battery_outlook
  use, intrinsic :: iso_fortran_env, only: output_unit
  use battery_kinds, only: wp, dp, int64
  use battery_error, only: error_type
  use battery_engine, only: particles_type
  use battery_initial_state, only: random_particles, read_particles
  use battery_plan, only: plan_type, point_type, point_of
  use battery_screen, only: duration_text, rate_text
  use battery_signals, only: cpu_seconds
  use battery_simulation, only: simulation_type, begin_simulation, step
  use battery_task, only: task_type
  use battery_tasks, only: task_count, task_of
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: print_outlook, bytes_per_particle

  !> Tasks tried for the calibration, and seconds spent on each.
  integer, parameter :: most_tries = 5
  real(dp), parameter :: try_seconds = 0.4_dp

contains

  !> Prints the plan and what it will cost on `ranks` ranks.
  subroutine print_outlook(plan, ranks, error)
    type(plan_type), intent(in) :: plan
    integer, intent(in) :: ranks
    type(error_type), allocatable, intent(out) :: error
    real(dp) :: seconds, rate

    call print_parameters(plan)
    call calibrate(plan, seconds, rate, error)
    if (allocated(error)) return
    write (output_unit, '(a)') 'speed:      '//rate_text(rate)//' collisions/s a rank (calibrated)'
    write (output_unit, '(a)') 'time:       about '//duration_text(seconds*max(1.0_dp, &
      real(ceiling(real(task_count(plan), dp)/ranks), dp)))//' on '//counted(ranks, 'rank')
    write (output_unit, '(a)') 'memory:     about ' &
      //megabytes(bytes_per_particle()*greatest_number(plan) + 30.0e6_dp) &
      //' a rank; rank 0 about '//megabytes(result_bytes(plan))//' more at the end'
    write (output_unit, '(a)') 'results:    '//plan%file, 'nothing was written'
  end subroutine print_outlook

  !> Bytes that the engines take per particle, the initial state included.
  pure function bytes_per_particle() result(bytes)
    real(dp) :: bytes

    bytes = 120.0_dp
  end function bytes_per_particle

  !> Bytes of all results, which rank 0 brings together, with the arrays of the results file.
  pure function result_bytes(plan) result(bytes)
    type(plan_type), intent(in) :: plan
    real(dp) :: bytes
    !> Bytes a task, and a particle's state.
    real(dp), parameter :: bytes_a_task = 400.0_dp, bytes_a_state = 32.0_dp
    integer :: states

    states = size(plan%snapshot_times) + merge(1, 0, plan%final_state)
    bytes = task_count(plan)*(bytes_a_task + 2.0_dp*states*bytes_a_state*greatest_number(plan))
    if (plan%series_interval > 0.0_wp .and. plan%duration > 0.0_wp) bytes = bytes &
      + task_count(plan)*80.0_dp*plan%duration/plan%series_interval
  end function result_bytes

  pure function megabytes(bytes) result(text)
    real(dp), intent(in) :: bytes
    character(len=:), allocatable :: text

    text = to_text(ceiling(bytes/1.0e6_dp, int64))//' MB'
  end function megabytes

  !> Particles of the largest system.
  pure function greatest_number(plan) result(number)
    type(plan_type), intent(in) :: plan
    integer :: number
    type(point_type) :: point
    integer :: at

    number = 0
    do at = 1, plan%point_count
      point = point_of(plan, at)
      number = max(number, point%number)
    end do
  end function greatest_number

  subroutine print_parameters(plan)
    type(plan_type), intent(in) :: plan
    type(point_type) :: point, least, most
    integer :: at

    least = point_of(plan, 1)
    most = least
    do at = 2, plan%point_count
      point = point_of(plan, at)
      least%number = min(least%number, point%number)
      most%number = max(most%number, point%number)
      least%threshold = min(least%threshold, point%threshold)
      most%threshold = max(most%threshold, point%threshold)
      least%channel1_width = min(least%channel1_width, point%channel1_width)
      most%channel1_width = max(most%channel1_width, point%channel1_width)
      least%channel2_width = min(least%channel2_width, point%channel2_width)
      most%channel2_width = max(most%channel2_width, point%channel2_width)
      least%urn1_number = min(least%urn1_number, point%urn1_number)
      most%urn1_number = max(most%urn1_number, point%urn1_number)
    end do
    write (output_unit, '(a)') 'tasks:      '//to_text(task_count(plan))//' (' &
      //counted(plan%point_count, 'point')//', '//counted(plan%replicas, 'replica')//' each)'
    write (output_unit, '(a)') 'shape:      '//plan%shape//', urn radius ' &
      //to_text(plan%urn_radius)//', channel 1 '//to_text(plan%channel1_length) &
      //' long, channel 2 '//to_text(plan%channel2_length)
    write (output_unit, '(a)') 'engine:     '//plan%engine
    write (output_unit, '(a)') 'N:          '//range_text(to_text(least%number), &
      to_text(most%number))
    write (output_unit, '(a)') 'T:          '//range_text(to_text(least%threshold), &
      to_text(most%threshold))
    write (output_unit, '(a)') 'w:          '//range_text(to_text(least%channel1_width), &
      to_text(most%channel1_width))
    write (output_unit, '(a)') 'w'':         '//range_text(to_text(least%channel2_width), &
      to_text(most%channel2_width))
    write (output_unit, '(a)') 'urn 1:      '//range_text(to_text(least%urn1_number), &
      to_text(most%urn1_number))//' particles at the start'
    if (plan%duration > 0.0_wp) then
      write (output_unit, '(a)') 'length:     '//to_text(plan%duration) &
        //' time units each, the first ' //to_text(plan%transient_duration)//' not averaged'
    else
      write (output_unit, '(a)') 'length:     '//rate_text(real(plan%collisions, dp)) &
        //' collisions each, the first ' &
        //rate_text(real(plan%transient_collisions, dp))//' not averaged'
    end if
  end subroutine print_parameters

  !> `1 point`, `2 points`.
  pure function counted(number, what) result(text)
    integer, intent(in) :: number
    character(len=*), intent(in) :: what
    character(len=:), allocatable :: text

    text = to_text(number)//' '//what
    if (number /= 1) text = text//'s'
  end function counted

  pure function range_text(least, most) result(text)
    character(len=*), intent(in) :: least, most
    character(len=:), allocatable :: text

    text = least
    if (most /= least) text = text//' ... '//most
  end function range_text

  !> Mean seconds a task will take, and collisions a second, from a few tasks spread over the plan.
  subroutine calibrate(plan, seconds, rate, error)
    type(plan_type), intent(in) :: plan
    real(dp), intent(out) :: seconds, rate
    type(error_type), allocatable, intent(out) :: error
    integer :: tries, k
    real(dp) :: one_seconds, one_rate

    tries = min(most_tries, task_count(plan))
    seconds = 0.0_dp
    rate = 0.0_dp
    do k = 1, tries
      call try(task_of(plan, 1 + int(int(task_count(plan) - 1, int64)*(k - 1)/max(tries - 1, 1))), &
        one_seconds, one_rate, error)
      if (allocated(error)) return
      seconds = seconds + one_seconds/tries
      rate = rate + one_rate/tries
    end do
  end subroutine calibrate

  !> Runs a task for a short while. Its time is that of a processor, so that other work on the
  !> machine does not count.
  subroutine try(task, seconds, rate, error)
    type(task_type), intent(in) :: task
    real(dp), intent(out) :: seconds, rate
    type(error_type), allocatable, intent(out) :: error
    type(simulation_type) :: simulation
    type(particles_type) :: particles
    real(dp) :: began, spent, elapsed
    integer(int64) :: before

    if (task%initial_file == '') then
      call random_particles(task%setup%table, task%number, task%urn1_number, task%seed, particles, &
        error)
    else
      call read_particles(task%initial_file, task%setup%table, task%number, particles, error)
    end if
    if (allocated(error)) return
    call begin_simulation(simulation, task%setup, particles, error)
    if (allocated(error)) return
    began = cpu_seconds()
    before = simulation%engine%collisions()
    elapsed = real(simulation%elapsed, dp)
    do
      call step(simulation)
      spent = cpu_seconds() - began
      if (spent > try_seconds .or. simulation%done) exit
    end do
    rate = real(simulation%engine%collisions() - before, dp)/max(spent, 1.0e-9_dp)
    if (task%setup%duration > 0.0_wp) then
      seconds = spent*real(task%setup%duration, dp)/max(real(simulation%elapsed, dp) - elapsed, &
        tiny(1.0_dp))
    else
      seconds = real(task%setup%collisions, dp)/max(rate, 1.0e-9_dp)
    end if
  end subroutine try

end module battery_outlook

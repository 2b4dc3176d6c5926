!> The speed of a plan's tasks, from a few that are tried for a short while.
module battery_calibration
  use battery_kinds, only: wp, dp, int64
  use battery_clocks, only: cpu_seconds
  use battery_engine, only: particles_type
  use battery_error, only: error_type
  use battery_plan, only: plan_type
  use battery_signals, only: stop_requested, stopped_before_start
  use battery_simulation, only: simulation_type, begin_simulation, step
  use battery_task, only: task_type, place_particles
  use battery_tasks, only: task_count, task_of
  implicit none (type, external)
  private
  public :: calibrate

  !> Tasks tried for the calibration, and seconds spent on each.
  integer, parameter :: most_tries = 5
  real(dp), parameter :: try_seconds = 0.4_dp

contains

  !> Mean seconds a task will take, and collisions a second, from a few tasks spread over the plan.
  subroutine calibrate(plan, most, seconds, rate, error)
    type(plan_type), intent(in) :: plan
    !> Particles of the largest task that there is memory for; larger ones are passed over.
    integer, intent(in) :: most
    !> Of a processor a task; collisions a second.
    real(dp), intent(out) :: seconds, rate
    type(error_type), allocatable, intent(out) :: error
    type(task_type) :: task
    integer :: tries, tried, k
    real(dp) :: one_seconds, one_rate

    tries = min(most_tries, task_count(plan))
    tried = 0
    seconds = 0.0_dp
    rate = 0.0_dp
    do k = 1, tries
      task = task_of(plan, 1 + int(int(task_count(plan) - 1, int64)*(k - 1)/max(tries - 1, 1)))
      if (task%number > most) cycle
      call try(task, plan%start, one_seconds, one_rate, error)
      if (allocated(error)) return
      tried = tried + 1
      seconds = seconds + one_seconds
      rate = rate + one_rate
    end do
    seconds = seconds/max(tried, 1)
    rate = rate/max(tried, 1)
  end subroutine calibrate

  !> Runs a task for a short while. Its time is that of a processor, so that other work on the
  !> machine does not count.
  subroutine try(task, start, seconds, rate, error)
    type(task_type), intent(in) :: task
    !> What the initial file says.
    type(particles_type), intent(in) :: start
    real(dp), intent(out) :: seconds, rate
    type(error_type), allocatable, intent(out) :: error
    type(simulation_type) :: simulation
    type(particles_type) :: particles
    real(dp) :: began, spent, elapsed
    integer(int64) :: before

    call place_particles(task, start, particles, error)
    if (allocated(error)) return
    call begin_simulation(simulation, task%setup, particles, error)
    if (allocated(error)) return
    began = cpu_seconds()
    before = simulation%engine%collisions()
    elapsed = real(simulation%elapsed, dp)
    do
      call step(simulation)
      spent = cpu_seconds() - began
      if (stop_requested()) then
        call stopped_before_start(error)
        return
      end if
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

end module battery_calibration

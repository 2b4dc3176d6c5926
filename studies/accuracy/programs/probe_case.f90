!> A case of the stability table: runs it, and prints its line.
module battery_probe_case
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_value, ieee_quiet_nan
  use battery_kinds, only: wp, dp, int64
  use battery_error, only: error_type
  use battery_text, only: to_text
  use battery_table, only: table_type, chamber_at, outside
  use battery_initial_state, only: random_particles
  use battery_sampling, only: event_log_type, append_events
  use battery_engine, only: engine_type, particles_type
  use battery_event_record, only: event_record_type
  use battery_clocks, only: wall_seconds
  use battery_probe, only: precision_name, start_engine, json_list, print_json_line, &
    stop_with_message
  implicit none (type, external)
  private
  public :: case_type, run_case, print_case, crossings, one_particle_at, first_event_time, &
    random_in_urns
  public :: engine_name, step, time_limit

  !> Approximate number of wall hits in a window; the time limit is tested after each window.
  real(wp), parameter :: window_hits = 1.0e4_wp

  !> A case: its parameters, and its results so far.
  type :: case_type
    character(len=:), allocatable :: name
    real(wp) :: parameter = 0.0_wp
    type(table_type) :: table
    !> Threshold of both gates, number of particles.
    integer :: threshold = 1000000, number = 0
    class(engine_type), allocatable :: engine
    !> Duration of the run, and the time it has reached; whether the time limit stopped it.
    real(wp) :: duration = 0.0_wp, reached = 0.0_wp
    logical :: stopped = .false.
    type(event_log_type) :: log
    !> Final state of the particles.
    type(particles_type) :: particles
    !> Crossings from half 1 to 2, and from half 2 to 1.
    integer(int64) :: crossings(2) = 0
    !> Time that the run took.
    real(dp) :: seconds = 0.0_dp
  end type case_type

  !> Engine of all cases; time step of the engine `timestep`.
  character(len=:), allocatable :: engine_name
  real(wp), parameter :: step = 1.0e-3_wp
  !> Time limit of a case, in seconds.
  real(dp) :: time_limit = 0.3_dp

contains

  !> Runs a case to its end or to the time limit.
  subroutine run_case(one, name, parameter, table, threshold, particles, duration, hit_rate, clock)
    type(case_type), intent(out) :: one
    character(len=*), intent(in) :: name
    !> Parameter that is printed; duration; upper bound of the wall hits of all particles per unit
    !> time.
    real(wp), intent(in) :: parameter, duration, hit_rate
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold
    !> Initial state.
    type(particles_type), intent(in) :: particles
    !> Time at the start; default 0.
    real(wp), intent(in), optional :: clock
    type(event_record_type) :: event_record
    real(wp) :: window, added, sum_after, compensation
    real(dp) :: began

    one%name = name
    one%parameter = parameter
    one%table = table
    one%threshold = threshold
    one%number = size(particles%x)
    one%duration = duration
    call start_engine(engine_name, table, threshold, particles, step, one%engine, clock)
    event_record%logging = .true.
    window = huge(1.0_wp)
    if (hit_rate > 0.0_wp .and. (engine_name == 'collision' .or. engine_name == 'synchronous')) &
      window = window_hits/hit_rate
    compensation = 0.0_wp
    began = wall_seconds()
    do while (duration - one%reached > 4.0_wp*epsilon(1.0_wp)*duration)
      call one%engine%advance(min(duration - one%reached, window), event_record)
      call append_events(one%log, event_record, one%reached)
      one%crossings = one%crossings + [crossings(event_record, 1), crossings(event_record, 0)]
      ! Compensated summation (Kahan), since there may be millions of windows.
      added = event_record%duration - compensation
      sum_after = one%reached + added
      compensation = (sum_after - one%reached) - added
      one%reached = sum_after
      one%stopped = wall_seconds() - began > time_limit
      if (one%stopped) exit
    end do
    one%seconds = wall_seconds() - began
    call one%engine%get_particles(1, one%number, one%particles)
  end subroutine run_case

  !> Number of crossings in a window from half 1 to 2 (`odd` = 1) or from half 2 to 1 (0).
  pure function crossings(event_record, odd) result(number)
    type(event_record_type), intent(in) :: event_record
    integer, intent(in) :: odd
    integer(int64) :: number

    number = count(modulo(int(event_record%crossing(:event_record%crossings)), 2) == odd)
  end function crossings

  !> Prints the line of a case.
  subroutine print_case(one, value)
    type(case_type), intent(in) :: one
    !> Number specific to the case.
    real(wp), intent(in) :: value
    integer :: i, lost, nan, in_urn1
    real(wp) :: speed_error

    lost = 0
    nan = 0
    speed_error = 0.0_wp
    associate (p => one%particles)
      do i = 1, one%number
        if (.not. all(ieee_is_finite([p%x(i), p%y(i), p%ux(i), p%uy(i)]))) then
          nan = nan + 1
        else if (chamber_at(one%table, p%x(i), p%y(i), 1.0e4_wp*epsilon(1.0_wp)) == outside) then
          lost = lost + 1
        else
          speed_error = max(speed_error, abs(hypot(p%ux(i), p%uy(i)) - 1.0_wp))
        end if
      end do
      in_urn1 = count(p%x < 0.0_wp)
    end associate
    call print_json_line('{"case": "'//one%name//'", "parameter": '//to_text(real(one%parameter, &
      dp))//', "precision": "'//precision_name()//'", "engine": "'//engine_name//'", "ended": "' &
      //merge('stopped', 'done   ', one%stopped)//'", "reached": '//to_text(real(one%reached, dp)) &
      //', "value": '//number_text(value)//', "lost": '//to_text(lost)//', "not_a_number": ' &
      //to_text(nan)//', "speed_error": '//to_text(real(speed_error, dp))//', "trapped": ' &
      //to_text(one%engine%trapped())//', "hits": '//to_text(one%engine%collisions()) &
      //', "seconds": '//to_text(one%seconds)//', "in_urn1": '//to_text(in_urn1)//'}')
  end subroutine print_case

  !> A number with all its digits; null for NaN and infinity.
  function number_text(value) result(text)
    real(wp), intent(in) :: value
    character(len=:), allocatable :: text

    text = json_list([value])
    text = text(2:len(text) - 1)
  end function number_text

  !> One particle at (x, y), with the direction of (ux, uy) and speed 1.
  function one_particle_at(x, y, ux, uy) result(particles)
    real(wp), intent(in) :: x, y, ux, uy
    type(particles_type) :: particles
    real(wp) :: speed

    speed = hypot(ux, uy)
    particles = particles_type([x], [y], [ux/speed], [uy/speed])
  end function one_particle_at

  !> Time of the first event; NaN (null) if there is none.
  function first_event_time(one) result(time)
    type(case_type), intent(in) :: one
    real(wp) :: time

    time = ieee_value(1.0_wp, ieee_quiet_nan)
    if (size(one%log%time) > 0) time = one%log%time(1)
  end function first_event_time

  !> Particles with uniform positions in the urns, half of them in each, and uniform directions.
  function random_in_urns(table, number) result(particles)
    type(table_type), intent(in) :: table
    integer, intent(in) :: number
    type(particles_type) :: particles
    type(error_type), allocatable :: error

    call random_particles(table, number, number - number/2, 1_int64, particles, error)
    if (allocated(error)) call stop_with_message(error%message)
  end function random_in_urns

end module battery_probe_case

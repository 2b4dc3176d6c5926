!> Probes of trajectories: positions at given times, and their cost; and distances from the initial
!> positions after all velocities are reversed and the run is repeated.
module battery_probe_trajectory
  use battery_kinds, only: wp, dp, int64
  use battery_clocks, only: cpu_seconds
  use battery_error, only: error_type
  use battery_text, only: to_text
  use battery_table, only: table_type
  use battery_engine, only: engine_type, particles_type
  use battery_event_record, only: event_record_type
  use battery_sampling, only: event_log_type, append_events
  use battery_probe, only: argument, real_argument, integer_argument, precision_name, paper_table, &
    start_engine, advance_for, json_list, print_json_line, stop_with_message, read_particles
  implicit none (type, external)
  private
  public :: trajectory_main, reversal_main

  !> The cost is measured over at least this processor time, in seconds.
  real(dp), parameter :: least_seconds = 0.1_dp

  !> A case: engine and its time step, table, initial state, threshold, and times at which the
  !> positions are printed.
  type :: case_type
    character(len=:), allocatable :: engine
    real(wp) :: step = 0.0_wp
    type(table_type) :: table
    type(particles_type) :: particles
    integer :: threshold = 0
    real(wp), allocatable :: times(:)
  end type case_type

contains

  !> `trajectory ENGINE STEP FILE NUMBER THRESHOLD TIME ...`: prints a line with the positions for
  !> each time, one with the cost, and one with all events.
  subroutine trajectory_main()
    type(case_type) :: one
    class(engine_type), allocatable :: engine
    type(event_record_type) :: event_record
    type(particles_type) :: state
    type(event_log_type) :: log
    real(wp) :: elapsed
    real(dp) :: began, spent
    integer :: k

    call read_case(one, 7)
    one%threshold = int(integer_argument(6))
    call start_engine(one%engine, one%table, one%threshold, one%particles, one%step, engine)
    event_record%logging = .true.
    elapsed = 0.0_wp
    spent = 0.0_dp
    do k = 1, size(one%times)
      began = cpu_seconds()
      do while (one%times(k) - elapsed > 4.0_wp*epsilon(1.0_wp)*one%times(k))
        call engine%advance(one%times(k) - elapsed, event_record)
        call append_events(log, event_record, elapsed)
        elapsed = elapsed + event_record%duration
      end do
      spent = spent + (cpu_seconds() - began)
      call engine%get_particles(1, engine%number, state)
      call print_json_line('{"time": '//to_text(real(one%times(k), dp))//', "x": ' &
        //json_list(state%x)//', "y": '//json_list(state%y)//'}')
    end do
    spent = spent/(elapsed*engine%number)
    if (spent*elapsed*engine%number < least_seconds) spent = seconds_per_particle_time(one)
    call print_json_line('{"precision": "'//precision_name()//'", "engine": "'//one%engine &
      //'", "step": '//to_text(real(one%step, dp))//', "threshold": '//to_text(one%threshold) &
      //', "seconds_per_particle_time": '//to_text(spent)//', "trapped": ' &
      //to_text(engine%trapped())//'}')
    call print_json_line('{"event_time": '//json_list(log%time)//', "kind": ' &
      //json_list(real(log%kind, wp))//', "where": '//json_list(real(log%where, wp)) &
      //', "particle": '//json_list(real(log%particle, wp))//'}')
  end subroutine trajectory_main

  !> `reversal ENGINE STEP FILE NUMBER TIME ...`: runs the circuit without gates for each time,
  !> reverses all velocities, and runs it for the same time; prints the distance of each particle
  !> from its initial position.
  subroutine reversal_main()
    type(case_type) :: one
    class(engine_type), allocatable :: engine
    type(event_record_type) :: event_record
    type(particles_type) :: state
    integer :: k

    call read_case(one, 6)
    one%threshold = size(one%particles%x)
    do k = 1, size(one%times)
      call start_engine(one%engine, one%table, one%threshold, one%particles, one%step, engine)
      call advance_for(engine, one%times(k), event_record)
      call engine%get_particles(1, engine%number, state)
      state%ux = -state%ux
      state%uy = -state%uy
      call start_engine(one%engine, one%table, one%threshold, state, one%step, engine)
      call advance_for(engine, one%times(k), event_record)
      call engine%get_particles(1, engine%number, state)
      call print_json_line('{"precision": "'//precision_name()//'", "engine": "'//one%engine &
        //'", "time": '//to_text(real(one%times(k), dp))//', "error": '//json_list(hypot(state%x &
        - one%particles%x, state%y - one%particles%y))//'}')
    end do
  end subroutine reversal_main

  !> Reads a case from the command line; word `first` is the first of its times.
  subroutine read_case(one, first)
    type(case_type), intent(out) :: one
    integer, intent(in) :: first
    type(error_type), allocatable :: error
    integer :: k

    one%engine = argument(2)
    one%step = real_argument(3)
    one%table = paper_table(0.3_wp, 0.01_wp)
    call read_particles(argument(4), one%table, int(integer_argument(5)), one%particles, error)
    if (allocated(error)) call stop_with_message(error%message)
    one%times = [(real_argument(k), k=first, command_argument_count())]
  end subroutine read_case

  !> Processor time per particle and time unit, in seconds, from repeated runs of the case.
  function seconds_per_particle_time(one) result(seconds)
    type(case_type), intent(in) :: one
    real(dp) :: seconds
    class(engine_type), allocatable :: engine
    type(event_record_type) :: event_record
    real(dp) :: began, spent, time

    spent = 0.0_dp
    time = 0.0_dp
    do
      call start_engine(one%engine, one%table, one%threshold, one%particles, one%step, engine)
      began = cpu_seconds()
      call advance_for(engine, one%times(size(one%times)), event_record)
      spent = spent + (cpu_seconds() - began)
      time = time + real(one%times(size(one%times)), dp)
      if (spent > least_seconds) exit
    end do
    seconds = spent/(time*size(one%particles%x))
  end function seconds_per_particle_time

end module battery_probe_trajectory

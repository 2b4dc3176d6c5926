!> Probe of any table of discs: events of a run, and the final state of the particles.
module battery_probe_events
  use battery_kinds, only: wp
  use battery_error, only: error_type
  use battery_text, only: to_text
  use battery_table, only: table_type, new_table, shape_circuit, shape_urn
  use battery_engine, only: engine_type, particles_type
  use battery_event_record, only: event_record_type
  use battery_initial_state, only: read_particles
  use battery_probe, only: argument, real_argument, integer_argument, precision_name, &
    start_engine, json_list, print_json_line, stop_with_message
  implicit none (type, external)
  private
  public :: events_main

contains

  !> `events ENGINE STEP SHAPE RADIUS WIDTH1 LENGTH1 WIDTH2 LENGTH2 FILE NUMBER THRESHOLD CLOCK
  !> DURATION`: prints one line. Engines with random numbers have the seed 1.
  subroutine events_main()
    class(engine_type), allocatable :: engine
    type(event_record_type) :: event_record
    type(table_type) :: table
    type(particles_type) :: particles, state
    type(error_type), allocatable :: error
    real(wp), allocatable :: time(:)
    !> (kind, where, particle) by event.
    integer, allocatable :: event(:, :)
    real(wp) :: elapsed, duration
    integer :: k

    if (argument(4) /= 'circuit' .and. argument(4) /= 'urn') call stop_with_message('unknown shape')
    table = new_table(merge(shape_circuit, shape_urn, argument(4) == 'circuit'), &
      real_argument(5), real_argument(6), real_argument(7), real_argument(8), real_argument(9))
    call read_particles(argument(10), table, int(integer_argument(11)), particles, error)
    if (allocated(error)) call stop_with_message(error%message)
    call start_engine(argument(2), table, int(integer_argument(12)), particles, real_argument(3), &
      engine, real_argument(13))
    duration = real_argument(14)
    event_record%logging = .true.
    allocate (time(0), event(3, 0))
    elapsed = 0.0_wp
    do while (duration - elapsed > 4.0_wp*epsilon(1.0_wp)*duration)
      call engine%advance(duration - elapsed, event_record)
      do k = 1, event_record%events
        time = [time, elapsed + event_record%event_time(k)]
        event = reshape([event, int(event_record%event_kind(k)), int(event_record%event_where(k)), &
          int(event_record%event_particle(k))], [3, size(time)])
      end do
      elapsed = elapsed + event_record%duration
    end do
    call engine%get_particles(1, engine%number, state)
    call print_json_line('{"precision": "'//precision_name()//'", "engine": "'//argument(2) &
      //'", "trapped": '//to_text(engine%trapped())//', "hits": '//to_text(engine%collisions()) &
      //', "time": '//json_list(time)//', "kind": '//json_list(real(event(1, :), wp)) &
      //', "where": '//json_list(real(event(2, :), wp))//', "particle": '//json_list(real(event(3, &
      :), wp))//', "x": '//json_list(state%x)//', "y": '//json_list(state%y)//', "ux": ' &
      //json_list(state%ux)//', "uy": '//json_list(state%uy)//'}')
  end subroutine events_main

end module battery_probe_events

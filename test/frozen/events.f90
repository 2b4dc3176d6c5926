!> The events of a run, and the final state of its particles, in the precision that the program was
!> built with. Reads two lines,
!>
!>     engine shape file
!>     number threshold time_step radius width1 length1 width2 length2 start_time duration
!>
!> with a file of initial states; engines with random numbers have the seed 1. Prints a line
!> `event kind where particle time` for each event, then a line `final x y ux uy` for each particle.
program events
  use, intrinsic :: iso_fortran_env, only: input_unit, output_unit
  use battery_kinds, only: wp
  use battery_error, only: error_type
  use battery_table, only: table_type, new_table, shape_circuit, shape_urn
  use battery_engine, only: engine_type, particles_type
  use battery_engines, only: new_engine
  use battery_event_record, only: event_record_type
  use battery_file_text, only: read_file
  use battery_initial_state, only: parse_particles
  implicit none (type, external)
  class(engine_type), allocatable :: engine
  type(event_record_type) :: event_record
  type(table_type) :: table
  type(particles_type) :: particles
  type(error_type), allocatable :: error
  character(len=1024) :: name, shape, file
  character(len=:), allocatable :: text
  real(wp) :: time_step, radius, width1, length1, width2, length2, start_time, duration, elapsed
  integer :: number, threshold, i

  read (input_unit, *) name, shape, file
  read (input_unit, *) number, threshold, time_step, radius, width1, length1, width2, length2, &
    start_time, duration
  table = new_table(merge(shape_circuit, shape_urn, shape == 'circuit'), radius, width1, length1, &
    width2, length2)
  call read_file(trim(file), text, error)
  if (.not. allocated(error)) &
    call parse_particles(text, trim(file), table, number, particles, error)
  if (.not. allocated(error)) call new_engine(trim(name), engine, error)
  if (allocated(error)) error stop error%message
  engine%time_step = time_step
  engine%seed = 1
  call engine%start(table, [threshold, threshold], particles, start_time)
  event_record%logging = .true.
  elapsed = 0.0_wp
  do while (duration - elapsed > 4.0_wp*epsilon(1.0_wp)*duration)
    call engine%advance(duration - elapsed, event_record)
    do i = 1, event_record%events
      associate (event => event_record%event(i))
        write (output_unit, '(a, 3(1x, i0), es48.36e4)') 'event', event%kind, event%where, &
          event%particle, elapsed + event%time
      end associate
    end do
    elapsed = elapsed + event_record%duration
  end do
  call engine%get_particles(1, number, particles)
  do i = 1, number
    write (output_unit, '(a, 4es48.36e4)') 'final', particles%x(i), particles%y(i), &
      particles%ux(i), particles%uy(i)
  end do
end program events

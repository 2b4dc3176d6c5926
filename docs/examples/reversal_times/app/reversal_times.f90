!> How long it takes from one reversal of a gate to its next, in the circuit of the paper with 1000
!> particles and T = 7, from an even start: what `battery` counts, but does not time.
program reversal_times
  use battery_kinds, only: wp, int64
  use battery_error, only: error_type
  use battery_table, only: table_type, new_table, shape_circuit
  use battery_initial_state, only: random_particles
  use battery_engine, only: engine_type, particles_type
  use battery_engines, only: new_engine
  use battery_event_record, only: event_record_type, event_reversal
  implicit none (type, external)
  class(engine_type), allocatable :: engine
  type(table_type) :: table
  type(particles_type) :: particles
  type(event_record_type) :: event_record
  type(error_type), allocatable :: error
  real(wp), parameter :: duration = 2000.0_wp
  real(wp) :: last(2) = -1.0_wp, begin, time, mean
  real(wp), allocatable :: waits(:)
  integer :: event

  table = new_table(shape_circuit, 1.0_wp, 0.3_wp, 1.0_wp, 0.01_wp, 1.0_wp)
  call random_particles(table, 1000, 500, 1_int64, particles, error)
  if (.not. allocated(error)) call new_engine('excursion', engine, error)
  if (allocated(error)) error stop error%message
  call engine%start(table, [7, 7], particles, 0.0_wp)
  event_record%logging = .true.
  allocate (waits(0))
  do while (engine%clock() < duration)
    begin = engine%clock()
    call engine%advance(duration - begin, event_record)
    do event = 1, event_record%events
      if (event_record%event(event)%kind /= event_reversal) cycle
      time = begin + event_record%event(event)%time
      associate (before => last(event_record%event(event)%where))
        if (before >= 0.0_wp) waits = [waits, time - before]
        before = time
      end associate
    end do
  end do
  mean = sum(waits)/size(waits)
  print '(i0, a)', size(waits), ' times between reversals of the same gate'
  print '(2(a, f8.6))', 'mean ', mean, ', their spread ', sqrt(sum((waits - mean)**2)/size(waits))

end program reversal_times

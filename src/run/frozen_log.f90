!> Frozen event logs: stored events of runs in quadruple precision. Every build must find the same
!> events in the same order, and times and positions within the tolerances of the log. The tests and
!> `battery --self-test` use the same comparison.
!>
!> A log consists of lines of numbers (made by `test/frozen/freeze.py`):
!>
!>     number of particles, number of events, threshold, shape (1: circuit, 2: urn)
!>     duration, tolerance of times, tolerance of places, time step
!>     urn radius, width and length of channel 1, width and length of channel 2
!>     x, y, ux, uy of each particle at the start
!>     kind, where, particle, time of each event
!>     x, y, ux, uy of each particle at the end
module battery_frozen_log
  use battery_kinds, only: wp, int64
  use battery_engine, only: particles_type
  use battery_error, only: error_type
  use battery_simulation, only: setup_type, simulation_type, begin_simulation, advance_simulation, &
    verify_simulation
  use battery_table, only: new_table
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: frozen_log_type, read_frozen_log, find_difference, is_final_state

  !> A log, and the run that it belongs to; any engine may repeat the run.
  type :: frozen_log_type
    type(setup_type) :: setup
    type(particles_type) :: start
    !> (kind, where, particle) of each event.
    integer, allocatable :: events(:, :)
    real(wp), allocatable :: times(:)
    !> (x, y, ux, uy) of each particle at the end.
    real(wp), allocatable :: final(:, :)
    real(wp) :: time_tolerance = 0.0_wp, final_tolerance = 0.0_wp
  end type frozen_log_type

contains

  !> Reads a log.
  subroutine read_frozen_log(lines, log)
    !> Lines as described above; they belong to the project and are not checked.
    character(len=*), intent(in) :: lines(:)
    !> Contents of the log.
    type(frozen_log_type), intent(out) :: log
    real(wp) :: lengths(5)
    real(wp), allocatable :: start(:, :)
    integer :: number, events, threshold, shape, k

    read (lines(1), *) number, events, threshold, shape
    allocate (start(4, number), log%final(4, number), log%events(3, events), log%times(events), &
      log%setup%snapshot_times(0))
    log%setup%threshold = threshold
    read (lines(2), *) log%setup%duration, log%time_tolerance, log%final_tolerance, &
      log%setup%time_step
    read (lines(3), *) lengths
    do k = 1, number
      read (lines(3 + k), *) start(:, k)
      read (lines(3 + number + events + k), *) log%final(:, k)
    end do
    do k = 1, events
      read (lines(3 + number + k), *) log%events(:, k), log%times(k)
    end do
    log%setup%seed = 1_int64
    log%setup%event_log = .true.
    log%setup%table = new_table(shape, lengths(1), lengths(2), lengths(3), lengths(4), lengths(5))
    log%start = particles_of(start)
  end subroutine read_frozen_log

  !> Particles from columns of (x, y, ux, uy); the speed becomes 1.
  pure function particles_of(columns) result(particles)
    real(wp), intent(in) :: columns(:, :)
    type(particles_type) :: particles
    real(wp), allocatable :: speed(:)

    speed = hypot(columns(3, :), columns(4, :))
    ! Separate assignments: gfortran 12 loses the stride of a row in a structure constructor.
    particles%x = columns(1, :)
    particles%y = columns(2, :)
    particles%ux = columns(3, :)/speed
    particles%uy = columns(4, :)/speed
  end function particles_of

  !> Repeats the run of a log with an engine, and describes the first difference; empty if there is
  !> none.
  function find_difference(log, engine) result(problem)
    !> The run and its events.
    type(frozen_log_type), intent(in) :: log
    !> Name of the engine.
    character(len=*), intent(in) :: engine
    character(len=:), allocatable :: problem
    !> More windows than any of these runs takes.
    integer, parameter :: most_windows = 100000
    type(setup_type) :: setup
    type(simulation_type) :: simulation
    type(particles_type) :: particles, final
    type(error_type), allocatable :: error
    integer :: window, k, same
    logical :: alike

    setup = log%setup
    setup%engine = engine
    particles = log%start
    call begin_simulation(simulation, setup, particles, error)
    if (.not. allocated(error)) then
      do window = 1, most_windows
        if (simulation%done) exit
        call advance_simulation(simulation)
      end do
      call verify_simulation(simulation, error)
    end if
    problem = ''
    if (allocated(error)) then
      problem = error%message
      return
    else if (.not. simulation%done) then
      problem = 'the run does not end'
      return
    end if
    associate (recorded => simulation%events)
      same = 0
      do k = 1, min(recorded%count, size(log%times))
        alike = all(log%events(:, k) == [recorded%event(k)%kind, recorded%event(k)%where, &
          recorded%event(k)%particle]) .and. abs(recorded%event(k)%time - log%times(k)) <= &
          log%time_tolerance
        if (.not. alike) exit
        same = k
      end do
      if (same < max(recorded%count, size(log%times))) then
        problem = 'event '//to_text(same + 1)//' of '//to_text(size(log%times))//' differs'
        return
      end if
    end associate
    call simulation%engine%get_particles(1, simulation%engine%number, final)
    if (.not. is_final_state(log, final%x, final%y, final%ux, final%uy)) &
      problem = 'the final state differs'
  end function find_difference

  !> Whether all particles are in the final state of the log.
  pure logical function is_final_state(log, x, y, ux, uy) result(yes)
    !> The run and its events.
    type(frozen_log_type), intent(in) :: log
    !> Positions (length) and velocities (1), shape (particle).
    real(wp), intent(in) :: x(:), y(:), ux(:), uy(:)

    yes = size(x) == size(log%final, 2)
    if (yes) yes = all(abs(x - log%final(1, :)) <= log%final_tolerance) .and. &
      all(abs(y - log%final(2, :)) <= log%final_tolerance) .and. &
      all(abs(ux - log%final(3, :)) <= log%final_tolerance) .and. &
      all(abs(uy - log%final(4, :)) <= log%final_tolerance)
  end function is_final_state

end module battery_frozen_log

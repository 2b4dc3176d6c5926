!> One simulation from start to end: an engine, an observer, and the conditions for its end.
!>
!> The length of a run is a number of wall collisions or a time; so is the length of the transient
!> at its start, which is excluded from the averages. `advance_simulation` advances by one window,
!> so that the caller can save the state, show the progress or stop between two windows.
module battery_simulation
  use battery_kinds, only: wp, dp, int32, int64
  use battery_powers, only: power_below
  use battery_text, only: to_text
  use battery_error, only: error_type, fatal_error
  use battery_table, only: channel2, relaxation_time, even_difference, chamber_at, outside, &
    half_length
  use battery_engine, only: engine_type, particles_type, allocate_particles
  use battery_event_record, only: event_record_type
  use battery_observer, only: end_series, observer_type, new_observer, observe_window, &
    begin_measuring, measured_time, serialize_observer
  use battery_engines, only: new_engine, explain_refusal, bytes_per_particle
  use battery_event_log, only: event_log_type, append_events, serialize_events
  use battery_archive, only: archive_type
  use battery_available_memory, only: need_type, check_memory, most_kept
  use battery_setup, only: setup_type
  implicit none (type, external)
  private
  public :: simulation_type, begin_simulation, advance_simulation, progress, verify_simulation
  public :: serialize_simulation

  !> State of one simulation.
  type :: simulation_type
    type(setup_type) :: setup
    class(engine_type), allocatable :: engine
    type(observer_type) :: observer
    type(event_record_type) :: event_record
    !> Time since the start, from the clock of the engine: a sum of windows would drift.
    real(wp) :: elapsed = 0.0_wp
    !> Time and collisions of the transient, once it is over.
    real(wp) :: transient_time = 0.0_wp
    integer(int64) :: transient_collisions = 0
    !> Total number of collisions, exact once the run is done.
    integer(int64) :: collisions = 0
    logical :: done = .false.
    !> An engine computes some collisions before they happen. The exact count, which takes a loop
    !> over all particles, is taken again when the observer has this many.
    integer(int64) :: next_count = 0
    !> Number of windows since the last exact count.
    integer :: windows_since_count = 0
    integer :: snapshots_taken = 0
    !> Snapshots as (particle, snapshot).
    type(particles_type), allocatable :: snapshot(:)
    type(event_log_type) :: events
    !> Whether the run was ended because its series or its event log outgrew the memory; number of
    !> entries and events for which the memory need not be checked.
    logical :: out_of_room = .false.
    integer(int64) :: unchecked_length = 1000000
  end type simulation_type

  !> Relative rounding error of the engine's clock at the end of a window of a given duration.
  real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp)

  !> Largest number of series entries in one window: signals are noticed between windows.
  integer, parameter :: most_entries = 2**20

  !> Largest number of windows between two exact counts of the collisions.
  integer, parameter :: windows_between_counts = 20000

contains

  !> Starts a simulation from `particles`, whose arrays may be freed.
  subroutine begin_simulation(simulation, setup, particles, error)
    type(simulation_type), intent(out) :: simulation
    type(setup_type), intent(in) :: setup
    type(particles_type), intent(inout) :: particles
    type(error_type), allocatable, intent(out) :: error

    call make_engine(simulation, setup, error)
    if (allocated(error)) return
    simulation%observer = new_observer(size(particles%x), count(particles%x < 0.0_wp), &
      setup%table%urn_count == 2, setup%series_interval, &
      power_below(maxval(setup%table%urn%reach)), &
      channel2_open=setup%table%channel(channel2)%width > 0.0_wp, &
      relaxation=relaxation_time(setup%table))
    simulation%observer%even_difference = even_difference(setup%table)
    call check_remaining_memory(simulation, error)
    if (allocated(error)) return
    ! The snapshot at the start has the given particles, without the rounding of the engine.
    if (next_snapshot_time(simulation) <= 0.0_wp) then
      simulation%snapshots_taken = 1
      simulation%snapshot(1) = particles
    end if
    call simulation%engine%start(setup%table, setup%threshold, particles, setup%start_time)
    if (.not. setup%duration > 0.0_wp) then
      if (setup%transient_collisions <= 0) call end_transient(simulation, 0_int64)
      simulation%next_count = target_collisions(simulation)
    end if
    call process_stops(simulation)
  end subroutine begin_simulation

  !> Makes the engine of a setup, not yet started, if it can simulate the table; allocates the
  !> snapshots.
  subroutine make_engine(simulation, setup, error)
    type(simulation_type), intent(inout) :: simulation
    type(setup_type), intent(in) :: setup
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: reason, others

    simulation%setup = setup
    simulation%event_record%logging = setup%event_log
    allocate (simulation%snapshot(size(setup%snapshot_times)))
    call new_engine(setup%engine, simulation%engine, error)
    if (allocated(error)) return
    simulation%engine%time_step = setup%time_step
    simulation%engine%seed = setup%seed
    call explain_refusal(simulation%engine, setup%table, reason, others)
    if (reason /= '') call fatal_error(error, 'the engine '''//setup%engine//''' '//reason &
      //'; allowed: '//others)
  end subroutine make_engine

  !> An error if there is no memory for the engine, the snapshots and, if its length is known, the
  !> series, in addition to the particles.
  subroutine check_remaining_memory(simulation, error)
    type(simulation_type), intent(in) :: simulation
    type(error_type), allocatable, intent(out) :: error
    !> Bytes of the positions and velocities of a particle.
    real(dp), parameter :: particle_bytes = 32.0_dp
    type(need_type) :: need

    associate (setup => simulation%setup, number => simulation%observer%number)
      need%bytes = (bytes_per_particle(setup%engine, any(setup%table%urn%truncates_passages)) &
        - particle_bytes)*number
      need%states = real(size(setup%snapshot_times), dp)*number
      if (setup%series_interval > 0.0_wp .and. setup%duration > 0.0_wp) &
        need%entries = real(setup%duration/setup%series_interval, dp)
      call check_memory(need, 'the engine of '//to_text(number) &
        //' particles, their snapshots and series', error)
    end associate
  end subroutine check_remaining_memory

  !> Ends the run if there is no memory for a series and an event log of twice the present length.
  subroutine stop_if_out_of_memory(simulation)
    type(simulation_type), intent(inout) :: simulation
    type(error_type), allocatable :: error

    associate (s => simulation)
      if (int(s%observer%entries, int64) + s%events%count < s%unchecked_length .and. &
        .not. (s%out_of_room .or. s%observer%out_of_room)) return
      call check_memory(need_type(entries=2.0_dp*s%observer%entries, &
        events=2.0_dp*s%events%count), 'series and events', error)
      s%out_of_room = s%out_of_room .or. s%observer%out_of_room .or. allocated(error) .or. &
        max(s%observer%entries, s%events%count) > most_kept
      s%unchecked_length = 2*s%unchecked_length
      if (s%out_of_room) s%done = .true.
    end associate
  end subroutine stop_if_out_of_memory

  !> Advances a simulation by one window.
  subroutine advance_simulation(simulation)
    type(simulation_type), intent(inout) :: simulation
    real(wp) :: until_entry

    until_entry = time_until_entry(simulation)
    call simulation%engine%advance(time_to_stop(simulation), simulation%event_record)
    call observe_window(simulation%observer, simulation%event_record, until_entry)
    if (simulation%event_record%events > 0) &
      call append_events(simulation%events, simulation%event_record, simulation%elapsed, &
      simulation%out_of_room)
    call stop_if_out_of_memory(simulation)
    simulation%elapsed = simulation%engine%elapsed()
    if (simulation%setup%duration > 0.0_wp) then
      call process_stops(simulation)
    else
      call take_snapshots(simulation)
      call count_collisions(simulation)
    end if
  end subroutine advance_simulation

  !> Time until the run must be exactly at a snapshot, the end of the transient, or its own end.
  pure real(wp) function time_to_stop(simulation) result(time)
    type(simulation_type), intent(in) :: simulation

    time = huge(1.0_wp)
    if (simulation%setup%series_interval > 0.0_wp) &
      time = most_entries*simulation%setup%series_interval
    associate (engine => simulation%engine, setup => simulation%setup)
      time = min(time, engine%time_until(next_snapshot_time(simulation)))
      if (setup%duration > 0.0_wp) then
        time = min(time, engine%time_until(setup%duration))
        if (.not. simulation%observer%measuring) &
          time = min(time, engine%time_until(setup%transient_duration))
      end if
    end associate
  end function time_to_stop

  !> Time until the next entry of the series; huge: there is none.
  pure real(wp) function time_until_entry(simulation) result(time)
    type(simulation_type), intent(in) :: simulation

    time = huge(1.0_wp)
    associate (observer => simulation%observer)
      if (observer%series_interval > 0.0_wp) time = simulation%engine%time_until( &
        real(observer%entries, wp)*observer%series_interval)
    end associate
  end function time_until_entry

  !> Time of the next snapshot since the start; huge: there is none.
  pure real(wp) function next_snapshot_time(simulation) result(time)
    type(simulation_type), intent(in) :: simulation

    time = huge(1.0_wp)
    associate (times => simulation%setup%snapshot_times, next => simulation%snapshots_taken + 1)
      if (next <= size(times)) time = times(next)
    end associate
  end function next_snapshot_time

  !> Whether the time `time` since the start has been reached, up to the rounding of the clock.
  pure logical function has_reached(simulation, time)
    type(simulation_type), intent(in) :: simulation
    real(wp), intent(in) :: time

    has_reached = simulation%engine%time_until(time) <= rounding*simulation%engine%now
  end function has_reached

  !> Stores the snapshots that are due.
  subroutine take_snapshots(simulation)
    type(simulation_type), intent(inout) :: simulation

    do while (has_reached(simulation, next_snapshot_time(simulation)))
      simulation%snapshots_taken = simulation%snapshots_taken + 1
      call simulation%engine%get_particles(1, simulation%engine%number, &
        simulation%snapshot(simulation%snapshots_taken))
    end do
  end subroutine take_snapshots

  !> Takes the snapshots that are due, and ends the transient or the run if they are set by time and
  !> their time is reached.
  subroutine process_stops(simulation)
    type(simulation_type), intent(inout) :: simulation

    call take_snapshots(simulation)
    if (.not. simulation%setup%duration > 0.0_wp) return
    if (.not. simulation%observer%measuring) then
      if (has_reached(simulation, simulation%setup%transient_duration)) &
        call end_transient(simulation, simulation%engine%collisions())
    end if
    if (has_reached(simulation, simulation%setup%duration)) then
      call end_series(simulation%observer, simulation%setup%duration)
      simulation%collisions = simulation%engine%collisions()
      simulation%done = .true.
    end if
  end subroutine process_stops

  !> Ends the transient after `collisions` wall collisions: the averages begin.
  subroutine end_transient(simulation, collisions)
    type(simulation_type), intent(inout) :: simulation
    integer(int64), intent(in) :: collisions

    simulation%transient_time = simulation%elapsed
    simulation%transient_collisions = collisions
    call begin_measuring(simulation%observer)
  end subroutine end_transient

  !> Number of collisions at which the present part of the run (transient or measurement) ends.
  pure integer(int64) function target_collisions(simulation) result(collisions)
    type(simulation_type), intent(in) :: simulation

    collisions = merge(simulation%setup%collisions, simulation%setup%transient_collisions, &
      simulation%observer%measuring)
  end function target_collisions

  !> Ends the transient or the run once the exact count has reached its target. The observer's count
  !> may include future collisions, and the exact count is expensive: it is taken only when the
  !> target may have been reached.
  subroutine count_collisions(simulation)
    type(simulation_type), intent(inout) :: simulation
    integer(int64) :: exact

    simulation%windows_since_count = simulation%windows_since_count + 1
    if (simulation%observer%collisions < simulation%next_count .and. &
      simulation%windows_since_count < windows_between_counts) return
    simulation%windows_since_count = 0
    exact = simulation%engine%collisions()
    if (exact >= target_collisions(simulation) .and. .not. simulation%observer%measuring) &
      call end_transient(simulation, exact)
    if (exact >= simulation%setup%collisions) then
      call end_series(simulation%observer, simulation%elapsed)
      simulation%collisions = exact
      simulation%done = .true.
    end if
    simulation%next_count = simulation%observer%collisions &
      + max(target_collisions(simulation) - exact, 0_int64)
  end subroutine count_collisions

  !> Completed fraction of the run, 0 to 1.
  pure real(wp) function progress(simulation) result(share)
    type(simulation_type), intent(in) :: simulation

    if (simulation%done) then
      share = 1.0_wp
    else if (simulation%setup%duration > 0.0_wp) then
      share = simulation%elapsed/simulation%setup%duration
    else
      share = real(simulation%observer%collisions, wp)/real(max(simulation%setup%collisions, &
        1_int64), wp)
    end if
    share = min(share, 1.0_wp)
  end function progress

  !> Checks the end of a run: it must not have been ended for lack of memory, all particles must be
  !> inside the table, and there must be averages: a single window may have more wall collisions
  !> than transient and measurement together.
  subroutine verify_simulation(simulation, error)
    type(simulation_type), intent(in) :: simulation
    !> The run was ended early, has no averages, or failed the check of its particles.
    type(error_type), allocatable, intent(out) :: error

    if (simulation%out_of_room) then
      call fatal_error(error, 'no memory for the series and the event log: ended after ' &
        //to_text(simulation%observer%entries)//' entries and '//to_text(simulation%events%count) &
        //' events; a longer &output series_interval, no event_log or a shorter run needs less')
    else if (simulation%done .and. .not. measured_time(simulation%observer) > 0.0_wp) then
      call fatal_error(error, 'nothing is left for the averages: the transient of ' &
        //to_text(simulation%setup%transient_collisions)//' wall collisions ended with the run, ' &
        //'after '//to_text(simulation%collisions)//'; more &run collisions are needed')
    else
      call check_particles(simulation, error)
    end if
  end subroutine verify_simulation

  !> Checks that all particles are inside the table at speed 1, up to the resolution of coordinates,
  !> and that the number in each half agrees with the crossings. A particle on a counted line may
  !> count for either half: events at the very end of the run are not processed.
  subroutine check_particles(simulation, error)
    type(simulation_type), intent(in) :: simulation
    type(error_type), allocatable, intent(out) :: error
    integer, parameter :: chunk = 65536
    real(wp), parameter :: share = 1.0e4_wp*epsilon(1.0_wp)
    type(particles_type) :: particles
    real(wp) :: tolerance, ends
    integer :: first, last, i, lost, off_speed, urn1_number, on_line
    character(len=200) :: text

    ends = half_length(simulation%setup%table)
    tolerance = share*ends
    lost = 0
    off_speed = 0
    urn1_number = 0
    on_line = 0
    do first = 1, simulation%engine%number, chunk
      last = min(first + chunk - 1, simulation%engine%number)
      call simulation%engine%get_particles(first, last, particles)
      do i = 1, last - first + 1
        if (chamber_at(simulation%setup%table, particles%x(i), particles%y(i), tolerance) &
          == outside) lost = lost + 1
        if (.not. abs(hypot(particles%ux(i), particles%uy(i)) - 1.0_wp) <= share) &
          off_speed = off_speed + 1
        if (min(abs(particles%x(i)), ends - abs(particles%x(i))) <= tolerance) then
          on_line = on_line + 1
        else if (particles%x(i) < 0.0_wp) then
          urn1_number = urn1_number + 1
        end if
      end do
    end do
    if (simulation%observer%has_two_urns) then
      ! Particles on a line are assigned so that the numbers agree, if they can.
      urn1_number = max(urn1_number, min(urn1_number + on_line, simulation%observer%urn1_number))
    else
      urn1_number = simulation%observer%urn1_number
    end if
    if (lost == 0 .and. off_speed == 0 .and. urn1_number == simulation%observer%urn1_number) return
    write (text, '(a, i0, a, i0, a, i0, a, i0, a)') 'check at the end of the run failed: ', lost, &
      ' particles outside the table, ', off_speed, ' with a speed that is not 1, ', urn1_number, &
      ' in half 1 where the crossings leave ', simulation%observer%urn1_number, &
      '; please report this with the namelist'
    call fatal_error(error, trim(text))
  end subroutine check_particles

  !> Saves or restores all that is needed to continue to the same last bit. A state is read for the
  !> setup that it was written for; the previous state of `simulation` is lost.
  subroutine serialize_simulation(simulation, setup, archive, error)
    type(simulation_type), intent(inout) :: simulation
    type(setup_type), intent(in) :: setup
    type(archive_type), intent(inout) :: archive
    !> The state does not fit, or the engine cannot be made.
    type(error_type), allocatable, intent(out) :: error

    if (archive%reading) call make_engine(simulation, setup, error)
    if (allocated(error)) return
    call serialize_observer(simulation%observer, archive)
    ! Those of a state of an earlier version were others.
    simulation%observer%even_difference = even_difference(setup%table)
    simulation%observer%relaxation = relaxation_time(setup%table)
    if (archive%reading .and. .not. archive%failed()) call check_remaining_memory(simulation, error)
    if (allocated(error)) return
    if (.not. archive%failed()) call simulation%engine%serialize_state(setup%table, &
      setup%threshold, archive)
    call archive%serialize('elapsed', simulation%elapsed)
    ! Older versions saved a sum of windows.
    if (archive%reading .and. .not. archive%failed()) simulation%elapsed = &
      simulation%engine%elapsed()
    call archive%serialize('transient_time', simulation%transient_time)
    call archive%serialize('transient_collisions', simulation%transient_collisions)
    call archive%serialize('collisions', simulation%collisions)
    call archive%serialize('done', simulation%done)
    call archive%serialize('next_count', simulation%next_count)
    call archive%serialize('windows_since_count', simulation%windows_since_count)
    call serialize_snapshots(simulation, archive)
    call serialize_events(simulation%events, archive)
    if (archive%failed()) call fatal_error(error, archive%problem)
  end subroutine serialize_simulation

  !> Saves or restores the snapshots taken so far.
  subroutine serialize_snapshots(simulation, archive)
    type(simulation_type), intent(inout) :: simulation
    type(archive_type), intent(inout) :: archive
    integer :: k

    call archive%serialize('snapshots_taken', simulation%snapshots_taken)
    if (archive%failed()) return
    do k = 1, simulation%snapshots_taken
      associate (snapshot => simulation%snapshot(k))
        if (archive%reading) call allocate_particles(snapshot, simulation%engine%number)
        call archive%serialize('x', snapshot%x, 'y', snapshot%y, 'ux', snapshot%ux, 'uy', &
          snapshot%uy)
      end associate
    end do
  end subroutine serialize_snapshots

end module battery_simulation

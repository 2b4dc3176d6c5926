!> Starts engines in tests, runs them with a log of all events, saves and restores them.
module engine_runs
  use battery_kinds, only: wp, int64
  use battery_table, only: table_type
  use battery_engine, only: engine_type, particles_type
  use battery_engines, only: new_engine
  use battery_error, only: error_type
  use battery_event_record, only: event_record_type
  use battery_archive, only: archive_type, new_archive, archive_of
  implicit none (type, external)
  private
  public :: begin, log_type, run_for, totals_of, append_window, extend_log, append_event
  public :: save_engine, restore_engine

  !> Events in chronological order, with their times since the start.
  type :: log_type
    integer :: events = 0
    real(wp), allocatable :: time(:)
    integer, allocatable :: kind(:), where(:), particle(:)
    !> Time simulated, number of windows, and sums over the event records of all windows.
    real(wp) :: elapsed = 0.0_wp
    integer :: windows = 0
    integer(int64) :: collisions = 0, reversals = 0, bounce_backs = 0
    !> Number of crossings of each kind.
    integer :: crossings(4) = 0
    !> Integral of |N1 - N2| over time, and N1 as it follows from the crossings.
    real(wp) :: spread = 0.0_wp
    integer :: first = 0
  end type log_type

contains

  !> Creates an engine by its name and starts it at the time 0 with a copy of the particles.
  subroutine begin(name, table, threshold, particles, engine, seed)
    character(len=*), intent(in) :: name
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold(2)
    type(particles_type), intent(in) :: particles
    class(engine_type), allocatable, intent(out) :: engine
    integer(int64), intent(in), optional :: seed
    type(error_type), allocatable :: error
    type(particles_type) :: given

    call new_engine(trim(name), engine, error)
    engine%time_step = 1.0e-4_wp
    engine%seed = 5_int64
    if (present(seed)) engine%seed = seed
    given = particles
    call engine%start(table, threshold, given, 0.0_wp)
  end subroutine begin

  !> Advances the engine by `duration`, in windows not longer than `step`, and appends them to the
  !> log.
  subroutine run_for(engine, duration, log, step)
    class(engine_type), intent(inout) :: engine
    real(wp), intent(in) :: duration
    type(log_type), intent(inout) :: log
    real(wp), intent(in), optional :: step
    type(event_record_type) :: event_record
    real(wp) :: rest, began

    call extend_log(log, 0)
    event_record%logging = .true.
    began = log%elapsed
    rest = duration
    do while (rest > 16.0_wp*epsilon(1.0_wp)*(began + duration))
      if (present(step)) rest = min(rest, step)
      call engine%advance(rest, event_record)
      call append_window(event_record, engine%number, log)
      rest = duration - (log%elapsed - began)
    end do
  end subroutine run_for

  !> Appends the events of one window to the log.
  subroutine append_window(event_record, number, log)
    type(event_record_type), intent(in) :: event_record
    integer, intent(in) :: number
    type(log_type), intent(inout) :: log
    integer :: i, n
    real(wp) :: before

    n = event_record%events
    if (n > 0) call append_events()
    before = 0.0_wp
    do i = 1, event_record%crossings
      log%spread = log%spread + (event_record%crossing_time(i) - before)*abs(2*log%first - number)
      before = event_record%crossing_time(i)
      log%first = log%first + merge(1, -1, modulo(int(event_record%crossing(i)), 2) == 0)
      log%crossings(event_record%crossing(i)) = log%crossings(event_record%crossing(i)) + 1
    end do
    log%spread = log%spread + (event_record%duration - before)*abs(2*log%first - number)
    log%elapsed = log%elapsed + event_record%duration
    log%windows = log%windows + 1
    log%collisions = log%collisions + event_record%collisions
    log%reversals = log%reversals + sum(event_record%reversals)
    log%bounce_backs = log%bounce_backs + event_record%bounce_backs

  contains

    subroutine append_events()
      call extend_log(log, log%events + n)
      log%time(log%events + 1:log%events + n) = log%elapsed + event_record%event(:n)%time
      log%kind(log%events + 1:log%events + n) = event_record%event(:n)%kind
      log%where(log%events + 1:log%events + n) = event_record%event(:n)%where
      log%particle(log%events + 1:log%events + n) = event_record%event(:n)%particle
      log%events = log%events + n
    end subroutine append_events

  end subroutine append_window

  !> Allocates the log, or extends it by so many events.
  subroutine extend_log(log, events)
    type(log_type), intent(inout) :: log
    integer, intent(in) :: events
    integer :: more

    if (.not. allocated(log%time)) then
      allocate (log%time(0), log%kind(0), log%where(0), log%particle(0))
    end if
    more = max(events, 2*size(log%time), 64) - size(log%time)
    if (events <= size(log%time)) return
    log%time = [log%time, spread(0.0_wp, 1, more)]
    log%kind = [log%kind, spread(0, 1, more)]
    log%where = [log%where, spread(0, 1, more)]
    log%particle = [log%particle, spread(0, 1, more)]
  end subroutine extend_log

  !> Appends one event to the log.
  subroutine append_event(log, time, kind, where, particle)
    type(log_type), intent(inout) :: log
    real(wp), intent(in) :: time
    integer, intent(in) :: kind, where, particle

    call extend_log(log, log%events + 1)
    log%events = log%events + 1
    log%time(log%events) = time
    log%kind(log%events) = kind
    log%where(log%events) = where
    log%particle(log%events) = particle
  end subroutine append_event

  !> Totals of a run: wall collisions, reversals, particles reversed, crossings of each kind.
  pure function totals_of(log, collisions) result(totals)
    type(log_type), intent(in) :: log
    !> Number as the engine counts it; the log includes future hits of visits computed already.
    integer(int64), intent(in) :: collisions
    real(wp) :: totals(7)

    totals = real([collisions, log%reversals, log%bounce_backs, int(log%crossings, int64)], wp)
  end function totals_of

  !> Writes the state of an engine into an archive, which is then ready to be read.
  subroutine save_engine(engine, state)
    class(engine_type), intent(inout) :: engine
    type(archive_type), intent(out) :: state

    state = new_archive()
    call engine%serialize_state(engine%table, engine%gate%threshold, state)
    state = archive_of(state%word(:state%length))
  end subroutine save_engine

  !> Restores an engine from a state; its time step and seed have been set already.
  subroutine restore_engine(engine, table, threshold, state)
    class(engine_type), intent(inout) :: engine
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold
    type(archive_type), intent(in) :: state
    type(archive_type) :: archive

    archive = state
    call engine%serialize_state(table, [threshold, threshold], archive)
    if (archive%failed()) error stop 'a state was not restored'
  end subroutine restore_engine

end module engine_runs

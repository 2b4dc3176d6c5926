!> What every engine offers: start, advance by about one window, tell where the particles are.
!>
!> An engine owns the particles and the gates. It reports what happened in a `history_type`, which
!> the observers read. Times in a history are counted from the beginning of its window, so they stay
!> sharp however long the run has been.
module battery_engine
  use battery_kinds, only: wp, int8, int32, int64
  use battery_table, only: table_type
  implicit none (type, external)
  private
  public :: engine_type, history_type, particles_type, engine_state_type, reserve_history
  public :: record_crossing, record_event
  public :: channel1_12, channel1_21, channel2_12, channel2_21
  public :: event_entry, event_reversal, event_crossing1, event_crossing2

  !> Crossings: of the middle line of channel 1 and of the periodic line, from urn 1 to 2 and back.
  integer, parameter :: channel1_12 = 1, channel1_21 = 2, channel2_12 = 3, channel2_21 = 4

  !> Kinds of the event log.
  integer, parameter :: event_entry = 1, event_reversal = 2, event_crossing1 = 3, &
    event_crossing2 = 4

  !> Positions and velocities (speed 1) of all particles, in the order of the initial file.
  type :: particles_type
    real(wp), allocatable :: x(:), y(:), ux(:), uy(:)
  end type particles_type

  !> What happened in one window.
  type :: history_type
    !> Length of the window.
    real(wp) :: duration = 0.0_wp
    !> Crossings in the order of time: when (since the window began) and which (`channel1_12` ...).
    integer :: crossings = 0
    real(wp), allocatable :: crossing_time(:)
    integer(int8), allocatable :: crossing(:)
    !> Wall collisions that became known in the window (see `engine_type%collisions`).
    integer(int64) :: collisions = 0
    !> How often a gate reversed, and how many particles it turned back.
    integer(int64) :: reversals = 0, bounce_backs = 0
    !> Sum of |N1 - N2| over the states after each wall collision, and how many there were; only
    !> from engines that see each collision (`sees_collisions`).
    integer(int64) :: collision_spread_sum = 0, collisions_seen = 0
    !> The event log, if asked for: kind, where (gate, or 12 or 21), particle (or how many).
    logical :: logging = .false.
    integer :: events = 0
    real(wp), allocatable :: event_time(:)
    integer(int32), allocatable :: event_kind(:), event_where(:), event_particle(:)
  end type history_type

  !> All that an engine must save to go on to the same last bit: flat arrays, no meaning outside it.
  type :: engine_state_type
    integer(int64), allocatable :: integers(:)
    real(wp), allocatable :: reals(:)
    integer(int8), allocatable :: bytes(:)
  end type engine_state_type

  type, abstract :: engine_type
    type(table_type) :: table
    integer :: number = 0
    integer :: threshold = 0
    !> Set before `start` or `restore_state`: the step of an engine that has one, and the seed, 0 to
    !> 2**32 - 1, of one that draws random numbers.
    real(wp) :: time_step = 0.0_wp
    integer(int64) :: seed = 0
    !> Whether the engine sees each wall collision (then it fills `collision_spread_sum`).
    logical :: sees_collisions = .false.
  contains
    !> Takes over particles at time `clock`; positions and velocities have been checked. The arrays
    !> of `particles` may be freed on return, so that large systems fit.
    procedure(start_interface), deferred :: start
    !> Goes on by at most one window and not beyond `duration`; fills `history`.
    procedure(advance_interface), deferred :: advance
    !> Where the particles `first` ... `last` are now.
    procedure(particles_interface), deferred :: particles
    !> Wall collisions from the start until now, exactly; may cost a pass over the particles, while
    !> the running sum of `history%collisions` may be ahead of it.
    procedure(count_interface), deferred :: collisions
    !> How many particles can never leave their urn or channel (periodic orbits).
    procedure(count_interface), deferred :: trapped
    !> Time now, in double precision of an absolute clock.
    procedure(clock_interface), deferred :: clock
    procedure(save_interface), deferred :: save_state
    procedure(restore_interface), deferred :: restore_state
  end type engine_type

  abstract interface
    subroutine start_interface(self, table, threshold, particles, clock)
      import :: engine_type, table_type, particles_type, wp
      implicit none (type, external)
      class(engine_type), intent(inout) :: self
      type(table_type), intent(in) :: table
      integer, intent(in) :: threshold
      type(particles_type), intent(inout) :: particles
      real(wp), intent(in) :: clock
    end subroutine start_interface

    subroutine advance_interface(self, duration, history)
      import :: engine_type, history_type, wp
      implicit none (type, external)
      class(engine_type), intent(inout) :: self
      real(wp), intent(in) :: duration
      type(history_type), intent(inout) :: history
    end subroutine advance_interface

    subroutine particles_interface(self, first, last, particles)
      import :: engine_type, particles_type
      implicit none (type, external)
      class(engine_type), intent(in) :: self
      integer, intent(in) :: first, last
      type(particles_type), intent(out) :: particles
    end subroutine particles_interface

    function count_interface(self) result(total)
      import :: engine_type, int64
      implicit none (type, external)
      class(engine_type), intent(in) :: self
      integer(int64) :: total
    end function count_interface

    function clock_interface(self) result(time)
      import :: engine_type, wp
      implicit none (type, external)
      class(engine_type), intent(in) :: self
      real(wp) :: time
    end function clock_interface

    subroutine save_interface(self, state)
      import :: engine_type, engine_state_type
      implicit none (type, external)
      class(engine_type), intent(in) :: self
      type(engine_state_type), intent(out) :: state
    end subroutine save_interface

    !> `table`, `threshold` and the number of particles come with it; the state was saved by the
    !> same engine with the same table.
    subroutine restore_interface(self, table, threshold, number, state)
      import :: engine_type, engine_state_type, table_type
      implicit none (type, external)
      class(engine_type), intent(inout) :: self
      type(table_type), intent(in) :: table
      integer, intent(in) :: threshold, number
      type(engine_state_type), intent(in) :: state
    end subroutine restore_interface
  end interface

contains

  !> Empties the history and makes room for `crossings` crossings and as many as `events` events.
  subroutine reserve_history(history, crossings, events)
    type(history_type), intent(inout) :: history
    integer, intent(in) :: crossings, events

    history%duration = 0.0_wp
    history%crossings = 0
    history%collisions = 0
    history%reversals = 0
    history%bounce_backs = 0
    history%collision_spread_sum = 0
    history%collisions_seen = 0
    history%events = 0
    call grow(history, crossings, events)
  end subroutine reserve_history

  !> Makes room for that many crossings and events, at least doubling what must grow.
  subroutine grow(history, crossings, events)
    type(history_type), intent(inout) :: history
    integer, intent(in) :: crossings, events
    integer :: room

    if (.not. allocated(history%crossing_time)) allocate (history%crossing_time(0), &
      history%crossing(0))
    if (size(history%crossing_time) < crossings) then
      room = max(crossings, 2*size(history%crossing_time), 64)
      history%crossing_time = [history%crossing_time, spread(0.0_wp, 1, room &
        - size(history%crossing_time))]
      history%crossing = [history%crossing, spread(0_int8, 1, room - size(history%crossing))]
    end if
    if (.not. history%logging) return
    if (.not. allocated(history%event_time)) allocate (history%event_time(0), &
      history%event_kind(0), history%event_where(0), history%event_particle(0))
    if (size(history%event_time) < events) then
      room = max(events, 2*size(history%event_time), 64) - size(history%event_time)
      history%event_time = [history%event_time, spread(0.0_wp, 1, room)]
      history%event_kind = [history%event_kind, spread(0_int32, 1, room)]
      history%event_where = [history%event_where, spread(0_int32, 1, room)]
      history%event_particle = [history%event_particle, spread(0_int32, 1, room)]
    end if
  end subroutine grow

  !> Adds a crossing at `time` after the window began, and its event if events are logged.
  subroutine record_crossing(history, time, crossing, particle)
    type(history_type), intent(inout) :: history
    real(wp), intent(in) :: time
    integer, intent(in) :: crossing, particle

    if (history%crossings == size(history%crossing_time)) call grow(history, history%crossings &
      + 1, 0)
    history%crossings = history%crossings + 1
    history%crossing_time(history%crossings) = time
    history%crossing(history%crossings) = int(crossing, int8)
    if (.not. history%logging) return
    if (crossing <= channel1_21) then
      call record_event(history, time, event_crossing1, merge(12, 21, crossing == channel1_12), &
        particle)
    else
      call record_event(history, time, event_crossing2, merge(12, 21, crossing == channel2_12), &
        particle)
    end if
  end subroutine record_crossing

  !> Adds an event to the log, if events are logged.
  subroutine record_event(history, time, kind, where, particle)
    type(history_type), intent(inout) :: history
    real(wp), intent(in) :: time
    integer, intent(in) :: kind, where, particle
    integer :: at

    if (.not. history%logging) return
    if (history%events == size(history%event_time)) call grow(history, 0, history%events + 1)
    at = history%events + 1
    history%events = at
    history%event_time(at) = time
    history%event_kind(at) = int(kind, int32)
    history%event_where(at) = int(where, int32)
    history%event_particle(at) = int(particle, int32)
  end subroutine record_event

end module battery_engine

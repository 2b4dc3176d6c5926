!> The base type of all engines: start, advance by about one window, locate particles.
!>
!> An engine owns the particles, the gates and the clock. It writes what happened in a window to an
!> `event_record_type`, which the observers read. Extensions add how particles move.
!>
!> **The clock.** Time counts within an epoch, a power of two, so that its resolution does not
!> depend on the length of the run; at the end of an epoch all times are reduced by its length,
!> which is exact.
module battery_engine
  use battery_kinds, only: wp, int64
  use battery_table, only: table_type, passage_type, passage_at, no_channel
  use battery_urn, only: shape_polygon
  use battery_gate, only: gate_type, new_gate, clear_new_entries, rebase_gate, serialize_gate
  use battery_event_record, only: event_record_type
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: engine_type, particles_type, allocate_particles, rebase_gates_and_clock, &
    unmet_requirement

  !> Positions and velocities (speed 1) of all particles, in the order of the initial file.
  type :: particles_type
    real(wp), allocatable :: x(:), y(:), ux(:), uy(:)
  end type particles_type

  !> State that all engines have. An extension adds the motion of its particles.
  type, abstract :: engine_type
    type(table_type) :: table
    !> The gates of urn 1 and urn 2.
    type(gate_type) :: gate(2)
    !> Number of particles.
    integer :: number = 0
    !> Set before `start` or `serialize_state`: the step of an engine that has one, and the seed, 0
    !> to 2**32 - 1, of one that draws random numbers.
    real(wp) :: time_step = 0.0_wp
    integer(int64) :: seed = 0
    !> Time since the epoch began; its length, set by `prepare_engine`; number of epochs before.
    real(wp) :: now = 0.0_wp, epoch = 0.0_wp
    integer(int64) :: epochs = 0
    !> Clock time at the start.
    real(wp) :: clock_start = 0.0_wp
  contains
    procedure, non_overridable :: start
    procedure, non_overridable :: advance
    procedure, non_overridable :: clock
    procedure, non_overridable :: elapsed
    procedure, non_overridable :: time_until
    procedure, non_overridable :: serialize_state
    !> Why the engine cannot simulate a table, in words for the user; an empty text: it can.
    procedure :: reason_unsupported
    !> Sets the sizes and lengths of the engine from `table`, `number` and `time_step`, among them
    !> the longest window and `epoch`.
    procedure(prepare_engine_interface), deferred :: prepare_engine
    !> Loads the particles, which have been checked. May free their arrays as it proceeds, so that
    !> large systems fit into memory.
    procedure(load_particles_interface), deferred :: load_particles
    !> Advances by at most one window and at most `duration`; fills `event_record`, sets `now`.
    procedure(advance_window_interface), deferred :: advance_window
    !> Starts a new epoch: reduces all times by its length; extended by engines with times of their
    !> own.
    procedure :: rebase_clock => rebase_gates_and_clock
    !> Saves or restores what the engine itself adds.
    procedure(serialize_interface), deferred :: serialize_own_state
    procedure, non_overridable :: get_particles
    !> x, y, u_x, u_y of one particle now.
    procedure(state_interface), deferred :: state_of
    !> Exact number of wall collisions from the start until now; may cost a pass over the particles,
    !> while the running sum of `event_record%collisions` may be ahead of it.
    procedure(count_interface), deferred :: collisions
    !> Number of particles that never leave their urn or channel (periodic orbits).
    procedure(count_interface), deferred :: trapped
  end type engine_type

  abstract interface
    subroutine prepare_engine_interface(self)
      import :: engine_type
      implicit none (type, external)
      class(engine_type), intent(inout) :: self
    end subroutine prepare_engine_interface

    subroutine load_particles_interface(self, particles)
      import :: engine_type, particles_type
      implicit none (type, external)
      class(engine_type), intent(inout) :: self
      type(particles_type), intent(inout) :: particles
    end subroutine load_particles_interface

    subroutine advance_window_interface(self, duration, event_record)
      import :: engine_type, event_record_type, wp
      implicit none (type, external)
      class(engine_type), intent(inout) :: self
      real(wp), intent(in) :: duration
      type(event_record_type), intent(inout) :: event_record
    end subroutine advance_window_interface

    subroutine serialize_interface(self, archive)
      import :: engine_type, archive_type
      implicit none (type, external)
      class(engine_type), intent(inout) :: self
      type(archive_type), intent(inout) :: archive
    end subroutine serialize_interface

    function state_interface(self, i) result(state)
      import :: engine_type, wp
      implicit none (type, external)
      class(engine_type), intent(in) :: self
      integer, intent(in) :: i
      real(wp) :: state(4)
    end function state_interface

    function count_interface(self) result(total)
      import :: engine_type, int64
      implicit none (type, external)
      class(engine_type), intent(in) :: self
      integer(int64) :: total
    end function count_interface
  end interface

contains

  !> Loads the particles at the time `clock`. One that is too slow along its channel ever to reach
  !> an end moves across it, and one that is upright up to rounding in a polygon is upright, in all
  !> engines alike: an angle of pi/2 has the cosine 6e-17.
  subroutine start(self, table, threshold, particles, clock)
    class(engine_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    !> Thresholds of the gates of urn 1 and 2.
    integer, intent(in) :: threshold(2)
    !> Positions and velocities, which have been checked; freed.
    type(particles_type), intent(inout) :: particles
    !> Clock time at the start, in time units.
    real(wp), intent(in) :: clock
    type(passage_type) :: passage
    integer :: i

    do i = 1, size(particles%x)
      passage = passage_at(table, particles%x(i), particles%y(i), particles%ux(i), particles%uy(i))
      associate (urn => table%urn(passage%urn), ux => particles%ux(i), uy => particles%uy(i))
        if (passage%trapped .or. passage%chord /= no_channel .or. (urn%shape == shape_polygon &
          .and. abs(ux) <= urn%least_across)) then
          ux = 0.0_wp
          uy = sign(1.0_wp, uy)
        end if
      end associate
      ! The end of a run may have put it beside the chord, by rounding.
      if (passage%chord /= no_channel) particles%x(i) = sign(table%urn(passage%urn) &
        %channel_start(passage%chord), particles%x(i))
    end do
    call set_up_engine(self, table, threshold, size(particles%x))
    self%clock_start = clock
    call self%load_particles(particles)
    call clear_new_entries(self%gate)
    if (allocated(particles%x)) deallocate (particles%x, particles%y, particles%ux, particles%uy)
  end subroutine start

  !> Sets table, gates and number; no particle is loaded yet.
  subroutine set_up_engine(self, table, threshold, number)
    class(engine_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold(2), number
    integer :: urn

    self%table = table
    self%number = number
    do urn = 1, 2
      call new_gate(self%gate(urn), threshold(urn))
    end do
    self%now = 0.0_wp
    self%epochs = 0
    call self%prepare_engine()
  end subroutine set_up_engine

  !> Advances by at most one window and at most `duration`.
  subroutine advance(self, duration, event_record)
    class(engine_type), intent(inout) :: self
    !> In time units; above 0.
    real(wp), intent(in) :: duration
    !> Events and counts of the window.
    type(event_record_type), intent(inout) :: event_record

    if (self%now >= self%epoch) call self%rebase_clock()
    call self%advance_window(duration, event_record)
  end subroutine advance

  !> Reduces the clock and the times of the gates by the length of the epoch.
  subroutine rebase_gates_and_clock(self)
    class(engine_type), intent(inout) :: self
    integer :: urn

    do urn = 1, 2
      call rebase_gate(self%gate(urn), self%epoch)
    end do
    self%now = self%now - self%epoch
    self%epochs = self%epochs + 1
  end subroutine rebase_gates_and_clock

  !> Time now; its resolution is that of an absolute clock.
  function clock(self) result(time)
    class(engine_type), intent(in) :: self
    real(wp) :: time

    time = self%clock_start + self%elapsed()
  end function clock

  !> Time since the start.
  pure function elapsed(self) result(time)
    class(engine_type), intent(in) :: self
    real(wp) :: time

    time = real(self%epochs, wp)*self%epoch + self%now
  end function elapsed

  !> Time from now until `time` since the start, with the resolution of the clock of the epoch.
  pure function time_until(self, time) result(left)
    class(engine_type), intent(in) :: self
    real(wp), intent(in) :: time
    real(wp) :: left

    left = (time - real(self%epochs, wp)*self%epoch) - self%now
  end function time_until

  !> Why this engine cannot simulate a table; overridden by engines with further requirements.
  pure function reason_unsupported(self, table) result(reason)
    class(engine_type), intent(in) :: self
    type(table_type), intent(in) :: table
    character(len=:), allocatable :: reason

    reason = unmet_requirement(table)
    if (self%time_step < 0.0_wp) reason = 'its time_step is below 0'
  end function reason_unsupported

  !> Requirement of all engines that `table` does not meet, in words for the user; or empty.
  pure function unmet_requirement(table) result(reason)
    type(table_type), intent(in) :: table
    character(len=:), allocatable :: reason

    reason = ''
    if (.not. all(table%urn%fits)) reason = 'its openings must be narrower than either urn'
  end function unmet_requirement

  !> Saves or restores all that is needed to continue to the same last bit. If an archive does not
  !> fit, it reports that, and the engine must not be used.
  subroutine serialize_state(self, table, threshold, archive)
    class(engine_type), intent(inout) :: self
    !> Table, the same for both directions: it is not part of the archive.
    type(table_type), intent(in) :: table
    !> Thresholds of the gates of urn 1 and 2.
    integer, intent(in) :: threshold(2)
    type(archive_type), intent(inout) :: archive
    integer :: number, urn

    number = self%number
    call archive%serialize('number', number)
    if (archive%failed()) return
    if (archive%reading) call set_up_engine(self, table, threshold, number)
    call archive%serialize('now', self%now)
    call archive%serialize('pages', self%epochs)
    call archive%serialize('clock_start', self%clock_start)
    do urn = 1, 2
      call serialize_gate(self%gate(urn), archive)
    end do
    if (.not. archive%failed()) call self%serialize_own_state(archive)
  end subroutine serialize_state

  !> Positions and velocities of the particles `first` ... `last` now, in the frame of the table.
  subroutine get_particles(self, first, last, found)
    class(engine_type), intent(in) :: self
    integer, intent(in) :: first, last
    !> The particles from `first` on.
    type(particles_type), intent(out) :: found
    real(wp) :: state(4)
    integer :: i, k

    call allocate_particles(found, last - first + 1)
    do i = first, last
      k = i - first + 1
      state = self%state_of(i)
      found%x(k) = state(1)
      found%y(k) = state(2)
      found%ux(k) = state(3)
      found%uy(k) = state(4)
    end do
  end subroutine get_particles

  !> Allocates positions and velocities.
  pure subroutine allocate_particles(particles, number)
    type(particles_type), intent(out) :: particles
    !> Number of particles.
    integer, intent(in) :: number

    allocate (particles%x(number), particles%y(number), particles%ux(number), particles%uy(number))
  end subroutine allocate_particles

end module battery_engine

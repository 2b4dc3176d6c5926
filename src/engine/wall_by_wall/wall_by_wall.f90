!> Base type of the engines in which a particle has an event at every wall.
!>
!> An extension finds when events are due. This type applies them to the gates, the counts and the
!> event record: the extension passes each particle whose event is due (`process_event`), until no
!> other event is due at that instant, and only then do the gates decide (`end_instant`). Whatever
!> the order of the events within the instant, the decision is that of the rule in `battery_gate`.
module battery_wall_by_wall
  use battery_kinds, only: wp, int64
  use battery_table, only: channel1, channel2, in_gate, x_on_side, enters_at_once
  use battery_motion, only: motion_type, meets_gate, meets_line, meets_channel_wall
  use battery_wall_motion, only: motion_at, find_first_wall, hit_wall, pass_line, reverse_motion, &
    heads_for_middle, time_to_middle, is_trapped
  use battery_gate, only: enter_gate, has_undecided_entries, decide_reversal, uncount_particle, &
    uncount_all, number_inside, counted_particle
  use battery_engine, only: engine_type, particles_type
  use battery_event_record, only: event_record_type, reserve_event_record, record_crossing, &
    put_channel1_first, record_event, record_reversal, sort_simultaneous_events, crossing_of, &
    event_entry
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: wall_by_wall_type, reset_counts, load_motions, serialize_counts, process_event, &
    end_instant, count_hits, record_gate_entry, record_line_crossing, longest_window, end_of_window

  !> A window lasts at most `window_reaches` times the reach of the larger urn, and has at most
  !> about `window_events` events.
  real(wp), parameter, public :: window_reaches = 2.0_wp, window_events = 65536.0_wp

  !> A window ends after this many wall collisions, far more than usual: signals are noticed between
  !> windows, and in a channel of almost no width a single particle has very many hits.
  integer(int64), parameter, public :: most_hits = 2_int64**24

  !> State that these engines have in common.
  type, abstract, extends(engine_type) :: wall_by_wall_type
    !> N1 - N2 now, and before the present instant, whose events have no order.
    integer :: difference = 0, difference_before = 0
    !> Wall collisions since the start.
    integer(int64) :: hits = 0
    !> Start of the window; time since then, at the present instant or at its end.
    real(wp) :: window_start = 0.0_wp, window_time = 0.0_wp
    !> Longest window; huge if the engine limits it otherwise.
    real(wp) :: window = huge(1.0_wp)
  contains
    procedure :: load_particles => load_motions
    procedure :: state_of, collisions, trapped
    procedure :: advance_window
    !> Processes the events of at most one window, and not beyond `duration`; sets `now` and
    !> `window_time`.
    procedure(process_window_interface), deferred :: process_window
    !> Reverses the axial velocity of a particle.
    procedure :: reverse_particle
    !> State of a particle now.
    procedure(motion_interface), deferred :: motion_now
    !> Stores the state of a particle now, and the time until its next event.
    procedure(store_motion_interface), deferred :: store_motion
  end type wall_by_wall_type

  abstract interface
    subroutine process_window_interface(self, event_record, duration)
      import :: wall_by_wall_type, event_record_type, wp
      implicit none (type, external)
      class(wall_by_wall_type), intent(inout) :: self
      type(event_record_type), intent(inout) :: event_record
      real(wp), intent(in) :: duration
    end subroutine process_window_interface

    pure function motion_interface(self, i) result(motion)
      import :: wall_by_wall_type, motion_type
      implicit none (type, external)
      class(wall_by_wall_type), intent(in) :: self
      integer, intent(in) :: i
      type(motion_type) :: motion
    end function motion_interface

    subroutine store_motion_interface(self, i, motion, wait)
      import :: wall_by_wall_type, motion_type, wp
      implicit none (type, external)
      class(wall_by_wall_type), intent(inout) :: self
      integer, intent(in) :: i
      type(motion_type), intent(in) :: motion
      real(wp), intent(in) :: wait
    end subroutine store_motion_interface
  end interface

contains

  !> Resets the counts, and takes the epoch from the table.
  subroutine reset_counts(self)
    class(wall_by_wall_type), intent(inout) :: self

    self%epoch = self%table%epoch
    self%difference = 0
    self%hits = 0
  end subroutine reset_counts

  !> Longest window that has at most `events` events.
  pure function longest_window(self, events) result(window)
    class(wall_by_wall_type), intent(in) :: self
    !> Number of events of all particles.
    real(wp), intent(in) :: events
    real(wp) :: window

    window = maxval(self%table%urn%reach)*min(window_reaches, events/real(self%number, wp))
  end function longest_window

  !> End of a window that starts now.
  pure function end_of_window(self, duration) result(window_end)
    class(wall_by_wall_type), intent(in) :: self
    !> Longest duration of the window.
    real(wp), intent(in) :: duration
    real(wp) :: window_end

    window_end = min(self%now + min(duration, self%window), self%epoch)
  end function end_of_window

  !> Advances by one window of at most `duration`.
  subroutine advance_window(self, duration, event_record)
    class(wall_by_wall_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(event_record_type), intent(inout) :: event_record
    integer(int64) :: hits

    self%window_start = self%now
    hits = self%hits
    call reserve_event_record(event_record, 64)
    call self%process_window(event_record, duration)
    event_record%duration = self%window_time
    event_record%collisions = self%hits - hits
  end subroutine advance_window

  !> Loads the particles. A particle that is in a gate at the start and heads for the other one is
  !> counted, but only an entry can make a gate reverse. Where `before_crossing` has put a particle
  !> before its line, it crosses that at the first instant.
  subroutine load_motions(self, particles)
    class(wall_by_wall_type), intent(inout) :: self
    type(particles_type), intent(inout) :: particles
    type(motion_type) :: motion
    real(wp) :: wait
    integer :: i

    do i = 1, self%number
      motion = motion_at(self%table, particles%x(i), particles%y(i), particles%ux(i), &
        particles%uy(i))
      if (heads_for_middle(motion) .and. abs(motion%x) <= tiny(wait)) motion%x = 0.0_wp
      call find_first_wall(self%table, motion, wait)
      if (enters_at_once(self%table, motion%x, motion%y, motion%ux)) then
        motion%x = sign(self%table%urn(motion%urn)%channel_start(channel1), motion%x)
        motion%next = meets_gate
        wait = 0.0_wp
      end if
      self%difference = self%difference + merge(1, -1, motion%urn == 1)
      if (heads_for_middle(motion)) call enter_gate(self%gate(motion%urn), self%now &
        + time_to_middle(motion), i)
      call self%store_motion(i, motion, wait)
    end do
    self%difference_before = self%difference
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
  end subroutine load_motions

  !> Processes the event of a particle, which has been moved to it; `wait` is the time until its
  !> next event.
  subroutine process_event(self, event_record, particle, motion, wait)
    class(wall_by_wall_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    !> Particle index, 1 ... N.
    integer, intent(in) :: particle
    type(motion_type), intent(inout) :: motion
    real(wp), intent(out) :: wait
    integer :: urn, chamber, reached

    urn = motion%urn
    chamber = motion%chamber
    reached = motion%next
    if (reached >= meets_channel_wall) then
      call hit_wall(self%table, motion, wait)
      call count_hits(self, event_record, 1_int64)
    else
      call pass_line(self%table, motion, wait)
      if (reached == meets_gate) call record_gate_entry(self, event_record, particle, motion)
      if (reached == meets_line) call record_line_crossing(self, event_record, particle, urn, &
        chamber)
    end if
  end subroutine process_event

  !> Counts a particle that has entered the gate of its urn.
  subroutine record_gate_entry(self, event_record, particle, motion)
    class(wall_by_wall_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    !> Particle index, 1 ... N.
    integer, intent(in) :: particle
    type(motion_type), intent(in) :: motion

    call enter_gate(self%gate(motion%urn), self%now + time_to_middle(motion), particle)
    if (event_record%logging) call record_event(event_record, self%window_time, event_entry, &
      int(motion%urn), particle)
  end subroutine record_gate_entry

  !> Records the crossing of a line: a particle from `chamber` of `urn` has reached the line of its
  !> channel. The middle line of a single urn is a wall: reaching it is also counted as a wall hit.
  subroutine record_line_crossing(self, event_record, particle, urn, chamber)
    class(wall_by_wall_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    !> Particle index; 1 or 2; `in_gate` or `in_channel2`.
    integer, intent(in) :: particle, urn, chamber

    if (chamber == in_gate) then
      call uncount_particle(self%gate(urn), particle)
      call record_crossing(event_record, self%window_time, crossing_of(urn, channel1), particle)
      call put_channel1_first(event_record, event_record%crossings)
    else
      call record_crossing(event_record, self%window_time, crossing_of(urn, channel2), particle)
    end if
    if (self%table%urn_across(urn) == urn) then
      call count_hits(self, event_record, 1_int64)
    else
      self%difference = self%difference + merge(-2, 2, urn == 1)
    end if
  end subroutine record_line_crossing

  !> Counts `hits` wall collisions, and for each the mass spread before the events of its instant.
  subroutine count_hits(self, event_record, hits)
    class(wall_by_wall_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    integer(int64), intent(in) :: hits

    self%hits = self%hits + hits
    event_record%collision_spread_sum = event_record%collision_spread_sum &
      + hits*abs(self%difference_before)
    event_record%collisions_seen = event_record%collisions_seen + hits
  end subroutine count_hits

  !> Ends an instant: the gates decide, and the logged events of the instant, from `first` on, are
  !> sorted.
  subroutine end_instant(self, first, event_record)
    class(wall_by_wall_type), intent(inout) :: self
    integer, intent(in) :: first
    type(event_record_type), intent(inout) :: event_record

    self%difference_before = self%difference
    if (has_undecided_entries(self%gate)) call decide_reversals(self, event_record)
    if (event_record%events > first) call sort_simultaneous_events(event_record, first, &
      event_record%events)
  end subroutine end_instant

  !> Lets each gate decide; if it reverses, all particles that it counts are reversed.
  subroutine decide_reversals(self, event_record)
    class(wall_by_wall_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    integer :: urn, place
    logical :: reverses

    do urn = 1, 2
      call decide_reversal(self%gate(urn), reverses)
      if (.not. reverses) cycle
      call record_reversal(event_record, self%window_time, urn, number_inside(self%gate(urn)))
      do place = 1, number_inside(self%gate(urn))
        call self%reverse_particle(counted_particle(self%gate(urn), place))
      end do
      call uncount_all(self%gate(urn))
    end do
  end subroutine decide_reversals

  !> Reverses the axial velocity of particle `i`.
  subroutine reverse_particle(self, i)
    class(wall_by_wall_type), intent(inout) :: self
    integer, intent(in) :: i
    type(motion_type) :: motion
    real(wp) :: wait

    motion = self%motion_now(i)
    call reverse_motion(self%table, motion, wait)
    call self%store_motion(i, motion, wait)
  end subroutine reverse_particle

  !> x, y, u_x, u_y of particle `i` now.
  function state_of(self, i) result(state)
    class(wall_by_wall_type), intent(in) :: self
    integer, intent(in) :: i
    real(wp) :: state(4)
    type(motion_type) :: motion

    motion = self%motion_now(i)
    state = [x_on_side(self%table, int(motion%urn), motion%next == meets_gate, &
      heads_for_middle(motion), motion%x, motion%y, motion%ux), motion%y, motion%ux, motion%uy]
  end function state_of

  !> Wall collisions since the start.
  function collisions(self) result(total)
    class(wall_by_wall_type), intent(in) :: self
    integer(int64) :: total

    total = self%hits
  end function collisions

  !> Number of particles that never leave their urn or channel.
  function trapped(self) result(total)
    class(wall_by_wall_type), intent(in) :: self
    integer(int64) :: total
    integer :: i

    total = 0
    do i = 1, self%number
      if (is_trapped(self%table, self%motion_now(i))) total = total + 1
    end do
  end function trapped

  !> Saves or restores the counts.
  subroutine serialize_counts(self, archive)
    class(wall_by_wall_type), intent(inout) :: self
    type(archive_type), intent(inout) :: archive

    call archive%serialize('difference', self%difference)
    self%difference_before = self%difference
    call archive%serialize('hits', self%hits)
  end subroutine serialize_counts

end module battery_wall_by_wall

!> What the engines have in common in which a particle has an event at every wall.
!>
!> Such an engine knows when events happen; here is what they do to the gates, to the counts and to
!> the event record. It hands over the particle that has an event (`process_event`), goes on until
!> no other event is due at that same instant, and only then are the gates asked whether they turn
!> (`end_instant`). Whatever the order in which the events of the instant came, that decides as the
!> rule of `battery_gate` does.
module battery_wall_by_wall
  use battery_kinds, only: wp, int64
  use battery_table, only: gated, ungated, in_gate
  use battery_motion, only: motion_type, meets_gate, meets_line, meets_channel_wall
  use battery_bounce, only: motion_at, find_first_wall, hit_wall, pass_line, reverse_motion, &
    heads_for_middle, time_to_middle, is_trapped
  use battery_gate, only: enter_gate, has_undecided_entries, decide_reversal, uncount_particle, &
    uncount_all, number_inside, counted_particle
  use battery_engine, only: engine_type, particles_type
  use battery_event_record, only: event_record_type, reserve_event_record, record_crossing, &
    record_event, record_reversal, sort_simultaneous_events, crossing_of, event_entry
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: wall_by_wall_type, reset_counts, load_motions, serialize_counts, process_event, &
    end_instant, count_hits, record_gate_entry, record_line_crossing, longest_window, end_of_window

  !> A window is at most so many times the reach of the larger urn long, and has about so many
  !> events at most.
  real(wp), parameter, public :: window_reaches = 2.0_wp, window_events = 65536.0_wp

  !> A window ends after so many wall collisions, far more than usual: in a channel that is hardly
  !> wider than nothing a single particle would keep the run from hearing a signal.
  integer(int64), parameter, public :: most_hits = 2_int64**24

  !> What these engines have; a kind of them adds when events happen.
  type, abstract, extends(engine_type) :: wall_by_wall_type
    !> N1 - N2.
    integer :: difference = 0
    !> Wall collisions since the start.
    integer(int64) :: hits = 0
    !> When the window began, and how long it has lasted: at an instant, and at the end.
    real(wp) :: began = 0.0_wp, since = 0.0_wp
    !> Longest window, of an engine that has one.
    real(wp) :: window = huge(1.0_wp)
  contains
    procedure :: load_particles => load_motions
    procedure :: state_of, collisions, trapped
    procedure :: advance_window
    !> Goes on by at most one window and not beyond `duration`; sets `now` and `since`.
    procedure(process_window_interface), deferred :: process_window
    !> Turns a particle of a gate back.
    procedure :: reverse_particle
    !> Where a particle is now, and how it moves.
    procedure(motion_interface), deferred :: motion_now
    !> Takes note of a particle now, and of the time until its next event.
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

  !> What follows from the table.
  subroutine reset_counts(self)
    class(wall_by_wall_type), intent(inout) :: self

    self%epoch = self%table%epoch
    self%difference = 0
    self%hits = 0
  end subroutine reset_counts

  !> As long as a window of so many events may be.
  pure function longest_window(self, events) result(window)
    class(wall_by_wall_type), intent(in) :: self
    !> At most, in all.
    real(wp), intent(in) :: events
    real(wp) :: window

    window = maxval(self%table%urn%reach)*min(window_reaches, events/real(self%number, wp))
  end function longest_window

  !> When a window ends that begins now.
  pure function end_of_window(self, duration) result(ends)
    class(wall_by_wall_type), intent(in) :: self
    !> At most so long.
    real(wp), intent(in) :: duration
    real(wp) :: ends

    ends = min(self%now + min(duration, self%window), self%epoch)
  end function end_of_window

  !> One window of at most the time `duration`.
  subroutine advance_window(self, duration, event_record)
    class(wall_by_wall_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(event_record_type), intent(inout) :: event_record
    integer(int64) :: hits

    self%began = self%now
    hits = self%hits
    call reserve_event_record(event_record, 64, 64)
    call self%process_window(event_record, duration)
    event_record%duration = self%since
    event_record%collisions = self%hits - hits
  end subroutine advance_window

  !> Takes in the particles. In a gate and on its way to the other one a particle is counted from
  !> the start, but only an entry can make a gate turn.
  subroutine load_motions(self, particles)
    class(wall_by_wall_type), intent(inout) :: self
    type(particles_type), intent(inout) :: particles
    type(motion_type) :: motion
    real(wp) :: wait
    integer :: i

    do i = 1, self%number
      motion = motion_at(self%table, particles%x(i), particles%y(i), particles%ux(i), &
        particles%uy(i))
      call find_first_wall(self%table, motion, wait)
      self%difference = self%difference + merge(1, -1, motion%urn == 1)
      if (heads_for_middle(motion)) call enter_gate(self%gate(motion%urn), self%now &
        + time_to_middle(motion), i)
      call self%store_motion(i, motion, wait)
    end do
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
  end subroutine load_motions

  !> The event of a particle, which has been moved to it. `wait` is how long it takes to its next.
  subroutine process_event(self, event_record, particle, motion, wait)
    class(wall_by_wall_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    !> Its number, from 1.
    integer, intent(in) :: particle
    type(motion_type), intent(inout) :: motion
    real(wp), intent(out) :: wait
    integer :: urn, chamber, met

    urn = motion%urn
    chamber = motion%chamber
    met = motion%next
    if (met >= meets_channel_wall) then
      call hit_wall(self%table, motion, wait)
      call count_hits(self, event_record, 1_int64)
    else
      call pass_line(self%table, motion, wait)
      if (met == meets_gate) call record_gate_entry(self, event_record, particle, motion)
      if (met == meets_line) call record_line_crossing(self, event_record, particle, urn, chamber)
    end if
  end subroutine process_event

  !> A particle has come into the gate of its side.
  subroutine record_gate_entry(self, event_record, particle, motion)
    class(wall_by_wall_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    !> Its number, from 1.
    integer, intent(in) :: particle
    type(motion_type), intent(in) :: motion

    call enter_gate(self%gate(motion%urn), self%now + time_to_middle(motion), particle)
    if (event_record%logging) call record_event(event_record, self%since, event_entry, &
      int(motion%urn), particle)
  end subroutine record_gate_entry

  !> A particle has come to the line of its channel, from `chamber` of `urn`.
  subroutine record_line_crossing(self, event_record, particle, urn, chamber)
    class(wall_by_wall_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    !> Its number; side 1 or 2; `in_gate` or `in_return`.
    integer, intent(in) :: particle, urn, chamber

    if (chamber == in_gate) then
      call uncount_particle(self%gate(urn), particle)
      call record_crossing(event_record, self%since, crossing_of(urn, gated), particle)
    else
      call record_crossing(event_record, self%since, crossing_of(urn, ungated), particle)
    end if
    if (self%table%beyond(urn) == urn) then
      call count_hits(self, event_record, 1_int64)
    else
      self%difference = self%difference + merge(-2, 2, urn == 1)
    end if
  end subroutine record_line_crossing

  !> `hits` wall collisions, and the state right after them.
  subroutine count_hits(self, event_record, hits)
    class(wall_by_wall_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    integer(int64), intent(in) :: hits

    self%hits = self%hits + hits
    event_record%collision_spread_sum = event_record%collision_spread_sum &
      + hits*abs(self%difference)
    event_record%collisions_seen = event_record%collisions_seen + hits
  end subroutine count_hits

  !> The gates decide, and the log of the instant, events `first` and later, is put in order.
  subroutine end_instant(self, first, event_record)
    class(wall_by_wall_type), intent(inout) :: self
    integer, intent(in) :: first
    type(event_record_type), intent(inout) :: event_record

    if (has_undecided_entries(self%gate)) call decide_reversals(self, event_record)
    if (event_record%events > first) call sort_simultaneous_events(event_record, first, &
      event_record%events)
  end subroutine end_instant

  !> Where a gate turns, all those counted in it turn back.
  subroutine decide_reversals(self, event_record)
    class(wall_by_wall_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    integer :: urn, place
    logical :: reverses

    do urn = 1, 2
      call decide_reversal(self%gate(urn), reverses)
      if (.not. reverses) cycle
      call record_reversal(event_record, self%since, urn, number_inside(self%gate(urn)))
      do place = 1, number_inside(self%gate(urn))
        call self%reverse_particle(counted_particle(self%gate(urn), place))
      end do
      call uncount_all(self%gate(urn))
    end do
  end subroutine decide_reversals

  !> Turns particle `i` of a gate back.
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
    state = [motion%x, motion%y, motion%ux, motion%uy]
  end function state_of

  !> Wall collisions since the start.
  function collisions(self) result(total)
    class(wall_by_wall_type), intent(in) :: self
    integer(int64) :: total

    total = self%hits
  end function collisions

  !> How many can never leave where they are.
  function trapped(self) result(total)
    class(wall_by_wall_type), intent(in) :: self
    integer(int64) :: total
    integer :: i

    total = 0
    do i = 1, self%number
      if (is_trapped(self%table, self%motion_now(i))) total = total + 1
    end do
  end function trapped

  !> The counts, through an archive.
  subroutine serialize_counts(self, archive)
    class(wall_by_wall_type), intent(inout) :: self
    type(archive_type), intent(inout) :: archive

    call archive%serialize('difference', self%difference)
    call archive%serialize('hits', self%hits)
  end subroutine serialize_counts

end module battery_wall_by_wall

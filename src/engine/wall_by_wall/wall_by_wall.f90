!> What the engines have in common in which a particle has an event at every wall.
!>
!> Such an engine knows when events happen; here is what they do to the gates, to the counts and to
!> the history. It hands over the particle that has an event (`meet`), goes on until no other event
!> is due at that same instant, and only then are the gates asked whether they turn (`end_instant`).
!> Whatever the order in which the events of the instant came, that decides as the rule of
!> `battery_gate` does.
module battery_wall_by_wall
  use battery_kinds, only: wp, int64
  use battery_table, only: gated, ungated, in_gate
  use battery_motion, only: motion_type, meets_gate, meets_line, meets_channel_wall
  use battery_bounce, only: put_down, take_off, hit_wall, pass_line, turn_back, heads_for_middle, &
    time_to_middle, is_trapped
  use battery_gate, only: enter, undecided, decide, cross, turned_back, &
    number_inside, who_is_inside
  use battery_engine, only: engine_type, particles_type
  use battery_history, only: history_type, reserve_history, record_crossing, record_event, &
    record_reversal, order_events, crossing_of, event_entry
  use battery_stream, only: stream_type
  implicit none (type, external)
  private
  public :: wall_by_wall_type, prepare_walls, take_in, pass_counts, meet, end_instant, count_hits, &
    enter_gate, cross_over, longest_window, end_of_window

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
    procedure :: take_over => take_in
    procedure :: state_of, collisions, trapped
    procedure :: live
    !> Goes on by at most one window and not beyond `duration`; sets `now` and `since`.
    procedure(go_on_interface), deferred :: go_on
    !> Turns a particle of a gate back.
    procedure :: turn_particle
    !> Where a particle is now, and how it moves.
    procedure(motion_interface), deferred :: motion_now
    !> Takes note of a particle now, and of the time until its next event.
    procedure(write_down_interface), deferred :: write_down
  end type wall_by_wall_type

  abstract interface
    subroutine go_on_interface(self, history, duration)
      import :: wall_by_wall_type, history_type, wp
      implicit none (type, external)
      class(wall_by_wall_type), intent(inout) :: self
      type(history_type), intent(inout) :: history
      real(wp), intent(in) :: duration
    end subroutine go_on_interface

    pure function motion_interface(self, i) result(motion)
      import :: wall_by_wall_type, motion_type
      implicit none (type, external)
      class(wall_by_wall_type), intent(in) :: self
      integer, intent(in) :: i
      type(motion_type) :: motion
    end function motion_interface

    subroutine write_down_interface(self, i, motion, wait)
      import :: wall_by_wall_type, motion_type, wp
      implicit none (type, external)
      class(wall_by_wall_type), intent(inout) :: self
      integer, intent(in) :: i
      type(motion_type), intent(in) :: motion
      real(wp), intent(in) :: wait
    end subroutine write_down_interface
  end interface

contains

  !> What follows from the table.
  subroutine prepare_walls(self)
    class(wall_by_wall_type), intent(inout) :: self

    self%page = self%table%page
    self%difference = 0
    self%hits = 0
  end subroutine prepare_walls

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

    ends = min(self%now + min(duration, self%window), self%page)
  end function end_of_window

  !> One window of at most the time `duration`.
  subroutine live(self, duration, history)
    class(wall_by_wall_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(history_type), intent(inout) :: history
    integer(int64) :: hits

    self%began = self%now
    hits = self%hits
    call reserve_history(history, 64, 64)
    call self%go_on(history, duration)
    history%duration = self%since
    history%collisions = self%hits - hits
  end subroutine live

  !> Takes in the particles. In a gate and on its way to the other one a particle is counted from
  !> the start, but only an entry can make a gate turn.
  subroutine take_in(self, particles)
    class(wall_by_wall_type), intent(inout) :: self
    type(particles_type), intent(inout) :: particles
    type(motion_type) :: motion
    real(wp) :: wait
    integer :: i

    do i = 1, self%number
      motion = put_down(self%table, particles%x(i), particles%y(i), particles%ux(i), &
        particles%uy(i))
      call take_off(self%table, motion, wait)
      self%difference = self%difference + merge(1, -1, motion%side == 1)
      if (heads_for_middle(motion)) call enter(self%gate(motion%side), self%now &
        + time_to_middle(motion), i)
      call self%write_down(i, motion, wait)
    end do
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
  end subroutine take_in

  !> The event of a particle, which has been moved to it. `wait` is how long it takes to its next.
  subroutine meet(self, history, particle, motion, wait)
    class(wall_by_wall_type), intent(inout) :: self
    type(history_type), intent(inout) :: history
    !> Its number, from 1.
    integer, intent(in) :: particle
    type(motion_type), intent(inout) :: motion
    real(wp), intent(out) :: wait
    integer :: side, chamber, met

    side = motion%side
    chamber = motion%chamber
    met = motion%next
    if (met >= meets_channel_wall) then
      call hit_wall(self%table, motion, wait)
      call count_hits(self, history, 1_int64)
    else
      call pass_line(self%table, motion, wait)
      if (met == meets_gate) call enter_gate(self, history, particle, motion)
      if (met == meets_line) call cross_over(self, history, particle, side, chamber)
    end if
  end subroutine meet

  !> A particle has come into the gate of its side.
  subroutine enter_gate(self, history, particle, motion)
    class(wall_by_wall_type), intent(inout) :: self
    type(history_type), intent(inout) :: history
    !> Its number, from 1.
    integer, intent(in) :: particle
    type(motion_type), intent(in) :: motion

    call enter(self%gate(motion%side), self%now + time_to_middle(motion), particle)
    if (history%logging) call record_event(history, self%since, event_entry, int(motion%side), &
      particle)
  end subroutine enter_gate

  !> A particle has come to the line of its channel, from `chamber` of `side`.
  subroutine cross_over(self, history, particle, side, chamber)
    class(wall_by_wall_type), intent(inout) :: self
    type(history_type), intent(inout) :: history
    !> Its number; side 1 or 2; `in_gate` or `in_return`.
    integer, intent(in) :: particle, side, chamber

    if (chamber == in_gate) then
      call cross(self%gate(side), particle)
      call record_crossing(history, self%since, crossing_of(side, gated), particle)
    else
      call record_crossing(history, self%since, crossing_of(side, ungated), particle)
    end if
    if (self%table%beyond(side) == side) then
      call count_hits(self, history, 1_int64)
    else
      self%difference = self%difference + merge(-2, 2, side == 1)
    end if
  end subroutine cross_over

  !> `hits` wall collisions, and the state right after them.
  subroutine count_hits(self, history, hits)
    class(wall_by_wall_type), intent(inout) :: self
    type(history_type), intent(inout) :: history
    integer(int64), intent(in) :: hits

    self%hits = self%hits + hits
    history%collision_spread_sum = history%collision_spread_sum + hits*abs(self%difference)
    history%collisions_seen = history%collisions_seen + hits
  end subroutine count_hits

  !> The gates decide, and the log of the instant, events `first` and later, is put in order.
  subroutine end_instant(self, first, history)
    class(wall_by_wall_type), intent(inout) :: self
    integer, intent(in) :: first
    type(history_type), intent(inout) :: history

    if (undecided(self%gate)) call let_gates_decide(self, history)
    if (history%events > first) call order_events(history, first, history%events)
  end subroutine end_instant

  !> Where a gate turns, all those counted in it turn back.
  subroutine let_gates_decide(self, history)
    class(wall_by_wall_type), intent(inout) :: self
    type(history_type), intent(inout) :: history
    integer :: side, place
    logical :: turns

    do side = 1, 2
      call decide(self%gate(side), turns)
      if (.not. turns) cycle
      call record_reversal(history, self%since, side, number_inside(self%gate(side)))
      do place = 1, number_inside(self%gate(side))
        call self%turn_particle(who_is_inside(self%gate(side), place))
      end do
      call turned_back(self%gate(side))
    end do
  end subroutine let_gates_decide

  !> Turns particle `i` of a gate back.
  subroutine turn_particle(self, i)
    class(wall_by_wall_type), intent(inout) :: self
    integer, intent(in) :: i
    type(motion_type) :: motion
    real(wp) :: wait

    motion = self%motion_now(i)
    call turn_back(self%table, motion, wait)
    call self%write_down(i, motion, wait)
  end subroutine turn_particle

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

  !> The counts, through a stream.
  subroutine pass_counts(self, stream)
    class(wall_by_wall_type), intent(inout) :: self
    type(stream_type), intent(inout) :: stream

    call stream%pass('difference', self%difference)
    call stream%pass('hits', self%hits)
  end subroutine pass_counts

end module battery_wall_by_wall

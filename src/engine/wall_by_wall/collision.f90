!> The engine `collision`: every wall collision is an event, and every particle has its own time. An
!> exact reference for `excursion`.
!>
!> The state of a particle is that at its last event; the particle is moved only when its next event
!> is due. A tournament holds the next event of each particle, with the earliest at its root.
!> Crossings of chords, of the middle line and of the periodic line are events too, but not
!> collisions. An event costs O(log N), except a reversal, which moves all particles that the gate
!> counts.
module battery_collision
  use battery_kinds, only: wp, int64
  use battery_table, only: table_type
  use battery_motion, only: motion_type, move_straight, meets_channel_wall, meets_nothing
  use battery_wall_motion, only: hit_wall, reverse_motion
  use battery_wall_by_wall, only: wall_by_wall_type, reset_counts, serialize_counts, &
    process_event, end_instant, count_hits, longest_window, end_of_window, window_events, most_hits
  use battery_tournament, only: tournament_type, new_tournament, set_event_time, event_time_of, &
    rebase_tournament
  use battery_engine, only: rebase_gates_and_clock
  use battery_event_record, only: event_record_type
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: collision_type

  !> The engine: state of each particle at its last event, and time of its next.
  type, extends(wall_by_wall_type) :: collision_type
    private
    type(motion_type), allocatable :: motion(:)
    !> Next event of each particle.
    type(tournament_type) :: tournament
  contains
    procedure :: prepare_engine, process_window, rebase_clock, serialize_own_state
    procedure :: reverse_particle, motion_now, store_motion
  end type collision_type

contains

  !> Sets the length of the longest window, from the table and the number of particles; allocates
  !> the particles, which have no events yet.
  subroutine prepare_engine(self)
    class(collision_type), intent(inout) :: self
    real(wp), allocatable :: due(:)

    call reset_counts(self)
    self%window = longest_window(self, window_events)
    if (allocated(self%motion)) deallocate (self%motion)
    allocate (self%motion(self%number))
    allocate (due(self%number), source=huge(1.0_wp))
    call new_tournament(self%tournament, due)
  end subroutine prepare_engine

  !> Processes the events of a window, one particle at a time. It lasts `duration`, or less if the
  !> longest window or the epoch ends before, or after `most_hits` wall hits.
  subroutine process_window(self, event_record, duration)
    class(collision_type), intent(inout) :: self
    type(event_record_type), intent(inout) :: event_record
    real(wp), intent(in) :: duration
    real(wp) :: window_end, wait
    integer(int64) :: hits
    integer :: i, first

    window_end = end_of_window(self, duration)
    do
      call process_collisions_until(self%table, self%number, self%motion, self%tournament, &
        window_end, hits)
      call count_hits(self, event_record, hits)
      if (self%tournament%node(1)%time >= window_end) exit
      if (event_record%collisions_seen >= most_hits) then
        window_end = self%tournament%node(1)%time
        exit
      end if
      self%now = self%tournament%node(1)%time
      self%window_time = self%now - self%window_start
      first = event_record%events + 1
      do while (self%tournament%node(1)%time <= self%now)
        i = self%tournament%node(1)%particle
        call move_straight(self%motion(i), self%now - self%motion(i)%time)
        self%motion(i)%time = self%now
        call process_event(self, event_record, i, self%motion(i), wait)
        call set_event_time(self%tournament, i, self%now + wait)
      end do
      call end_instant(self, first, event_record)
    end do
    self%now = window_end
    self%window_time = window_end - self%window_start
  end subroutine process_window

  !> Hot loop: processes wall collisions until an event of another kind is due or the window ends. A
  !> collision changes one particle only.
  pure subroutine process_collisions_until(table, number, motion, tournament, window_end, hits)
    type(table_type), intent(in) :: table
    integer, intent(in) :: number
    type(motion_type), intent(inout) :: motion(number)
    type(tournament_type), intent(inout) :: tournament
    real(wp), intent(in) :: window_end
    integer(int64), intent(out) :: hits
    real(wp) :: time, wait
    integer :: i

    hits = 0
    do
      time = tournament%node(1)%time
      i = tournament%node(1)%particle
      if (time >= window_end .or. motion(i)%next < meets_channel_wall .or. hits >= most_hits) exit
      call move_straight(motion(i), time - motion(i)%time)
      call hit_wall(table, motion(i), wait)
      motion(i)%time = time
      call set_event_time(tournament, i, time + wait)
      hits = hits + 1
    end do
  end subroutine process_collisions_until

  !> Reverses the axial velocity of particle `i`.
  subroutine reverse_particle(self, i)
    class(collision_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp) :: wait

    call move_straight(self%motion(i), self%now - self%motion(i)%time)
    self%motion(i)%time = self%now
    call reverse_motion(self%table, self%motion(i), wait)
    call set_event_time(self%tournament, i, self%now + wait)
  end subroutine reverse_particle

  !> State of particle `i` now; a particle without a next event stays at its stored position.
  pure function motion_now(self, i) result(motion)
    class(collision_type), intent(in) :: self
    integer, intent(in) :: i
    type(motion_type) :: motion

    motion = self%motion(i)
    if (motion%next /= meets_nothing) call move_straight(motion, self%now - motion%time)
    motion%time = self%now
  end function motion_now

  !> Stores the state of particle `i` now; its next event is due after the time `wait`.
  subroutine store_motion(self, i, motion, wait)
    class(collision_type), intent(inout) :: self
    integer, intent(in) :: i
    type(motion_type), intent(in) :: motion
    real(wp), intent(in) :: wait

    self%motion(i) = motion
    call set_event_time(self%tournament, i, self%now + wait)
  end subroutine store_motion

  !> Shifts all times back by one epoch.
  subroutine rebase_clock(self)
    class(collision_type), intent(inout) :: self

    self%motion%time = self%motion%time - self%epoch
    call rebase_tournament(self%tournament, self%epoch)
    call rebase_gates_and_clock(self)
  end subroutine rebase_clock

  !> Saves or restores the counts, the particles, and the time of the next event of each particle.
  subroutine serialize_own_state(self, archive)
    class(collision_type), intent(inout) :: self
    type(archive_type), intent(inout) :: archive
    real(wp), allocatable :: due(:)
    integer :: i

    call serialize_counts(self, archive)
    call archive%serialize('x', self%motion%x, 'y', self%motion%y, 'ux', self%motion%ux, &
      'uy', self%motion%uy, 'time', self%motion%time)
    call archive%serialize('side', self%motion%urn)
    call archive%serialize('chamber', self%motion%chamber)
    call archive%serialize('next', self%motion%next)
    due = [(event_time_of(self%tournament, i), i=1, self%number)]
    call archive%serialize('due', due)
    if (archive%reading) call new_tournament(self%tournament, due)
  end subroutine serialize_own_state

end module battery_collision

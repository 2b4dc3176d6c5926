!> The engine `collision`: every wall collision is an event, and every particle has its own clock.
!>
!> A particle is where it was at its last event; it is moved when it has its next one. The earliest
!> event of all stands at the root of a tournament. Crossings of chords, of the middle line and of
!> the periodic line are events too, but no collisions. An event costs O(log N), whatever it is,
!> except a reversal, which brings all those counted in a gate to its time.
module battery_collision
  use battery_kinds, only: wp, int64
  use battery_table, only: table_type
  use battery_motion, only: motion_type, fly, meets_channel_wall, meets_nothing
  use battery_bounce, only: hit_wall, turn_back
  use battery_wall_by_wall, only: wall_by_wall_type, prepare_walls, take_in, pass_counts, &
    meet, end_instant, count_hits, longest_window, end_of_window, window_events, most_hits
  use battery_tournament, only: tournament_type, new_tournament, set_time, time_of, shift_times
  use battery_engine, only: particles_type, turn_clock
  use battery_history, only: history_type
  use battery_stream, only: stream_type
  implicit none (type, external)
  private
  public :: collision_type

  !> The engine: where each was at its last event, and when each has its next.
  type, extends(wall_by_wall_type) :: collision_type
    private
    type(motion_type), allocatable :: motion(:)
    !> When each has its next event.
    type(tournament_type) :: tournament
    !> The same where there is no tournament yet.
    real(wp), allocatable :: due(:)
  contains
    procedure :: prepare, take_over, go_on, turn_page, pass_own
    procedure :: turn_particle, motion_now, write_down
  end type collision_type

contains

  !> Walls, the longest window, and room for the particles.
  subroutine prepare(self)
    class(collision_type), intent(inout) :: self

    call prepare_walls(self)
    self%window = longest_window(self, window_events)
    if (allocated(self%motion)) deallocate (self%motion)
    if (allocated(self%due)) deallocate (self%due)
    allocate (self%motion(self%number))
    allocate (self%due(self%number), source=huge(1.0_wp))
  end subroutine prepare

  !> Takes in the particles, and begins the tournament of their first events.
  subroutine take_over(self, particles)
    class(collision_type), intent(inout) :: self
    type(particles_type), intent(inout) :: particles

    call take_in(self, particles)
    call begin_tournament(self)
  end subroutine take_over

  subroutine begin_tournament(self)
    class(collision_type), intent(inout) :: self

    call new_tournament(self%tournament, self%due)
    deallocate (self%due)
  end subroutine begin_tournament

  !> Event by event, each at its particle alone, for the time `duration` at most.
  subroutine go_on(self, history, duration)
    class(collision_type), intent(inout) :: self
    type(history_type), intent(inout) :: history
    real(wp), intent(in) :: duration
    real(wp) :: ends, wait
    integer(int64) :: hits
    integer :: i, first

    ends = end_of_window(self, duration)
    do
      call bounce_until(self%table, self%number, self%motion, self%tournament, ends, hits)
      call count_hits(self, history, hits)
      if (self%tournament%node(1)%time >= ends) exit
      if (history%collisions_seen >= most_hits) then
        ends = self%tournament%node(1)%time
        exit
      end if
      self%now = self%tournament%node(1)%time
      self%since = self%now - self%began
      first = history%events + 1
      do while (self%tournament%node(1)%time <= self%now)
        i = self%tournament%node(1)%particle
        call fly(self%motion(i), self%now - self%motion(i)%time)
        self%motion(i)%time = self%now
        call meet(self, history, i, self%motion(i), wait)
        call set_time(self%tournament, i, self%now + wait)
      end do
      call end_instant(self, first, history)
    end do
    self%now = ends
    self%since = ends - self%began
  end subroutine go_on

  !> The hot loop: wall collisions, until something else is due or the window ends. They touch only
  !> the particle that has one.
  pure subroutine bounce_until(table, number, motion, tournament, ends, hits)
    type(table_type), intent(in) :: table
    integer, intent(in) :: number
    type(motion_type), intent(inout) :: motion(number)
    type(tournament_type), intent(inout) :: tournament
    real(wp), intent(in) :: ends
    integer(int64), intent(out) :: hits
    real(wp) :: time, wait
    integer :: i

    hits = 0
    do
      time = tournament%node(1)%time
      i = tournament%node(1)%particle
      if (time >= ends .or. motion(i)%next < meets_channel_wall .or. hits >= most_hits) exit
      call fly(motion(i), time - motion(i)%time)
      call hit_wall(table, motion(i), wait)
      motion(i)%time = time
      call set_time(tournament, i, time + wait)
      hits = hits + 1
    end do
  end subroutine bounce_until

  !> Turns particle `i` of a gate back, where it is kept.
  subroutine turn_particle(self, i)
    class(collision_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp) :: wait

    call fly(self%motion(i), self%now - self%motion(i)%time)
    self%motion(i)%time = self%now
    call turn_back(self%table, self%motion(i), wait)
    call set_time(self%tournament, i, self%now + wait)
  end subroutine turn_particle

  !> Particle `i`, flown on from its last event until now, if it meets anything at all.
  pure function motion_now(self, i) result(motion)
    class(collision_type), intent(in) :: self
    integer, intent(in) :: i
    type(motion_type) :: motion

    motion = self%motion(i)
    if (motion%next /= meets_nothing) call fly(motion, self%now - motion%time)
    motion%time = self%now
  end function motion_now

  !> Particle `i` as it is now; its next event is due after the time `wait`.
  subroutine write_down(self, i, motion, wait)
    class(collision_type), intent(inout) :: self
    integer, intent(in) :: i
    type(motion_type), intent(in) :: motion
    real(wp), intent(in) :: wait

    self%motion(i) = motion
    if (allocated(self%due)) then
      self%due(i) = self%now + wait
    else
      call set_time(self%tournament, i, self%now + wait)
    end if
  end subroutine write_down

  !> Sets back the motions, the tournament and the clock.
  subroutine turn_page(self)
    class(collision_type), intent(inout) :: self

    self%motion%time = self%motion%time - self%page
    call shift_times(self%tournament, self%page)
    call turn_clock(self)
  end subroutine turn_page

  !> The counts, the motions and when each has its event, through a stream.
  subroutine pass_own(self, stream)
    class(collision_type), intent(inout) :: self
    type(stream_type), intent(inout) :: stream
    integer :: i

    call pass_counts(self, stream)
    call stream%pass('x', self%motion%x, 'y', self%motion%y, 'ux', self%motion%ux, &
      'uy', self%motion%uy, 'time', self%motion%time)
    call stream%pass('side', self%motion%side)
    call stream%pass('chamber', self%motion%chamber)
    call stream%pass('next', self%motion%next)
    if (.not. stream%reading) self%due = [(time_of(self%tournament, i), i=1, self%number)]
    call stream%pass('due', self%due)
    call begin_tournament(self)
  end subroutine pass_own

end module battery_collision

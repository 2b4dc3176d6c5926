!> The engine `collision`: every wall collision is an event, and every particle has its own clock.
!>
!> A particle is where it was at its last event; it is moved when it has its next one. The earliest
!> event of all stands at the root of a tournament. Crossings of chords, of the middle line and of
!> the periodic line are events too, but no collisions. An event costs O(log N), whatever it is,
!> except a reversal, which brings all those counted in a gate to its time.
!>
!> Time is counted within a page, a power of two, so that it resolves the same however long the run
!> has been; at its end all clocks are set back by it, which is exact.
module battery_collision
  use battery_kinds, only: wp, int8, int64
  use battery_table, only: table_type
  use battery_bounce, only: walls_type, flight_type, take_off, fly, hit_arc, hit_channel, reverse, &
    is_trapped, meets_arc, meets_wall, meets_nothing
  use battery_instant, only: scene_type, new_scene, board, meet, turns_back, count_reversal, &
    order_events
  use battery_tournament, only: tournament_type, new_tournament, set_time, time_of, shift_times
  use battery_engine, only: engine_type, engine_state_type, history_type, particles_type, &
    reserve_history
  implicit none (type, external)
  private
  public :: collision_type

  !> A window is at most so many urn radii long, and has about so many events at most.
  real(wp), parameter :: window_radii = 2.0_wp, window_events = 65536.0_wp

  !> A window ends after so many wall collisions, far more than usual: in a channel that is hardly
  !> wider than nothing a single particle would keep the run from hearing a signal.
  integer(int64), parameter :: most_hits = 2_int64**24

  type, extends(engine_type) :: collision_type
    private
    type(scene_type) :: scene
    type(flight_type), allocatable :: flight(:)
    type(tournament_type) :: tournament
    !> Time since the page was turned, and how often it was.
    real(wp) :: now = 0.0_wp
    integer(int64) :: pages = 0
    real(wp) :: clock_start = 0.0_wp
    !> Longest window.
    real(wp) :: window = 0.0_wp
  contains
    procedure :: start
    procedure :: advance
    procedure :: particles => all_particles
    procedure :: collisions
    procedure :: trapped
    procedure :: clock
    procedure :: save_state
    procedure :: restore_state
  end type collision_type

contains

  subroutine start(self, table, threshold, particles, clock)
    class(collision_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold
    type(particles_type), intent(inout) :: particles
    real(wp), intent(in) :: clock
    real(wp), allocatable :: due(:)
    integer :: i

    call prepare(self, table, threshold, size(particles%x))
    self%clock_start = clock
    allocate (due(self%number))
    do i = 1, self%number
      self%flight(i)%x = particles%x(i)
      self%flight(i)%y = particles%y(i)
      self%flight(i)%ux = particles%ux(i)
      self%flight(i)%uy = particles%uy(i)
      call take_off(table, self%scene%walls, self%flight(i), due(i))
      call board(self%scene, i, self%flight(i))
    end do
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
    call new_tournament(self%tournament, due)
  end subroutine start

  !> What follows from the table and the number of particles.
  subroutine prepare(self, table, threshold, number)
    type(collision_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number

    self%table = table
    self%threshold = threshold
    self%number = number
    self%sees_collisions = .true.
    call new_scene(self%scene, table, threshold, number)
    self%window = table%urn_radius*min(window_radii, window_events/real(number, wp))
    if (allocated(self%flight)) deallocate (self%flight)
    allocate (self%flight(number))
    self%now = 0.0_wp
    self%pages = 0
  end subroutine prepare

  subroutine advance(self, duration, history)
    class(collision_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(history_type), intent(inout) :: history
    real(wp) :: began, ends, time
    integer(int64) :: hits

    if (self%now >= self%scene%walls%page) call turn_page(self)
    began = self%now
    ends = min(began + min(duration, self%window), self%scene%walls%page)
    call reserve_history(history, 64, 64)
    do
      call bounce_until(self%scene%walls, self%number, self%flight, self%tournament, ends, hits)
      self%scene%hits = self%scene%hits + hits
      history%collisions_seen = history%collisions_seen + hits
      history%collision_spread_sum = history%collision_spread_sum + hits*abs(self%scene%difference)
      time = self%tournament%node(1)%time
      if (time >= ends) exit
      if (history%collisions_seen >= most_hits) then
        ends = time
        exit
      end if
      call live_instant(self, time, began, history)
    end do
    self%now = ends
    history%duration = ends - began
    history%collisions = history%collisions_seen
  end subroutine advance

  !> The hot loop: wall collisions, until something else is due or the window ends. They touch only
  !> the particle that has one.
  pure subroutine bounce_until(walls, number, flight, tournament, ends, hits)
    type(walls_type), intent(in) :: walls
    integer, intent(in) :: number
    type(flight_type), intent(inout) :: flight(number)
    type(tournament_type), intent(inout) :: tournament
    real(wp), intent(in) :: ends
    integer(int64), intent(out) :: hits
    real(wp) :: time, wait
    integer :: i

    hits = 0
    do
      time = tournament%node(1)%time
      i = tournament%node(1)%particle
      if (time >= ends .or. flight(i)%next > meets_wall .or. hits >= most_hits) exit
      call fly(flight(i), time - flight(i)%time)
      if (flight(i)%next == meets_arc) then
        call hit_arc(walls, flight(i), wait)
      else
        call hit_channel(walls, flight(i), wait)
      end if
      flight(i)%time = time
      call set_time(tournament, i, time + wait)
      hits = hits + 1
    end do
  end subroutine bounce_until

  !> Everything that is due at `time`, then what the gates decide.
  subroutine live_instant(self, time, began, history)
    type(collision_type), intent(inout) :: self
    real(wp), intent(in) :: time, began
    type(history_type), intent(inout) :: history
    real(wp) :: wait
    integer :: i, g, first
    logical :: turns

    first = history%events + 1
    do while (self%tournament%node(1)%time <= time)
      i = self%tournament%node(1)%particle
      call fly(self%flight(i), time - self%flight(i)%time)
      self%flight(i)%time = time
      call meet(self%scene, history, time - began, i, self%flight(i), wait)
      call set_time(self%tournament, i, time + wait)
    end do
    do g = 1, 2
      call turns_back(self%scene, g, turns)
      if (turns) call reverse_gate(self, g, time, began, history)
    end do
    if (history%events > first) call order_events(history, first)
  end subroutine live_instant

  !> All those counted in a gate turn back at `time`.
  subroutine reverse_gate(self, g, time, began, history)
    type(collision_type), intent(inout) :: self
    integer, intent(in) :: g
    real(wp), intent(in) :: time, began
    type(history_type), intent(inout) :: history
    real(wp) :: wait
    integer :: member, i

    do member = 1, self%scene%gate(g)%count
      i = self%scene%gate(g)%member(member)
      call fly(self%flight(i), time - self%flight(i)%time)
      self%flight(i)%time = time
      call reverse(self%scene%walls, self%flight(i), wait)
      call set_time(self%tournament, i, time + wait)
    end do
    call count_reversal(self%scene, g, time - began, history)
  end subroutine reverse_gate

  !> All clocks are set back by the length of the page.
  subroutine turn_page(self)
    type(collision_type), intent(inout) :: self

    self%flight%time = self%flight%time - self%scene%walls%page
    call shift_times(self%tournament, self%scene%walls%page)
    self%now = self%now - self%scene%walls%page
    self%pages = self%pages + 1
  end subroutine turn_page

  subroutine all_particles(self, first, last, particles)
    class(collision_type), intent(in) :: self
    integer, intent(in) :: first, last
    type(particles_type), intent(out) :: particles
    type(flight_type) :: flight
    integer :: i, k

    allocate (particles%x(last - first + 1), particles%y(last - first + 1))
    allocate (particles%ux(last - first + 1), particles%uy(last - first + 1))
    do i = first, last
      k = i - first + 1
      flight = self%flight(i)
      if (flight%next /= meets_nothing) call fly(flight, self%now - flight%time)
      particles%x(k) = flight%x
      particles%y(k) = flight%y
      particles%ux(k) = flight%ux
      particles%uy(k) = flight%uy
    end do
  end subroutine all_particles

  function collisions(self) result(total)
    class(collision_type), intent(in) :: self
    integer(int64) :: total

    total = self%scene%hits
  end function collisions

  function trapped(self) result(total)
    class(collision_type), intent(in) :: self
    integer(int64) :: total

    total = count(is_trapped(self%flight), kind=int64)
  end function trapped

  function clock(self) result(time)
    class(collision_type), intent(in) :: self
    real(wp) :: time

    time = self%clock_start + (real(self%pages, wp)*self%scene%walls%page + self%now)
  end function clock

  subroutine save_state(self, state)
    class(collision_type), intent(in) :: self
    type(engine_state_type), intent(out) :: state
    integer :: i

    state%integers = [self%pages, self%scene%hits]
    allocate (state%reals(2 + 6*self%number))
    state%reals(:2) = [self%now, self%clock_start]
    do i = 1, self%number
      associate (flight => self%flight(i))
        state%reals(6*i - 3:6*i + 2) = [flight%x, flight%y, flight%ux, flight%uy, flight%time, &
          time_of(self%tournament, i)]
      end associate
    end do
    state%bytes = 8_int8*self%flight%region + self%flight%next - 1_int8
  end subroutine save_state

  subroutine restore_state(self, table, threshold, number, state)
    class(collision_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number
    type(engine_state_type), intent(in) :: state
    integer :: i

    call prepare(self, table, threshold, number)
    self%pages = state%integers(1)
    self%scene%hits = state%integers(2)
    self%now = state%reals(1)
    self%clock_start = state%reals(2)
    do i = 1, number
      self%flight(i) = flight_type(x=state%reals(6*i - 3), y=state%reals(6*i - 2), &
        ux=state%reals(6*i - 1), uy=state%reals(6*i), time=state%reals(6*i + 1), &
        region=state%bytes(i)/8_int8, next=modulo(state%bytes(i), 8_int8) + 1_int8)
      call board(self%scene, i, self%flight(i))
    end do
    call new_tournament(self%tournament, state%reals(8:6*number + 2:6))
  end subroutine restore_state

end module battery_collision

!> The engine `synchronous`: the paper's own algorithm. At every event all particles move to it.
!>
!> One pass over all particles takes the time that has gone by off what each has left until its next
!> event, moves it along its straight line, and finds the earliest of the next events. Then the
!> particle that has its event is treated alone. An event costs O(N): this engine is here to measure
!> the others by, so the pass is as quick as it can be made:
!> - A minimum is kept for each lane, not for each row of particles: vector instructions without a
!>   branch and without a reduction, until the lanes themselves are compared by halves.
!> - The five numbers of a row of particles stand side by side. Five long arrays of their own, as
!>   long as a power of two, fell onto the same lines of the cache and took twice the time.
!> - Every other pass goes backwards and finds the rows that the last one left in the cache: 1000
!>   particles are a little more than the first level holds. That takes another third off.
module battery_synchronous
  use battery_kinds, only: wp, int8, int64
  use battery_table, only: table_type
  use battery_bounce, only: flight_type, take_off, reverse, is_trapped, meets_nothing
  use battery_instant, only: scene_type, new_scene, board, meet, turns_back, count_reversal, &
    order_events
  use battery_engine, only: engine_type, engine_state_type, history_type, particles_type, &
    reserve_history
  implicit none (type, external)
  private
  public :: synchronous_type

  !> Particles in a row: a multiple of any vector's length, and so many that the compiler does not
  !> unroll the loop over them before it vectorises it. About as many as there are rows for
  !> N = 1000, since both a row and a lane are searched at each event.
  integer, parameter :: lanes = 32

  !> What is known of a particle: position, velocity, time left until its next event.
  integer, parameter :: in_x = 1, in_y = 2, in_ux = 3, in_uy = 4, in_left = 5

  !> A window is at most so many urn radii long, and has about so many events at most.
  real(wp), parameter :: window_radii = 2.0_wp, window_events = 65536.0_wp, &
    window_moves = 1.0e9_wp

  !> A window ends after so many wall collisions, far more than usual: in a channel that is hardly
  !> wider than nothing a single particle would keep the run from hearing a signal.
  integer(int64), parameter :: most_hits = 2_int64**24

  type, extends(engine_type) :: synchronous_type
    private
    type(scene_type) :: scene
    !> All of them now: lane, which number (`in_x` ...), row. Who is not there or meets nothing
    !> stands still and has a huge time left.
    real(wp), allocatable :: field(:, :, :)
    integer(int8), allocatable :: region(:), next(:)
    !> Whether the next pass goes backwards.
    logical :: backwards = .false.
    !> Velocities of those that meet nothing.
    real(wp), allocatable :: kept_ux(:), kept_uy(:)
    !> Least time left in each lane.
    real(wp) :: least(lanes) = 0.0_wp
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
  end type synchronous_type

contains

  subroutine start(self, table, threshold, particles, clock)
    class(synchronous_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold
    type(particles_type), intent(inout) :: particles
    real(wp), intent(in) :: clock
    type(flight_type) :: flight
    real(wp) :: wait
    integer :: i

    call prepare(self, table, threshold, size(particles%x))
    self%clock_start = clock
    do i = 1, self%number
      flight = flight_type(x=particles%x(i), y=particles%y(i), ux=particles%ux(i), &
        uy=particles%uy(i))
      call take_off(table, self%scene%walls, flight, wait)
      call board(self%scene, i, flight)
      call write_down(self, i, flight, wait)
    end do
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
    call pass(self, 0.0_wp)
  end subroutine start

  !> What follows from the table and the number of particles.
  subroutine prepare(self, table, threshold, number)
    type(synchronous_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number

    self%table = table
    self%threshold = threshold
    self%number = number
    self%sees_collisions = .true.
    call new_scene(self%scene, table, threshold, number)
    self%window = table%urn_radius*min(window_radii, window_events/real(number, wp), &
      window_moves/real(number, wp)**2)
    self%now = 0.0_wp
    self%pages = 0
    if (allocated(self%field)) deallocate (self%field, self%region, self%next, self%kept_ux, &
      self%kept_uy)
    allocate (self%field(lanes, in_left, (number + lanes - 1)/lanes), source=0.0_wp)
    self%field(:, in_left, :) = huge(1.0_wp)
    allocate (self%region(number), self%next(number), source=meets_nothing)
    allocate (self%kept_ux(number), self%kept_uy(number), source=0.0_wp)
  end subroutine prepare

  subroutine advance(self, duration, history)
    class(synchronous_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(history_type), intent(inout) :: history
    real(wp) :: began, ends, wait
    integer(int64) :: hits

    if (self%now >= self%scene%walls%page) then
      self%now = self%now - self%scene%walls%page
      self%pages = self%pages + 1
    end if
    began = self%now
    hits = self%scene%hits
    ends = min(began + min(duration, self%window), self%scene%walls%page)
    call reserve_history(history, 64, 64)
    do
      wait = earliest(self%least)
      if (self%now + wait >= ends) exit
      if (self%scene%hits - hits >= most_hits) then
        ends = self%now
        exit
      end if
      call pass(self, wait)
      self%now = self%now + wait
      call live_instant(self, self%now - began, history)
    end do
    ! Not by more than what is left, lest the event lie in the past by rounding.
    wait = min(wait, ends - self%now)
    call pass(self, wait)
    self%now = ends
    history%duration = ends - began
    history%collisions = self%scene%hits - hits
  end subroutine advance

  !> Moves everyone by `time`.
  subroutine pass(self, time)
    type(synchronous_type), intent(inout) :: self
    real(wp), intent(in) :: time

    call move_all(size(self%field, 3), self%backwards, time, self%field, self%least)
    self%backwards = .not. self%backwards
  end subroutine pass

  !> The pass itself. `least` is the least time left in each lane.
  pure subroutine move_all(rows, backwards, time, field, least)
    integer, intent(in) :: rows
    logical, intent(in) :: backwards
    real(wp), intent(in) :: time
    real(wp), intent(inout) :: field(lanes, in_left, rows)
    real(wp), intent(out) :: least(lanes)
    real(wp) :: left
    integer :: k, row, lane

    least = huge(1.0_wp)
    do k = 1, rows
      row = merge(rows + 1 - k, k, backwards)
      do lane = 1, lanes
        field(lane, in_x, row) = field(lane, in_x, row) + field(lane, in_ux, row)*time
        field(lane, in_y, row) = field(lane, in_y, row) + field(lane, in_uy, row)*time
        left = field(lane, in_left, row) - time
        field(lane, in_left, row) = left
        least(lane) = merge(left, least(lane), left < least(lane))
      end do
    end do
  end subroutine move_all

  !> The least of all lanes, by halves, which the processor does side by side.
  pure function earliest(least) result(time)
    real(wp), intent(in) :: least(lanes)
    real(wp) :: time
    real(wp) :: half(lanes)
    integer :: width

    half = least
    width = lanes
    do while (width > 1)
      width = width/2
      half(:width) = min(half(:width), half(width + 1:2*width))
    end do
    time = half(1)
  end function earliest

  !> Everything that is due now, then what the gates decide.
  subroutine live_instant(self, since, history)
    type(synchronous_type), intent(inout) :: self
    real(wp), intent(in) :: since
    type(history_type), intent(inout) :: history
    type(flight_type) :: flight
    real(wp) :: wait
    integer :: i, g, first
    logical :: turns

    first = history%events + 1
    do
      call who_is_due(self, i)
      if (i == 0) exit
      flight = look_up(self, i)
      call meet(self%scene, history, since, i, flight, wait)
      call write_down(self, i, flight, wait)
      call renew_lane(size(self%field, 3), modulo(i - 1, lanes) + 1, self%field, self%least)
    end do
    do g = 1, 2
      call turns_back(self%scene, g, turns)
      if (turns) call reverse_gate(self, g, since, history)
    end do
    if (history%events > first) call order_events(history, first)
  end subroutine live_instant

  !> A particle with no time left; 0 if there is none.
  pure subroutine who_is_due(self, i)
    type(synchronous_type), intent(in) :: self
    integer, intent(out) :: i
    integer :: lane, row

    do lane = 1, lanes
      if (self%least(lane) <= 0.0_wp) then
        do row = 1, size(self%field, 3)
          i = lanes*(row - 1) + lane
          if (self%field(lane, in_left, row) <= 0.0_wp) return
        end do
      end if
    end do
    i = 0
  end subroutine who_is_due

  !> All those counted in a gate turn back.
  subroutine reverse_gate(self, g, since, history)
    type(synchronous_type), intent(inout) :: self
    integer, intent(in) :: g
    real(wp), intent(in) :: since
    type(history_type), intent(inout) :: history
    type(flight_type) :: flight
    real(wp) :: wait
    integer :: member, i

    do member = 1, self%scene%gate(g)%count
      i = self%scene%gate(g)%member(member)
      flight = look_up(self, i)
      call reverse(self%scene%walls, flight, wait)
      call write_down(self, i, flight, wait)
      call renew_lane(size(self%field, 3), modulo(i - 1, lanes) + 1, self%field, self%least)
    end do
    call count_reversal(self%scene, g, since, history)
  end subroutine reverse_gate

  !> A particle out of the arrays.
  pure function look_up(self, i) result(flight)
    class(synchronous_type), intent(in) :: self
    integer, intent(in) :: i
    type(flight_type) :: flight
    integer :: lane, row

    lane = modulo(i - 1, lanes) + 1
    row = (i - 1)/lanes + 1
    flight%x = self%field(lane, in_x, row)
    flight%y = self%field(lane, in_y, row)
    flight%ux = self%field(lane, in_ux, row) + self%kept_ux(i)
    flight%uy = self%field(lane, in_uy, row) + self%kept_uy(i)
    flight%region = self%region(i)
    flight%next = self%next(i)
  end function look_up

  !> A particle back into the arrays, with the time left until its next event.
  pure subroutine write_down(self, i, flight, left)
    type(synchronous_type), intent(inout) :: self
    integer, intent(in) :: i
    type(flight_type), intent(in) :: flight
    real(wp), intent(in) :: left
    integer :: lane, row

    lane = modulo(i - 1, lanes) + 1
    row = (i - 1)/lanes + 1
    self%field(lane, :, row) = [flight%x, flight%y, flight%ux, flight%uy, left]
    self%region(i) = flight%region
    self%next(i) = flight%next
    if (flight%next /= meets_nothing) return
    self%kept_ux(i) = flight%ux
    self%kept_uy(i) = flight%uy
    self%field(lane, in_ux:in_uy, row) = 0.0_wp
  end subroutine write_down

  !> The least time left in one lane.
  pure subroutine renew_lane(rows, lane, field, least)
    integer, intent(in) :: rows, lane
    real(wp), intent(in) :: field(lanes, in_left, rows)
    real(wp), intent(inout) :: least(lanes)
    real(wp) :: time
    integer :: row

    time = huge(1.0_wp)
    do row = 1, rows
      time = merge(field(lane, in_left, row), time, field(lane, in_left, row) < time)
    end do
    least(lane) = time
  end subroutine renew_lane

  subroutine all_particles(self, first, last, particles)
    class(synchronous_type), intent(in) :: self
    integer, intent(in) :: first, last
    type(particles_type), intent(out) :: particles
    type(flight_type) :: flight
    integer :: i

    allocate (particles%x(last - first + 1), particles%y(last - first + 1))
    allocate (particles%ux(last - first + 1), particles%uy(last - first + 1))
    do i = first, last
      flight = look_up(self, i)
      particles%x(i - first + 1) = flight%x
      particles%y(i - first + 1) = flight%y
      particles%ux(i - first + 1) = flight%ux
      particles%uy(i - first + 1) = flight%uy
    end do
  end subroutine all_particles

  function collisions(self) result(total)
    class(synchronous_type), intent(in) :: self
    integer(int64) :: total

    total = self%scene%hits
  end function collisions

  function trapped(self) result(total)
    class(synchronous_type), intent(in) :: self
    integer(int64) :: total
    integer :: i

    total = 0
    do i = 1, self%number
      if (is_trapped(look_up(self, i))) total = total + 1
    end do
  end function trapped

  function clock(self) result(time)
    class(synchronous_type), intent(in) :: self
    real(wp) :: time

    time = self%clock_start + (real(self%pages, wp)*self%scene%walls%page + self%now)
  end function clock

  subroutine save_state(self, state)
    class(synchronous_type), intent(in) :: self
    type(engine_state_type), intent(out) :: state
    type(flight_type) :: flight
    integer :: i

    state%integers = [self%pages, self%scene%hits]
    allocate (state%reals(2 + 5*self%number))
    state%reals(:2) = [self%now, self%clock_start]
    do i = 1, self%number
      flight = look_up(self, i)
      state%reals(5*i - 2:5*i + 2) = [flight%x, flight%y, flight%ux, flight%uy, &
        self%field(modulo(i - 1, lanes) + 1, in_left, (i - 1)/lanes + 1)]
    end do
    state%bytes = 8_int8*self%region + self%next - 1_int8
  end subroutine save_state

  subroutine restore_state(self, table, threshold, number, state)
    class(synchronous_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number
    type(engine_state_type), intent(in) :: state
    type(flight_type) :: flight
    integer :: i

    call prepare(self, table, threshold, number)
    self%pages = state%integers(1)
    self%scene%hits = state%integers(2)
    self%now = state%reals(1)
    self%clock_start = state%reals(2)
    do i = 1, number
      flight = flight_type(x=state%reals(5*i - 2), y=state%reals(5*i - 1), ux=state%reals(5*i), &
        uy=state%reals(5*i + 1), &
        region=state%bytes(i)/8_int8, next=modulo(state%bytes(i), 8_int8) + 1_int8)
      call board(self%scene, i, flight)
      call write_down(self, i, flight, state%reals(5*i + 2))
    end do
    call pass(self, 0.0_wp)
  end subroutine restore_state

end module battery_synchronous

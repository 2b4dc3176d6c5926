!> The engine `reservoir`: urns without memory. The gates and channels are exact, the urns are not.
!>
!> A particle that enters an urn stays for an exponential time of mean pi A / (w + w'), the mean of
!> the true visits, and leaves through channel 1 with probability w / (w + w'), at a height uniform
!> on the opening, in a direction of the cosine law: the sine of its angle to the channel is uniform
!> in (-1, 1). All three are drawn anew, whatever it did before. That is what the theory assumes of
!> an urn, so the difference to `excursion` is what the shape of the urn does.
!>
!> **Ticks.** Exponential times forget, so nobody's end of stay has to be known ahead. Each of the n
!> particles that are in an urn or on the way into one ticks at the rate 1/mean; together they tick
!> at n/mean, and who it is, is drawn among them. One that is in its urn leaves it with the tick;
!> one that is still on its way does not heed it. That is exact, and there is no calendar to keep.
!> Ticks belong to the order of events and to the seed alone, not to the windows.
!>
!> **What is not there.** There are no walls in an urn. `collisions` takes the mean for them,
!> (arc left)/(pi A) hits per time spent in an urn, and the true hits in the channels: so a
!> run of so many collisions is about as long as that of another engine. Nobody has a place in an
!> urn: `particles` draws one, uniform in the urn, from the seed, the time and the particle's
!> number; it is another one at each time.
module battery_reservoir
  use battery_kinds, only: wp, int8, int32, int64, pi
  use battery_table, only: table_type, shape_circuit, area_of_urn, arc_length
  use battery_stay, only: stay_type, draws_type, block_length, draw_ticks, draw_exits, take_over, &
    whereabouts, passed_walls, from_gate, from_return, in_gate, to_return, parked
  use battery_random, only: new_random
  use battery_gate, only: gate_type, empty_gate, fill_gate, cross_middle, shift_gate
  use battery_engine, only: engine_type, engine_state_type, history_type, particles_type, &
    reserve_history, record_crossing, record_event, channel1_12, channel1_21, channel2_12, &
    channel2_21, event_entry, event_reversal
  implicit none (type, external)
  private
  public :: reservoir_type

  !> The queues: those counted in gates 1 and 2, and those on their way to the periodic line.
  integer, parameter :: periodic = 3

  type, extends(engine_type) :: reservoir_type
    private
    type(stay_type), allocatable :: stay(:)
    !> When each enters its urn, if it is not on its way into a channel. Apart from the rest, since
    !> each tick asks for it, of anybody.
    real(wp), allocatable :: entered(:)
    !> Those that tick: `member(:members)`.
    integer :: members = 0
    integer(int32), allocatable :: member(:)
    !> When the next of them ticks.
    real(wp) :: next_tick = huge(1.0_wp)
    type(gate_type) :: queue(3)
    !> Whether a queue stands in a heap. It is just a list until somebody crosses: a dense gate
    !> turns all back before.
    logical :: in_heap(3) = .false.
    type(draws_type) :: draws
    !> Time since the page was turned, its length, and how often it was.
    real(wp) :: now = 0.0_wp, page = 0.0_wp
    integer(int64) :: pages = 0
    real(wp) :: clock_start = 0.0_wp
    !> Longest window, mean stay, half lengths of the channels, hits per time in an urn, and a time
    !> that any clock within a page can tell from none.
    real(wp) :: window = 0.0_wp, mean_stay = 0.0_wp, half1 = 0.0_wp, half2 = 0.0_wp, &
      hit_rate = 0.0_wp, shortest = 0.0_wp
    !> Wall hits, as if all that move had been in an urn all the time but for the passages before
    !> their present stay, and all passages would be whole: never less than there were. What is left
    !> over of those that are not whole; what histories have told of them.
    integer(int64) :: known_hits = 0, told_hits = 0
    real(wp) :: fraction = 0.0_wp
    !> How many move on, that is, are not parked.
    integer :: moving = 0
  contains
    procedure :: start
    procedure :: advance
    procedure :: particles => all_particles
    procedure :: collisions
    procedure :: trapped
    procedure :: clock
    procedure :: save_state
    procedure :: restore_state
  end type reservoir_type

  ! What it tells of itself, and how its state is kept: `reservoir_state.f90`.
  interface
    module subroutine prepare(self, table, threshold, number)
      implicit none (type, external)
      class(reservoir_type), intent(inout) :: self
      type(table_type), intent(in) :: table
      integer, intent(in) :: threshold, number
    end subroutine prepare

    module subroutine all_particles(self, first, last, particles)
      implicit none (type, external)
      class(reservoir_type), intent(in) :: self
      integer, intent(in) :: first, last
      type(particles_type), intent(out) :: particles
    end subroutine all_particles

    module function collisions(self) result(total)
      implicit none (type, external)
      class(reservoir_type), intent(in) :: self
      integer(int64) :: total
    end function collisions

    module subroutine save_state(self, state)
      implicit none (type, external)
      class(reservoir_type), intent(in) :: self
      type(engine_state_type), intent(out) :: state
    end subroutine save_state

    module subroutine restore_state(self, table, threshold, number, state)
      implicit none (type, external)
      class(reservoir_type), intent(inout) :: self
      type(table_type), intent(in) :: table
      integer, intent(in) :: threshold, number
      type(engine_state_type), intent(in) :: state
    end subroutine restore_state
  end interface

contains

  subroutine start(self, table, threshold, particles, clock)
    class(reservoir_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold
    type(particles_type), intent(inout) :: particles
    real(wp), intent(in) :: clock
    integer :: i

    call prepare(self, table, threshold, size(particles%x))
    self%clock_start = clock
    self%draws%random = new_random(self%seed)
    do i = 1, self%number
      call take_over(table, particles%x(i), particles%y(i), particles%ux(i), particles%uy(i), &
        self%stay(i), self%entered(i))
      associate (stay => self%stay(i))
        select case (stay%heading)
        case (in_gate)
          call stand_in(self, stay%urn, stay%time + self%half1/stay%along, i)
        case (to_return)
          call stand_in(self, periodic, stay%time + self%half2/stay%along, i)
        case (from_gate, from_return)
          call join(self, i)
        case default
          continue
        end select
        if (stay%heading == in_gate .or. stay%heading == to_return) &
          self%known_hits = self%known_hits + int(stay%hits, int64) - passed_walls(table, stay, &
          -stay%time)
        if (stay%heading == from_gate .or. stay%heading == from_return) &
          self%known_hits = self%known_hits + int(stay%hits, int64)
        ! The time in the channel before the start is no time of this run.
        if (stay%heading /= parked) self%fraction = self%fraction - self%hit_rate*stay%time
      end associate
    end do
    self%moving = self%number - count(self%stay%heading == parked)
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
    call wind_up(self, 0.0_wp)
  end subroutine start

  subroutine advance(self, duration, history)
    class(reservoir_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(history_type), intent(inout) :: history
    real(wp) :: began, ends, whole

    if (self%now >= self%page) call turn_page(self)
    began = self%now
    ends = min(began + min(duration, self%window), self%page)
    call reserve_history(history, 64, 64)
    call walk(self, began, ends, history)
    self%now = ends
    self%fraction = self%fraction + self%hit_rate*real(self%moving, wp)*(ends - began)
    whole = aint(self%fraction)
    self%known_hits = self%known_hits + int(whole, int64)
    self%fraction = self%fraction - whole
    history%duration = ends - began
    history%collisions = self%known_hits - self%told_hits
    self%told_hits = self%known_hits
  end subroutine advance

  !> Turns the page: all clocks are set back by its length.
  subroutine turn_page(self)
    type(reservoir_type), intent(inout) :: self
    integer :: q

    do q = 1, 3
      call shift_gate(self%queue(q), self%page)
      if (.not. self%in_heap(q) .and. self%queue(q)%count > 0) &
        self%queue(q)%next_crossing = minval(self%queue(q)%time(:self%queue(q)%count))
    end do
    self%stay%time = self%stay%time - self%page
    self%entered = self%entered - self%page
    if (self%members > 0) self%next_tick = self%next_tick - self%page
    self%now = self%now - self%page
    self%pages = self%pages + 1
  end subroutine turn_page

  !> All events before `ends`, in the order of time. Crossings come before a tick at one time; no
  !> two ticks are at one time.
  subroutine walk(self, began, ends, history)
    type(reservoir_type), intent(inout) :: self
    real(wp), intent(in) :: began, ends
    type(history_type), intent(inout) :: history
    real(wp) :: time, crossing, inverse, spent
    integer :: at, i, k, urn

    do
      crossing = min(self%queue(1)%next_crossing, self%queue(2)%next_crossing, &
        self%queue(3)%next_crossing)
      time = self%next_tick
      if (crossing <= time) then
        if (crossing >= ends) exit
        call cross(self, crossing, began, history)
        cycle
      end if
      if (time >= ends) exit
      at = min(1 + int(self%draws%who(self%draws%next_tick - 1)*real(self%members, wp)), &
        self%members)
      i = self%member(at)
      if (self%entered(i) <= time) then
        if (self%draws%next_exit > block_length) call draw_exits(self%draws, self%table)
        k = self%draws%next_exit
        self%draws%next_exit = k + 1
        inverse = self%draws%inverse(k)
        spent = self%entered(i) - self%stay(i)%time
        self%fraction = self%fraction + (self%draws%hits(k) - self%hit_rate*spent)
        self%stay(i)%time = time
        self%stay(i)%y = self%draws%y(k)
        self%stay(i)%along = self%draws%along(k)
        self%stay(i)%across = self%draws%across(k)
        self%stay(i)%hits = self%draws%hits(k)
        self%member(at) = self%member(self%members)
        self%members = self%members - 1
        if (self%draws%opening(k) > 0.0_wp) then
          urn = self%stay(i)%urn
          self%stay(i)%heading = in_gate
          call stand_in(self, urn, time + self%half1*inverse, i)
          if (history%logging) call record_event(history, time - began, event_entry, urn, i)
          if (self%queue(urn)%count > self%threshold) call reverse(self, urn, time, began, history)
        else
          self%stay(i)%heading = to_return
          call stand_in(self, periodic, time + self%half2*inverse, i)
        end if
      end if
      call wind_up(self, time)
    end do
  end subroutine walk

  !> Draws when the next tick comes after `time`.
  subroutine wind_up(self, time)
    type(reservoir_type), intent(inout) :: self
    real(wp), intent(in) :: time

    if (self%draws%next_tick > block_length) call draw_ticks(self%draws)
    self%next_tick = huge(1.0_wp)
    if (self%members > 0) self%next_tick = time + self%shortest &
      + self%mean_stay*self%draws%wait(self%draws%next_tick)/real(self%members, wp)
    self%draws%next_tick = self%draws%next_tick + 1
  end subroutine wind_up

  !> One more particle ticks from now on.
  subroutine join(self, i)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: i

    self%members = self%members + 1
    self%member(self%members) = int(i, int32)
  end subroutine join

  !> A particle stands in a queue, to cross its line at `time`.
  subroutine stand_in(self, q, time, i)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: q, i
    real(wp), intent(in) :: time
    integer :: at, parent

    associate (queue => self%queue(q))
      if (queue%count == queue%room) then
        queue%time = [queue%time, queue%time]
        queue%particle = [queue%particle, queue%particle]
        queue%room = size(queue%time)
      end if
      at = queue%count + 1
      queue%count = at
      if (self%in_heap(q)) then
        do while (at > 1)
          parent = at/2
          if (queue%time(parent) <= time) exit
          queue%time(at) = queue%time(parent)
          queue%particle(at) = queue%particle(parent)
          at = parent
        end do
      end if
      queue%time(at) = time
      queue%particle(at) = i
      queue%next_crossing = min(queue%next_crossing, time)
    end associate
  end subroutine stand_in

  !> A gate reverses: all counted go back to their urn, as long as they have been in the channel.
  subroutine reverse(self, urn, time, began, history)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: urn
    real(wp), intent(in) :: time, began
    type(history_type), intent(inout) :: history
    real(wp) :: hits, per_width
    integer :: place, i, turned

    per_width = 1.0_wp/self%table%channel1_width
    turned = self%queue(urn)%count
    if (history%logging) call record_event(history, time - began, event_reversal, urn, turned)
    do place = 1, turned
      i = self%queue(urn)%particle(place)
      hits = aint(abs(self%stay(i)%y + self%stay(i)%across*(2.0_wp*(time - self%stay(i)%time))) &
        *per_width + 0.5_wp)
      self%fraction = self%fraction + (hits - self%stay(i)%hits)
      self%stay(i)%hits = hits
      self%entered(i) = 2.0_wp*time - self%stay(i)%time
      self%stay(i)%heading = from_gate
      self%member(self%members + place) = int(i, int32)
    end do
    self%members = self%members + turned
    history%reversals = history%reversals + 1
    history%bounce_backs = history%bounce_backs + turned
    call empty_gate(self%queue(urn))
    self%in_heap(urn) = .false.
  end subroutine reverse

  !> The next of all queues crosses its line (in `shape_urn` it hits the end wall), and goes on to
  !> the urn beyond. With one more to tick, the next tick comes so much sooner.
  subroutine cross(self, time, began, history)
    type(reservoir_type), intent(inout) :: self
    real(wp), intent(in) :: time, began
    type(history_type), intent(inout) :: history
    integer :: q, i, urn, line

    q = 1
    do while (self%queue(q)%next_crossing > time)
      q = q + 1
    end do
    associate (queue => self%queue(q))
      if (.not. self%in_heap(q)) call fill_gate(queue, (queue%time(:queue%count)), &
        (queue%particle(:queue%count)))
      call cross_middle(queue, i)
      self%in_heap(q) = queue%count > 0
    end associate
    urn = self%stay(i)%urn
    line = merge(channel2_12, channel1_12, q == periodic)
    if (urn == 2) line = merge(channel2_21, channel1_21, q == periodic)
    call record_crossing(history, time - began, line, i)
    if (self%table%shape == shape_circuit) then
      self%stay(i)%urn = int(3 - urn, int32)
    else
      self%known_hits = self%known_hits + 1
    end if
    self%stay(i)%heading = int(merge(from_return, from_gate, q == periodic), int32)
    self%entered(i) = self%stay(i)%time + whole_passage(self, self%stay(i))
    call join(self, i)
    if (self%members == 1) then
      call wind_up(self, time)
    else
      self%next_tick = time + (self%next_tick - time)*(real(self%members - 1, wp) &
        /real(self%members, wp))
    end if
  end subroutine cross

  !> How long it takes to fly through a channel.
  elemental function whole_passage(self, stay) result(time)
    class(reservoir_type), intent(in) :: self
    type(stay_type), intent(in) :: stay
    real(wp) :: time

    time = 2.0_wp*merge(self%half1, self%half2, stay%heading == in_gate .or. stay%heading &
      == from_gate)/stay%along
  end function whole_passage

  function trapped(self) result(total)
    class(reservoir_type), intent(in) :: self
    integer(int64) :: total

    total = self%number - self%moving
  end function trapped

  function clock(self) result(time)
    class(reservoir_type), intent(in) :: self
    real(wp) :: time

    time = self%clock_start + (real(self%pages, wp)*self%page + self%now)
  end function clock

end module battery_reservoir

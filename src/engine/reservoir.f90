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

  !> About so many events make a window.
  real(wp), parameter :: window_events = 100.0_wp

  !> The queues: those counted in gates 1 and 2, and those on their way to the periodic line.
  integer, parameter :: periodic = 3

  type, extends(engine_type) :: reservoir_type
    private
    type(stay_type), allocatable :: stay(:)
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
        self%stay(i))
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

  !> Sizes and lengths that follow from the table and the number of particles.
  subroutine prepare(self, table, threshold, number)
    type(reservoir_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number
    real(wp) :: interval
    integer :: q

    self%table = table
    self%threshold = threshold
    self%number = number
    self%half1 = 0.5_wp*table%channel1_length
    self%half2 = 0.5_wp*table%channel2_length
    self%mean_stay = pi*area_of_urn(table)/(table%channel1_width + table%channel2_width)
    self%hit_rate = arc_length(table)/(pi*area_of_urn(table))
    interval = self%mean_stay + 0.25_wp*pi*table%channel1_length
    self%page = 2.0_wp**ceiling(log(4.0_wp*interval)/log(2.0_wp))
    self%shortest = epsilon(1.0_wp)*self%page
    self%window = min(window_events/real(number, wp), 2.0_wp)*interval
    if (allocated(self%stay)) deallocate (self%stay, self%member)
    allocate (self%stay(number), self%member(number))
    do q = 1, 3
      call empty_gate(self%queue(q))
    end do
    self%in_heap = .false.
    self%members = 0
    self%next_tick = huge(1.0_wp)
    self%draws%next_tick = block_length + 1
    self%draws%next_exit = block_length + 1
    self%now = 0.0_wp
    self%pages = 0
    self%known_hits = 0
    self%told_hits = 0
    self%fraction = 0.0_wp
  end subroutine prepare

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
    self%stay%entered = self%stay%entered - self%page
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
      if (self%stay(i)%entered <= time) then
        if (self%draws%next_exit > block_length) call draw_exits(self%draws, self%table)
        k = self%draws%next_exit
        self%draws%next_exit = k + 1
        inverse = self%draws%inverse(k)
        spent = self%stay(i)%entered - self%stay(i)%time
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
      self%stay(i)%entered = 2.0_wp*time - self%stay(i)%time
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
    self%stay(i)%entered = self%stay(i)%time + whole_passage(self, self%stay(i))
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

  subroutine all_particles(self, first, last, particles)
    class(reservoir_type), intent(in) :: self
    integer, intent(in) :: first, last
    type(particles_type), intent(out) :: particles
    real(wp) :: place(4)
    integer(int64) :: key
    integer :: i, k

    key = self%seed + ishft(self%pages, 20) + int(self%now/self%page*2.0_wp**61, int64)
    allocate (particles%x(last - first + 1), particles%y(last - first + 1))
    allocate (particles%ux(last - first + 1), particles%uy(last - first + 1))
    do i = first, last
      k = i - first + 1
      place = whereabouts(self%table, self%stay(i), self%now, key, int(i, int64))
      particles%x(k) = place(1)
      particles%y(k) = place(2)
      particles%ux(k) = place(3)
      particles%uy(k) = place(4)
    end do
  end subroutine all_particles

  function collisions(self) result(total)
    class(reservoir_type), intent(in) :: self
    integer(int64) :: total
    real(wp) :: outside
    integer :: i

    total = self%known_hits
    outside = 0.0_wp
    do i = 1, self%number
      associate (stay => self%stay(i))
        select case (stay%heading)
        case (from_gate, from_return)
          outside = outside + (min(stay%entered, self%now) - stay%time)
          if (self%now < stay%entered) total = total + passed_walls(self%table, stay, self%now &
            - stay%time) - int(stay%hits, int64)
        case (parked)
          total = total + passed_walls(self%table, stay, self%now - stay%time)
        case default
          outside = outside + (self%now - stay%time)
          total = total + passed_walls(self%table, stay, self%now - stay%time) &
            - int(stay%hits, int64)
        end select
      end associate
    end do
    total = max(total + floor(self%fraction - self%hit_rate*outside + 0.5_wp, int64), 0_int64)
    total = min(total, self%known_hits + merge(huge(total) - self%known_hits, 0_int64, &
      self%moving < self%number))
  end function collisions

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

  subroutine save_state(self, state)
    class(reservoir_type), intent(in) :: self
    type(engine_state_type), intent(out) :: state
    integer :: q

    associate (d => self%draws)
      state%integers = [self%pages, self%known_hits, self%told_hits, int(self%members, int64), &
        int([d%next_tick, d%next_exit], int64), int(self%queue%count, int64), &
        merge(1_int64, 0_int64, self%in_heap), reshape(d%random%state, [size(d%random%state)]), &
        int(self%member(:self%members), int64)]
      state%reals = [self%now, self%clock_start, self%fraction, self%next_tick, d%wait, d%who, &
        d%y, d%along, d%inverse, d%across, d%hits, d%opening, self%stay%time, self%stay%y, &
        self%stay%along, self%stay%across, self%stay%entered, self%stay%hits]
    end associate
    do q = 1, 3
      associate (queue => self%queue(q))
        state%integers = [state%integers, int(queue%particle(:queue%count), int64)]
        state%reals = [state%reals, queue%time(:queue%count)]
      end associate
    end do
    state%bytes = int(2*self%stay%heading + self%stay%urn, int8)
  end subroutine save_state

  subroutine restore_state(self, table, threshold, number, state)
    class(reservoir_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number
    type(engine_state_type), intent(in) :: state
    integer :: at, i, q, k, words

    call prepare(self, table, threshold, number)
    self%stay%heading = int((state%bytes - 1)/2, int32)
    self%stay%urn = int(state%bytes, int32) - 2*self%stay%heading
    self%moving = number - count(self%stay%heading == parked)
    self%pages = state%integers(1)
    self%known_hits = state%integers(2)
    self%told_hits = state%integers(3)
    self%members = int(state%integers(4))
    self%draws%next_tick = int(state%integers(5))
    self%draws%next_exit = int(state%integers(6))
    words = size(self%draws%random%state)
    self%draws%random%state = reshape(state%integers(13:12 + words), &
      shape(self%draws%random%state))
    self%member(:self%members) = int(state%integers(13 + words:12 + words + self%members), int32)
    self%now = state%reals(1)
    self%clock_start = state%reals(2)
    self%fraction = state%reals(3)
    self%next_tick = state%reals(4)
    at = 4
    call take_draws(state, self%draws, at)
    self%stay%time = state%reals(at + 1:at + number)
    self%stay%y = state%reals(at + number + 1:at + 2*number)
    self%stay%along = state%reals(at + 2*number + 1:at + 3*number)
    self%stay%across = state%reals(at + 3*number + 1:at + 4*number)
    self%stay%entered = state%reals(at + 4*number + 1:at + 5*number)
    self%stay%hits = state%reals(at + 5*number + 1:at + 6*number)
    at = at + 6*number
    i = 12 + words + self%members
    ! As they stood, in a heap or not: their order decides who ticks.
    do q = 1, 3
      do k = 1, int(state%integers(6 + q))
        call stand_in(self, q, state%reals(at + k), int(state%integers(i + k)))
      end do
      self%in_heap(q) = state%integers(9 + q) == 1
      at = at + int(state%integers(6 + q))
      i = i + int(state%integers(6 + q))
    end do
  end subroutine restore_state

  !> Takes the numbers drawn ahead out of a state, from place `at` + 1 on.
  pure subroutine take_draws(state, draws, at)
    type(engine_state_type), intent(in) :: state
    type(draws_type), intent(inout) :: draws
    integer, intent(inout) :: at
    real(wp) :: block(block_length, 8)

    block = reshape(state%reals(at + 1:at + size(block)), shape(block))
    draws%wait = block(:, 1)
    draws%who = block(:, 2)
    draws%y = block(:, 3)
    draws%along = block(:, 4)
    draws%inverse = block(:, 5)
    draws%across = block(:, 6)
    draws%hits = block(:, 7)
    draws%opening = block(:, 8)
    at = at + size(block)
  end subroutine take_draws

end module battery_reservoir

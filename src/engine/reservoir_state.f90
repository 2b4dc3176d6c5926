!> What the engine `reservoir` tells of itself, and how its state is kept.
submodule (battery_reservoir) battery_reservoir_state
  use battery_powers, only: power_above
  implicit none (type, external)

  !> About so many events make a window.
  real(wp), parameter :: window_events = 100.0_wp

  !> And no more ticks than this.
  real(wp), parameter :: window_ticks = 1.0e6_wp

contains

  !> Sizes and lengths that follow from the table and the number of particles.
  module subroutine prepare(self, table, threshold, number)
    class(reservoir_type), intent(inout) :: self
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
    self%page = power_above(4.0_wp*interval)
    self%shortest = epsilon(1.0_wp)*self%page
    ! Where stays are much shorter than passages, those in the channels tick most of the time.
    self%window = min(min(window_events/real(number, wp), 2.0_wp)*interval, &
      window_ticks/real(number, wp)*self%mean_stay)
    if (allocated(self%stay)) deallocate (self%stay, self%entered, self%member)
    allocate (self%stay(number), self%entered(number), self%member(number))
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

  module subroutine all_particles(self, first, last, particles)
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
      place = whereabouts(self%table, self%stay(i), self%entered(i), self%now, key, int(i, int64))
      particles%x(k) = place(1)
      particles%y(k) = place(2)
      particles%ux(k) = place(3)
      particles%uy(k) = place(4)
    end do
  end subroutine all_particles

  module function collisions(self) result(total)
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
          outside = outside + (min(self%entered(i), self%now) - stay%time)
          if (self%now < self%entered(i)) total = total + passed_walls(self%table, stay, self%now &
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

  module subroutine save_state(self, state)
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
        self%stay%along, self%stay%across, self%entered, self%stay%hits]
    end associate
    do q = 1, 3
      associate (queue => self%queue(q))
        state%integers = [state%integers, int(queue%particle(:queue%count), int64)]
        state%reals = [state%reals, queue%time(:queue%count)]
      end associate
    end do
    state%bytes = int(2*self%stay%heading + self%stay%urn, int8)
  end subroutine save_state

  module subroutine restore_state(self, table, threshold, number, state)
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
    self%entered = state%reals(at + 4*number + 1:at + 5*number)
    self%stay%hits = state%reals(at + 5*number + 1:at + 6*number)
    at = at + 6*number
    i = 12 + words + self%members
    ! As they stood, in a heap or not: their order decides who ticks.
    do q = 1, 3
      k = int(state%integers(6 + q))
      associate (queue => self%queue(q))
        queue%count = k
        queue%room = max(k, 32)
        queue%time = [state%reals(at + 1:at + k), spread(0.0_wp, 1, queue%room - k)]
        queue%particle = [int(state%integers(i + 1:i + k)), spread(0, 1, queue%room - k)]
        if (k > 0) queue%next_crossing = minval(queue%time(:k))
      end associate
      self%in_heap(q) = state%integers(9 + q) == 1
      at = at + k
      i = i + k
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

end submodule battery_reservoir_state

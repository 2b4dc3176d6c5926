!> The engine `reservoir`: urns without memory. Gates and channels are exact, urns are not: an
!> approximation to compare with.
!>
!> A particle that enters an urn stays there for an exponential time of mean pi A/(w + w'), the true
!> mean, and leaves through channel 1 with probability w/(w + w'), at a height uniform on the
!> opening, in a direction of the cosine law: the sine of its angle to the channel is uniform in
!> (-1, 1). Time, opening, height and direction are independent of the past. The theory assumes this
!> of an urn, so the difference to `excursion` is the effect of the urn's shape.
!>
!> **Ticks.** Exponential times have no memory, so the end of a stay need not be known in advance.
!> Each of the n particles that are in an urn, or on the way into one, has ticks at the rate 1/mean.
!> Together they are a Poisson process of rate n/mean; the particle of each tick is drawn. A
!> particle in its urn leaves at the tick; the tick of a particle that is still on its way has no
!> effect. That is exact, and needs no calendar. If the urns differ, all particles have the rate of
!> the urn with the shorter mean, and the ticks of particles in the other urn are thinned. Ticks
!> depend on the order of events and on the seed only, not on the windows.
!>
!> **Limits.** Urns have no walls here. `collisions` adds their mean number, (length of walls)/(pi
!> A) per time in an urn, to the true hits in the channels, so a run of a given number of collisions
!> is about as long as with another engine. A particle in an urn has no position: `state_of` draws
!> one, from the seed, the time and the particle index.
module battery_reservoir
  use battery_kinds, only: wp, int32, int64, pi
  use battery_powers, only: power_above
  use battery_table, only: table_type, channel1, channel2, are_mirror_images, mean_urn_passage
  use battery_stay, only: stay_type, draws_type, block_length, draw_ticks, draw_exits, &
    make_initial_stay, remaining_channel_hits, locate_stay, locate_trapped_stay, sum_outside_urns, &
    serialize_stays, serialize_draws, is_trapped, from_gate, from_channel2, counted_in_gate, &
    to_periodic_line
  use battery_random, only: new_random
  use battery_queue, only: queue_type, empty_queue, push, pop, rebase_queue, serialize_queue
  use battery_gate, only: enter_gate, must_reverse, gate_crossed_first, uncount_first, &
    uncount_all, number_inside, counted_particle, next_crossing_time, first_crossing_time
  use battery_engine, only: engine_type, particles_type, rebase_gates_and_clock, unmet_requirement
  use battery_event_record, only: event_record_type, reserve_event_record, record_crossing, &
    record_event, record_reversal, crossing_of, event_entry
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: reservoir_type

  !> Events of a window, about, and its largest number of ticks.
  real(wp), parameter :: window_events = 100.0_wp, window_ticks = 1.0e6_wp

  !> The engine: the stay of each particle, and the particles that have ticks.
  type, extends(engine_type) :: reservoir_type
    private
    type(stay_type), allocatable :: stay(:)
    !> Time at which each particle enters its urn, unless it is on its way into a channel. A
    !> separate array, since each tick reads this time of a random particle.
    real(wp), allocatable :: urn_entry_time(:)
    !> x of each particle in the frame of the table, for those that are trapped; allocated if there
    !> are any.
    real(wp), allocatable :: trapped_x(:)
    !> Particles that have ticks: `member(:members)`.
    integer :: members = 0
    integer(int32), allocatable :: member(:)
    !> Time of the next tick.
    real(wp) :: next_tick = huge(1.0_wp)
    !> Particles in channel 2 on their way to the periodic line.
    type(queue_type) :: to_periodic_queue
    type(draws_type) :: draws
    !> Longest window, mean time between ticks of one particle, half lengths of the channels, and
    !> the shortest time that the clock of an epoch resolves.
    real(wp) :: window = 0.0_wp, mean_stay = 0.0_wp, half_length(2) = 0.0_wp, &
      clock_resolution = 0.0_wp
    !> Whether the urns differ; by urn, the fraction of ticks that thinning keeps, and wall hits per
    !> time; the greater of these two rates.
    logical :: uneven = .false.
    real(wp) :: tick_share(2) = 1.0_wp, urn_rate(2) = 0.0_wp, hit_rate = 0.0_wp
    !> Wall hits counted so far, an upper bound: as if each particle that is not trapped had been in
    !> the urn with more hits at all times except its passages before the present stay, and each
    !> passage were complete. Wall hits that event records have reported. Fraction of a hit not yet
    !> counted.
    integer(int64) :: computed_hits = 0, reported_hits = 0
    real(wp) :: fraction = 0.0_wp
    !> Number of particles that are not trapped.
    integer :: moving = 0
  contains
    procedure :: reason_unsupported, prepare_engine, load_particles, advance_window, rebase_clock, &
      serialize_own_state, state_of, collisions
    procedure :: trapped
  end type reservoir_type

contains

  !> Why the engine cannot simulate a table: a passage of a channel with discs has no fixed
  !> duration.
  pure function reason_unsupported(self, table) result(reason)
    class(reservoir_type), intent(in) :: self
    type(table_type), intent(in) :: table
    character(len=:), allocatable :: reason

    reason = unmet_requirement(table)
    if (table%has_scatterers .and. self%number >= 0) reason = 'it does not support scatterers'
  end function reason_unsupported

  !> Sets mean times, rates and the longest window from the table and the number of particles.
  subroutine prepare_engine(self)
    class(reservoir_type), intent(inout) :: self
    real(wp) :: stay(2), interval

    stay = [mean_urn_passage(self%table%urn(1)), mean_urn_passage(self%table%urn(2))]
    self%urn_rate = self%table%urn%perimeter/(pi*self%table%urn%area)
    self%uneven = .not. are_mirror_images(self%table%urn)
    self%mean_stay = minval(stay)
    self%tick_share = self%mean_stay/stay
    self%hit_rate = maxval(self%urn_rate)
    self%half_length = 0.5_wp*self%table%channel%length
    interval = self%mean_stay + 0.25_wp*pi*self%table%channel(channel1)%length
    self%epoch = power_above(4.0_wp*interval)
    self%clock_resolution = epsilon(1.0_wp)*self%epoch
    ! If stays are much shorter than passages, most ticks are of particles in the channels.
    self%window = min(min(window_events/real(self%number, wp), 2.0_wp)*interval, &
      window_ticks/real(self%number, wp)*self%mean_stay)
    if (allocated(self%stay)) deallocate (self%stay, self%urn_entry_time, self%member)
    allocate (self%stay(self%number), self%urn_entry_time(self%number), self%member(self%number))
    call empty_queue(self%to_periodic_queue)
    self%members = 0
    self%next_tick = huge(1.0_wp)
    self%draws = draws_type(random=new_random(self%seed))
    self%computed_hits = 0
    self%reported_hits = 0
    self%fraction = 0.0_wp
  end subroutine prepare_engine

  !> Loads the particles: those in channels continue their passage, those in urns begin a stay.
  subroutine load_particles(self, particles)
    class(reservoir_type), intent(inout) :: self
    type(particles_type), intent(inout) :: particles
    integer :: i

    do i = 1, self%number
      call make_initial_stay(self%table, particles%x(i), particles%y(i), particles%ux(i), &
        particles%uy(i), self%stay(i), self%urn_entry_time(i))
      associate (stay => self%stay(i))
        select case (stay%phase)
        case (counted_in_gate)
          call enter_gate(self%gate(stay%urn), stay%time + self%half_length(channel1) &
            /stay%u_axial, i)
        case (to_periodic_line)
          call push(self%to_periodic_queue, stay%time + self%half_length(channel2)/stay%u_axial, i)
        case (from_gate, from_channel2)
          call start_ticking(self, i)
        case default
          continue
        end select
        self%computed_hits = self%computed_hits + remaining_channel_hits(self%table, stay)
        ! The time in the channel before the start is not part of the run.
        if (.not. is_trapped(stay)) self%fraction = self%fraction - self%hit_rate*stay%time
      end associate
    end do
    self%moving = self%number - count(is_trapped(self%stay))
    if (self%moving < self%number) self%trapped_x = particles%x
    call schedule_tick(self, 0.0_wp)
  end subroutine load_particles

  !> Advances by one window of at most `duration`; hits in urns are counted by their mean number.
  subroutine advance_window(self, duration, event_record)
    class(reservoir_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(event_record_type), intent(inout) :: event_record
    real(wp) :: window_start, window_end, whole

    window_start = self%now
    window_end = min(window_start + min(duration, self%window), self%epoch)
    call reserve_event_record(event_record, 64)
    call run_window_events(self, window_start, window_end, event_record)
    self%now = window_end
    self%fraction = self%fraction + self%hit_rate*real(self%moving, wp)*(window_end - window_start)
    whole = aint(self%fraction)
    self%computed_hits = self%computed_hits + int(whole, int64)
    self%fraction = self%fraction - whole
    event_record%duration = window_end - window_start
    event_record%collisions = self%computed_hits - self%reported_hits
    self%reported_hits = self%computed_hits
  end subroutine advance_window

  !> Shifts all times back by one epoch.
  subroutine rebase_clock(self)
    class(reservoir_type), intent(inout) :: self

    call rebase_queue(self%to_periodic_queue, self%epoch)
    self%stay%time = self%stay%time - self%epoch
    self%urn_entry_time = self%urn_entry_time - self%epoch
    if (self%members > 0) self%next_tick = self%next_tick - self%epoch
    call rebase_gates_and_clock(self)
  end subroutine rebase_clock

  !> Processes all events before `window_end`, in the order of time. At one time crossings come
  !> before a tick; no two ticks are simultaneous.
  subroutine run_window_events(self, window_start, window_end, event_record)
    type(reservoir_type), intent(inout) :: self
    real(wp), intent(in) :: window_start, window_end
    type(event_record_type), intent(inout) :: event_record
    real(wp) :: time, crossing, place
    integer :: at
    logical :: leaves

    do
      crossing = min(first_crossing_time(self%gate), self%to_periodic_queue%next)
      time = self%next_tick
      if (crossing <= time) then
        if (crossing >= window_end) exit
        call process_line_crossing(self, crossing, window_start, event_record)
        cycle
      end if
      if (time >= window_end) exit
      place = self%draws%selector(self%draws%next_tick - 1)*real(self%members, wp)
      at = min(1 + int(place), self%members)
      if (self%urn_entry_time(self%member(at)) <= time) then
        leaves = .true.
        if (self%uneven) call thin_tick(self, self%member(at), place - real(at - 1, wp), time, &
          leaves)
        if (leaves) call leave_urn(self, at, time, window_start, event_record)
      end if
      call schedule_tick(self, time)
    end do
  end subroutine run_window_events

  !> If the urns differ: decides whether the tick of particle `i` is kept, from `chance` uniform in
  !> (0, 1). If it is, subtracts the hits by which the particle's urn falls short of the other urn.
  pure subroutine thin_tick(self, i, chance, time, is_kept)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: chance, time
    logical, intent(out) :: is_kept
    integer :: urn

    urn = self%stay(i)%urn
    is_kept = chance <= self%tick_share(urn)
    if (is_kept) self%fraction = self%fraction &
      - (self%hit_rate - self%urn_rate(urn))*(time - self%urn_entry_time(i))
  end subroutine thin_tick

  !> Moves member `at` at `time` out of its urn, into one of the channels.
  subroutine leave_urn(self, at, time, window_start, event_record)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: at
    real(wp), intent(in) :: time, window_start
    type(event_record_type), intent(inout) :: event_record
    integer :: i, k, urn
    real(wp) :: inverse

    i = self%member(at)
    if (self%draws%next_exit > block_length) call draw_exits(self%draws, self%table)
    k = self%draws%next_exit
    self%draws%next_exit = k + 1
    inverse = self%draws%inverse(k)
    associate (stay => self%stay(i))
      self%fraction = self%fraction + (self%draws%hits(k) - self%hit_rate*(self%urn_entry_time(i) &
        - stay%time))
      stay%time = time
      stay%y = self%draws%y(k)
      stay%u_axial = self%draws%u_axial(k)
      stay%u_lateral = self%draws%u_lateral(k)
      stay%hits = self%draws%hits(k)
      urn = stay%urn
      stay%phase = int(merge(counted_in_gate, to_periodic_line, &
        self%draws%channel(k) == channel1), int32)
    end associate
    self%member(at) = self%member(self%members)
    self%members = self%members - 1
    if (self%draws%channel(k) == channel1) then
      call enter_gate(self%gate(urn), time + self%half_length(channel1)*inverse, i)
      if (event_record%logging) call record_event(event_record, time - window_start, event_entry, &
        urn, i)
      if (must_reverse(self%gate(urn))) call reverse_gate(self, urn, time, window_start, &
        event_record)
    else
      call push(self%to_periodic_queue, time + self%half_length(channel2)*inverse, i)
    end if
  end subroutine leave_urn

  !> Draws the time of the next tick after `time`.
  subroutine schedule_tick(self, time)
    type(reservoir_type), intent(inout) :: self
    real(wp), intent(in) :: time

    if (self%draws%next_tick > block_length) call draw_ticks(self%draws)
    self%next_tick = huge(1.0_wp)
    if (self%members > 0) self%next_tick = time + self%clock_resolution &
      + self%mean_stay*self%draws%wait(self%draws%next_tick)/real(self%members, wp)
    self%draws%next_tick = self%draws%next_tick + 1
  end subroutine schedule_tick

  !> Adds particle `i` to those that have ticks.
  subroutine start_ticking(self, i)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: i

    self%members = self%members + 1
    self%member(self%members) = int(i, int32)
  end subroutine start_ticking

  !> Reverses a gate: all particles that it counts return to their urn. The way out takes as long as
  !> the way in.
  subroutine reverse_gate(self, urn, time, window_start, event_record)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: urn
    real(wp), intent(in) :: time, window_start
    type(event_record_type), intent(inout) :: event_record
    real(wp) :: hits, per_width
    integer :: place, i

    per_width = 1.0_wp/self%table%channel(channel1)%width
    call record_reversal(event_record, time - window_start, urn, number_inside(self%gate(urn)))
    do place = 1, number_inside(self%gate(urn))
      i = counted_particle(self%gate(urn), place)
      hits = aint(abs(self%stay(i)%y + self%stay(i)%u_lateral*(2.0_wp*(time - self%stay(i)%time))) &
        *per_width + 0.5_wp)
      self%fraction = self%fraction + (hits - self%stay(i)%hits)
      self%stay(i)%hits = hits
      self%urn_entry_time(i) = 2.0_wp*time - self%stay(i)%time
      self%stay(i)%phase = from_gate
      call start_ticking(self, i)
    end do
    call uncount_all(self%gate(urn))
  end subroutine reverse_gate

  !> Processes the earliest pending crossing of a line (of a single urn: hit of the end wall): the
  !> particle moves to the urn across the line. One more particle has ticks, so the next tick comes
  !> sooner in proportion.
  subroutine process_line_crossing(self, time, window_start, event_record)
    type(reservoir_type), intent(inout) :: self
    real(wp), intent(in) :: time, window_start
    type(event_record_type), intent(inout) :: event_record
    integer :: i, urn, channel

    urn = gate_crossed_first(self%gate)
    channel = merge(channel1, channel2, next_crossing_time(self%gate(urn)) <= time)
    if (channel == channel1) then
      call uncount_first(self%gate(urn), i)
    else
      call pop(self%to_periodic_queue, i)
      urn = self%stay(i)%urn
    end if
    call record_crossing(event_record, time - window_start, crossing_of(urn, channel), i)
    if (self%table%urn_across(urn) == urn) self%computed_hits = self%computed_hits + 1
    associate (stay => self%stay(i))
      stay%urn = int(self%table%urn_across(urn), int32)
      stay%phase = int(merge(from_gate, from_channel2, channel == channel1), int32)
      self%urn_entry_time(i) = stay%time + 2.0_wp*self%half_length(channel)/stay%u_axial
    end associate
    call start_ticking(self, i)
    if (self%members == 1) then
      call schedule_tick(self, time)
    else
      self%next_tick = time + (self%next_tick - time)*(real(self%members - 1, wp) &
        /real(self%members, wp))
    end if
  end subroutine process_line_crossing

  !> State (x, y, u_x, u_y) of particle `i` now; in an urn it is drawn at random.
  function state_of(self, i) result(state)
    class(reservoir_type), intent(in) :: self
    integer, intent(in) :: i
    real(wp) :: state(4)
    integer(int64) :: key

    key = self%seed + ishft(self%epochs, 20) + int(self%now/self%epoch*2.0_wp**61, int64)
    if (is_trapped(self%stay(i))) then
      state = locate_trapped_stay(self%table, self%stay(i), self%trapped_x(i), self%now)
    else
      state = locate_stay(self%table, self%stay(i), self%urn_entry_time(i), self%now, key, int(i, &
        int64))
    end if
  end function state_of

  !> Wall hits from the start until now: `computed_hits`, corrected for each particle.
  function collisions(self) result(total)
    class(reservoir_type), intent(in) :: self
    integer(int64) :: total
    integer(int64) :: passed
    real(wp) :: outside

    call sum_outside_urns(self%table, self%stay, self%urn_entry_time, self%now, &
      self%urn_rate/self%hit_rate, outside, passed)
    total = self%computed_hits + passed
    total = max(total + floor(self%fraction - self%hit_rate*outside + 0.5_wp, int64), 0_int64)
    total = min(total, self%computed_hits + merge(huge(total) - self%computed_hits, 0_int64, &
      self%moving < self%number))
  end function collisions

  !> Number of trapped particles.
  function trapped(self) result(total)
    class(reservoir_type), intent(in) :: self
    integer(int64) :: total

    total = self%number - self%moving
  end function trapped

  !> Saves or restores the stays, the particles that have ticks, the random numbers drawn ahead and
  !> the counts.
  subroutine serialize_own_state(self, archive)
    class(reservoir_type), intent(inout) :: self
    type(archive_type), intent(inout) :: archive

    call serialize_stays(self%table, self%stay, self%urn_entry_time, self%trapped_x, archive)
    call archive%serialize('members', self%members)
    call archive%serialize('member', self%member(:self%members))
    call archive%serialize('next_tick', self%next_tick)
    call serialize_queue(self%to_periodic_queue, archive)
    call serialize_draws(self%draws, archive)
    call archive%serialize('known_hits', self%computed_hits)
    call archive%serialize('told_hits', self%reported_hits)
    call archive%serialize('fraction', self%fraction)
    call archive%serialize('moving', self%moving)
  end subroutine serialize_own_state

end module battery_reservoir

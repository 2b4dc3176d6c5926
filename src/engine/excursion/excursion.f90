!> The engine `excursion`: event-driven simulation with whole visits as its unit of work. A visit is
!> the passage of a particle through a channel and then through the urn behind it, up to the next
!> opening.
!>
!> Particles interact through the counts of the two gates only, so few events need a common order:
!> entries into a gate, crossings of the middle line of channel 1, crossings of the periodic line.
!> After any of these events, the particle's next entry or periodic crossing is at least
!> `shortest_excursion` later: the lookahead. A window no longer than that is processed in two
!> steps: its events in the order of time (`run_batch_window`, `run_serial_window`), then, in one
!> batch, the visits that these events begin.
!>
!> The state of a particle (`flight_type`) is its state on entry into its next channel. Its position
!> before then is computed backwards from that entry, or forwards from the start of a long visit;
!> in a polygon, if that way meets a corner, along the path of the passage.
!>
!> The algorithm, with the file of each step; files without a folder are in this one:
!>
!>     start                                                         engine/engine.f90
!>       for each particle
!>         flight := how it will enter its next channel              flight.f90
!>         schedule the next event of the flight                     calendar.f90
!>
!>     advance by one window                                         `advance_window`
!>       if the epoch is over: subtract its length from all times    `rebase_clock`
!>       due := earliest pending event                               calendar.f90, gate/gate.f90
!>       window_end := min(due + lookahead, now + duration, ...)
!>       take all events before `window_end`, in the order of time   events/ordering.f90
!>       set apart those at which a truncated visit is continued     partial_visits.f90
!>
!>       if few are left, one event at a time:                       serial_window.f90
!>         before each: the crossings of the middle line up to it;
!>           the gate no longer counts the particle;
!>           a visit to the urn across the line begins
!>         an entry: the gate counts the particle                    gate/gate.f90
!>           if no more enter at this instant, and it counts more
!>           than T: for all counted particles, visits to their
!>           own urn begin
!>         a crossing of the periodic line:
!>           a visit to the urn across the line begins
!>       else the same with arrays:                                  batch_window.f90
!>         partition the events: gate 1, gate 2, periodic line
!>         apply the rule of each gate to all its entries            gate/gate.f90
!>         sort the crossings of all lines by time                   events/ordering.f90
!>
!>       for all visits that have begun, as one batch:             `compute_window_visits_straight`
!>         load from the flights how they entered their channel      flight.f90
!>         (with few events a window: together with visits that
!>         begin in later windows)                                   precomputed_visits.f90
!>         through the channel to the urn                            table/urn_shape.f90
!>         through the urn to an opening                             table/urn.f90
!>         store how each enters its next channel                    flight.f90
!>         schedule the next events                                  calendar.f90
!>
!>       report crossings, reversals and wall hits                   engine/event_record.f90
!>
!> Besides these: starts of long visits (`long_visits.f90`) and of passages through polygons
!> (`passage_starts.f90`), tables with discs in channel 2 (`excursion_with_scatterers.f90`,
!> `scatterer_visits.f90`).
module battery_excursion
  use battery_kinds, only: wp, int64, pi
  use battery_archive, only: archive_type
  use battery_calendar, only: calendar_type, new_calendar, epoch_for, schedule_event, &
    schedule_events, open_buckets_until, next_due_time, count_due_before, drop_done_events, &
    rebase_calendar
  use battery_table, only: channel1, channel2, urn_at, x_on_side, are_mirror_images, &
    mean_urn_passage, shortest_excursion
  use battery_urn_shape, only: cross_channels
  use battery_urn, only: compute_passages
  use battery_passage_starts, only: start_words, store_passage_starts, correct_by_passage, &
    serialize_passage_starts
  use battery_visits, only: visits_type, reserve_visits, split_visits_by_urn, truncated
  use battery_scatterers, only: narrowest_gap
  use battery_wall_motion, only: motion_at, is_trapped
  use battery_gate, only: enter_gate, number_inside, first_crossing_time
  use battery_engine, only: engine_type, particles_type, rebase_gates_and_clock
  use battery_event_record, only: event_record_type, reserve_event_record
  use battery_flight, only: flight_type, new_flights, make_initial_flight, &
    set_flight_to_visit_start, load_flights, store_flights, locate_particle, &
    locate_trapped_particle, to_gate, to_periodic_line, counted_in_gate, trapped_in_urn, &
    trapped_in_channel, partial_visit
  use battery_long_visits, only: long_visits_type, new_long_visits, is_long_visit, &
    store_visit_starts, is_nearer_start, locate_from_start, rebase_long_visits, &
    serialize_long_visits
  use battery_partial_visits, only: split_off_partial_visits, compute_partial_visits
  use battery_precomputed_visits, only: precomputed_visits_type, precomputing_pays, &
    take_or_compute_visits, most_precomputed_visits
  use battery_serial_window, only: run_serial_window, longest_serial_window
  use battery_batch_window, only: batch_window_type, run_batch_window
  use battery_scatterer_visits, only: scatterer_visits_type, new_scatterer_visits, &
    locate_by_replay, serialize_visit_starts
  implicit none (type, external)
  private
  public :: excursion_type

  !> Particles loaded in one batch at the start.
  integer, parameter :: start_chunk = 4096

  !> The engine: one flight a particle, and the calendar of their events.
  type, extends(engine_type) :: excursion_type
    private
    !> Largest expected number of events in a window; the visits of a window should fit into the
    !> cache.
    integer, public :: batch = 1024
    type(flight_type), allocatable :: flight(:)
    !> x of each particle in the frame of the table, for those trapped in a channel; allocated if
    !> there are any.
    real(wp), allocatable :: trapped_x(:)
    type(calendar_type) :: calendar
    !> Work space of a window that is processed as a batch.
    type(batch_window_type) :: batch_window
    !> Visits by urn. Urns that are mirror images share the first batch.
    type(visits_type) :: visits(2)
    integer :: batches = 1
    !> Whether visits are computed before they begin.
    logical, public :: precomputes_visits = .false.
    !> Visits that have been computed before they begin.
    type(precomputed_visits_type) :: precomputed
    !> Visits on a table with discs in channel 2.
    type(scatterer_visits_type) :: scatterer_visits
    !> Least time from an event to the next one that depends on it.
    real(wp) :: lookahead = 0.0_wp
    !> Greatest length of a window.
    real(wp) :: window = 0.0_wp
    !> Mean time between two events of a particle.
    real(wp) :: interval = 0.0_wp
    !> Number of visits that are truncated now.
    integer :: partial_count = 0
    !> Number of truncated visits that are continued in this window.
    integer :: resumed_count = 0
    !> Time at which each of these is due.
    real(wp), allocatable :: resumed_time(:)
    !> Particle of each of these.
    integer, allocatable :: resumed(:)
    !> Their next parts.
    type(visits_type) :: partial_visits
    !> Start of each long visit, and of those that cannot be traced back; if channel 2 has discs,
    !> `scatterer_visits` holds the start of every visit.
    type(long_visits_type) :: long_visits
    !> Start of the latest passage of each particle through a polygon, (`start_words`, particle);
    !> without particles if no urn is a polygon, or channel 2 has discs.
    real(wp), allocatable :: passage_starts(:, :)
    !> Wall hits of all visits and passages computed so far, future ones included, and those that
    !> event records have reported.
    integer(int64) :: computed_hits = 0, reported_hits = 0
  contains
    procedure :: prepare_engine, load_particles, advance_window, rebase_clock, &
      serialize_own_state, state_of, collisions, trapped
  end type excursion_type

  !> With discs in channel 2 a window is so short that a particle in the narrowest gap has at most
  !> `window_hits` hits in it; but it is never made shorter than `least_window` times the lookahead.
  real(wp), parameter :: window_hits = 1.0e6_wp, least_window = 1.0e-3_wp

  ! Tables with discs in channel 2: `excursion_with_scatterers.f90`.
  interface
    module subroutine load_particles_with_scatterers(self, particles)
      implicit none (type, external)
      type(excursion_type), intent(inout) :: self
      type(particles_type), intent(inout) :: particles
    end subroutine load_particles_with_scatterers

    module subroutine compute_window_visits_with_scatterers(self, window_start, window_end, &
      event_record)
      implicit none (type, external)
      type(excursion_type), intent(inout) :: self
      !> Start and end of the window.
      real(wp), intent(in) :: window_start, window_end
      type(event_record_type), intent(inout) :: event_record
    end subroutine compute_window_visits_with_scatterers
  end interface

contains

  !> Sets the lookahead, the longest window and the mean time between events from the table and the
  !> number of particles; allocates the flights.
  subroutine prepare_engine(self)
    class(excursion_type), intent(inout) :: self

    self%batches = merge(1, 2, are_mirror_images(self%table%urn))
    self%interval = 0.5_wp*(mean_urn_passage(self%table%urn(1)) &
      + mean_urn_passage(self%table%urn(2))) + 0.25_wp*pi*self%table%channel(channel1)%length
    self%lookahead = shortest_excursion(self%table)
    self%window = min(self%lookahead, real(self%batch, wp)*self%interval/real(self%number, wp))
    if (self%table%has_scatterers) then
      call new_scatterer_visits(self%scatterer_visits, self%number)
      self%window = min(self%window, max(least_window*self%lookahead, &
        window_hits*narrowest_gap(self%table%channel(channel2), self%table%scatterers)))
    end if
    self%precomputes_visits = self%batches == 1 .and. .not. self%table%has_scatterers .and. &
      precomputing_pays(self%number, real(self%number, wp)*self%lookahead/self%interval, &
      self%gate%threshold)
    if (allocated(self%flight)) deallocate (self%flight, self%passage_starts)
    call new_flights(self%flight, self%number)
    call new_long_visits(self%long_visits, self%number, maxval(self%table%urn%reach))
    allocate (self%passage_starts(start_words, merge(self%number, 0, &
      any(self%table%urn%truncates_passages) .and. .not. self%table%has_scatterers)), &
      source=0.0_wp)
    self%computed_hits = 0
    self%reported_hits = 0
    self%partial_count = 0
    self%epoch = epoch_for(self%interval)
  end subroutine prepare_engine

  !> Loads the particles and schedules their first events.
  subroutine load_particles(self, particles)
    class(excursion_type), intent(inout) :: self
    type(particles_type), intent(inout) :: particles
    integer :: i

    if (self%table%has_scatterers) then
      call load_particles_with_scatterers(self, particles)
    else
      call load_particles_straight(self, particles)
    end if
    if (any(self%flight%next_event == trapped_in_channel)) self%trapped_x = particles%x
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
    call new_calendar(self%calendar, self%number, self%interval)
    do i = 1, self%number
      call schedule_next_event(self, i)
    end do
  end subroutine load_particles

  !> Loads the particles in the urns first, then those in the channels.
  subroutine load_particles_straight(self, particles)
    type(excursion_type), intent(inout) :: self
    type(particles_type), intent(inout) :: particles
    integer :: first, i, j, k, b
    logical :: from_channels

    do k = 1, 2
      from_channels = k == 2
      do first = 1, self%number, start_chunk
        do b = 1, self%batches
          call reserve_visits(self%visits(b), start_chunk)
        end do
        do i = first, min(first + start_chunk - 1, self%number)
          b = min(urn_at(self%table, particles%x(i)), self%batches)
          call make_initial_flight(self%table, i, particles%x(i), particles%y(i), particles%ux(i), &
            particles%uy(i), from_channels, self%flight(i), self%visits(b), self%computed_hits)
        end do
        do b = 1, self%batches
          if (from_channels) call cross_channels(self%table%urn(b), self%visits(b))
          call compute_urn_passages(self, b)
          associate (v => self%visits(b))
            do j = 1, v%count
              if (.not. (is_long_visit(self%long_visits%least, v%channel(j), v%length(j)) &
                .or. any(v%untraceable_index(:v%untraceable_count) == j))) cycle
              i = v%particle(j)
              call set_flight_to_visit_start(self%table, particles%x(i), particles%y(i), &
                particles%ux(i), particles%uy(i), self%flight(i), v%hits(j))
            end do
          end associate
          call store_batch_flights(self, b)
        end do
      end do
    end do
  end subroutine load_particles_straight

  !> Schedules the first event of particle `i`, at the start of a run: in the calendar, or, of a
  !> particle inside a gate, its crossing of the middle line in the queue of that gate, which counts
  !> it.
  subroutine schedule_next_event(self, i)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: i

    associate (flight => self%flight(i))
      select case (flight%next_event)
      case (to_gate, to_periodic_line, partial_visit)
        call schedule_event(self%calendar, self%flight, i, flight%due)
      case (counted_in_gate)
        call enter_gate(self%gate(flight%urn), flight%time + 0.5_wp*flight%through, i)
      case default
        continue
      end select
    end associate
  end subroutine schedule_next_event

  !> Computes the passages through the urn of the visits of batch `b`, and adds their wall hits to
  !> `computed_hits`.
  subroutine compute_urn_passages(self, b)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: b

    associate (v => self%visits(b))
      if (self%table%urn(b)%truncates_passages) call store_passage_starts(self%passage_starts, v, &
        v%count)
      call compute_passages(self%table%urn(b), v)
      self%computed_hits = self%computed_hits + v%all_hits
    end associate
  end subroutine compute_urn_passages

  !> Writes the flights in which the visits of batch `b` end to the flights of their particles, and
  !> the starts of those that are long, or cannot be traced back, to `long_visits`.
  subroutine store_batch_flights(self, b)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: b

    associate (v => self%visits(b))
      if (v%many_hits_count + v%untraceable_count > 0) call store_visit_starts(self%long_visits, &
        self%number, self%flight, v)
      call store_flights(self%number, self%flight, v%count, v%particle, v%urn, v%channel, v%time, &
        v%length, v%y, v%u_axial, v%u_lateral, v%through)
      if (self%table%urn(b)%truncates_passages) self%partial_count = self%partial_count &
        + count(v%channel(:v%count) == truncated)
    end associate
  end subroutine store_batch_flights

  !> Advances by one window of at most `duration`: processes its events, then computes the visits
  !> that they begin.
  subroutine advance_window(self, duration, event_record)
    class(excursion_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(event_record_type), intent(inout) :: event_record
    real(wp) :: window_start, limit, window_end, due
    integer :: due_count, event_count, counted(2)

    window_start = self%now
    limit = min(self%now + duration, self%epoch)
    call next_due_time(self%calendar, self%flight, min(limit, first_crossing_time(self%gate)), due)
    window_end = min(limit, due + self%lookahead, max(due, window_start) + self%window)
    call open_buckets_until(self%calendar, self%flight, window_end)
    due_count = count_due_before(self%calendar%sorted, self%calendar%due_time, window_end)
    event_count = due_count
    self%resumed_count = 0
    if (self%partial_count > 0 .or. self%table%has_scatterers) call split_off_partial_visits( &
      self%number, self%flight, self%calendar%due_time, self%calendar%particle, event_count, &
      self%resumed_count, self%resumed_time, self%resumed)
    counted = number_inside(self%gate)
    call reserve_visits(self%visits(1), event_count + sum(counted) + most_precomputed_visits)
    call reserve_event_record(event_record, event_count + sum(counted))
    if (event_count + sum(counted) <= longest_serial_window) then
      call run_serial_window(self%gate, self%table%urn_across, self%flight, self%calendar, &
        event_count, window_start, window_end, self%visits(1), event_record, self%computed_hits)
    else
      call run_batch_window(self%batch_window, self%gate, self%table%urn_across, self%number, &
        self%flight, self%calendar, event_count, window_start, window_end, self%visits(1), &
        event_record, self%computed_hits)
    end if
    call drop_done_events(self%calendar, due_count)
    if (self%table%has_scatterers) then
      call compute_window_visits_with_scatterers(self, window_start, window_end, event_record)
    else
      if (self%resumed_count > 0) call continue_partial_visits(self)
      call compute_window_visits_straight(self)
    end if
    self%now = window_end
    event_record%duration = window_end - window_start
    event_record%collisions = self%computed_hits - self%reported_hits
    self%reported_hits = self%computed_hits
  end subroutine advance_window

  !> Computes the visits that the events of a window began.
  subroutine compute_window_visits_straight(self)
    type(excursion_type), intent(inout) :: self
    integer :: b

    if (self%batches == 2) call split_visits_by_urn(self%visits(1), self%visits(2))
    do b = 1, self%batches
      associate (v => self%visits(b))
        if (self%precomputes_visits) then
          ! There is one batch then (`prepare_engine`), and both urns are mirror images.
          call take_or_compute_visits(self%table%urn(1), self%number, self%flight, &
            self%calendar%sorted, self%calendar%particle, v, self%precomputed, &
            self%passage_starts, self%computed_hits)
        else
          call load_flights(self%number, self%flight, v%count, v%particle, v%reversal_time, &
            v%passage, v%time, v%y, v%u_axial, v%u_lateral)
          call cross_channels(self%table%urn(b), v)
          call compute_urn_passages(self, b)
        end if
        call store_batch_flights(self, b)
        call schedule_events(self%calendar, v%count, v%particle, v%time)
      end associate
    end do
  end subroutine compute_window_visits_straight

  !> Computes the next part of each partial visit that is due.
  subroutine continue_partial_visits(self)
    type(excursion_type), intent(inout) :: self
    integer :: urn

    do urn = 1, 2
      associate (v => self%partial_visits)
        call compute_partial_visits(self%table%urn(urn), urn, self%number, self%flight, &
          self%resumed_count, self%resumed_time, self%resumed, v, self%long_visits, &
          self%passage_starts, self%computed_hits)
        self%partial_count = self%partial_count - v%count + count(v%channel(:v%count) == truncated)
        call schedule_events(self%calendar, v%count, v%particle, v%time)
      end associate
    end do
  end subroutine continue_partial_visits

  !> Shifts calendar, flights, visit starts and clock back by one epoch.
  subroutine rebase_clock(self)
    class(excursion_type), intent(inout) :: self

    call rebase_calendar(self%calendar, self%flight)
    if (self%precomputes_visits) self%flight%precomputed_slot = 0
    if (self%table%has_scatterers) self%scatterer_visits%visit_start%time = &
      self%scatterer_visits%visit_start%time - self%epoch
    self%flight%time = self%flight%time - self%epoch
    call rebase_long_visits(self%long_visits, self%epoch)
    self%passage_starts(start_words, :) = self%passage_starts(start_words, :) - self%epoch
    call rebase_gates_and_clock(self)
  end subroutine rebase_clock

  !> x, y, u_x, u_y of particle `i` now.
  function state_of(self, i) result(state)
    class(excursion_type), intent(in) :: self
    integer, intent(in) :: i
    real(wp) :: state(4)
    integer(int64) :: hits

    call locate_particle_now(self, i, state, hits)
    associate (flight => self%flight(i))
      state(1) = x_on_side(self%table, int(flight%urn), flight%next_event == to_gate, &
        flight%next_event == counted_in_gate, state(1), state(2), state(3))
    end associate
  end function state_of

  !> State (x, y, u_x, u_y) of particle `i` now, computed from the nearer end of its visit; and the
  !> `hits` to be added to `computed_hits` for this particle.
  subroutine locate_particle_now(self, i, state, hits)
    type(excursion_type), intent(in) :: self
    integer, intent(in) :: i
    real(wp), intent(out) :: state(4)
    integer(int64), intent(out) :: hits
    logical :: from_start

    associate (flight => self%flight(i), urn => self%table%urn(self%flight(i)%urn))
      if (flight%next_event == trapped_in_channel) then
        call locate_trapped_particle(urn, flight, self%trapped_x(i), self%now, state, hits)
      else if (self%table%has_scatterers .and. flight%next_event /= counted_in_gate &
        .and. (flight%next_event /= to_gate .or. self%now < flight%time)) then
        call locate_by_replay(self%table, self%scatterer_visits%visit_start(i), self%now, state, &
          hits)
      else
        from_start = is_nearer_start(self%long_visits, i, flight, self%now)
        if (from_start) then
          call locate_from_start(self%long_visits, urn, i, self%now, state(:2), state(3:), hits)
        else
          call locate_particle(urn, flight, self%now, state(:2), state(3:), hits)
        end if
        if (urn%truncates_passages .and. flight%next_event /= counted_in_gate .and. .not. &
          self%table%has_scatterers) call correct_by_passage(self%passage_starts(:, i), urn, &
          flight, self%now, from_start, state(:2), state(3:), hits)
        state(1) = urn%axis_sign*(state(1) - urn%centre)
        state(3) = urn%axis_sign*state(3)
      end if
    end associate
  end subroutine locate_particle_now

  !> Exact number of wall hits from the start until now: `computed_hits`, corrected for each
  !> particle.
  function collisions(self) result(total)
    class(excursion_type), intent(in) :: self
    integer(int64) :: total
    real(wp) :: state(4)
    integer(int64) :: hits
    integer :: i

    total = self%computed_hits
    do i = 1, self%number
      call locate_particle_now(self, i, state, hits)
      total = total + hits
    end do
  end function collisions

  !> Number of particles that never leave their urn or channel, those that repeat a path among discs
  !> included.
  function trapped(self) result(total)
    class(excursion_type), intent(in) :: self
    integer(int64) :: total
    real(wp) :: state(4)
    integer(int64) :: hits
    integer :: i

    total = count(self%flight%next_event == trapped_in_urn .or. self%flight%next_event == &
      trapped_in_channel)
    if (.not. self%table%has_scatterers) return
    do i = 1, self%number
      if (self%flight(i)%next_event /= partial_visit) cycle
      call locate_particle_now(self, i, state, hits)
      if (is_trapped(self%table, motion_at(self%table, state(1), state(2), state(3), state(4)))) &
        total = total + 1
    end do
  end function trapped

  !> Saves or restores flights and counts; the calendar follows from the flights.
  subroutine serialize_own_state(self, archive)
    class(excursion_type), intent(inout) :: self
    type(archive_type), intent(inout) :: archive
    integer :: i

    ! Names in saved states are a format: they stay when a component is renamed.
    call archive%serialize('known_hits', self%computed_hits)
    call archive%serialize('told_hits', self%reported_hits)
    call archive%serialize('heading', self%flight%next_event)
    call archive%serialize('urn', self%flight%urn)
    call archive%serialize('due', self%flight%due, 'time', self%flight%time, 'y', self%flight%y)
    call archive%serialize('along', self%flight%u_axial, 'across', self%flight%u_lateral, &
      'length', self%flight%length, 'through', self%flight%through)
    if (any(self%flight%next_event == trapped_in_channel)) &
      call archive%serialize_list('trapped_x', self%trapped_x)
    if (self%table%has_scatterers) then
      call serialize_visit_starts(self%scatterer_visits, self%flight%urn, archive)
    else
      call serialize_long_visits(self%long_visits, self%flight, archive)
      call serialize_passage_starts(self%passage_starts, archive)
    end if
    if (.not. archive%reading .or. archive%failed()) return
    self%partial_count = merge(0, count(self%flight%next_event == partial_visit), &
      self%table%has_scatterers)
    call new_calendar(self%calendar, self%number, self%interval)
    do i = 1, self%number
      if (any(self%flight(i)%next_event == [to_gate, to_periodic_line, partial_visit])) &
        call schedule_event(self%calendar, self%flight, i, self%flight(i)%due)
    end do
  end subroutine serialize_own_state

end module battery_excursion

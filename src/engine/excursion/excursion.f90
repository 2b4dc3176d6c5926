!> The engine `excursion`: one event a gate entry or crossing, whole visits to the urns in batches.
!>
!> Particles feel each other through the counts of the two gates only. So the events that need a
!> common order are few: a particle enters a gate, crosses the middle of channel 1, or crosses the
!> periodic line. After any of them its next entry or periodic crossing is at least
!> `shortest_excursion` away. A window that long is walked through in the order of time; all
!> particles that go back to an urn are gathered, and their visits are computed in one batch.
!>
!> What is known of a particle (`flight_type`) is how it will enter its next channel; where it is
!> until then follows by going back from there, or forwards from where a long visit began.
module battery_excursion
  use battery_kinds, only: wp, int64, pi
  use battery_table, only: gated, ungated, side_at, alike, mean_visit, shortest_excursion, &
    is_scattered
  use battery_flight, only: gather, never, to_gate, to_return, in_gate, &
    parked_in_urn, parked_in_channel, in_parts
  use battery_launch, only: launch, lay_out, date_back
  use battery_long_visits, only: long_visits_type, new_long_visits, is_long_visit, &
    keep_beginnings, land, set_back_long
  use battery_few, only: walk_few, few
  use battery_foresight, only: pays, recall
  use battery_scattered_sides, only: sides_type, new_sides
  use battery_chamber, only: leave_channels
  use battery_scatterers, only: narrowest_gap
  use battery_urn, only: cross
  use battery_parts, only: set_apart, compute_parts
  use battery_visits, only: visits_type, reserve_visits, part_visits, goes_on
  use battery_gate, only: enter, admit, number_inside, first_crossing
  use battery_window, only: window_type, reserve_window, deal, line_up, read_ticket, write_log, &
    record_crossings
  use battery_calendar, only: calendar_type, flight_type, new_calendar, page_for, &
    schedule, schedule_all, open_until, next_due, due_before, drop_done, turn_calendar
  use battery_engine, only: engine_type, particles_type, turn_clock
  use battery_history, only: history_type, reserve_history
  use battery_stream, only: stream_type
  implicit none (type, external)
  private
  public :: excursion_type

  !> How many particles are taken over at a time at the start.
  integer, parameter :: start_chunk = 4096

  !> The engine: a flight for each particle, and the calendar of their events.
  type, extends(engine_type) :: excursion_type
    private
    !> Most events of one window; the visits of a window should fit into the cache.
    integer, public :: batch = 1024
    type(flight_type), allocatable :: flight(:)
    !> Where each is along x in the frame of the table, if any is parked in a channel: for ever.
    real(wp), allocatable :: parked_x(:)
    type(calendar_type) :: calendar
    !> The events of a window.
    type(window_type) :: events
    !> The visits to the urn of each side. Urns that are alike share the first batch; the second has
    !> those foreseen then, if it pays to look ahead.
    type(visits_type) :: visits(2)
    integer :: batches = 1
    logical, public :: looks_ahead = .false.
    !> Whether discs stand in channel 2, and what is known of visits then.
    logical :: scattered = .false.
    type(sides_type) :: sides
    !> Lookahead, longest window, mean time between two events of a particle.
    real(wp) :: lookahead = 0.0_wp, window = 0.0_wp, interval = 0.0_wp
    !> How many visits are known in part; those that are gone on with now, when and who.
    integer :: parts = 0, others = 0
    real(wp), allocatable :: other_time(:)
    integer, allocatable :: other(:)
    type(visits_type) :: partial
    !> How those began that are long; where discs stand in channel 2 `sides` knows that of all.
    type(long_visits_type) :: long_visits
    !> Wall hits of all visits and passages computed so far, those still to come included, and what
    !> histories have told of them.
    integer(int64) :: known_hits = 0, told_hits = 0
  contains
    procedure :: prepare, take_over, live, turn_page, pass_own, state_of, collisions, trapped
  end type excursion_type

  !> Where discs stand in channel 2 a window has no more hits of one particle in a narrow gap,
  !> unless it were shorter than this share of the longest.
  real(wp), parameter :: window_hits = 1.0e6_wp, least_window = 1.0e-3_wp

  ! What it tells of itself, and how its state is kept: `excursion_state.f90`.
  interface
    module function state_of(self, i) result(state)
      implicit none (type, external)
      class(excursion_type), intent(in) :: self
      integer, intent(in) :: i
      real(wp) :: state(4)
    end function state_of

    module function collisions(self) result(total)
      implicit none (type, external)
      class(excursion_type), intent(in) :: self
      integer(int64) :: total
    end function collisions

    module function trapped(self) result(total)
      implicit none (type, external)
      class(excursion_type), intent(in) :: self
      integer(int64) :: total
    end function trapped

    module subroutine pass_own(self, stream)
      implicit none (type, external)
      class(excursion_type), intent(inout) :: self
      type(stream_type), intent(inout) :: stream
    end subroutine pass_own
  end interface

  ! Where discs stand in channel 2: `excursion_scattered.f90`.
  interface
    module subroutine take_over_scattered(self, particles)
      implicit none (type, external)
      type(excursion_type), intent(inout) :: self
      type(particles_type), intent(inout) :: particles
    end subroutine take_over_scattered

    module subroutine go_scattered(self, began, ends, history)
      implicit none (type, external)
      type(excursion_type), intent(inout) :: self
      !> The window.
      real(wp), intent(in) :: began, ends
      type(history_type), intent(inout) :: history
    end subroutine go_scattered
  end interface

contains

  !> Sizes and lengths that follow from the table and the number of particles.
  subroutine prepare(self)
    class(excursion_type), intent(inout) :: self

    self%batches = merge(1, 2, alike(self%table%urn))
    self%interval = 0.5_wp*(mean_visit(self%table%urn(1)) + mean_visit(self%table%urn(2))) &
      + 0.25_wp*pi*self%table%channel(gated)%length
    self%lookahead = shortest_excursion(self%table)
    self%window = min(self%lookahead, real(self%batch, wp)*self%interval/real(self%number, wp))
    self%scattered = is_scattered(self%table)
    if (self%scattered) then
      call new_sides(self%sides, self%number)
      self%window = min(self%window, max(least_window*self%lookahead, window_hits &
        *narrowest_gap(self%table%channel(ungated), self%table%scatterers)))
    end if
    self%looks_ahead = self%batches == 1 .and. .not. self%scattered .and. &
      pays(real(self%number, wp)*self%lookahead/self%interval, self%gate%threshold)
    if (allocated(self%flight)) deallocate (self%flight)
    call lay_out(self%flight, self%number)
    call new_long_visits(self%long_visits, self%number, maxval(self%table%urn%reach))
    self%known_hits = 0
    self%told_hits = 0
    self%parts = 0
    self%page = page_for(self%interval)
  end subroutine prepare

  !> Takes over the particles, and writes down their first events.
  subroutine take_over(self, particles)
    class(excursion_type), intent(inout) :: self
    type(particles_type), intent(inout) :: particles
    integer :: i

    if (self%scattered) then
      call take_over_scattered(self, particles)
    else
      call take_over_straight(self, particles)
    end if
    if (any(self%flight%heading == parked_in_channel)) self%parked_x = particles%x
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
    call new_calendar(self%calendar, self%number, self%interval)
    do i = 1, self%number
      call write_down(self, i)
    end do
  end subroutine take_over

  !> First those in the urns, then those in the channels.
  subroutine take_over_straight(self, particles)
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
          b = min(side_at(self%table, particles%x(i)), self%batches)
          call launch(self%table, i, particles%x(i), particles%y(i), particles%ux(i), &
            particles%uy(i), from_channels, self%flight(i), self%visits(b), self%known_hits)
        end do
        do b = 1, self%batches
          if (from_channels) call leave_channels(self%table%urn(b), self%visits(b))
          call cross_urn(self, b)
          associate (v => self%visits(b))
            do j = 1, v%count
              if (.not. is_long_visit(self%long_visits%least, v%channel(j), v%length(j))) cycle
              i = v%particle(j)
              call date_back(self%table, particles%x(i), particles%y(i), particles%ux(i), &
                particles%uy(i), self%flight(i), v%hits(j))
            end do
          end associate
          call go_on(self, b)
        end do
      end do
    end do
  end subroutine take_over_straight

  !> Puts the next event of a particle into the calendar, or, inside a gate, lets that count it.
  subroutine write_down(self, i)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: i

    associate (flight => self%flight(i))
      select case (flight%heading)
      case (to_gate)
        call schedule(self%calendar, self%flight, i, flight%time)
      case (to_return)
        call schedule(self%calendar, self%flight, i, flight%time + 0.5_wp*flight%through)
      case (in_parts)
        call schedule(self%calendar, self%flight, i, flight%time - flight%through)
      case (in_gate)
        call enter(self%gate(flight%urn), flight%time + 0.5_wp*flight%through, i)
      case default
        continue
      end select
    end associate
  end subroutine write_down

  !> Visits of a batch: from the urn's entrance to its exit.
  subroutine cross_urn(self, b)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: b

    associate (v => self%visits(b))
      call cross(self%table%urn(b), v)
      self%known_hits = self%known_hits + v%all_hits
    end associate
  end subroutine cross_urn

  !> Writes down how the particles of a batch go on.
  subroutine go_on(self, b)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: b

    associate (v => self%visits(b))
      if (v%many_count > 0) call keep_beginnings(self%long_visits, self%number, &
        self%flight, v)
      call land(self%number, self%flight, v%count, v%particle, v%urn, v%channel, v%time, v%length, &
        v%y, v%along, v%across, v%through)
      if (self%table%urn(b)%hands_on) self%parts = self%parts &
        + count(v%channel(:v%count) == goes_on)
    end associate
  end subroutine go_on

  !> One window of at most the time `duration`: its events, then the visits that they begin.
  subroutine live(self, duration, history)
    class(excursion_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(history_type), intent(inout) :: history
    real(wp) :: began, limit, ends, due
    integer :: due_now, done, counted(2)

    began = self%now
    limit = min(self%now + duration, self%page)
    call next_due(self%calendar, self%flight, min(limit, first_crossing(self%gate)), due)
    ends = min(limit, due + self%lookahead, max(due, began) + self%window)
    call open_until(self%calendar, self%flight, ends)
    due_now = due_before(self%calendar%sorted, self%calendar%due_time, ends)
    done = due_now
    self%others = 0
    if (self%parts > 0 .or. self%scattered) call set_apart(self%number, self%flight, &
      self%calendar%due_time, self%calendar%particle, done, self%others, self%other_time, &
      self%other)
    counted = number_inside(self%gate)
    call reserve_visits(self%visits(1), done + sum(counted))
    call reserve_history(history, done + sum(counted), 0)
    if (done <= few) then
      call walk_few(self%gate, self%table%beyond, self%flight, self%calendar, done, began, ends, &
        self%visits(1), history, self%known_hits)
    else
      call reserve_window(self%events, done, counted)
      call walk(self, began, ends, done, history)
    end if
    call drop_done(self%calendar, due_now)
    if (self%scattered) then
      call go_scattered(self, began, ends, history)
    else
      if (self%others > 0) call go_on_with_parts(self)
      call go_straight(self)
    end if
    self%now = ends
    history%duration = ends - began
    history%collisions = self%known_hits - self%told_hits
    self%told_hits = self%known_hits
  end subroutine live

  !> The visits of a window.
  subroutine go_straight(self)
    type(excursion_type), intent(inout) :: self
    integer :: b

    if (self%batches == 2) call part_visits(self%visits(1), self%visits(2))
    do b = 1, self%batches
      associate (v => self%visits(b))
        if (self%looks_ahead .and. self%parts == 0) then
          call recall(self%table%urn(1), self%number, self%flight, self%calendar%sorted, &
            self%calendar%particle, v, self%visits(2), self%known_hits)
        else
          if (self%looks_ahead) self%visits(2)%count = 0
          call gather(self%number, self%flight, v%count, v%particle, v%turned, v%passage, v%time, &
            v%y, v%along, v%across)
          call leave_channels(self%table%urn(b), v)
          call cross_urn(self, b)
        end if
        call go_on(self, b)
        call schedule_all(self%calendar, v%count, v%particle, v%time)
      end associate
    end do
  end subroutine go_straight

  !> Goes on with visits of which a part is known.
  subroutine go_on_with_parts(self)
    type(excursion_type), intent(inout) :: self
    integer :: side

    do side = 1, 2
      associate (v => self%partial)
        call compute_parts(self%table%urn(side), side, self%number, self%flight, self%others, &
          self%other_time, self%other, v, self%long_visits, self%known_hits)
        self%parts = self%parts - v%count + count(v%channel(:v%count) == goes_on)
        call schedule_all(self%calendar, v%count, v%particle, v%time)
      end associate
    end do
  end subroutine go_on_with_parts

  !> Sets back the calendar, the flights and the clock.
  subroutine turn_page(self)
    class(excursion_type), intent(inout) :: self

    call turn_calendar(self%calendar, self%flight)
    if (self%looks_ahead) self%visits(2)%count = 0
    if (self%scattered) self%sides%begun%time = self%sides%begun%time - self%page
    self%flight%time = self%flight%time - self%page
    call set_back_long(self%long_visits, self%page)
    call turn_clock(self)
  end subroutine turn_page

  !> All events before `ends`, the first `events` of the sorted ones and the crossings of the middle
  !> line; gathers the visits that they begin. The gates do not meet: what the entries into one lead
  !> to has nothing to do with the other.
  subroutine walk(self, began, ends, events, history)
    class(excursion_type), intent(inout) :: self
    real(wp), intent(in) :: began, ends
    integer, intent(in) :: events
    type(history_type), intent(inout) :: history
    integer :: urn, before, crossed, crossed_before, from_gate(2)

    associate (v => self%visits(1), w => self%events, due => self%calendar%due_time, &
      particle => self%calendar%particle)
      call deal(self%number, self%flight, events, due, particle, size(w%ticket), w%dealt, w%due, &
        w%middle, w%particle)
      crossed = 0
      do urn = 1, 2
        before = v%count
        crossed_before = crossed
        call admit(self%gate(urn), w%stretch(urn), w%dealt(urn), w%due(:, urn), w%middle(:, urn), &
          w%particle(:, urn), ends, v%count, v%particle, v%turned, crossed, w%ticket, &
          w%crossing_time)
        v%urn(before + 1:v%count) = urn
        v%channel(before + 1:v%count) = gated
        from_gate(urn) = crossed - crossed_before
        if (self%table%beyond(urn) == urn) self%known_hits = self%known_hits + from_gate(urn)
      end do
      call line_up(w, from_gate(1), from_gate(2))
      if (history%logging) then
        call write_log(w, self%number, self%flight, began, events, due, particle, history)
      else
        history%reversals = w%stretch%reversals
        history%bounce_backs = v%count
        call record_crossings(w, self%number, self%flight, began, history)
      end if
      call send(self, w%crossings, w%ticket)
    end associate
  end subroutine walk

  !> Puts those who have crossed a line into the batch: they go straight to the urn beyond.
  pure subroutine send(self, crossings, ticket)
    class(excursion_type), intent(inout) :: self
    integer, intent(in) :: crossings
    !> As in `window_type`.
    integer, intent(in) :: ticket(crossings)
    integer :: k, count, particle, from, channel

    associate (v => self%visits(1))
      count = v%count
      do k = 1, crossings
        call read_ticket(self%number, self%flight, ticket(k), particle, from, channel)
        v%particle(count + k) = particle
        v%urn(count + k) = self%table%beyond(from)
        v%channel(count + k) = channel
        v%turned(count + k) = never
      end do
      v%count = count + crossings
    end associate
  end subroutine send

end module battery_excursion

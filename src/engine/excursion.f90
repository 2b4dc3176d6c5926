!> The engine `excursion`: one event a gate entry or crossing, whole visits to the urns in batches.
!>
!> Particles feel each other through the counts of the two gates only. So the events that need a
!> common order are few: a particle enters a gate, crosses the middle of channel 1, or crosses the
!> periodic line. After any of them its next entry or periodic crossing is at least
!> `shortest_excursion` away. A window that long is walked through in the order of time; all
!> particles that go back to an urn are gathered, and their visits are computed in one batch.
!>
!> What is known of a particle (`flight_type`) is how it will enter its next channel; where it is
!> until then follows by going back from there.
module battery_excursion
  use, intrinsic :: iso_c_binding, only: c_loc, c_size_t
  use battery_kinds, only: wp, int8, int16, int64, pi
  use battery_table, only: table_type, shape_circuit, area_of_urn, shortest_excursion
  use battery_flight, only: look_up, gather, land, locate, straight, to_gate, to_return, in_gate, &
    parked_in_urn, parked_in_channel
  use battery_launch, only: launch
  use battery_urn, only: urn_type, new_urn, leave_channels, cross_urns
  use battery_visits, only: visits_type, reserve_visits
  use battery_gate, only: gate_type, empty_gate, fill_gate, enter_gate, cross_middle, shift_gate
  use battery_calendar, only: calendar_type, flight_type, idle, new_calendar, schedule, &
    schedule_all, open_until, next_due, drop_done, turn_page
  use battery_memory, only: prefer_large_pages
  use battery_engine, only: engine_type, engine_state_type, history_type, particles_type, &
    reserve_history, record_crossing, record_event, channel1_12, channel1_21, channel2_12, &
    channel2_21, event_entry, event_reversal
  implicit none (type, external)
  private
  public :: excursion_type

  !> How many particles are taken over at a time at the start.
  integer, parameter :: start_chunk = 4096

  type, extends(engine_type) :: excursion_type
    private
    !> Most events of one window; the visits of a window should fit into the cache.
    integer, public :: batch = 1024
    type(urn_type) :: urn
    type(flight_type), allocatable :: flight(:)
    type(gate_type) :: gate(2)
    type(calendar_type) :: calendar
    type(visits_type) :: visits
    !> Of the sorted events of the calendar: when an entrant would cross the middle.
    real(wp), allocatable :: middle(:)
    !> Time since the page of the calendar was turned, and how often it was.
    real(wp) :: now = 0.0_wp
    integer(int64) :: pages = 0
    real(wp) :: clock_start = 0.0_wp
    !> Lookahead, longest window, mean time between two events of a particle, half lengths of the
    !> channels.
    real(wp) :: lookahead = 0.0_wp, window = 0.0_wp, interval = 0.0_wp, half1 = 0.0_wp, half2 = &
      0.0_wp
    !> Wall hits of all visits and passages computed so far, those still to come included, and what
    !> histories have told of them.
    integer(int64) :: known_hits = 0, told_hits = 0
  contains
    procedure :: start
    procedure :: advance
    procedure :: particles => all_particles
    procedure :: collisions
    procedure :: trapped
    procedure :: clock
    procedure :: save_state
    procedure :: restore_state
  end type excursion_type

contains

  subroutine start(self, table, threshold, particles, clock)
    class(excursion_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold
    type(particles_type), intent(inout) :: particles
    real(wp), intent(in) :: clock
    integer :: first, i, urn
    logical :: from_channels

    call prepare(self, table, threshold, size(particles%x))
    self%clock_start = clock
    from_channels = .false.
    do
      do first = 1, self%number, start_chunk
        call reserve_visits(self%visits, start_chunk)
        do i = first, min(first + start_chunk - 1, self%number)
          call launch(self%table, i, particles%x(i), particles%y(i), particles%ux(i), &
            particles%uy(i), from_channels, self%flight(i), self%visits, self%known_hits)
        end do
        if (from_channels) call leave_channels(self%urn, self%visits)
        call finish_visits(self)
        self%visits%count = 0
      end do
      if (from_channels) exit
      from_channels = .true.
    end do
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
    call new_calendar(self%calendar, self%number, self%interval)
    do i = 1, self%number
      call write_down(self, i)
    end do
    do urn = 1, 2
      call fill_at_start(self, urn)
    end do
  end subroutine start

  !> Puts the next event of a particle into the calendar, if it has one there.
  subroutine write_down(self, i)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp) :: due

    associate (flight => self%flight(i))
      if (flight%heading /= to_gate .and. flight%heading /= to_return) return
      due = flight%time
      if (flight%heading == to_return) due = due + 0.5_wp*flight%through
    end associate
    call schedule(self%calendar, self%flight, i, due)
  end subroutine write_down

  !> Counts those that are inside a gate when the run starts.
  subroutine fill_at_start(self, urn)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: urn
    integer, allocatable :: inside(:)
    integer :: i, members

    members = count(self%flight%heading == in_gate .and. self%flight%urn == urn)
    allocate (inside(members))
    members = 0
    do i = 1, self%number
      if (self%flight(i)%heading /= in_gate .or. self%flight(i)%urn /= urn) cycle
      members = members + 1
      inside(members) = i
    end do
    call fill_gate(self%gate(urn), self%flight(inside)%time &
      + 0.5_wp*self%flight(inside)%through, inside)
  end subroutine fill_at_start

  !> Sizes and lengths that follow from the table and the number of particles.
  subroutine prepare(self, table, threshold, number)
    type(excursion_type), intent(inout), target :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number
    integer :: g

    self%table = table
    self%threshold = threshold
    self%number = number
    self%urn = new_urn(table)
    self%half1 = 0.5_wp*table%channel1_length
    self%half2 = 0.5_wp*table%channel2_length
    self%interval = pi*area_of_urn(table)/(table%channel1_width + table%channel2_width) &
      + 0.25_wp*pi*table%channel1_length
    self%lookahead = shortest_excursion(table)
    self%window = min(self%lookahead, real(self%batch, wp)*self%interval/real(number, wp))
    if (allocated(self%flight)) deallocate (self%flight, self%middle)
    allocate (self%flight(number), self%middle(number))
    call prefer_large_pages(c_loc(self%flight), int(number, c_size_t)*storage_size(self%flight)/8)
    self%flight = idle
    do g = 1, 2
      call empty_gate(self%gate(g))
    end do
    self%now = 0.0_wp
    self%pages = 0
    self%known_hits = 0
    self%told_hits = 0
  end subroutine prepare

  !> Visits of the batch: from the urn's entrance to its exit, into flights.
  subroutine finish_visits(self)
    type(excursion_type), intent(inout) :: self
    integer :: n

    call cross_urns(self%urn, self%visits)
    n = self%visits%count
    associate (v => self%visits)
      self%known_hits = self%known_hits + v%all_hits
      call land(self%number, self%flight, n, v%particle, v%urn, v%opening, v%time, v%length, v%y, &
        v%along, v%across, v%passage)
    end associate
  end subroutine finish_visits

  subroutine advance(self, duration, history)
    class(excursion_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(history_type), intent(inout) :: history
    real(wp) :: began, limit, ends, due
    integer :: done

    if (self%now >= self%calendar%page) call turn(self)
    began = self%now
    limit = min(self%now + duration, self%calendar%page)
    call next_due(self%calendar, self%flight, min(limit, self%gate(1)%next_crossing, &
      self%gate(2)%next_crossing), due)
    ends = min(limit, due + self%lookahead, max(due, began) + self%window)
    call open_until(self%calendar, self%flight, ends)
    call reserve_visits(self%visits, self%calendar%sorted + self%gate(1)%count + self%gate(2)%count)
    call reserve_history(history, self%calendar%sorted, 0)
    call look_up(self%number, self%flight, self%calendar%sorted, self%calendar%particle, &
      self%calendar%due_time, self%middle)
    call walk(self, began, ends, self%calendar%sorted, self%calendar%due_time, &
      self%calendar%particle, self%middle, self%number, self%flight, history, done)
    call drop_done(self%calendar, done)
    call gather(self%number, self%flight, self%visits%count, self%visits%particle, &
      self%visits%urn, self%visits%opening, self%visits%passage, self%visits%time, &
      self%visits%y, self%visits%along, self%visits%across)
    call leave_channels(self%urn, self%visits)
    call finish_visits(self)
    call schedule_all(self%calendar, self%flight, self%visits%count, &
      self%visits%particle, self%visits%time)
    self%visits%count = 0
    self%now = ends
    history%duration = ends - began
    history%collisions = self%known_hits - self%told_hits
    self%told_hits = self%known_hits
  end subroutine advance

  !> Turns the page: all clocks are set back by its length.
  subroutine turn(self)
    type(excursion_type), intent(inout) :: self
    integer :: g

    call turn_page(self%calendar, self%flight)
    do g = 1, 2
      call shift_gate(self%gate(g), self%calendar%page)
    end do
    self%flight%time = self%flight%time - self%calendar%page
    self%now = self%now - self%calendar%page
    self%pages = self%pages + 1
  end subroutine turn

  !> All events before `ends`, in the order of time; gathers the visits that begin with them. `done`
  !> of the `last` sorted ones were.
  subroutine walk(self, began, ends, last, due_time, particle, middle, number, flight, history, &
    done)
    type(excursion_type), intent(inout) :: self
    real(wp), intent(in) :: began, ends
    integer, intent(in) :: last, particle(last)
    real(wp), intent(in) :: due_time(last), middle(last)
    integer, intent(in) :: number
    type(flight_type), intent(inout) :: flight(number)
    type(history_type), intent(inout) :: history
    integer, intent(out) :: done
    real(wp) :: time
    integer :: at, i, urn, threshold
    logical :: logging

    ! Copies, which the compiler may keep in registers while it writes to `self`.
    threshold = self%threshold
    logging = history%logging
    do at = 1, last
      time = due_time(at)
      if (time >= ends) exit
      i = particle(at)
      do while (min(self%gate(1)%next_crossing, self%gate(2)%next_crossing) <= time)
        call cross_channel1(self, began, history)
      end do
      urn = flight(i)%urn
      if (flight(i)%heading == to_gate) then
        flight(i)%heading = in_gate
        call enter_gate(self%gate(urn), middle(at), i)
        if (logging) call record_event(history, time - began, event_entry, urn, i)
        if (self%gate(urn)%count > threshold) then
          if (.not. more_enter_now(last, due_time, particle, number, flight, at)) &
            call reverse(self, urn, time, began, history)
        end if
      else
        call record_crossing(history, time - began, merge(channel2_12, channel2_21, urn == 1), i)
        call send(self, i, urn - 3)
      end if
    end do
    done = at - 1
    do while (min(self%gate(1)%next_crossing, self%gate(2)%next_crossing) < ends)
      call cross_channel1(self, began, history)
    end do
  end subroutine walk

  !> Whether another particle enters the same gate at the very same time as the event `at`.
  pure function more_enter_now(last, due_time, particle, number, flight, at) result(more)
    integer, intent(in) :: last, particle(last), number, at
    real(wp), intent(in) :: due_time(last)
    type(flight_type), intent(in) :: flight(number)
    logical :: more
    integer :: other, i

    more = .false.
    do other = at + 1, last
      if (due_time(other) > due_time(at)) exit
      i = particle(other)
      more = flight(i)%heading == to_gate .and. flight(i)%urn == flight(particle(at))%urn
      if (more) exit
    end do
  end function more_enter_now

  !> A gate reverses: all counted go back to their urn, as long as they have been in the channel.
  subroutine reverse(self, urn, time, began, history)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: urn
    real(wp), intent(in) :: time, began
    type(history_type), intent(inout) :: history
    integer :: counted, before

    if (history%logging) &
      call record_event(history, time - began, event_reversal, urn, self%gate(urn)%count)
    counted = self%gate(urn)%count
    before = self%visits%count
    self%visits%count = before + counted
    self%visits%particle(before + 1:before + counted) = self%gate(urn)%particle(:counted)
    self%visits%urn(before + 1:before + counted) = urn
    self%visits%passage(before + 1:before + counted) = time
    history%reversals = history%reversals + 1
    history%bounce_backs = history%bounce_backs + counted
    call empty_gate(self%gate(urn))
  end subroutine reverse

  !> The next particle of channel 1 crosses its middle line (in `shape_urn` it hits the end wall).
  subroutine cross_channel1(self, began, history)
    type(excursion_type), intent(inout) :: self
    real(wp), intent(in) :: began
    type(history_type), intent(inout) :: history
    real(wp) :: time
    integer :: urn, i, beyond

    urn = merge(1, 2, self%gate(1)%next_crossing <= self%gate(2)%next_crossing)
    time = self%gate(urn)%next_crossing
    call cross_middle(self%gate(urn), i)
    call record_crossing(history, time - began, merge(channel1_12, channel1_21, urn == 1), i)
    beyond = 3 - urn
    if (self%table%shape /= shape_circuit) then
      beyond = urn
      self%known_hits = self%known_hits + 1
    end if
    call send(self, i, beyond)
  end subroutine cross_channel1

  !> Puts a particle into the batch: it goes to `urn` through channel 1, or to -`urn` through
  !> channel 2, straight.
  subroutine send(self, i, urn)
    type(excursion_type), intent(inout) :: self
    integer, intent(in) :: i, urn
    integer :: count

    count = self%visits%count + 1
    self%visits%count = count
    self%visits%particle(count) = i
    self%visits%urn(count) = urn
    self%visits%passage(count) = straight
  end subroutine send

  subroutine all_particles(self, first, last, particles)
    class(excursion_type), intent(in) :: self
    integer, intent(in) :: first, last
    type(particles_type), intent(out) :: particles
    integer :: i
    integer(int64) :: hits
    real(wp) :: position(2), velocity(2), side

    allocate (particles%x(last - first + 1), particles%y(last - first + 1))
    allocate (particles%ux(last - first + 1), particles%uy(last - first + 1))
    do i = first, last
      call locate(self%urn, self%half1, self%flight(i), self%now, position, velocity, hits)
      side = merge(1.0_wp, -1.0_wp, self%flight(i)%urn == 1)
      if (self%flight(i)%heading == parked_in_channel) then
        particles%x(i - first + 1) = position(1)
        particles%ux(i - first + 1) = velocity(1)
      else
        particles%x(i - first + 1) = side*(position(1) - self%table%urn_centre)
        particles%ux(i - first + 1) = side*velocity(1)
      end if
      particles%y(i - first + 1) = position(2)
      particles%uy(i - first + 1) = velocity(2)
    end do
  end subroutine all_particles

  function collisions(self) result(total)
    class(excursion_type), intent(in) :: self
    integer(int64) :: total
    real(wp) :: position(2), velocity(2)
    integer(int64) :: hits
    integer :: i

    total = self%known_hits
    do i = 1, self%number
      call locate(self%urn, self%half1, self%flight(i), self%now, position, velocity, hits)
      total = total + hits
    end do
  end function collisions

  function trapped(self) result(total)
    class(excursion_type), intent(in) :: self
    integer(int64) :: total

    total = count(self%flight%heading == parked_in_urn .or. self%flight%heading == &
      parked_in_channel)
  end function trapped

  function clock(self) result(time)
    class(excursion_type), intent(in) :: self
    real(wp) :: time

    time = self%clock_start + (real(self%pages, wp)*self%calendar%page + self%now)
  end function clock

  subroutine save_state(self, state)
    class(excursion_type), intent(in) :: self
    type(engine_state_type), intent(out) :: state
    integer :: counted(2)

    counted = self%gate%count
    state%integers = [self%pages, self%known_hits, self%told_hits, int(counted, int64), &
      int(self%gate(1)%particle(:counted(1)), int64), int(self%gate(2)%particle(:counted(2)), &
      int64)]
    state%reals = [self%now, self%clock_start, self%flight%time, self%flight%y, self%flight%along, &
      self%flight%across, self%flight%length, self%flight%due, &
      self%gate(1)%time(:counted(1)), self%gate(2)%time(:counted(2))]
    state%bytes = int(2*self%flight%heading + self%flight%urn, int8)
  end subroutine save_state

  subroutine restore_state(self, table, threshold, number, state)
    class(excursion_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number
    type(engine_state_type), intent(in) :: state
    real(wp), allocatable :: due(:)
    integer :: at, g, i, counted

    call prepare(self, table, threshold, number)
    self%pages = state%integers(1)
    self%known_hits = state%integers(2)
    self%told_hits = state%integers(3)
    self%now = state%reals(1)
    self%clock_start = state%reals(2)
    self%flight%time = state%reals(3:number + 2)
    self%flight%y = state%reals(number + 3:2*number + 2)
    self%flight%along = state%reals(2*number + 3:3*number + 2)
    self%flight%across = state%reals(3*number + 3:4*number + 2)
    self%flight%length = state%reals(4*number + 3:5*number + 2)
    call new_calendar(self%calendar, number, self%interval)
    due = state%reals(5*number + 3:6*number + 2)
    self%flight%heading = int((state%bytes - 1)/2, int16)
    self%flight%urn = int(state%bytes, int16) - 2_int16*self%flight%heading
    do i = 1, number
      if (self%flight(i)%along > 0.0_wp) self%flight(i)%through = merge(table%channel2_length, &
        2.0_wp*self%half1, self%flight(i)%heading == to_return)/self%flight(i)%along
    end do
    at = 0
    do g = 1, 2
      counted = int(state%integers(3 + g))
      call fill_gate(self%gate(g), state%reals(6*number + 3 + at:6*number + 2 + at + counted), &
        int(state%integers(6 + at:5 + at + counted)))
      at = at + counted
    end do
    do i = 1, number
      if (self%flight(i)%heading == to_gate .or. self%flight(i)%heading == to_return) &
        call schedule(self%calendar, self%flight, i, due(i))
    end do
  end subroutine restore_state

end module battery_excursion

!> The engine `reservoir`: urns without memory. The gates and channels are exact, the urns are not.
!>
!> A particle that enters an urn stays for an exponential time of mean pi A / (w + w'), the mean of
!> the true visits, and leaves through channel 1 with probability w / (w + w'), at a height uniform
!> on the opening, in a direction of the cosine law: the sine of its angle to the channel is uniform
!> in (-1, 1). All three are drawn anew, whatever it did before. That is what the theory assumes of
!> an urn, so the difference to `excursion` is what the shape of the urn does.
!>
!> **Events** are those of `excursion`, but a stay can be as short as it likes, so there is no
!> lookahead: events are taken one by one, in the order of time. The pending event of a particle in
!> an urn is that it leaves it; only then it is drawn where. Draws belong to the order of events
!> and to the seed alone, not to the windows.
!>
!> **What is not there.** There are no walls in an urn. `collisions` takes the mean for them,
!> (arc left)/(pi A) hits per time spent in an urn, and the true hits in the channels: so a
!> run of so many collisions is about as long as that of another engine. Nobody has a place in an
!> urn: `particles` draws one, uniform in the urn, from the seed, the time and the particle's
!> number; it is another one at each time.
module battery_reservoir
  use battery_kinds, only: wp, int8, int32, int64, pi
  use battery_table, only: table_type, shape_circuit, area_of_urn, arc_length, region_at, urn_one, &
    urn_two, return_one, return_two
  use battery_channel, only: fold
  use battery_random, only: random_type, new_random, draw_uniform, hashed_uniform
  use battery_gate, only: gate_type, empty_gate, fill_gate, enter_gate, cross_middle, shift_gate
  use battery_calendar, only: calendar_type, new_calendar, schedule, open_until, drop_done, &
    turn_page
  use battery_engine, only: engine_type, engine_state_type, history_type, particles_type, &
    reserve_history, record_crossing, record_event, channel1_12, channel1_21, channel2_12, &
    channel2_21, event_entry, event_reversal
  implicit none (type, external)
  private
  public :: reservoir_type

  !> Random numbers are drawn so many at a time.
  integer, parameter :: block_length = 512

  !> Most and least events of a window. A stay that ends in the window it began in must be put in
  !> its place among the sorted events, so windows grow with the root of the number of particles.
  integer, parameter :: most_events = 2048, least_events = 8

  !> In an urn, or on the way into it from channel 1 or 2; counted in a gate; on the way to the
  !> periodic line; flying to and fro across a channel for ever.
  integer, parameter :: from_gate = 1, from_return = 2, in_gate = 3, to_return = 4, parked = 5

  type :: stay_type
    !> When it entered the channel it is or was last in, at which height, with |u_x| and u_y.
    !> `parked`: time, y, x, u_y.
    real(wp) :: time = 0.0_wp, y = 0.0_wp, along = 0.0_wp, across = 0.0_wp
    !> When it enters the urn, and when its next event is due.
    real(wp) :: entered = 0.0_wp, due = 0.0_wp
    integer(int32) :: heading = from_gate
    !> Urn it is in or goes to, or leaves.
    integer(int32) :: urn = 0
  end type stay_type

  !> Numbers drawn ahead: stays, and where and how an urn is left.
  type :: draws_type
    type(random_type) :: random
    integer :: next_stay = block_length + 1, next_exit = block_length + 1
    real(wp) :: stay(block_length) = 0.0_wp
    !> Height, |u_x|, 1 over it, u_y; `opening` is positive for channel 1.
    real(wp), dimension(block_length) :: y = 0.0_wp, along = 0.0_wp, inverse = 0.0_wp, &
      across = 0.0_wp, opening = 0.0_wp
  end type draws_type

  type, extends(engine_type) :: reservoir_type
    private
    type(stay_type), allocatable :: stay(:)
    type(gate_type) :: gate(2)
    type(calendar_type) :: calendar
    type(draws_type) :: draws
    !> Time since the page of the calendar was turned, and how often it was.
    real(wp) :: now = 0.0_wp
    integer(int64) :: pages = 0
    real(wp) :: clock_start = 0.0_wp
    !> How many of the sorted events of the calendar are over.
    integer :: done = 0
    !> Longest window, mean stay, half lengths of the channels, hits per time in an urn, and a time
    !> that any clock within a page can tell from none.
    real(wp) :: window = 0.0_wp, mean_stay = 0.0_wp, half1 = 0.0_wp, half2 = 0.0_wp, &
      hit_rate = 0.0_wp, shortest = 0.0_wp
    !> Wall hits of all stays and passages drawn so far, those still to come included; what is left
    !> over of those that are not whole; what histories have told of them.
    integer(int64) :: known_hits = 0, told_hits = 0
    real(wp) :: fraction = 0.0_wp
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
    integer, allocatable :: inside(:)
    integer :: i, g

    call prepare(self, table, threshold, size(particles%x))
    self%clock_start = clock
    self%draws%random = new_random(self%seed)
    do i = 1, self%number
      call take_over(self, i, particles%x(i), particles%y(i), particles%ux(i), particles%uy(i))
    end do
    deallocate (particles%x, particles%y, particles%ux, particles%uy)
    do g = 1, 2
      inside = pack([(i, i=1, self%number)], self%stay%heading == in_gate .and. &
        self%stay%urn == g)
      call fill_gate(self%gate(g), self%stay(inside)%time + self%half1/self%stay(inside)%along, &
        inside)
    end do
  end subroutine start

  !> Sizes and lengths that follow from the table and the number of particles.
  subroutine prepare(self, table, threshold, number)
    type(reservoir_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number
    real(wp) :: interval, events
    integer :: g

    self%table = table
    self%threshold = threshold
    self%number = number
    self%half1 = 0.5_wp*table%channel1_length
    self%half2 = 0.5_wp*table%channel2_length
    self%mean_stay = pi*area_of_urn(table)/(table%channel1_width + table%channel2_width)
    self%hit_rate = arc_length(table)/(pi*area_of_urn(table))
    interval = self%mean_stay + 0.25_wp*pi*table%channel1_length
    events = min(max(2.0_wp*sqrt(real(number, wp)), real(least_events, wp)), real(most_events, wp))
    self%window = events*interval/real(number, wp)
    call new_calendar(self%calendar, number, interval)
    self%shortest = epsilon(1.0_wp)*self%calendar%page
    if (allocated(self%stay)) deallocate (self%stay)
    allocate (self%stay(number))
    do g = 1, 2
      call empty_gate(self%gate(g))
    end do
    self%draws%next_stay = block_length + 1
    self%draws%next_exit = block_length + 1
    self%now = 0.0_wp
    self%pages = 0
    self%known_hits = 0
    self%told_hits = 0
    self%fraction = 0.0_wp
  end subroutine prepare

  !> From a position and velocity. A particle in a channel that heads for its far end is dated back
  !> to where it would have entered.
  subroutine take_over(self, i, x, y, ux, uy)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: x, y, ux, uy
    integer :: region, urn
    real(wp) :: outward, depth, width, length, turned, hits
    logical :: in_channel2
    !> Slower passages, longer than any run, and those with more wall hits than an integer can
    !> count, are taken for endless.
    real(wp), parameter :: longest_passage = 1.0e15_wp, most_hits = 4.0e18_wp

    region = region_at(self%table, x, y, huge(1.0_wp))
    urn = merge(1, 2, x < 0.0_wp)
    self%stay(i)%urn = int(urn, int32)
    self%stay(i)%y = y
    self%stay(i)%across = uy
    self%stay(i)%along = abs(ux)
    if (region == urn_one .or. region == urn_two) then
      call send(self, i, urn, from_gate, 0.0_wp, 0.0_wp)
      return
    end if
    in_channel2 = region == return_one .or. region == return_two
    width = merge(self%table%channel2_width, self%table%channel1_width, in_channel2)
    depth = merge(abs(x) - self%table%urn_centre - self%table%chord2_distance, self%half1 &
      - abs(x), in_channel2)
    ! Towards the far end of the channel.
    outward = merge(-1.0_wp, 1.0_wp, in_channel2)*merge(ux, -ux, urn == 1)
    length = merge(self%table%channel2_length, self%table%channel1_length, in_channel2)
    if (.not. abs(ux)*min(longest_passage, most_hits*width) > length) then
      self%stay(i)%heading = int(parked, int32)
      self%stay(i)%along = x
    else if (outward > 0.0_wp) then
      call fold(y - uy*depth/outward, width, self%stay(i)%y, turned, hits)
      self%known_hits = self%known_hits - int(hits, int64)
      self%stay(i)%time = -depth/outward
      self%stay(i)%across = turned*uy
      self%stay(i)%heading = int(merge(to_return, in_gate, in_channel2), int32)
      if (in_channel2) then
        self%stay(i)%due = self%stay(i)%time + self%half2/outward
        call schedule(self%calendar, i, self%stay(i)%due)
      end if
    else
      call send(self, i, urn, merge(from_return, from_gate, in_channel2), -depth/outward, 0.0_wp)
    end if
  end subroutine take_over

  subroutine advance(self, duration, history)
    class(reservoir_type), intent(inout) :: self
    real(wp), intent(in) :: duration
    type(history_type), intent(inout) :: history
    real(wp) :: began, ends, whole

    if (self%now >= self%calendar%page) call turn(self)
    began = self%now
    ends = min(began + min(duration, self%window), self%calendar%page)
    call open_until(self%calendar, ends)
    call reserve_history(history, self%calendar%sorted, 0)
    call walk(self, began, ends, history)
    self%now = ends
    whole = aint(self%fraction)
    self%known_hits = self%known_hits + int(whole, int64)
    self%fraction = self%fraction - whole
    history%duration = ends - began
    history%collisions = self%known_hits - self%told_hits
    self%told_hits = self%known_hits
  end subroutine advance

  !> Turns the page: all clocks are set back by its length.
  subroutine turn(self)
    type(reservoir_type), intent(inout) :: self
    integer :: g

    call turn_page(self%calendar)
    do g = 1, 2
      call shift_gate(self%gate(g), self%calendar%page)
    end do
    self%stay%time = self%stay%time - self%calendar%page
    self%stay%entered = self%stay%entered - self%calendar%page
    self%stay%due = self%stay%due - self%calendar%page
    self%now = self%now - self%calendar%page
    self%pages = self%pages + 1
  end subroutine turn

  !> All events before `ends`, in the order of time; those that follow from them, too.
  subroutine walk(self, began, ends, history)
    type(reservoir_type), intent(inout) :: self
    real(wp), intent(in) :: began, ends
    type(history_type), intent(inout) :: history
    real(wp) :: time
    integer :: i, g
    logical :: entered(2)

    entered = .false.
    do
      time = ends
      if (self%done < self%calendar%sorted) &
        time = min(self%calendar%due_time(self%done + 1), ends)
      if (min(self%gate(1)%next_crossing, self%gate(2)%next_crossing) <= time) then
        if (min(self%gate(1)%next_crossing, self%gate(2)%next_crossing) >= ends) exit
        call cross_channel1(self, began, history)
        cycle
      end if
      if (time >= ends) exit
      self%done = self%done + 1
      i = self%calendar%particle(self%done)
      if (self%stay(i)%heading == to_return) then
        call cross_periodic_line(self, i, time, began, history)
      else
        call leave_urn(self, i, time, began, entered, history)
      end if
      ! Entries at one instant all count before the gate decides.
      if (.not. (entered(1) .or. entered(2))) cycle
      if (self%done < self%calendar%sorted) then
        if (self%calendar%due_time(self%done + 1) <= time) cycle
      end if
      do g = 1, 2
        if (entered(g) .and. self%gate(g)%count > self%threshold) &
          call reverse(self, g, time, began, history)
      end do
      entered = .false.
    end do
    call drop_done(self%calendar, self%done)
    self%done = 0
  end subroutine walk

  !> Puts an event into the calendar, whose sorted events have room for one of each particle.
  subroutine write_down(self, i, due)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: due

    if (self%calendar%sorted == self%number) then
      call drop_done(self%calendar, self%done)
      self%done = 0
    end if
    call schedule(self%calendar, i, due)
  end subroutine write_down

  !> Where a stay ends.
  subroutine leave_urn(self, i, time, began, entered, history)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: time, began
    logical, intent(inout) :: entered(2)
    type(history_type), intent(inout) :: history
    integer :: k, urn
    real(wp) :: inverse

    if (self%draws%next_exit > block_length) call draw_exits(self%draws, &
      self%table%channel1_width, self%table%channel2_width)
    k = self%draws%next_exit
    self%draws%next_exit = k + 1
    urn = self%stay(i)%urn
    self%stay(i)%time = time
    self%stay(i)%y = self%draws%y(k)
    self%stay(i)%along = self%draws%along(k)
    self%stay(i)%across = self%draws%across(k)
    inverse = self%draws%inverse(k)
    if (self%draws%opening(k) > 0.0_wp) then
      self%stay(i)%heading = int(in_gate, int32)
      call enter_gate(self%gate(urn), time + self%half1*inverse, i)
      entered(urn) = .true.
      if (history%logging) call record_event(history, time - began, event_entry, urn, i)
    else
      self%stay(i)%heading = int(to_return, int32)
      self%stay(i)%due = max(time + self%half2*inverse, time + self%shortest)
      call write_down(self, i, self%stay(i)%due)
    end if
  end subroutine leave_urn

  !> A gate reverses: all counted go back to their urn, as long as they have been in the channel.
  subroutine reverse(self, urn, time, began, history)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: urn
    real(wp), intent(in) :: time, began
    type(history_type), intent(inout) :: history
    integer :: member, i

    if (history%logging) &
      call record_event(history, time - began, event_reversal, urn, self%gate(urn)%count)
    do member = 1, self%gate(urn)%count
      i = self%gate(urn)%particle(member)
      call send(self, i, urn, from_gate, 2.0_wp*time - self%stay(i)%time, time)
    end do
    history%reversals = history%reversals + 1
    history%bounce_backs = history%bounce_backs + self%gate(urn)%count
    call empty_gate(self%gate(urn))
  end subroutine reverse

  !> The next particle of channel 1 crosses its middle line (in `shape_urn` it hits the end wall).
  subroutine cross_channel1(self, began, history)
    type(reservoir_type), intent(inout) :: self
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
    call send(self, i, beyond, from_gate, time + self%half1/self%stay(i)%along, time)
  end subroutine cross_channel1

  subroutine cross_periodic_line(self, i, time, began, history)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: time, began
    type(history_type), intent(inout) :: history
    integer :: urn

    urn = self%stay(i)%urn
    call record_crossing(history, time - began, merge(channel2_12, channel2_21, urn == 1), i)
    call send(self, i, 3 - urn, from_return, time + self%half2/self%stay(i)%along, time)
  end subroutine cross_periodic_line

  !> A particle enters an urn at `entered`, and its stay there is drawn. The end of it is later than
  !> the present event, be it by the least that the clock can tell.
  subroutine send(self, i, urn, heading, entered, time)
    type(reservoir_type), intent(inout) :: self
    integer, intent(in) :: i, urn, heading
    real(wp), intent(in) :: entered, time
    real(wp) :: due

    if (self%draws%next_stay > block_length) call draw_stays(self%draws)
    due = entered + self%mean_stay*self%draws%stay(self%draws%next_stay)
    self%draws%next_stay = self%draws%next_stay + 1
    due = max(due, time + self%shortest)
    self%known_hits = self%known_hits + passed_walls(self, i, heading, entered - self%stay(i)%time)
    self%fraction = self%fraction + self%hit_rate*(due - entered)
    self%stay(i)%entered = entered
    self%stay(i)%due = due
    self%stay(i)%heading = int(heading, int32)
    self%stay(i)%urn = int(urn, int32)
    call write_down(self, i, due)
  end subroutine send

  !> Wall hits in a channel in the time `passage` after its entry.
  pure function passed_walls(self, i, heading, passage) result(hits)
    type(reservoir_type), intent(in) :: self
    integer, intent(in) :: i, heading
    real(wp), intent(in) :: passage
    integer(int64) :: hits
    real(wp) :: width

    width = merge(self%table%channel1_width, self%table%channel2_width, heading == from_gate &
      .or. heading == in_gate)
    hits = 0
    if (passage > 0.0_wp) hits = int(abs(self%stay(i)%y + self%stay(i)%across*passage)/width &
      + 0.5_wp, int64)
  end function passed_walls

  !> A block of stays in units of their mean.
  pure subroutine draw_stays(draws)
    type(draws_type), intent(inout) :: draws
    integer :: k

    call draw_uniform(draws%random, block_length, draws%stay)
    do k = 1, block_length
      draws%stay(k) = -log(draws%stay(k))
    end do
    draws%next_stay = 1
  end subroutine draw_stays

  !> A block of ways out. One number says through which opening and at which height: where on the
  !> length of both openings, one after the other, it falls.
  pure subroutine draw_exits(draws, width1, width2)
    type(draws_type), intent(inout) :: draws
    real(wp), intent(in) :: width1, width2
    real(wp) :: place, sine
    integer :: k

    call draw_uniform(draws%random, block_length, draws%y)
    call draw_uniform(draws%random, block_length, draws%across)
    do k = 1, block_length
      place = (width1 + width2)*draws%y(k)
      draws%opening(k) = merge(1.0_wp, -1.0_wp, place < width1)
      draws%y(k) = merge(place - 0.5_wp*width1, place - width1 - 0.5_wp*width2, place < width1)
      sine = 2.0_wp*draws%across(k) - 1.0_wp
      draws%across(k) = sine
      draws%along(k) = sqrt((1.0_wp - sine)*(1.0_wp + sine))
      draws%inverse(k) = 1.0_wp/draws%along(k)
    end do
    draws%next_exit = 1
  end subroutine draw_exits

  subroutine all_particles(self, first, last, particles)
    class(reservoir_type), intent(in) :: self
    integer, intent(in) :: first, last
    type(particles_type), intent(out) :: particles
    real(wp) :: side, depth, place(4)
    integer :: i, k

    allocate (particles%x(last - first + 1), particles%y(last - first + 1))
    allocate (particles%ux(last - first + 1), particles%uy(last - first + 1))
    do i = first, last
      k = i - first + 1
      side = merge(-1.0_wp, 1.0_wp, self%stay(i)%urn == 1)
      select case (self%stay(i)%heading)
      case (parked)
        depth = 0.0_wp
        place = in_channel(self, i, 0.0_wp, 0.0_wp)
        place(1) = self%stay(i)%along
        side = 1.0_wp
      case (in_gate)
        depth = self%stay(i)%along*(self%now - self%stay(i)%time)
        place = in_channel(self, i, self%half1 - depth, -1.0_wp)
      case (to_return)
        depth = self%stay(i)%along*(self%now - self%stay(i)%time)
        place = in_channel(self, i, self%table%urn_centre + self%table%chord2_distance + depth, &
          1.0_wp)
      case default
        depth = self%stay(i)%along*(self%stay(i)%entered - self%now)
        if (self%now >= self%stay(i)%entered) then
          place = in_urn(self, i)
        else if (self%stay(i)%heading == from_gate) then
          place = in_channel(self, i, self%half1 - depth, 1.0_wp)
        else
          place = in_channel(self, i, self%table%urn_centre + self%table%chord2_distance + depth, &
            -1.0_wp)
        end if
      end select
      particles%x(k) = side*place(1)
      particles%y(k) = place(2)
      particles%ux(k) = side*place(3)
      particles%uy(k) = place(4)
    end do
  end subroutine all_particles

  !> Position and velocity in a channel at the distance `x` from the middle of the table, on the way
  !> away from it (`way` = 1) or towards it (-1).
  pure function in_channel(self, i, x, way) result(place)
    class(reservoir_type), intent(in) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: x, way
    real(wp) :: place(4)
    real(wp) :: width, turned, hits
    logical :: in_channel1

    associate (stay => self%stay(i))
      in_channel1 = stay%heading == from_gate .or. stay%heading == in_gate
      if (stay%heading == parked) in_channel1 = abs(stay%along) <= self%half1
      width = merge(self%table%channel1_width, self%table%channel2_width, in_channel1)
      call fold(stay%y + stay%across*(self%now - stay%time), width, place(2), turned, hits)
      place(1) = x
      place(3) = way*stay%along
      place(4) = turned*stay%across
    end associate
  end function in_channel

  !> A place uniform in the urn and a direction, drawn for this time and particle alone.
  pure function in_urn(self, i) result(place)
    class(reservoir_type), intent(in) :: self
    integer, intent(in) :: i
    real(wp) :: place(4)
    integer(int64) :: key, count
    real(wp) :: x, y, angle

    key = self%seed + ishft(self%pages, 20) + int(self%now/self%calendar%page*2.0_wp**61, int64)
    count = ishft(int(i, int64), 20)
    do
      x = self%table%urn_radius*(2.0_wp*hashed_uniform(key, count) - 1.0_wp)
      y = self%table%urn_radius*(2.0_wp*hashed_uniform(key, count + 1) - 1.0_wp)
      count = count + 2
      if (x**2 + y**2 >= self%table%urn_radius**2) cycle
      if (-x < self%table%chord1_distance .and. x < self%table%chord2_distance) exit
    end do
    angle = 2.0_wp*pi*hashed_uniform(key, count)
    place = [self%table%urn_centre + x, y, cos(angle), sin(angle)]
  end function in_urn

  function collisions(self) result(total)
    class(reservoir_type), intent(in) :: self
    integer(int64) :: total
    real(wp) :: ahead
    integer :: i

    total = self%known_hits
    ahead = -self%fraction
    do i = 1, self%number
      associate (stay => self%stay(i))
        select case (stay%heading)
        case (from_gate, from_return)
          ahead = ahead + self%hit_rate*(stay%due - max(stay%entered, self%now))
          if (self%now < stay%entered) total = total + passed_walls(self, i, stay%heading, &
            self%now - stay%time) - passed_walls(self, i, stay%heading, stay%entered - stay%time)
        case (parked)
          total = total + parked_hits(self, i)
        case default
          total = total + passed_walls(self, i, stay%heading, self%now - stay%time)
        end select
      end associate
    end do
    total = max(total - nint(ahead, int64), 0_int64)
  end function collisions

  !> Wall hits of a particle that flies across a channel for ever.
  pure function parked_hits(self, i) result(hits)
    class(reservoir_type), intent(in) :: self
    integer, intent(in) :: i
    integer(int64) :: hits

    hits = passed_walls(self, i, merge(from_gate, from_return, &
      abs(self%stay(i)%along) <= self%half1), self%now - self%stay(i)%time)
  end function parked_hits

  function trapped(self) result(total)
    class(reservoir_type), intent(in) :: self
    integer(int64) :: total

    total = count(self%stay%heading == parked)
  end function trapped

  function clock(self) result(time)
    class(reservoir_type), intent(in) :: self
    real(wp) :: time

    time = self%clock_start + (real(self%pages, wp)*self%calendar%page + self%now)
  end function clock

  subroutine save_state(self, state)
    class(reservoir_type), intent(in) :: self
    type(engine_state_type), intent(out) :: state
    integer :: counted(2)

    counted = self%gate%count
    associate (d => self%draws)
      state%integers = [self%pages, self%known_hits, self%told_hits, int(counted, int64), &
        int([d%next_stay, d%next_exit], int64), reshape(d%random%state, [size(d%random%state)]), &
        int(self%gate(1)%particle(:counted(1)), int64), &
        int(self%gate(2)%particle(:counted(2)), int64)]
      state%reals = [self%now, self%clock_start, self%fraction, d%stay, d%y, d%along, d%inverse, &
        d%across, d%opening, self%stay%time, self%stay%y, self%stay%along, self%stay%across, &
        self%stay%entered, self%stay%due, self%gate(1)%time(:counted(1)), &
        self%gate(2)%time(:counted(2))]
    end associate
    state%bytes = int(2*self%stay%heading + self%stay%urn, int8)
  end subroutine save_state

  subroutine restore_state(self, table, threshold, number, state)
    class(reservoir_type), intent(inout) :: self
    type(table_type), intent(in) :: table
    integer, intent(in) :: threshold, number
    type(engine_state_type), intent(in) :: state
    integer :: at, g, i, counted

    call prepare(self, table, threshold, number)
    self%pages = state%integers(1)
    self%known_hits = state%integers(2)
    self%told_hits = state%integers(3)
    self%draws%next_stay = int(state%integers(6))
    self%draws%next_exit = int(state%integers(7))
    self%draws%random%state = reshape(state%integers(8:7 + size(self%draws%random%state)), &
      shape(self%draws%random%state))
    self%now = state%reals(1)
    self%clock_start = state%reals(2)
    self%fraction = state%reals(3)
    at = 3
    call take(self%draws%stay)
    call take(self%draws%y)
    call take(self%draws%along)
    call take(self%draws%inverse)
    call take(self%draws%across)
    call take(self%draws%opening)
    self%stay%time = state%reals(at + 1:at + number)
    self%stay%y = state%reals(at + number + 1:at + 2*number)
    self%stay%along = state%reals(at + 2*number + 1:at + 3*number)
    self%stay%across = state%reals(at + 3*number + 1:at + 4*number)
    self%stay%entered = state%reals(at + 4*number + 1:at + 5*number)
    self%stay%due = state%reals(at + 5*number + 1:at + 6*number)
    at = at + 6*number
    self%stay%heading = int((state%bytes - 1)/2, int32)
    self%stay%urn = int(state%bytes, int32) - 2*self%stay%heading
    i = 7 + size(self%draws%random%state)
    do g = 1, 2
      counted = int(state%integers(3 + g))
      call fill_gate(self%gate(g), state%reals(at + 1:at + counted), &
        int(state%integers(i + 1:i + counted)))
      at = at + counted
      i = i + counted
    end do
    do i = 1, number
      if (self%stay(i)%heading /= in_gate .and. self%stay(i)%heading /= parked) &
        call schedule(self%calendar, i, self%stay(i)%due)
    end do

  contains

    subroutine take(array)
      real(wp), intent(inout) :: array(:)

      array = state%reals(at + 1:at + size(array))
      at = at + size(array)
    end subroutine take

  end subroutine restore_state

end module battery_reservoir

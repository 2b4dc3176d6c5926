!> The pending events of many particles, one each, handed out window by window in the order of time.
!>
!> A calendar of narrow buckets of equal width covers one page of time; a bucket is a list of about
!> one particle. Buckets are opened one after the other and their particles sorted into `due_time`.
!> What lies beyond the page waits until the page is turned: then the clock is set back by the
!> length of the page, a power of two, so that future times stay exact and resolve the same however
!> long the run has been.
!>
!> The flights, one a particle, belong to the caller.
module battery_calendar
  use battery_kinds, only: wp, int16, int32
  use battery_powers, only: power_above
  use battery_ordering, only: insert
  implicit none (type, external)
  private
  public :: calendar_type, idle, new_calendar, page_for, flight_type, schedule, schedule_all, &
    open_until, next_due, due_before, drop_done, turn_calendar

  !> A particle between two of its events. The calendar knows `due` and `next` only; the rest is
  !> its owner's. A record fills a line of the cache: with many particles the time is that of
  !> reading one line of memory a particle.
  type :: flight_type
    real(wp) :: due
    !> Next particle in the same bucket, 0 at the end.
    integer(int32) :: next
    !> Heading, and the urn it leaves, 1 or 2.
    integer(int16) :: heading, urn
    !> When it enters the channel (entered it, for those that are inside), at which height, with
    !> |u_x| and u_y.
    real(wp) :: time, y, along, across
    !> How long it is in the channel if nothing turns it back, and in the urn before.
    real(wp) :: through, length
  end type flight_type

  !> One without an event. Not by default, since the program must be able to say where a great array
  !> is to lie before it is written to.
  type(flight_type), parameter :: idle = flight_type(0.0_wp, 0_int32, 0_int16, 0_int16, 0.0_wp, &
    0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp)

  !> So many buckets are looked at together.
  integer, parameter :: chunk = 64

  !> The events of a page of time, from the beginning of which its times count.
  type :: calendar_type
    !> Length of a page and width of a bucket, powers of two.
    real(wp) :: page = 0.0_wp, width = 0.0_wp, per_width = 0.0_wp
    integer :: buckets = 0
    !> First particle of each bucket.
    integer(int32), allocatable :: head(:)
    !> How many buckets are open; all that is due before `opened_until` is sorted or done.
    integer :: opened = 0
    real(wp) :: opened_until = 0.0_wp
    !> Sorted events: `due_time(:sorted)` and whose they are; room for all particles.
    integer :: sorted = 0
    real(wp), allocatable :: due_time(:)
    integer, allocatable :: particle(:)
  end type calendar_type

contains

  !> An empty calendar for `number` particles that have an event every `interval` on average.
  pure subroutine new_calendar(calendar, number, interval)
    type(calendar_type), intent(out) :: calendar
    integer, intent(in) :: number
    real(wp), intent(in) :: interval
    integer :: bits

    bits = 0
    do while (2**bits < max(number, 16) .and. bits < 28)
      bits = bits + 1
    end do
    calendar%buckets = 2**(bits + 2)
    calendar%page = page_for(interval)
    calendar%width = calendar%page/real(calendar%buckets, wp)
    calendar%per_width = 1.0_wp/calendar%width
    allocate (calendar%head(calendar%buckets), source=0_int32)
    allocate (calendar%due_time(number), calendar%particle(number))
  end subroutine new_calendar

  !> The length of a page for events that come every `interval` on average.
  elemental function page_for(interval) result(page)
    real(wp), intent(in) :: interval
    real(wp) :: page

    page = power_above(4.0_wp*interval)
  end function page_for

  !> Writes down that the event of `particle` is due at `time`.
  pure subroutine schedule(calendar, flight, particle, time)
    type(calendar_type), intent(inout) :: calendar
    type(flight_type), intent(inout) :: flight(:)
    integer, intent(in) :: particle
    real(wp), intent(in) :: time
    integer :: bucket

    flight(particle)%due = time
    if (time < calendar%opened_until) then
      call insert(size(calendar%particle), calendar%due_time, calendar%particle, calendar%sorted, &
        time, particle)
    else if (time < calendar%page) then
      bucket = 1 + int(time*calendar%per_width)
      flight(particle)%next = calendar%head(bucket)
      calendar%head(bucket) = int(particle, int32)
    end if
  end subroutine schedule

  !> Writes down many events at once: of `particle(:count)` at `time(:count)`; one whose time is
  !> huge never comes.
  pure subroutine schedule_all(calendar, flight, count, particle, time)
    type(calendar_type), intent(inout) :: calendar
    type(flight_type), intent(inout) :: flight(:)
    !> How many.
    integer, intent(in) :: count
    !> Whose, each at most once.
    integer, intent(in) :: particle(count)
    !> When each is due, on the clock of the page.
    real(wp), intent(in) :: time(count)
    integer :: k
    logical :: some_at_once

    call fill_buckets(size(calendar%particle), calendar%buckets, count, particle, time, &
      calendar%per_width, calendar%opened_until, calendar%page, calendar%head, flight, some_at_once)
    if (.not. some_at_once) return
    do k = 1, count
      if (time(k) < calendar%opened_until) call schedule(calendar, flight, particle(k), time(k))
    end do
  end subroutine schedule_all

  !> The part of it that is not due before `opened_until`; tells whether there are others.
  pure subroutine fill_buckets(number, buckets, count, particle, time, per_width, opened_until, &
    page, head, flight, some_at_once)
    integer, intent(in) :: number, buckets, count, particle(count)
    real(wp), intent(in) :: time(count), per_width, opened_until, page
    integer(int32), intent(inout) :: head(buckets)
    type(flight_type), intent(inout) :: flight(number)
    logical, intent(out) :: some_at_once
    integer :: k, i, bucket

    some_at_once = .false.
    do k = 1, count
      i = particle(k)
      flight(i)%due = time(k)
      if (time(k) >= page) cycle
      if (time(k) < opened_until) then
        some_at_once = .true.
        cycle
      end if
      bucket = 1 + int(time(k)*per_width)
      flight(i)%next = head(bucket)
      head(bucket) = int(i, int32)
    end do
  end subroutine fill_buckets

  !> Opens buckets until all that is due before `time` is sorted.
  pure subroutine open_until(calendar, flight, time)
    type(calendar_type), intent(inout) :: calendar
    type(flight_type), intent(in) :: flight(:)
    real(wp), intent(in) :: time
    integer :: target, first, last

    if (calendar%opened_until >= time .or. calendar%opened == calendar%buckets) return
    target = calendar%buckets
    if (time < calendar%page) target = min(target, ceiling(time*calendar%per_width))
    do first = calendar%opened + 1, target, chunk
      last = min(first + chunk - 1, target)
      call open_buckets(size(calendar%particle), last - first + 1, calendar%head(first:last), &
        flight, calendar%sorted, calendar%due_time, calendar%particle)
    end do
    calendar%opened = target
    calendar%opened_until = real(target, wp)*calendar%width
  end subroutine open_until

  !> Empties some buckets, at most `chunk`, into the sorted events. All that was sorted before is
  !> due earlier and a bucket holds about one particle, so few have to be put in their place. The
  !> loops over `first` and `second` particles of the buckets have no branches, so that many flights
  !> are on their way from memory at a time.
  pure subroutine open_buckets(number, buckets, head, flight, sorted, due_time, particle)
    integer, intent(in) :: number, buckets
    integer(int32), intent(inout) :: head(buckets)
    type(flight_type), intent(in) :: flight(:)
    integer, intent(inout) :: sorted
    real(wp), intent(inout) :: due_time(number)
    integer, intent(inout) :: particle(number)
    integer :: first(chunk + 1), following(chunk + 1), second(chunk + 1), third(chunk)
    real(wp) :: due(chunk + 1), second_due(chunk)
    integer :: k, kept, seconds, i, some, at

    kept = 0
    seconds = 0
    do k = 1, buckets
      i = head(k)
      head(k) = 0
      ! An empty bucket writes what the next one overwrites.
      some = max(i, 1)
      first(kept + 1) = i
      due(kept + 1) = flight(some)%due
      following(kept + 1) = flight(some)%next
      second(seconds + 1) = following(kept + 1)
      seconds = seconds + merge(1, 0, i > 0 .and. following(kept + 1) > 0)
      kept = kept + merge(1, 0, i > 0)
    end do
    do k = 1, seconds
      second_due(k) = flight(second(k))%due
      third(k) = flight(second(k))%next
    end do
    at = sorted
    seconds = 0
    do k = 1, kept
      at = at + 1
      due_time(at) = due(k)
      particle(at) = first(k)
      if (following(k) == 0) cycle
      seconds = seconds + 1
      call insert(number, due_time, particle, at, second_due(seconds), second(seconds))
      i = third(seconds)
      do while (i > 0)
        call insert(number, due_time, particle, at, flight(i)%due, i)
        i = flight(i)%next
      end do
    end do
    sorted = at
  end subroutine open_buckets

  !> When the next event is due; opens buckets as needed; not beyond `horizon`, nor beyond the page.
  pure subroutine next_due(calendar, flight, horizon, time)
    type(calendar_type), intent(inout) :: calendar
    type(flight_type), intent(in) :: flight(:)
    real(wp), intent(in) :: horizon
    !> On the clock of the page; `horizon` or the end of the page if nothing is due before.
    real(wp), intent(out) :: time
    integer :: bucket

    if (calendar%sorted == 0 .and. calendar%opened_until < horizon) then
      do bucket = calendar%opened + 1, calendar%buckets
        if (calendar%head(bucket) > 0) exit
      end do
      call open_until(calendar, flight, min(horizon, real(bucket, wp)*calendar%width))
    end if
    time = min(horizon, calendar%page)
    if (calendar%sorted > 0) time = min(time, calendar%due_time(1))
  end subroutine next_due

  !> How many of the sorted events are due before `instant`.
  pure function due_before(sorted, due_time, instant) result(due)
    integer, intent(in) :: sorted
    real(wp), intent(in) :: due_time(sorted), instant
    integer :: due

    due = sorted
    do while (due > 0)
      if (due_time(due) < instant) exit
      due = due - 1
    end do
  end function due_before

  !> The first `done` of the sorted events are over.
  pure subroutine drop_done(calendar, done)
    type(calendar_type), intent(inout) :: calendar
    integer, intent(in) :: done
    integer :: k

    do k = 1, calendar%sorted - done
      calendar%due_time(k) = calendar%due_time(k + done)
      calendar%particle(k) = calendar%particle(k + done)
    end do
    calendar%sorted = calendar%sorted - done
  end subroutine drop_done

  !> The page is done: sets all times back by its length and writes down what is due on the next.
  !> What is over, or waits for no event, is due before the new page.
  pure subroutine turn_calendar(calendar, flight)
    type(calendar_type), intent(inout) :: calendar
    type(flight_type), intent(inout) :: flight(:)
    integer :: i

    calendar%due_time(:calendar%sorted) = calendar%due_time(:calendar%sorted) - calendar%page
    calendar%opened = 0
    calendar%opened_until = 0.0_wp
    do i = 1, size(calendar%particle)
      flight(i)%due = flight(i)%due - calendar%page
      if (flight(i)%due >= 0.0_wp) call schedule(calendar, flight, i, flight(i)%due)
    end do
  end subroutine turn_calendar

end module battery_calendar

!> The pending events of many particles, one each, handed out window by window in the order of time.
!>
!> A calendar of narrow buckets of equal width covers one page of time; a bucket is a list of about
!> one particle. Buckets are opened one after the other and their particles sorted into `due_time`.
!> What lies beyond the page waits in one list until the page is turned: then the clock is set back
!> by the length of the page, a power of two, so that future times stay exact and resolve the same
!> however long the run has been.
module battery_calendar
  use battery_kinds, only: wp, int32
  implicit none (type, external)
  private
  public :: calendar_type, new_calendar, schedule, open_until, next_due, turn_page

  type :: entry_type
    real(wp) :: due = 0.0_wp
    !> Next particle in the same bucket, 0 at the end; -1 for a particle that is in no bucket.
    integer(int32) :: next = -1
  end type entry_type

  type :: calendar_type
    !> Length of a page and width of a bucket, powers of two.
    real(wp) :: page = 0.0_wp, width = 0.0_wp, per_width = 0.0_wp
    integer :: buckets = 0
    !> First particle of each bucket; the last entry is the list of those beyond the page.
    integer(int32), allocatable :: head(:)
    type(entry_type), allocatable :: entry(:)
    !> How many buckets are open; all that is due before `opened_until` is sorted or done.
    integer :: opened = 0
    real(wp) :: opened_until = 0.0_wp
    !> Sorted events: `due_time(first:last)` and whose they are.
    integer :: first = 1, last = 0
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
    do while (2**bits < max(number, 16) .and. bits < 29)
      bits = bits + 1
    end do
    calendar%buckets = 2**(bits + 1)
    calendar%page = 2.0_wp**ceiling(log(2.0_wp*interval)/log(2.0_wp))
    calendar%width = calendar%page/real(calendar%buckets, wp)
    calendar%per_width = 1.0_wp/calendar%width
    allocate (calendar%head(calendar%buckets + 1), source=0_int32)
    allocate (calendar%entry(number))
    allocate (calendar%due_time(256), source=0.0_wp)
    allocate (calendar%particle(256), source=0)
  end subroutine new_calendar

  !> Writes down that the event of `particle` is due at `time`.
  pure subroutine schedule(calendar, particle, time)
    type(calendar_type), intent(inout) :: calendar
    integer, intent(in) :: particle
    real(wp), intent(in) :: time
    integer :: bucket

    calendar%entry(particle)%due = time
    if (time < calendar%opened_until) then
      calendar%entry(particle)%next = -1
      call sort_in(calendar, particle, time)
      return
    end if
    bucket = calendar%buckets + 1
    if (time < calendar%page) bucket = 1 + int(time*calendar%per_width)
    calendar%entry(particle)%next = calendar%head(bucket)
    calendar%head(bucket) = int(particle, int32)
  end subroutine schedule

  !> Opens buckets until all that is due before `time` is sorted.
  pure subroutine open_until(calendar, time)
    type(calendar_type), intent(inout) :: calendar
    real(wp), intent(in) :: time
    integer :: bucket, particle
    integer(int32) :: following

    do while (calendar%opened_until < time .and. calendar%opened < calendar%buckets)
      bucket = calendar%opened + 1
      particle = calendar%head(bucket)
      do while (particle > 0)
        following = calendar%entry(particle)%next
        calendar%entry(particle)%next = -1
        call sort_in(calendar, particle, calendar%entry(particle)%due)
        particle = following
      end do
      calendar%head(bucket) = 0
      calendar%opened = bucket
      calendar%opened_until = real(bucket, wp)*calendar%width
    end do
  end subroutine open_until

  !> When the next event is due; opens buckets as needed; not beyond `horizon`, nor beyond the page.
  pure subroutine next_due(calendar, horizon, time)
    type(calendar_type), intent(inout) :: calendar
    real(wp), intent(in) :: horizon
    real(wp), intent(out) :: time

    do while (calendar%first > calendar%last .and. calendar%opened < calendar%buckets &
        .and. calendar%opened_until < horizon)
      call open_until(calendar, calendar%opened_until + calendar%width)
    end do
    time = min(horizon, calendar%page)
    if (calendar%first <= calendar%last) time = min(time, calendar%due_time(calendar%first))
  end subroutine next_due

  !> Puts an event in its place among the sorted ones: by time, then by number.
  pure subroutine sort_in(calendar, particle, time)
    type(calendar_type), intent(inout) :: calendar
    integer, intent(in) :: particle
    real(wp), intent(in) :: time
    integer :: at

    if (calendar%first > calendar%last) then
      calendar%first = 1
      calendar%last = 0
    end if
    if (calendar%last == size(calendar%due_time)) call make_room(calendar)
    at = calendar%last
    do while (at >= calendar%first)
      if (calendar%due_time(at) < time) exit
      if (.not. calendar%due_time(at) > time .and. calendar%particle(at) < particle) exit
      calendar%due_time(at + 1) = calendar%due_time(at)
      calendar%particle(at + 1) = calendar%particle(at)
      at = at - 1
    end do
    calendar%due_time(at + 1) = time
    calendar%particle(at + 1) = particle
    calendar%last = calendar%last + 1
  end subroutine sort_in

  !> Moves the sorted events to the front, or doubles the room for them.
  pure subroutine make_room(calendar)
    type(calendar_type), intent(inout) :: calendar
    integer :: sorted

    sorted = calendar%last - calendar%first + 1
    if (2*sorted > size(calendar%due_time)) then
      calendar%due_time = [calendar%due_time, calendar%due_time]
      calendar%particle = [calendar%particle, calendar%particle]
    end if
    calendar%due_time(:sorted) = calendar%due_time(calendar%first:calendar%last)
    calendar%particle(:sorted) = calendar%particle(calendar%first:calendar%last)
    calendar%first = 1
    calendar%last = sorted
  end subroutine make_room

  !> The page is done: sets all times back by its length and writes down what is due on the next.
  pure subroutine turn_page(calendar)
    type(calendar_type), intent(inout) :: calendar
    integer :: particle
    integer(int32) :: following

    calendar%entry%due = calendar%entry%due - calendar%page
    calendar%due_time(calendar%first:calendar%last) = &
      calendar%due_time(calendar%first:calendar%last) - calendar%page
    calendar%opened = 0
    calendar%opened_until = 0.0_wp
    particle = calendar%head(calendar%buckets + 1)
    calendar%head(calendar%buckets + 1) = 0
    do while (particle > 0)
      following = calendar%entry(particle)%next
      call schedule(calendar, particle, calendar%entry(particle)%due)
      particle = following
    end do
  end subroutine turn_page

end module battery_calendar

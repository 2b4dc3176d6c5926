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
  public :: calendar_type, new_calendar, entry_type, schedule, schedule_all, &
    open_until, next_due, drop_done, turn_page

  type :: entry_type
    real(wp) :: due = 0.0_wp
    !> Next particle in the same bucket, 0 at the end.
    integer(int32) :: next = 0
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
    calendar%page = 2.0_wp**ceiling(log(4.0_wp*interval)/log(2.0_wp))
    calendar%width = calendar%page/real(calendar%buckets, wp)
    calendar%per_width = 1.0_wp/calendar%width
    allocate (calendar%head(calendar%buckets + 1), source=0_int32)
    allocate (calendar%entry(number))
    allocate (calendar%due_time(number), calendar%particle(number))
  end subroutine new_calendar

  !> Writes down that the event of `particle` is due at `time`.
  pure subroutine schedule(calendar, particle, time)
    type(calendar_type), intent(inout) :: calendar
    integer, intent(in) :: particle
    real(wp), intent(in) :: time
    integer :: bucket

    if (time < calendar%opened_until) then
      calendar%entry(particle)%due = time
      call insert(size(calendar%entry), calendar%due_time, calendar%particle, calendar%sorted, &
        time, particle)
    else
      bucket = calendar%buckets + 1
      if (time < calendar%page) bucket = 1 + int(time*calendar%per_width)
      call push(size(calendar%entry), calendar%buckets, calendar%head, calendar%entry, particle, &
        time, bucket)
    end if
  end subroutine schedule

  !> Puts a particle into a bucket.
  pure subroutine push(number, buckets, head, entry, particle, time, bucket)
    integer, intent(in) :: number, buckets, particle, bucket
    integer(int32), intent(inout) :: head(buckets + 1)
    type(entry_type), intent(inout) :: entry(number)
    real(wp), intent(in) :: time

    entry(particle)%due = time
    entry(particle)%next = head(bucket)
    head(bucket) = int(particle, int32)
  end subroutine push

  !> Writes down many events at once: of `particle(:count)` at `time(:count)`; those whose time is
  !> huge never come.
  pure subroutine schedule_all(calendar, count, particle, time)
    type(calendar_type), intent(inout) :: calendar
    integer, intent(in) :: count
    integer, intent(in) :: particle(count)
    real(wp), intent(in) :: time(count)
    integer :: k

    do k = 1, count
      if (time(k) < calendar%opened_until .or. time(k) >= calendar%page) then
        if (time(k) < huge(time)) call schedule(calendar, particle(k), time(k))
      else
        call push(size(calendar%entry), calendar%buckets, calendar%head, calendar%entry, &
          particle(k), time(k), 1 + int(time(k)*calendar%per_width))
      end if
    end do
  end subroutine schedule_all

  !> Opens buckets until all that is due before `time` is sorted.
  pure subroutine open_until(calendar, time)
    type(calendar_type), intent(inout) :: calendar
    real(wp), intent(in) :: time
    integer :: target

    if (calendar%opened_until >= time .or. calendar%opened == calendar%buckets) return
    target = calendar%buckets
    if (time < calendar%page) target = min(target, ceiling(time*calendar%per_width))
    call open_buckets(size(calendar%entry), calendar%buckets, calendar%opened + 1, target, &
      calendar%head, calendar%entry, calendar%sorted, calendar%due_time, calendar%particle)
    calendar%opened = target
    calendar%opened_until = real(target, wp)*calendar%width
  end subroutine open_until

  !> Empties the buckets `first` ... `last` into the sorted events. A bucket holds about one
  !> particle and all that was sorted before is due earlier, so insertion is the fastest sort there
  !> is.
  pure subroutine open_buckets(number, buckets, first, last, head, entry, sorted, due_time, &
    particle)
    integer, intent(in) :: number, buckets, first, last
    integer(int32), intent(inout) :: head(buckets + 1)
    type(entry_type), intent(inout) :: entry(number)
    integer, intent(inout) :: sorted
    real(wp), intent(inout) :: due_time(number)
    integer, intent(inout) :: particle(number)
    integer :: bucket, i, at
    real(wp) :: time

    at = sorted
    do bucket = first, last
      i = head(bucket)
      head(bucket) = 0
      do while (i > 0)
        time = entry(i)%due
        call insert(number, due_time, particle, at, time, i)
        i = entry(i)%next
      end do
    end do
    sorted = at
  end subroutine open_buckets

  !> Puts an event in its place among `sorted` ones: by time, then by number.
  pure subroutine insert(number, due_time, particle, sorted, time, i)
    integer, intent(in) :: number, i
    real(wp), intent(inout) :: due_time(number)
    integer, intent(inout) :: particle(number)
    integer, intent(inout) :: sorted
    real(wp), intent(in) :: time
    integer :: at

    at = sorted
    do while (at > 0)
      if (due_time(at) < time) exit
      if (.not. due_time(at) > time .and. particle(at) < i) exit
      due_time(at + 1) = due_time(at)
      particle(at + 1) = particle(at)
      at = at - 1
    end do
    due_time(at + 1) = time
    particle(at + 1) = i
    sorted = sorted + 1
  end subroutine insert

  !> When the next event is due; opens buckets as needed; not beyond `horizon`, nor beyond the page.
  pure subroutine next_due(calendar, horizon, time)
    type(calendar_type), intent(inout) :: calendar
    real(wp), intent(in) :: horizon
    real(wp), intent(out) :: time

    do while (calendar%sorted == 0 .and. calendar%opened < calendar%buckets &
        .and. calendar%opened_until < horizon)
      call open_until(calendar, calendar%opened_until + calendar%width)
    end do
    time = min(horizon, calendar%page)
    if (calendar%sorted > 0) time = min(time, calendar%due_time(1))
  end subroutine next_due

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
  pure subroutine turn_page(calendar)
    type(calendar_type), intent(inout) :: calendar
    integer :: particle
    integer(int32) :: following

    calendar%entry%due = calendar%entry%due - calendar%page
    calendar%due_time(:calendar%sorted) = calendar%due_time(:calendar%sorted) - calendar%page
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

!> A calendar queue: the pending events of many particles, one for each, in the order of time.
!>
!> Buckets of equal width cover one epoch; a bucket lists the particles whose events fall into it,
!> in no order. Buckets are opened one after the other and their events sorted into `due_time`.
!> Events beyond the epoch wait until the clock is rebased: all times are then reduced by the length
!> of the epoch, a power of two, so that times stay exact and their resolution does not depend on
!> the length of the run.
!>
!> The flights, one per particle, belong to the engine; the calendar uses `due` of them only. It is
!> not among the queues of `events`, which know no flight: gfortran 12 copies the array `flight%due`
!> to pass it.
module battery_calendar
  use battery_kinds, only: wp, int32, int64
  use battery_powers, only: power_above
  use battery_flight, only: flight_type
  use battery_ordering, only: sort_by_time, insert_sorted
  implicit none (type, external)
  private
  public :: calendar_type, new_calendar, epoch_for, schedule_event, schedule_events, &
    open_buckets_until, next_due_time, count_due_before, drop_done_events, rebase_calendar

  !> Events of a block, a power of two. A block is a cache line: with few buckets, all lines being
  !> written to stay in the cache for any number of particles.
  integer(int32), parameter :: block_size = 16

  !> With up to 2**crowd particles a bucket holds about ten events; with more particles, more.
  integer, parameter :: crowd = 14

  !> The events of an epoch; times count from its beginning.
  type :: calendar_type
    !> Length of an epoch and width of a bucket, powers of two.
    real(wp) :: epoch = 0.0_wp, width = 0.0_wp, per_width = 0.0_wp
    integer :: buckets = 0
    !> Particles of each bucket, in blocks: block b has the places from b*block_size on.
    integer(int32), allocatable :: bucket_particle(:)
    !> Place for the next event of each bucket, or 0 if it is empty. At the first place of a block
    !> the previous block is full.
    integer(int32), allocatable :: next_place(:)
    !> Previous block of the same bucket, or -1; stack of free blocks.
    integer(int32), allocatable :: block_before(:)
    integer :: free_blocks = 0
    integer(int32), allocatable :: free_block(:)
    !> Number of open buckets; all events before `opened_until` are sorted or done.
    integer :: opened = 0
    real(wp) :: opened_until = 0.0_wp
    !> Sorted events: `due_time(:sorted)` and their particles; large enough for all particles.
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
    integer :: bits, blocks, k

    bits = 4
    do while (2**bits < number .and. bits < 30)
      bits = bits + 1
    end do
    calendar%buckets = 2**(min(bits, crowd) + max(bits - crowd, 0)/2 - 1)
    calendar%epoch = epoch_for(interval)
    calendar%width = calendar%epoch/real(calendar%buckets, wp)
    calendar%per_width = 1.0_wp/calendar%width
    allocate (calendar%next_place(calendar%buckets), source=0_int32)
    ! Each bucket that is not empty has at most one block that is not full.
    blocks = number/block_size + min(number, calendar%buckets)
    allocate (calendar%bucket_particle(0:block_size*blocks - 1), calendar%block_before(0:blocks &
      - 1))
    calendar%free_blocks = blocks
    calendar%free_block = [(int(blocks - k, int32), k=1, blocks)]
    allocate (calendar%due_time(number), calendar%particle(number))
  end subroutine new_calendar

  !> Length of an epoch for events that come every `interval` on average.
  elemental function epoch_for(interval) result(epoch)
    real(wp), intent(in) :: interval
    real(wp) :: epoch

    epoch = power_above(4.0_wp*interval)
  end function epoch_for

  !> Schedules the event of `particle` at `time`: sets `due` of its flight, and puts it into the
  !> calendar.
  pure subroutine schedule_event(calendar, flight, particle, time)
    type(calendar_type), intent(inout) :: calendar
    type(flight_type), intent(inout) :: flight(:)
    integer, intent(in) :: particle
    real(wp), intent(in) :: time

    flight(particle)%due = time
    call schedule_events(calendar, 1, [particle], [time])
  end subroutine schedule_event

  !> Schedules the events of `particle(:count)` at `time(:count)`, which must be `due` of their
  !> flights; an event whose time is huge never comes.
  pure subroutine schedule_events(calendar, count, particle, time)
    type(calendar_type), intent(inout) :: calendar
    !> Number of events.
    integer, intent(in) :: count
    !> Particle of each event; no particle twice.
    integer, intent(in) :: particle(count)
    !> Time of each event, on the clock of the epoch.
    real(wp), intent(in) :: time(count)
    integer :: k
    logical :: some_at_once

    call fill_buckets(count, particle, time, calendar%per_width, calendar%opened_until, &
      calendar%epoch, calendar%next_place, calendar%bucket_particle, calendar%block_before, &
      calendar%free_blocks, calendar%free_block, some_at_once)
    if (.not. some_at_once) return
    do k = 1, count
      if (time(k) < calendar%opened_until) call insert_sorted(size(calendar%particle), &
        calendar%due_time, calendar%particle, calendar%sorted, time(k), particle(k))
    end do
  end subroutine schedule_events

  !> Puts events that are not due before `opened_until` into buckets; `some_at_once`: whether there
  !> are events due before.
  pure subroutine fill_buckets(count, particle, time, per_width, opened_until, epoch, &
    next_place, bucket_particle, block_before, free_blocks, free_block, some_at_once)
    integer, intent(in) :: count, particle(count)
    real(wp), intent(in) :: time(count), per_width, opened_until, epoch
    integer(int32), intent(inout), contiguous :: next_place(:), bucket_particle(0:), &
      block_before(0:)
    integer, intent(inout) :: free_blocks
    integer(int32), intent(in), contiguous :: free_block(:)
    logical, intent(out) :: some_at_once
    integer :: k, bucket
    integer(int32) :: at, before

    some_at_once = .false.
    do k = 1, count
      if (time(k) >= epoch) cycle
      if (time(k) < opened_until) then
        some_at_once = .true.
        cycle
      end if
      bucket = 1 + int(time(k)*per_width)
      at = next_place(bucket)
      if (modulo(at, block_size) == 0) then
        before = at/block_size - 1
        at = free_block(free_blocks)
        free_blocks = free_blocks - 1
        block_before(at) = before
        at = block_size*at
      end if
      bucket_particle(at) = int(particle(k), int32)
      next_place(bucket) = at + 1
    end do
  end subroutine fill_buckets

  !> Opens buckets until all events before `time` are sorted.
  pure subroutine open_buckets_until(calendar, flight, time)
    type(calendar_type), intent(inout) :: calendar
    type(flight_type), intent(in) :: flight(:)
    real(wp), intent(in) :: time
    integer :: target

    if (calendar%opened_until >= time .or. calendar%opened == calendar%buckets) return
    target = calendar%buckets
    if (time < calendar%epoch) target = min(target, ceiling(time*calendar%per_width))
    call open_buckets(size(flight), flight, target - calendar%opened, &
      calendar%next_place(calendar%opened + 1:target), calendar%bucket_particle, &
      calendar%block_before, calendar%free_blocks, calendar%free_block, calendar%sorted, &
      calendar%due_time, calendar%particle)
    calendar%opened = target
    calendar%opened_until = real(target, wp)*calendar%width
  end subroutine open_buckets_until

  !> Moves the events of the next buckets to the sorted events, all of which are earlier.
  pure subroutine open_buckets(number, flight, buckets, next_place, bucket_particle, block_before, &
    free_blocks, free_block, sorted, due_time, particle)
    integer, intent(in) :: number, buckets
    type(flight_type), intent(in) :: flight(number)
    integer(int32), intent(inout) :: next_place(buckets)
    integer(int32), intent(in), contiguous :: bucket_particle(0:), block_before(0:)
    integer, intent(inout) :: free_blocks
    integer(int32), intent(inout), contiguous :: free_block(:)
    integer, intent(inout) :: sorted
    real(wp), intent(inout), contiguous :: due_time(:)
    integer, intent(inout), contiguous :: particle(:)
    integer(int32) :: block
    integer :: bucket, n, events, k, i

    do bucket = 1, buckets
      if (next_place(bucket) == 0) cycle
      n = sorted
      block = (next_place(bucket) - 1)/block_size
      events = next_place(bucket) - block_size*block
      next_place(bucket) = 0
      do while (block >= 0)
        do k = 1, events
          i = bucket_particle(block_size*block + k - 1)
          particle(n + k) = i
          due_time(n + k) = flight(i)%due
        end do
        n = n + events
        events = block_size
        free_blocks = free_blocks + 1
        free_block(free_blocks) = block
        block = block_before(block)
      end do
      if (n > sorted + 1) call sort_by_time(n - sorted, due_time(sorted + 1:n), &
        particle(sorted + 1:n))
      sorted = n
    end do
  end subroutine open_buckets

  !> Time of the next event; opens buckets as needed; not beyond `horizon`, nor beyond the epoch.
  pure subroutine next_due_time(calendar, flight, horizon, time)
    type(calendar_type), intent(inout) :: calendar
    type(flight_type), intent(in) :: flight(:)
    real(wp), intent(in) :: horizon
    !> On the clock of the epoch; `horizon` or the end of the epoch if no event is due before.
    real(wp), intent(out) :: time
    integer :: bucket

    if (calendar%sorted == 0 .and. calendar%opened_until < horizon) then
      do bucket = calendar%opened + 1, calendar%buckets
        if (calendar%next_place(bucket) > 0) exit
      end do
      call open_buckets_until(calendar, flight, min(horizon, real(bucket, wp)*calendar%width))
    end if
    time = min(horizon, calendar%epoch)
    if (calendar%sorted > 0) time = min(time, calendar%due_time(1))
  end subroutine next_due_time

  !> Number of sorted events that are due before `instant`.
  pure function count_due_before(sorted, due_time, instant) result(due)
    !> Number of sorted events.
    integer, intent(in) :: sorted
    !> Time of each sorted event, ascending; and a time on the same clock.
    real(wp), intent(in) :: due_time(sorted), instant
    integer :: due

    due = int(count(due_time < instant, kind=int64))
  end function count_due_before

  !> Removes the first `done` of the sorted events.
  pure subroutine drop_done_events(calendar, done)
    type(calendar_type), intent(inout) :: calendar
    integer, intent(in) :: done
    integer :: k

    do k = 1, calendar%sorted - done
      calendar%due_time(k) = calendar%due_time(k + done)
      calendar%particle(k) = calendar%particle(k + done)
    end do
    calendar%sorted = calendar%sorted - done
  end subroutine drop_done_events

  !> Starts a new epoch: reduces all times by the length of an epoch, and schedules the events due
  !> in the new one. `due` of a particle without an event lies before the new epoch.
  pure subroutine rebase_calendar(calendar, flight)
    type(calendar_type), intent(inout) :: calendar
    type(flight_type), intent(inout) :: flight(:)
    integer :: i

    calendar%due_time(:calendar%sorted) = calendar%due_time(:calendar%sorted) - calendar%epoch
    calendar%opened = 0
    calendar%opened_until = 0.0_wp
    do i = 1, size(flight)
      flight(i)%due = flight(i)%due - calendar%epoch
      if (flight(i)%due >= 0.0_wp) call schedule_event(calendar, flight, i, flight(i)%due)
    end do
  end subroutine rebase_calendar

end module battery_calendar

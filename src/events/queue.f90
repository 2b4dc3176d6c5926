!> A priority queue of particles by time.
!>
!> It is an unordered list until its first is asked for, since many queues are emptied before that:
!> until then adding to it costs one store. From then on, until it is empty again, it is a binary
!> heap, and adding costs O(1) on average. At one time the lower number comes first.
module battery_queue
  use battery_kinds, only: wp
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: queue_type, empty_queue, push, push_all, pop, pop_due, remove_particle, rebase_queue, &
    serialize_queue

  !> Particles, each with a time; the arrays `time` and `who` (the particles' indices) have the size
  !> `room`.
  type :: queue_type
    !> Number of particles in it, and size of the arrays.
    integer :: count = 0, room = 0
    !> Time of the first of them; huge if the queue is empty.
    real(wp) :: next = huge(1.0_wp)
    !> Whether `time` and `who` up to `count` are a heap.
    logical :: in_order = .false.
    real(wp), allocatable :: time(:)
    integer, allocatable :: who(:)
  end type queue_type

  !> A list no longer than this is removed as a whole: selecting costs more than adding the rest
  !> again.
  integer, parameter :: short_list = 256

contains

  !> Removes all particles.
  pure subroutine empty_queue(queue)
    type(queue_type), intent(inout) :: queue

    if (queue%room == 0) call grow_queue(queue)
    queue%count = 0
    queue%next = huge(1.0_wp)
    queue%in_order = .false.
  end subroutine empty_queue

  !> Adds the particle `who` at `time`. Short, so that it is inlined.
  pure subroutine push(queue, time, who)
    type(queue_type), intent(inout) :: queue
    real(wp), intent(in) :: time
    integer, intent(in) :: who

    if (queue%count == queue%room) call grow_queue(queue)
    queue%count = queue%count + 1
    queue%next = min(queue%next, time)
    queue%time(queue%count) = time
    queue%who(queue%count) = who
    if (queue%in_order) call sift_up_last(queue)
  end subroutine push

  !> Adds `count` particles `who`.
  pure subroutine push_all(queue, count, time, who)
    type(queue_type), intent(inout) :: queue
    !> Number of particles.
    integer, intent(in) :: count
    !> Time of each, in no order.
    real(wp), intent(in) :: time(count)
    integer, intent(in) :: who(count)
    integer :: is_before, k

    if (count == 0) return
    if (queue%in_order) then
      do k = 1, count
        call push(queue, time(k), who(k))
      end do
      return
    end if
    is_before = queue%count
    do while (queue%room < is_before + count)
      call grow_queue(queue)
    end do
    queue%time(is_before + 1:is_before + count) = time
    queue%who(is_before + 1:is_before + count) = who
    queue%count = is_before + count
    queue%next = min(queue%next, minval(time))
  end subroutine push_all

  !> Allocates the arrays, or doubles them.
  pure subroutine grow_queue(queue)
    type(queue_type), intent(inout) :: queue

    if (queue%room == 0) then
      queue%room = 32
      allocate (queue%time(32), queue%who(32))
    else
      queue%time = [queue%time, queue%time]
      queue%who = [queue%who, queue%who]
      queue%room = size(queue%time)
    end if
  end subroutine grow_queue

  !> Restores the heap after one was added at its end.
  pure subroutine sift_up_last(queue)
    type(queue_type), intent(inout) :: queue
    real(wp) :: time
    integer :: who, at

    at = queue%count
    time = queue%time(at)
    who = queue%who(at)
    do while (at > 1)
      if (is_before(queue%time(at/2), queue%who(at/2), time, who)) exit
      queue%time(at) = queue%time(at/2)
      queue%who(at) = queue%who(at/2)
      at = at/2
    end do
    queue%time(at) = time
    queue%who(at) = who
  end subroutine sift_up_last

  !> Removes the first particle of the queue, which is not empty.
  pure subroutine pop(queue, who)
    type(queue_type), intent(inout) :: queue
    !> Its number.
    integer, intent(out) :: who

    call make_heap(queue)
    who = queue%who(1)
    call remove_at(queue, 1)
  end subroutine pop

  !> Removes all that are due before `until`, and possibly others, in no order. The arrays are
  !> large enough for the whole queue.
  pure subroutine pop_due(queue, until, removed, time, who)
    type(queue_type), intent(inout) :: queue
    real(wp), intent(in) :: until
    !> Number removed.
    integer, intent(out) :: removed
    !> Time of each,
    real(wp), intent(inout) :: time(:)
    !> and its number.
    integer, intent(inout) :: who(:)

    removed = 0
    if (queue%count == 0) return
    if (queue%count <= short_list) then
      removed = queue%count
      time(:removed) = queue%time(:removed)
      who(:removed) = queue%who(:removed)
      call empty_queue(queue)
    else
      do while (queue%next < until)
        removed = removed + 1
        time(removed) = queue%next
        call pop(queue, who(removed))
      end do
    end if
  end subroutine pop_due

  !> Removes the particle `who`, which is in the queue and near its front.
  pure subroutine remove_particle(queue, who)
    type(queue_type), intent(inout) :: queue
    integer, intent(in) :: who
    integer :: place

    call make_heap(queue)
    place = 1
    do while (queue%who(place) /= who)
      place = place + 1
    end do
    call remove_at(queue, place)
  end subroutine remove_particle

  !> Makes the list a heap.
  pure subroutine make_heap(queue)
    type(queue_type), intent(inout) :: queue
    integer :: at

    if (queue%in_order) return
    queue%in_order = .true.
    do at = queue%count/2, 1, -1
      call sift_down(queue, at, queue%time(at), queue%who(at))
    end do
  end subroutine make_heap

  !> Replaces the particle at a place of the heap by the last one.
  pure subroutine remove_at(queue, place)
    type(queue_type), intent(inout) :: queue
    integer, intent(in) :: place
    integer :: last, at

    last = queue%count
    queue%count = last - 1
    at = place
    if (place < last) then
      ! The last may belong above the place, if that is not the first.
      do while (at > 1)
        if (is_before(queue%time(at/2), queue%who(at/2), queue%time(last), queue%who(last))) exit
        queue%time(at) = queue%time(at/2)
        queue%who(at) = queue%who(at/2)
        at = at/2
      end do
      call sift_down(queue, at, queue%time(last), queue%who(last))
    end if
    queue%in_order = queue%count > 0
    queue%next = merge(queue%time(1), huge(1.0_wp), queue%in_order)
  end subroutine remove_at

  !> Puts a particle into the heap at `place` or below.
  pure subroutine sift_down(queue, place, time, who)
    type(queue_type), intent(inout) :: queue
    integer, intent(in) :: place
    real(wp), value, intent(in) :: time
    integer, value, intent(in) :: who
    integer :: at, child

    at = place
    do
      child = 2*at
      if (child > queue%count) exit
      if (child < queue%count) then
        if (is_before(queue%time(child + 1), queue%who(child + 1), queue%time(child), &
          queue%who(child))) child = child + 1
      end if
      if (.not. is_before(queue%time(child), queue%who(child), time, who)) exit
      queue%time(at) = queue%time(child)
      queue%who(at) = queue%who(child)
      at = child
    end do
    queue%time(at) = time
    queue%who(at) = who
  end subroutine sift_down

  !> Whether one is earlier than another, or at the same time and has the lower number.
  pure function is_before(time, who, other_time, other_who)
    real(wp), intent(in) :: time, other_time
    integer, intent(in) :: who, other_who
    logical :: is_before

    is_before = time < other_time
    if (.not. is_before) is_before = .not. time > other_time .and. who < other_who
  end function is_before

  !> Subtracts `shift` from all times.
  pure subroutine rebase_queue(queue, shift)
    type(queue_type), intent(inout) :: queue
    real(wp), intent(in) :: shift

    if (queue%count == 0) return
    queue%time(:queue%count) = queue%time(:queue%count) - shift
    queue%next = minval(queue%time(:queue%count))
  end subroutine rebase_queue

  !> Serialises the queue in its present order.
  pure subroutine serialize_queue(queue, archive)
    type(queue_type), intent(inout) :: queue
    type(archive_type), intent(inout) :: archive

    call archive%serialize('count', queue%count)
    call archive%serialize('in_order', queue%in_order)
    if (archive%failed()) return
    do while (queue%room < max(queue%count, 1))
      call grow_queue(queue)
    end do
    call archive%serialize('time', queue%time(:queue%count))
    call archive%serialize('who', queue%who(:queue%count))
    queue%next = minval(queue%time(:queue%count))
  end subroutine serialize_queue

end module battery_queue

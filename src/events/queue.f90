!> A priority queue of particles by time.
!>
!> A queue is an unordered list until its first particle is removed, since many queues are emptied
!> before that: until then, adding a particle costs one store. From then on, until it is empty
!> again, it is a binary heap, and adding costs O(1) on average. At equal times the particle with
!> the lower index comes first.
module battery_queue
  use battery_kinds, only: wp
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: queue_type, empty_queue, push, push_all, pop, pop_due, remove_particle, rebase_queue, &
    serialize_queue

  !> A queue of particles: time and index of each, in arrays of the size `capacity`.
  type :: queue_type
    !> Number of particles in the queue, and size of the arrays.
    integer :: count = 0, capacity = 0
    !> Time of the first particle; huge if the queue is empty.
    real(wp) :: next = huge(1.0_wp)
    !> Whether `time` and `particle` up to `count` are a heap.
    logical :: in_order = .false.
    real(wp), allocatable :: time(:)
    integer, allocatable :: particle(:)
  end type queue_type

  !> A list no longer than this is removed as a whole: selecting the particles that are due costs
  !> more than adding the others again.
  integer, parameter :: short_list = 256

contains

  !> Removes all particles.
  pure subroutine empty_queue(queue)
    type(queue_type), intent(inout) :: queue

    if (queue%capacity == 0) call grow_queue(queue)
    queue%count = 0
    queue%next = huge(1.0_wp)
    queue%in_order = .false.
  end subroutine empty_queue

  !> Adds a particle at `time`. Short, so that it is inlined.
  pure subroutine push(queue, time, particle)
    type(queue_type), intent(inout) :: queue
    real(wp), intent(in) :: time
    !> Index of the particle.
    integer, intent(in) :: particle

    if (queue%count == queue%capacity) call grow_queue(queue)
    queue%count = queue%count + 1
    queue%next = min(queue%next, time)
    queue%time(queue%count) = time
    queue%particle(queue%count) = particle
    if (queue%in_order) call sift_up_last(queue)
  end subroutine push

  !> Adds `count` particles at once: those that a gate still counts after a window are put back.
  pure subroutine push_all(queue, count, time, particle)
    type(queue_type), intent(inout) :: queue
    !> Number of particles.
    integer, intent(in) :: count
    !> Time of each particle, in no order.
    real(wp), intent(in) :: time(count)
    !> Indices of the particles.
    integer, intent(in) :: particle(count)
    integer :: is_before, k

    if (count == 0) return
    if (queue%in_order) then
      do k = 1, count
        call push(queue, time(k), particle(k))
      end do
      return
    end if
    is_before = queue%count
    do while (queue%capacity < is_before + count)
      call grow_queue(queue)
    end do
    queue%time(is_before + 1:is_before + count) = time
    queue%particle(is_before + 1:is_before + count) = particle
    queue%count = is_before + count
    queue%next = min(queue%next, minval(time))
  end subroutine push_all

  !> Allocates the arrays, or doubles them.
  pure subroutine grow_queue(queue)
    type(queue_type), intent(inout) :: queue

    if (queue%capacity == 0) then
      queue%capacity = 32
      allocate (queue%time(32), queue%particle(32))
    else
      queue%time = [queue%time, queue%time]
      queue%particle = [queue%particle, queue%particle]
      queue%capacity = size(queue%time)
    end if
  end subroutine grow_queue

  !> Restores the heap after a particle was added at its end.
  pure subroutine sift_up_last(queue)
    type(queue_type), intent(inout) :: queue
    real(wp) :: time
    integer :: particle, at

    at = queue%count
    time = queue%time(at)
    particle = queue%particle(at)
    do while (at > 1)
      if (is_before(queue%time(at/2), queue%particle(at/2), time, particle)) exit
      queue%time(at) = queue%time(at/2)
      queue%particle(at) = queue%particle(at/2)
      at = at/2
    end do
    queue%time(at) = time
    queue%particle(at) = particle
  end subroutine sift_up_last

  !> Removes the particle with the earliest time from the queue, which is not empty.
  pure subroutine pop(queue, particle)
    type(queue_type), intent(inout) :: queue
    !> Index of the particle removed.
    integer, intent(out) :: particle

    call make_heap(queue)
    particle = queue%particle(1)
    call remove_at(queue, 1)
  end subroutine pop

  !> Removes all particles that are due before `until`, and possibly others, in no order. The arrays
  !> are large enough for the whole queue.
  pure subroutine pop_due(queue, until, removed, time, particle)
    type(queue_type), intent(inout) :: queue
    real(wp), intent(in) :: until
    !> Number of particles removed.
    integer, intent(out) :: removed
    !> Time of each particle removed.
    real(wp), intent(inout) :: time(:)
    !> Index of each particle removed.
    integer, intent(inout) :: particle(:)

    removed = 0
    if (queue%count == 0) return
    if (queue%count <= short_list) then
      removed = queue%count
      time(:removed) = queue%time(:removed)
      particle(:removed) = queue%particle(:removed)
      call empty_queue(queue)
    else
      do while (queue%next < until)
        removed = removed + 1
        time(removed) = queue%next
        call pop(queue, particle(removed))
      end do
    end if
  end subroutine pop_due

  !> Removes a particle, which is in the queue and near its front.
  pure subroutine remove_particle(queue, particle)
    type(queue_type), intent(inout) :: queue
    !> Index of the particle.
    integer, intent(in) :: particle
    integer :: place

    call make_heap(queue)
    place = 1
    do while (queue%particle(place) /= particle)
      place = place + 1
    end do
    call remove_at(queue, place)
  end subroutine remove_particle

  !> Arranges the list as a heap.
  pure subroutine make_heap(queue)
    type(queue_type), intent(inout) :: queue
    integer :: at

    if (queue%in_order) return
    queue%in_order = .true.
    do at = queue%count/2, 1, -1
      call sift_down(queue, at, queue%time(at), queue%particle(at))
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
      ! The last particle may belong above the place, if the place is not the first.
      do while (at > 1)
        if (is_before(queue%time(at/2), queue%particle(at/2), queue%time(last), &
          queue%particle(last))) exit
        queue%time(at) = queue%time(at/2)
        queue%particle(at) = queue%particle(at/2)
        at = at/2
      end do
      call sift_down(queue, at, queue%time(last), queue%particle(last))
    end if
    queue%in_order = queue%count > 0
    queue%next = merge(queue%time(1), huge(1.0_wp), queue%in_order)
  end subroutine remove_at

  !> Puts a particle into the heap at `place` or below.
  pure subroutine sift_down(queue, place, time, particle)
    type(queue_type), intent(inout) :: queue
    integer, intent(in) :: place
    real(wp), value, intent(in) :: time
    integer, value, intent(in) :: particle
    integer :: at, child

    at = place
    do
      child = 2*at
      if (child > queue%count) exit
      if (child < queue%count) then
        if (is_before(queue%time(child + 1), queue%particle(child + 1), queue%time(child), &
          queue%particle(child))) child = child + 1
      end if
      if (.not. is_before(queue%time(child), queue%particle(child), time, particle)) exit
      queue%time(at) = queue%time(child)
      queue%particle(at) = queue%particle(child)
      at = child
    end do
    queue%time(at) = time
    queue%particle(at) = particle
  end subroutine sift_down

  !> Whether a particle comes before another: it is earlier, or simultaneous with a lower index.
  pure function is_before(time, particle, other_time, other_particle)
    real(wp), intent(in) :: time, other_time
    integer, intent(in) :: particle, other_particle
    logical :: is_before

    is_before = time < other_time
    if (.not. is_before) is_before = .not. time > other_time .and. particle < other_particle
  end function is_before

  !> Subtracts `shift` from all times.
  pure subroutine rebase_queue(queue, shift)
    type(queue_type), intent(inout) :: queue
    real(wp), intent(in) :: shift

    if (queue%count == 0) return
    queue%time(:queue%count) = queue%time(:queue%count) - shift
    queue%next = minval(queue%time(:queue%count))
  end subroutine rebase_queue

  !> Saves or restores the queue in its present order.
  pure subroutine serialize_queue(queue, archive)
    type(queue_type), intent(inout) :: queue
    type(archive_type), intent(inout) :: archive

    call archive%serialize('count', queue%count)
    call archive%serialize('in_order', queue%in_order)
    if (archive%failed()) return
    do while (queue%capacity < max(queue%count, 1))
      call grow_queue(queue)
    end do
    call archive%serialize('time', queue%time(:queue%count))
    call archive%serialize('who', queue%particle(:queue%count))
    queue%next = minval(queue%time(:queue%count))
  end subroutine serialize_queue

end module battery_queue

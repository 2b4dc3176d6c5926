!> A queue: who is due when; whoever is due first comes out first.
!>
!> It is just a list until the first is asked for, since many a queue is emptied before: then
!> joining it costs no more than writing down. From then on, until it is empty again, it is a binary
!> heap, in which joining costs O(1) on average. At one time the lower number comes first.
module battery_queue
  use battery_kinds, only: wp
  use battery_archive, only: archive_type
  implicit none (type, external)
  private
  public :: queue_type, empty_queue, push, push_all, pop, pop_due, remove, rebase_queue, &
    serialize_queue

  !> Numbers, each with a time; `time` and `who` have room for `room` of them.
  type :: queue_type
    !> How many are in it, and for how many there is room.
    integer :: count = 0, room = 0
    !> When the first of them is due; huge if there is none.
    real(wp) :: next = huge(1.0_wp)
    !> Whether `time` and `who` up to `count` are a heap.
    logical :: in_order = .false.
    real(wp), allocatable :: time(:)
    integer, allocatable :: who(:)
  end type queue_type

  !> A list so short is taken out as a whole: telling who is due costs more than putting back the
  !> others.
  integer, parameter :: short_list = 256

contains

  !> All leave at once.
  pure subroutine empty_queue(queue)
    type(queue_type), intent(inout) :: queue

    if (queue%room == 0) call grow(queue)
    queue%count = 0
    queue%next = huge(1.0_wp)
    queue%in_order = .false.
  end subroutine empty_queue

  !> `who` is due at `time`. Short, so that it is compiled in where it is called.
  pure subroutine push(queue, time, who)
    type(queue_type), intent(inout) :: queue
    real(wp), intent(in) :: time
    integer, intent(in) :: who

    if (queue%count == queue%room) call grow(queue)
    queue%count = queue%count + 1
    queue%next = min(queue%next, time)
    queue%time(queue%count) = time
    queue%who(queue%count) = who
    if (queue%in_order) call sift_up_last(queue)
  end subroutine push

  !> Each of `who` is due at its time.
  pure subroutine push_all(queue, count, time, who)
    type(queue_type), intent(inout) :: queue
    !> How many.
    integer, intent(in) :: count
    !> When each is due, in no order.
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
      call grow(queue)
    end do
    queue%time(is_before + 1:is_before + count) = time
    queue%who(is_before + 1:is_before + count) = who
    queue%count = is_before + count
    queue%next = min(queue%next, minval(time))
  end subroutine push_all

  pure subroutine grow(queue)
    type(queue_type), intent(inout) :: queue

    if (queue%room == 0) then
      queue%room = 32
      allocate (queue%time(32), queue%who(32))
    else
      queue%time = [queue%time, queue%time]
      queue%who = [queue%who, queue%who]
      queue%room = size(queue%time)
    end if
  end subroutine grow

  !> The last of a heap finds its place.
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

  !> The first leaves the queue, which is not empty.
  pure subroutine pop(queue, who)
    type(queue_type), intent(inout) :: queue
    !> Who that is.
    integer, intent(out) :: who

    call make_heap(queue)
    who = queue%who(1)
    call remove_at(queue, 1)
  end subroutine pop

  !> Takes out all who are due before `until`, and others, as it likes: in no order. There is room
  !> for all that are in the queue.
  pure subroutine pop_due(queue, until, taken, time, who)
    type(queue_type), intent(inout) :: queue
    real(wp), intent(in) :: until
    !> How many were taken.
    integer, intent(out) :: taken
    !> When each is due,
    real(wp), intent(inout) :: time(:)
    !> and who it is.
    integer, intent(inout) :: who(:)

    taken = 0
    if (queue%count == 0) return
    if (queue%count <= short_list) then
      taken = queue%count
      time(:taken) = queue%time(:taken)
      who(:taken) = queue%who(:taken)
      call empty_queue(queue)
    else
      do while (queue%next < until)
        taken = taken + 1
        time(taken) = queue%next
        call pop(queue, who(taken))
      end do
    end if
  end subroutine pop_due

  !> `who`, who is in the queue and about to be due, leaves it.
  pure subroutine remove(queue, who)
    type(queue_type), intent(inout) :: queue
    integer, intent(in) :: who
    integer :: place

    call make_heap(queue)
    place = 1
    do while (queue%who(place) /= who)
      place = place + 1
    end do
    call remove_at(queue, place)
  end subroutine remove

  !> Makes a heap of a list.
  pure subroutine make_heap(queue)
    type(queue_type), intent(inout) :: queue
    integer :: at

    if (queue%in_order) return
    queue%in_order = .true.
    do at = queue%count/2, 1, -1
      call sift_down(queue, at, queue%time(at), queue%who(at))
    end do
  end subroutine make_heap

  !> Fills the place in the heap with the last.
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

  !> Puts one into the heap at `place` or below.
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

  !> Earlier, or at the same time and with the lower number.
  pure function is_before(time, who, other_time, other_who)
    real(wp), intent(in) :: time, other_time
    integer, intent(in) :: who, other_who
    logical :: is_before

    is_before = time < other_time
    if (.not. is_before) is_before = .not. time > other_time .and. who < other_who
  end function is_before

  !> The clock is set back by `shift`.
  pure subroutine rebase_queue(queue, shift)
    type(queue_type), intent(inout) :: queue
    real(wp), intent(in) :: shift

    if (queue%count == 0) return
    queue%time(:queue%count) = queue%time(:queue%count) - shift
    queue%next = minval(queue%time(:queue%count))
  end subroutine rebase_queue

  !> Through a stream, as it stands.
  pure subroutine serialize_queue(queue, archive)
    type(queue_type), intent(inout) :: queue
    type(archive_type), intent(inout) :: archive

    call archive%serialize('count', queue%count)
    call archive%serialize('in_order', queue%in_order)
    if (archive%failed()) return
    do while (queue%room < max(queue%count, 1))
      call grow(queue)
    end do
    call archive%serialize('time', queue%time(:queue%count))
    call archive%serialize('who', queue%who(:queue%count))
    queue%next = minval(queue%time(:queue%count))
  end subroutine serialize_queue

end module battery_queue

!> Puts a short list of events into the order of time, and of their numbers at one time.
!>
!> Which of two times is less cannot be guessed, so the kernel does not ask: the place of each is
!> how many are earlier, and counting has no branches.
module battery_ordering
  use battery_kinds, only: wp, int64
  implicit none (type, external)
  private
  public :: put_in_order, insert

  !> So many times are compared with each other at a time.
  integer, parameter :: block = 16
  !> Longest list that is ordered by counting.
  integer, parameter, public :: longest = 16*block
  !> Longer lists than that are dealt out by time first, to about `share` a heap.
  integer, parameter :: share = 12

contains

  !> Puts a list into order: by time, then by number.
  pure subroutine put_in_order(n, time, number)
    !> How many.
    integer, intent(in) :: n
    !> In and out, all finite.
    real(wp), intent(inout) :: time(n)
    !> Whose each is; no two at one time are the same.
    integer, intent(inout) :: number(n)
    integer :: k, sorted

    if (n < 2) return
    if (n <= longest) then
      call order_by_counting(n, time, number)
    else
      do k = 2, n
        sorted = k - 1
        call insert(n, time, number, sorted, time(k), number(k))
      end do
    end if
  end subroutine put_in_order

  !> The same for a list no longer than `longest`.
  pure subroutine order_by_counting(n, time, number)
    integer, intent(in) :: n
    real(wp), intent(inout) :: time(n)
    integer, intent(inout) :: number(n)
    real(wp) :: was(longest)
    integer :: whose(longest)
    integer(int64) :: earlier(block), total
    integer :: first, k, j, lane, sorted

    was(:n) = time
    whose(:n) = number
    do k = n + 1, block*((n + block - 1)/block)
      was(k) = huge(1.0_wp)
    end do
    total = 0
    do first = 1, n, block
      earlier = 0
      do j = 1, n
        do lane = 1, block
          earlier(lane) = earlier(lane) + merge(1_int64, 0_int64, was(j) < was(first + lane - 1))
        end do
      end do
      do k = first, min(first + block - 1, n)
        j = int(earlier(k - first + 1)) + 1
        time(j) = was(k)
        number(j) = whose(k)
        total = total + j
      end do
    end do
    if (total == (int(n, int64)*(n + 1))/2) return
    ! Some are due at one time.
    do k = 1, n
      sorted = k - 1
      call insert(n, time, number, sorted, was(k), whose(k))
    end do
  end subroutine order_by_counting

  !> Puts an event in its place among `sorted` ones: by time, then by number.
  pure subroutine insert(room, time, number, sorted, at, whose)
    integer, intent(in) :: room
    real(wp), intent(inout) :: time(room)
    integer, intent(inout) :: number(room)
    integer, intent(inout) :: sorted
    real(wp), intent(in) :: at
    integer, intent(in) :: whose
    integer :: place

    place = sorted
    do while (place > 0)
      if (time(place) < at) exit
      if (.not. time(place) > at .and. number(place) < whose) exit
      time(place + 1) = time(place)
      number(place + 1) = number(place)
      place = place - 1
    end do
    time(place + 1) = at
    number(place + 1) = whose
    sorted = sorted + 1
  end subroutine insert

end module battery_ordering

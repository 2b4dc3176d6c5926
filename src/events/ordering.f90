!> Sorts short lists of events by time, and events at the same time by number.
!>
!> Branch prediction fails on comparisons of random times, so the kernel has none: the place of an
!> event in the sorted list is the number of earlier ones, and counting has no branches.
module battery_ordering
  use battery_kinds, only: wp, int64
  implicit none (type, external)
  private
  public :: sort_by_time, insert_sorted

  !> Number of times that are compared with another time at once.
  integer, parameter :: block = 8
  !> Longest list that is sorted by counting.
  integer, parameter, public :: longest_counting_sort = 16*block
  !> Lists longer than `longest_without_bins` are first distributed to bins of about `events_a_bin`
  !> events.
  integer, parameter, public :: longest_without_bins = 32
  integer, parameter :: events_a_bin = 10

contains

  !> Sorts a list by time, then by number.
  pure subroutine sort_by_time(n, time, number)
    !> Length of the list.
    integer, intent(in) :: n
    !> Times, all finite.
    real(wp), intent(inout) :: time(n)
    !> Number of each event; no two at one time are the same.
    integer, intent(inout) :: number(n)
    real(wp) :: least, most

    if (n <= longest_without_bins) then
      call order_by_counting(n, time, number)
      return
    end if
    least = minval(time)
    most = maxval(time)
    if (most > least) then
      call sort_in_bins(n, time, number, least, (real(n/events_a_bin, wp) - 0.5_wp)/(most - least))
    else
      call insertion_sort(n, time, number)
    end if
  end subroutine sort_by_time

  !> Sorts a longer list: distributes the events to bins of equal width, and sorts each bin.
  pure subroutine sort_in_bins(n, time, number, least, per_width)
    integer, intent(in) :: n
    real(wp), intent(inout) :: time(n)
    integer, intent(inout) :: number(n)
    !> The earliest time, and the number of bins per unit of time.
    real(wp), intent(in) :: least, per_width
    real(wp), allocatable :: was(:)
    integer, allocatable :: was_number(:), bin(:), place(:)
    integer :: k, at, first, bins

    bins = n/events_a_bin
    was = time
    was_number = number
    allocate (bin(n), place(0:bins))
    place = 0
    do k = 1, n
      bin(k) = int((was(k) - least)*per_width)
      place(bin(k) + 1) = place(bin(k) + 1) + 1
    end do
    do k = 1, bins
      place(k) = place(k) + place(k - 1)
    end do
    do k = 1, n
      at = place(bin(k)) + 1
      place(bin(k)) = at
      time(at) = was(k)
      number(at) = was_number(k)
    end do
    ! Now `place` is the end of each bin.
    first = 1
    do k = 0, bins - 1
      at = place(k)
      if (at - first < longest_counting_sort) then
        call order_by_counting(at - first + 1, time(first:at), number(first:at))
      else
        call insertion_sort(at - first + 1, time(first:at), number(first:at))
      end if
      first = at + 1
    end do
  end subroutine sort_in_bins

  !> Sorts a list no longer than `longest_counting_sort`: the place of an event in the sorted list
  !> is the number of earlier events; at one time, of those with lower numbers.
  pure subroutine order_by_counting(n, time, number)
    integer, intent(in) :: n
    real(wp), intent(inout) :: time(n)
    integer, intent(inout) :: number(n)
    real(wp) :: was(longest_counting_sort)
    integer :: was_number(longest_counting_sort), place
    integer(int64) :: earlier(block), total
    integer :: first, k

    if (n < 2) return
    do k = 1, n
      was(k) = time(k)
      was_number(k) = number(k)
    end do
    do k = n + 1, min(n + block - 1, longest_counting_sort)
      was(k) = huge(1.0_wp)
    end do
    total = 0
    do first = 1, n, block
      call count_earlier(n, was, was(first), earlier)
      do k = first, min(first + block - 1, n)
        place = int(earlier(k - first + 1)) + 1
        time(place) = was(k)
        number(place) = was_number(k)
        total = total + place
      end do
    end do
    if (total == (int(n, int64)*(n + 1))/2) return
    ! Some events are due at the same time.
    time = was(:n)
    number = was_number(:n)
    call insertion_sort(n, time, number)
  end subroutine order_by_counting

  !> Counts, for each of eight times of `mine`, how many times are earlier. The fixed number lets
  !> the compiler keep the counts in registers.
  pure subroutine count_earlier(n, time, mine, earlier)
    integer, intent(in) :: n
    real(wp), intent(in) :: time(n), mine(block)
    integer(int64), intent(out) :: earlier(block)
    integer :: j, lane

    do lane = 1, block
      earlier(lane) = 0
    end do
    do j = 1, n
      ! Without unrolling, the lanes become one vector; else the outer loop is vectorised, slowly.
!GCC$ unroll 0
      do lane = 1, block
        earlier(lane) = earlier(lane) + merge(1_int64, 0_int64, time(j) < mine(lane))
      end do
    end do
  end subroutine count_earlier

  !> Insertion sort, for lists with many events at one time.
  pure subroutine insertion_sort(n, time, number)
    integer, intent(in) :: n
    real(wp), intent(inout) :: time(n)
    integer, intent(inout) :: number(n)
    real(wp) :: this_time
    integer :: k, sorted, this

    do k = 2, n
      sorted = k - 1
      this_time = time(k)
      this = number(k)
      call insert_sorted(n, time, number, sorted, this_time, this)
    end do
  end subroutine insertion_sort

  !> Inserts an event into `sorted` events, ordered by time, then by number.
  pure subroutine insert_sorted(capacity, time, number, sorted, new_time, new_number)
    !> Extent of the arrays, more than `sorted`.
    integer, intent(in) :: capacity
    !> Time of each event, ascending.
    real(wp), intent(inout) :: time(capacity)
    !> Number of each event.
    integer, intent(inout) :: number(capacity)
    integer, intent(inout) :: sorted
    !> Time of the new event.
    real(wp), intent(in) :: new_time
    !> Number of the new event, which no event at the same time has.
    integer, intent(in) :: new_number
    integer :: place

    place = sorted
    do while (place > 0)
      if (time(place) < new_time) exit
      if (.not. time(place) > new_time .and. number(place) < new_number) exit
      time(place + 1) = time(place)
      number(place + 1) = number(place)
      place = place - 1
    end do
    time(place + 1) = new_time
    number(place + 1) = new_number
    sorted = sorted + 1
  end subroutine insert_sorted

end module battery_ordering

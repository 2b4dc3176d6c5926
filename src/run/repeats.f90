!> Repeated values in a list.
module battery_repeats
  use, intrinsic :: iso_c_binding, only: c_size_t
  use battery_kinds, only: wp, dp
  use battery_gsl, only: sort_order
  use battery_identity, only: twelve_digits
  implicit none (type, external)
  private
  public :: first_repeat

contains

  !> Place of the first value, or pair of values, that stands in a list before; 0 if there is none.
  integer function first_repeat(values, second) result(place)
    !> The list, or the first of the pairs.
    real(wp), intent(in) :: values(:)
    !> The other of the pairs.
    real(wp), allocatable, intent(in), optional :: second(:)
    integer :: rank(size(values))
    logical :: seen(size(values))

    rank = ranks_of(values)
    if (present(second)) then
      if (allocated(second)) rank = ranks_of(real(rank, wp)*size(values) + ranks_of(second))
    end if
    seen = .false.
    do place = 1, size(values)
      if (seen(rank(place))) return
      seen(rank(place)) = .true.
    end do
    place = 0
  end function first_repeat

  !> The place of each value among the different ones in the order of size. Numbers are equal where
  !> those of tasks are (`battery_identity`).
  function ranks_of(values) result(rank)
    real(wp), intent(in) :: values(:)
    integer :: rank(size(values))
    real(wp) :: known(size(values))
    integer(c_size_t) :: order(size(values)), k

    known = twelve_digits(values)
    call sort_order(order, real(known, dp), 1_c_size_t, size(order, kind=c_size_t))
    order = order + 1
    if (size(order) > 0) rank(order(1)) = 1
    do k = 2, size(order)
      rank(order(k)) = rank(order(k - 1)) + merge(1, 0, known(order(k)) > known(order(k - 1)))
    end do
  end function ranks_of

end module battery_repeats

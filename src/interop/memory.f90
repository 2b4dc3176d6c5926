!> Advice to the operating system on memory.
module battery_memory
  use, intrinsic :: iso_c_binding, only: c_ptr, c_int, c_size_t, c_intptr_t
  implicit none (type, external)
  private
  public :: prefer_large_pages

  integer(c_intptr_t), parameter :: page_size = 4096
  !> Linux's MADV_HUGEPAGE.
  integer(c_int), parameter :: large_pages = 14

  interface
    function c_madvise(address, length, advice) result(status) bind(c, name='madvise')
      import :: c_int, c_size_t, c_intptr_t
      implicit none (type, external)
      integer(c_intptr_t), value, intent(in) :: address
      integer(c_size_t), value, intent(in) :: length
      integer(c_int), value, intent(in) :: advice
      integer(c_int) :: status
    end function c_madvise
  end interface

contains

  !> Asks for large pages for an array that is read at random and has not been written to yet: then
  !> the processor finds its pages without a walk through tables that lie in memory themselves. Only
  !> advice: where it is not heeded nothing changes but the speed.
  subroutine prefer_large_pages(address, bytes)
    type(c_ptr), intent(in) :: address
    integer(c_size_t), intent(in) :: bytes
    integer(c_intptr_t) :: first, length
    integer(c_int) :: status

    first = transfer(address, first)
    length = int(bytes, c_intptr_t) - modulo(-first, page_size)
    first = first + modulo(-first, page_size)
    length = length - modulo(length, page_size)
    if (length > 0) status = c_madvise(first, int(length, c_size_t), large_pages)
  end subroutine prefer_large_pages

end module battery_memory

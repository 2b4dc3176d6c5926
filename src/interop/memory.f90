!> Advice to the operating system on memory.
module battery_memory
  use, intrinsic :: iso_c_binding, only: c_ptr, c_size_t
  implicit none (type, external)
  private
  public :: prefer_large_pages

  interface
    !> Asks for large pages for an array that is read at random and has not been written to yet:
    !> then the processor finds its pages without a walk through tables that lie in memory
    !> themselves. Only advice: where it is not heeded nothing changes but the speed.
    subroutine prefer_large_pages(address, bytes) bind(c, name='battery_prefer_large_pages')
      import :: c_ptr, c_size_t
      implicit none (type, external)
      !> Where the array begins.
      type(c_ptr), value, intent(in) :: address
      !> Its length in bytes.
      integer(c_size_t), value, intent(in) :: bytes
    end subroutine prefer_large_pages
  end interface

end module battery_memory

!> Alignment and page size of arrays in memory, and the address space of threads.
module battery_memory
  use, intrinsic :: iso_c_binding, only: c_ptr, c_size_t, c_int
  use battery_c_shapes, only: action
  implicit none (type, external)
  private
  public :: prefer_large_pages, bytes_to_next_line, spare_address_space

  !> Length of a cache line in bytes, on all processors that this program is likely to run on.
  integer, parameter, public :: line_bytes = 64

  interface
    !> Requests large pages for an array that is accessed at random and has not been written to yet:
    !> with fewer pages, the processor finds their addresses in its own cache instead of tables in
    !> memory. The system may ignore the request, which changes the speed only.
    subroutine prefer_large_pages(address, bytes) bind(c, name='battery_prefer_large_pages')
      import :: c_ptr, c_size_t
      implicit none (type, external)
      !> Address of the array.
      type(c_ptr), value, intent(in) :: address
      !> Length of the array in bytes.
      integer(c_size_t), value, intent(in) :: bytes
    end subroutine prefer_large_pages

    !> Offset in bytes of the first cache line that begins within an array.
    pure function bytes_to_next_line(array) result(bytes) bind(c, name='battery_bytes_to_next_line')
      import :: c_int
      implicit none (type, external)
      !> Array of any type.
      type(*), intent(in) :: array(*)
      !> Number of bytes, 0 to 63.
      integer(c_int) :: bytes
    end function bytes_to_next_line
  end interface

  !> Reduces the address space that threads reserve, if it is limited; to be called before there are
  !> threads.
  procedure(action), bind(c, name='battery_spare_address_space') :: spare_address_space

end module battery_memory

!> Type and item size of arrays of any type and rank.
module battery_values
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none (type, external)
  private
  public :: describe_array

  interface
    !> Determines whether the items of `values` are reals, or integers of 32 or 64 bits, and the
    !> bytes of one item.
    subroutine describe_array(values, is_real, is_integer, bytes) bind(c, name='battery_describe')
      import :: c_int
      implicit none (type, external)
      type(*), intent(in) :: values(..)
      integer(c_int), intent(out) :: is_real, is_integer, bytes
    end subroutine describe_array
  end interface

end module battery_values

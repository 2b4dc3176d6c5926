!> How long compressed values are.
module battery_deflate
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_int64_t
  implicit none (type, external)
  private
  public :: inflates_to

  interface
    !> Whether what lies in a file is a deflated stream of just so many bytes: 1 or 0. HDF5 believes
    !> it, and reads beyond the end of a shorter one. 1 where HDF5 has not loaded zlib.
    integer(c_int) function inflates_to(path, address, stored, size) &
        bind(c, name='battery_inflates_to')
      import :: c_char, c_int, c_int64_t
      implicit none (type, external)
      !> Path of the file, ended by a null character.
      character(kind=c_char), intent(in) :: path(*)
      !> Place of its first byte in the file, its length there, and inflated, in bytes.
      integer(c_int64_t), value, intent(in) :: address, stored, size
    end function inflates_to
  end interface

end module battery_deflate

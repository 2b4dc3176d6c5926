!> Inflated length of compressed values.
module battery_deflate
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_int64_t
  implicit none (type, external)
  private
  public :: inflates_to

  interface
    !> Whether bytes of a file are a deflated stream of exactly `size` bytes: 1 or 0. HDF5 does not
    !> check this, and reads beyond the end of a shorter one. 1 if HDF5 has not loaded zlib.
    integer(c_int) function inflates_to(path, address, stored, size) &
        bind(c, name='battery_inflates_to')
      import :: c_char, c_int, c_int64_t
      implicit none (type, external)
      !> Path of the file, ended by a null character.
      character(kind=c_char), intent(in) :: path(*)
      !> Offset of the stream in the file, its stored length, and its inflated length, in bytes.
      integer(c_int64_t), value, intent(in) :: address, stored, size
    end function inflates_to
  end interface

end module battery_deflate

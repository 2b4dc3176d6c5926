!> Interfaces of C procedures, one for each list of arguments and type of result.
!>
!> Texts passed to C end with a null character; C writes texts into `capacity` bytes. There is no
!> interface for a single number passed by value: for a procedure declared by such an abstract
!> interface, gfortran 12 passes the address of a constant or of a function's result.
module battery_c_shapes
  use, intrinsic :: iso_c_binding, only: c_char, c_int
  implicit none (type, external)
  private
  public :: action
  public :: returns_number, number_of_path, number_of_paths
  public :: number_of_text, number_of_path_and_text

  abstract interface
    !> No argument, no result.
    subroutine action() bind(c)
      implicit none (type, external)
    end subroutine action

    !> No argument; returns an integer.
    integer(c_int) function returns_number() bind(c)
      import :: c_int
      implicit none (type, external)
    end function returns_number

    !> Returns an integer for a path.
    integer(c_int) function number_of_path(path) bind(c)
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
    end function number_of_path

    !> Returns an integer for two paths.
    integer(c_int) function number_of_paths(one, other) bind(c)
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: one(*), other(*)
    end function number_of_paths

    !> Writes a text; returns its length or an error number.
    integer(c_int) function number_of_text(text, capacity) bind(c)
      import :: c_char, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: capacity
      character(kind=c_char), intent(inout) :: text(capacity)
    end function number_of_text

    !> Reads or writes the text of a path; returns an integer.
    integer(c_int) function number_of_path_and_text(path, text, capacity) bind(c)
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value, intent(in) :: capacity
      character(kind=c_char), intent(inout) :: text(capacity)
    end function number_of_path_and_text
  end interface

end module battery_c_shapes

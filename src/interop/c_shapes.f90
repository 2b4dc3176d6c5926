!> Shapes of C procedures: what takes and gives the same is declared by one of them.
!>
!> Texts that go to C end with a null sign; what C writes goes into `room` bytes.
module battery_c_shapes
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_ptr
  implicit none (type, external)
  private
  public :: action, action_on_number, action_on_address
  public :: number_known, number_of_number, number_of_address, number_of_path, number_of_paths
  public :: number_of_text, number_of_path_and_text, address_known, address_of_path

  abstract interface
    subroutine action() bind(c)
      implicit none (type, external)
    end subroutine action

    subroutine action_on_number(number) bind(c)
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: number
    end subroutine action_on_number

    subroutine action_on_address(address) bind(c)
      import :: c_ptr
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: address
    end subroutine action_on_address

    integer(c_int) function number_known() bind(c)
      import :: c_int
      implicit none (type, external)
    end function number_known

    integer(c_int) function number_of_number(number) bind(c)
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: number
    end function number_of_number

    integer(c_int) function number_of_address(address) bind(c)
      import :: c_int, c_ptr
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: address
    end function number_of_address

    integer(c_int) function number_of_path(path) bind(c)
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
    end function number_of_path

    integer(c_int) function number_of_paths(one, other) bind(c)
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: one(*), other(*)
    end function number_of_paths

    integer(c_int) function number_of_text(text, room) bind(c)
      import :: c_char, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: room
      character(kind=c_char), intent(inout) :: text(room)
    end function number_of_text

    integer(c_int) function number_of_path_and_text(path, text, room) bind(c)
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value, intent(in) :: room
      character(kind=c_char), intent(inout) :: text(room)
    end function number_of_path_and_text

    type(c_ptr) function address_known() bind(c)
      import :: c_ptr
      implicit none (type, external)
    end function address_known

    type(c_ptr) function address_of_path(path) bind(c)
      import :: c_char, c_ptr
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
    end function address_of_path
  end interface

end module battery_c_shapes

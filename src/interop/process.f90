!> This process: its number, and its end.
module battery_process
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none (type, external)
  private
  public :: leave, process_number

  interface
    subroutine c_exit(status) bind(c, name='exit')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: status
    end subroutine c_exit

    function c_getpid() result(number) bind(c, name='getpid')
      import :: c_int
      implicit none (type, external)
      integer(c_int) :: number
    end function c_getpid
  end interface

contains

  !> Ends the program, without the word `STOP` that Fortran prints.
  subroutine leave(exit_code)
    !> What the shell is told, 0 to 255.
    integer, intent(in) :: exit_code

    call c_exit(int(exit_code, c_int))
  end subroutine leave

  !> Number of this process, as the system has it.
  function process_number() result(number)
    integer :: number

    number = int(c_getpid())
  end function process_number

end module battery_process

!> This process: its number, and its end.
module battery_process
  use, intrinsic :: iso_c_binding, only: c_int
  use battery_c_shapes, only: returns_number
  implicit none (type, external)
  private
  public :: exit_process, exit_after, process_number

  interface
    !> Ends the program, without the message `STOP` of Fortran.
    subroutine exit_process(code) bind(c, name='exit')
      import :: c_int
      implicit none (type, external)
      !> Exit code, 0 to 255.
      integer(c_int), value, intent(in) :: code
    end subroutine exit_process

    !> Ends the program after a time, even if it is blocked.
    subroutine exit_after(seconds, code) bind(c, name='process_leave_after')
      import :: c_int
      implicit none (type, external)
      !> Time from now on.
      integer(c_int), value, intent(in) :: seconds
      !> Exit code, 0 to 255.
      integer(c_int), value, intent(in) :: code
    end subroutine exit_after
  end interface

  !> Process identifier of this process.
  procedure(returns_number), bind(c, name='getpid') :: process_number

end module battery_process

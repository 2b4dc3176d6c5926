!> This process: its number, and its end.
module battery_process
  use battery_c_shapes, only: action_on_number, number_known
  implicit none (type, external)
  private
  public :: leave, process_number

  !> Ends the program, without the word `STOP` that Fortran prints. Its argument is what the shell
  !> is told, 0 to 255.
  procedure(action_on_number), bind(c, name='exit') :: leave

  !> Number of this process, as the system has it.
  procedure(number_known), bind(c, name='getpid') :: process_number

end module battery_process

!> Errors as values: a procedure that can fail returns one, and only the top of the program prints.
module battery_error
  implicit none (type, external)
  private
  public :: error_type, fatal_error, exit_success, exit_failure, exit_bad_input, exit_stopped_early

  !> Exit codes of the program.
  integer, parameter :: exit_success = 0, exit_failure = 1, exit_bad_input = 2, &
    exit_stopped_early = 3

  !> An error: what is wrong, where, and what would be right. Not allocated: no error.
  type :: error_type
    !> Exit code the program should end with.
    integer :: code = exit_failure
    !> Text for the user; several problems are separated by new lines.
    character(len=:), allocatable :: message
  end type error_type

contains

  !> Sets `error`; `code` is `exit_failure` if absent.
  subroutine fatal_error(error, message, code)
    type(error_type), allocatable, intent(out) :: error
    !> What is wrong, where, and what would be right.
    character(len=*), intent(in) :: message
    integer, intent(in), optional :: code

    allocate (error)
    error%message = message
    if (present(code)) error%code = code
  end subroutine fatal_error

end module battery_error

!> Errors as values: a procedure that can fail returns one, and only the top of the program prints.
module battery_error
  implicit none (type, external)
  private
  public :: error_type, fatal_error, exit_success, exit_failure, exit_bad_input, exit_stopped_early

  !> Exit codes of the program.
  integer, parameter :: exit_success = 0, exit_failure = 1, exit_bad_input = 2, &
    exit_stopped_early = 3

  !> An error. A variable of this type that is not allocated means: no error.
  type :: error_type
    !> Exit code of the program.
    integer :: code = exit_failure
    !> Text for the user; several problems are separated by new lines.
    character(len=:), allocatable :: message
  end type error_type

contains

  !> Sets `error`; `code` is `exit_failure` if absent.
  subroutine fatal_error(error, message, code)
    type(error_type), allocatable, intent(out) :: error
    !> Problem, place, and what is allowed.
    character(len=*), intent(in) :: message
    integer, intent(in), optional :: code

    allocate (error)
    error%message = message
    if (present(code)) error%code = code
  end subroutine fatal_error

end module battery_error

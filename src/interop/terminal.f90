!> Standard output and standard error. A failed write is recorded, and makes the run fail. Control
!> characters are printed as escapes (`printable`), whatever file they come from.
module battery_terminal
  use, intrinsic :: iso_c_binding, only: c_int, c_char, c_size_t
  use battery_c_shapes, only: action, returns_number
  use battery_text, only: printable
  implicit none (type, external)
  private
  public :: guard_streams, print_line, print_text, print_error, all_was_printed, is_terminal
  public :: output_is_ready

  !> Descriptors of standard output and standard error.
  integer(c_int), parameter :: output = 1, errors = 2

  !> False after a failed write to standard output.
  logical :: printed = .true.

  !> Replaces closed standard streams by ones on which writes fail, so that no text is written to a
  !> file that gets their descriptor; to be called before any file is opened.
  procedure(action), bind(c, name='terminal_guard') :: guard_streams

  procedure(returns_number), bind(c) :: terminal_output, terminal_takes_text

  interface
    !> Writes without a buffer, so that failed writes are known; returns 0 or an error number.
    integer(c_int) function c_write(stream, text, length) bind(c, name='battery_write_all')
      import :: c_int, c_char, c_size_t
      implicit none (type, external)
      integer(c_int), value, intent(in) :: stream
      character(kind=c_char), intent(in) :: text(*)
      integer(c_size_t), value, intent(in) :: length
    end function c_write
  end interface

contains

  !> Prints a line, or several, on standard output.
  subroutine print_line(text)
    !> Text to print, without its line end.
    character(len=*), intent(in) :: text

    call print_text(printable(text)//new_line('a'))
  end subroutine print_line

  !> Prints a text on standard output without a line end.
  subroutine print_text(text)
    !> Text to print, without its line end.
    character(len=*), intent(in) :: text

    ! After a failure nothing more is written: a text with a gap could be misread.
    if (printed) printed = c_write(output, text, len(text, c_size_t)) == 0
  end subroutine print_text

  !> Prints one or several lines on standard error; a failed write is ignored.
  subroutine print_error(text)
    !> Text to print, without its line end.
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: line
    integer :: status

    line = printable(text)//new_line('a')
    status = c_write(errors, line, len(line, c_size_t))
  end subroutine print_error

  !> Whether all writes so far have succeeded.
  logical function all_was_printed()

    all_was_printed = printed
  end function all_was_printed

  !> Whether standard output goes to a terminal, also through `mpirun`.
  logical function is_terminal()

    is_terminal = terminal_output() /= 0
  end function is_terminal

  !> Whether a line can be printed on standard output without waiting.
  logical function output_is_ready()

    output_is_ready = terminal_takes_text() /= 0
  end function output_is_ready

end module battery_terminal

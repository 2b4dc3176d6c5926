!> Whole files as texts, read and written. Fortran's own `close` does not report that the last bytes
!> could not be written (gfortran 12, with `iostat` and after `flush` too).
module battery_file_text
  use, intrinsic :: iso_c_binding, only: c_int, c_int64_t, c_size_t, c_char, c_null_char
  use battery_c_shapes, only: number_of_path
  use battery_kinds, only: int64
  use battery_error, only: error_type, fatal_error, exit_stopped_early
  use battery_paths, only: is_folder, is_pipe_or_device, system_message, set_system_error
  use battery_signals, only: stop_requested
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: read_file, read_input, write_file, is_standard_output

  !> Results of `c_read_some` that are no number of bytes: end of the file, nothing to read yet.
  integer(int64), parameter :: at_end = 0, not_yet = -2

  procedure(number_of_path), bind(c, name='battery_open_input') :: c_open_input

  procedure(number_of_path), bind(c, name='battery_is_standard_output') :: c_is_standard_output

  interface
    integer(c_int) function c_write_file(path, bytes, length) bind(c, name='battery_write_file')
      import :: c_char, c_int, c_size_t
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*), bytes(*)
      integer(c_size_t), value, intent(in) :: length
    end function c_write_file

    integer(c_int) function c_close(descriptor) bind(c, name='close')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: descriptor
    end function c_close

    integer(c_int64_t) function c_size_of(descriptor) bind(c, name='battery_size_of')
      import :: c_int, c_int64_t
      implicit none (type, external)
      integer(c_int), value, intent(in) :: descriptor
    end function c_size_of

    integer(c_int64_t) function c_read_some(descriptor, bytes, capacity) &
      bind(c, name='battery_read_some')
      import :: c_char, c_int, c_int64_t
      implicit none (type, external)
      integer(c_int), value, intent(in) :: descriptor
      integer(c_int64_t), value, intent(in) :: capacity
      character(kind=c_char), intent(inout) :: bytes(capacity)
    end function c_read_some
  end interface

contains

  !> Reads a whole file as one text, with its line ends unchanged.
  subroutine read_file(path, text, error)
    !> Path of a file; a pipe or a device is an error.
    character(len=*), intent(in) :: path
    !> Bytes of the file; empty after an error.
    character(len=:), allocatable, intent(out) :: text
    type(error_type), allocatable, intent(out) :: error

    if (is_pipe_or_device(path)) then
      text = ''
      call fatal_error(error, path//': is a pipe or a device, not a file')
    else
      call read_input(path, huge(0_int64), text, error)
    end if
  end subroutine read_file

  !> Reads a whole file or pipe, up to `max_bytes` bytes.
  subroutine read_input(path, max_bytes, text, error)
    !> Path of a file or a pipe.
    character(len=*), intent(in) :: path
    integer(int64), intent(in) :: max_bytes
    !> Bytes of the file, up to the error if there is one.
    character(len=:), allocatable, intent(out) :: text
    !> The input cannot be read; code `exit_stopped_early` if a signal came while the pipe was
    !> empty.
    type(error_type), allocatable, intent(out) :: error
    integer(int64), parameter :: least_room = 4096_int64
    character(len=:), allocatable :: larger
    integer :: descriptor, status
    integer(int64) :: filled, length

    text = ''
    if (is_folder(path)) then
      call fatal_error(error, path//': is a folder, not a file')
      return
    end if
    descriptor = c_open_input(path//c_null_char)
    if (descriptor < 0) then
      call fatal_error(error, path//': cannot be read: '//system_message())
      return
    end if
    allocate (character(len=max(least_room, min(c_size_of(descriptor) + 1, max_bytes))) :: larger)
    call move_alloc(larger, text)
    filled = 0
    do
      if (filled == len(text, int64)) then
        allocate (character(len=2*filled) :: larger)
        larger(:filled) = text
        call move_alloc(larger, text)
      end if
      length = c_read_some(descriptor, text(filled + 1:), len(text, int64) - filled)
      if (length > 0) filled = filled + length
      if (length == not_yet .and. .not. stop_requested()) cycle
      if (length <= 0 .or. filled > max_bytes) exit
    end do
    if (filled > max_bytes) then
      call fatal_error(error, path//': does not end after '//to_text(max_bytes)//' bytes')
    else if (length == not_yet) then
      call fatal_error(error, path//': stopped while nothing came out of it', exit_stopped_early)
    else if (length /= at_end) then
      call fatal_error(error, path//': cannot be read: '//system_message())
    end if
    status = c_close(descriptor)
    text = text(:filled)
  end subroutine read_input

  !> Writes a text as a whole file, which is replaced; to standard output it is appended.
  subroutine write_file(path, text, error)
    !> Path of a file, a pipe or a device.
    character(len=*), intent(in) :: path
    !> Bytes of the file.
    character(len=*), intent(in) :: text
    !> Not all bytes could be written.
    type(error_type), allocatable, intent(out) :: error

    call set_system_error(c_write_file(path//c_null_char, text, len(text, c_size_t)), &
      path//': cannot be written', error)
  end subroutine write_file

  !> Whether a path names standard output, such as `/dev/stdout` or the file it is redirected to.
  logical function is_standard_output(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path

    yes = c_is_standard_output(path//c_null_char) /= 0
  end function is_standard_output

end module battery_file_text

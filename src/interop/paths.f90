!> Paths: the kind of file that they name, links, and messages of the system about them.
module battery_paths
  use, intrinsic :: iso_c_binding, only: c_int, c_size_t, c_char, c_ptr, c_null_char, c_f_pointer, &
    c_associated
  use battery_c_shapes, only: returns_number, number_of_path, number_of_paths, number_of_text, &
    number_of_path_and_text
  use battery_error, only: error_type, fatal_error, exit_bad_input
  implicit none (type, external)
  private
  public :: is_folder, is_pipe_or_device, same_file, folder_of
  public :: real_folder_of, follow_links
  public :: system_message, c_text_at, set_system_error

  !> Kinds of objects that a path names.
  integer(c_int), parameter :: a_folder = 2, something_else = 3

  procedure(number_of_path), bind(c, name='battery_kind_of') :: c_kind_of
  procedure(number_of_paths), bind(c, name='battery_same_file') :: c_same_file
  procedure(returns_number), bind(c, name='battery_longest_path') :: c_longest_path
  procedure(number_of_text), bind(c, name='battery_follow') :: c_follow
  procedure(number_of_path_and_text), bind(c, name='battery_real_folder') :: c_real_folder
  procedure(returns_number), bind(c, name='battery_errno') :: c_errno

  interface
    type(c_ptr) function c_message(number) bind(c, name='strerror')
      import :: c_int, c_ptr
      implicit none (type, external)
      integer(c_int), value, intent(in) :: number
    end function c_message

    integer(c_size_t) function c_strlen(address) bind(c, name='strlen')
      import :: c_ptr, c_size_t
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: address
    end function c_strlen
  end interface

contains

  !> Whether a path names a folder.
  logical function is_folder(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path

    yes = kind_of(path) == a_folder
  end function is_folder

  !> Whether a path names a pipe, a device or a socket.
  logical function is_pipe_or_device(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path

    yes = kind_of(path) == something_else
  end function is_pipe_or_device

  !> Kind of object that a path names: `a_folder`, `something_else`, 1: a file, or 0: none.
  integer(c_int) function kind_of(path)
    character(len=*), intent(in) :: path

    kind_of = c_kind_of(path//c_null_char)
  end function kind_of

  !> Whether two paths name the same file, or would if it were made; links followed.
  logical function same_file(one, other) result(yes)
    !> The two paths; if only one of the files is missing, they are not the same.
    character(len=*), intent(in) :: one, other

    yes = c_same_file(one//c_null_char, other//c_null_char) /= 0
  end function same_file

  !> Folder of a file: the path before its last slash, `.` if it has none.
  pure function folder_of(path) result(folder)
    !> Path of a file, which need not exist.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: folder
    integer :: slash

    slash = index(path, '/', back=.true.)
    if (slash == 0) then
      folder = '.'
    else
      folder = path(:max(slash - 1, 1))
    end if
  end function folder_of

  !> Folder of a file, with links resolved; empty if the folder does not exist.
  function real_folder_of(path) result(folder)
    !> Path of a file.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: folder
    integer :: length

    folder = repeat(' ', c_longest_path())
    length = c_real_folder(path//c_null_char, folder, c_longest_path())
    folder = folder(:length)
  end function real_folder_of

  !> Replaces a path that is a link by its final target, which need not exist.
  subroutine follow_links(path, error)
    !> Path; out: target if it is a link.
    character(len=:), allocatable, intent(inout) :: path
    !> The link cannot be followed, for instance a circle of links; code `exit_bad_input`.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: final

    if (len(path) >= c_longest_path()) return
    final = path//repeat(c_null_char, c_longest_path() - len(path))
    call set_system_error(c_follow(final, c_longest_path()), 'the path cannot be followed', error)
    if (allocated(error)) then
      error%code = exit_bad_input
    else
      path = final(:index(final, c_null_char) - 1)
    end if
  end subroutine follow_links

  !> Message of the system about the last call that failed.
  function system_message() result(message)
    character(len=:), allocatable :: message

    message = c_text_at(c_message(c_errno()))
  end function system_message

  !> Sets an error if a C function returned an error number; its message follows `what`.
  subroutine set_system_error(number, what, error)
    !> Error number of C (`errno`); 0: no error.
    integer, intent(in) :: number
    !> Text for the operation that failed, with the name of the file.
    character(len=*), intent(in) :: what
    type(error_type), allocatable, intent(out) :: error

    if (number /= 0) call fatal_error(error, what//': '//c_text_at(c_message(number)))
  end subroutine set_system_error

  !> Text of C at an address.
  function c_text_at(address) result(text)
    !> Address of bytes that end with a zero; null: the text is empty.
    type(c_ptr), intent(in) :: address
    character(len=:), allocatable :: text
    character(kind=c_char), pointer :: letters(:)

    text = ''
    if (.not. c_associated(address)) return
    call c_f_pointer(address, letters, [c_strlen(address)])
    text = transfer(letters, repeat(' ', size(letters)))
  end function c_text_at

end module battery_paths

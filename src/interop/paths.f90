!> Names of files: what they name, by whatever link, and what the system says about them.
module battery_paths
  use, intrinsic :: iso_c_binding, only: c_int, c_size_t, c_char, c_ptr, c_null_char, c_f_pointer, &
    c_associated
  use battery_c_shapes, only: returns_number, number_of_path, number_of_paths, number_of_text, &
    number_of_path_and_text, size_of_address, address_of_number
  use battery_error, only: error_type, fatal_error, exit_bad_input
  implicit none (type, external)
  private
  public :: is_file, is_folder, is_pipe_or_device, same_file, folder_of
  public :: real_folder_of, follow_links
  public :: system_message, c_text_at, set_system_error

  !> What a path names.
  integer(c_int), parameter :: a_file = 1, a_folder = 2, something_else = 3

  procedure(number_of_path), bind(c, name='battery_kind_of') :: c_kind_of
  procedure(number_of_paths), bind(c, name='battery_same_file') :: c_same_file
  procedure(returns_number), bind(c, name='battery_longest_path') :: c_longest_path
  procedure(number_of_text), bind(c, name='battery_follow') :: c_follow
  procedure(number_of_path_and_text), bind(c, name='battery_real_folder') :: c_real_folder
  procedure(returns_number), bind(c, name='battery_errno') :: c_errno
  procedure(address_of_number), bind(c, name='battery_message') :: c_message
  procedure(size_of_address), bind(c, name='strlen') :: c_strlen

contains

  !> Whether there is a file of that name, and no folder, pipe or device.
  logical function is_file(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path

    yes = kind_of(path) == a_file
  end function is_file

  !> Whether there is a folder of that name.
  logical function is_folder(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path

    yes = kind_of(path) == a_folder
  end function is_folder

  !> Whether there is something else of that name: a pipe, a device, a socket.
  logical function is_pipe_or_device(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path

    yes = kind_of(path) == something_else
  end function is_pipe_or_device

  !> What a path names: `a_file`, `a_folder`, `something_else`, or 0 where nothing is there.
  integer(c_int) function kind_of(path)
    character(len=*), intent(in) :: path

    kind_of = c_kind_of(path//c_null_char)
  end function kind_of

  !> Whether two paths name one and the same file, by whatever link.
  logical function same_file(one, other) result(yes)
    !> The two paths; where either is not there, they are not the same file.
    character(len=*), intent(in) :: one, other

    yes = c_same_file(one//c_null_char, other//c_null_char) /= 0
  end function same_file

  !> Folder that a file lies in: what is before its last slash, `.` if it has none.
  pure function folder_of(path) result(folder)
    !> Need not be there.
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

  !> The folder in which a file really lies, its links resolved; empty if it is not there.
  function real_folder_of(path) result(folder)
    !> Path of a file.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: folder
    integer :: length

    folder = repeat(' ', c_longest_path())
    length = c_real_folder(path//c_null_char, folder, c_longest_path())
    folder = folder(:length)
  end function real_folder_of

  !> Where a name is a link, what it points to in the end, which need not be there; others stay.
  subroutine follow_links(path, error)
    !> The name; what it points to where it is a link.
    character(len=:), allocatable, intent(inout) :: path
    !> Code `exit_bad_input`: links in a circle, for instance.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: final

    if (len(path) >= c_longest_path()) return
    final = path//repeat(c_null_char, c_longest_path() - len(path))
    call set_system_error(c_follow(final, c_longest_path()), 'the link cannot be followed', error)
    if (allocated(error)) then
      error%code = exit_bad_input
    else
      path = final(:index(final, c_null_char) - 1)
    end if
  end subroutine follow_links

  !> What the system says about the call that failed last.
  function system_message() result(message)
    character(len=:), allocatable :: message

    message = c_text_at(c_message(c_errno()))
  end function system_message

  !> An error if what C was asked for came to the number of one: its text follows `what`.
  subroutine set_system_error(number, what, error)
    !> What C calls `errno`; 0: all is well.
    integer, intent(in) :: number
    !> What failed, with the name of its file.
    character(len=*), intent(in) :: what
    type(error_type), allocatable, intent(out) :: error

    if (number /= 0) call fatal_error(error, what//': '//c_text_at(c_message(number)))
  end subroutine set_system_error

  !> The text of C that an address points to.
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

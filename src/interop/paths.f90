!> Names of files: what they name, by whatever link, and what the system says about them.
module battery_paths
  use, intrinsic :: iso_c_binding, only: c_int, c_size_t, c_char, c_ptr, c_null_char, c_f_pointer, &
    c_associated
  use battery_error, only: error_type, fatal_error, exit_bad_input
  implicit none (type, external)
  private
  public :: is_file, is_folder, is_pipe_or_device, same_file, folder_of
  public :: real_folder_of, follow_links
  public :: system_message, text_at, error_text

  !> What a path names.
  integer(c_int), parameter :: a_file = 1, a_folder = 2, something_else = 3

  interface
    function c_kind_of(path) result(kind) bind(c, name='battery_kind_of')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int) :: kind
    end function c_kind_of

    function c_same_file(one, other) result(yes) bind(c, name='battery_same_file')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: one(*), other(*)
      integer(c_int) :: yes
    end function c_same_file

    function c_longest_path() result(length) bind(c, name='battery_longest_path')
      import :: c_int
      implicit none (type, external)
      integer(c_int) :: length
    end function c_longest_path

    function c_follow(path, room) result(status) bind(c, name='battery_follow')
      import :: c_char, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: room
      character(kind=c_char), intent(inout) :: path(room)
      integer(c_int) :: status
    end function c_follow

    function c_real_folder(path, folder, room) result(status) &
      bind(c, name='battery_real_folder')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value, intent(in) :: room
      character(kind=c_char), intent(inout) :: folder(room)
      integer(c_int) :: status
    end function c_real_folder

    function c_errno() result(number) bind(c, name='battery_errno')
      import :: c_int
      implicit none (type, external)
      integer(c_int) :: number
    end function c_errno

    function c_strerror(number) result(text) bind(c, name='strerror')
      import :: c_int, c_ptr
      implicit none (type, external)
      integer(c_int), value, intent(in) :: number
      type(c_ptr) :: text
    end function c_strerror

    function c_strlen(text) result(length) bind(c, name='strlen')
      import :: c_ptr, c_size_t
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: text
      integer(c_size_t) :: length
    end function c_strlen
  end interface

contains

  !> Whether there is a file of that name, and no folder, pipe or device.
  function is_file(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path
    logical :: yes

    yes = c_kind_of(path//c_null_char) == a_file
  end function is_file

  !> Whether there is a folder of that name.
  function is_folder(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path
    logical :: yes

    yes = c_kind_of(path//c_null_char) == a_folder
  end function is_folder

  !> Whether there is something else of that name: a pipe, a device, a socket.
  function is_pipe_or_device(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path
    logical :: yes

    yes = c_kind_of(path//c_null_char) == something_else
  end function is_pipe_or_device

  !> Whether two paths name one and the same file, by whatever link.
  function same_file(one, other) result(yes)
    !> Where either is not there, they are not the same.
    character(len=*), intent(in) :: one, other
    logical :: yes

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
    !> Of a file.
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: folder

    folder = repeat(c_null_char, c_longest_path())
    if (c_real_folder(path//c_null_char, folder, c_longest_path()) /= 0) folder = c_null_char
    folder = folder(:index(folder, c_null_char) - 1)
  end function real_folder_of

  !> Where a name is a link, what it points to in the end, which need not be there; others stay.
  subroutine follow_links(path, error)
    !> The name; what it points to where it is a link.
    character(len=:), allocatable, intent(inout) :: path
    !> Code `exit_bad_input`: links in a circle, for instance.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: final
    integer(c_int) :: status

    if (len(path) >= c_longest_path()) return
    final = path//repeat(c_null_char, c_longest_path() - len(path))
    status = c_follow(final, c_longest_path())
    if (status == 0) then
      path = final(:index(final, c_null_char) - 1)
    else
      call fatal_error(error, 'the link cannot be followed: '//error_text(int(status)), &
        exit_bad_input)
    end if
  end subroutine follow_links

  !> What the system says about the call that failed last.
  function system_message() result(message)
    character(len=:), allocatable :: message

    message = error_text(int(c_errno()))
  end function system_message

  !> The text of C that an address points to.
  function text_at(address) result(text)
    !> Of bytes that end with a zero; null: the text is empty.
    type(c_ptr), intent(in) :: address
    character(len=:), allocatable :: text
    character(kind=c_char), pointer :: letters(:)
    integer :: at

    text = ''
    if (.not. c_associated(address)) return
    call c_f_pointer(address, letters, [c_strlen(address)])
    deallocate (text)
    allocate (character(len=size(letters)) :: text)
    do at = 1, size(letters)
      text(at:at) = letters(at)
    end do
  end function text_at

  !> What the system calls an error of that number.
  function error_text(number) result(text)
    !> What C calls `errno`.
    integer, intent(in) :: number
    character(len=:), allocatable :: text

    text = text_at(c_strerror(int(number, c_int)))
  end function error_text

end module battery_paths

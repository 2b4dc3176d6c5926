!> What Fortran cannot do with files: sync, atomic rename, remove, rights, folders and what is in
!> them.
module battery_files
  use, intrinsic :: iso_c_binding, only: c_int, c_size_t, c_char, c_ptr, c_funptr, &
    c_null_char, c_null_funptr, c_associated, c_f_pointer
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_text, only: string_type
  implicit none (type, external)
  private
  public :: file_exists, is_folder, is_readable, is_writable, folder_of, real_path_of
  public :: sync_file, rename_file, remove_file, make_folder, publish_file, read_text
  public :: files_like

  !> Questions to C's `access`.
  integer(c_int), parameter :: exists = 0, may_write = 2, may_read = 4

  !> Numbers of errors on Linux: the disk fails, is full, a quota is used up.
  integer(c_int), parameter :: disk_errors(4) = [5_c_int, 27_c_int, 28_c_int, 122_c_int]

  !> What C's `glob` finds (glob_t of the GNU library).
  type, bind(c) :: glob_type
    integer(c_size_t) :: count = 0
    type(c_ptr) :: paths
    integer(c_size_t) :: reserved = 0
    integer(c_int) :: flags = 0
    type(c_funptr) :: functions(5)
  end type glob_type

  interface
    function c_glob(pattern, flags, on_error, found) result(status) bind(c, name='glob')
      import :: c_char, c_int, c_funptr, glob_type
      implicit none (type, external)
      character(kind=c_char), intent(in) :: pattern(*)
      integer(c_int), value, intent(in) :: flags
      type(c_funptr), value, intent(in) :: on_error
      type(glob_type), intent(inout) :: found
      integer(c_int) :: status
    end function c_glob

    subroutine c_globfree(found) bind(c, name='globfree')
      import :: glob_type
      implicit none (type, external)
      type(glob_type), intent(inout) :: found
    end subroutine c_globfree

    function c_access(path, mode) result(status) bind(c, name='access')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value, intent(in) :: mode
      integer(c_int) :: status
    end function c_access

    function c_rename(old, new) result(status) bind(c, name='rename')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: old(*), new(*)
      integer(c_int) :: status
    end function c_rename

    function c_remove(path) result(status) bind(c, name='remove')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int) :: status
    end function c_remove

    function c_mkdir(path, mode) result(status) bind(c, name='mkdir')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), value, intent(in) :: mode
      integer(c_int) :: status
    end function c_mkdir

    function c_fopen(path, mode) result(stream) bind(c, name='fopen')
      import :: c_char, c_ptr
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*), mode(*)
      type(c_ptr) :: stream
    end function c_fopen

    function c_fileno(stream) result(descriptor) bind(c, name='fileno')
      import :: c_ptr, c_int
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: stream
      integer(c_int) :: descriptor
    end function c_fileno

    function c_fsync(descriptor) result(status) bind(c, name='fsync')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: descriptor
      integer(c_int) :: status
    end function c_fsync

    function c_fclose(stream) result(status) bind(c, name='fclose')
      import :: c_ptr, c_int
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: stream
      integer(c_int) :: status
    end function c_fclose

    function c_errno() result(place) bind(c, name='__errno_location')
      import :: c_ptr
      implicit none (type, external)
      type(c_ptr) :: place
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

  !> Whether there is a file or folder of that name.
  function file_exists(path) result(yes)
    character(len=*), intent(in) :: path
    logical :: yes

    yes = c_access(path//c_null_char, exists) == 0
  end function file_exists

  !> Whether there is a folder of that name.
  function is_folder(path) result(yes)
    character(len=*), intent(in) :: path
    logical :: yes

    yes = c_access(path//'/.'//c_null_char, exists) == 0
  end function is_folder

  !> Whether this process may read the file or folder.
  function is_readable(path) result(yes)
    character(len=*), intent(in) :: path
    logical :: yes

    yes = c_access(path//c_null_char, may_read) == 0
  end function is_readable

  !> Whether this process may write to the file or folder.
  function is_writable(path) result(yes)
    character(len=*), intent(in) :: path
    logical :: yes

    yes = c_access(path//c_null_char, may_write) == 0
  end function is_writable

  !> Folder that a file lies in: what is before its last slash, `.` if it has none.
  pure function folder_of(path) result(folder)
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

  !> A path as given in a file that lies in `folder`: absolute ones stay, others start there.
  pure function real_path_of(path, folder) result(real_path)
    character(len=*), intent(in) :: path, folder
    character(len=:), allocatable :: real_path

    if (path(1:min(1, len(path))) == '/' .or. folder == '.') then
      real_path = path
    else
      real_path = folder//'/'//path
    end if
  end function real_path_of

  !> Waits until the file, or the entries of the folder, are on the disk.
  subroutine sync_file(path, error)
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(out) :: error
    type(c_ptr) :: stream
    integer(c_int) :: synced, closed

    stream = c_fopen(path//c_null_char, 'r'//c_null_char)
    if (.not. c_associated(stream)) then
      call fatal_error(error, path//': cannot be opened: '//system_message())
      return
    end if
    synced = c_fsync(c_fileno(stream))
    if (synced /= 0) then
      call fatal_error(error, path//': cannot be written to the disk: '//system_message())
    end if
    closed = c_fclose(stream)
    if (closed /= 0 .and. synced == 0) then
      call fatal_error(error, path//': cannot be closed: '//system_message())
    end if
  end subroutine sync_file

  !> Gives a file another name in one step; what had that name is gone.
  subroutine rename_file(old, new, error)
    character(len=*), intent(in) :: old, new
    type(error_type), allocatable, intent(out) :: error

    if (c_rename(old//c_null_char, new//c_null_char) /= 0) then
      call fatal_error(error, old//': cannot be renamed to '//new//': '//system_message())
    end if
  end subroutine rename_file

  !> Puts a finished temporary file under its final name, so that after a crash there is either the
  !> old file or the new one, whole.
  subroutine publish_file(temporary, final, error)
    character(len=*), intent(in) :: temporary, final
    type(error_type), allocatable, intent(out) :: error

    call sync_file(temporary, error)
    if (allocated(error)) return
    call rename_file(temporary, final, error)
    if (allocated(error)) return
    call sync_file(folder_of(final), error)
  end subroutine publish_file

  !> Removes a file or an empty folder; one that is not there is no error.
  subroutine remove_file(path, error)
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(out) :: error

    if (.not. file_exists(path)) return
    if (c_remove(path//c_null_char) /= 0) then
      call fatal_error(error, path//': cannot be removed: '//system_message())
    end if
  end subroutine remove_file

  !> Makes a folder; one that is there already is no error. The error's code is `exit_bad_input`
  !> unless the disk is at fault.
  subroutine make_folder(path, error)
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(out) :: error
    integer(c_int), parameter :: rights = int(o'777', c_int)
    character(len=:), allocatable :: reason
    integer(c_int), pointer :: number
    integer :: code

    if (is_folder(path)) return
    if (c_mkdir(path//c_null_char, rights) == 0) return
    call c_f_pointer(c_errno(), number)
    code = merge(exit_failure, exit_bad_input, any(number == disk_errors))
    reason = system_message()
    ! Another rank may have been faster.
    if (is_folder(path)) return
    call fatal_error(error, path//': the folder cannot be made: '//reason, code)
  end subroutine make_folder

  !> Names, without the folder, of the files in a folder that match a pattern with `*` and `?`;
  !> none if there is no such folder. Their order is arbitrary.
  function files_like(folder, pattern) result(names)
    character(len=*), intent(in) :: folder, pattern
    type(string_type), allocatable :: names(:)
    integer(c_int), parameter :: unsorted = 4
    type(glob_type) :: found
    type(c_ptr), pointer :: paths(:)
    integer :: at

    allocate (names(0))
    if (c_glob(plain(folder)//'/'//pattern//c_null_char, unsorted, c_null_funptr, found) /= 0) &
      return
    call c_f_pointer(found%paths, paths, [found%count])
    deallocate (names)
    allocate (names(found%count))
    do at = 1, size(names)
      names(at)%text = text_at(paths(at))
      names(at)%text = names(at)%text(len(folder) + 2:)
    end do
    call c_globfree(found)
  end function files_like

  !> A path in which nothing stands for anything else.
  pure function plain(path) result(pattern)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: pattern
    integer :: at

    pattern = ''
    do at = 1, len(path)
      if (scan(path(at:at), '*?[]\') > 0) pattern = pattern//'\'
      pattern = pattern//path(at:at)
    end do
  end function plain

  !> The whole of a file as one text, its line ends as they are.
  subroutine read_text(path, text, error)
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(out) :: text
    type(error_type), allocatable, intent(out) :: error
    character(len=256) :: message
    integer :: unit, status, bytes

    text = ''
    if (is_folder(path)) then
      call fatal_error(error, path//': is a folder, not a file')
      return
    end if
    open (newunit=unit, file=path, access='stream', form='unformatted', status='old', &
      action='read', iostat=status, iomsg=message)
    if (status /= 0) then
      call fatal_error(error, path//': cannot be read: '//trim(message))
      return
    end if
    inquire (unit, size=bytes)
    deallocate (text)
    allocate (character(len=max(bytes, 0)) :: text)
    if (bytes > 0) read (unit, iostat=status, iomsg=message) text
    close (unit)
    if (status /= 0) call fatal_error(error, path//': cannot be read: '//trim(message))
  end subroutine read_text

  !> What the system says about the call that failed last.
  function system_message() result(message)
    character(len=:), allocatable :: message
    integer(c_int), pointer :: number

    call c_f_pointer(c_errno(), number)
    message = text_at(c_strerror(number))
  end function system_message

  !> The text of C that an address points to.
  function text_at(address) result(text)
    type(c_ptr), intent(in) :: address
    character(len=:), allocatable :: text
    character(kind=c_char), pointer :: letters(:)
    integer :: at

    call c_f_pointer(address, letters, [c_strlen(address)])
    allocate (character(len=size(letters)) :: text)
    do at = 1, size(letters)
      text(at:at) = letters(at)
    end do
  end function text_at

end module battery_files

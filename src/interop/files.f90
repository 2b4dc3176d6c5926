!> What Fortran cannot do with files: sync, atomic rename, remove, rights, folders and what is in
!> them.
module battery_files
  use, intrinsic :: iso_c_binding, only: c_int, c_char, c_ptr, c_null_char, c_associated
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_file_text, only: read_text
  use battery_paths, only: is_folder, folder_of, real_path_of, system_message, error_text, text_at
  use battery_text, only: string_type
  implicit none (type, external)
  private
  public :: file_exists, is_folder, is_readable, is_writable, folder_of, real_path_of
  public :: sync_file, rename_file, remove_file, make_folder, publish_file, read_text
  public :: create_new_file, files_like, is_disk_error

  !> Questions to C's `access`.
  integer(c_int), parameter :: exists = 0, may_write = 2, may_read = 4

  interface
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

    function c_remove(path) result(status) bind(c, name='battery_remove')
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

    function c_is_disk_error() result(yes) bind(c, name='battery_is_disk_error')
      import :: c_int
      implicit none (type, external)
      integer(c_int) :: yes
    end function c_is_disk_error

    function c_create_new(path) result(status) bind(c, name='battery_create_new')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int) :: status
    end function c_create_new

    function c_opendir(path) result(folder) bind(c, name='opendir')
      import :: c_char, c_ptr
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      type(c_ptr) :: folder
    end function c_opendir

    function c_next_like(folder, pattern) result(name) bind(c, name='battery_next_like')
      import :: c_char, c_ptr
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: folder
      character(kind=c_char), intent(in) :: pattern(*)
      type(c_ptr) :: name
    end function c_next_like

    function c_closedir(folder) result(status) bind(c, name='closedir')
      import :: c_int, c_ptr
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: folder
      integer(c_int) :: status
    end function c_closedir
  end interface

contains

  !> Whether there is a file or folder of that name.
  function file_exists(path) result(yes)
    character(len=*), intent(in) :: path
    logical :: yes

    yes = c_access(path//c_null_char, exists) == 0
  end function file_exists

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
    integer(c_int) :: status

    status = c_remove(path//c_null_char)
    if (status /= 0) call fatal_error(error, path//': cannot be removed: ' &
      //error_text(int(status)))
  end subroutine remove_file

  !> Makes a folder; one that is there already is no error. The error's code is `exit_bad_input`
  !> unless the disk is at fault.
  subroutine make_folder(path, error)
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(out) :: error
    integer(c_int), parameter :: rights = int(o'777', c_int)
    character(len=:), allocatable :: reason
    integer :: code

    if (is_folder(path)) return
    if (c_mkdir(path//c_null_char, rights) == 0) return
    code = merge(exit_failure, exit_bad_input, is_disk_error())
    reason = system_message()
    ! Another rank may have been faster.
    if (is_folder(path)) return
    call fatal_error(error, path//': the folder cannot be made: '//reason, code)
  end subroutine make_folder

  !> Makes an empty file anew. What had that name is removed, a link too: nothing is ever written
  !> through one.
  subroutine create_new_file(path, error)
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(out) :: error
    integer(c_int) :: status

    status = c_create_new(path//c_null_char)
    if (status /= 0) call fatal_error(error, path//': cannot be made anew: ' &
      //error_text(int(status)))
  end subroutine create_new_file

  !> Whether the disk is at fault for what failed last, and not a name or a right.
  function is_disk_error() result(yes)
    logical :: yes

    yes = c_is_disk_error() /= 0
  end function is_disk_error

  !> Names, without the folder, of what there is in a folder that matches a pattern with `*` and
  !> `?`; none if there is no such folder. Their order is arbitrary.
  function files_like(folder, pattern) result(names)
    character(len=*), intent(in) :: folder, pattern
    type(string_type), allocatable :: names(:)
    type(string_type), allocatable :: more(:)
    type(c_ptr) :: open_folder, name
    integer(c_int) :: status
    integer :: found

    allocate (names(16))
    found = 0
    open_folder = c_opendir(folder//c_null_char)
    if (c_associated(open_folder)) then
      do
        name = c_next_like(open_folder, pattern//c_null_char)
        if (.not. c_associated(name)) exit
        if (found == size(names)) then
          allocate (more(2*found))
          more(:found) = names
          call move_alloc(more, names)
        end if
        found = found + 1
        names(found)%text = text_at(name)
      end do
      status = c_closedir(open_folder)
    end if
    names = names(:found)
  end function files_like

end module battery_files

!> Operations on files that Fortran lacks: sync, atomic rename, removal, permissions, folders and
!> their contents.
module battery_files
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_int64_t, c_ptr, c_null_char, c_null_ptr, &
    c_associated
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_c_shapes, only: returns_number, number_of_path, number_of_paths
  use battery_paths, only: is_folder, folder_of, system_message, set_system_error, c_text_at
  use battery_text, only: string_type
  implicit none (type, external)
  private
  public :: file_exists, is_writable, is_disk_error, find_files, may_open
  public :: sync_file, remove_file, make_folder, publish_file, write_parts
  public :: file_stamp_type, has_stamp, publish_unless_replaced

  !> Stamp of a file when it was read, and the digest of its contents, if that was computed;
  !> initially: no file.
  type :: file_stamp_type
    integer(c_int64_t) :: mark(5) = 0
    character(len=64) :: digest = ''
  end type file_stamp_type

  procedure(number_of_path), bind(c, name='battery_exists') :: c_exists
  procedure(number_of_path), bind(c, name='battery_may_write') :: c_may_write
  procedure(number_of_path), bind(c, name='battery_remove') :: c_remove
  procedure(number_of_path), bind(c, name='battery_make_folder') :: c_make_folder
  procedure(number_of_path), bind(c, name='battery_sync') :: c_sync
  procedure(number_of_paths), bind(c, name='battery_rename') :: c_rename
  procedure(returns_number), bind(c, name='battery_is_disk_error') :: c_is_disk_error

  interface
    type(c_ptr) function c_next_like(folder, path, pattern, status) &
        bind(c, name='battery_next_like')
      import :: c_char, c_int, c_ptr
      implicit none (type, external)
      type(c_ptr), intent(inout) :: folder
      character(kind=c_char), intent(in) :: path(*), pattern(*)
      integer(c_int), intent(out) :: status
    end function c_next_like

    !> Whether this process may have so many files open at the same time; its limit is raised if
    !> that is allowed.
    integer(c_int) function may_open(count) bind(c, name='battery_may_open')
      import :: c_int, c_int64_t
      implicit none (type, external)
      integer(c_int64_t), value, intent(in) :: count
    end function may_open

    integer(c_int) function c_has_stamp(path, seen) bind(c, name='battery_has_stamp')
      import :: c_char, c_int, c_int64_t
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int64_t), intent(in) :: seen(5)
    end function c_has_stamp

    integer(c_int) function c_write_parts(path, at, first, second, third) &
        bind(c, name='battery_write_parts')
      import :: c_char, c_int, c_int64_t
      implicit none (type, external)
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int64_t), value, intent(in) :: at
      type(*), intent(in) :: first(..), second(..), third(..)
    end function c_write_parts

    integer(c_int) function c_put_in_place(old, new, seen) bind(c, name='battery_put_in_place')
      import :: c_char, c_int, c_int64_t
      implicit none (type, external)
      character(kind=c_char), intent(in) :: old(*), new(*)
      integer(c_int64_t), intent(in) :: seen(5)
    end function c_put_in_place
  end interface

contains

  !> Whether there is a file or folder of that name. It is missing only if the system says so: an
  !> error of the system, of a disk that is away for a moment, is no answer.
  logical function file_exists(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path

    yes = c_exists(path//c_null_char) /= 0
  end function file_exists

  !> Whether this process may write to the file or folder.
  logical function is_writable(path) result(yes)
    !> Links are followed.
    character(len=*), intent(in) :: path

    yes = c_may_write(path//c_null_char) /= 0
  end function is_writable

  !> Syncs a file, or the entries of a folder, to disk. A folder that cannot be synced is no error.
  subroutine sync_file(path, error)
    !> Path of a file or a folder.
    character(len=*), intent(in) :: path
    !> The file is missing, or the disk has failed.
    type(error_type), allocatable, intent(out) :: error

    call set_system_error(c_sync(path//c_null_char), path//': cannot be written to the disk', error)
  end subroutine sync_file

  !> Puts a finished temporary file under its final name, at once and in place of a file that had
  !> it, so that after a crash there is either the old file or the new one, whole.
  subroutine publish_file(temporary, final, error)
    !> Paths of the two files, in one folder.
    character(len=*), intent(in) :: temporary, final
    type(error_type), allocatable, intent(out) :: error

    call sync_file(temporary, error)
    if (allocated(error)) return
    if (c_rename(temporary//c_null_char, final//c_null_char) == 0) then
      call sync_file(folder_of(final), error)
    else
      call fatal_error(error, temporary//': cannot be renamed to '//final//': '//system_message())
    end if
  end subroutine publish_file

  !> Whether a name still refers to the file that was read, as far as is known without opening it.
  logical function has_stamp(path, before) result(yes)
    !> Links are not followed.
    character(len=*), intent(in) :: path
    !> Stamp of the file that was read.
    type(file_stamp_type), intent(in) :: before

    yes = c_has_stamp(path//c_null_char, before%mark) /= 0
  end function has_stamp

  !> As `publish_file`, for a temporary file that is synced to disk, but replaces only the file with
  !> the given stamp: otherwise the file keeps its temporary name, and there is an error.
  subroutine publish_unless_replaced(temporary, final, before, error)
    !> Paths of the two files, in one folder.
    character(len=*), intent(in) :: temporary, final
    !> Stamp of the file that may be replaced.
    type(file_stamp_type), intent(in) :: before
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: what
    integer :: status

    what = temporary//': is whole, and is kept under this name'
    status = c_put_in_place(temporary//c_null_char, final//c_null_char, before%mark)
    if (status < 0) then
      call fatal_error(error, what//', since '//final//' is something else now than it was when ' &
        //'the run began; the same command goes on, or says what is in its way')
    else
      call set_system_error(status, what//'; it cannot be renamed to '//final, error)
    end if
    if (.not. allocated(error)) call sync_file(folder_of(final), error)
  end subroutine publish_unless_replaced

  !> Removes a file or an empty folder; a missing one is no error, and other folders stay.
  subroutine remove_file(path, error)
    !> Of a link, the link itself is removed, not its target.
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(out) :: error

    call set_system_error(c_remove(path//c_null_char), path//': cannot be removed', error)
  end subroutine remove_file

  !> Makes a folder; an existing one is no error. The code of the error is `exit_bad_input` unless
  !> the disk has failed.
  subroutine make_folder(path, error)
    !> Path of the new folder, in an existing folder.
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: reason
    integer :: code

    if (is_folder(path)) return
    if (c_make_folder(path//c_null_char) == 0) return
    code = merge(exit_failure, exit_bad_input, is_disk_error())
    reason = system_message()
    ! Another rank may have made the folder in the meantime.
    if (is_folder(path)) return
    call fatal_error(error, path//': the folder cannot be made: '//reason, code)
  end subroutine make_folder

  !> Writes three arrays one after the other into a file, and ends the file behind them.
  subroutine write_parts(path, at, first, second, third, error)
    !> Path of the file.
    character(len=*), intent(in) :: path
    !> Offset in bytes of the first array; 0: the file is made anew, and a file or a link that had
    !> the name is removed.
    integer(c_int64_t), intent(in) :: at
    !> Arrays of numbers; may be empty, but not the constant `[integer ::]`: gfortran 11 gives it no
    !> address, and refuses it.
    type(*), intent(in), contiguous :: first(..), second(..), third(..)
    !> Not all bytes could be written.
    type(error_type), allocatable, intent(out) :: error

    call set_system_error(c_write_parts(path//c_null_char, at, first, second, third), &
      path//': cannot be written', error)
  end subroutine write_parts

  !> Whether the last failure was one of the disk, not of a name or of permissions.
  logical function is_disk_error() result(yes)

    yes = c_is_disk_error() /= 0
  end function is_disk_error

  !> Finds the names, without the folder, of the entries of a folder that match a pattern of a
  !> shell, with `*`, `?` and `@(one|other)`, in any order; none if there is no such folder.
  subroutine find_files(folder, pattern, names, error)
    !> Folder to look in, and pattern of the names.
    character(len=*), intent(in) :: folder, pattern
    type(string_type), allocatable, intent(out) :: names(:)
    !> The folder cannot be read.
    type(error_type), allocatable, intent(out) :: error
    type(string_type), allocatable :: more(:)
    type(c_ptr) :: open_folder, name
    integer :: found, status

    allocate (names(16))
    found = 0
    open_folder = c_null_ptr
    do
      name = c_next_like(open_folder, folder//c_null_char, pattern//c_null_char, status)
      if (.not. c_associated(name)) exit
      if (found == size(names)) then
        allocate (more(2*found))
        more(:found) = names
        call move_alloc(more, names)
      end if
      found = found + 1
      names(found)%text = c_text_at(name)
    end do
    names = names(:found)
    call set_system_error(status, folder//': cannot be read, and is kept', error)
  end subroutine find_files

end module battery_files

!> Files of HDF5 and the paths in them, every status checked.
!>
!> Three modules wrap HDF5: this one, attributes, datasets. A path is absolute, and its groups exist
!> already. An error names the file and the path.
!>
!> A new file is made in memory and written to disk when it is closed: after a failed write HDF5
!> crashes when it closes the file. Its bytes are written from the memory of HDF5 without a copy,
!> followed by the checksum footer.
!>
!> Of a file that is read no object is opened before `check_links` found that it is stored in this
!> file, and no filter is loaded from elsewhere.
module battery_hdf5_file
  use, intrinsic :: iso_c_binding, only: c_associated, c_char, c_f_pointer, c_int, c_int64_t, &
    c_null_char, c_null_ptr, c_ptr, c_size_t
  ! A compiler without the switches of fpm.rsp shows the next line, and stops.
  use hdf5, only: & ! type "fpm @release": "fpm build" alone has no switches (docs/install.md)
    hid_t, size_t, h5get_libversion_f, h5open_f, h5eset_auto_f, h5fcreate_f, h5fopen_f, &
    h5fflush_f, h5fget_file_image_f, h5gcreate_f, h5pcreate_f, &
    h5pset_fclose_degree_f, h5pset_fapl_core_f, h5idec_ref_f, h5lexists_f
  use hdf5, only: h5f_acc_trunc_f, h5f_acc_rdonly_f, h5f_close_strong_f, h5f_scope_global_f, &
    h5p_default_f, h5p_file_access_f
  use battery_kinds, only: int8
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_checksum_footer, only: write_with_footer
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: hdf5_file_type, create_file, open_file, close_file
  public :: make_group
  public :: release_handle, check_status, check_links, no_handle, hdf5_library

  !> Value of a handle that is not open.
  integer(hid_t), parameter :: no_handle = -1_hid_t

  !> An open file.
  type :: hdf5_file_type
    character(len=:), allocatable :: name
    integer(hid_t) :: id = no_handle
    !> Whether the file is new, and so still in memory.
    logical :: is_new = .false.
  end type hdf5_file_type

  !> Whether HDF5 has been started: only once per program, since each start makes new type handles.
  logical :: is_started = .false.

  interface
    !> Sets the kinds of plugins that HDF5 may load; 0: none.
    integer(c_int) function set_plugins(kinds) bind(c, name='H5PLset_loading_state')
      import :: c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: kinds
    end function set_plugins

    !> Value of a soft or external link; negative status for a hard link, which has no value. Of the
    !> ways to determine the kind of a link, only this one is the same in all versions of HDF5.
    integer(c_int) function link_value(place, name, buffer, length, access) &
      bind(c, name='H5Lget_val')
      import :: c_char, c_int, c_int64_t, c_ptr, c_size_t
      implicit none (type, external)
      integer(c_int64_t), value, intent(in) :: place, access
      character(kind=c_char), intent(in) :: name(*)
      type(c_ptr), value, intent(in) :: buffer
      integer(c_size_t), value, intent(in) :: length
    end function link_value

    !> Sets a variable of the environment.
    integer(c_int) function set_variable(name, value, replace) bind(c, name='setenv')
      import :: c_char, c_int
      implicit none (type, external)
      character(kind=c_char), intent(in) :: name(*), value(*)
      integer(c_int), value, intent(in) :: replace
    end function set_variable

    !> Handle of the driver of a file; for a file in memory, it is where the address of its bytes is
    !> stored. Not all versions of HDF5 have a Fortran interface for it.
    integer(c_int) function get_handle(file, access, handle) bind(c, name='H5Fget_vfd_handle')
      import :: c_int, c_ptr, c_int64_t
      implicit none (type, external)
      integer(c_int64_t), value, intent(in) :: file, access
      type(c_ptr), intent(out) :: handle
    end function get_handle
  end interface

contains

  !> Name and version of the HDF5 library.
  function hdf5_library() result(version)
    character(len=:), allocatable :: version
    integer :: major, minor, release_number, status

    call start_hdf5(status)
    call h5get_libversion_f(major, minor, release_number, status)
    version = to_text(major)//'.'//to_text(minor)//'.'//to_text(release_number)
  end function hdf5_library

  !> Creates a file in memory; `close_file` writes it to disk, over any file of the same name.
  subroutine create_file(file, name, error)
    !> File, opened here; `close_file` closes it.
    class(hdf5_file_type), intent(out) :: file
    !> Path of the file.
    character(len=*), intent(in) :: name
    type(error_type), allocatable, intent(out) :: error
    integer(size_t), parameter :: growth = 1024_size_t**2
    integer(hid_t) :: access
    integer :: status

    file%name = name
    file%is_new = .true.
    call new_access(access, status)
    if (status == 0) call h5pset_fapl_core_f(access, growth, .false., status)
    if (status == 0) call h5fcreate_f(name, h5f_acc_trunc_f, file%id, status, access_prp=access)
    call release_handle(access, status)
    if (status /= 0) call fatal_error(error, name//': cannot be created in memory')
  end subroutine create_file

  !> Opens a file for reading. `check_footer` reports a missing or unreadable file.
  subroutine open_file(file, name, error)
    !> File, opened here; `close_file` closes it.
    class(hdf5_file_type), intent(out) :: file
    !> Path of the file.
    character(len=*), intent(in) :: name
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: access
    integer :: status

    file%name = name
    call new_access(access, status)
    if (status == 0) call h5fopen_f(name, h5f_acc_rdonly_f, file%id, status, access_prp=access)
    call release_handle(access, status)
    if (status /= 0) &
      call fatal_error(error, name//': cannot be opened as an HDF5 file', exit_bad_input)
  end subroutine open_file

  !> Starts HDF5 if needed, without its own messages, the plugins for filters that a file names, and
  !> its file locks: some network disks have none, and the program has a lock of its own. HDF5 reads
  !> the variable when it starts; versions before 1.10.7 have no other way.
  subroutine start_hdf5(status)
    integer, intent(out) :: status

    status = 0
    if (is_started) return
    status = set_variable('HDF5_USE_FILE_LOCKING'//c_null_char, 'FALSE'//c_null_char, 1_c_int)
    if (status == 0) call h5open_f(status)
    if (status == 0) call h5eset_auto_f(0, status)
    if (status == 0) status = set_plugins(0_c_int)
    is_started = status == 0
  end subroutine start_hdf5

  !> Makes the access properties of files: closing a file closes all objects in it.
  subroutine new_access(access, status)
    integer(hid_t), intent(out) :: access
    integer, intent(out) :: status

    access = no_handle
    call start_hdf5(status)
    if (status == 0) call h5pcreate_f(h5p_file_access_f, access, status)
    if (status == 0) call h5pset_fclose_degree_f(access, h5f_close_strong_f, status)
  end subroutine new_access

  !> Closes a file; a file that is not open is no error. A new file is written to the disk, unless
  !> there was an error.
  subroutine close_file(file, error)
    !> File, open.
    class(hdf5_file_type), intent(inout) :: file
    !> An earlier error is kept.
    type(error_type), allocatable, intent(inout) :: error
    integer(int8), pointer, contiguous :: image(:)
    integer :: status

    if (file%id < 0) return
    status = 0
    if (file%is_new .and. .not. allocated(error)) then
      call get_image(file, image, status)
      if (status == 0) call write_with_footer(file%name, image, error)
    end if
    call release_handle(file%id, status)
    file%id = no_handle
    if (status /= 0 .and. .not. allocated(error)) &
      call fatal_error(error, file%name//': cannot be closed')
  end subroutine close_file

  !> Gets the bytes of a file in memory, without a copy.
  subroutine get_image(file, image, status)
    class(hdf5_file_type), intent(in) :: file
    !> Bytes of the file; valid while it is open and nothing is written to it.
    integer(int8), pointer, contiguous, intent(out) :: image(:)
    integer, intent(out) :: status
    integer(size_t) :: bytes
    type(c_ptr) :: handle
    type(c_ptr), pointer :: memory

    nullify (image)
    bytes = 0
    handle = c_null_ptr
    call h5fflush_f(file%id, h5f_scope_global_f, status)
    if (status == 0) call h5fget_file_image_f(file%id, handle, 0_size_t, status, bytes)
    if (status == 0) &
      status = get_handle(int(file%id, c_int64_t), int(h5p_default_f, c_int64_t), handle)
    if (status /= 0 .or. .not. c_associated(handle)) then
      status = -1
      return
    end if
    call c_f_pointer(handle, memory)
    call c_f_pointer(memory, image, [bytes])
  end subroutine get_image

  !> Makes a group in a file; it must not exist yet, and its parent must. Does nothing after an
  !> error.
  subroutine make_group(file, path, error)
    !> File, open for writing.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the group in the file, from the root.
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(inout) :: error
    integer(hid_t) :: group
    integer :: status

    if (allocated(error)) return
    group = no_handle
    call h5gcreate_f(file%id, path, group, status)
    call release_handle(group, status)
    call check_status(file, path, 'cannot be made', status, error)
  end subroutine make_group

  !> Closes a handle of any kind, if it is open; `status` becomes nonzero if that fails.
  subroutine release_handle(handle, status)
    !> Handle of any HDF5 object, or `no_handle`.
    integer(hid_t), intent(in) :: handle
    integer, intent(inout) :: status
    integer :: users, closed

    if (handle < 0) return
    call h5idec_ref_f(handle, users, closed)
    if (closed /= 0) status = closed
  end subroutine release_handle

  !> Checks that an object is stored in this file under its path: all links to it must be hard
  !> links. Other links can lead to any object, also in any other file that the user may read. Does
  !> nothing after an error.
  subroutine check_links(file, path, error)
    !> File, open.
    class(hdf5_file_type), intent(in) :: file
    !> Path from the root; `/` is the root itself.
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(inout) :: error
    integer :: last, slash, status
    logical :: is_there

    last = 1
    do while (last < len(path) .and. .not. allocated(error))
      slash = index(path(last + 1:), '/')
      last = merge(len(path), last + slash, slash == 0)
      associate (step => path(:last - merge(0, 1, slash == 0)))
        call h5lexists_f(file%id, step, is_there, status)
        if (.not. is_there) status = 1
        call check_status(file, path, 'is not there', status, error)
        if (status == 0) call check_status(file, path, 'is a link out of its place', merge(1, 0, &
          link_value(file%id, step//c_null_char, c_null_ptr, 0_c_size_t, h5p_default_f) >= 0), &
          error)
      end associate
    end do
  end subroutine check_links

  !> Sets an error about the object at a path, if `status` is not 0. In a file that is read, it
  !> is bad input: the checksum was valid, so the file was made like this.
  subroutine check_status(file, path, problem, status, error)
    !> File that the object is in.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the object in the file, from the root; what is wrong with it.
    character(len=*), intent(in) :: path, problem
    integer, intent(in) :: status
    type(error_type), allocatable, intent(out) :: error

    if (status /= 0) call fatal_error(error, file%name//': '//path//' '//problem, &
      merge(exit_failure, exit_bad_input, file%is_new))
  end subroutine check_status

end module battery_hdf5_file

!> Files of HDF5 and the paths in them, every status checked.
!>
!> The layer over HDF5 has four rooms: this one, attributes, datasets, dimension scales. A path is
!> absolute, the groups on its way are there already. An error names the file and the path.
module battery_hdf5_file
  use hdf5, only: hid_t, h5open_f, h5eset_auto_f, h5fcreate_f, h5fopen_f, h5fclose_f, &
    h5fis_hdf5_f, h5gcreate_f, h5lexists_f, h5pcreate_f, h5pset_fclose_degree_f, h5idec_ref_f
  use hdf5, only: h5f_acc_trunc_f, h5f_acc_rdonly_f, h5f_close_strong_f, h5p_file_access_f
  use battery_error, only: error_type, fatal_error
  use battery_files, only: file_exists, is_folder, is_readable, folder_of
  implicit none (type, external)
  private
  public :: hdf5_file_type, create_file, open_file, close_file, make_group, path_exists
  public :: release, check, no_handle

  !> What a handle is before HDF5 gives one.
  integer(hid_t), parameter :: no_handle = -1_hid_t

  !> An open file.
  type :: hdf5_file_type
    character(len=:), allocatable :: name
    integer(hid_t) :: id = no_handle
  end type hdf5_file_type

  !> HDF5 makes its types anew each time it is started, so this is done once in a program.
  logical :: is_started = .false.

contains

  !> Starts HDF5 and switches off what it prints by itself.
  subroutine start_hdf5(status)
    integer, intent(out) :: status

    status = 0
    if (is_started) return
    call h5open_f(status)
    if (status == 0) call h5eset_auto_f(0, status)
    is_started = status == 0
  end subroutine start_hdf5

  !> Creates a file; one that is there is emptied.
  subroutine create_file(file, name, error)
    type(hdf5_file_type), intent(out) :: file
    character(len=*), intent(in) :: name
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: access
    integer :: status

    file%name = name
    call start_hdf5(status)
    call new_access(access, status)
    if (status == 0) call h5fcreate_f(name, h5f_acc_trunc_f, file%id, status, access_prp=access)
    call release(access, status)
    if (status == 0) return
    if (.not. is_folder(folder_of(name))) then
      call fatal_error(error, name//': cannot be created: there is no folder '//folder_of(name))
    else if (is_folder(name)) then
      call fatal_error(error, name//': cannot be created: a folder has that name')
    else
      call fatal_error(error, name//': cannot be created: may '//folder_of(name)//' be written to?')
    end if
  end subroutine create_file

  !> Opens a file for reading.
  subroutine open_file(file, name, error)
    type(hdf5_file_type), intent(out) :: file
    character(len=*), intent(in) :: name
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: access
    logical :: is_hdf5
    integer :: status

    file%name = name
    if (.not. file_exists(name)) then
      call fatal_error(error, name//': there is no such file')
    else if (is_folder(name)) then
      call fatal_error(error, name//': is a folder, not a file')
    else if (.not. is_readable(name)) then
      call fatal_error(error, name//': may not be read')
    end if
    if (allocated(error)) return
    call start_hdf5(status)
    if (status == 0) call h5fis_hdf5_f(name, is_hdf5, status)
    if (status /= 0) is_hdf5 = .false.
    call new_access(access, status)
    if (status == 0) call h5fopen_f(name, h5f_acc_rdonly_f, file%id, status, access_prp=access)
    call release(access, status)
    if (status == 0) return
    if (is_hdf5) then
      call fatal_error(error, name//': cannot be opened: damaged, or being written')
    else
      call fatal_error(error, name//': is not an HDF5 file')
    end if
  end subroutine open_file

  !> How files are opened: closing one closes all that is open in it.
  subroutine new_access(access, status)
    integer(hid_t), intent(out) :: access
    integer, intent(inout) :: status

    access = no_handle
    if (status == 0) call h5pcreate_f(h5p_file_access_f, access, status)
    if (status == 0) call h5pset_fclose_degree_f(access, h5f_close_strong_f, status)
  end subroutine new_access

  !> Closes a file; one that is not open is no error. What could not be written is found out here.
  subroutine close_file(file, error)
    type(hdf5_file_type), intent(inout) :: file
    type(error_type), allocatable, intent(out) :: error
    integer :: status

    if (file%id < 0) return
    call h5fclose_f(file%id, status)
    file%id = no_handle
    if (status /= 0) call fatal_error(error, file%name//': cannot be closed: is the disk full?')
  end subroutine close_file

  !> Makes a group.
  subroutine make_group(file, path, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: group
    integer :: status

    group = no_handle
    call h5gcreate_f(file%id, path, group, status)
    call release(group, status)
    call check(file, path, 'cannot be made', status, error)
  end subroutine make_group

  !> Whether a group or dataset is at a path.
  function path_exists(file, path) result(yes)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    logical :: yes
    integer :: last, slash, status

    yes = .true.
    last = 1
    do while (yes .and. last < len(path))
      slash = index(path(last + 1:), '/')
      last = merge(len(path), last + slash, slash == 0)
      call h5lexists_f(file%id, path(:merge(last, last - 1, slash == 0)), yes, status)
      yes = yes .and. status == 0
    end do
  end function path_exists

  !> Closes a handle of any kind, if there is one; `status` becomes nonzero where that fails.
  subroutine release(handle, status)
    integer(hid_t), intent(in) :: handle
    integer, intent(inout) :: status
    integer :: users, closed

    if (handle < 0) return
    call h5idec_ref_f(handle, users, closed)
    if (closed /= 0) status = closed
  end subroutine release

  !> An error about what stands at a path, if `status` says so.
  subroutine check(file, path, problem, status, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, problem
    integer, intent(in) :: status
    type(error_type), allocatable, intent(out) :: error

    if (status /= 0) call fatal_error(error, file%name//': '//path//' '//problem)
  end subroutine check

end module battery_hdf5_file

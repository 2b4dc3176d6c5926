!> Reads datasets and attributes of HDF5 files in tests; the program itself reads no dataset.
module hdf5_reading
  use, intrinsic :: iso_c_binding, only: c_ptr, c_loc
  use hdf5, only: hid_t, hsize_t, h5kind_to_type, h5_real_kind, h5_integer_kind, h5dopen_f, &
    h5dread_f, h5dget_space_f, h5aopen_by_name_f, h5aread_f, h5aget_space_f, h5lexists_f, &
    h5sget_simple_extent_ndims_f, h5sget_simple_extent_dims_f
  use battery_kinds, only: dp, int32, int64
  use battery_error, only: error_type
  use battery_text, only: to_text
  use battery_hdf5_file, only: hdf5_file_type, release_handle, check_status, no_handle, &
    array_view_type, array_view_of, read_text_attribute
  implicit none (type, external)
  private
  public :: read_dataset, read_attribute, read_shape, path_exists

  !> Reads the attribute `name`, a single number or a text, of the object at the `path` (`/` for the
  !> file itself) of an open `file`.
  interface read_attribute
    module procedure :: read_real64, read_int32, read_text_attribute
  end interface read_attribute

contains

  !> Whether a group or dataset of that name lies at the top of an open `file`.
  logical function path_exists(file, path) result(yes)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    integer :: status

    call h5lexists_f(file%id, path, yes, status)
  end function path_exists

  subroutine read_real64(file, path, name, value, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    real(dp), intent(inout) :: value
    type(error_type), allocatable, intent(out) :: error
    ! Not memory_of: gfortran 11 passes it a wrong type of a scalar that is an argument, and
    ! gfortran 14 takes a scalar that was its argument as unchanged.
    real(dp), target :: found

    found = value
    call read_number(file, path, name, h5kind_to_type(kind(found), h5_real_kind), c_loc(found), &
      error)
    value = found
  end subroutine read_real64

  subroutine read_int32(file, path, name, value, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(int32), intent(inout) :: value
    type(error_type), allocatable, intent(out) :: error
    integer(int32), target :: found

    found = value
    call read_number(file, path, name, h5kind_to_type(kind(found), h5_integer_kind), c_loc(found), &
      error)
    value = found
  end subroutine read_int32

  subroutine read_number(file, path, name, value_type, address, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(hid_t), intent(in) :: value_type
    type(c_ptr), intent(in) :: address
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: attribute, space
    integer :: dimensions, status
    type(c_ptr) :: buffer

    attribute = no_handle
    space = no_handle
    buffer = address
    call h5aopen_by_name_f(file%id, path, name, attribute, status)
    if (status == 0) call h5aget_space_f(attribute, space, status)
    if (status == 0) call h5sget_simple_extent_ndims_f(space, dimensions, status)
    if (status == 0) status = merge(-1, 0, dimensions > 0)
    if (status == 0) call h5aread_f(attribute, value_type, buffer, status)
    call release_handle(space, status)
    call release_handle(attribute, status)
    call check_status(file, path, 'has no attribute '//name//' that is one number', status, error)
  end subroutine read_number

  !> Reads the dataset at the `path` of an open `file`; it must have the shape of `values`.
  subroutine read_dataset(file, path, values, error)
    !> An open file.
    type(hdf5_file_type), intent(in) :: file
    !> Absolute path.
    character(len=*), intent(in) :: path
    type(*), intent(inout), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error
    type(array_view_type) :: memory
    integer(hsize_t), allocatable :: found(:)
    integer(hid_t) :: dataset
    integer :: status
    logical :: same

    call read_shape(file, path, found, error)
    if (allocated(error)) return
    memory = array_view_of(values)
    same = size(found) == size(memory%extents)
    if (same) same = all(found == memory%extents)
    if (.not. same) then
      call check_status(file, path, 'has the extents '//shape_text(found)//', not ' &
        //shape_text(memory%extents), 1, error)
      return
    end if
    if (product(found) == 0) return
    dataset = no_handle
    call h5dopen_f(file%id, path, dataset, status)
    if (status == 0) call h5dread_f(dataset, memory%value_type, memory%address, status)
    call release_handle(dataset, status)
    call check_status(file, path, 'cannot be read', status, error)
  end subroutine read_dataset

  !> Reads the extents of a dataset.
  subroutine read_shape(file, path, extents, error)
    !> An open file.
    type(hdf5_file_type), intent(in) :: file
    !> Absolute path.
    character(len=*), intent(in) :: path
    !> One extent for each dimension, in Fortran order; empty for a scalar.
    integer(int64), allocatable, intent(out) :: extents(:)
    type(error_type), allocatable, intent(out) :: error
    integer(hsize_t), allocatable :: most(:)
    integer(hid_t) :: dataset, space
    integer :: dimensions, status

    dataset = no_handle
    space = no_handle
    dimensions = 0
    call h5dopen_f(file%id, path, dataset, status)
    if (status == 0) call h5dget_space_f(dataset, space, status)
    if (status == 0) call h5sget_simple_extent_ndims_f(space, dimensions, status)
    allocate (extents(dimensions), most(dimensions))
    if (status == 0 .and. dimensions > 0) then
      call h5sget_simple_extent_dims_f(space, extents, most, status)
      status = min(status, 0)
    end if
    call release_handle(space, status)
    call release_handle(dataset, status)
    call check_status(file, path, 'cannot be read', status, error)
  end subroutine read_shape

  !> Extents as text, such as 3 x 4.
  pure function shape_text(extents) result(text)
    integer(hsize_t), intent(in) :: extents(:)
    character(len=:), allocatable :: text
    integer :: k

    text = 'of a scalar'
    if (size(extents) > 0) text = to_text(extents(1))
    do k = 2, size(extents)
      text = text//' x '//to_text(extents(k))
    end do
  end function shape_text

end module hdf5_reading

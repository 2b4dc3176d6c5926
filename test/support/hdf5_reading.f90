!> What the tests read back from HDF5: the program itself reads no dataset.
module hdf5_reading
  use, intrinsic :: iso_c_binding, only: c_ptr, c_loc, c_null_ptr
  use hdf5, only: hid_t, hsize_t, h5dopen_f, h5dread_f, h5dget_space_f, h5dget_type_f, &
    h5dvlen_reclaim_f, h5lexists_f, h5sget_simple_extent_ndims_f, h5sget_simple_extent_dims_f, &
    h5kind_to_type, h5p_default_f, h5_real_kind, h5_integer_kind
  use battery_kinds, only: dp, int8, int32, int64
  use battery_error, only: error_type
  use battery_paths, only: text_at
  use battery_text, only: to_text
  use battery_hdf5_file, only: hdf5_file_type, release, check, no_handle
  use battery_hdf5_attributes, only: is_text
  implicit none (type, external)
  private
  public :: read_dataset, read_shape, path_exists

  !> Reads the dataset at the `path` of an open `file`, of the same shape as `values`, or a text.
  interface read_dataset
    module procedure :: read_real64, read_int8, read_int32, read_int64, read_text
  end interface read_dataset

contains

  !> Whether a group or dataset is at a path.
  function path_exists(file, path) result(yes)
    !> Open.
    type(hdf5_file_type), intent(in) :: file
    !> From the root.
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

  subroutine read_real64(file, path, values, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    real(dp), intent(inout), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call read_values(file, path, h5kind_to_type(dp, h5_real_kind), c_loc(values), &
      shape(values, hsize_t), error)
  end subroutine read_real64

  subroutine read_int8(file, path, values, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(int8), intent(inout), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call read_values(file, path, h5kind_to_type(int8, h5_integer_kind), c_loc(values), &
      shape(values, hsize_t), error)
  end subroutine read_int8

  subroutine read_int32(file, path, values, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(int32), intent(inout), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call read_values(file, path, h5kind_to_type(int32, h5_integer_kind), c_loc(values), &
      shape(values, hsize_t), error)
  end subroutine read_int32

  subroutine read_int64(file, path, values, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(int64), intent(inout), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call read_values(file, path, h5kind_to_type(int64, h5_integer_kind), c_loc(values), &
      shape(values, hsize_t), error)
  end subroutine read_int64

  !> A dataset of these extents, into the memory at `address`.
  subroutine read_values(file, path, value_type, address, extents, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(hid_t), intent(in) :: value_type
    type(c_ptr), intent(in) :: address
    integer(hsize_t), intent(in) :: extents(:)
    type(error_type), allocatable, intent(out) :: error
    integer(hsize_t), allocatable :: found(:)
    integer(hid_t) :: dataset
    integer :: status
    logical :: same
    type(c_ptr) :: buffer

    call read_shape(file, path, found, error)
    if (allocated(error)) return
    same = size(found) == size(extents)
    if (same) same = all(found == extents)
    if (.not. same) then
      call check(file, path, 'has the extents '//shape_text(found)//', not '//shape_text(extents), &
        1, error)
      return
    end if
    if (product(extents) == 0) return
    dataset = no_handle
    buffer = address
    call h5dopen_f(file%id, path, dataset, status)
    if (status == 0) call h5dread_f(dataset, value_type, buffer, status)
    call release(dataset, status)
    call check(file, path, 'cannot be read', status, error)
  end subroutine read_values

  !> Extents of a dataset, in Fortran order; none for a scalar.
  subroutine read_shape(file, path, extents, error)
    !> Open.
    type(hdf5_file_type), intent(in) :: file
    !> From the root.
    character(len=*), intent(in) :: path
    !> One a dimension, in Fortran order; none: a scalar.
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
    call release(space, status)
    call release(dataset, status)
    call check(file, path, 'cannot be read', status, error)
  end subroutine read_shape

  subroutine read_text(file, path, values, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(out) :: values
    type(error_type), allocatable, intent(out) :: error
    type(c_ptr), target :: address
    type(c_ptr) :: buffer
    integer(hid_t) :: dataset, text_type, space
    integer :: status, freed

    dataset = no_handle
    text_type = no_handle
    space = no_handle
    address = c_null_ptr
    buffer = c_loc(address)
    values = ''
    call h5dopen_f(file%id, path, dataset, status)
    if (status == 0) call h5dget_type_f(dataset, text_type, status)
    if (status == 0) call h5dget_space_f(dataset, space, status)
    if (status == 0) then
      if (.not. is_text(text_type, space)) status = -1
    end if
    if (status == 0) call h5dread_f(dataset, text_type, buffer, status)
    if (status == 0) then
      values = text_at(address)
      call h5dvlen_reclaim_f(text_type, space, h5p_default_f, buffer, freed)
    end if
    call release(space, status)
    call release(text_type, status)
    call release(dataset, status)
    call check(file, path, 'cannot be read as a text', status, error)
  end subroutine read_text

  !> Extents as a reader sees them: 3 x 4.
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

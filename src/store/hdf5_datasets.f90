!> Datasets of HDF5: numbers of any rank, and texts.
!>
!> All ranks of a type go through one procedure, as an address and extents. Extents are in Fortran
!> order; readers in C or Python see them reversed.
module battery_hdf5_datasets
  use, intrinsic :: iso_c_binding, only: c_ptr, c_loc, c_null_ptr, c_null_char, c_char, c_associated
  use hdf5, only: hid_t, hsize_t, size_t, h5dcreate_f, h5dwrite_f, h5pcreate_f, h5pset_chunk_f, &
    h5pset_shuffle_f, h5pset_deflate_f, h5tget_size_f, h5zfilter_avail_f, h5kind_to_type
  use hdf5, only: h5p_default_f, h5p_dataset_create_f, h5z_filter_deflate_f, h5_real_kind, &
    h5_integer_kind
  use battery_kinds, only: dp, int8, int32, int64
  use battery_error, only: error_type
  use battery_hdf5_file, only: hdf5_file_type, release, check, no_handle
  use battery_hdf5_attributes, only: add_text, new_space, new_text_type
  implicit none (type, external)
  private
  public :: write_dataset, reserve_dataset

  !> Writes a scalar or an array, `values`, as a new dataset at the `path` of an open `file`;
  !> `units` and `long_name` become its attributes. Large ones are compressed.
  interface write_dataset
    module procedure :: write_real64, write_int8, write_int32, write_int64, write_text
  end interface write_dataset

  !> Datasets above so many bytes are compressed, in pieces of at most as many.
  integer(int64), parameter :: large = 1024_int64**2
  integer, parameter :: deflate_level = 4

contains

  subroutine write_real64(file, path, values, units, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, units, long_name
    real(dp), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call write_values(file, path, h5kind_to_type(dp, h5_real_kind), c_loc(values), &
      shape(values, hsize_t), units, long_name, error)
  end subroutine write_real64

  subroutine write_int8(file, path, values, units, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, units, long_name
    integer(int8), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call write_values(file, path, h5kind_to_type(int8, h5_integer_kind), c_loc(values), &
      shape(values, hsize_t), units, long_name, error)
  end subroutine write_int8

  subroutine write_int32(file, path, values, units, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, units, long_name
    integer(int32), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call write_values(file, path, h5kind_to_type(int32, h5_integer_kind), c_loc(values), &
      shape(values, hsize_t), units, long_name, error)
  end subroutine write_int32

  subroutine write_int64(file, path, values, units, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, units, long_name
    integer(int64), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call write_values(file, path, h5kind_to_type(int64, h5_integer_kind), c_loc(values), &
      shape(values, hsize_t), units, long_name, error)
  end subroutine write_int64

  subroutine write_text(file, path, values, units, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, values, units, long_name
    type(error_type), allocatable, intent(out) :: error
    character(len=:, kind=c_char), allocatable, target :: letters
    type(c_ptr), target :: address
    integer(hid_t) :: text_type
    integer :: status

    letters = values//c_null_char
    address = c_loc(letters)
    call new_text_type(text_type, status)
    if (status == 0) call write_values(file, path, text_type, c_loc(address), &
      [integer(hsize_t) ::], units, long_name, error)
    call release(text_type, status)
    if (.not. allocated(error)) call check(file, path, 'cannot be written', status, error)
  end subroutine write_text

  !> A new dataset of rank 1 of 32-bit integers that are never written and take no room.
  subroutine reserve_dataset(file, path, length, units, long_name, error)
    !> Open, to be written.
    type(hdf5_file_type), intent(in) :: file
    !> From the root, in groups that are there.
    character(len=*), intent(in) :: path
    !> In bytes.
    integer, intent(in) :: length
    !> Attributes of the same names.
    character(len=*), intent(in) :: units, long_name
    type(error_type), allocatable, intent(out) :: error

    call write_values(file, path, h5kind_to_type(int32, h5_integer_kind), c_null_ptr, &
      [int(length, hsize_t)], units, long_name, error)
  end subroutine reserve_dataset

  !> A new dataset from the values at `address`, or without values if that is null.
  subroutine write_values(file, path, value_type, address, extents, units, long_name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(hid_t), intent(in) :: value_type
    type(c_ptr), intent(in) :: address
    integer(hsize_t), intent(in) :: extents(:)
    character(len=*), intent(in) :: units, long_name
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: space, layout, dataset
    integer :: status

    layout = no_handle
    dataset = no_handle
    call new_space(extents, space, status)
    if (status == 0) call new_layout(value_type, extents, c_associated(address), layout, status)
    if (status == 0) call h5dcreate_f(file%id, path, value_type, space, dataset, status, &
      dcpl_id=layout)
    if (status == 0 .and. c_associated(address) .and. product(extents) > 0) &
      call h5dwrite_f(dataset, value_type, address, status)
    if (status == 0) call add_text(dataset, 'units', units, status)
    if (status == 0) call add_text(dataset, 'long_name', long_name, status)
    call release(dataset, status)
    call release(layout, status)
    call release(space, status)
    call check(file, path, 'cannot be written', status, error)
  end subroutine write_values

  !> How a dataset lies in the file: as it is, or, if large, in compressed pieces.
  subroutine new_layout(value_type, extents, has_values, layout, status)
    integer(hid_t), intent(in) :: value_type
    integer(hsize_t), intent(in) :: extents(:)
    logical, intent(in) :: has_values
    integer(hid_t), intent(out) :: layout
    integer, intent(out) :: status
    integer(hsize_t) :: piece(size(extents))
    integer(size_t) :: bytes
    integer :: k
    logical :: can_deflate

    layout = no_handle
    call h5pcreate_f(h5p_dataset_create_f, layout, status)
    if (status == 0) call h5tget_size_f(value_type, bytes, status)
    if (status /= 0 .or. .not. has_values) return
    if (product(extents)*bytes <= large) return
    call h5zfilter_avail_f(h5z_filter_deflate_f, can_deflate, status)
    if (status /= 0 .or. .not. can_deflate) return
    piece = extents
    do k = size(piece), 1, -1
      do while (product(piece)*bytes > large .and. piece(k) > 1)
        piece(k) = (piece(k) + 1)/2
      end do
    end do
    call h5pset_chunk_f(layout, size(piece), piece, status)
    if (status == 0) call h5pset_shuffle_f(layout, status)
    if (status == 0) call h5pset_deflate_f(layout, deflate_level, status)
  end subroutine new_layout

end module battery_hdf5_datasets

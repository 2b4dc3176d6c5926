!> Attributes of HDF5: numbers of any rank, and texts.
!>
!> Texts are of variable length, in UTF-8: then they lie apart from the attribute, which has room
!> for no more than 64 KiB, and readers take them for texts and not for bytes.
module battery_hdf5_attributes
  use, intrinsic :: iso_c_binding, only: c_ptr, c_loc, c_null_ptr, c_null_char, c_char
  use hdf5, only: hid_t, hsize_t, h5oopen_f, h5acreate_f, h5aopen_f, h5awrite_f, h5aread_f, &
    h5aget_type_f, h5aget_space_f, h5screate_f, h5screate_simple_f, h5sget_simple_extent_ndims_f, &
    h5tcopy_f, h5tset_cset_f, h5tis_variable_str_f, h5dvlen_reclaim_f, h5kind_to_type
  use hdf5, only: h5s_scalar_f, h5t_string, h5t_cset_utf8_f, h5p_default_f, h5_real_kind, &
    h5_integer_kind
  use battery_kinds, only: dp, int32, int64
  use battery_error, only: error_type
  use battery_paths, only: text_at
  use battery_hdf5_file, only: hdf5_file_type, release, check, no_handle
  implicit none (type, external)
  private
  public :: write_attribute, read_attribute
  public :: add_text, new_space, new_text_type, is_text

  !> Adds an attribute `name` to what stands at the `path`, `/` for the file, of an open `file`: a
  !> number, a list of them, or a text in `values`.
  interface write_attribute
    module procedure :: write_real64_attribute, write_int32_attribute, write_int64_attribute, &
      write_text_attribute
  end interface write_attribute

  !> Reads the attribute `name` of what stands at the `path`, `/` for the file, of an open `file`: a
  !> single number, or a text, in `value`.
  interface read_attribute
    module procedure :: read_real64_attribute, read_int32_attribute, read_text_attribute
  end interface read_attribute

contains

  subroutine write_real64_attribute(file, path, name, values, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    real(dp), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call write_attribute_values(file, path, name, h5kind_to_type(dp, h5_real_kind), &
      c_loc(values), shape(values, hsize_t), error)
  end subroutine write_real64_attribute

  subroutine write_int32_attribute(file, path, name, values, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(int32), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call write_attribute_values(file, path, name, h5kind_to_type(int32, h5_integer_kind), &
      c_loc(values), shape(values, hsize_t), error)
  end subroutine write_int32_attribute

  subroutine write_int64_attribute(file, path, name, values, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(int64), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(out) :: error

    call write_attribute_values(file, path, name, h5kind_to_type(int64, h5_integer_kind), &
      c_loc(values), shape(values, hsize_t), error)
  end subroutine write_int64_attribute

  subroutine write_text_attribute(file, path, name, values, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name, values
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: object
    integer :: status

    object = no_handle
    call h5oopen_f(file%id, path, object, status)
    if (status == 0) call add_text(object, name, values, status)
    call release(object, status)
    call check(file, path, 'cannot be given the attribute '//name, status, error)
  end subroutine write_text_attribute

  subroutine write_attribute_values(file, path, name, value_type, address, extents, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(hid_t), intent(in) :: value_type
    type(c_ptr), intent(in) :: address
    integer(hsize_t), intent(in) :: extents(:)
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: object
    integer :: status

    object = no_handle
    call h5oopen_f(file%id, path, object, status)
    if (status == 0) call add_attribute(object, name, value_type, address, extents, status)
    call release(object, status)
    call check(file, path, 'cannot be given the attribute '//name, status, error)
  end subroutine write_attribute_values

  !> Adds an attribute to an open object.
  subroutine add_attribute(object, name, value_type, address, extents, status)
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    integer(hid_t), intent(in) :: value_type
    type(c_ptr), intent(in) :: address
    integer(hsize_t), intent(in) :: extents(:)
    integer, intent(out) :: status
    integer(hid_t) :: space, attribute

    attribute = no_handle
    call new_space(extents, space, status)
    if (status == 0) call h5acreate_f(object, name, value_type, space, attribute, status)
    if (status == 0) call h5awrite_f(attribute, value_type, address, status)
    call release(attribute, status)
    call release(space, status)
  end subroutine add_attribute

  !> Adds a text to an open object.
  subroutine add_text(object, name, text, status)
    !> Handle of a group or a dataset that is open.
    integer(hid_t), intent(in) :: object
    !> Of the attribute, and what it says.
    character(len=*), intent(in) :: name, text
    !> Negative: HDF5 has failed.
    integer, intent(out) :: status
    character(len=:, kind=c_char), allocatable, target :: letters
    type(c_ptr), target :: address
    integer(hid_t) :: text_type

    letters = text//c_null_char
    address = c_loc(letters)
    call new_text_type(text_type, status)
    if (status == 0) call add_attribute(object, name, text_type, c_loc(address), &
      [integer(hsize_t) ::], status)
    call release(text_type, status)
  end subroutine add_text

  !> A space of these extents; a scalar one if there are none.
  subroutine new_space(extents, space, status)
    !> One a dimension; none: a scalar.
    integer(hsize_t), intent(in) :: extents(:)
    !> To be closed by who asked for it.
    integer(hid_t), intent(out) :: space
    !> Negative: HDF5 has failed.
    integer, intent(out) :: status

    space = no_handle
    if (size(extents) == 0) then
      call h5screate_f(h5s_scalar_f, space, status)
    else
      call h5screate_simple_f(size(extents), extents, space, status)
    end if
  end subroutine new_space

  !> The type of texts of variable length, in UTF-8.
  subroutine new_text_type(text_type, status)
    !> To be closed by who asked for it.
    integer(hid_t), intent(out) :: text_type
    !> Negative: HDF5 has failed.
    integer, intent(out) :: status

    text_type = no_handle
    call h5tcopy_f(h5t_string, text_type, status)
    if (status == 0) call h5tset_cset_f(text_type, h5t_cset_utf8_f, status)
  end subroutine new_text_type

  subroutine read_real64_attribute(file, path, name, value, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    real(dp), intent(out), target :: value
    type(error_type), allocatable, intent(out) :: error

    value = 0.0_dp
    call read_attribute_value(file, path, name, h5kind_to_type(dp, h5_real_kind), &
      c_loc(value), error)
  end subroutine read_real64_attribute

  subroutine read_int32_attribute(file, path, name, value, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(int32), intent(out), target :: value
    type(error_type), allocatable, intent(out) :: error

    value = 0
    call read_attribute_value(file, path, name, h5kind_to_type(int32, h5_integer_kind), &
      c_loc(value), error)
  end subroutine read_int32_attribute

  subroutine read_text_attribute(file, path, name, value, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    character(len=:), allocatable, intent(out) :: value
    type(error_type), allocatable, intent(out) :: error
    type(c_ptr), target :: address
    type(c_ptr) :: buffer
    integer(hid_t) :: object, attribute, text_type, space
    integer :: status, freed

    text_type = no_handle
    address = c_null_ptr
    buffer = c_loc(address)
    value = ''
    call open_attribute(file, path, name, object, attribute, space, status)
    if (status == 0) call h5aget_type_f(attribute, text_type, status)
    if (status == 0) then
      if (.not. is_text(text_type, space)) status = -1
    end if
    if (status == 0) call h5aread_f(attribute, text_type, buffer, status)
    if (status == 0) then
      value = text_at(address)
      call h5dvlen_reclaim_f(text_type, space, h5p_default_f, buffer, freed)
    end if
    call release(text_type, status)
    call release(space, status)
    call release(attribute, status)
    call release(object, status)
    call check(file, path, 'has no text attribute '//name, status, error)
  end subroutine read_text_attribute

  !> A single number, into the memory at `address`.
  subroutine read_attribute_value(file, path, name, value_type, address, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(hid_t), intent(in) :: value_type
    type(c_ptr), intent(in) :: address
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: object, attribute, space
    integer :: dimensions, status
    type(c_ptr) :: buffer

    buffer = address
    call open_attribute(file, path, name, object, attribute, space, status)
    if (status == 0) call h5sget_simple_extent_ndims_f(space, dimensions, status)
    if (status == 0) then
      if (dimensions > 0) status = -1
    end if
    if (status == 0) call h5aread_f(attribute, value_type, buffer, status)
    call release(space, status)
    call release(attribute, status)
    call release(object, status)
    call check(file, path, 'has no attribute '//name//' that is one number', status, error)
  end subroutine read_attribute_value

  subroutine open_attribute(file, path, name, object, attribute, space, status)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(hid_t), intent(out) :: object, attribute, space
    integer, intent(out) :: status

    object = no_handle
    attribute = no_handle
    space = no_handle
    call h5oopen_f(file%id, path, object, status)
    if (status == 0) call h5aopen_f(object, name, attribute, status)
    if (status == 0) call h5aget_space_f(attribute, space, status)
  end subroutine open_attribute

  !> Whether something of this type and space is one text of variable length.
  function is_text(value_type, space)
    !> Handles of what is stored.
    integer(hid_t), intent(in) :: value_type, space
    logical :: is_text
    integer :: dimensions, status

    call h5tis_variable_str_f(value_type, is_text, status)
    if (status /= 0) is_text = .false.
    call h5sget_simple_extent_ndims_f(space, dimensions, status)
    is_text = is_text .and. status == 0 .and. dimensions == 0
  end function is_text

end module battery_hdf5_attributes

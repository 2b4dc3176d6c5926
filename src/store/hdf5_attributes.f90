!> Attributes of HDF5: numbers of any rank, and texts.
!>
!> Texts have variable length and UTF-8: then they are stored outside the attribute, which is
!> limited to 64 KiB, and readers take them for texts and not for bytes.
module battery_hdf5_attributes
  use, intrinsic :: iso_c_binding, only: c_ptr, c_loc, c_null_ptr, c_null_char, c_char, c_int
  use hdf5, only: hid_t, hsize_t, h5acreate_by_name_f, h5aopen_by_name_f, h5awrite_f, h5aread_f, &
    h5aget_type_f, h5aget_space_f, h5screate_simple_f, h5tcopy_f, h5tset_cset_f, &
    h5tis_variable_str_f, h5sget_simple_extent_npoints_f, h5dvlen_reclaim_f, &
    h5kind_to_type
  use hdf5, only: h5t_string, h5t_cset_utf8_f, h5p_default_f, h5_real_kind, h5_integer_kind
  use battery_error, only: error_type
  use battery_paths, only: c_text_at
  use battery_hdf5_file, only: hdf5_file_type, release_handle, check_status, check_links, no_handle
  implicit none (type, external)
  private
  public :: write_attribute, write_text_attribute, read_text_attribute
  public :: array_view_type, array_view_of

  !> Description of values in memory for HDF5.
  type :: array_view_type
    integer(hid_t) :: value_type = no_handle
    type(c_ptr) :: address = c_null_ptr
    !> Extents, one per dimension, in Fortran order; of size 0 for a scalar.
    integer(hsize_t), allocatable :: extents(:)
  end type array_view_type

  interface
    !> Determines whether the items of `values` are reals, or integers of 32 or 64 bits, and the
    !> bytes of one item.
    subroutine describe_array(values, is_real, is_integer, bytes) bind(c, name='battery_describe')
      import :: c_int
      implicit none (type, external)
      type(*), intent(in) :: values(..)
      integer(c_int), intent(out) :: is_real, is_integer, bytes
    end subroutine describe_array
  end interface

contains

  !> Address, HDF5 type and extents of a scalar or an array.
  function array_view_of(values) result(memory)
    !> Reals, or integers of 32 or 64 bits.
    type(*), intent(in), target, contiguous :: values(..)
    type(array_view_type) :: memory
    integer(c_int) :: is_real, is_integer, bytes

    call describe_array(values, is_real, is_integer, bytes)
    if (is_real == 1) memory%value_type = h5kind_to_type(int(bytes), h5_real_kind)
    if (is_integer == 1) memory%value_type = h5kind_to_type(int(bytes), h5_integer_kind)
    memory%address = c_loc(values)
    ! gfortran 11 gives an empty array the extent -1 here.
    memory%extents = max(shape(values, hsize_t), 0_hsize_t)
  end function array_view_of

  !> Adds an attribute that is a number or an array of numbers; does nothing after an error, or to a
  !> file that is read.
  subroutine write_attribute(file, path, name, values, error)
    !> File, open for writing.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the object that gets the attribute, `/` for the file; name of the attribute.
    character(len=*), intent(in) :: path, name
    !> Scalar or array, as `array_view_of` takes it.
    type(*), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(inout) :: error

    if (file%is_new .and. .not. allocated(error)) &
      call add_attribute(file, path, name, array_view_of(values), error)
  end subroutine write_attribute

  !> Adds an attribute that is a text; does nothing after an error, or to a file that is read.
  subroutine write_text_attribute(file, path, name, text, error)
    !> File, open for writing.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the object that gets the attribute, `/` for the file; its name and its text.
    character(len=*), intent(in) :: path, name, text
    type(error_type), allocatable, intent(inout) :: error
    character(len=:, kind=c_char), allocatable, target :: letters
    type(c_ptr), target :: address
    type(array_view_type) :: memory
    integer :: status

    if (allocated(error) .or. .not. file%is_new) return
    letters = text//c_null_char
    address = c_loc(letters)
    memory%address = c_loc(address)
    allocate (memory%extents(0))
    call h5tcopy_f(h5t_string, memory%value_type, status)
    if (status == 0) call h5tset_cset_f(memory%value_type, h5t_cset_utf8_f, status)
    call add_attribute(file, path, name, memory, error)
    call release_handle(memory%value_type, status)
  end subroutine write_text_attribute

  !> Adds an attribute from a description of its values.
  subroutine add_attribute(file, path, name, memory, error)
    class(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    type(array_view_type), intent(in) :: memory
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: space, attribute
    integer :: status

    attribute = no_handle
    space = no_handle
    call h5screate_simple_f(size(memory%extents), memory%extents, space, status)
    if (status == 0) call h5acreate_by_name_f(file%id, path, name, memory%value_type, space, &
      attribute, status)
    if (status == 0) call h5awrite_f(attribute, memory%value_type, memory%address, status)
    call release_handle(attribute, status)
    call release_handle(space, status)
    call check_status(file, path, 'cannot be given the attribute '//name, status, error)
  end subroutine add_attribute

  !> Reads an attribute that is one text; after an error it does nothing, and the text is empty.
  subroutine read_text_attribute(file, path, name, text, error)
    !> File, open.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the object that has the attribute, `/` for the file; name of the attribute.
    character(len=*), intent(in) :: path, name
    !> Value of the attribute.
    character(len=:), allocatable, intent(out) :: text
    type(error_type), allocatable, intent(inout) :: error
    type(c_ptr), target :: address
    type(c_ptr) :: buffer
    integer(hid_t) :: attribute, text_type, space
    integer(hsize_t) :: texts
    integer :: status, freed
    logical :: is_text

    text = ''
    call check_links(file, path, error)
    if (allocated(error)) return
    attribute = no_handle
    text_type = no_handle
    space = no_handle
    address = c_null_ptr
    buffer = c_loc(address)
    call h5aopen_by_name_f(file%id, path, name, attribute, status)
    if (status == 0) call h5aget_space_f(attribute, space, status)
    if (status == 0) call h5aget_type_f(attribute, text_type, status)
    if (status == 0) call h5tis_variable_str_f(text_type, is_text, status)
    if (status == 0) call h5sget_simple_extent_npoints_f(space, texts, status)
    if (status == 0 .and. (.not. is_text .or. texts /= 1)) status = -1
    if (status == 0) call h5aread_f(attribute, text_type, buffer, status)
    if (status == 0) then
      text = c_text_at(address)
      call h5dvlen_reclaim_f(text_type, space, h5p_default_f, buffer, freed)
    end if
    call release_handle(text_type, status)
    call release_handle(space, status)
    call release_handle(attribute, status)
    call check_status(file, path, 'has no text attribute '//name, status, error)
  end subroutine read_text_attribute

end module battery_hdf5_attributes

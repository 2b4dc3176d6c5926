!> Datasets of HDF5: numbers of any rank, and the dimension scales that identify their dimensions to
!> readers.
!>
!> All types and ranks are passed to one procedure, as an address and extents. Extents are in
!> Fortran order; readers in C or Python see them reversed.
!>
!> A dataset that is read must be stored in this file, and have the expected extents.
module battery_hdf5_datasets
  use, intrinsic :: iso_c_binding, only: c_associated, c_char, c_int, c_int64_t, c_null_char, &
    c_null_ptr, c_ptr
  use hdf5, only: hid_t, hsize_t, size_t, h5dcreate_f, h5dopen_f, h5dread_f, h5dwrite_f, &
    h5dget_space_f, h5sget_simple_extent_dims_f, h5sget_simple_extent_ndims_f, h5pcreate_f, &
    h5pset_chunk_f, h5pset_shuffle_f, h5pset_deflate_f, h5pset_fill_value_f, h5screate_simple_f, &
    h5sselect_hyperslab_f, h5tget_size_f, h5zfilter_avail_f, h5kind_to_type
  use hdf5, only: h5dget_create_plist_f, h5pget_layout_f, h5pget_external_count_f, &
    h5p_dataset_create_f, h5s_select_set_f, h5s_all_f, h5z_filter_deflate_f, h5d_compact_f, &
    h5d_contiguous_f, h5d_chunked_f, h5_integer_kind
  use battery_kinds, only: int32, int64
  use battery_error, only: error_type
  use battery_hdf5_file, only: hdf5_file_type, release_handle, check_status, check_links, no_handle
  use battery_hdf5_attributes, only: array_view_type, array_view_of, write_text_attribute
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: serialize_dataset, write_dataset, write_scale, write_dimension
  public :: dataset_type, open_dataset, extents_of, prepare_dataset, serialize_slab, release_dataset

  !> A dataset whose parts are written or read one by one.
  type :: dataset_type
    private
    character(len=:), allocatable :: path
    integer(hid_t) :: id = no_handle
  end type dataset_type

  !> Datasets larger than this number of bytes are compressed, in chunks of at most this size. It is
  !> the size of HDF5's chunk cache: a larger chunk would be compressed again for each column
  !> written.
  integer(int64), parameter :: large = 1024_int64**2
  integer, parameter :: deflate_level = 4

  ! The C interface of dimension scales: the name of the library of their Fortran interface depends
  ! on the build of HDF5 (hdf5hl_fortran, hdf5_hl_fortran).
  interface
    integer(c_int) function c_set_scale(dataset, name) bind(c, name='H5DSset_scale')
      import :: c_char, c_int, c_int64_t
      implicit none (type, external)
      integer(c_int64_t), value, intent(in) :: dataset
      character(kind=c_char), intent(in) :: name(*)
    end function c_set_scale

    !> `dimension` counts from 0, the slowest first.
    integer(c_int) function c_attach_scale(dataset, scale, dimension) &
        bind(c, name='H5DSattach_scale')
      import :: c_int, c_int64_t
      implicit none (type, external)
      integer(c_int64_t), value, intent(in) :: dataset, scale
      integer(c_int), value, intent(in) :: dimension
    end function c_attach_scale
  end interface

contains

  !> Writes a whole dataset to a new file, or reads it from a file, so that one procedure declares
  !> the contents for both. Does nothing after an error.
  subroutine serialize_dataset(file, path, values, units, long_name, error, scales)
    !> File, open.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the dataset in the file, from the root, in a group that is there.
    character(len=*), intent(in) :: path
    !> Scalar or array, as `array_view_of` takes it.
    type(*), intent(inout), target, contiguous :: values(..)
    !> Attributes of the same names, of a new file.
    character(len=*), intent(in) :: units, long_name
    type(error_type), allocatable, intent(inout) :: error
    !> Paths of its dimension scales, one per dimension, in Fortran order.
    character(len=*), intent(in) :: scales(:)

    call serialize_whole(file, path, array_view_of(values), units, long_name, error, scales)
  end subroutine serialize_dataset

  !> As `serialize_dataset`, for values that are only written, also without dimension scales.
  subroutine write_dataset(file, path, values, units, long_name, error, scales)
    !> New file.
    class(hdf5_file_type), intent(in) :: file
    !> As above.
    character(len=*), intent(in) :: path, units, long_name
    type(*), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), intent(in), optional :: scales(:)

    call serialize_whole(file, path, array_view_of(values), units, long_name, error, scales)
  end subroutine write_dataset

  !> Writes a new dataset of rank 1 that is a dimension scale, named for the last part of its path.
  !> Does nothing after an error.
  subroutine write_scale(file, path, values, units, long_name, error)
    !> New file.
    class(hdf5_file_type), intent(in) :: file
    !> As above.
    character(len=*), intent(in) :: path, units, long_name
    !> The coordinates, one dimension.
    type(*), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(inout) :: error

    call serialize_whole(file, path, array_view_of(values), units, long_name, error, &
      scale_name=path(index(path, '/', back=.true.) + 1:))
  end subroutine write_scale

  !> Makes a dimension scale without coordinates, marked as in netCDF; it has no data, and occupies
  !> no space. Does nothing after an error.
  subroutine write_dimension(file, path, length, long_name, error)
    !> New file.
    class(hdf5_file_type), intent(in) :: file
    !> As above.
    character(len=*), intent(in) :: path, long_name
    !> Length of the dimension.
    integer, intent(in) :: length
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), parameter :: mark = 'This is a netCDF dimension but not a netCDF variable.'
    character(len=len(mark) + 10) :: name

    write (name, '(a, i10)') mark, length
    call serialize_whole(file, path, array_view_type(h5kind_to_type(int32, h5_integer_kind), &
      c_null_ptr, [int(length, hsize_t)]), '1', long_name, error, scale_name=name)
  end subroutine write_dimension

  !> Writes or reads a whole dataset. Does nothing after an error.
  subroutine serialize_whole(file, path, memory, units, long_name, error, scales, scale_name)
    class(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, units, long_name
    !> Values in memory; without an address, only the dataset is made.
    type(array_view_type), intent(in) :: memory
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), intent(in), optional :: scales(:)
    !> Makes it a dimension scale of that name.
    character(len=*), intent(in), optional :: scale_name
    type(dataset_type) :: dataset

    call open_or_make(file, path, memory, .false., units, long_name, error, dataset, scales, &
      scale_name)
    if (c_associated(memory%address) .and. product(memory%extents) > 0) &
      call serialize_view(file, dataset, memory, h5s_all_f, h5s_all_f, error)
    call release_dataset(file, dataset, error)
  end subroutine serialize_whole

  !> Makes a dataset with fill values in a new file, or opens and checks one of a file that is read,
  !> so that one procedure declares the contents for both; `serialize_slab` then writes or reads
  !> parts of it. Does nothing after an error.
  subroutine prepare_dataset(file, path, extents, unknown, units, long_name, error, scales, dataset)
    !> File, open.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the dataset in the file, from the root.
    character(len=*), intent(in) :: path
    !> Extents of the dataset, in Fortran order.
    integer, intent(in) :: extents(:)
    !> Fill value, one number of the dataset's type: it stands for unknown values.
    type(*), intent(in), target, contiguous :: unknown(..)
    !> Attributes of the same names, of a new file.
    character(len=*), intent(in) :: units, long_name
    type(error_type), allocatable, intent(inout) :: error
    !> Paths of its dimension scales, in Fortran order.
    character(len=*), intent(in) :: scales(:)
    !> Open dataset, to be released with `release_dataset`.
    type(dataset_type), intent(inout) :: dataset
    type(array_view_type) :: memory

    memory = array_view_of(unknown)
    memory%extents = int(extents, hsize_t)
    call open_or_make(file, path, memory, .true., units, long_name, error, dataset, scales)
  end subroutine prepare_dataset

  !> Writes values to a part of a dataset of a new file, or reads them from a file. Parts should be
  !> passed in the order of the dataset, which fills one chunk after the other: HDF5 keeps one chunk
  !> in memory, and compresses it when the next one begins. Does nothing after an error.
  subroutine serialize_slab(file, dataset, values, extents, first, error)
    !> File, open.
    class(hdf5_file_type), intent(in) :: file
    !> Dataset from `prepare_dataset`.
    type(dataset_type), intent(in) :: dataset
    !> Array of as many values as the part has; HDF5 converts integers and reals.
    type(*), intent(inout), target, contiguous :: values(..)
    !> Extents of the part, and indices of its first value, from 1, in Fortran order.
    integer, intent(in) :: extents(:), first(:)
    type(error_type), allocatable, intent(inout) :: error
    integer(hid_t) :: space, part
    integer :: status

    if (allocated(error)) return
    space = no_handle
    part = no_handle
    call h5dget_space_f(dataset%id, space, status)
    if (status == 0) call h5sselect_hyperslab_f(space, h5s_select_set_f, &
      int(first - 1, hsize_t), int(extents, hsize_t), status)
    if (status == 0) call h5screate_simple_f(size(extents), int(extents, hsize_t), part, status)
    if (status /= 0) part = no_handle
    call serialize_view(file, dataset, array_view_of(values), part, space, error)
    call release_handle(part, status)
    call release_handle(space, status)
  end subroutine serialize_slab

  !> Writes values to the selected part of a dataset, or reads them. Does nothing after an error.
  subroutine serialize_view(file, dataset, memory, part, space, error)
    class(hdf5_file_type), intent(in) :: file
    type(dataset_type), intent(in) :: dataset
    type(array_view_type), intent(in) :: memory
    !> Data spaces of the values in memory, and of the dataset with the part selected.
    integer(hid_t), intent(in) :: part, space
    type(error_type), allocatable, intent(inout) :: error
    type(c_ptr) :: address
    integer :: status

    if (allocated(error)) return
    address = memory%address
    if (file%is_new) then
      call h5dwrite_f(dataset%id, memory%value_type, address, status, part, space)
    else
      call h5dread_f(dataset%id, memory%value_type, address, status, part, space)
    end if
    call check_status(file, dataset%path, merge('cannot be written', 'cannot be read   ', &
      file%is_new), status, error)
  end subroutine serialize_view

  !> Closes a dataset; one that is not open is no error.
  subroutine release_dataset(file, dataset, error)
    !> File that the dataset is in, still open.
    class(hdf5_file_type), intent(in) :: file
    type(dataset_type), intent(inout) :: dataset
    !> The last chunk could not be written to the file; an earlier error is kept.
    type(error_type), allocatable, intent(inout) :: error
    integer :: status

    status = 0
    call release_handle(dataset%id, status)
    dataset%id = no_handle
    if (.not. allocated(error) .and. allocated(dataset%path)) &
      call check_status(file, dataset%path, 'cannot be closed', status, error)
  end subroutine release_dataset

  !> Opens a dataset, if it is stored in the file itself. This is checked before anything else: a
  !> query of the extents of a virtual dataset would open other files. Does nothing after an error.
  subroutine open_dataset(file, path, dataset, error)
    !> File, open for reading.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the dataset in the file, from the root.
    character(len=*), intent(in) :: path
    !> Dataset, open, to be released with `release_dataset`.
    type(dataset_type), intent(out) :: dataset
    type(error_type), allocatable, intent(inout) :: error
    integer(hid_t) :: layout
    integer :: status, way, others

    dataset%path = path
    layout = no_handle
    call check_links(file, path, error)
    if (allocated(error)) return
    call h5dopen_f(file%id, path, dataset%id, status)
    if (status == 0) call h5dget_create_plist_f(dataset%id, layout, status)
    if (status == 0) call h5pget_layout_f(layout, way, status)
    if (status == 0) call h5pget_external_count_f(layout, others, status)
    call check_status(file, path, 'is no dataset', status, error)
    if (status == 0 .and. (others > 0 .or. all(way /= [h5d_compact_f, h5d_contiguous_f, &
      h5d_chunked_f]))) call check_status(file, path, 'does not lie in the file itself', 1, error)
    call release_handle(layout, status)
  end subroutine open_dataset

  !> Text for extents, in the order of C and Python.
  pure function extents_text(extents) result(text)
    !> Extents in Fortran order; below 0: the dataset has another rank.
    integer(hsize_t), intent(in) :: extents(:)
    character(len=:), allocatable :: text
    integer :: k

    text = ''
    do k = size(extents), 1, -1
      text = text//to_text(int(extents(k), int64))
      if (k > 1) text = text//' x '
    end do
    if (any(extents < 0)) text = 'of another number'
  end function extents_text

  !> Extents of an open dataset, in Fortran order; -1 if it has another rank.
  function extents_of(dataset, rank) result(extents)
    !> Dataset, open, or with an error on opening.
    type(dataset_type), intent(in) :: dataset
    !> Expected number of dimensions.
    integer, intent(in) :: rank
    integer(hsize_t) :: extents(rank), most(rank)
    integer(hid_t) :: space
    integer :: status, found

    extents = -1
    space = no_handle
    found = -1
    call h5dget_space_f(dataset%id, space, status)
    if (status == 0) call h5sget_simple_extent_ndims_f(space, found, status)
    if (status == 0 .and. found == rank) &
      call h5sget_simple_extent_dims_f(space, extents, most, status)
    call release_handle(space, status)
  end function extents_of

  !> Makes a dataset in a new file, or opens and checks one of a file that is read. Does nothing
  !> after an error.
  subroutine open_or_make(file, path, memory, fills, units, long_name, error, dataset, scales, &
    scale_name)
    class(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, units, long_name
    !> Type and extents of the dataset; its address is that of the fill value if it `fills`.
    type(array_view_type), intent(in) :: memory
    logical, intent(in) :: fills
    type(error_type), allocatable, intent(inout) :: error
    type(dataset_type), intent(inout) :: dataset
    character(len=*), intent(in), optional :: scales(:), scale_name
    integer(hid_t) :: space, layout
    integer(hsize_t) :: extents(size(memory%extents))
    integer :: status

    if (allocated(error)) return
    if (.not. file%is_new) then
      call open_dataset(file, path, dataset, error)
      if (allocated(error)) return
      extents = extents_of(dataset, size(extents))
      if (any(extents /= memory%extents)) call check_status(file, path, 'has the dimensions ' &
        //extents_text(extents)//'; by the namelist in the file they are ' &
        //extents_text(memory%extents), 1, error)
      return
    end if
    dataset%path = path
    layout = no_handle
    call h5screate_simple_f(size(memory%extents), memory%extents, space, status)
    if (status == 0) call new_layout(memory, layout, status)
    if (status == 0 .and. fills) &
      call h5pset_fill_value_f(layout, memory%value_type, memory%address, status)
    if (status == 0) call h5dcreate_f(file%id, path, memory%value_type, space, dataset%id, status, &
      dcpl_id=layout)
    if (status == 0 .and. present(scale_name)) &
      status = c_set_scale(dataset%id, scale_name//c_null_char)
    if (present(scales)) call attach_scales(file, dataset%id, scales, status)
    call release_handle(layout, status)
    call release_handle(space, status)
    call check_status(file, path, 'cannot be written', status, error)
    call write_text_attribute(file, path, 'units', units, error)
    call write_text_attribute(file, path, 'long_name', long_name, error)
  end subroutine open_or_make

  !> Attaches dimension scales to a dataset. HDF5 counts dimensions in the reverse order of Fortran.
  subroutine attach_scales(file, dataset, scales, status)
    class(hdf5_file_type), intent(in) :: file
    integer(hid_t), intent(in) :: dataset
    character(len=*), intent(in) :: scales(:)
    integer, intent(inout) :: status
    integer(hid_t) :: scale
    integer :: dimension

    do dimension = 1, size(scales)
      scale = no_handle
      if (status == 0) call h5dopen_f(file%id, trim(scales(dimension)), scale, status)
      if (status == 0) &
        status = c_attach_scale(dataset, scale, int(size(scales) - dimension, c_int))
      call release_handle(scale, status)
    end do
  end subroutine attach_scales

  !> Makes the layout of a dataset: contiguous, or, if it is large, compressed chunks.
  subroutine new_layout(memory, layout, status)
    !> Values in memory, with the extents of the dataset.
    type(array_view_type), intent(in) :: memory
    integer(hid_t), intent(out) :: layout
    integer, intent(out) :: status
    integer(hsize_t) :: piece(size(memory%extents))
    integer(size_t) :: bytes
    integer :: k
    logical :: can_deflate

    layout = no_handle
    call h5pcreate_f(h5p_dataset_create_f, layout, status)
    if (status == 0) call h5tget_size_f(memory%value_type, bytes, status)
    if (status /= 0 .or. .not. c_associated(memory%address)) return
    piece = memory%extents
    if (product(piece)*bytes <= large) return
    call h5zfilter_avail_f(h5z_filter_deflate_f, can_deflate, status)
    if (status /= 0 .or. .not. can_deflate) return
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

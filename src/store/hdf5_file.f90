!> An HDF5 file: its groups, its attributes, and its datasets, with the dimension scales that
!> identify their dimensions to readers. Every status is checked, and an error names the file and
!> the path.
!>
!> A path is absolute, and its groups exist already. Numbers of all types and ranks are passed to
!> one procedure, as a type, an address and extents. Extents are in Fortran order; readers in C or
!> Python see them reversed. Texts are attributes of variable length and UTF-8: then they are stored
!> outside the attribute, which is limited to 64 KiB, and readers take them for texts and not for
!> bytes.
!>
!> A new file is made in memory and written to disk when it is closed: after a failed write HDF5
!> crashes when it closes the file. Its bytes are written from the memory of HDF5 without a copy,
!> followed by the checksum footer.
!>
!> Of a file that is read no object is opened before `check_links` found that it is stored in this
!> file, and no filter is loaded from elsewhere. A dataset must have the expected extents.
module battery_hdf5_file
  use, intrinsic :: iso_c_binding, only: c_associated, c_char, c_f_pointer, c_int, c_int64_t, &
    c_loc, c_null_char, c_null_ptr, c_ptr, c_size_t
  ! A compiler without the switches of fpm.rsp shows the next line, and stops.
  use hdf5, only: & ! type "fpm @release": "fpm build" alone has no switches (docs/install.md)
    hid_t, hsize_t, size_t, h5get_libversion_f, h5open_f, h5eset_auto_f, h5fcreate_f, h5fopen_f, &
    h5fflush_f, h5fget_file_image_f, h5gcreate_f, h5pcreate_f, h5pset_fclose_degree_f, &
    h5pset_fapl_core_f, h5idec_ref_f, h5lexists_f, h5kind_to_type, h5acreate_by_name_f, &
    h5aopen_by_name_f, h5awrite_f, h5aread_f, h5aget_type_f, h5aget_space_f, h5tcopy_f, &
    h5tget_size_f, h5tset_cset_f, h5tis_variable_str_f, h5dvlen_reclaim_f, h5dcreate_f, h5dopen_f, &
    h5dread_f, h5dwrite_f, h5dget_space_f, h5dget_type_f, h5tget_class_f, &
    h5dget_create_plist_f, h5screate_simple_f, h5sget_simple_extent_dims_f, &
    h5sget_simple_extent_ndims_f, h5sget_simple_extent_npoints_f, h5sselect_hyperslab_f, &
    h5pset_chunk_f, h5pset_shuffle_f, h5pset_deflate_f, &
    h5pset_fill_value_f, h5pget_layout_f, h5pget_external_count_f, h5zfilter_avail_f
  use hdf5, only: h5f_acc_trunc_f, h5f_acc_rdonly_f, h5f_close_strong_f, h5f_scope_global_f, &
    h5p_default_f, h5p_file_access_f, h5p_dataset_create_f, h5s_all_f, h5s_select_set_f, &
    h5t_string, h5t_cset_utf8_f, h5z_filter_deflate_f, h5d_compact_f, h5d_contiguous_f, &
    h5d_chunked_f, h5_real_kind, h5_integer_kind
  use battery_kinds, only: int8, int32, int64
  use battery_error, only: error_type, fatal_error, exit_failure, exit_bad_input
  use battery_checksum_footer, only: write_with_footer
  use battery_paths, only: c_text_at
  use battery_text, only: to_text
  implicit none (type, external)
  private
  public :: hdf5_file_type, open_file, close_file, make_group, hdf5_library
  public :: write_attribute, write_text_attribute, read_text_attribute
  public :: dataset_type, write_dataset, write_dimension, serialize_dataset, prepare_dataset, &
    serialize_slab, read_extents, close_dataset
  public :: array_view_type, array_view_of, release_handle, check_status, no_handle

  !> Value of a handle that is not open.
  integer(hid_t), parameter :: no_handle = -1_hid_t

  !> An open file.
  type :: hdf5_file_type
    character(len=:), allocatable :: name
    integer(hid_t) :: id = no_handle
    !> Whether the file is new, and so still in memory.
    logical :: is_new = .false.
  end type hdf5_file_type

  !> A dataset whose parts are written or read one by one; it is closed with its file, or before.
  type :: dataset_type
    private
    character(len=:), allocatable :: path
    integer(hid_t) :: id = no_handle
  end type dataset_type

  !> Description of values in memory for HDF5.
  type :: array_view_type
    integer(hid_t) :: value_type = no_handle
    type(c_ptr) :: address = c_null_ptr
    !> Extents, one per dimension, in Fortran order; of size 0 for a scalar.
    integer(hsize_t), allocatable :: extents(:)
  end type array_view_type

  !> Whether HDF5 has been started: only once per program, since each start makes new type handles.
  logical :: is_started = .false.

  !> Datasets larger than this number of bytes are compressed, in chunks of at most this size. It is
  !> the size of HDF5's chunk cache: a larger chunk would be compressed again for each column
  !> written.
  integer(int64), parameter :: large = 1024_int64**2
  integer, parameter :: deflate_level = 4

  ! The C interface of dimension scales is used here, since the name of the library of their Fortran
  ! interface depends on the build of HDF5 (hdf5hl_fortran, hdf5_hl_fortran).
  interface
    !> Determines whether the items of `values` are reals, or integers of 32 or 64 bits, and the
    !> bytes of one item.
    subroutine describe_array(values, is_real, is_integer, bytes) bind(c, name='battery_describe')
      import :: c_int
      implicit none (type, external)
      type(*), intent(in) :: values(..)
      integer(c_int), intent(out) :: is_real, is_integer, bytes
    end subroutine describe_array

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

    !> Puts /dev/null in the place of a file; its descriptor stays open.
    subroutine replace_descriptor(descriptor) bind(c, name='battery_replace_descriptor')
      import :: c_ptr
      implicit none (type, external)
      type(c_ptr), value, intent(in) :: descriptor
    end subroutine replace_descriptor

    integer(c_int) function set_scale(dataset, name) bind(c, name='H5DSset_scale')
      import :: c_char, c_int, c_int64_t
      implicit none (type, external)
      integer(c_int64_t), value, intent(in) :: dataset
      character(kind=c_char), intent(in) :: name(*)
    end function set_scale

    !> `dimension` counts from 0, the slowest first.
    integer(c_int) function attach_scale(dataset, scale, dimension) &
        bind(c, name='H5DSattach_scale')
      import :: c_int, c_int64_t
      implicit none (type, external)
      integer(c_int64_t), value, intent(in) :: dataset, scale
      integer(c_int), value, intent(in) :: dimension
    end function attach_scale

    integer(c_int) function scale_count(dataset, dimension) bind(c, name='H5DSget_num_scales')
      import :: c_int, c_int64_t
      implicit none (type, external)
      integer(c_int64_t), value, intent(in) :: dataset
      integer(c_int), value, intent(in) :: dimension
    end function scale_count
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

  !> Starts HDF5 if needed, without its own messages, the plugins for filters that a file names, and
  !> its file locks: some network disks have none, and the program has a lock of its own. HDF5 reads
  !> the variables when it starts; versions before 1.10.7 have no other way to switch the locks off.
  subroutine start_hdf5(status)
    integer, intent(out) :: status

    status = 0
    if (is_started) return
    status = set_variable('HDF5_USE_FILE_LOCKING'//c_null_char, 'FALSE'//c_null_char, 1_c_int)
    if (status == 0) status = set_variable('HDF5_PLUGIN_PRELOAD'//c_null_char, '::'//c_null_char, &
      1_c_int)
    if (status == 0) call h5open_f(status)
    if (status == 0) call h5eset_auto_f(0, status)
    is_started = status == 0
  end subroutine start_hdf5

  !> Opens a file: a new one is made in memory, and another read (`check_footer` reports a missing
  !> or unreadable one).
  subroutine open_file(file, name, is_new, error)
    !> File, opened here; `close_file` closes it.
    class(hdf5_file_type), intent(out) :: file
    !> Path of the file.
    character(len=*), intent(in) :: name
    !> Whether the file is made, and written to disk by `close_file` over any file of the same name.
    logical, intent(in) :: is_new
    type(error_type), allocatable, intent(out) :: error
    integer(size_t), parameter :: growth = 1024_size_t**2
    integer(hid_t) :: access
    integer :: status

    file%name = name
    file%is_new = is_new
    access = no_handle
    call start_hdf5(status)
    if (status == 0) call h5pcreate_f(h5p_file_access_f, access, status)
    ! Closing the file closes all objects in it.
    if (status == 0) call h5pset_fclose_degree_f(access, h5f_close_strong_f, status)
    if (status == 0 .and. is_new) call h5pset_fapl_core_f(access, growth, .false., status)
    if (status == 0 .and. is_new) then
      call h5fcreate_f(name, h5f_acc_trunc_f, file%id, status, access_prp=access)
    else if (status == 0) then
      call h5fopen_f(name, h5f_acc_rdonly_f, file%id, status, access_prp=access)
    end if
    call release_handle(access, status)
    if (status == 0) return
    if (is_new) call fatal_error(error, name//': cannot be created in memory')
    if (.not. is_new) call fatal_error(error, name//': cannot be opened as an HDF5 file', &
      exit_bad_input)
  end subroutine open_file

  !> Closes a file, and all that is open in it; a file that is not open is no error. A new file is
  !> written to the disk, unless there was an error.
  subroutine close_file(file, error)
    !> File, open.
    class(hdf5_file_type), intent(inout) :: file
    !> An earlier error is kept.
    type(error_type), allocatable, intent(inout) :: error
    integer(int8), pointer, contiguous :: image(:)
    integer(size_t) :: bytes
    type(c_ptr) :: handle
    type(c_ptr), pointer :: memory
    integer :: status

    if (file%id < 0) return
    status = 0
    if (file%is_new .and. .not. allocated(error)) then
      handle = c_null_ptr
      call h5fflush_f(file%id, h5f_scope_global_f, status)
      if (status == 0) call h5fget_file_image_f(file%id, handle, 0_size_t, status, bytes)
      if (status == 0) &
        status = get_handle(int(file%id, c_int64_t), int(h5p_default_f, c_int64_t), handle)
      if (status == 0 .and. .not. c_associated(handle)) status = -1
      if (status == 0) then
        call c_f_pointer(handle, memory)
        call c_f_pointer(memory, image, [bytes])
        call write_with_footer(file%name, image, error)
      end if
    end if
    if (.not. file%is_new) call detach(file)
    call release_handle(file%id, status)
    file%id = no_handle
    if (status /= 0 .and. .not. allocated(error)) &
      call fatal_error(error, file%name//': cannot be closed')
  end subroutine close_file

  !> Puts another file in the place of one that was read. HDF5 1.10 crashes at the end of the
  !> program if the system cannot close a file, as on a disk that has gone away.
  subroutine detach(file)
    class(hdf5_file_type), intent(in) :: file
    type(c_ptr) :: handle

    handle = c_null_ptr
    if (get_handle(int(file%id, c_int64_t), int(h5p_default_f, c_int64_t), handle) == 0 .and. &
      c_associated(handle)) call replace_descriptor(handle)
  end subroutine detach

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

  !> Checks that an object is stored in this file under its path: all links to it must be hard
  !> links. Other links can lead to any object, also in any other file that the user may read. Does
  !> nothing after an error.
  subroutine check_links(file, path, error)
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
        call check_status(file, path, 'is not there, or cannot be read', status, error)
        if (status == 0) call check_status(file, path, 'is a link out of its place', merge(1, 0, &
          link_value(file%id, step//c_null_char, c_null_ptr, 0_c_size_t, h5p_default_f) >= 0), &
          error)
      end associate
    end do
  end subroutine check_links

  !> Makes a group in a file; it must not exist yet, and its parent must. Does nothing after an
  !> error, or to a file that is read.
  subroutine make_group(file, path, error)
    !> File, open.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the group in the file, from the root.
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(inout) :: error
    integer(hid_t) :: group
    integer :: status

    if (allocated(error) .or. .not. file%is_new) return
    group = no_handle
    call h5gcreate_f(file%id, path, group, status)
    call release_handle(group, status)
    call check_status(file, path, 'cannot be made', status, error)
  end subroutine make_group

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
    !> File, open.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the object that gets the attribute, `/` for the file; name of the attribute.
    character(len=*), intent(in) :: path, name
    !> Scalar or array, as `array_view_of` takes it.
    type(*), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(inout) :: error

    call add_attribute(file, path, name, array_view_of(values), error)
  end subroutine write_attribute

  !> Adds an attribute that is a text; does nothing after an error, or to a file that is read.
  subroutine write_text_attribute(file, path, name, text, error)
    !> File, open.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the object that gets the attribute, `/` for the file; its name and its text.
    character(len=*), intent(in) :: path, name, text
    type(error_type), allocatable, intent(inout) :: error
    character(len=:, kind=c_char), allocatable, target :: letters
    type(c_ptr), target :: address
    type(array_view_type) :: memory
    integer :: status

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
    type(error_type), allocatable, intent(inout) :: error
    integer(hid_t) :: space, attribute
    integer :: status

    if (allocated(error) .or. .not. file%is_new) return
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

  !> As `serialize_dataset`, for values that are known: those in a file that is read must be the
  !> same. Without dimension scales, the dataset is one.
  subroutine write_dataset(file, path, values, units, long_name, error, scales)
    !> File, open.
    class(hdf5_file_type), intent(in) :: file
    !> As above.
    character(len=*), intent(in) :: path, units, long_name
    type(*), intent(in), target, contiguous :: values(..)
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), intent(in), optional :: scales(:)
    integer(int8), allocatable, target :: found(:)
    integer(int8), pointer, contiguous :: known(:)
    type(array_view_type) :: memory
    integer(size_t) :: bytes
    integer :: status

    memory = array_view_of(values)
    if (file%is_new) then
      call serialize_whole(file, path, memory, units, long_name, error, scales)
      return
    end if
    bytes = 0
    call h5tget_size_f(memory%value_type, bytes, status)
    call c_f_pointer(memory%address, known, [bytes*product(memory%extents)])
    found = known
    memory%address = c_loc(found)
    call serialize_whole(file, path, memory, units, long_name, error, scales)
    if (allocated(error)) return
    call check_status(file, path, 'has other values than those of the namelist in the file', &
      count(found /= known), error)
  end subroutine write_dataset

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

    call serialize_whole(file, path, array_view_type(h5kind_to_type(int32, h5_integer_kind), &
      c_null_ptr, [int(length, hsize_t)]), '1', long_name, error)
  end subroutine write_dimension

  !> Writes or reads a whole dataset. Does nothing after an error.
  subroutine serialize_whole(file, path, memory, units, long_name, error, scales)
    class(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, units, long_name
    !> Values in memory; without an address, only the dataset is made.
    type(array_view_type), intent(in) :: memory
    type(error_type), allocatable, intent(inout) :: error
    character(len=*), intent(in), optional :: scales(:)
    type(dataset_type) :: dataset

    if (allocated(error)) return
    call open_or_make(file, path, memory, .false., units, long_name, error, dataset, scales)
    if (c_associated(memory%address) .and. product(memory%extents) > 0) &
      call serialize_view(file, dataset, memory, error)
    call close_dataset(file, dataset, error)
  end subroutine serialize_whole

  !> Closes a dataset before its file, which frees the memory of its last chunk.
  subroutine close_dataset(file, dataset, error)
    !> File that the dataset is in, open.
    class(hdf5_file_type), intent(in) :: file
    !> Dataset; one that is not open is no error.
    type(dataset_type), intent(inout) :: dataset
    !> The last chunk could not be written to the file; an earlier error is kept.
    type(error_type), allocatable, intent(inout) :: error
    integer :: status

    status = 0
    call release_handle(dataset%id, status)
    dataset%id = no_handle
    if (status /= 0 .and. .not. allocated(error)) &
      call check_status(file, dataset%path, 'cannot be closed', status, error)
  end subroutine close_dataset

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
    !> Open dataset.
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
    type(array_view_type) :: memory

    memory = array_view_of(values)
    memory%extents = extents
    call serialize_view(file, dataset, memory, error, first)
  end subroutine serialize_slab

  !> Writes values to a dataset, or reads them: all, or those from `first` on. Does nothing after an
  !> error.
  subroutine serialize_view(file, dataset, memory, error, first)
    class(hdf5_file_type), intent(in) :: file
    type(dataset_type), intent(in) :: dataset
    type(array_view_type), intent(in) :: memory
    type(error_type), allocatable, intent(inout) :: error
    integer, intent(in), optional :: first(:)
    integer(hid_t) :: space, part
    type(c_ptr) :: address
    integer :: status, released

    if (allocated(error)) return
    status = 0
    space = merge(no_handle, h5s_all_f, present(first))
    part = space
    if (present(first)) then
      call h5dget_space_f(dataset%id, space, status)
      if (status == 0) call h5sselect_hyperslab_f(space, h5s_select_set_f, int(first - 1, &
        hsize_t), memory%extents, status)
      if (status == 0) call h5screate_simple_f(size(first), memory%extents, part, status)
    end if
    address = memory%address
    if (status == 0 .and. file%is_new) then
      call h5dwrite_f(dataset%id, memory%value_type, address, status, part, space)
    else if (status == 0) then
      call h5dread_f(dataset%id, memory%value_type, address, status, part, space)
    end if
    if (present(first)) then
      call release_handle(part, released)
      call release_handle(space, released)
    end if
    call check_status(file, dataset%path, merge('cannot be written', 'cannot be read   ', &
      file%is_new), status, error)
  end subroutine serialize_view

  !> Reads the extents of a dataset, in Fortran order; -1 if it has another rank. It must be stored
  !> in the file itself, which is checked before anything else: a query of the extents of a virtual
  !> dataset would open other files. Does nothing after an error.
  subroutine read_extents(file, path, extents, error, dataset)
    !> File, open for reading.
    class(hdf5_file_type), intent(in) :: file
    !> Path of the dataset in the file, from the root.
    character(len=*), intent(in) :: path
    !> Of the size of the expected number of dimensions.
    integer(hsize_t), intent(out) :: extents(:)
    type(error_type), allocatable, intent(inout) :: error
    !> The dataset, open.
    type(dataset_type), intent(out) :: dataset
    integer(hsize_t) :: most(size(extents))
    integer(hid_t) :: layout, space
    integer :: status, way, others, found

    extents = -1
    call check_links(file, path, error)
    if (allocated(error)) return
    dataset%path = path
    layout = no_handle
    space = no_handle
    call h5dopen_f(file%id, path, dataset%id, status)
    if (status == 0) call h5dget_create_plist_f(dataset%id, layout, status)
    if (status == 0) call h5pget_layout_f(layout, way, status)
    if (status == 0) call h5pget_external_count_f(layout, others, status)
    call check_status(file, path, 'is no dataset, or cannot be read', status, error)
    if (status == 0 .and. (others > 0 .or. all(way /= [h5d_compact_f, h5d_contiguous_f, &
      h5d_chunked_f]))) call check_status(file, path, 'does not lie in the file itself', 1, error)
    call release_handle(layout, status)
    if (allocated(error)) return
    call h5dget_space_f(dataset%id, space, status)
    if (status == 0) call h5sget_simple_extent_ndims_f(space, found, status)
    if (status == 0 .and. found == size(extents)) &
      call h5sget_simple_extent_dims_f(space, extents, most, status)
    call release_handle(space, status)
  end subroutine read_extents

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

  !> Makes a dataset in a new file, or opens and checks one of a file that is read. Does nothing
  !> after an error.
  subroutine open_or_make(file, path, memory, fills, units, long_name, error, dataset, scales)
    class(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, units, long_name
    !> Type and extents of the dataset; its address is that of the fill value if it `fills`.
    type(array_view_type), intent(in) :: memory
    logical, intent(in) :: fills
    type(error_type), allocatable, intent(inout) :: error
    type(dataset_type), intent(inout) :: dataset
    !> Without them, it is a dimension scale, named for the last part of its path.
    character(len=*), intent(in), optional :: scales(:)
    character(len=*), parameter :: mark = 'This is a netCDF dimension but not a netCDF variable.'
    character(len=len(mark) + 10) :: name
    integer(hid_t) :: space, layout, scale
    integer(hsize_t) :: extents(size(memory%extents))
    integer :: status, k

    if (allocated(error)) return
    if (.not. file%is_new) then
      call read_extents(file, path, extents, error, dataset)
      if (.not. allocated(error) .and. any(extents /= memory%extents)) call check_status(file, &
        path, 'has the dimensions '//extents_text(extents)//'; by the namelist in the file they ' &
        //'are '//extents_text(memory%extents), 1, error)
      k = 0
      if (present(scales)) k = size(scales)
      if (.not. allocated(error)) call check_like_new(file, dataset, memory%value_type, k, error)
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
    if (present(scales)) then
      ! HDF5 counts dimensions in the reverse order of Fortran.
      do k = 1, size(scales)
        scale = no_handle
        if (status == 0) call h5dopen_f(file%id, trim(scales(k)), scale, status)
        if (status == 0) status = attach_scale(dataset%id, scale, int(size(scales) - k, c_int))
        call release_handle(scale, status)
      end do
    else if (status == 0) then
      name = path(index(path, '/', back=.true.) + 1:)
      if (.not. c_associated(memory%address)) write (name, '(a, i10)') mark, memory%extents
      status = set_scale(dataset%id, trim(name)//c_null_char)
    end if
    call release_handle(layout, status)
    call release_handle(space, status)
    call check_status(file, path, 'cannot be written', status, error)
    call write_text_attribute(file, path, 'units', units, error)
    call write_text_attribute(file, path, 'long_name', long_name, error)
  end subroutine open_or_make

  !> An error unless a dataset of a file that is read has the type of a new one, and a dimension
  !> scale for each of its first `scales` dimensions.
  subroutine check_like_new(file, dataset, value_type, scales, error)
    class(hdf5_file_type), intent(in) :: file
    type(dataset_type), intent(in) :: dataset
    integer(hid_t), intent(in) :: value_type
    integer, intent(in) :: scales
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: types(2)
    integer(size_t) :: bytes(2)
    integer :: class(2), status, k

    types(1) = value_type
    call h5dget_type_f(dataset%id, types(2), status)
    do k = 1, 2
      if (status == 0) call h5tget_class_f(types(k), class(k), status)
      if (status == 0) call h5tget_size_f(types(k), bytes(k), status)
    end do
    if (status == 0) status = merge(0, 1, class(1) == class(2) .and. bytes(1) == bytes(2))
    call check_status(file, dataset%path, 'has numbers of another type', status, error)
    call release_handle(types(2), status)
    if (allocated(error)) return
    status = count([(scale_count(dataset%id, int(k - 1, c_int)), k=1, scales)] /= 1)
    call check_status(file, dataset%path, 'has lost its dimension scales', status, error)
  end subroutine check_like_new

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

end module battery_hdf5_file

!> Dimension scales of HDF5, so that readers know the dimensions of datasets by name.
module battery_hdf5_scales
  use hdf5, only: hid_t, h5dopen_f
  use h5ds, only: h5dsset_scale_f, h5dsattach_scale_f
  use battery_error, only: error_type
  use battery_hdf5_file, only: hdf5_file_type, release, check, no_handle
  use battery_hdf5_datasets, only: reserve_dataset
  implicit none (type, external)
  private
  public :: make_scale, make_dimension, attach_scales

contains

  !> Makes a dataset of rank 1 a dimension scale, named for the last part of its path.
  subroutine make_scale(file, path, error)
    !> Open, to be written.
    type(hdf5_file_type), intent(in) :: file
    !> Of a dataset of one dimension.
    character(len=*), intent(in) :: path
    type(error_type), allocatable, intent(out) :: error

    call set_scale(file, path, path(index(path, '/', back=.true.) + 1:), error)
  end subroutine make_scale

  !> Makes a dimension without coordinates, marked as netCDF does; its data take no room.
  subroutine make_dimension(file, path, length, long_name, error)
    !> Open, to be written.
    type(hdf5_file_type), intent(in) :: file
    !> From the root, in a group that is there.
    character(len=*), intent(in) :: path
    !> Of the dimension.
    integer, intent(in) :: length
    !> What it counts.
    character(len=*), intent(in) :: long_name
    type(error_type), allocatable, intent(out) :: error
    character(len=*), parameter :: mark = 'This is a netCDF dimension but not a netCDF variable.'
    character(len=len(mark) + 10) :: name

    write (name, '(a, i10)') mark, length
    call reserve_dataset(file, path, length, '1', long_name, error)
    if (.not. allocated(error)) call set_scale(file, path, name, error)
  end subroutine make_dimension

  !> Attaches dimension scales to a dataset: `scales` are their paths, one a dimension, in Fortran
  !> order. HDF5 counts dimensions the other way round here, in its Fortran interface too.
  subroutine attach_scales(file, path, scales, error)
    !> Open, to be written.
    type(hdf5_file_type), intent(in) :: file
    !> Of the dataset.
    character(len=*), intent(in) :: path
    character(len=*), intent(in) :: scales(:)
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: dataset, scale
    integer :: dimension, status

    dataset = no_handle
    call h5dopen_f(file%id, path, dataset, status)
    do dimension = 1, size(scales)
      scale = no_handle
      if (status == 0) call h5dopen_f(file%id, trim(scales(dimension)), scale, status)
      if (status == 0) &
        call h5dsattach_scale_f(dataset, scale, size(scales) - dimension + 1, status)
      call release(scale, status)
    end do
    call release(dataset, status)
    call check(file, path, 'cannot be given its dimension scales', status, error)
  end subroutine attach_scales

  subroutine set_scale(file, path, name, error)
    type(hdf5_file_type), intent(in) :: file
    character(len=*), intent(in) :: path, name
    type(error_type), allocatable, intent(out) :: error
    integer(hid_t) :: dataset
    integer :: status

    dataset = no_handle
    call h5dopen_f(file%id, path, dataset, status)
    if (status == 0) call h5dsset_scale_f(dataset, status, name)
    call release(dataset, status)
    call check(file, path, 'cannot be a dimension scale', status, error)
  end subroutine set_scale

end module battery_hdf5_scales

!> Brings a file to the disk while the program goes on computing (POSIX asynchronous input and
!> output). What is written is safe from the program's own end at once, whatever becomes of it; a
!> sync makes it safe from that of the machine, and takes milliseconds that need not be waited for.
module battery_background_sync
  use, intrinsic :: iso_c_binding, only: c_ptr, c_null_char, c_null_ptr, c_associated
  use battery_c_shapes, only: address_of_path, number_of_address
  use battery_error, only: error_type, fatal_error
  use battery_paths, only: system_message, fail_with
  implicit none (type, external)
  private
  public :: sync_type, begin_sync, end_sync

  !> A sync that may be under way; one at a time.
  type :: sync_type
    private
    !> Name of the file; not allocated: nothing is under way.
    character(len=:), allocatable :: path
    !> Whether the file was written to since the sync began.
    logical :: again = .false.
    !> What the system works on.
    type(c_ptr) :: control = c_null_ptr
  end type sync_type

  procedure(address_of_path), bind(c, name='battery_sync_begin') :: c_begin
  procedure(number_of_address), bind(c, name='battery_sync_is_under_way') :: c_is_under_way
  procedure(number_of_address), bind(c, name='battery_sync_end') :: c_end

contains

  !> Begins to bring a file to the disk, or, where that is under way, takes note to do so again.
  recursive subroutine begin_sync(sync, path, error)
    type(sync_type), intent(inout) :: sync
    !> The same until `end_sync`.
    character(len=*), intent(in) :: path
    !> It may be that of the sync before.
    type(error_type), allocatable, intent(out) :: error

    if (allocated(sync%path)) then
      sync%again = c_is_under_way(sync%control) == 1
      if (sync%again) return
      call end_sync(sync, error)
      if (allocated(error)) return
    end if
    sync%control = c_begin(path//c_null_char)
    if (c_associated(sync%control)) then
      sync%path = path
    else
      call fatal_error(error, path//': cannot be brought to the disk: '//system_message())
    end if
  end subroutine begin_sync

  !> Waits until all that was begun is over; without anything, does nothing.
  recursive subroutine end_sync(sync, error)
    type(sync_type), intent(inout) :: sync
    !> The file may not be on the disk.
    type(error_type), allocatable, intent(out) :: error
    character(len=:), allocatable :: path
    logical :: again

    if (.not. allocated(sync%path)) return
    call move_alloc(sync%path, path)
    again = sync%again
    sync%again = .false.
    call fail_with(c_end(sync%control), path//': cannot be brought to the disk', error)
    if (allocated(error) .or. .not. again) return
    call begin_sync(sync, path, error)
    if (.not. allocated(error)) call end_sync(sync, error)
  end subroutine end_sync

end module battery_background_sync
